# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Objectives of a search, limits of layers and throws, and the score of a layer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import Cancelled, throw_many, Throws
from soft_throw_ros.design.uncertainty import Variants

Floats = NDArray[np.float64]


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
    max_loss_tangent : float
        Largest loss tangent of a material of the library. [-]

    Raises
    ------
    ValueError
        If a limit is not positive, or a smallest one is not below the largest.

    """

    thickness_min: float = 1e-3
    thickness_max: float = 50e-3
    wave_speed_min: float = 1.0
    wave_speed_max: float = 50.0
    max_strain: float = math.inf
    max_acceleration: float = math.inf
    max_loss_tangent: float = math.inf

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


class Objective(ABC):
    """
    The throws that score a layer: a subclass in a file of `objectives`, see `OBJECTIVES`.

    The score is the lowest energy transfer of the throws, or a quantile of their transfers.
    """

    name: ClassVar[str]
    """Value of the parameter `recommendation.objective`."""

    quantile: float = 0.0
    """Quantile of the energy transfers that is the score; 0 is the lowest. [-]"""

    limits_hold_for_all: ClassVar[bool] = True
    """Whether limits of the loads hold for all throws, or for the first one."""

    is_fast: ClassVar[bool] = False
    """Whether the score takes one throw, so that alternatives are searched as well."""

    @property
    def summary(self) -> str:
        """Name of the score in texts."""
        return 'worst alpha'

    @classmethod
    @abstractmethod
    def from_settings(cls, settings: Settings) -> Objective:
        """Return the objective that the settings of the twin describe."""

    @abstractmethod
    def variants(self, rig: Rig) -> Variants:
        """Return the throws that count, that of the rig itself first if it is among them."""

    def with_spread(self, _spread: float) -> Objective:
        """Return the objective for a material whose wave speed may be off by a spread [m/s]."""
        return self


class LayerScore:
    """
    Scores of layers for an objective: the function that a search maximises.

    Parameters
    ----------
    rig : Rig
        The rig; each call sets thickness and wave speed of its layer.
    objective : Objective
        Throws to evaluate, and the score that combines them.
    limits : Limits, optional
        Limits of the loads; the search itself keeps those of thickness and wave speed.
    cells, cancelled : optional
        Arguments of `throw_many`.

    Raises
    ------
    ValueError
        If an uncertainty is as large as the uncertain value.

    """

    def __init__(
        self,
        rig: Rig,
        objective: Objective,
        limits: Limits | None = None,
        *,
        cells: int | None = None,
        cancelled: Cancelled | None = None,
    ) -> None:
        self.rig = rig
        self._quantile = objective.quantile
        self._limits = limits or Limits()
        self._cells = cells
        self._cancelled = cancelled
        self._variants = objective.variants(rig)
        self.throws_per_layer = self._variants.mass.size
        self._limited = self.throws_per_layer if objective.limits_hold_for_all else 1

    def __call__(
        self,
        thickness: ArrayLike,
        wave_speed: ArrayLike,
        *,
        mass: ArrayLike = 1.0,
        frequency: ArrayLike = 1.0,
        damping_ratio: ArrayLike = 1.0,
    ) -> Floats:
        """
        Compute the energy transfers that count.

        Parameters
        ----------
        thickness, wave_speed : array_like, shape (n,)
            Thicknesses and wave speeds of the layers. [m], [m/s]
        mass, frequency, damping_ratio : array_like
            Factors of the values of every throw. [-]

        Returns
        -------
        ndarray, shape (n,)
            0 for layers that throw nothing or exceed a limit. [-]

        Raises
        ------
        SearchCancelledError
            If `cancelled` returns True.

        """
        arguments = (thickness, wave_speed, mass, frequency, damping_ratio)
        thickness, wave_speed, mass, frequency, damping_ratio = (
            np.asarray(column, dtype=np.float64)[:, None]
            for column in np.broadcast_arrays(*map(np.atleast_1d, arguments))
        )
        variants = self._variants._replace(
            mass=mass * self._variants.mass,
            frequency=frequency * self._variants.frequency,
            damping_ratio=np.minimum(damping_ratio * self._variants.damping_ratio, 0.999),
        )
        changes = variants.changes(thickness, wave_speed)
        limited = self._throw(changes, slice(self._limited), loads=self._limits.of_loads)
        transfers = limited.energy_transfer
        if self._limited < self.throws_per_layer:
            others = self._throw(changes, slice(self._limited, None))
            transfers = np.hstack([transfers, others.energy_transfer])
        transfers = np.nan_to_num(transfers)
        scores: Floats = transfers.min(axis=1)
        if self._quantile > 0.0:
            scores = np.quantile(transfers, self._quantile, axis=1)
        if self._limits.of_loads:
            is_within = limited.peak_strain <= self._limits.max_strain
            is_within &= limited.peak_acceleration <= self._limits.max_acceleration
            scores *= is_within.all(axis=1)
        return scores

    def _throw(
        self, changes: Mapping[str, Floats], columns: slice, *, loads: bool = False
    ) -> Throws:
        """Compute some of the throws of all layers."""
        some = {name: values[:, columns] for name, values in changes.items()}
        return throw_many(
            self.rig, some, loads=loads, cells=self._cells, cancelled=self._cancelled
        )
