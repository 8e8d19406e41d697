# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The complete result of one throw: ejections, loads, energies, trajectories, fields."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import takewhile
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.batch import Cancelled, check_cancelled
from soft_throw_ros.core.cell_stepper import CellStepper
from soft_throw_ros.core.plate import motion_of, PlateMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import (
    Event,
    Loads,
    MAX_EVENTS,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    Stepper,
    TIME,
)
from soft_throw_ros.core.wave_stepper import WaveStepper

Floats = NDArray[np.float64]

MAX_DURATION = 60.0
"""Longest that a throw is followed if nothing else ends it. [s]"""

_BUDGET = 0.5
"""Processor time after which a throw ends that `until` does not end. [s]"""

_QUIET_CROSSINGS, _QUIET_PERIODS = 8.0, 2.0
"""Crossings plus periods after a release that show how far up the free top swings."""

_LOSSLESS_CELLS, _MAX_CELLS = 256, 2048
"""Cells of lossless sheets between which the step is halved; fewer miss short releases. [-]"""

_HALVING = 1e-4
"""Largest relative change of time and speed at which halving the step ends. [-]"""


class ThrowUnfinishedError(RuntimeError):
    """The time given ended before the projectile was released."""


class Energies(NamedTuple):
    """
    Work of the plate, energy stored in layer and projectile, and heat [J].

    The heat is the difference, 0 for a layer that is linear and lossless.
    """

    plate_work: float
    stored: float
    heat: float


class Trajectory(NamedTuple):
    """Positions [m] and velocities [m/s] over `time` [s], arrays of one shape; z up."""

    time: Floats
    plate_position: Floats
    top_position: Floats
    projectile_position: Floats
    plate_velocity: Floats
    projectile_velocity: Floats


class Fields(NamedTuple):
    """Strain [-] and velocity [m/s] of shape (time, depth), with their axes [s], [m]."""

    time: Floats
    depth: Floats
    strain: Floats
    velocity: Floats


def ejections(events: Iterable[Event]) -> tuple[Event, ...]:
    """Return the ejections: the releases before the projectile has come down on the layer."""
    before = takewhile(lambda event: event.kind != 'landing', events)
    return tuple(event for event in before if event.kind == 'release')


def apex_height(ejection: Event, gravity: float) -> float:
    """Compute how high the lower face flies, infinite without gravity [m]."""
    if gravity == 0.0:
        return math.inf
    return ejection.position + max(ejection.velocity, 0.0) ** 2 / (2.0 * gravity)


def make_stepper(
    rig: Rig,
    *,
    is_measured: bool = False,
    cells: int | None = None,
    field_points: int = 64,
) -> Stepper:
    """
    Make a stepper: cells if the layer needs them, otherwise travelling waves.

    The plate of a measured one moves by `append_plate_states`, and not by the rig's engine; the
    layer is read at `field_points` heights. ValueError if the rig cannot be stepped in real time,
    or an option is out of range.
    """
    if rig.layer.needs_cells:
        return CellStepper(rig, is_measured=is_measured, cells=cells, field_points=field_points)
    if cells is not None:
        raise ValueError(f'cells are for layers that need them only, got {cells!r}')
    return WaveStepper(rig, is_measured=is_measured, field_points=field_points)


def make_settled_stepper(
    rig: Rig, *, cells: int | None, field_points: int = 64, cancelled: Cancelled | None
) -> tuple[Stepper, int | None]:
    """
    Make a stepper for results to 1e-4, and return its number of cells, too.

    Nothing smooths the waves in sheets without loss, whose boundaries are between two steps. There
    the step is halved until the first release settles, and the stepper stands after it.
    """
    if cells is not None or not rig.layer.parts or rig.layer.loss_tangent > 0.0:
        return make_stepper(rig, cells=cells, field_points=field_points), cells
    before: tuple[float, float] | None = None
    cells, latest = _LOSSLESS_CELLS, rig.longest_wait
    while True:
        stepper = make_stepper(rig, cells=cells, field_points=field_points)
        event = stepper.advance_to_release(latest=latest, cancelled=cancelled)
        now = (math.nan, math.nan) if event is None else (event.time, event.velocity)
        is_settled = before is not None and np.allclose(
            now, before, rtol=_HALVING, atol=0.0, equal_nan=True
        )
        if is_settled or cells == _MAX_CELLS:
            return stepper, cells
        cells, before = 2 * cells, now


