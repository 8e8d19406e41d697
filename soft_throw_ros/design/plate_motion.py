# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
r"""
Find the motion of the plate that throws best within what an actuator can do.

Notes
-----
As long as the projectile lies on the layer, all that happens is linear in the plate's motion and
does not depend on when it starts. So one answer of the stepper to one short pulse of the plate's
velocity tells what any motion does: a motion is a row of such pulses, and velocities and forces
add up. To be as fast as possible at some time T, with the layer pushing all the while, and within
limits of speed, acceleration, jerk and travel, is then a linear programme in the heights of the
pulses, whose optimum is global [1]_. A plate may always wait before it starts, so the speed grows
with T; the shortest T is taken that gives nearly as much as the longest.

Pulses are quadratic B-splines. Their heights bound velocity, acceleration and jerk at all times,
not only on the grid, and what they add up to is a cubic spline in height, which a file of times
and heights holds without loss. They are a whole number of nanoseconds apart, as the times of a
trajectory for a controller are. What a motion gives is then followed by the exact stepper to its
end: motions that meet the projectile again, or throw it off too early, are left out.

Loss and stacks are linear, too. For a neo-Hookean layer the programme takes the linear one that it
is when it is hardly strained, but what follows is the layer itself: of programmes for several
times of release, the motion counts that throws best with it.

Nothing after T less a crossing of the wave can be felt by the projectile; there the plate brakes.

References
----------
.. [1] L. Schork, J. Gondzio, "Implementation of an interior point method with basis
   preconditioning", Math. Prog. Comp. 12 (2020): of HiGHS, by `scipy.optimize.linprog`.

"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts are imported where they are first used, which takes 0.3 s
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.plate import motion_of, SampledMotion
from soft_throw_ros.core.rig import Engine, Layer, Rig, Stack
from soft_throw_ros.core.stepper import EventLimitError, PROJECTILE_FORCE, PROJECTILE_VELOCITY
from soft_throw_ros.core.throw import make_stepper, simulate, Throw, ThrowUnfinishedError
from soft_throw_ros.design.evaluate import Cancelled, check_cancelled, model_for, SEARCH_CELLS
from soft_throw_ros.design.objective import Limits

Floats = NDArray[np.float64]

_COARSE, _FINE = (12, 120), (64, 300)  # pulses in a crossing of the wave, and at most until T
_WORTH = 1e-3  # part of the speed for which it is not worth to wait longer
_FINER = 2  # times as often as there are pulses the layer has to push
_PRESSED = 0.2  # part of the weight with which a plate must push, whatever it does, ...
_PUSH = 1e-3  # and of speed times impedance while the wave is in the layer
_AS_PROMISED = 0.01  # part of the speed by which a motion may miss what the programme promised
_FLOORS = (1.0, 4.0)  # times these, to be tried in turn if a motion fails, ...
_LONGER = (1.0, 0.95, 1.06, 0.85, 0.6, 0.4)  # and times of release
_OPTIMAL, _INFEASIBLE = 0, 2  # statuses of `linprog`
_LONGEST = 10.0  # that a programme may take; it takes a second [s]
_ROUNDING = 1e-12
_LAYERS = 7  # along an axis of the grid on which the search for a layer begins


@dataclass(frozen=True, kw_only=True)
class PlateLimits:
    """
    What an actuator can do.

    Parameters
    ----------
    speed, acceleration, jerk, travel : float
        Largest magnitudes; travel is from the lowest to the highest position; all but the speed
        may be infinite. [m/s], [m/s2], [m/s3], [m]

    Raises
    ------
    ValueError
        If a value is not positive, or the speed not finite.

    """

    speed: float
    acceleration: float = math.inf
    jerk: float = math.inf
    travel: float = math.inf

    def __post_init__(self) -> None:
        checks.require_positive('speed', self.speed)
        for name in ('acceleration', 'jerk', 'travel'):
            if getattr(self, name) != math.inf:
                checks.require_positive(name, getattr(self, name))

    @classmethod
    def of(cls, engine: Engine) -> PlateLimits:
        """Return what the plate of an engine does by itself; its jerk is not limited."""
        motion = motion_of(engine)
        end = motion.end_time if isinstance(motion, SampledMotion) else 2.0 / engine.frequency
        times = np.linspace(0.0, end, 20001)
        velocity = motion.velocity(times)
        return cls(
            speed=float(np.abs(velocity).max()),
            acceleration=float(np.abs(np.diff(velocity)).max() / (times[1] - times[0])),
            travel=float(np.ptp(motion.position(times))),
        )

    @property
    def peak_acceleration(self) -> float:
        """Return the largest on the way to the largest speed; less if the jerk is small [m/s2]."""
        return min(self.acceleration, math.sqrt(self.speed * self.jerk))

    @property
    def acceleration_time(self) -> float:
        """How long it takes to reach the largest acceleration [s]."""
        return self.peak_acceleration / self.jerk if self.jerk < math.inf else 0.0

    @property
    def rise_time(self) -> float:
        """How long it takes to reach the largest speed [s]."""
        return self.speed / self.peak_acceleration + self.acceleration_time


class Pulses(NamedTuple):
    """A motion of the plate: quadratic B-splines in its velocity, one after another."""

    step: float  # from one to the next [s]
    heights: Floats  # [m/s]

    def motion(self) -> SampledMotion:
        """Return it as a motion, without the rest before and after it."""
        moving = np.flatnonzero(self.heights)
        c = np.pad(self.heights[moving[0]:moving[-1] + 1], 3)
        velocity, acceleration = 0.5 * (c[1:-1] + c[2:]), np.diff(c)[1:] / self.step
        rise = self.step * velocity[:-1]
        rise = rise + self.step**2 * (2.0 * acceleration[:-1] + acceleration[1:]) / 6.0
        heights = np.append(0.0, np.cumsum(rise))
        states: Floats = np.column_stack([heights, velocity, acceleration])
        return SampledMotion(self.step * np.arange(float(len(states))), states)

    def within(self, limits: PlateLimits) -> Pulses:
        """Return them as far down as it takes to keep limits to the last bit, at all times."""
        heights, step = np.pad(self.heights, 3), self.step
        parts = [
            np.abs(heights).max() / limits.speed,
            np.abs(np.diff(heights)).max() / (limits.acceleration * step),
            np.abs(np.diff(heights, 2)).max() / (limits.jerk * step**2),
            np.ptp(np.cumsum(heights)) * step / limits.travel,
        ]
        return Pulses(step, self.heights / max(1.0, (1.0 + _ROUNDING) * max(parts)))


def with_motion(rig: Rig, motion: SampledMotion) -> Rig:
    """Return the rig with a plate that moves so."""
    return replace(rig, engine=replace(rig.engine, motion=motion))


def find_best_motion(
    rig: Rig,
    limits: PlateLimits,
    *,
    loads: Limits | None = None,
    model: str = 'travelling_wave',
    cancelled: Cancelled | None = None,
) -> Throw:
    """
    Find the motion that throws a rig's projectile fastest, at its first release.

    Parameters
    ----------
    rig : Rig
        How its own plate moves does not matter.
    limits : PlateLimits
        Of the plate.
    loads : Limits, optional
        Of them count strain and acceleration.
    model : str
        Of the layer; the travelling wave gives way to finite differences where it must.
    cancelled : callable, optional
        Asked between programmes, some tenths of a second each.

    Returns
    -------
    Throw
        With `motion`, to its end. The plate comes to rest, and does not meet the projectile again
        before that has come down.

    Raises
    ------
    ThrowUnresolvedError
        If no motion within the limits throws, or none keeps clear of the projectile.
    SearchCancelledError
        If `cancelled` says so.

    Notes
    -----
    See the module. The speed is within 0.5 % of the best, as seen beside the known optima of a
    plate that goes up as fast as it can.

    """
    loads = loads or Limits()
    model = model_for(rig, model)
    time, promised = _shortest_time(rig, limits, loads, model, cancelled)
    best: Throw | None = None
    for longer in _LONGER:
        programme = _Programme(rig, limits, loads, model, longer * time, _FINE)
        for floor in _FLOORS:
            check_cancelled(cancelled)
            pulses, _ = programme.solve(longer * time, floor)
            throw = pulses and _follow(rig, pulses.motion(), model, loads)
            if throw and (best is None or throw.ejection_speed > best.ejection_speed):
                best = throw
            is_exact = rig.layer.elasticity == 'linear'
            if best and is_exact and best.ejection_speed > (1.0 - _AS_PROMISED) * promised:
                return best
            if throw and not is_exact:
                break
    if best is None:
        raise ThrowUnresolvedError(
            f'no motion of the plate throws within {limits} and strain {loads.max_strain:g}, '
            f'acceleration {loads.max_acceleration:g} m/s2'
        )
    return best


def find_best_layer(
    rig: Rig,
    limits: PlateLimits,
    vary: str,
    *,
    loads: Limits | None = None,
    model: str = 'travelling_wave',
    cancelled: Cancelled | None = None,
) -> Rig:
    """
    Find the layer from which the best motion throws fastest.

    Parameters
    ----------
    vary : {'thickness', 'wave_speed', 'both'}
        What of the layer may change, within `loads`.
    rig, limits, loads, model, cancelled
        As for `find_best_motion`.

    Raises
    ------
    ThrowUnresolvedError
        If nothing is thrown.

    Notes
    -----
    The largest speed at a given time does not jump from layer to layer, as releases of a given
    motion do. So the best point of a coarse grid is improved by Nelder's and Mead's method.

    """
    loads = loads or Limits()
    model = model_for(rig, model)
    names = [name for name in ('thickness', 'wave_speed') if vary in (name, 'both')]
    box = np.log([getattr(loads, name) for name in names])

    def layer(place: Floats) -> Rig:
        values = np.exp(np.clip(place, *box.T)).tolist()
        return replace(rig, layer=replace(rig.layer, **dict(zip(names, values, strict=True))))

    def slowness(place: Floats) -> float:
        try:
            return -_shortest_time(layer(place), limits, loads, model, cancelled, is_rough=True)[1]
        except ThrowUnresolvedError:
            return 0.0

    axes = [np.linspace(low, high, _LAYERS * (3 - len(names))) for low, high in box]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(names))
    values = [slowness(place) for place in grid]
    best = grid[int(np.argmin(values))]
    if min(values) == 0.0:
        raise ThrowUnresolvedError(f'no motion of the plate throws within {limits} and {loads}')
    spacing = np.array([axis[1] - axis[0] for axis in axes])
    simplex = np.vstack([best, best + 0.4 * np.diag(spacing)])
    options = {'initial_simplex': simplex, 'xatol': 5e-3, 'fatol': 1e-4 * limits.speed}
    options['maxfev'] = 60
    found = scipy.optimize.minimize(slowness, best, method='Nelder-Mead', options=options)
    return layer(found.x)


def rest_to_rest(limits: PlateLimits, *, travel: float) -> SampledMotion:
    """
    Make the shortest motion up by `travel`: what a controller does that is given a height.

    Acceleration, speed and braking are the largest allowed; a limited jerk rounds them off.
    """
    # If the travel is short it has to brake before it is as fast as it may be
    speed = min(
        limits.speed,
        math.sqrt(travel * limits.acceleration),
        (travel**2 * limits.jerk) ** (1.0 / 3.0),
    )
    limits = replace(limits, speed=speed)
    ramp = max(speed / limits.peak_acceleration, 1e-4 * travel / speed)
    cruise = max(travel / speed - ramp, 0.0)
    step = max(0.005 * ramp, 1e-4 * cruise)
    rounded = max(limits.acceleration_time, 6.0 * step)  # a moving average limits the jerk
    times = np.arange(0.0, 2.0 * ramp + cruise + rounded + 2.0 * step, step)

    def path(t: Floats) -> Floats:
        """Integrate the trapezoid of velocities twice; at its corners the acceleration jumps."""
        corners = ((0.0, 1.0), (ramp, -1.0), (ramp + cruise, -1.0), (2.0 * ramp + cruise, 1.0))
        cubes = (sign * np.maximum(t - corner, 0.0) ** 3 for corner, sign in corners)
        return np.asarray(speed / (6.0 * ramp) * sum(cubes))

    heights = (path(times) - path(times - rounded)) / rounded
    return SampledMotion.from_positions(times, heights)


def linear_layer(layer: Layer) -> Layer:
    """Return what a layer is while it is hardly strained."""
    if isinstance(layer, Stack):
        return Stack(sheets=tuple(linear_layer(sheet) for sheet in layer.sheets))
    return replace(layer, elasticity='linear')


def _follow(rig: Rig, motion: SampledMotion, model: str, loads: Limits) -> Throw | None:
    """Follow a throw to its end; None if it meets the projectile again or exceeds a load."""
    try:
        throw = simulate(with_motion(rig, motion), model=model)
    except (ValueError, EventLimitError, ThrowUnfinishedError):
        return None
    is_within = throw.peak_strain <= loads.max_strain * (
        1.0 + 1e-3
    ) and throw.peak_acceleration <= loads.max_acceleration * (1.0 + 1e-3)
    return throw if is_within and not throw.recontacts and throw.ejection_speed > 0.0 else None


def _times(rig: Rig, limits: PlateLimits) -> Iterator[float]:
    """List times of release that may be worth it, the longest first [s]."""
    contact = rig.crossing_time * (1.5 + math.pi * math.sqrt(rig.mass_ratio + 0.4))
    longest = contact + limits.rise_time
    if rig.gravity > 0.0:
        # A plate that goes down first, no faster than the projectile falls, has a longer way up
        fall = min(limits.speed / rig.gravity, 1.5 * math.sqrt(limits.travel / rig.gravity))
        longest += fall + limits.rise_time
    yield longest
    count = max(4, math.ceil(math.log(longest / (0.6 * contact)) / 0.04))
    yield from np.geomspace(0.6 * contact, longest, count)[:-1].tolist()


def _shortest_time(
    rig: Rig,
    limits: PlateLimits,
    loads: Limits,
    model: str,
    cancelled: Cancelled | None,
    *,
    is_rough: bool = False,
) -> tuple[float, float]:
    """Find the shortest time that gives nearly the largest speed, and that."""
    longest, *shorter = _times(rig, limits)
    programme = _Programme(rig, limits, loads, model, longest, _COARSE)
    check_cancelled(cancelled)
    _, speed = programme.solve(longest)
    if not speed > 0.0:
        raise ThrowUnresolvedError(f'no motion of the plate throws within {limits}')
    if is_rough:
        return longest, speed
    low, high = 0, len(shorter)
    while low < high:
        middle = (low + high) // 2
        check_cancelled(cancelled)
        if programme.solve(shorter[middle])[1] >= (1.0 - _WORTH) * speed:
            high = middle
        else:
            low = middle + 1
    return (shorter[low] if low < len(shorter) else longest), speed


class _Programme:
    """The linear programmes for a rig, up to some time of release."""

    def __init__(
        self,
        rig: Rig,
        limits: PlateLimits,
        loads: Limits,
        model: str,
        longest: float,
        resolution: tuple[int, int],
    ) -> None:
        self._rig, self._limits, self._loads = rig, limits, loads
        per_crossing, most = resolution
        step = max(rig.crossing_time / per_crossing, longest / most)
        self._step = 1e-9 * math.ceil(1e9 * step)
        self._count = math.ceil(longest / self._step) + 1
        cells = None if model == 'travelling_wave' or resolution is _FINE else SEARCH_CELLS
        # Under a heavy weight nothing leaves; it changes nothing else. Units: [m/s], [N] per m/s
        heavy = replace(rig, layer=linear_layer(rig.layer), gravity=1e3 / self._step)
        pulse = Pulses(self._step, np.ones(1)).motion()
        stepper = make_stepper(heavy, pulse, model=model, cells=cells, field_points=2)
        rows = np.empty((_FINER * self._count, 7))
        for row, time in zip(rows, self._step / _FINER * np.arange(len(rows)), strict=True):
            stepper.advance_to(float(time))
            row[:] = stepper.state
        self._velocity = rows[::_FINER, PROJECTILE_VELOCITY]
        self._force = rows[:, PROJECTILE_FORCE] - rig.projectile.mass * heavy.gravity

    def solve(self, time: float, floor: float = 1.0) -> tuple[Pulses | None, float]:
        """
        Find the pulses that are fastest at a time, and that speed.

        The layer has to push by a little, times `floor`; at 0 it may just not pull.
        """
        rig, limits, step = self._rig, self._limits, self._step
        release = min(round(time / step), self._count - 1)
        felt = max(release - int(rig.crossing_time / step), 1)  # pulses that reach the projectile
        braking = 1.2 * limits.rise_time + 2.0 * limits.acceleration_time
        size = felt + math.ceil(braking / step) + 6
        # Unknown are the control points of the height, from before the start, in units of speed
        # and step; pulses are their differences, and steps and bends those of the pulses.
        rise, steps, bends = (_differences(order, size) for order in (1, 2, 3))
        rise = rise[:size]
        force, least = self._pushing(release, size, floor)
        most = min(
            self._loads.max_acceleration * rig.projectile.mass,
            self._loads.max_strain * rig.layer.youngs_modulus * rig.layer.section,
        ) / (limits.speed * rig.layer.impedance)
        slowest = np.where(np.arange(size) < felt, -1.0, 0.0)
        between = [
            (force @ rise, least, np.full(least.shape, most)),
            (rise, slowest, np.ones(size)),
        ]
        for matrix, limit in ((steps, limits.acceleration), (bends, limits.jerk * step)):
            if limit < math.inf:
                bound = np.ones(matrix.shape[0])
                between.append((matrix * (limits.speed / (limit * step)), -bound, bound))
        both = [sign * matrix for matrix, _, _ in between for sign in (1.0, -1.0)]
        rows = scipy.sparse.vstack(both).tocsr()
        bounds = np.concatenate([each for _, low, high in between for each in (high, -low)])
        goal = np.zeros(size)
        goal[:felt] = -self._velocity[release - np.arange(felt)]
        goal[felt:] = 1e-5 * step / rig.crossing_time  # brake as early as it does not matter
        is_limit = bounds < math.inf
        # The simplex method may take minutes where the jerk is limited, and the interior-point one
        # does not always get to an end.
        for method in ('highs-ipm', 'highs-ds'):
            found = scipy.optimize.linprog(
                goal @ rise,
                A_ub=rows[is_limit],
                b_ub=bounds[is_limit],
                bounds=(0.0, limits.travel / (limits.speed * step)),
                method=method,
                options={'time_limit': _LONGEST},
            )
            if found.status in (_OPTIMAL, _INFEASIBLE):
                break
        if found.status != _OPTIMAL:
            return None, 0.0
        pulses = limits.speed * (rise @ found.x)
        pulses[np.abs(pulses) < 1e-6 * np.abs(pulses).max()] = 0.0
        if rig.gravity == 0.0:  # while it waits, what is below zero by rounding would let go
            start = int((np.abs(pulses) > 1e-3 * np.abs(pulses).max()).argmax())
            pulses[: int(np.flatnonzero(pulses[:start] < 0.0).max(initial=-1)) + 1] = 0.0
        return Pulses(step, pulses).within(limits), float(-goal[:felt] @ pulses[:felt])

    def _pushing(
        self, release: int, size: int, floor: float
    ) -> tuple[scipy.sparse.csr_matrix, Floats]:
        """Return the force on the projectile over time, and how small it may be, against rest."""
        rig, step = self._rig, self._step / _FINER
        scale = self._limits.speed * rig.layer.impedance
        index = np.arange(1, _FINER * release + 1)[:, None] - _FINER * np.arange(size)
        rows = np.where(index > 0, self._force[np.maximum(index, 0)], 0.0) / rig.layer.impedance
        rows[np.abs(rows) < 1e-9 * np.abs(rows).max()] = 0.0
        weight = rig.projectile.mass * rig.gravity / scale
        bound = np.full(len(rows), (floor * _PRESSED - 1.0) * weight)
        times = step * np.arange(1, len(rows) + 1)
        crossing = rig.crossing_time
        inside = (times > 1.5 * crossing) & (times < times[-1] - 0.5 * crossing)
        bound[inside] += floor * _PUSH
        return scipy.sparse.csr_matrix(rows), bound


def _differences(order: int, size: int) -> scipy.sparse.csr_matrix:
    """Return what takes differences of a row that does not change before and after it."""
    sparse = scipy.sparse
    matrix = sparse.csr_matrix(sparse.diags([-1.0, 1.0], [0, 1], shape=(size, size + 1)))
    for n in range(1, order):
        shape = (size + n, size + n - 1)
        matrix = sparse.csr_matrix(sparse.diags([1.0, -1.0], [0, -1], shape=shape)) @ matrix
    return matrix
