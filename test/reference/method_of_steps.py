# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
The travelling-wave model for any plate motion, through every release and landing.

Notes
-----
At the top of the layer the upward wave :math:`p` and the downward wave :math:`q` obey

.. math::

    p(t) = V_p(t - t_s) - q(t - 2 t_s), \qquad
    q = V_m - p \ \text{(contact)}, \qquad q = p + g \tau \ \text{(flight)}

(about the static equilibrium), and in contact :math:`\tau \dot V_m + V_m = 2 p`. Since p only
needs q of two crossings ago, time is cut into pieces within which all is smooth: at the kinks
that the start, the samples of the plate and every event send up and down the layer, and wherever
24 Chebyshev coefficients would not reach rounding. On a piece the equation of the mass is one
small linear system, and events are roots of polynomials. The result is exact to about 1e-12 of
the plate's speed, without a step size.

"""

from __future__ import annotations

import bisect
import heapq
from itertools import pairwise
import math
from typing import Literal

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.plate import motion_of, PlateMotion, SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event

Floats = NDArray[np.float64]

_SIZE = 24  # coefficients of a piece
_TOLERANCE = 1e-13  # of the plate's speed, for the last coefficients
_MAX_PIECES = 100_000
# Chebyshev points of the first kind (never at an end), and the matrices that give coefficients
# from the values there, and those of the integral from -1, cut off at the same size
_NODES: Floats = np.cos(np.pi * (np.arange(_SIZE) + 0.5) / _SIZE)
_TO_COEFFICIENTS: Floats = np.linalg.inv(chebyshev.chebvander(_NODES, _SIZE - 1))
_INTEGRAL: Floats = np.stack(
    [chebyshev.chebint(row, lbnd=-1)[:_SIZE] for row in np.eye(_SIZE)], axis=1
)
_IDENTITY = np.eye(_SIZE)
_AT_END = np.ones(_SIZE)


class _Series:
    """A function of time as Chebyshev pieces laid end to end, constant 0 before the first."""

    def __init__(self, start: float) -> None:
        self.edges = [start]
        self.pieces: list[Floats] = []
        self._stack: Floats | None = None

    def append(self, end: float, coefficients: Floats) -> None:
        self.edges.append(end)
        self.pieces.append(coefficients)
        self._stack = None

    def __call__(self, times: Floats) -> Floats:
        """Evaluate; times after the last piece are taken as at its end."""
        if not self.pieces:
            return np.zeros_like(times)
        first = bisect.bisect_right(self.edges, float(times.min())) - 1
        last = bisect.bisect_right(self.edges, float(times.max())) - 1
        if first == last and 0 <= first < len(self.pieces):
            start, end = self.edges[first], self.edges[first + 1]
            x = (2.0 * times - (start + end)) / (end - start)
            return np.asarray(chebyshev.chebval(x, self.pieces[first]))
        if self._stack is None:
            self._stack = np.array(self.pieces)
        edges = np.asarray(self.edges)
        index = np.searchsorted(edges, times, side='right') - 1
        inside = np.clip(index, 0, len(self.pieces) - 1)
        lefts, rights = edges[inside], edges[inside + 1]
        x = np.clip((2.0 * times - (lefts + rights)) / (rights - lefts), -1.0, 1.0)
        values = chebyshev.chebval(x, np.moveaxis(self._stack[inside], -1, 0), tensor=False)
        return np.where(index < 0, 0.0, values)


class WaveHistory:
    """
    All that happens in one throw, from rest to the last event asked for.

    Made by `follow`. Times are those of the plate's motion.

    Attributes
    ----------
    events : tuple of Event
        In order; the first is a release. Empty if the projectile never left in the time given.
    end_time : float
        Until when everything is known. [s]

    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.motion = motion_of(rig.engine)
        self._crossing = rig.crossing_time
        start = float(_knots(self.motion)[0]) + self._crossing
        self._down = _Series(start)  # q at the top
        self._mass_velocity = _Series(start)
        self._mass_rise = _Series(start)
        self.events: tuple[Event, ...] = ()

    @property
    def end_time(self) -> float:
        """Until when everything is known [s]."""
        return self._down.edges[-1]

    def upward(self, times: Floats) -> Floats:
        """Upward wave at the top, p; known for one crossing more than the rest [m/s]."""
        return self.motion.velocity(times - self._crossing) - self._down(
            times - 2.0 * self._crossing
        )

    def projectile_velocity(self, time: ArrayLike) -> Floats:
        """Velocity of the projectile, upwards [m/s]."""
        return self._mass_velocity(self._known(time))

    def projectile_position(self, time: ArrayLike) -> Floats:
        """Height of the projectile's lower face above the plate's rest position [m]."""
        return self.rig.rest_height + self._mass_rise(self._known(time))

    def velocity(self, depth: ArrayLike, time: ArrayLike) -> Floats:
        """Velocity of the material at undeformed depths [m] from the plate, upwards [m/s]."""
        up, down = self._waves(depth, time)
        return up + down

    def strain(self, depth: ArrayLike, time: ArrayLike) -> Floats:
        """Strain of the layer, negative in compression, with the weight's static part [-]."""
        up, down = self._waves(depth, time)
        static = self.rig.gravity * self.rig.relaxation_time
        return (down - up - static) / self.rig.layer.wave_speed

    def contact_force(self, time: ArrayLike) -> Floats:
        """Force of the layer on the projectile, upwards: 0 in flight [N]."""
        time = self._known(time)
        pushed = self.rig.layer.impedance * (self.upward(time) - self._down(time))
        force = pushed + self.rig.projectile.mass * self.rig.gravity
        return np.where(self._touching(time), force, 0.0)

    def plate_force(self, time: ArrayLike) -> Floats:
        """Force of the layer on the plate, upwards: negative when the plate pushes [N]."""
        time = self._known(time)
        wave = 2.0 * self._down(time - self._crossing) - self.motion.velocity(time)
        weight = self.rig.projectile.mass * self.rig.gravity
        return self.rig.layer.impedance * wave - weight

    def _known(self, time: ArrayLike) -> Floats:
        time = np.asarray(time, dtype=np.float64)
        assert not time.size or time.max() <= self.end_time, 'follow the throw for longer'
        return time

    def _waves(self, depth: ArrayLike, time: ArrayLike) -> tuple[Floats, Floats]:
        """Upward and downward wave at (depth, time)."""
        depth = np.asarray(depth, dtype=np.float64)
        from_top = (self.rig.layer.thickness - depth) / self.rig.layer.wave_speed
        time = self._known(time)
        return self.upward(time + from_top), self._down(time - from_top)

    def _touching(self, time: Floats) -> NDArray[np.bool_]:
        """Return the times in contact with the layer as a mask; a release counts as contact."""
        passed = np.searchsorted([event.time for event in self.events], time, side='left')
        return np.asarray(passed % 2 == 0)


