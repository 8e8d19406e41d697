# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Objectives of a search, limits of layers and throws, and the score of a layer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core import checks
from soft_throw_ros.core.batch import Cancelled
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import throw_many
from soft_throw_ros.design.maximise import Box
from soft_throw_ros.design.prediction import changes_of, CORNERS, Uncertainties, variant_of

Floats = NDArray[np.float64]

Objective: TypeAlias = Callable[[Rig], Floats]
"""The throws of a rig that score its layer, as variants; the lowest energy transfer counts."""

# Throws of a layer in stages; a layer that is worse than another is not computed to the end
_STAGES = (slice(0, 1), slice(1, 5), slice(5, None))


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a layer and of its throws."""

    thickness_min: float = 1e-3  # [m]
    thickness_max: float = 50e-3  # [m]
    wave_speed_min: float = 1.0  # [m/s]
    wave_speed_max: float = 50.0  # [m/s]
    max_strain: float = math.inf  # largest magnitude anywhere in the layer [-]
    max_acceleration: float = math.inf  # of the projectile, largest magnitude [m/s2]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value != math.inf or name.startswith(('thickness', 'wave_speed')):
                checks.require_all(name, value, 'positive')
        for name, (low, high) in self.box._asdict().items():
            if low >= high:
                raise ValueError(f'{name}_min must be below {name}_max, got {low:g} and {high:g}')

    @classmethod
    def from_settings(cls, settings: Settings) -> Limits:
        """Return the limits that the settings of the twin set; 0 is none."""
        values = {item.name: settings[f'recommendation.{item.name}'] for item in fields(cls)}
        return cls(**{name: value or math.inf for name, value in values.items()})

    @property
    def box(self) -> Box:
        """Layers within the limits."""
        thickness = self.thickness_min, self.thickness_max
        return Box(thickness, (self.wave_speed_min, self.wave_speed_max))


def peak(rig: Rig) -> Floats:
    """Return the throw of a rig itself: the most energy from one throw."""
    return variant_of(rig)


def robust(rig: Rig, *, uncertainties: Uncertainties | None = None) -> Floats:
    """
    Return the throws at the corners of the uncertainties: the most energy in the worst case.

    The uncertainties are those of the paper if not given. A layer that could be off by its whole
    thickness or wave speed throws nothing.
    """
    return (uncertainties or Uncertainties()).variants(rig, CORNERS)


def versatile(rig: Rig, *, masses: Sequence[float], frequencies: Sequence[float]) -> Floats:
    """
    Return the throws of each mass [kg] at each frequency [Hz]: the most energy in the worst.

    Amplitude and damping of the plate, and the layer's loss tangent, are those of the rig at
    every frequency.
    """
    grid = np.meshgrid(
        checks.require_all('masses', masses, 'positive'),
        checks.require_all('frequencies', frequencies, 'positive'),
    )
    variants = np.repeat(variant_of(rig), grid[0].size, axis=0)
    variants[:, 2:4] = np.transpose([values.ravel() for values in grid])
    return variants


@dataclass(eq=False)
class Score:
    """
    Scores of layers for an objective: the function that `maximise` maximises.

    Each call sets thickness and wave speed of the layer of the rig. Limits of the loads hold for
    every throw that counts; the search itself keeps those of thickness and wave speed. `cells` and
    `cancelled` are arguments of `throw_many`.
    """

    rig: Rig
    objective: Objective
    limits: Limits = Limits()
    cells: int | None = None
    cancelled: Cancelled | None = None

    def __post_init__(self) -> None:
        self._variants = self.objective(self.rig)
        self._order = np.arange(len(self._variants))

    def __call__(
        self,
        thickness: ArrayLike,
        wave_speed: ArrayLike,
        needed: ArrayLike = 0.0,
        stages: int = len(_STAGES),
    ) -> Floats:
        """
        Compute the lowest energy transfer of the throws that count, shape (n,).

        It is 0 for layers that throw nothing or exceed a limit. Where it is below `needed`, it may
        be any number between them, because some throws of a layer are enough. Fewer stages give an
        upper bound from the throws that are most often the worst.
        """
        thickness, wave_speed = np.broadcast_arrays(*np.atleast_1d(thickness, wave_speed))
        scores = np.full(thickness.shape, math.inf)
        for numbers in map(self._order.__getitem__, _STAGES[:stages]):
            rows = np.flatnonzero(scores >= needed)
            if numbers.size and rows.size:
                transfers = self._transfers(thickness[rows], wave_speed[rows], numbers)
                scores[rows] = np.minimum(scores[rows], transfers.min(axis=1))
        if stages == len(_STAGES) and numbers.size and rows.size:
            # begin with the most frequent worst throw the next time
            worst = np.bincount(numbers[transfers.argmin(axis=1)], minlength=self._order.size)
            self._order = self._order[np.argsort(-worst[self._order], kind='stable')]
        return scores

    def _transfers(
        self, thickness: Floats, wave_speed: Floats, numbers: NDArray[np.intp]
    ) -> Floats:
        """Return the energy transfers of some throws of each layer, 0 beyond a limit [-]."""
        limits = self.limits
        has_limits = min(limits.max_strain, limits.max_acceleration) < math.inf
        changes = changes_of(self._variants[numbers], thickness[:, None], wave_speed[:, None])
        throws = throw_many(
            self.rig, changes, loads=has_limits, cells=self.cells, cancelled=self.cancelled
        )
        transfers: Floats = np.nan_to_num(throws.energy_transfer)
        if has_limits:
            is_within = throws.peak_strain <= limits.max_strain
            is_within &= throws.peak_acceleration <= limits.max_acceleration
            transfers[~is_within] = 0.0
        return transfers
