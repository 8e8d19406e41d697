# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Objectives of a search, limits of layers and throws, and the score of a layer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core import checks
from soft_throw_ros.core.batch import Cancelled
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import throw_many
from soft_throw_ros.design.uncertainty import CORNERS, Uncertainties, Variants

Floats = NDArray[np.float64]

Objective: TypeAlias = Callable[[Rig], Variants]
"""The throws of a rig that score its layer: the score is their lowest energy transfer."""

_STAGES = (slice(0, 1), slice(1, 5), slice(5, None))
"""Throws of a layer in stages; a layer that is worse than another is not computed to the end."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """
    Limits of a layer and of its throws.

    Parameters
    ----------
    thickness_min, thickness_max, wave_speed_min, wave_speed_max : float
        Range of the layer. [m], [m/s]
    max_strain : float
        Largest magnitude of the strain anywhere in the layer. [-]
    max_acceleration : float
        Largest magnitude of the projectile's acceleration. [m/s2]

    """

    thickness_min: float = 1e-3
    thickness_max: float = 50e-3
    wave_speed_min: float = 1.0
    wave_speed_max: float = 50.0
    max_strain: float = math.inf
    max_acceleration: float = math.inf

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value != math.inf or name.startswith(('thickness', 'wave_speed')):
                checks.require_positive(name, value)
        for name in ('thickness', 'wave_speed'):
            low, high = getattr(self, name)
            if low >= high:
                raise ValueError(f'{name}_min must be below {name}_max, got {low:g} and {high:g}')

    @property
    def thickness(self) -> tuple[float, float]:
        """Smallest and largest [m]."""
        return self.thickness_min, self.thickness_max

    @property
    def wave_speed(self) -> tuple[float, float]:
        """Smallest and largest [m/s]."""
        return self.wave_speed_min, self.wave_speed_max

    @property
    def of_loads(self) -> bool:
        """Whether strain or acceleration is limited."""
        return min(self.max_strain, self.max_acceleration) < math.inf


def peak(rig: Rig) -> Variants:
    """Return the throw of a rig itself: the most energy from one throw."""
    return Variants.of(rig)


def robust(rig: Rig, *, uncertainties: Uncertainties | None = None) -> Variants:
    """
    Return the throws at the corners of the uncertainties: the most energy in the worst case.

    The uncertainties are those of the paper if not given. A layer that could be off by its whole
    thickness or wave speed throws nothing.
    """
    return (uncertainties or Uncertainties()).variants(rig, CORNERS)


def versatile(
    rig: Rig, *, masses: Sequence[float], frequencies: Sequence[float]
) -> Variants:
    """
    Return the throws of each mass [kg] at each frequency [Hz]: the most energy in the worst.

    Amplitude and damping of the plate, and the layer's loss tangent, are those of the rig at
    every frequency.
    """
    mass, frequency = (
        values.ravel()
        for values in np.meshgrid(
            checks.require_all('masses', masses, 'positive'),
            checks.require_all('frequencies', frequencies, 'positive'),
        )
    )
    others = (np.broadcast_to(item, mass.shape) for item in Variants.of(rig)[2:])
    return Variants(mass, frequency, *others)


OBJECTIVES: Mapping[str, Callable[[Settings], Objective]] = {
    'peak': lambda _: peak,
    'robust': lambda settings: partial(
        robust, uncertainties=Uncertainties.from_settings(settings)
    ),
    'versatile': lambda settings: partial(
        versatile,
        masses=settings['recommendation.masses'],
        frequencies=settings['recommendation.frequencies'],
    ),
}
"""Objectives by the value of `recommendation.objective`, made from the settings of the twin."""


class Score:
    """
    Scores of layers for an objective: the function that `maximise` maximises.

    Parameters
    ----------
    rig : Rig
        The rig; each call sets thickness and wave speed of its layer.
    objective : Objective
        The throws that count.
    limits : Limits, optional
        Limits of the loads, which hold for every throw that counts; the search itself keeps
        those of thickness and wave speed.
    uncertainties : Uncertainties, optional
        Errors at whose corners the projectile has to leave, too.
    cells, cancelled : optional
        Arguments of `throw_many`.

    """

    def __init__(
        self,
        rig: Rig,
        objective: Objective,
        limits: Limits | None = None,
        *,
        uncertainties: Uncertainties | None = None,
        cells: int | None = None,
        cancelled: Cancelled | None = None,
    ) -> None:
        self._rig = rig
        self._limits = limits or Limits()
        self._cells = cells
        self._cancelled = cancelled
        self._variants = objective(rig)
        self._counted = self._variants.mass.size
        if uncertainties is not None:
            others = uncertainties.variants(rig, CORNERS)
            pairs = zip(self._variants, others, strict=True)
            self._variants = Variants(*map(np.concatenate, pairs))
        self._order = np.arange(self._variants.mass.size)

    def __call__(
        self, thickness: ArrayLike, wave_speed: ArrayLike, needed: ArrayLike = 0.0
    ) -> Floats:
        """
        Compute the lowest energy transfer of the throws that count.

        Parameters
        ----------
        thickness, wave_speed : array_like, shape (n,)
            Thicknesses and wave speeds of the layers. [m], [m/s]
        needed : array_like, shape (n,)
            Scores below which a layer does not matter, so that some throws are enough. [-]

        Returns
        -------
        ndarray, shape (n,)
            0 for layers that throw nothing or exceed a limit; where the score is below `needed`,
            any number between them. [-]

        """
        thickness, wave_speed = np.broadcast_arrays(*np.atleast_1d(thickness, wave_speed))
        scores = np.full(thickness.shape, math.inf)
        for variants in map(self._order.__getitem__, _STAGES):
            rows = np.flatnonzero(scores >= needed)
            if variants.size and rows.size:
                transfers = self._transfers(thickness[rows], wave_speed[rows], variants)
                scores[rows] = np.minimum(scores[rows], transfers.min(axis=1))
        if variants.size and rows.size:  # begin with the throw that is most often the worst
            worst = np.bincount(variants[transfers.argmin(axis=1)], minlength=self._order.size)
            self._order = self._order[np.argsort(-worst[self._order], kind='stable')]
        return scores

    def _transfers(
        self, thickness: Floats, wave_speed: Floats, variants: NDArray[np.intp]
    ) -> Floats:
        """Return the energy transfers of some throws of each layer, 0 beyond a limit [-]."""
        limits, chosen = self._limits, Variants(*(item[variants] for item in self._variants))
        throws = throw_many(
            self._rig, chosen.changes(thickness[:, None], wave_speed[:, None]),
            loads=limits.of_loads, cells=self._cells, cancelled=self._cancelled,
        )
        transfers: Floats = np.nan_to_num(throws.energy_transfer)
        is_counted = variants < self._counted
        if limits.of_loads:
            is_within = throws.peak_strain <= limits.max_strain
            is_within &= throws.peak_acceleration <= limits.max_acceleration
            transfers[is_counted & ~is_within] = 0.0
        transfers[~is_counted & (transfers > 0.0)] = math.inf
        return transfers
