# SPDX-License-Identifier: Apache-2.0
"""
What the models in real time have in common: how they are asked, and how they answer.

`soft_throw_ros.core.stepper` follows the travelling wave, `soft_throw_ros.core.grid_stepper`
finite differences.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
import math
from typing import Any, Literal, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.moving_plate import checked_samples, coast, FEED_SEGMENTS
from soft_throw_ros.core.rig import Rig

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
"""Where things stand in `state`."""

MAX_EVENTS = 4096
"""Most releases and landings of one throw."""

BACKWARDS, BEYOND_HORIZON, TOO_MANY_EVENTS, TOO_FAR = -1, -2, -3, -4
"""What a kernel says instead of the number of events."""


class HorizonError(ValueError):
    """The plate is not known that far ahead (yet)."""


class EventLimitError(RuntimeError):
    """More than `MAX_EVENTS` releases and landings in one throw."""


class FeedFullError(RuntimeError):
    """Measured samples were fed further ahead than is kept."""


class Event(NamedTuple):
    """
    The projectile left the layer, or came down on it.

    Attributes
    ----------
    kind : {'release', 'landing'}
        Which of the two.
    time : float
        Since the start. [s]
    velocity : float
        Of the projectile, which neither changes. [m/s]

    """

    kind: Literal['release', 'landing']
    time: float
    velocity: float


class Peaks(NamedTuple):
    """
    Largest values so far.

    Attributes
    ----------
    plate_strain, contact_strain : float
        Magnitude of the strain at the plate, and at the top. [-]
    acceleration : float
        Of the projectile, upwards; downwards it is never more than gravity. [m/s2]
    plate_force : float
        Of the layer on the plate, as a magnitude. [N]

    """

    plate_strain: float
    contact_strain: float
    acceleration: float
    plate_force: float


class ThrowStepper(ABC):
    """
    A throw in real time: state and field of the rig at any time, going forward.

    Attributes
    ----------
    rig : Rig
        The rig.
    field_points : int
        Heights at which `read_field` and `sample_field` give the layer.
    state : ndarray, shape (7,)
        At exactly the time that was asked for last, and always the same array: `TIME` [s],
        `PLATE_POSITION` and `PROJECTILE_POSITION` (of the lower face) up from the plate's
        position at rest [m], `PLATE_VELOCITY` and `PROJECTILE_VELOCITY` [m/s], `PLATE_FORCE`
        and `PROJECTILE_FORCE` of the layer on each, up [N].

    Notes
    -----
    What comes out at some time depends on that time alone, to the last bit: not on the times
    that were asked for before, nor (given the samples) on how they were fed. Nothing is allocated
    after construction, except by `feed` and `events`, and nothing holds Python's lock for longer
    than a call takes to begin and end.

    """

    rig: Rig
    field_points: int
    state: Floats
    _is_fed = False
    _fed = ''
    _last_fed = -math.inf
    _path: Floats
    """How the plate moves."""
    _core: NDArray[np.void]
    """Records, of which the second is at the present time; with the fields used below."""
    _memory: tuple[Any, ...]
    """What kernels take besides their own arguments."""
    _advance: Callable[..., int]
    """Kernel that goes to a time; it returns the number of events, or what is wrong."""
    _sample: Callable[..., tuple[int, int]]
    """Kernel that goes through times; it returns the row it came to, and what is wrong there."""
    _scratch: Any
    """What the latter needs besides."""
    _changing: tuple[str, ...]
    """Names of the arrays that hold what changes, without the path and the events."""

    def __init__(self, rig: Rig, field_points: int) -> None:
        self.rig = rig
        self.field_points = checked_count('field_points', field_points, low=2, high=1 << 20)
        self._events = np.zeros((MAX_EVENTS, 3))
        self._checked: tuple[Floats | None, Floats | None] = (None, None)

    def reset(self) -> None:
        """Go back to time 0, everything at rest; samples fed are forgotten."""
        self._fed = ''
        self._last_fed = -math.inf
        self._put_to_rest()
        self._advance(0.0, *self._memory)

    @abstractmethod
    def _put_to_rest(self) -> None:
        """Have the kernel forget everything."""

    def advance_to(self, time: float) -> int:
        """
        Go forward to `time`, however far, and bring `state` there.

        Parameters
        ----------
        time : float
            Since the start, not before the time of the last call. [s]

        Returns
        -------
        int
            Releases and landings so far.

        Raises
        ------
        ValueError
            If `time` is not finite or goes backwards.
        HorizonError
            If the plate is not known that far ahead; nothing has changed.
        EventLimitError
            If there were too many events on the way; only `reset` helps.

        """
        count = self._advance(float(time), *self._memory)
        if count < 0:
            raise self._refusal(count, time)
        return count

    def _refusal(self, status: int, time: float) -> Exception:
        """Say what is wrong."""
        if status == BEYOND_HORIZON:
            return HorizonError(f'the plate is known until {self.horizon:g} s, got {time:g} s')
        if status == TOO_MANY_EVENTS:
            return EventLimitError(
                f'more than {MAX_EVENTS} releases and landings before {time:g} s'
            )
        if status == TOO_FAR or math.isnan(time):
            return ValueError(f'time must be finite and within 4e15 steps, got {time:g} s')
        return ValueError(
            f'time must not go backwards, got {time!r} s after {float(self.state[TIME])!r} s'
        )

    def feed(
        self,
        times: ArrayLike,
        *,
        positions: ArrayLike | None = None,
        velocities: ArrayLike | None = None,
    ) -> None:
        """
        Take in samples of the plate, measured while it runs.

        Parameters
        ----------
        times : array_like, shape (n,)
            Increasing, from call to call too; the first not negative. [s]
        positions, velocities : array_like, shape (n,)
            One of them, the same in every call. Heights count from the first sample. [m], [m/s]

        Raises
        ------
        ValueError
            If the stepper was not made with the motion 'measured', or samples are not finite,
            not increasing, or not of one kind. None is taken then.
        FeedFullError
            If they are more than `FEED_SEGMENTS` ahead of `advance_to`. None is taken then.

        Notes
        -----
        Slope and curvature at a sample are those of the quartic through it and two samples on
        either side. Positions are joined by quintics with a continuous acceleration, fourth order
        in velocity; velocities by cubics with a continuous acceleration, fourth order too.

        So the plate is known (`horizon`) up to the last sample but two, and before the fifth
        sample up to the first, before which it is at rest: driven by samples of a live rig, the
        twin is two samples late.

        """
        if not self._is_fed:
            raise ValueError("feed needs a stepper made with motion 'measured'")
        if (positions is None) == (velocities is None):
            raise ValueError('feed needs either positions or velocities, got both or neither')
        kind = 'velocities' if positions is None else 'positions'
        if self._fed not in ('', kind):
            raise ValueError(f'{self._fed} were fed before, got {kind}; call reset in between')
        values = velocities if positions is None else positions
        times, values = checked_samples(times, values, kind, after=self._last_fed)
        if not times.size:
            return
        self._check_room(times.size)
        self._take_samples(times, values, positions is not None)
        self._fed = kind
        self._last_fed = float(times[-1])

    def feed_states(self, times: ArrayLike, states: ArrayLike) -> None:
        """
        Take in states of the plate, as a filter gives them while it runs.

        Parameters
        ----------
        times : array_like, shape (n,)
            As for `feed`. [s]
        states : array_like, shape (n, 3)
            Height, velocity and acceleration at each. [m], [m/s], [m/s2]

        Raises
        ------
        ValueError, FeedFullError
            As by `feed`, the two of which cannot be mixed.

        Notes
        -----
        States are joined by quintics, sixth order in height. The plate is known up to the last
        state, before the second one up to the first.

        """
        if not self._is_fed:
            raise ValueError("feed_states needs a stepper made with motion 'measured'")
        if self._fed not in ('', 'states'):
            raise ValueError(f'{self._fed} were fed before, got states; call reset in between')
        rows = np.ascontiguousarray(states, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise ValueError(f'states must be of shape (n, 3), got {rows.shape}')
        times = np.ascontiguousarray(times, dtype=np.float64)
        if times.shape != rows.shape[:1] or not _go_on(times, rows, self._last_fed):
            checked_samples(times, rows.sum(axis=1), 'states', after=self._last_fed)
        if not times.size:
            return
        self._check_room(times.size)
        self._take_states(times, rows)
        self._fed = 'states'
        self._last_fed = float(times[-1])

    def _check_room(self, count: int) -> None:
        ahead = int(self._core[0]['pieces'] - self._core[1]['piece']) + count
        if ahead > FEED_SEGMENTS:
            raise FeedFullError(
                f'samples must not be more than {FEED_SEGMENTS} ahead of advance_to, '
                f'got {count} which makes {ahead}'
            )

    @abstractmethod
    def _take_samples(self, times: Floats, values: Floats, of_positions: bool) -> None:
        """Hand checked samples to the kernel."""

    @abstractmethod
    def _take_states(self, times: Floats, states: Floats) -> None:
        """Hand checked states to the kernel."""

    def scout(self) -> ThrowStepper:
        """
        Make a stepper that can go ahead of this one, see `depart`.

        The two share what is known of the plate, and the memory for events: `events` of the scout
        are right until this stepper goes on.

        Raises
        ------
        ValueError
            If this stepper was not made with the motion 'measured'.

        """
        if not self._is_fed:
            raise ValueError("scout needs a stepper made with motion 'measured'")
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        copies = {id(getattr(self, name)): name for name in self._changing}
        for name in self._changing:
            setattr(other, name, getattr(self, name).copy())
        other._memory = tuple(
            getattr(other, copies[id(part)]) if id(part) in copies else part
            for part in self._memory
        )
        other._checked = (None, None)
        other.state = other._core['state'][1]
        other.state.flags.writeable = False
        other._is_fed = False
        return other

    def depart(self, origin: ThrowStepper) -> None:
        """
        Take over where `origin`, of which this is a scout, is now, and go ahead from there.

        From its horizon on, the plate keeps the acceleration it has there. What a wave from the
        plate has not reached yet does not depend on that: in a layer between plate and projectile
        the projectile is as it will be for one crossing of the wave beyond the horizon of
        `origin`, to the order of the model. Internal loss spreads in no time: a loss tangent of
        0.05 makes the velocity uncertain by 2e-3 of its scale at the end of that time.

        Parameters
        ----------
        origin : ThrowStepper
            Which has made this one.

        """
        for name in self._changing:  # as bytes, since records are copied field by field
            getattr(self, name).view(np.uint8)[:] = getattr(origin, name).view(np.uint8)
        _coast(self._core, self._path)

    def read_field(self, strain: Floats, velocity: Floats) -> None:
        """
        Write what the layer does at the present time, from plate to top.

        Parameters
        ----------
        strain, velocity : ndarray, shape (field_points,)
            Of float64, written to: total strain [-], and velocity [m/s].

        Raises
        ------
        ValueError
            If an array does not fit.

        """
        if self._checked[0] is not strain or self._checked[1] is not velocity:
            check_target('strain', strain, (self.field_points,))
            check_target('velocity', velocity, (self.field_points,))
            self._checked = (strain, velocity)
        self._read_field(strain, velocity)

    @abstractmethod
    def _read_field(self, strain: Floats, velocity: Floats) -> None:
        """Have the kernel write the field."""

    def sample_field(self, times: ArrayLike, out: Floats) -> None:
        """
        Go forward through `times`, and write the total strain at each into a row of `out`.

        Parameters
        ----------
        times : array_like, shape (n,)
            As for `advance_to`. [s]
        out : ndarray, shape (n, field_points)
            Of float64, written to. [-]

        Raises
        ------
        ValueError
            If `out` does not fit; else as `advance_to`, with the rows before it written.

        """
        times = np.ascontiguousarray(times, dtype=np.float64)
        if times.ndim != 1:
            raise ValueError(f'times must be a series, got shape {times.shape}')
        check_target('out', out, (times.size, self.field_points))
        row, status = self._sample(times, out, self._scratch, *self._memory)
        if status < 0:
            raise self._refusal(status, float(times[row]))

    @property
    def horizon(self) -> float:
        """Until when `advance_to` can go, since the plate is known. [s]"""
        return float(self._core['horizon'][0])

    @property
    def in_contact(self) -> bool:
        """Whether the projectile lies on the layer."""
        return bool(self._core['contact'][1])

    @property
    def event_count(self) -> int:
        """Releases and landings so far."""
        return int(self._core['events'][1])

    def events(self) -> list[Event]:
        """Return releases and landings so far."""
        rows = self._events[: self.event_count].tolist()
        return [
            Event('landing' if kind else 'release', time, velocity)
            for kind, time, velocity in rows
        ]

    @property
    def rest_position(self) -> float:
        """Height of the projectile's lower face at rest. [m]"""
        return float(self._core['rest_height'][1])

    @property
    def surface_position(self) -> float:
        """Height of the top of the layer; in contact that of the projectile's lower face. [m]"""
        return float(self._core['rest_height'][1] + self._core['surface'][1])

    @property
    def highest_position(self) -> float:
        """Highest that the projectile's lower face has been so far. [m]"""
        return float(self._core['rest_height'][1] + self._core['highest'][1])

    @property
    def peaks(self) -> Peaks:
        """Largest values so far, at grid points and events."""
        return self._peaks('')

    @property
    def first_peaks(self) -> Peaks:
        """Largest values up to the first release, at grid points and events."""
        return self._peaks('first_' if self.event_count else '')

    @abstractmethod
    def _peaks(self, prefix: str) -> Peaks:
        """Read the peaks from the fields whose names begin so."""

    @property
    @abstractmethod
    def work(self) -> float:
        """Work of the plate so far, up to the last grid point. [J]"""

    @property
    @abstractmethod
    def peak_work(self) -> float:
        """Largest work of the plate so far: what the engine has to have handed out. [J]"""

    @property
    def dissipated(self) -> float:
        """Energy that the layer has turned to heat so far. [J]"""
        return 0.0

    @abstractmethod
    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, at the present time. [J]"""


@nb.njit(cache=True, nogil=True)
def _go_on(times: Floats, rows: Floats, last: float) -> bool:
    """Tell if states are finite, and times increase after the last one and are not negative."""
    for n in range(times.size):
        if not (last < times[n] < math.inf and times[n] >= 0.0):
            return False
        if not np.isfinite(rows[n]).all():
            return False
        last = times[n]
    return True


@nb.njit(cache=True, nogil=True)
def _coast(core: NDArray[np.void], path: Floats) -> None:
    """Let the plate go on from where it is known."""
    coast(core[0], path)
    core[1].horizon = core[0].horizon


def checked_count(name: str, value: Any, *, low: int, high: int) -> int:
    """Return a whole number within limits, or raise ValueError."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise ValueError(f'{name} must be a whole number, got {value!r}')
    if not low <= value <= high:
        raise ValueError(f'{name} must be from {low} to {high}, got {value}')
    return int(value)


def check_target(name: str, array: Any, shape: tuple[int, ...]) -> None:
    """Raise ValueError unless a kernel can write to `array`."""
    if (
        not isinstance(array, np.ndarray)
        or array.dtype != np.float64
        or array.shape != shape
        or not (array.flags.c_contiguous and array.flags.writeable)
    ):
        got = (
            f'{array.dtype} of shape {array.shape}'
            if isinstance(array, np.ndarray)
            else type(array).__name__
        )
        raise ValueError(f'{name} must be a contiguous float64 array of shape {shape}, got {got}')
