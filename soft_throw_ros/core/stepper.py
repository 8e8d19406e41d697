# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Steppers: models of one throw that go forward in time, by waves or by cells.

Kernels know the plate's motion as pieces, each a quintic in height; the present piece is in a
stepper's record. Pieces of a damped step are made when they are needed. Those of another motion
are in a *path*, a ring with a column for each piece: its start time, and the six coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
import copy
from functools import partial
import math
from typing import Any, get_args, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.batch import Cancelled, check_cancelled, ThrowUnresolvedError
from soft_throw_ros.core.kernels import Floats, inlined, kernel, Record, subroutine
from soft_throw_ros.core.plate import damped_state, quintic
from soft_throw_ros.core.rig import Engine, Rig

(
    TIME, PLATE_POSITION, PROJECTILE_POSITION, PLATE_VELOCITY, PROJECTILE_VELOCITY, PLATE_FORCE,
    PROJECTILE_FORCE,
) = range(7)
"""Indices of `Stepper.state`."""

EventKind: TypeAlias = Literal['release', 'recontact', 'landing']

_EVENT_KINDS: tuple[EventKind, ...] = get_args(EventKind)
_RELEASE, _RECONTACT, _LANDING = np.arange(3)  # in the memory of a kernel

CAPACITY = 4096
"""
Most entries of each table of a stepper, whose memory does not grow: cells of a layer, steps of a
crossing, events of a throw, states of a measured plate ahead of the stepper. [-]
"""

MAX_COST = 0.24
"""Largest `Stepper.cost` of a twin, which has other work to do as well. [-]"""

FEWEST, PER_RELAXATION, PER_PERIOD = 64, 12.0, 120.0
"""
Cells of a layer, and per relaxation time and plate period, for errors of 1e-4; of second order,
so that a third is enough for 1e-3. [-]
"""

FORCE_NOISE = 1e-11
"""Rounding of the contact force, over impedance times the plate's peak speed. [-]"""

SLICE = 0.05
"""Time of a processor between two looks at a flag, as estimated by `Stepper.cost`. [s]"""

ROUNDING = 1e-6
"""Rest of `SLICE` that is rounding. [s]"""

_PIECES_PER_PERIOD = 32.0
"""Pieces in a period of a damped step, whose speeds err by 1e-8 of the largest. [-]"""

_quintic, _damped_state = subroutine(quintic), subroutine(damped_state)

COMMON = [
    ('amplitude', 'f8'),  # of a damped step [m]
    ('growth', 'f8'),  # its exponent [1/s]
    ('turn', 'f8'),
    ('duration', 'f8'),  # of its pieces, 0 for another motion [s]
    ('piece_begin', 'f8'),  # of the present piece [s]
    ('piece_end', 'f8'),  # infinite if no other piece is known [s]
    ('coefficients', 'f8', (6,)),  # of the present piece, lowest order first
    ('piece', 'i8'),  # its number
    ('pieces', 'i8'),  # how many are known; number 0 is rest before the first state
    ('horizon', 'f8'),  # until when the plate is known [s]
    ('last', 'f8', (4,)),  # time, height, velocity and acceleration at the end of all pieces
    ('contact', '?'),
    ('landed', '?'),
    ('events', 'i8'),
    ('event_time', 'f8'),  # of the last event; of cells in the last step, infinite without one [s]
    ('event_velocity', 'f8'),  # [m/s]
    ('rest_height', 'f8'),  # of the projectile's lower face [m]
    ('loads', 'f8', (3,)),  # of `Loads`
    ('work', 'f8'),  # of the plate up to the first release [J]
    ('surface', 'f8'),  # height of the top of the layer against rest [m]
    ('state', 'f8', (7,)),
]
"""Fields of the records of all steppers, for `numpy.dtype`."""

NO_PATH = np.empty((7, 0))
"""Path of a damped step."""


class EventLimitError(ThrowUnresolvedError):
    """More than `CAPACITY` events in one throw."""


class Event(NamedTuple):
    """
    A release, re-contact or landing of the projectile.

    A re-contact is when the layer catches up with a projectile that has not fallen back yet; a
    landing is when it has come down under gravity, and every contact after that.
    """

    kind: EventKind
    time: float  # since the start [s]
    position: float  # of the projectile's lower face above the plate's rest position [m]
    velocity: float  # of the projectile, the same before and after the event [m/s]


