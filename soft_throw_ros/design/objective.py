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
"""What a layer is to be good at, within which limits, and how good it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import itertools
import math
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.evaluate import Cancelled, first_throws, highest_transfers, Throws
from soft_throw_ros.design.uncertainty import even_offsets, Uncertainties, Variants

Floats = NDArray[np.float64]

MAX_VALUES = 16
"""Masses, and frequencies, that a versatile layer may be for."""

_INSIDE = 31  # throws between the corners of what is uncertain
_SAMPLE = 61  # throws from which a quantile is taken
_STAGES = (1, 4, 12)  # so many throws of a layer are computed before the others


@dataclass(frozen=True, kw_only=True)
class Limits:
    """
    What a layer, and a throw from it, must not exceed.

    Parameters
    ----------
    thickness_min, thickness_max, wave_speed_min, wave_speed_max : float
        Of the layer. [m], [m/s]
    max_strain : float
        Largest magnitude of the strain anywhere in the layer. [-]
    max_acceleration : float
        Largest magnitude of the projectile's acceleration. [m/s2]
    max_loss_tangent : float
        Of a material that is picked. [-]

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


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The most energy from the throw of the rig as it is."""

    name: ClassVar[str] = 'peak'
    summary: ClassVar[str] = 'alpha'
    quantile: ClassVar[float] = 0.0

    def variants(self, rig: Rig) -> Variants:
        """Return the throws that count."""
        return Variants.of(rig)


@dataclass(frozen=True, kw_only=True)
class Robust:
    """
    The most energy when the rig is not quite what it should be.

    Parameters
    ----------
    uncertainties : Uncertainties
        How far it may be off.
    quantile : float
        Which of the throws counts: 0 is the worst, 0.05 is worse than 95 % of them. [-]

    Raises
    ------
    ValueError
        If `quantile` is not in [0, 1).

    Notes
    -----
    The worst is looked for at the corners of the uncertainties and at points spread between; a
    quantile is taken of points spread evenly. Limits hold for the rig as it should be. A layer
    that could be off by its whole thickness or wave speed throws nothing.

    """

    uncertainties: Uncertainties = field(default_factory=Uncertainties)
    quantile: float = 0.0
    name: ClassVar[str] = 'robust'

    def __post_init__(self) -> None:
        checks.require_in_unit_interval('quantile', self.quantile)

    @property
    def summary(self) -> str:
        """Say what counts."""
        return f'{100.0 * self.quantile:g} % quantile of alpha' if self.quantile else 'worst alpha'

    def variants(self, rig: Rig) -> Variants:
        """Return the throws that count; the first is that of the rig as it should be."""
        if self.quantile > 0.0:
            offsets = even_offsets(_SAMPLE)
        else:
            # Thickness, wave speed and frequency count by c / (L f) above all, which is farthest
            # off where the frequency is off against the wave speed.
            corners = np.array(list(itertools.product((-1.0, 1.0), repeat=4)))
            corners = np.insert(corners, 3, -corners[:, 0], axis=1)
            offsets = np.concatenate([np.zeros((1, 5)), corners, even_offsets(_INSIDE + 1)[1:]])
        return self.uncertainties.variants(rig, offsets)


@dataclass(frozen=True, kw_only=True)
class Versatile:
    """
    The most energy in the worst of several throws with one layer.

    Parameters
    ----------
    masses : tuple of float
        Of the projectiles, at most `MAX_VALUES`. [kg]
    frequencies : tuple of float
        Of the plate, at most `MAX_VALUES`; every projectile is thrown with each. [Hz]

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
    summary: ClassVar[str] = 'worst alpha'
    quantile: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        for name, values in vars(self).items():
            if not 1 <= len(values) <= MAX_VALUES:
                raise ValueError(
                    f'{name} must be 1 to {MAX_VALUES} numbers, got {len(values)}: '
                    f'{", ".join(f"{value:g}" for value in values)}'
                )
            for value in values:
                checks.require_positive(name, value)

    def variants(self, rig: Rig) -> Variants:
        """Return the throws that count."""
        pairs = itertools.product(self.masses, self.frequencies)
        mass, frequency = np.array(list(pairs), dtype=np.float64).T
        rest = (np.broadcast_to(each, mass.shape) for each in Variants.of(rig)[2:])
        return Variants(mass, frequency, *rest)


Objective: TypeAlias = Peak | Robust | Versatile


