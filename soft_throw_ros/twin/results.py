# SPDX-License-Identifier: Apache-2.0
"""What comes out of a throw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig

Floats = NDArray[np.float64]


class Phase(str, Enum):
    """What the rig is doing."""

    REST = 'rest'
    CONTACT = 'contact'
    FLIGHT = 'flight'
    LANDED = 'landed'
    RETURNING = 'returning'


class State(NamedTuple):
    """Where plate and projectile are, z up from the plate's rest position."""

    plate_position: float
    projectile_position: float
    plate_velocity: float
    projectile_velocity: float
    plate_force: float
    projectile_force: float


class Event(NamedTuple):
    """
    The projectile left the layer, or came down on it.

    `kind` is 'release' or 'landing'; `time` counts from the start of the throw. [s]
    """

    kind: str
    time: float
    velocity: float


class Field(NamedTuple):
    """Strain [-] and velocity [m/s] of the layer, from plate to top."""

    strain: Floats
    velocity: Floats


class ThrowField(NamedTuple):
    """Strain of the layer over time and height: a row for each of `times`. [s], [-]"""

    times: Floats
    strain: Floats


@dataclass(frozen=True, kw_only=True)
class Release:
    r"""
    How the projectile left.

    Parameters
    ----------
    time : float
        Ejection time :math:`t_e`, from the start of the throw. [s]
    speed : float
        Ejection speed :math:`V_e`. [m/s]
    energy_transfer : float
        :math:`\\alpha = (V_e / V_p^*)^2`. [-]

    """

    time: float
    speed: float
    energy_transfer: float

    @classmethod
    def of(cls, *, time: float, speed: float, peak_plate_speed: float) -> Release:
        """Make it from the two speeds whose ratio counts."""
        return cls(time=time, speed=speed, energy_transfer=(speed / peak_plate_speed) ** 2)


@dataclass(frozen=True, kw_only=True)
class ThrowResult:
    """
    What a throw gave, so far or in the end.

    Parameters
    ----------
    throw : int
        Number of the throw, from 1.
    step : int
        At which it is reported.
    stage : {'release', 'final'}
        After the first release, or when the throw is over.
    ended_by : str
        Why a throw is over: 'rest', 'max_events', 'period', 'duration' or 'reset'.
    rig : Rig
        What threw.
    first, last : Release or None
        Of the ejection: before the projectile falls back. None while it has not left.
    peak_plate_speed : float
        :math:`V_p^*`. [m/s]
    peak_strain : float
        Largest magnitude of the strain so far, anywhere in the layer. [-]
    max_strain : float
        Where the linear range ends. [-]
    peak_acceleration : float
        Largest acceleration of the projectile so far. [m/s2]
    peak_force : float
        Largest force of the layer on the plate so far, as a magnitude. [N]
    plate_work : float
        Largest work that the plate has done so far, which the engine has to hand out. [J]
    apex_height : float
        Highest point of the projectile's lower face, above where it rested; infinite without
        gravity. [m]
    recontacts : int
        How often the layer caught up with the projectile between first and last release.
    landings : int
        How often they met again in all.
    models : mapping of str to Release or None
        The first release as other models of the layer predict it.

    """

    throw: int
    step: int
    stage: str
    ended_by: str
    rig: Rig
    first: Release | None
    last: Release | None
    peak_plate_speed: float
    peak_strain: float
    max_strain: float
    peak_acceleration: float
    peak_force: float
    plate_work: float
    apex_height: float
    recontacts: int
    landings: int
    models: Mapping[str, Release | None]

    @property
    def is_linear(self) -> bool:
        """Whether the layer stayed in its linear range."""
        return self.peak_strain <= self.max_strain

    def sentence(self) -> str:
        """Say it for people to read."""
        if self.first is None:
            return f'throw {self.throw}: the projectile has not left the layer'
        text = (
            f'throw {self.throw}: left after {1e3 * self.first.time:.3f} ms '
            f'at {self.first.speed:.4f} m/s, alpha {self.first.energy_transfer:.3f}'
        )
        if self.last is not None and self.recontacts:
            text += f', after {self.recontacts} re-contacts {self.last.energy_transfer:.3f}'
        if not self.is_linear:
            strain, limit = 100.0 * self.peak_strain, 100.0 * self.max_strain
            text += f'; strain {strain:.1f} % is beyond the linear {limit:.3g} %'
        return text


class Outputs(NamedTuple):
    """
    What one step gives.

    Parameters
    ----------
    step : int
        Its number.
    throw : int
        How many throws have started.
    state : State
        At the end of the step.
    phases : tuple of Phase
        Phases entered in this step.
    events : tuple of Event
        Releases and landings in this step.
    results : tuple of ThrowResult
        Of the throw under way, or just over.
    field : Field or None
        At `rate.field`.
    throw_field : ThrowField or None
        Once per throw.

    """

    step: int
    throw: int
    state: State
    phases: tuple[Phase, ...] = ()
    events: tuple[Event, ...] = ()
    results: tuple[ThrowResult, ...] = ()
    field: Field | None = None
    throw_field: ThrowField | None = None
