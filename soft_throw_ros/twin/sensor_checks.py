# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Diagnoses of the sensors of a measured plate."""

from __future__ import annotations

import math

import numpy as np
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.twin.plate_estimator import least_rate, PlateEstimator, scatter

MAX_NOISE = 1.5
"""Noise of the samples over `measured.position_noise`, above which it is reported. [-]"""

MAX_RISE = 100.0
"""Range of the plate's heights in amplitudes of the engine, above which it is reported. [-]"""

_RATE_ERROR = 0.03
"""Error of the estimated rate of a sensor whose stamps jitter, relative to the rate. [-]"""

_FEWEST_SAMPLES = 30
"""Fewest samples that give an estimate of the noise. [-]"""

_NOISE_RANGE = 15.0
"""Range of heights, in standard deviations, of a plate that is at rest but for noise. [-]"""

_FALL = 0.5
"""Downward speed over the peak speed of the plate that no return to rest reaches. [-]"""


class SensorChecks:
    """
    Reports on the sensors, each once per throw, for `diagnose` to collect about once a second.

    The monitor of the plate adds observations in every tick, which costs a few comparisons.
    """

    def __init__(self) -> None:
        self._reports: list[str] = []  # not collected yet
        self._reported: set[str] = set()  # kinds of reports in this throw
        self._newest_ns = -math.inf  # stamp of the newest sample at the last diagnosis
        self._forget_motion()

    def _forget_motion(self) -> None:
        self._lowest, self._highest = math.inf, -math.inf  # of the smoothed heights [m]
        self._fall = 0.0  # largest downward speed shortly after a rest [m/s]

    def begin(self, config: MeasurementConfig) -> None:
        """Begin a throw, or another measurement, after one with the given configuration."""
        self._check_motion(config)
        self._reported.clear()
        self._forget_motion()

    def report(self, kind: str, text: str) -> None:
        """Add a report, unless there has been one of this kind in this throw."""
        if kind not in self._reported:
            self._reported.add(kind)
            self._reports.append(text)

    def observe(self, height: float, speed: float, *, was_at_rest: bool) -> None:
        """Observe the smoothed motion of the plate, which may have been at rest shortly before."""
        self._lowest, self._highest = min(self._lowest, height), max(self._highest, height)
        if was_at_rest:
            self._fall = max(self._fall, -speed)

    def diagnose(
        self, estimator: PlateEstimator, crossing_time: float, *, is_armed: bool
    ) -> tuple[str, ...]:
        """Return the reports since the last call, after a check of rate, noise and motion."""
        self._check_motion(estimator.config)
        if estimator.newest_ns > self._newest_ns:  # else the sensor is silent
            self._newest_ns = estimator.newest_ns
            # until a rest is seen, the rate must suffice to see one
            self.has_rate(estimator, crossing_time if is_armed else math.inf)
            if not is_armed:
                self._check_noise(estimator)
        reports, self._reports = tuple(self._reports), []
        return reports

    def has_rate(self, estimator: PlateEstimator, crossing_time: float) -> bool:
        """Return whether the rate of samples suffices to follow a throw; report if not."""
        rate = estimator.rate()
        least, reason = least_rate(estimator.config, crossing_time)
        suffices = rate >= (1.0 - _RATE_ERROR) * least
        if rate > 0.0 and not suffices:
            self.report(
                'rate',
                f'the plate is measured at {rate:.0f} Hz, which must be at least {least:.0f} Hz, '
                f'{reason}: no throw is followed',
            )
        return suffices

    def _check_noise(self, estimator: PlateEstimator) -> None:
        """Report noise that hides the rest of the plate."""
        heights = estimator.samples(-math.inf)['plate']
        if heights.size < _FEWEST_SAMPLES:
            return
        noise, expected = scatter(heights), estimator.config.position_noise
        if noise > MAX_NOISE * expected and np.ptp(heights) < _NOISE_RANGE * noise:
            self.report(
                'noise',
                f'the plate at rest scatters by {1e6 * noise:.3g} um, {noise / expected:.1f} '
                f'times measured.position_noise {1e6 * expected:.3g} um: set it, without which '
                'the plate may never seem at rest and no throw is followed',
            )

    def _check_motion(self, config: MeasurementConfig) -> None:
        """Report heights that are in millimetres, or count downwards."""
        rise, amplitude = self._highest - self._lowest, config.plate.amplitude
        if rise > MAX_RISE * amplitude:
            self.report(
                'units',
                f'the plate moves by {rise:.3g} m, {rise / amplitude:.0f} times '
                'engine.amplitude: if heights are in millimetres, divide them by 1000',
            )
        if self._fall > _FALL * config.plate.peak_velocity:
            self.report(
                'direction',
                f'the plate has jumped down, at {self._fall:.3g} m/s: if heights count '
                'downwards, change their sign; no throw is followed',
            )