def follow(rig: Rig, *, until: float | None = None, max_events: int | None = None) -> WaveHistory:
    """Follow a throw from rest to `until` [s], or so many events, or else to the first landing."""
    assert not rig.layer.needs_cells
    return _Follower(rig, until, max_events).run()


class _Follower:
    """The march through the pieces."""

    def __init__(self, rig: Rig, until: float | None, max_events: int | None) -> None:
        self.history = WaveHistory(rig)
        motion = self.history.motion
        self.tau: float = rig.relaxation_time
        self.crossing: float = rig.crossing_time
        self.gravity = rig.gravity
        self.lift = rig.gravity * rig.relaxation_time
        self.scale = motion.peak_velocity
        self.max_events = max_events
        self.until = math.inf if until is None else until
        self.kinks: list[float] = (_knots(motion) + self.crossing).tolist()
        heapq.heapify(self.kinks)
        self.time = float(heapq.heappop(self.kinks))
        heapq.heappush(self.kinks, self.time + 2.0 * self.crossing)
        self.flying = False
        self.velocity = 0.0
        self.rise = 0.0
        self.top = 0.0
        self.events: list[Event] = []

    def run(self) -> WaveHistory:
        """March until an end condition holds."""
        length = self.crossing
        for _ in range(_MAX_PIECES):
            if self.time >= self.until or self._is_over():
                self.history.events = tuple(self.events)
                return self.history
            end = min(self._next_kink(), self.until)
            length = self._advance(min(end, self.time + length), end)
        raise RuntimeError(f'more than {_MAX_PIECES} pieces until {self.time:g} s')

    def _next_kink(self) -> float:
        """First kink clearly after now; those reached are sent round the layer again."""
        while self.kinks[0] <= self.time * (1.0 + 4e-16) + 1e-13 * self.crossing:
            kink = heapq.heappop(self.kinks)
            heapq.heappush(self.kinks, kink + 2.0 * self.crossing)
        return self.kinks[0]

    def _is_over(self) -> bool:
        if self.max_events is not None:
            return len(self.events) >= self.max_events
        landed = any(event.kind == 'landing' and event.velocity <= 0.0 for event in self.events)
        return landed and self.until == math.inf

    def _advance(self, end: float, limit: float) -> float:
        """Do one piece, shorter than asked if it must be; return the next length to try."""
        start = self.time
        while True:
            half = 0.5 * (end - start)
            upward = _TO_COEFFICIENTS @ self.history.upward(start + half * (_NODES + 1.0))
            rate = half / self.tau
            if self.flying:
                velocity = np.zeros(_SIZE)
                velocity[0] = self.velocity - self.gravity * half
                velocity[1] = -self.gravity * half
                tail = upward[-3:]
            else:
                source = 2.0 * rate * (_INTEGRAL @ upward)
                source[0] += self.velocity
                velocity = np.asarray(
                    np.linalg.solve(_IDENTITY + rate * _INTEGRAL, source), np.float64
                )
                tail = np.concatenate((upward[-3:], velocity[-3:]))
            if np.abs(tail).max() <= _TOLERANCE * self.scale or half < 1e-12 * self.crossing:
                break
            end = 0.5 * (start + end)
        event = self._first_event(half, upward, velocity)
        if event is not None:
            end = float(start + half * (event + 1.0))
            upward, velocity = _cut(upward, event), _cut(velocity, event)
            half = 0.5 * (end - start)
        if end > start:  # otherwise the event comes at once
            self._store(end, half, upward, velocity)
        if event is not None:
            self._happen(end)
            return max(self.crossing * 1e-3, min(self.tau, self.crossing))
        return limit - start if end == limit else 2.0 * (end - start)

    def _first_event(self, half: float, upward: Floats, velocity: Floats) -> float | None:
        """Where in [-1, 1] the force turns to pull, or the gap closes; None if it does not."""
        if self.flying:
            opening = velocity - 2.0 * upward
            opening[0] -= self.lift
            gap = half * (_INTEGRAL @ opening)
            gap[0] += self.rise - self.top
            return _first_negative(gap, 1e-14 * self.scale * half)
        force = 2.0 * upward - velocity
        force[0] += self.lift
        return _first_negative(force, 1e-14 * self.scale)

    def _store(self, end: float, half: float, upward: Floats, velocity: Floats) -> None:
        """Lay the piece down and move on."""
        history = self.history
        rise = half * (_INTEGRAL @ velocity)
        rise[0] += self.rise
        if self.flying:
            down = upward.copy()
            down[0] += self.lift
            top = half * (_INTEGRAL @ (upward + down))
            top[0] += self.top
        else:
            down = velocity - upward
            top = rise
        history._down.append(end, down)
        history._mass_velocity.append(end, velocity)
        history._mass_rise.append(end, rise)
        self.time = end
        self.velocity = float(velocity @ _AT_END)
        self.rise = float(rise @ _AT_END)
        self.top = float(top @ _AT_END)

    def _happen(self, time: float) -> None:
        """Change between contact and flight."""
        kind: Literal['release', 'landing'] = 'landing' if self.flying else 'release'
        height = self.history.rig.rest_height + self.rise
        self.events.append(Event(kind, time, height, self.velocity))
        self.flying = not self.flying
        self.rise = self.top
        heapq.heappush(self.kinks, time + 2.0 * self.crossing)