class Loads(NamedTuple):
    """
    Largest magnitudes from the start to the first release, or up to now before the release.

    Strain of the layer [-], upward acceleration of the projectile [m/s2], and force of the layer
    on the plate [N].
    """

    strain: float
    acceleration: float
    plate_force: float


class Stepper:
    """
    One throw, going forward: state, layer, events and loads at any time.

    `state` is always the same array, at exactly the time that was asked for last: `TIME` [s],
    `PLATE_POSITION` and `PROJECTILE_POSITION` (of the lower face) up from the plate's position at
    rest [m], `PLATE_VELOCITY` and `PROJECTILE_VELOCITY` [m/s], `PLATE_FORCE` and
    `PROJECTILE_FORCE` of the layer on each, up [N]. The layer is read at `field_points` heights
    from plate to top.

    The results at a time depend on this time alone, to the last bit: not on the times of earlier
    requests, nor on the size of the appended pieces of a measured plate. Nothing is allocated
    after construction, except for `events`, and no kernel holds Python's lock.
    """

    cost: float
    """Time of a processor over time of the rig, about [-]."""

    def __init__(
        self, rig: Rig, core: NDArray[np.void], layer: Floats,
        kernels: tuple[Callable[..., Any], Callable[..., Any]], *reading: Callable[[int], Floats],
        is_measured: bool = False, field_points: int = 64,
    ) -> None:
        """Take over a layer and the third of three records (grid, now, at rest) without plate."""
        self.rig = rig
        self.field_points = require_count('field_points', field_points, low=2, high=1 << 20)
        self._kernels, self._reading = kernels, [points(field_points) for points in reading]
        self._layer_at_rest = layer
        self._events = np.zeros((CAPACITY, 4))  # rows of kind, time, position, velocity
        self._path = write_motion(core, rig.engine, is_measured=is_measured)
        self._is_measured = is_measured
        self._bind(core, layer.copy())
        self.reset()

    def _bind(self, core: NDArray[np.void], layer: Floats) -> None:
        """Take over arrays for the state of this stepper alone."""
        self._core, self._layer = core, layer
        self._numbers = core.view(np.float64).reshape(3, -1)  # for faster copies
        self._field = np.empty((4, self.field_points))
        self.state = core['state'][1]
        self.state.flags.writeable = False
        advance, read_layer = self._kernels
        self._advance = partial(advance, core, layer, self._path, self._events)
        self._read_layer = partial(read_layer, core, layer, *self._reading, self._field)

    def reset(self) -> None:
        """Go back to time 0, everything at rest; states appended are forgotten."""
        self._numbers[:2] = self._numbers[2]
        self._path[:, :1] = 0.0  # the rest before the first state, unless pieces went round
        self._layer[:] = self._layer_at_rest
        self._advance(0.0)

    def advance_to(self, time: float) -> int:
        """
        Go forward to a time, bring `state` there, and return the number of events until then.

        ValueError if the time [s] is not finite, decreases from call to call, or is beyond the
        known motion of the plate, and nothing has changed; EventLimitError if there were too many
        events on the way, and only `reset` helps.
        """
        count: int = self._advance(time)
        if count > CAPACITY:
            raise EventLimitError(f'more than {CAPACITY} events before {time:g} s')
        if count < 0:
            raise ValueError(
                f'time must be finite and from {float(self.state[TIME])!r} s on, and the plate is '
                f'known until {self.horizon:g} s, got {time!r} s'
            )
        return count

    def advance_to_release(
        self, *, latest: float, cancelled: Cancelled | None = None
    ) -> Event | None:
        """
        Go forward until the first release, and return it, or None if there is none by `latest`.

        `cancelled` is called after each quarter of the projectile's own period.
        """
        step = 0.25 * (1.0 / self.rig.natural_frequency + self.rig.crossing_time)
        time = float(self.state[TIME])
        while not self.advance_to(time):
            check_cancelled(cancelled)
            if time >= latest:
                return None
            time = min(time + step, latest)
        return self.events()[0]

    def append_plate_states(self, times: ArrayLike, states: ArrayLike) -> None:
        """
        Append states of a measured plate in real time; quintics join the states.

        A row of the states, of shape (n, 3), is height [m], velocity [m/s] and acceleration
        [m/s2]. The plate is at rest before the first state, and known up to the last one.
        ValueError, and none is taken, if the stepper was not made with `is_measured`, states are
        not finite, or times [s] are negative, do not increase, or are too many.
        """
        if not self._is_measured:
            raise ValueError('append_plate_states needs a stepper made with is_measured')
        times = np.ascontiguousarray(times, dtype=np.float64)
        states = np.ascontiguousarray(states, dtype=np.float64)
        if not times.size:
            return
        if states.shape != (times.size, 3) or not _may_follow(self._core, times, states):
            last = float(self._core[0]['last'][0])
            raise ValueError(
                f'states must be three finite numbers each, at times from 0 on that increase '
                f'from {last:g} s, got {states.tolist()} at {times.tolist()} s'
            )
        ahead = int(self._core[0]['pieces'] - self._core[1]['piece']) + times.size
        if ahead > CAPACITY:
            raise ValueError(
                f'states must not be more than {CAPACITY} ahead of advance_to, '
                f'got {times.size} which makes {ahead}'
            )
        append_states(self._core, 0, self._path, times, states)
        self._core['horizon'][:2] = times[-1]

    def fork(self) -> Stepper:
        """
        Make a stepper that can go ahead of this one, which has a measured plate, see `sync_from`.

        They share the memory for events: those of the fork are right until this one goes on.
        """
        other = copy.copy(self)
        other._bind(self._core.copy(), self._layer.copy())
        other._is_measured = False
        return other

    def sync_from(self, origin: Stepper, times: Floats, states: Floats) -> None:
        """
        Copy the state of `origin`, the stepper that this fork runs ahead of.

        Beyond its horizon the plate passes the given states, see `append_plate_states`, unchecked,
        and beyond the last one it keeps its acceleration. This reaches the projectile only after a
        crossing of the wave, except for internal loss, which acts without delay: a loss tangent of
        0.05 makes the velocity uncertain by 2e-3 of its scale at the end of the crossing.
        """
        self._numbers[:] = origin._numbers
        self._layer[:] = origin._layer
        append_states(self._core, 0, self._path, times, states)
        extrapolate(self._core, self._path)

    def read_layer(self) -> Floats:
        """
        Return the layer at the present time, from plate to top; always the same array.

        The rows, of shape (4, field_points), are heights above the plate's rest position [m],
        velocities [m/s], forces through the layer, positive in compression [N], and total
        strains, negative in compression [-].
        """
        self._read_layer()
        return self._field

    @property
    def horizon(self) -> float:
        """Time until which the plate is known and `advance_to` can go [s]."""
        return float(self._core['horizon'][0])

    @property
    def in_contact(self) -> bool:
        """Whether the projectile lies on the layer."""
        return bool(self._core['contact'][1])

    @property
    def event_count(self) -> int:
        """Number of events so far."""
        return int(self._core['events'][1])

    def events(self, start: int = 0) -> list[Event]:
        """Return the events until now, from number `start` on, counted from 0."""
        return [
            Event(_EVENT_KINDS[int(kind)], *numbers)
            for kind, *numbers in self._events[start:self.event_count].tolist()
        ]

    @property
    def loads(self) -> Loads:
        """Largest loads up to the first release, or up to now before the release."""
        return Loads(*self._core['loads'][1].tolist())

    @property
    def plate_work(self) -> float:
        """Work of the plate up to the first release, or up to now before the release [J]."""
        return float(self._core['work'][1])

    def stored_energy(self) -> float:
        """Return the energy of layer and projectile against rest, up to the first release [J]."""
        return self.plate_work