class LayerScore:
    """
    How good layers are for an objective: the function that a search makes as large as it can.

    Parameters
    ----------
    rig : Rig
        All but thickness and wave speed of the layer.
    objective : Peak, Robust or Versatile
        What a layer is to be good at.
    limits : Limits, optional
        Of the loads of its throws; where it may lie is for the search.
    cells, cancelled : optional
        As for `first_throws`.

    Raises
    ------
    ValueError
        If an uncertainty is as large as what is uncertain.

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
        self._objective = objective
        self._limits = limits or Limits()
        self._cells = cells
        self._cancelled = cancelled
        self._variants = objective.variants(rig)
        # The lowest throws first, as far as known: most layers are out after a few of them.
        self._order = np.arange(self._variants.mass.size)

    def __call__(
        self,
        thickness: ArrayLike,
        wave_speed: ArrayLike,
        *,
        least: ArrayLike = 0.0,
        mass: ArrayLike = 1.0,
        frequency: ArrayLike = 1.0,
        damping_ratio: ArrayLike = 1.0,
    ) -> Floats:
        """
        Compute the energy transfers that count.

        Parameters
        ----------
        thickness, wave_speed : array_like, shape (n,)
            Of the layers. [m], [m/s]
        least : array_like
            What is below this need not be known: it becomes 0. [-]
        mass, frequency, damping_ratio : array_like
            What every throw's are multiplied by. [-]

        Returns
        -------
        ndarray, shape (n,)
            0 for layers that throw nothing or exceed a limit. [-]

        Raises
        ------
        SearchCancelledError
            If `cancelled` says so.

        """
        given = (thickness, wave_speed, least, mass, frequency, damping_ratio)
        thickness, wave_speed, least, mass, frequency, damping_ratio = (
            np.asarray(column, dtype=np.float64)[:, None]
            for column in np.broadcast_arrays(*map(np.atleast_1d, given))
        )
        variants = self._variants._replace(
            mass=mass * self._variants.mass,
            frequency=frequency * self._variants.frequency,
            damping_ratio=np.minimum(damping_ratio * self._variants.damping_ratio, 0.999),
        )
        changes = variants.changes(thickness, wave_speed)
        count, size = np.broadcast_shapes(*(each.shape for each in changes.values()))
        changes = {name: np.broadcast_to(each, (count, size)) for name, each in changes.items()}
        # A layer is out as soon as more of its throws are too low than the quantile leaves aside.
        spare = math.ceil(self._objective.quantile * (size - 1))
        transfers = np.full((count, size), math.inf)
        alive = np.arange(count)
        if self.rig.engine.motion is None:
            highest = highest_transfers(self.rig, changes).max(axis=1)
            alive = np.flatnonzero(highest >= least[:, 0])
        stages = sorted({0, *(stage for stage in _STAGES if stage < size), size})
        for start, stop in itertools.pairwise(stages):
            columns = self._order[start:stop]
            found = self._throw(changes, alive, columns).energy_transfer
            transfers[np.ix_(alive, columns)] = np.nan_to_num(found)
            too_low = (transfers[alive] < least[alive]).sum(axis=1)
            alive = alive[too_low <= spare]
        scores = np.zeros(count)
        if alive.size:
            left = transfers[alive]
            scores[alive] = (
                np.quantile(left, self._objective.quantile, axis=1) if spare else left.min(axis=1)
            )
            self._order = left.mean(axis=0).argsort()
        if self._limits.of_loads:
            alive = alive[scores[alive] > 0.0]
            # in all throws, or in the rig's own, the first
            is_for_all = isinstance(self._objective, Versatile)
            throws = self._throw(changes, alive, np.arange(size if is_for_all else 1), loads=True)
            is_within = throws.peak_strain <= self._limits.max_strain
            is_within &= throws.peak_acceleration <= self._limits.max_acceleration
            scores[alive] *= is_within.all(axis=1)
        return scores

    def _throw(
        self,
        changes: Mapping[str, Floats],
        layers: NDArray[np.int64],
        columns: NDArray[np.int64],
        *,
        loads: bool = False,
    ) -> Throws:
        """Compute some of the throws of some of the layers."""
        chosen = np.ix_(layers, columns)
        some = {name: values[chosen] for name, values in changes.items()}
        return first_throws(
            self.rig, some, loads=loads, cells=self._cells, cancelled=self._cancelled
        )
