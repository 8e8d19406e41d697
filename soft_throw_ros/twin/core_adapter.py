# SPDX-License-Identifier: Apache-2.0
"""
The steppers of `core` as they are about to be: the twin is written against these names.

This module goes as soon as `core.stepper`, `core.wave_stepper` and `core.cell_stepper` have them.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import grid_stepper, stepper, stepping
from soft_throw_ros.core.finite_difference import first_releases as first_throws
from soft_throw_ros.core.grid_stepper import cells_per_layer, GridStepper
from soft_throw_ros.core.peak import first_peaks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import steps_per_crossing
from soft_throw_ros.core.stepping import (
    EventLimitError,
    FEED_SEGMENTS,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    TIME,
)
from soft_throw_ros.core.travelling_wave import ThrowUnresolvedError

__all__ = [
    'FEED_SEGMENTS', 'PROJECTILE_FORCE', 'PROJECTILE_POSITION', 'PROJECTILE_VELOCITY', 'TIME',
    'Event', 'EventLimitError', 'Loads', 'Stepper', 'apex_height', 'cells_per_layer', 'ejections',
    'first_throws', 'make_stepper', 'steps_per_crossing', 'warm_up',
]  # fmt: skip

Floats = NDArray[np.float64]


class Event(NamedTuple):
    """The projectile left the layer ('release'), was caught up with ('recontact') or came down."""

    kind: Literal['release', 'recontact', 'landing']
    time: float
    position: float
    velocity: float


class Loads(NamedTuple):
    """Largest magnitudes up to the first release."""

    strain: float
    plate_strain: float
    contact_strain: float
    acceleration: float
    plate_force: float


def ejections(events: Sequence[Event]) -> list[Event]:
    """Return the releases before the first landing."""
    found = []
    for event in events:
        if event.kind == 'landing':
            break
        if event.kind == 'release':
            found.append(event)
    return found


def apex_height(event: Event, gravity: float) -> float:
    """Return how high the projectile rises after an event; infinite without gravity. [m]"""
    if gravity == 0.0:
        return math.inf if event.velocity > 0.0 else event.position
    return event.position + 0.5 * max(event.velocity, 0.0) ** 2 / gravity


class Stepper:
    """A stepper of today under the names of tomorrow."""

    def __init__(self, inner: stepping.ThrowStepper, *, peak_strain: float = 0.0) -> None:
        self.inner = inner
        self.rig = inner.rig
        self.reset_state()
        self._peak_strain = peak_strain
        self._strain = np.zeros(inner.field_points)
        self._velocity = np.zeros(inner.field_points)

    def reset_state(self) -> None:
        """Forget what was kept of the events."""
        self._positions: list[float] = []
        self._work: float | None = None

    @property
    def state(self) -> Floats:
        """Time, positions, velocities, forces."""
        return self.inner.state

    def reset(self) -> None:
        """Go back to rest."""
        self.inner.reset()
        self.reset_state()

    def advance_to(self, time: float) -> int:
        """Go on."""
        count = self.inner.advance_to(time)
        if count > len(self._positions):
            self._keep(count)
        return count

    def _keep(self, count: int) -> None:
        """Find the height of the last release from the flight since."""
        inner = self.inner
        if self._work is None:
            self._work = inner.work
        event = inner.events()[-1]
        since = inner.state[TIME] - event.time
        fall = event.velocity * since - 0.5 * self.rig.gravity * since**2
        position = float(inner.state[PROJECTILE_POSITION] - fall)
        if inner.in_contact:
            position = inner.highest_position
        self._positions += [position] * (count - len(self._positions))

    def events(self) -> list[Event]:
        """Return what has happened."""
        return [
            Event(self._kind(event), event.time, position, event.velocity)
            for event, position in zip(self.inner.events(), self._positions, strict=False)
        ]

    def _kind(self, event: stepping.Event) -> Literal['release', 'recontact', 'landing']:
        if event.kind == 'release':
            return 'release'
        falls = event.velocity <= 0.0 and self.rig.gravity > 0.0
        return 'landing' if falls else 'recontact'

    @property
    def event_count(self) -> int:
        """How much has happened."""
        return self.inner.event_count

    @property
    def in_contact(self) -> bool:
        """Whether the projectile lies on the layer."""
        return self.inner.in_contact

    @property
    def horizon(self) -> float:
        """Until when the plate is known. [s]"""
        return self.inner.horizon

    @property
    def loads(self) -> Loads:
        """Largest magnitudes up to the first release."""
        peaks, inner = self.inner.first_peaks, self.inner
        strain = max(peaks.plate_strain, peaks.contact_strain)
        if inner.event_count:
            within = inner.first_peak_strain if isinstance(inner, GridStepper) else 0.0
            strain = max(strain, within, self._peak_strain)
        return Loads(strain, *peaks)

    @property
    def plate_work(self) -> float:
        """Work of the plate up to the first release. [J]"""
        return self.inner.work if self._work is None else self._work

    def append_plate_states(self, times: ArrayLike, states: ArrayLike) -> None:
        """Take in states of the plate."""
        self.inner.feed_states(times, states)

    def fork(self) -> Stepper:
        """Make a stepper that can go ahead."""
        return Stepper(self.inner.scout())

    def sync_from(self, origin: Stepper) -> None:
        """Take over where `origin` is."""
        self.inner.depart(origin.inner)
        self._positions, self._work = list(origin._positions), origin._work

    def read_layer(self, out: Floats) -> None:
        """Write heights, velocities and forces of the layer from plate to top."""
        height, velocity, force = out
        self.inner.read_field(self._strain, velocity)
        layer = self.rig.layer
        spacing = layer.thickness / (self._strain.size - 1)
        rise = spacing * (1.0 + 0.5 * (self._strain[1:] + self._strain[:-1]))
        height[0] = self.state[1]
        np.cumsum(rise, out=height[1:])
        height[1:] += height[0]
        stiffness = layer.youngs_modulus * layer.section
        np.multiply(self._strain, -stiffness, out=force)

    def sample_strain(self, times: ArrayLike, out: Floats) -> None:
        """Write the strain at times into rows."""
        self.inner.sample_field(times, out)


def make_stepper(
    rig: Rig, model: str, motion: Literal['measured'] | None, *, field_points: int
) -> Stepper:
    """Make what follows a rig in real time."""
    if model != 'travelling_wave':
        return Stepper(GridStepper(rig, motion, model=model, field_points=field_points))
    inner = stepper.Stepper(rig, motion, field_points=field_points)
    return Stepper(inner, peak_strain=0.0 if motion == 'measured' else _peak_strain(rig))


def _peak_strain(rig: Rig) -> float:
    try:
        peaks = first_peaks(
            mass_ratio=rig.mass_ratio,
            speed_ratio=rig.speed_ratio,
            damping_ratio=rig.engine.damping_ratio,
            gravity_ratio=rig.gravity_ratio,
        )
    except ThrowUnresolvedError:
        return 0.0
    return peaks.strain * rig.engine.speed_scale / rig.layer.wave_speed


def warm_up() -> None:
    """Compile or load all kernels."""
    stepper.warm_up()
    grid_stepper.warm_up()
    _peak_strain(Rig())
