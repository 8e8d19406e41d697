# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The common contract of steppers: models of one throw that go forward in time, tick by tick.

`soft_throw_ros.core.wave_stepper` follows travelling waves, `soft_throw_ros.core.cell_stepper`
cells of finite size. An offline result is the same kernel, run to the end of the throw.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
import math
from typing import ClassVar, get_args, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.batch import Cancelled, check_cancelled
from soft_throw_ros.core.kernels import Record, subroutine
from soft_throw_ros.core.plate import require_series
from soft_throw_ros.core.plate_kernels import (
    append_states,
    extrapolate,
    MAX_PIECES_AHEAD,
    write_motion,
)
from soft_throw_ros.core.rig import Layer, Rig

Floats = NDArray[np.float64]

(
    TIME,
    PLATE_POSITION,
    PROJECTILE_POSITION,
    PLATE_VELOCITY,
    PROJECTILE_VELOCITY,
    PLATE_FORCE,
    PROJECTILE_FORCE,
) = range(7)
"""Indices of `Stepper.state`."""

RELEASE, RECONTACT, LANDING = np.arange(3)
"""Kinds of events in the memory of a kernel; `EVENT_KINDS` are their names."""

EventKind: TypeAlias = Literal['release', 'recontact', 'landing']

EVENT_KINDS: tuple[EventKind, ...] = get_args(EventKind)

_NO_TIMES, _NO_STATES = np.empty(0), np.empty((0, 3))

MAX_EVENTS = 4096
"""Most events of one throw."""

BACKWARDS, BEYOND_HORIZON, TOO_MANY_EVENTS, TOO_FAR = -1, -2, -3, -4
"""Error codes that a kernel returns instead of the number of events."""


class HorizonError(ValueError):
    """A time beyond the known motion of the plate."""


class EventLimitError(RuntimeError):
    """More than `MAX_EVENTS` events in one throw."""


class Event(NamedTuple):
    """A release, re-contact or landing of the projectile."""

    kind: EventKind
    """
    A re-contact is when the layer catches up with a projectile that has not fallen back yet; a
    landing is when it has come down under gravity, and every contact after that.
    """
    time: float
    """Since the start. [s]"""
    position: float
    """Height of the projectile's lower face above the plate's rest position. [m]"""
    velocity: float
    """Velocity of the projectile, the same before and after the event. [m/s]"""


class Loads(NamedTuple):
    """
    Largest magnitudes from the start to the first release, or up to now before the release.

    Strains [-] anywhere in the layer, at the plate and at its top, the projectile's upward
    acceleration [m/s2], and the force of the layer on the plate [N].
    """

    strain: float
    plate_strain: float
    contact_strain: float
    acceleration: float
    plate_force: float


