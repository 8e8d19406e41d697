# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnoses of the sensors of a measured plate."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.twin.outlier_filter import MEDIAN_DEVIATION
from soft_throw_ros.twin.plate_estimator import least_rate, PlateEstimator, SampledSpan

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


class LowRate(NamedTuple):
    """The plate is measured too rarely to follow a throw."""

    rate: float  # [Hz]
    least_rate: float  # [Hz]
    span: SampledSpan  # the one that requires the least rate


class HighNoise(NamedTuple):
    """Noise hides the rest of the plate."""

    noise: float  # standard deviation of the heights at rest [m]
    expected: float  # `measured.position_noise` [m]


class WrongUnit(NamedTuple):
    """The plate moves too far for heights in metres."""

    rise: float  # range of the heights [m]
    amplitude: float  # `engine.amplitude` [m]


class WrongDirection(NamedTuple):
    """The plate jumps down, as if heights counted downwards."""

    speed: float  # downward, shortly after a rest [m/s]


class SwappedBodies(NamedTuple):
    """The projectile moves before the plate."""


SensorFault: TypeAlias = LowRate | HighNoise | WrongUnit | WrongDirection | SwappedBodies


class SensorChecks:
    """
    Faults of the sensors, each once per throw, for `diagnose` to collect about once a second.

    The monitor of the plate adds observations in every tick, which costs a few comparisons.
    """

    def __init__(self) -> None:
        self._faults: list[SensorFault] = []  # not collected yet
        self._reported: set[type] = set()  # kinds of faults in this throw
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

    def report(self, fault: SensorFault) -> None:
        """Add a fault, unless there has been one of this kind in this throw."""
        if type(fault) not in self._reported:
            self._reported.add(type(fault))
            self._faults.append(fault)

    def observe(self, height: float, speed: float, *, was_at_rest: bool) -> None:
        """Observe the smoothed motion of the plate, which may have been at rest shortly before."""
        self._lowest, self._highest = min(self._lowest, height), max(self._highest, height)
        if was_at_rest:
            self._fall = max(self._fall, -speed)

    def diagnose(
        self, estimator: PlateEstimator, crossing_time: float, *, is_armed: bool
    ) -> tuple[SensorFault, ...]:
        """Return the faults since the last call, after a check of rate, noise and motion."""
        self._check_motion(estimator.config)
        if estimator.newest_ns > self._newest_ns:  # else the sensor is silent
            self._newest_ns = estimator.newest_ns
            # until a rest is seen, the rate must suffice to see one
            self.has_rate(estimator, crossing_time if is_armed else math.inf)
            if not is_armed:
                self._check_noise(estimator)
        faults, self._faults = tuple(self._faults), []
        return faults

    def has_rate(self, estimator: PlateEstimator, crossing_time: float) -> bool:
        """Return whether the rate of samples suffices to follow a throw; report if not."""
        rate = estimator.rate()
        least, span = least_rate(estimator.config, crossing_time)
        suffices = rate >= (1.0 - _RATE_ERROR) * least
        if rate > 0.0 and not suffices:
            self.report(LowRate(rate, least, span))
        return suffices

    def _check_noise(self, estimator: PlateEstimator) -> None:
        """Report noise that hides the rest of the plate."""
        heights = estimator.samples().plate
        if heights.size < _FEWEST_SAMPLES:
            return
        noise, expected = _scatter(heights), estimator.config.position_noise
        if noise > MAX_NOISE * expected and np.ptp(heights) < _NOISE_RANGE * noise:
            self.report(HighNoise(noise, expected))

    def _check_motion(self, config: MeasurementConfig) -> None:
        """Report heights that are in millimetres, or count downwards."""
        rise, amplitude = self._highest - self._lowest, config.plate.amplitude
        if rise > MAX_RISE * amplitude:
            self.report(WrongUnit(rise, amplitude))
        if self._fall > _FALL * config.plate.peak_velocity:
            self.report(WrongDirection(self._fall))


def _scatter(heights: NDArray[np.float64]) -> float:
    """Return the standard deviation of heights about a slow motion, robustly [m]."""
    deviation = float(np.median(np.abs(np.diff(heights, 2)))) / MEDIAN_DEVIATION
    return deviation / math.sqrt(6.0)  # second differences have six times the variance
