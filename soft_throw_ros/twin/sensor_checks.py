# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnoses of the sensors of a measured plate."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from soft_throw_ros.twin.outlier_filter import MEDIAN_DEVIATION
from soft_throw_ros.twin.plate_estimator import least_rate, PlateEstimator, SampledSpan
from soft_throw_ros.twin.sample_buffer import LONG_AGO

MAX_NOISE = 1.5
"""Noise of the samples over `measured.position_noise`, above which it is reported. [-]"""

_RATE_ERROR = 0.03
"""Error of the estimated rate of a sensor whose stamps jitter, relative to the rate. [-]"""

_FEWEST_SAMPLES = 30
"""Fewest samples that give an estimate of the noise. [-]"""

_NOISE_RANGE = 15.0
"""Range of heights, in standard deviations, of a plate that is at rest but for noise. [-]"""


class LowRate(NamedTuple):
    """The plate is measured too rarely to follow a throw."""

    rate: float  # [Hz]
    least_rate: float  # [Hz]
    span: SampledSpan  # the one that requires the least rate


class HighNoise(NamedTuple):
    """Noise hides the rest of the plate."""

    noise: float  # standard deviation of the heights at rest [m]
    expected: float  # `measured.position_noise` [m]


SensorFault: TypeAlias = LowRate | HighNoise


class SensorChecks:
    """Faults of the sensors, each once per throw, for `diagnose` to collect now and then."""

    def __init__(self) -> None:
        self._faults: dict[type[SensorFault], SensorFault] = {}  # not collected yet
        self._reported: set[type[SensorFault]] = set()  # kinds of faults in this throw
        self._newest_ns = LONG_AGO  # stamp of the newest sample at the last diagnosis

    def begin(self) -> None:
        """Begin a throw, or another measurement."""
        self._reported.clear()

    def diagnose(
        self, estimator: PlateEstimator, crossing_time: float, *, is_armed: bool
    ) -> tuple[SensorFault, ...]:
        """Return the new faults since the last call, after a check of rate and noise."""
        if estimator.newest_ns > self._newest_ns:  # else the sensor is silent
            self._newest_ns = estimator.newest_ns
            # until a rest is seen, the rate must suffice to see one
            self.has_rate(estimator, crossing_time if is_armed else math.inf)
            if not is_armed:
                self._check_noise(estimator)
        faults = tuple(fault for kind, fault in self._faults.items() if kind not in self._reported)
        self._reported |= self._faults.keys()
        self._faults.clear()
        return faults

    def has_rate(self, estimator: PlateEstimator, crossing_time: float) -> bool:
        """Return whether the rate of samples suffices to follow a throw; report if not."""
        rate = estimator.rate()
        least, span = least_rate(estimator.config, crossing_time)
        suffices = rate >= (1.0 - _RATE_ERROR) * least
        if rate > 0.0 and not suffices:
            self._faults.setdefault(LowRate, LowRate(rate, least, span))
        return suffices

    def _check_noise(self, estimator: PlateEstimator) -> None:
        """Report noise that hides the rest of the plate, or heights in another unit."""
        heights = estimator.samples().plate
        if heights.size < _FEWEST_SAMPLES:
            return
        # second differences, which have six times the variance, are free of slow motions
        deviation = float(np.median(np.abs(np.diff(heights, 2)))) / MEDIAN_DEVIATION
        noise, expected = deviation / math.sqrt(6.0), estimator.config.position_noise
        if noise > MAX_NOISE * expected and np.ptp(heights) < _NOISE_RANGE * noise:
            self._faults[HighNoise] = HighNoise(noise, expected)
