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

The node `rig` measures sample by sample, the trials whole throws: all that is done here takes
numbers and arrays alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from soft_throw_ros.core import checks

Numbers: TypeAlias = Any
"""A float or an array: what is done here serves both, for which there is no type."""

_SMALLEST_OUTLIER = 0.1  # of the largest
_DRIFT_TURNS = 1.0  # after which drift turns round [s]


class Sample(NamedTuple):
    """What is measured: the stamp [s], heights [m], and whether anybody hears of it."""

    stamp: Numbers
    plate: Numbers
    projectile: Numbers
    is_seen: Numbers


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
        random: np.random.Generator,
    ) -> Sample:
        """
        Measure both bodies.

        Parameters
        ----------
        time : float or ndarray, shape (n,)
            At which samples are due. [s]
        plate, projectile : callable
            True heights [m] at times [s].
        random : Generator
            Chances are drawn from it.

        """
        size = np.shape(time) or None  # None draws a number
        seen = time + self.jitter * random.uniform(-1.0, 1.0, size)
        drift = self.drift * (_DRIFT_TURNS - abs(seen % (2.0 * _DRIFT_TURNS) - _DRIFT_TURNS))
        higher = self.projectile_scale * projectile(seen - self.projectile_delay)
        return Sample(
            stamp=seen + self.stamp_error * random.uniform(-1.0, 1.0, size),
            plate=self._look(plate(seen) + drift, random, size),
            projectile=self._look(higher + drift, random, size),
            is_seen=random.random(size) >= self.missing_rate,
        )

    def _look(
        self, height: Numbers, random: np.random.Generator, size: tuple[int, ...] | None
    ) -> Numbers:
        """Add noise, and outliers of either sign, none of them small; and round."""
        part = random.uniform(-1.0, 1.0, size)
        outlier = np.copysign(_SMALLEST_OUTLIER + (1.0 - _SMALLEST_OUTLIER) * abs(part), part)
        is_outlier = random.random(size) < self.outlier_rate
        measured = height + self.noise * random.standard_normal(size)
        measured = measured + is_outlier * self.outlier_size * outlier
        return np.rint(measured / self.rounding) * self.rounding if self.rounding else measured