def _cut(coefficients: Floats, x: float) -> Floats:
    """Coefficients of the same polynomial on [-1, x], stretched to [-1, 1]."""
    return _TO_COEFFICIENTS @ chebyshev.chebval(
        0.5 * (x + 1.0) * (_NODES + 1.0) - 1.0, coefficients
    )


def _first_negative(coefficients: Floats, noise: float) -> float | None:
    """Return the left end of the first interval of [-1, 1] where a polynomial is below -noise."""
    if coefficients[0] > np.abs(coefficients[1:]).sum():
        return None
    trimmed = chebyshev.chebtrim(coefficients, tol=1e-3 * noise)
    if trimmed.size < 2:
        return -1.0 if trimmed[0] < -noise else None
    roots = chebyshev.chebroots(trimmed)
    real = np.sort(roots[np.abs(roots.imag) < 1e-7].real)
    edges = np.concatenate(([-1.0], real[(real > -1.0) & (real < 1.0)], [1.0]))
    for start, end in pairwise(edges):
        middle = chebyshev.chebval(0.5 * (start + end), coefficients)
        if middle < -noise:
            return _polished(coefficients, start) if start > -1.0 else -1.0
    return None


def _polished(coefficients: Floats, root: float) -> float:
    """Improve a simple root by two Newton steps."""
    slope = chebyshev.chebder(coefficients)
    for _ in range(2):
        change = chebyshev.chebval(root, coefficients) / chebyshev.chebval(root, slope)
        if abs(change) < 1e-4:
            root -= change
    return float(min(max(root, -1.0), 1.0))


def _knots(motion: PlateMotion) -> Floats:
    """Return the times at which a motion is not smooth, the start first [s]."""
    return motion.times if isinstance(motion, SampledMotion) else np.zeros(1)