def follow_batch(
    follow: Callable[..., tuple[int, Floats]], record: np.dtype[np.void], rigs: Any,
    arrays: Any, latest: Floats, cancelled: Cancelled | None,
) -> Floats:
    """
    Follow throws to their first releases, or up to some latest times [s], without steppers.

    `follow` is a kernel that goes on with a number of throws for about `SLICE`, and returns the
    number and the layer of the one under way; `rigs` are `rig.scales_of` the throws, and it
    prepares each by its row of `arrays`. Each model has its own, because numba caches no kernel
    that takes a function. The result has the rows time (NaN without a release),
    speed, largest strain, acceleration and plate force, and work of the plate.
    """
    engines = rigs.engine
    plates = np.array([engines.amplitude, engines.angular_frequency, engines.damping_ratio])
    core, rows = np.zeros(4, record), np.empty((6, latest.size))
    number, layer = 0, np.empty((0, 0))
    while number < latest.size:
        check_cancelled(cancelled)
        number, layer = follow(core, layer, number, plates, arrays, latest, rows)
    return rows


@subroutine
def begin_throw(core: NDArray[np.void], plate: Floats) -> None:
    """Write a damped step into the third record of a batch, whose fourth one is empty."""
    core[2] = core[3]
    write_damped(core, plate[0], plate[1], plate[2])