class Stepper(ABC):
    """
    One throw, going forward: state, layer, events and loads at any time.

    Attributes
    ----------
    rig : Rig
        The rig.
    field_points : int
        Heights of the layer, from plate to top, at which it is read.
    state : ndarray, shape (7,)
        At exactly the time that was asked for last, and always the same array: `TIME` [s],
        `PLATE_POSITION` and `PROJECTILE_POSITION` (of the lower face) up from the plate's
        position at rest [m], `PLATE_VELOCITY` and `PROJECTILE_VELOCITY` [m/s], `PLATE_FORCE`
        and `PROJECTILE_FORCE` of the layer on each, up [N].

    Notes
    -----
    The results at a time depend on this time alone, to the last bit: not on the times of earlier
    requests, nor (given the states of a measured plate) on the size of the appended pieces.
    Nothing is allocated after construction, except for `events`, and no kernel holds Python's
    lock.

    A subclass has two records in `_core`: the first stands at a step of its grid, the second at
    the time asked for. Their fields include `plate_kernels.PLATE`, and contact, events, state,
    surface (height of the top against rest) and rest_height (of the projectile's lower face).

    """

    rig: Rig
    field_points: int
    state: Floats

    _core: NDArray[np.void]
    _numbers: Floats
    """View of the records as plain numbers, a row for each record, for faster copies."""
    _path: Floats
    """Motion of the plate, see `plate_kernels`."""
    _events: Floats
    """A row for each event: kind, time, position, velocity."""
    _advance: Callable[[float], int]
    """Goes to a time, and returns the number of events, or an error code."""
    _read_layer: Callable[[Floats], None]
    """Does the work of `read_layer`, without checks."""
    _changing: ClassVar[tuple[str, ...]]
    """Names of the arrays that the kernels change, beside records, path and events."""

    def __init__(self, rig: Rig, field_points: int) -> None:
        self.rig = rig
        self.field_points = require_count('field_points', field_points, low=2, high=1 << 20)
        self._events = np.zeros((MAX_EVENTS, 4))
        self._readable = np.empty(0)  # the array that was checked last

    def _make_records(
        self, record: np.dtype[np.void], step: float, *, is_measured: bool
    ) -> NDArray[np.void]:
        """Make records and path, and return the record to fill in."""
        self._use_records(np.zeros(3, record))
        start: NDArray[np.void] = self._core[2]
        self._path = write_motion(self._core, self.rig.engine, step, is_measured=is_measured)
        self._is_measured = is_measured
        return start

    def _use_records(self, core: NDArray[np.void]) -> None:
        self._core = core
        self._numbers = core.view(np.float64).reshape(3, -1)
        self.state = core['state'][1]
        self.state.flags.writeable = False

    @abstractmethod
    def _bind(self) -> None:
        """Hand the arrays to the kernels `_advance` and `_read_layer`."""

    @abstractmethod
    def _clear(self) -> None:
        """Put the layer back to rest."""

    def reset(self) -> None:
        """Go back to time 0, everything at rest; states appended are forgotten."""
        self._numbers[:2] = self._numbers[2]
        if self._is_measured:
            self._path[:, 0] = 0.0  # the rest before the first state, unless pieces went round
        self._clear()
        self._advance(0.0)

    def advance_to(self, time: float) -> int:
        """
        Go forward to `time`, however far, and bring `state` there.

        Parameters
        ----------
        time : float
            Time since the start; must not decrease from call to call. [s]

        Returns
        -------
        int
            Number of events until now.

        Raises
        ------
        ValueError
            If `time` is not finite or goes backwards.
        HorizonError
            If the plate is not known that far ahead; nothing has changed.
        EventLimitError
            If there were too many events on the way; only `reset` helps.

        """
        count = self._advance(time)
        if count < 0:
            raise self._refusal(count, float(time))
        return count

    def advance_to_release(
        self, *, latest: float, step: float, cancelled: Cancelled | None = None
    ) -> Event | None:
        """
        Go forward from the start in steps until the first release, and return it.

        Parameters
        ----------
        latest : float
            Time after which to give up and return None. [s]
        step : float
            Time of each step. [s]
        cancelled : callable, optional
            See `batch.Cancelled`; SearchCancelledError if it returns True.

        """
        steps = 0
        while not self.advance_to(min(steps * step, latest)):
            check_cancelled(cancelled)
            if steps * step >= latest:
                return None
            steps += 1
        return self.events()[0]

    def _refusal(self, status: int, time: float) -> Exception:
        """Return the exception for a failed advance."""
        if status == BEYOND_HORIZON:
            return HorizonError(f'the plate is known until {self.horizon:g} s, got {time:g} s')
        if status == TOO_MANY_EVENTS:
            return EventLimitError(f'more than {MAX_EVENTS} events before {time:g} s')
        if status == TOO_FAR or math.isnan(time):
            return ValueError(f'time must be finite and within 4e15 steps, got {time:g} s')
        return ValueError(
            f'time must not go backwards, got {time!r} s after {float(self.state[TIME])!r} s'
        )

    def append_plate_states(self, times: ArrayLike, states: ArrayLike) -> None:
        """
        Append states of a measured plate in real time; quintics join the states.

        The plate is known up to the last state; with a single state, up to this state. It is at
        rest before the first state.

        Parameters
        ----------
        times : array_like, shape (n,)
            Increasing, from call to call too; the first not negative. [s]
        states : array_like, shape (n, 3)
            Height, velocity and acceleration at each. [m], [m/s], [m/s2]

        Raises
        ------
        ValueError
            If the stepper was not made with `is_measured`, or states are not finite, not
            increasing, or more than `plate_kernels.MAX_PIECES_AHEAD` ahead; none is taken.

        """
        if not self._is_measured:
            raise ValueError('append_plate_states needs a stepper made with is_measured')
        times = np.ascontiguousarray(times, dtype=np.float64)
        states = np.ascontiguousarray(states, dtype=np.float64)
        if times.ndim != 1 or states.shape != (times.size, 3):
            raise ValueError(
                'times and states must be of shapes (n,) and (n, 3), '
                f'got {times.shape} and {states.shape}'
            )
        if not times.size:
            return
        last = float(self._core[0]['last'][0])
        if not _are_in_order(times, states, last):
            require_series(times, states, 'states', after=last)
            raise ValueError(f'times must not be negative, got {times[0]:g} s')
        ahead = int(self._core[0]['pieces'] - self._core[1]['piece']) + times.size
        if ahead > MAX_PIECES_AHEAD:
            raise ValueError(
                f'states must not be more than {MAX_PIECES_AHEAD} ahead of advance_to, '
                f'got {times.size} which makes {ahead}'
            )
        core = self._core
        core['pieces'][0] = append_states(
            core['last'][0], int(core['pieces'][0]), self._path, times, states
        )
        core['horizon'][:2] = times[-1]

    def fork(self) -> Stepper:
        """
        Make a stepper that can go ahead of this one, see `sync_from`.

        They share the plate and the memory for events: `events` of the fork are right until this
        stepper goes on. ValueError if this one was not made with `is_measured`.
        """
        if not self._is_measured:
            raise ValueError('fork needs a stepper made with is_measured')
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        other._use_records(self._core.copy())
        for name in self._changing:
            setattr(other, name, getattr(self, name).copy())
        other._bind()
        other._is_measured = False
        return other

    def sync_from(
        self, origin: Stepper, times: Floats = _NO_TIMES, states: Floats = _NO_STATES
    ) -> None:
        """
        Copy the state of `origin`, the stepper that this fork runs ahead of.

        Beyond its horizon the plate passes the given states, see `append_plate_states`, unchecked.
        Beyond the last one it keeps its acceleration. The extrapolated motion reaches the
        projectile only after a crossing of the wave; until then the motion of the projectile is
        exact. Internal loss acts without delay: a loss tangent of 0.05 makes the velocity
        uncertain by 2e-3 of its scale at the end of this crossing.
        """
        self._numbers[:] = origin._numbers
        self._copy_layer(origin)
        record = self._core[0]
        record['pieces'] = append_states(
            record['last'], int(record['pieces']), self._path, times, states
        )
        extrapolate(self._core, self._path)

    @abstractmethod
    def _copy_layer(self, origin: Stepper) -> None:
        """Copy the state of the layer."""

    def read_layer(self, out: Floats) -> None:
        """
        Write the state of the layer at the present time, from plate to top.

        Parameters
        ----------
        out : ndarray, shape (3, field_points) or (4, field_points)
            Of float64, else ValueError: heights above the plate's rest position [m], velocities
            [m/s], forces through the layer, positive in compression [N], and, if there is a
            fourth row, total strains, negative in compression [-].

        """
        if out is not self._readable:
            _require_target(out, self.field_points)
            self._readable = out
        self._read_layer(out)

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
            Event(EVENT_KINDS[int(kind)], *numbers)
            for kind, *numbers in self._events[start:self.event_count].tolist()
        ]

    @property
    def rest_position(self) -> float:
        """Height of the projectile's lower face at rest [m]."""
        return float(self._core['rest_height'][1])

    @property
    def surface_position(self) -> float:
        """Height of the top of the layer; in contact that of the projectile's lower face [m]."""
        return float(self._core['rest_height'][1] + self._core['surface'][1])

    @property
    @abstractmethod
    def cost(self) -> float:
        """Time of a processor over time of the rig, about [-]."""

    @property
    @abstractmethod
    def loads(self) -> Loads:
        """Largest loads up to the first release, or up to now before the release."""

    @property
    @abstractmethod
    def plate_work(self) -> float:
        """Work of the plate up to the first release, or up to now before the release [J]."""

    @abstractmethod
    def stored_energy(self) -> float:
        """Return the energy of layer and projectile against rest, up to the first release [J]."""


