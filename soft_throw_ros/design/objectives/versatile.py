# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The objective `versatile`: the most energy in the worst of several throws."""

from __future__ import annotations

from dataclasses import dataclass
import itertools
from typing import ClassVar

import numpy as np
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.objective import Objective
from soft_throw_ros.design.uncertainty import Variants

MAX_VALUES = 16
"""Largest number of masses, and of frequencies, of a versatile layer."""


@dataclass(frozen=True, kw_only=True)
class Versatile(Objective):
    """
    The most energy in the worst of several throws with one layer.

    Parameters
    ----------
    masses : tuple of float
        Masses of the projectiles, at most `MAX_VALUES`. [kg]
    frequencies : tuple of float
        Frequencies of the plate, at most `MAX_VALUES`; all are combined with all masses. [Hz]

    Raises
    ------
    ValueError
        If there is none of either, or too many, or one is not finite and positive.

    Notes
    -----
    Amplitude and damping of the plate, and the layer's loss tangent, are those of the rig at
    every frequency. Limits hold for every throw.

    """

    masses: tuple[float, ...]
    frequencies: tuple[float, ...]
    name: ClassVar[str] = 'versatile'

    def __post_init__(self) -> None:
        for name, values in vars(self).items():
            if not 1 <= len(values) <= MAX_VALUES:
                raise ValueError(
                    f'{name} must be 1 to {MAX_VALUES} numbers, got {len(values)}: '
                    f'{", ".join(f"{value:g}" for value in values)}'
                )
            for value in values:
                checks.require_positive(name, value)

    @classmethod
    def from_settings(cls, settings: Settings) -> Versatile:
        """Return the objective with `recommendation.masses` and `recommendation.frequencies`."""
        return cls(
            masses=settings['recommendation.masses'],
            frequencies=settings['recommendation.frequencies'],
        )

    def variants(self, rig: Rig) -> Variants:
        """Return the throw of each projectile with each frequency."""
        pairs = itertools.product(self.masses, self.frequencies)
        mass, frequency = np.array(list(pairs), dtype=np.float64).T
        others = (np.broadcast_to(item, mass.shape) for item in Variants.of(rig)[2:])
        return Variants(mass, frequency, *others)
