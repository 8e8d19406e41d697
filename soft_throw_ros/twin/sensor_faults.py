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
"""
What sensors of plate and projectile get wrong.

The node `rig` asks sample by sample, the trials ask for whole throws: all that is done here takes
numbers and arrays alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from soft_throw_ros.core import checks

Numbers: TypeAlias = Any
"""A float or an array: what is done here serves both, for which there is no type."""
Flags: TypeAlias = Any
"""A bool, or an array of them."""

_SMALLEST_OUTLIER = 0.1  # of the largest
_DRIFT_TURNS = 1.0  # after which drift turns round [s]
_BLOCK = 4096  # random numbers that are drawn at a time


class Chances(NamedTuple):
    """
    Random numbers of one sample, or arrays of those of many.

    `jitter`, `stamp` and the outliers' sizes are even in [-1, 1], the other chances even in
    [0, 1), and noise is normal.
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


class Sample(NamedTuple):
    """What is measured: the stamp [s], heights [m], and whether anybody hears of it."""

    stamp: Numbers
    plate: Numbers
    projectile: Numbers
    is_seen: Flags


@dataclass(frozen=True, kw_only=True)
class SensorFaults:
    """
    What sensors get wrong; by default nothing but noise.

    Parameters
    ----------
    noise : float
        Standard deviation of heights. [m]
    jitter : float
        Largest deviation of the time of a sample, which its stamp tells. [s]
    stamp_error : float
        Largest deviation of a stamp from the time of its sample. [s]
    outlier_rate : float
        Share of the heights that are far off. [-]
    outlier_size : float
        How far at most; at least a tenth of that. [m]
    drift : float
        Of both heights; after a second it turns round. [m/s]
    projectile_delay : float
        By which the projectile's heights are older than their stamps. [s]
    projectile_scale : float
        Heights of the projectile that are told, over those that are true. [-]
    missing_rate : float
        Share of the samples that are lost. [-]
    rounding : float
        Step to which heights are rounded; 0 for none. [m]

    Raises
    ------
    ValueError
        If a value is not finite, or negative where it must not be.

    """

    noise: float = 0.0
    jitter: float = 0.0
    stamp_error: float = 0.0
    outlier_rate: float = 0.0
    outlier_size: float = 0.0
    drift: float = 0.0
    projectile_delay: float = 0.0
    projectile_scale: float = 1.0
    missing_rate: float = 0.0
    rounding: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            is_signed = field.name in ('drift', 'projectile_delay')
            check = checks.require_finite if is_signed else checks.require_not_negative
            object.__setattr__(self, field.name, check(field.name, getattr(self, field.name)))

    def measure(
        self,
        time: Numbers,
        plate: Callable[[Numbers], Numbers],
        projectile: Callable[[Numbers], Numbers],
        chances: Chances,
    ) -> Sample:
        """
        Measure both bodies.

        Parameters
        ----------
        time : float or ndarray, shape (n,)
            At which samples are due. [s]
        plate, projectile : callable
            True heights [m] at times [s].
        chances : Chances
            Of as many samples.

        """
        seen = time + self.jitter * chances.jitter
        drift = self.drift * (_DRIFT_TURNS - abs(seen % (2.0 * _DRIFT_TURNS) - _DRIFT_TURNS))
        heights = plate(seen), self.projectile_scale * projectile(seen - self.projectile_delay)
        stamp = seen + self.stamp_error * chances.stamp
        return Sample(
            stamp,
            self._look(heights[0] + drift, *chances[3:6]),
            self._look(heights[1] + drift, *chances[6:9]),
            chances.missing >= self.missing_rate,
        )

    def _look(self, height: Numbers, noise: Numbers, outlier: Numbers, size: Numbers) -> Numbers:
        """Add noise and outliers, and round."""
        measured = height + self.noise * noise
        return self._round(measured + (outlier < self.outlier_rate) * self._outlier(size))

    def _outlier(self, size: Numbers) -> Numbers:
        """Stretch what is even in [-1, 1] to outliers of either sign, none of them small."""
        part = _SMALLEST_OUTLIER + (1.0 - _SMALLEST_OUTLIER) * abs(size)
        if isinstance(part, float):
            return math.copysign(self.outlier_size * part, size)
        return np.copysign(self.outlier_size * part, size)

    def _round(self, height: Numbers) -> Numbers:
        """Round to the next step."""
        if self.rounding == 0.0:
            return height
        steps = height / self.rounding
        rounded = round(steps) if isinstance(steps, float) else np.rint(steps)
        return rounded * self.rounding


def draw_chances(random: np.random.Generator, samples: int) -> Chances:
    """Draw the random numbers of so many samples."""
    jitter, stamp, plate_size, projectile_size = random.uniform(-1.0, 1.0, (4, samples))
    missing, plate_outlier, projectile_outlier = random.uniform(size=(3, samples))
    plate_noise, projectile_noise = random.standard_normal((2, samples))
    return Chances(
        jitter, stamp, missing,
        plate_noise, plate_outlier, plate_size,
        projectile_noise, projectile_outlier, projectile_size,
    )


def chances_one_by_one(random: np.random.Generator) -> Iterator[Chances]:
    """Yield the random numbers of sample after sample, again and again."""
    while True:
        block = draw_chances(random, _BLOCK)
        yield from map(Chances, *(np.asarray(each).tolist() for each in block))
