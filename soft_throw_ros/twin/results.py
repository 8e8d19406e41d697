# SPDX-License-Identifier: Apache-2.0
"""What comes out of a throw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event

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


class LayerState(NamedTuple):
    """
    The layer, from plate to top.

    `height` [m], `velocity` [m/s], and the `force` through each height, of what is below on what
    is above, z up [N]: each of shape (points,).
    """

    height: Floats
    velocity: Floats
    force: Floats


class ThrowField(NamedTuple):
    """
    Strain of the layer over time and height.

    Attributes
    ----------
    times : ndarray, shape (rows,)
        Since the start of the throw. [s]
    strain : ndarray, shape (rows, points)
        From plate to top. [-]
    checksum : int
        CRC-32 of the two.
    start_ns : int
        When the throw began, by the clock of the ticks. [ns]

    """

    times: Floats
    strain: Floats
    checksum: int
    start_ns: int = 0

    @classmethod
    def of(cls, times: Floats, strain: Floats, *, start_ns: int = 0) -> ThrowField:
        """Make it with its checksum, which takes a tenth of a millisecond."""
        return cls(times, strain, crc32(strain.data, crc32(times.data)), start_ns)


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
class Comparison:
    """
    A throw by the model against what was measured, until a plate period after the release.

    Parameters
    ----------
    samples : int
        Of the projectile, that were compared.
    position_rms, position_max : float
        Of the differences of its position. [m]
    threshold : float
        Within which the former should be. [m]
    ejection_time_error : float or None
        How much later it passes the height of its release by the model than measured; None if it
        was not followed long enough. [s]
    ejection_speed_error : float or None
        How much faster it is there by the model. [m/s]

    """

    samples: int
    position_rms: float
    position_max: float
    threshold: float
    ejection_time_error: float | None = None
    ejection_speed_error: float | None = None

    @property
    def is_within_threshold(self) -> bool:
        """Whether the model is as good as it should be."""
        return self.position_rms <= self.threshold

    def describe(self) -> str:
        """Say it for people to read."""
        rms, threshold = 1e6 * self.position_rms, 1e6 * self.threshold
        if self.is_within_threshold:
            return f'the projectile went as by the model, to {rms:.3g} um rms'
        return (
            f'the projectile was {rms:.3g} um rms off the model, beyond measured.band '
            f'{threshold:.3g} um: the layer has aged or slipped, or the parameters are wrong'
        )


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
    stage : {'predicted', 'release', 'final'}
        When the first release of a measured plate is known beforehand, after it, or when the
        throw is over.
    ended_by : str
        Why a throw is over: 'rest', 'max_events', 'period', 'duration' or 'reset', and with a
        measured plate 'gap', or 'next' if it jumps again.
    rig : Rig
        What threw.
    first, last : Release or None
        Of the ejection: before the projectile falls back. None while it has not left.
    peak_plate_speed : float
        :math:`V_p^*`. [m/s]
    peak_strain : float
        Largest magnitude of the strain anywhere in the layer, up to the first release like all
        loads; so far, while it has not come. [-]
    max_strain : float
        Where the linear range ends. [-]
    peak_acceleration : float
        Largest acceleration of the projectile. [m/s2]
    peak_force : float
        Largest force of the layer on the plate, as a magnitude. [N]
    plate_work : float
        Work of the plate. [J]
    apex_height : float
        How high the projectile's lower face rises after the last ejection, above the plate's rest
        position; infinite without gravity. [m]
    recontacts : int
        How often the layer caught up with the projectile before that had fallen back.
    landings : int
        How often it came down on the layer.
    models : mapping of str to Release or None
        The first release as other models of the layer predict it.
    lead : float or None
        With a measured plate, how long before the first release it was known. [s]
    comparison : Comparison or None
        With what was measured of the projectile, if it was.

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
    lead: float | None = None
    comparison: Comparison | None = None

    @property
    def is_valid(self) -> bool:
        """Whether the plate was known all the time."""
        return self.ended_by != 'gap'

    @property
    def is_ahead(self) -> bool:
        """Whether the release was known before it came."""
        return self.lead is not None and self.lead > 0.0

    @property
    def is_linear(self) -> bool:
        """Whether the layer stayed in its linear range."""
        return self.peak_strain <= self.max_strain

    def describe(self) -> str:
        """Say it for people to read."""
        if not self.is_valid:
            return f'throw {self.throw} is invalid: the plate was not measured for too long'
        if self.first is None:
            return f'throw {self.throw}: the projectile has not left the layer'
        verb = 'will leave' if self.stage == 'predicted' else 'left'
        text = (
            f'throw {self.throw}: {verb} after {1e3 * self.first.time:.3f} ms '
            f'at {self.first.speed:.4f} m/s, alpha {self.first.energy_transfer:.3f}'
        )
        if self.last is not None and self.recontacts:
            text += f', after {self.recontacts} re-contacts {self.last.energy_transfer:.3f}'
        if not self.is_linear:
            strain, limit = 100.0 * self.peak_strain, 100.0 * self.max_strain
            text += f'; strain {strain:.1f} % is beyond the linear {limit:.3g} %'
        return text

    def describe_lead(self) -> str:
        """Say how long before the release that was known, if it was predicted."""
        lead = 1e3 * (self.lead or 0.0)
        return f'known {lead:.2f} ms before' if self.is_ahead else f'known {-lead:.2f} ms too late'


class Prediction(NamedTuple):
    """
    The projectile, as far ahead as it is known.

    `stamp_ns` is the time of it, `lead_ns` how far that is ahead of the step. [ns]
    """

    stamp_ns: int
    position: float
    velocity: float
    force: float
    lead_ns: int


class Residual(NamedTuple):
    """Positions of plate and projectile by the model less those measured, at a stamp. [m]"""

    stamp_ns: int
    plate: float
    projectile: float


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
        Releases, re-contacts and landings in this step.
    results : tuple of ThrowResult
        Of the throw under way, or just over.
    layer : LayerState or None
        At `rate.field`.
    throw_field : ThrowField or None
        Once per throw.
    prediction : Prediction or None
        In a throw of a measured plate.
    residual : Residual or None
        When the projectile has been measured, too.
    notices : tuple of str
        What is to be said about the measurement.

    """

    step: int
    throw: int
    state: State
    phases: tuple[Phase, ...] = ()
    events: tuple[Event, ...] = ()
    results: tuple[ThrowResult, ...] = ()
    layer: LayerState | None = None
    throw_field: ThrowField | None = None
    prediction: Prediction | None = None
    residual: Residual | None = None
    notices: tuple[str, ...] = ()
