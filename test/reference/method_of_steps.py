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
needs q of two crossings ago, time is cut into smooth pieces: at the kinks that the start, the
samples of the plate and every event send up and down the layer, and wherever 24 Chebyshev
coefficients would not reach rounding. The equation of the mass is a small linear system, events
are roots of polynomials, and the result is exact to about 1e-12 of the plate's speed.

"""

from __future__ import annotations

import bisect
import heapq
from itertools import pairwise
import math

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.plate import motion_of, SampledMotion
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


class WaveHistory:
    """All that happens in one throw, from rest to the last event asked for; made by `follow`."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.motion = rig, motion_of(rig.engine)
        self.events: list[Event] = []
        self._crossing, self._tau = rig.crossing_time, rig.relaxation_time
        self._lift = rig.gravity * rig.relaxation_time
        knots = self.motion.times if isinstance(self.motion, SampledMotion) else np.zeros(1)
        self._kinks: list[float] = (knots + self._crossing).tolist()  # increasing, so a heap
        start = self._kinks[0]
        heapq.heapreplace(self._kinks, start + 2.0 * self._crossing)
        self._edges = [start]
        self._pieces: list[Floats] = []  # coefficients of q at the top, V_m, and its integral
        self._velocity = self._rise = self._top = 0.0  # at the end

    @property
    def end_time(self) -> float:
        """Until when everything is known [s]."""
        return self._edges[-1]

    def _evaluate(self, row: int, time: ArrayLike) -> Floats:
        """Evaluate a row of the pieces, which is 0 before the first one."""
        times = np.asarray(time, dtype=np.float64)
        flat = times.ravel()
        assert flat.max() <= self.end_time * (1.0 + 1e-12), 'follow the throw for longer'
        numbers = np.array([bisect.bisect_right(self._edges, t) - 1 for t in flat.tolist()])
        numbers = np.minimum(numbers, len(self._pieces) - 1)
        values = np.zeros(flat.size)
        for n in set(numbers[numbers >= 0].tolist()):
            low, high = self._edges[n:n + 2]
            x = (2.0 * flat[numbers == n] - (low + high)) / (high - low)
            values[numbers == n] = chebyshev.chebval(np.minimum(x, 1.0), self._pieces[n][row])
        return values.reshape(times.shape)

    def upward(self, time: Floats) -> Floats:
        """Upward wave at the top, p; known for one crossing more than the rest [m/s]."""
        down = self._evaluate(0, time - 2.0 * self._crossing)
        return self.motion.velocity(time - self._crossing) - down

    def projectile_velocity(self, time: ArrayLike) -> Floats:
        """Velocity of the projectile, upwards [m/s]."""
        return self._evaluate(1, time)

    def projectile_position(self, time: ArrayLike) -> Floats:
        """Height of the projectile's lower face above the plate's rest position [m]."""
        return self.rig.rest_height + self._evaluate(2, time)

    def velocity(self, depth: Floats, time: float) -> Floats:
        """Velocity of the material at undeformed depths [m] from the plate, upwards [m/s]."""
        up, down = self._waves(depth, time)
        return up + down

    def strain(self, depth: Floats, time: float) -> Floats:
        """Strain of the layer, negative in compression, with the weight's static part [-]."""
        up, down = self._waves(depth, time)
        return (down - up - self._lift) / self.rig.layer.wave_speed

    def _waves(self, depth: Floats, time: float) -> tuple[Floats, Floats]:
        """Upward and downward wave at (depth, time)."""
        from_top = (self.rig.layer.thickness - depth) / self.rig.layer.wave_speed
        return self.upward(time + from_top), self._evaluate(0, time - from_top)

    def contact_force(self, time: ArrayLike) -> Floats:
        """Force of the layer on the projectile, upwards: 0 in flight [N]."""
        time = np.asarray(time)
        wave = self.upward(time) - self._evaluate(0, time) + self._lift
        events = np.searchsorted([event.time for event in self.events], time)
        return np.where(events % 2 == 0, self.rig.layer.impedance * wave, 0.0)

    def plate_force(self, time: ArrayLike) -> Floats:
        """Force of the layer on the plate, upwards: negative when the plate pushes [N]."""
        time = np.asarray(time)
        down = self._evaluate(0, time - self._crossing)
        return self.rig.layer.impedance * (2.0 * down - self.motion.velocity(time) - self._lift)

    def next_kink(self) -> float:
        """First kink clearly after the end; those reached are sent round the layer again."""
        while self._kinks[0] <= self.end_time * (1.0 + 4e-16) + 1e-13 * self._crossing:
            heapq.heapreplace(self._kinks, self._kinks[0] + 2.0 * self._crossing)
        return self._kinks[0]

    def advance(self, end: float, limit: float) -> float:
        """Add a piece, shorter than asked if it must be; return the next length to try."""
        start, scale = self.end_time, self.motion.peak_velocity
        while True:
            half = 0.5 * (end - start)
            upward = _TO_COEFFICIENTS @ self.upward(start + half * (_NODES + 1.0))
            velocity = self._velocities(half, upward)
            last = np.abs((upward[-3:], velocity[-3:])).max()
            if last <= _TOLERANCE * scale or half < 1e-12 * self._crossing:
                break
            end = 0.5 * (start + end)
        in_flight = len(self.events) % 2
        excess, noise = 2.0 * upward - velocity, 1e-14 * scale  # of the force
        excess[0] += self._lift
        if in_flight:  # of the gap
            excess, noise = -half * (_INTEGRAL @ excess), noise * half
            excess[0] += self._rise - self._top
        event = _first_negative(excess, noise)
        if event is not None:
            end = float(start + half * (event + 1.0))
            upward, velocity = _cut(upward, event), _cut(velocity, event)
            half = 0.5 * (end - start)
        if end > start:  # otherwise the event comes at once
            down, rise = velocity - upward, half * (_INTEGRAL @ velocity)
            rise[0] += self._rise
            if in_flight:
                down = upward.copy()
                down[0] += self._lift
                self._top += float((half * (_INTEGRAL @ (upward + down))).sum())
            self._edges.append(end)
            self._pieces.append(np.stack((down, velocity, rise)))
            self._velocity, self._rise = float(velocity.sum()), float(rise.sum())
        if event is None:
            return limit - start if end == limit else 2.0 * (end - start)
        height = self.rig.rest_height + self._rise
        self.events.append(
            Event('landing' if in_flight else 'release', end, height, self._velocity)
        )
        if in_flight:
            self._rise = self._top
        else:
            self._top = self._rise
        heapq.heappush(self._kinks, end + 2.0 * self._crossing)
        return max(self._crossing * 1e-3, min(self._tau, self._crossing))

    def _velocities(self, half: float, upward: Floats) -> Floats:
        """Coefficients of V_m on the next piece, of half a length."""
        if len(self.events) % 2:
            fall = self.rig.gravity * half
            return np.pad([self._velocity - fall, -fall], (0, _SIZE - 2))
        rate = half / self._tau
        source = 2.0 * rate * (_INTEGRAL @ upward)
        source[0] += self._velocity
        return np.asarray(np.linalg.solve(np.eye(_SIZE) + rate * _INTEGRAL, source))


def follow(rig: Rig, *, until: float = math.inf, max_events: int | None = None) -> WaveHistory:
    """Follow a throw from rest to `until` [s], or so many events, or else to the first landing."""
    assert not rig.layer.needs_cells
    history, length = WaveHistory(rig), rig.crossing_time
    for _ in range(_MAX_PIECES):
        events = history.events
        is_over = until == math.inf and any(
            event.kind == 'landing' and event.velocity <= 0.0 for event in events
        )
        if max_events is not None:
            is_over = len(events) >= max_events
        if is_over or history.end_time >= until:
            return history
        limit = min(history.next_kink(), until)
        length = history.advance(min(limit, history.end_time + length), limit)
    raise RuntimeError(f'more than {_MAX_PIECES} pieces until {history.end_time:g} s')


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
    for start, end in pairwise(edges.tolist()):
        if chebyshev.chebval(0.5 * (start + end), coefficients) < -noise:
            return float(start)
    return None