@dataclass(frozen=True, kw_only=True)
class Throw:
    """
    Result of one throw. Made by `simulate`.

    Times count from the start of the plate's motion, heights from the plate's rest position; loads
    and energies are those up to the first release.
    """

    rig: Rig
    cells: int | None = field(repr=False)
    rest_height: float
    """Height of the projectile's lower face before the throw. [m]"""
    events: tuple[Event, ...]
    """Releases, re-contacts and landings in order; the first is a release."""
    end_time: float
    """Time until which it was followed. [s]"""
    loads: Loads
    energies: Energies

    @property
    def motion(self) -> PlateMotion:
        """Motion of the plate."""
        return motion_of(self.rig.engine)

    @property
    def peak_plate_speed(self) -> float:
        """:math:`V_p^*` [m/s]."""
        return self.motion.peak_velocity

    @property
    def peak_strain(self) -> float:
        """Largest strain magnitude in the layer [-]."""
        return self.loads.strain

    @property
    def ejections(self) -> tuple[Event, ...]:
        """Releases before the projectile has come down on the layer."""
        return ejections(self.events)

    @property
    def first_release(self) -> Event:
        """Event at which the projectile first leaves the layer."""
        return self.ejections[0]

    @property
    def last_release(self) -> Event:
        """Event at which it leaves for the last time, after all re-contacts that were followed."""
        return self.ejections[-1]

    @property
    def recontacts(self) -> int:
        """Number of re-contacts between the two."""
        return len(self.ejections) - 1

    @property
    def ejection_time(self) -> float:
        """:math:`t_e` of the first release [s]."""
        return self.first_release.time

    @property
    def ejection_speed(self) -> float:
        """:math:`V_e` of the first release [m/s]."""
        return self.first_release.velocity

    @property
    def energy_transfer(self) -> float:
        r""":math:`\alpha = (V_e / V_p^*)^2` of the first release [-]."""
        return (self.ejection_speed / self.peak_plate_speed) ** 2

    @property
    def last_energy_transfer(self) -> float:
        r""":math:`\alpha` of the last release [-]."""
        return (self.last_release.velocity / self.peak_plate_speed) ** 2

    @property
    def leaves_linear_range(self) -> bool:
        """Whether the peak strain is so large that the result is doubtful."""
        return self.peak_strain > self.rig.layer.linear_range

    @property
    def apex_height(self) -> float:
        """Highest position of the projectile's lower face, see `apex_height` [m]."""
        return apex_height(self.last_release, self.rig.gravity)

    def trajectory(self, time: ArrayLike) -> Trajectory:
        """Return positions and velocities at increasing times [s], following the throw again."""
        time = np.atleast_1d(np.asarray(time, dtype=np.float64))
        stepper = self._stepper()
        rows = np.empty((time.size, 5))
        for row, moment in zip(rows, time.tolist(), strict=True):
            stepper.advance_to(moment)
            plate, projectile, plate_velocity, velocity = stepper.state[1:5]
            row[:] = plate, stepper.surface_position, projectile, plate_velocity, velocity
        return Trajectory(time, *rows.T)

    def fields(self, time: ArrayLike, *, points: int = 64) -> Fields:
        """
        Return strain and velocity of the layer at increasing times [s], following the throw again.

        There are so many `points` from plate to top, both included, at least 2.
        """
        time = np.atleast_1d(np.asarray(time, dtype=np.float64))
        stepper = self._stepper(points)
        strain, velocity = np.empty((2, time.size, points))
        layer = np.empty((4, points))
        for row, moment in enumerate(time.tolist()):
            stepper.advance_to(moment)
            stepper.read_layer(layer)
            velocity[row], strain[row] = layer[1], layer[3]
        depth = np.linspace(0.0, self.rig.layer.thickness, points)
        return Fields(time, depth, strain, velocity)

    def _stepper(self, points: int = 2) -> Stepper:
        return make_stepper(self.rig, cells=self.cells, field_points=points)