@subroutine
def write_release(core: NDArray[np.void], row: Floats) -> None:
    """Write the first release of a throw, if any, and its loads into a row of `follow_batch`."""
    s = core[1]
    row[0], row[1] = s.event_time if s.events else math.nan, s.event_velocity
    row[2:5], row[5] = s.loads, s.work


@kernel
def write_damped(core: Record, amplitude: float, omega: float, zeta: float) -> None:
    """Write a damped step into the third record, unchecked."""
    s = core[2]
    s.amplitude, s.growth, s.turn = amplitude, -zeta * omega, math.sqrt(1.0 - zeta * zeta) * omega
    s.duration, s.horizon = 1.0 / (_PIECES_PER_PERIOD * omega / (2.0 * math.pi)), math.inf


def write_motion(core: NDArray[np.void], engine: Engine, *, is_measured: bool) -> Floats:
    """Write a motion into the third record, where the plate is at rest; return its path."""
    record, motion = core[2], engine.motion
    if motion is None and not is_measured:
        write_damped(core, engine.amplitude, engine.angular_frequency, engine.damping_ratio)
        return NO_PATH
    record['pieces'], record['last'][0] = 1, -math.inf
    if motion is None or is_measured:
        return np.zeros((7, CAPACITY + 2))  # one more to extrapolate with
    path = np.zeros((7, motion.times.size + 1))
    append_states(core, 2, path, motion.times, motion.states)
    path[:2, -1] = motion.end_time, motion.states[-1, 0]  # there it stays
    record['pieces'] += 1
    record['horizon'] = math.inf
    return path


@subroutine
def enter_piece(s: Record, path: Floats, time: float) -> None:
    """Write the piece at `time`, which must not decrease, into the record."""
    c = s.coefficients
    if s.duration > 0.0:
        s.piece = int(time / s.duration) + 1
        while s.piece * s.duration > time:
            s.piece -= 1
        s.piece_begin, s.piece_end = s.piece * s.duration, (s.piece + 1) * s.duration
        state = _damped_state(s.piece_begin, s.amplitude, s.growth, s.turn)
        later = _damped_state(s.piece_end, s.amplitude, s.growth, s.turn)
        duration = s.piece_end - s.piece_begin
        c[0], c[1], c[2], c[3], c[4], c[5] = _quintic(duration, state, later)
        return
    capacity = path.shape[1]
    while s.piece + 1 < s.pieces and path[0, (s.piece + 1) % capacity] <= time:
        s.piece += 1
    s.piece_begin = path[0, s.piece % capacity]
    s.piece_end = path[0, (s.piece + 1) % capacity] if s.piece + 1 < s.pieces else math.inf
    for n in range(6):
        c[n] = path[n + 1, s.piece % capacity]


@inlined
def motion_at(s: Record, path: Floats, time: float) -> tuple[float, float, float]:
    """Evaluate height, velocity and acceleration of the plate."""
    if not s.piece_begin <= time < s.piece_end:
        enter_piece(s, path, time)
    u, c = time - s.piece_begin, s.coefficients
    height = c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))
    velocity = c[1] + u * (2.0 * c[2] + u * (3.0 * c[3] + u * (4.0 * c[4] + u * 5.0 * c[5])))
    acceleration = 2.0 * c[2] + u * (6.0 * c[3] + u * (12.0 * c[4] + u * 20.0 * c[5]))
    return height, velocity, acceleration


@kernel
def _may_follow(core: Record, times: Floats, states: Floats) -> bool:
    """Return whether states are finite, and their times are not negative and increase."""
    last, is_allowed = core[0].last[0], times[0] >= 0.0 and np.isfinite(states).all()
    for time in times:
        is_allowed, last = is_allowed and last < time < math.inf, time
    return bool(is_allowed)


