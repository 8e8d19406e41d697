# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Faults of the sensors of plate and projectile.

The node `rig` measures sample by sample, and the trials measure whole throws; therefore all
functions take floats and arrays alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

Numbers: TypeAlias = Any
"""A number or an array; typing has no name for functions that keep the one they are given."""

# Size of the smallest outlier over that of the largest. [-]
_SMALLEST_OUTLIER = 0.1

# Time after which the drift changes its sign, so that heights stay bounded. [s]
_DRIFT_TURNS = 1.0

# Number of samples in a block of random numbers; drawing numbers one by one is slow. [-]
_BLOCK = 4096


class Chances(NamedTuple):
    """
    Random numbers of one sample, or arrays for many samples.

    `jitter`, `stamp` and the sizes of outliers are uniform in [-1, 1], noise is standard normal,
    and all others are uniform in [0, 1).
    """

    jitter: Numbers
    stamp: Numbers
    missing: Numbers
    plate_noise: Numbers
    plate_outlier: Numbers
    plate_outlier_size: Numbers
    projectile_noise: Numbers
    projectile_outlier: Numbers
    projectile_outlier_size: Numbers


class Measurement(NamedTuple):
    """A measured stamp [s] and heights [m], and whether the message arrives."""

    stamp: Numbers
    plate: Numbers
    projectile: Numbers
    is_received: Numbers


@dataclass(frozen=True, kw_only=True)
class SensorFaults:
    """Faults of the sensors, by default none; only a drift and a delay may be negative."""

    noise: float = 0.0  # standard deviation of heights [m]
    jitter: float = 0.0  # largest deviation of sample and stamp from the nominal time [s]
    stamp_error: float = 0.0  # largest deviation of a stamp from the time of its sample [s]
    outlier_rate: float = 0.0  # share of the heights that are outliers [-]
    outlier_size: float = 0.0  # largest error of an outlier; the smallest is a tenth of it [m]
    drift: float = 0.0  # rate of change of both heights; its sign changes every second [m/s]
    projectile_delay: float = 0.0  # age of the projectile's height at its stamp [s]
    projectile_scale: float = 1.0  # measured height of the projectile over the true one [-]
    missing_rate: float = 0.0  # share of the samples that are lost [-]
    rounding: float = 0.0  # resolution of the heights; 0 for no rounding [m]

    def measure(
        self,
        time: Numbers,
        plate: Callable[[Numbers], Numbers],
        projectile: Callable[[Numbers], Numbers],
        chances: Chances,
    ) -> Measurement:
        """Measure plate and projectile, whose heights [m] are functions of time, at a time [s]."""
        moment = time + self.jitter * chances.jitter
        drift = self.drift * (_DRIFT_TURNS - abs(moment % (2.0 * _DRIFT_TURNS) - _DRIFT_TURNS))
        heights = plate(moment), self.projectile_scale * projectile(moment - self.projectile_delay)
        stamp = moment + self.stamp_error * chances.stamp
        return Measurement(
            stamp,
            self._disturb(heights[0] + drift, *chances[3:6]),
            self._disturb(heights[1] + drift, *chances[6:9]),
            chances.missing >= self.missing_rate,
        )

    def _disturb(
        self, height: Numbers, noise: Numbers, outlier: Numbers, size: Numbers
    ) -> Numbers:
        """Add noise and outliers of either sign, and round to the nearest step."""
        share = _SMALLEST_OUTLIER + (1.0 - _SMALLEST_OUTLIER) * abs(size)
        error = np.copysign(self.outlier_size * share, size)
        measured = height + self.noise * noise + (outlier < self.outlier_rate) * error
        if self.rounding == 0.0:
            return measured
        return np.rint(measured / self.rounding) * self.rounding


def draw_chances(random: np.random.Generator, samples: int) -> Chances:
    """Draw the random numbers of a number of samples."""
    jitter, stamp, plate_size, projectile_size = random.uniform(-1.0, 1.0, (4, samples))
    missing, plate_outlier, projectile_outlier = random.uniform(size=(3, samples))
    plate_noise, projectile_noise = random.standard_normal((2, samples))
    return Chances(
        jitter, stamp, missing,
        plate_noise, plate_outlier, plate_size,
        projectile_noise, projectile_outlier, projectile_size,
    )


def chances_one_by_one(random: np.random.Generator) -> Iterator[Chances]:
    """Yield the random numbers of one sample after another, without end."""
    while True:
        block = draw_chances(random, _BLOCK)
        yield from map(Chances, *(np.asarray(column).tolist() for column in block))