def simulate(
    rig: Rig,
    *,
    cells: int | None = None,
    until: float | None = None,
    max_events: int | None = None,
    cancelled: Cancelled | None = None,
) -> Throw:
    """
    Simulate a throw to its end, by travelling waves or, if the layer needs them, by cells.

    Parameters
    ----------
    rig : Rig
        The throwing rig.
    cells : int, optional
        Number of cells of a layer that needs them; by default for errors of 1e-4.
    until : float, optional
        Stop at this time. [s]
    max_events : int, optional
        Stop after so many events. If not given, and neither is `until`, stop when the projectile
        has come down on the layer, since a lossless bounce has no end. Without gravity, or if the
        simulation until then would take more than about half a second, stop when the projectile
        is far above every height that the free top reached in eight crossings and two periods of
        the plate.
    cancelled : callable, optional
        See `batch.Cancelled`.

    Returns
    -------
    Throw

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, or a bound is out of range.
    ThrowUnfinishedError
        If the projectile is not released by `until`, or within 16 periods of the plate or of its
        own on the layer.
    SearchCancelledError
        If `cancelled` returns True.

    Notes
    -----
    `wave_stepper.steps_per_crossing` and `cell_stepper.cells_per_layer` give the errors.

    Examples
    --------
    >>> from soft_throw_ros.core.rig import Layer, Rig
    >>> throw = simulate(Rig(layer=Layer(thickness=16.8e-3)))
    >>> round(throw.ejection_time * 1e3, 3), round(throw.energy_transfer, 3)
    (7.647, 3.637)

    The same gelatin with a loss tangent of 0.05:

    >>> layer = Layer(thickness=16.8e-3, loss_tangent=0.05)
    >>> round(simulate(Rig(layer=layer)).energy_transfer, 3)
    3.256

    """
    if until is not None:
        checks.require_positive('until', until)
    if max_events is not None and not 1 <= max_events <= MAX_EVENTS:
        raise ValueError(f'max_events must be from 1 to {MAX_EVENTS}, got {max_events}')
    stepper, cells = make_settled_stepper(rig, cells=cells, cancelled=cancelled)
    stepper.reset()
    _run(stepper, until, max_events, cancelled)
    events = tuple(stepper.events()[:max_events])
    end_time = float(stepper.state[TIME])
    if not events:
        largest = rig.engine.speed_scale * rig.engine.angular_frequency
        if rig.engine.motion is None and largest < rig.gravity:
            raise ThrowUnfinishedError(
                f"the plate's acceleration, at most {largest:.3g} m/s2, is below gravity, "
                f'{rig.gravity:g} m/s2, and the projectile stays on the layer'
            )
        raise ThrowUnfinishedError(
            f'the projectile is not released by {end_time:g} s; follow it for longer'
        )
    stepper.reset()
    stepper.advance_to(events[0].time)
    return Throw(
        rig=rig,
        cells=cells,
        rest_height=stepper.rest_position,
        events=events,
        end_time=end_time,
        loads=stepper.loads,
        energies=_energies(stepper),
    )


def _energies(stepper: Stepper) -> Energies:
    """Return the energies of a throw at its first release."""
    layer, work, stored = stepper.rig.layer, stepper.plate_work, stepper.stored_energy()
    is_lossless = layer.loss_tangent == 0.0 and layer.stress_strain_law == 'linear'
    return Energies(work, stored, 0.0 if is_lossless else max(0.0, work - stored))


def _run(
    stepper: Stepper, until: float | None, max_events: int | None, cancelled: Cancelled | None
) -> None:
    """Go to the end of a throw as `simulate` defines it."""
    rig = stepper.rig
    latest = MAX_DURATION if until is None else until
    wait, affordable = rig.longest_wait, max(_BUDGET / stepper.cost, 2.0 / rig.engine.frequency)
    quiet = _QUIET_CROSSINGS * rig.crossing_time + _QUIET_PERIODS / rig.engine.frequency
    tick = 0.25 / max(rig.engine.frequency, rig.natural_frequency)
    low = high = stepper.rest_position
    time, ticks, event_count = 0.0, 0, 0
    while time < latest and (max_events is None or event_count < max_events):
        check_cancelled(cancelled)
        ticks += 1
        time = min(ticks * tick, latest)
        count = stepper.advance_to(time)
        if count > event_count:
            last = stepper.events(event_count)[-1]
            event_count = count
            low = high = stepper.surface_position
            if last.kind == 'landing' and max_events is None and until is None:
                return
        if until is not None:
            continue
        if time > affordable or (not event_count and time > wait):
            return
        low, high = min(low, stepper.surface_position), max(high, stepper.surface_position)
        if event_count and not stepper.in_contact and time - last.time > quiet:
            rise, speed = stepper.state[PROJECTILE_POSITION], stepper.state[PROJECTILE_VELOCITY]
            is_out_of_reach = rise - high > high - low and speed > 0.0
            if is_out_of_reach and (
                rig.gravity == 0.0 or time + 2.0 * speed / rig.gravity > min(affordable, latest)
            ):
                return