@subroutine
def note_event(
    s: Record, events: Floats, kind: int, time: float, height: float, velocity: float
) -> None:
    """Append an event, with its height from rest; the march ends if the table is full."""
    s.events += 1
    if s.events <= events.shape[0]:
        row = events[s.events - 1]
        row[0], row[1], row[2], row[3] = kind, time, s.rest_height + height, velocity


@subroutine
def steps_until(s: Record, step: float, time: float) -> int:
    """Return the number of whole steps until a time, or an error code."""
    if not time >= s.time:
        return BACKWARDS
    if time >= 4e15 * step:
        return TOO_FAR
    steps = int(time / step)
    while steps * step > time:
        steps -= 1
    while (steps + 1) * step <= time:
        steps += 1
    return steps


def _are_in_order(times: Floats, states: Floats, last: float) -> bool:
    """Return whether states are finite, and times increase after `last` and are not negative."""
    for time in times.tolist():
        if not (last < time < math.inf and time >= 0.0):
            return False
        last = time
    return all(map(math.isfinite, states.ravel().tolist()))


def load_kernels(stepper: Stepper) -> None:
    """Compile or load the kernels of a stepper, which is new and has a measured plate."""
    stepper.append_plate_states(np.arange(2.0), np.zeros((2, 3)))
    stepper.advance_to(stepper.horizon / 1024.0)
    stepper.read_layer(np.empty((3, stepper.field_points)))
    stepper.fork().sync_from(stepper)
    stepper.stored_energy()
    _ = stepper.loads