@kernel
def append_states(core: Record, row: int, path: Floats, times: Floats, states: Floats) -> None:
    """Append states (height, velocity, acceleration), joined by quintics, to one record."""
    s, last = core[row], core[row].last
    s.piece_end = -math.inf  # the present piece may end now
    for n in range(times.size):
        if last[0] >= 0.0:
            piece = path[:, s.pieces % path.shape[1]]
            c0, c1, c2, c3, c4, c5 = _quintic(times[n] - last[0], last[1:], states[n])
            piece[0], piece[1], piece[2] = last[0], c0, c1
            piece[3], piece[4], piece[5], piece[6] = c2, c3, c4, c5
            s.pieces += 1
        last[0], last[1], last[2], last[3] = times[n], states[n, 0], states[n, 1], states[n, 2]


@kernel
def extrapolate(core: Record, path: Floats) -> None:
    """Extend the plate's motion for ever, with its acceleration at the horizon."""
    s, last = core[0], core[0].last
    if math.isfinite(s.horizon) and last[0] >= 0.0:
        piece = path[:, s.pieces % path.shape[1]]
        piece[0], piece[1], piece[2] = last[0], last[1], last[2]
        piece[3], piece[4:] = 0.5 * last[3], 0.0
        s.pieces += 1
    s.horizon = core[1].horizon = math.inf


@subroutine
def note_event(s: Record, events: Floats, time: float, height: float, velocity: float) -> None:
    """
    Change between contact and flight, and append this event, with its height from rest.

    The march ends if the table is full.
    """
    kind = _RELEASE
    if not s.contact:
        s.landed = s.landed or (velocity <= 0.0 and s.gravity > 0.0)
        kind = _LANDING if s.landed else _RECONTACT
    s.contact = not s.contact
    s.events += 1
    s.event_time, s.event_velocity = time, velocity
    if s.events <= events.shape[0]:
        row = events[s.events - 1]
        row[0], row[1], row[2], row[3] = kind, time, s.rest_height + height, velocity


@subroutine
def steps_until(s: Record, step: float, time: float) -> int:
    """Return the number of whole steps until a time, or -1 if there is no way there."""
    if not s.state[TIME] <= time < 4e15 * step or time > s.horizon:
        return -1
    steps = int(time / step)  # to one step
    return steps + int((steps + 1) * step <= time) - int(steps * step > time)


def require_count(name: str, value: object, *, low: int, high: int) -> int:
    """Return a whole number within limits, or raise ValueError."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ValueError(f'{name} must be a whole number, got {value!r}')
    if not low <= value <= high:
        raise ValueError(f'{name} must be from {low} to {high}, got {value}')
    return int(value)


def needed_cells(rig: Any) -> Any:
    """Return the cells of a layer, or of many, that errors of 1e-4 need."""
    needed = np.maximum(PER_RELAXATION / rig.mass_ratio, PER_PERIOD / rig.speed_ratio)
    return np.ceil(np.maximum(needed, FEWEST))


def cells_in_real_time(rig: Rig, cost: float, order: int, *, fewest: int = FEWEST) -> int:
    """
    Choose the cells for errors of 1e-4, or what there is time for if that gives 1e-3.

    `cost` is that of one cell, see `Stepper.cost`; many cost this times a power of their number.
    ThrowUnresolvedError, with a feasible value of a parameter, if there is no time for 1e-3.
    """
    limit = min(CAPACITY, (MAX_COST / cost) ** (1.0 / order))
    for name, value, unit, needed, power in (
        ('layer.thickness', rig.layer.thickness, 'm', FEWEST, order),
        ('projectile.mass', rig.projectile.mass, 'kg', PER_RELAXATION / 3.0 / rig.mass_ratio, 1),
        ('engine.frequency', rig.engine.frequency, 'Hz', PER_PERIOD / 3.0 / rig.speed_ratio, -1),
    ):
        if needed > limit:
            feasible = value * (1.001 * needed / limit) ** power
            raise ThrowUnresolvedError(
                f'{name} {value:g} {unit} at layer.wave_speed {rig.layer.wave_speed:g} m/s needs '
                f'{math.ceil(needed)} cells, the limit is {int(limit)}; '
                f'feasible: {name} of {feasible:.4g} {unit} or {"more" if power > 0 else "less"}'
            )
    return int(min(max(needed_cells(rig), fewest), limit))
