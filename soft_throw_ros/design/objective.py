# SPDX-License-Identifier: Apache-2.0
"""What a layer is to be good at, and within which limits."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
import itertools
import math
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.search import one_throw, Problem
from soft_throw_ros.design.uncertainty import even_offsets, Uncertainties

Floats = NDArray[np.float64]

_INSIDE = 31  # throws between the corners of what is uncertain
_SAMPLE = 127  # throws from which a quantile is taken


@dataclass(frozen=True, kw_only=True)
class Limits:
    """
    What a layer, and a throw from it, must not exceed.

    Parameters
    ----------
    thickness_min, thickness_max : float
        Of the layer. [m]
    wave_speed_min, wave_speed_max : float
        Of the layer. [m/s]
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
        for item in fields(self):
            value = getattr(self, item.name)
            if value != math.inf or item.name.startswith(('thickness', 'wave_speed')):
                object.__setattr__(self, item.name, checks.positive(item.name, value))
        for name in ('thickness', 'wave_speed'):
            low, high = getattr(self, f'{name}_min'), getattr(self, f'{name}_max')
            if low >= high:
                raise ValueError(f'{name}_min must be below {name}_max, got {low:g} and {high:g}')

    @property
    def thickness(self) -> tuple[float, float]:
        """Smallest and largest. [m]"""
        return self.thickness_min, self.thickness_max

    @property
    def wave_speed(self) -> tuple[float, float]:
        """Smallest and largest. [m/s]"""
        return self.wave_speed_min, self.wave_speed_max


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The most energy from the throw of the rig as it is."""

    name: ClassVar[str] = 'peak'
    words: ClassVar[str] = 'alpha'
    quantile: ClassVar[float] = 0.0

    def throws(self, rig: Rig) -> Floats:
        """Return `Problem.throws`, all to be checked."""
        return one_throw(rig.engine.damping_ratio)

    def checked(self, _throws: Floats) -> int:
        """Return for how many of them the limits hold."""
        return 1


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
        object.__setattr__(self, 'quantile', checks.below_one('quantile', self.quantile))

    @property
    def words(self) -> str:
        """What counts, in words."""
        return f'{100.0 * self.quantile:g} % quantile of alpha' if self.quantile else 'worst alpha'

    def throws(self, rig: Rig) -> Floats:
        """Return `Problem.throws`; the first is that of the rig as it should be."""
        if self.quantile > 0.0:
            offsets = even_offsets(_SAMPLE)
        else:
            corners = np.array(list(itertools.product((-1.0, 1.0), repeat=5)))
            offsets = np.concatenate([np.zeros((1, 5)), corners, even_offsets(_INSIDE + 1)[1:]])
        return self.uncertainties.throws(rig, offsets)

    def checked(self, _throws: Floats) -> int:
        """Return for how many of them the limits hold."""
        return 1


@dataclass(frozen=True, kw_only=True)
class Versatile:
    """
    The most energy in the worst of several throws with one layer.

    Parameters
    ----------
    masses : tuple of float
        Of the projectiles. [kg]
    frequencies : tuple of float
        Of the plate; every projectile is thrown with each. [Hz]

    Raises
    ------
    ValueError
        If there is none of either, or one is not finite and positive.

    Notes
    -----
    Amplitude and damping of the plate, and the layer's loss tangent, are those of the rig at
    every frequency. Limits hold for every throw.

    """

    masses: tuple[float, ...]
    frequencies: tuple[float, ...]
    name: ClassVar[str] = 'versatile'
    words: ClassVar[str] = 'worst alpha'
    quantile: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        for name in ('masses', 'frequencies'):
            values = tuple(checks.positive(name, value) for value in getattr(self, name))
            if not values:
                raise ValueError(f'{name} must be at least one number, got none')
            object.__setattr__(self, name, values)

    def throws(self, rig: Rig) -> Floats:
        """Return `Problem.throws`, all to be checked."""
        return np.array([
            (mass / rig.projectile.mass, frequency / rig.engine.frequency,
             rig.engine.damping_ratio, 0.0, 0.0)
            for mass, frequency in itertools.product(self.masses, self.frequencies)
        ])  # fmt: skip

    def checked(self, throws: Floats) -> int:
        """Return for how many of them the limits hold."""
        return len(throws)


Objective: TypeAlias = Peak | Robust | Versatile


def problem_of(
    rig: Rig, objective: Objective, limits: Limits, *, target_speed: float = 0.0
) -> Problem:
    """
    Put into numbers what is asked of a layer.

    Parameters
    ----------
    rig : Rig
        With the layer that others are compared with.
    objective : Peak, Robust or Versatile
        What the layer is to be good at.
    limits : Limits
        What it must not exceed.
    target_speed : float
        If above 0, the amplitude is not the rig's, but what gives this ejection speed. [m/s]

    Raises
    ------
    ValueError
        If an uncertainty is as large as what is uncertain.

    """
    speed = rig.engine.speed_scale
    throws = objective.throws(rig)
    return Problem(
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        gravity_ratio=rig.gravity_ratio,
        loss_tangent=rig.layer.loss_tangent,
        throws=throws,
        quantile=objective.quantile,
        checked=objective.checked(throws),
        strain=limits.max_strain * rig.layer.wave_speed / speed,
        acceleration=limits.max_acceleration / (speed * rig.engine.angular_frequency),
        target=target_speed / speed,
    )