def require_count(name: str, value: object, *, low: int, high: int) -> int:
    """Return a whole number within limits, or raise ValueError."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ValueError(f'{name} must be a whole number, got {value!r}')
    if not low <= value <= high:
        raise ValueError(f'{name} must be from {low} to {high}, got {value}')
    return int(value)


def require_rate(layer: Layer, needed: float, *, limit: float, unit: str) -> None:
    """Raise ValueError with a remedy if a layer needs more steps per second than the limit."""
    factor = needed / limit
    if factor > 1.0:
        raise ValueError(
            f'layer.thickness {layer.thickness:g} m at layer.wave_speed {layer.wave_speed:g} m/s '
            f'needs {needed:.3g} {unit} per second, the limit is {limit:g}; feasible: '
            f'layer.thickness of {1.001 * layer.thickness * factor:.4g} m or more, or '
            f'layer.wave_speed of {0.999 * layer.wave_speed / factor:.4g} m/s or less'
        )


def require_steps_per_period(rig: Rig, steps: float, *, limit: int, unit: str) -> int:
    """Return the count of a unit for some steps in a period of the plate, or raise ValueError."""
    needed = math.ceil(steps * rig.crossing_time * rig.engine.frequency)
    if needed > limit:
        raise ValueError(
            f'engine.frequency {rig.engine.frequency:g} Hz with a crossing time of '
            f'{rig.crossing_time:.4g} s needs {needed} {unit}, the limit is {limit}; feasible: '
            f'engine.frequency of {0.999 * rig.engine.frequency * limit / needed:.4g} Hz or less'
        )
    return needed


def _require_target(out: Floats, points: int) -> None:
    """Raise ValueError unless a kernel can write a layer to `out`."""
    shapes, got = ((3, points), (4, points)), type(out).__name__
    if isinstance(out, np.ndarray):
        if out.dtype == np.float64 and out.shape in shapes and out.flags.carray:
            return
        got = f'{out.dtype} of shape {out.shape}'
    raise ValueError(
        f'out must be a contiguous float64 array of shape (3 or 4, {points}), got {got}'
    )
