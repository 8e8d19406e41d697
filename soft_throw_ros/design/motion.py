# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Find the motion of the plate that throws best within the limits of an actuator.

Notes
-----
While the projectile lies on the layer, the rig is linear in the plate's motion and invariant in
time. A motion is a sum of short pulses of the plate's velocity. The stepper computes the
velocities, forces and strains of one pulse; those of all pulses add up. The largest speed of the
projectile at a release time T is therefore a linear programme in the heights of the pulses, whose
optimum is global [1]_. Its constraints are a pushing contact force until T, and limits of the
plate's speed, acceleration, jerk and travel, of the layer's strain, and of the projectile's
acceleration. The speed grows with T, since the plate may wait before it starts; the shortest T
with nearly the speed of the longest is used.

The strain is limited at several heights of the layer at all times. Most limits never become
active, so the programme begins without limits of the strain, and adds the limits that its solution
exceeds, until the solution keeps all limits.

Pulses are quadratic B-splines. Their heights bound velocity, acceleration and jerk at all times.
The height of the plate is a cubic spline from rest to rest, with knots at whole nanoseconds, the
resolution of trajectory messages. A quintic then leads the plate back to its first height. The
exact stepper simulates the throw to its end. A motion that meets the projectile again is rejected,
and one that slightly exceeds a limit of the layer or the projectile is scaled down.

Loss and stacks are linear, too. For a neo-Hookean layer the programme uses the linear layer of
the same modulus at rest, but the simulation uses the neo-Hookean layer. Programmes are solved for
several times of release, and the motion with the best simulated throw is chosen.

A rig that differs by the uncertainties may throw early, where the force nearly ends. If a motion
loses more than 7 % of the speed so, it is designed once more, with a pushing contact force on the
slowest and on the fastest layer and projectile as well.

A wave that leaves the plate later than one crossing time before T cannot reach the projectile
before the release; from then on the plate brakes.

References
----------
.. [1] L. Schork, J. Gondzio, "Implementation of an interior point method with basis
   preconditioning", Math. Prog. Comp. 12 (2020): of HiGHS, by `scipy.optimize.linprog`.

"""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass, replace
import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts are imported where they are first used, which takes 0.3 s
from soft_throw_ros.core import checks
from soft_throw_ros.core.batch import Cancelled, check_cancelled, ThrowUnresolvedError
from soft_throw_ros.core.plate import motion_of, SampledMotion
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.stepper import PROJECTILE_FORCE, PROJECTILE_VELOCITY
from soft_throw_ros.core.throw import (
    make_stepper,
    rig_with,
    SEARCH_CELLS,
    simulate,
    Throw,
    throw_many,
)
from soft_throw_ros.design.prediction import gain_text, predict, PredictedThrow
from soft_throw_ros.design.score import Limits
from soft_throw_ros.design.uncertainty import Uncertainties

Floats = NDArray[np.float64]

Critical: TypeAlias = set[tuple[int, float, float]]
"""Strains that solutions exceeded: index of the height, time before the release [s], sign."""

_COARSE, _FINE = (12, 120), (64, 300)  # pulses per crossing of the wave, and until T at most
_FINER = 2  # times per pulse at which the layer has to push the projectile
_HEIGHTS = 9  # points of the layer, from plate to projectile, whose strain is limited
_WAITING_GAIN = 1e-3  # relative gain of speed that does not justify a later release [-]
_STRAIN_TOLERANCE = 2e-3  # relative excess of a strain that adds a limit to the programme [-]
_STRAIN_STRIDE = 4  # of the pulses that get a limit of the strain, beside the maxima
_MAX_ROUNDS = 12  # programmes in turn while limits of the strain are added; 3 to 6 are enough
_SMOOTHING_LOSS = 5e-4  # relative loss of speed for a motion without brief pulses [-]
_SCALINGS = 5  # most simulations that scale a motion down to the limits of its loads
_LOAD_TOLERANCE = 1e-6  # relative excess of a load that is tolerated [-]
_MIN_CONTACT_FORCE = 0.2  # smallest force on the projectile over its weight [-]
_MIN_WAVE_FORCE = 1e-3  # the same in the contact, over the largest speed times impedance [-]
_KEPT_SPEED = 0.93  # share of the speed that a motion keeps on other rigs [-]
_PROGRAMME_ERROR = 0.01  # relative deficit of the simulated speed against the programme [-]
_TIME_FACTORS = (1.0, 0.95, 1.06, 0.85, 0.6, 0.4)  # of the time of release, tried in turn
_OPTIMAL, _INFEASIBLE = 0, 2  # statuses of `linprog` that need no other method
_PROGRAMME_TIME = 60.0  # limit of the time of a programme, which takes a second [s]
_ROUNDING = 1e-12  # relative room below the limits of the plate [-]
_RETURN_SHARE = 0.25  # peak speed, acceleration and jerk of the way back, over the motion's [-]
_NO_RETURN = 1e-9  # distance from the first height that is rounding [m]

_METHODS = {'highs-ipm': 300, 'highs-ds': 20000}
"""
Methods of `linprog` in turn, with their largest numbers of iterations.

The simplex method may take minutes where the jerk is limited; the interior-point method takes 50
iterations, but does not always converge.
"""

_QUINTIC_PEAKS = (1.875, 10.0 / math.sqrt(3.0), 60.0)
"""Peak speed, acceleration and jerk of a quintic from rest to rest, of height and duration 1."""


@dataclass(frozen=True, kw_only=True)
class PlateLimits:
    """Limits of an actuator: largest magnitudes, of which all but the speed may be infinite."""

    speed: float  # [m/s]
    acceleration: float = math.inf  # [m/s2]
    jerk: float = math.inf  # [m/s3]
    travel: float = math.inf  # from the lowest to the highest position [m]

    def __post_init__(self) -> None:
        checks.require_positive('speed', self.speed)
        for name in ('acceleration', 'jerk', 'travel'):
            if getattr(self, name) != math.inf:
                checks.require_positive(name, getattr(self, name))

    @classmethod
    def of(cls, engine: Engine) -> PlateLimits:
        """Return the limits of the present motion of an engine; its jerk is not limited."""
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
        """Time to reach the largest acceleration [s]."""
        return self.peak_acceleration / self.jerk if self.jerk < math.inf else 0.0

    @property
    def rise_time(self) -> float:
        """Time to reach the largest speed [s]."""
        return self.speed / self.peak_acceleration + self.acceleration_time


class Pulses(NamedTuple):
    """A motion of the plate: a series of quadratic B-splines in its velocity."""

    step: float  # time between neighbours [s]
    heights: Floats  # coefficients of the B-splines [m/s]

    def motion(self) -> SampledMotion:
        """Return the motion, without the rest before and after it."""
        moving = np.flatnonzero(self.heights)
        c = np.pad(self.heights[moving[0]:moving[-1] + 1], 3)
        velocity, acceleration = 0.5 * (c[1:-1] + c[2:]), np.diff(c)[1:] / self.step
        rise = self.step * velocity[:-1]
        rise = rise + self.step**2 * (2.0 * acceleration[:-1] + acceleration[1:]) / 6.0
        heights = np.append(0.0, np.cumsum(rise))
        states: Floats = np.column_stack([heights, velocity, acceleration])
        return SampledMotion(self.step * np.arange(float(len(states))), states)

    def motion_and_back(self) -> SampledMotion:
        """Return the motion with a way back to its first height, slow beside the motion."""
        motion = self.motion()
        distance = abs(float(motion.states[-1, 0]))
        if distance <= _NO_RETURN:
            return motion
        changes = (np.diff(np.pad(self.heights, 3), n) / self.step**n for n in range(3))
        durations = [
            (peak * distance / (_RETURN_SHARE * np.abs(change).max())) ** (1.0 / order)
            for order, (peak, change) in enumerate(zip(_QUINTIC_PEAKS, changes, strict=True), 1)
        ]
        end = motion.end_time + _whole_ns(max(durations))
        return SampledMotion(np.append(motion.times, end), np.vstack([motion.states, np.zeros(3)]))

    def within(self, limits: PlateLimits) -> Pulses:
        """Return the motion, scaled down if it exceeds a limit at any time."""
        heights, step = np.pad(self.heights, 3), self.step
        excesses = [
            np.abs(heights).max() / limits.speed,
            np.abs(np.diff(heights)).max() / (limits.acceleration * step),
            np.abs(np.diff(heights, 2)).max() / (limits.jerk * step**2),
            np.ptp(np.cumsum(heights)) * step / limits.travel,
        ]
        excess = max(1.0, (1.0 + _ROUNDING) * max(excesses))
        return self._replace(heights=self.heights / excess)


def find_best_motion(
    rig: Rig,
    limits: PlateLimits,
    *,
    loads: Limits | None = None,
    others: Sequence[Mapping[str, float]] = (),
    cancelled: Cancelled | None = None,
) -> Throw:
    """
    Find the motion that throws a rig's projectile fastest, and follow its throw to the end.

    `others` are changes to rigs, as for `rig_with`, that it should throw nearly as fast. The plate
    comes to rest at its first height, and does not meet the projectile before that has come down.
    The speed is within 0.5 % of the known optima of a plate that goes up as fast as it can.
    """
    loads = loads or Limits()
    problem = _Problem(rig, limits, loads, cancelled, set())
    time, promised = _shortest_time(problem)
    is_exact = rig.layer.stress_strain_law == 'linear'
    best: Throw | None = None
    for time_factor in _TIME_FACTORS if promised > 0.0 else ():
        throw = _design(problem, time_factor * time)
        if throw and not _keeps_contact(throw, others):
            throw = _design(problem, time_factor * time, others) or throw
        if throw and (best is None or throw.ejection_speed > best.ejection_speed):
            best = throw
        if best and is_exact and best.ejection_speed > (1.0 - _PROGRAMME_ERROR) * promised:
            return best
    if best is None:
        raise ThrowUnresolvedError(
            f'no motion of the plate throws within {limits} and strain {loads.max_strain:g}, '
            f'acceleration {loads.max_acceleration:g} m/s2'
        )
    return best


@dataclass(frozen=True, kw_only=True)
class MotionDesign(PredictedThrow):
    """The best motion of the plate, and its throw."""

    rig: Rig  # the rig with the best motion
    present: Rig  # the rig as it is
    limits: PlateLimits  # limits of the actuator
    now: PredictedThrow | None  # throw of the rig as it is; None if it does not throw
    worst: PredictedThrow | None  # slowest throw within the uncertainties; None without a throw

    @property
    def motion(self) -> SampledMotion:
        """Designed motion of the plate."""
        assert self.rig.engine.motion is not None
        return self.rig.engine.motion

    @property
    def summary(self) -> str:
        """A sentence with the gain of energy, and the way down of the plate."""
        now, motion = self.now, self.motion
        text = f'the present motion throws nothing, the best one {self.ejection_speed:.4g} m/s'
        if now is not None:
            gain = gain_text(self.kinetic_energy / now.kinetic_energy - 1.0)
            text = (
                f'with the same motor, {gain} by the best motion (ejection speed '
                f'{now.ejection_speed:.4g} -> {self.ejection_speed:.4g} m/s)'
            )
        lowest = int(motion.states[:, 0].argmin())
        depth, time = -motion.states[lowest, 0], motion.times[lowest]
        if depth > 0.01 * self.limits.travel:
            text += f'; the plate goes down first, by {1e3 * depth:.2g} mm in {1e3 * time:.2g} ms'
        return text

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with `now.` and `worst.` before values of other throws."""
        others = {'now': self.now, 'worst': self.worst}
        return super().values() | {
            f'{key}.{name}': value
            for key, throw in others.items() if throw for name, value in vars(throw).items()
        }


def design_motion(
    rig: Rig,
    plate: PlateLimits | None = None,
    *,
    limits: Limits | None = None,
    uncertainties: Uncertainties | None = None,
    cancelled: Cancelled | None = None,
) -> MotionDesign:
    """
    Find the best motion of the plate, within the limits of its present motion if none are given.

    Examples
    --------
    >>> design = design_motion(Rig(gravity=0.0))
    >>> round(design.kinetic_energy / design.now.kinetic_energy, 2)
    1.15

    """
    plate = plate or PlateLimits.of(rig.engine)
    others = _corners(rig, uncertainties) if uncertainties else []
    best = find_best_motion(rig, plate, loads=limits, others=others, cancelled=cancelled).rig
    throw, now, worst = predict(best), None, None
    with contextlib.suppress(ThrowUnresolvedError):
        now = predict(rig)
    with contextlib.suppress(ThrowUnresolvedError):
        cases = [throw, *(predict(rig_with(best, change)) for change in others)]
        worst = min(cases, key=lambda case: case.ejection_speed)
    return MotionDesign(
        **vars(throw), rig=best, present=rig, limits=plate, now=now, worst=worst
    )


def _corners(rig: Rig, uncertainties: Uncertainties) -> list[dict[str, float]]:
    """Return the changes to the slowest and to the fastest layer and projectile."""
    offsets = np.array([[-1.0, 1.0, 1.0, 0.0, 0.0], [1.0, -1.0, -1.0, 0.0, 0.0]])
    variants, layer = uncertainties.variants(rig, offsets), rig.layer
    return [
        {'wave_speed': layer.wave_speed + speed, 'thickness': layer.thickness + size, 'mass': mass}
        for speed, size, mass, *_ in variants.tolist()
    ]


def _design(
    problem: _Problem, time: float, others: Sequence[Mapping[str, float]] = ()
) -> Throw | None:
    """Return the throw of the best motion for a time of release."""
    check_cancelled(problem.cancelled)
    programme = _Programme(problem, time, is_fine=True, others=others)
    pulses, _ = programme.solve(time)
    return pulses and _follow(problem.rig, pulses, problem.loads, problem.cancelled)


def _keeps_contact(throw: Throw, others: Sequence[Mapping[str, float]]) -> bool:
    """Return whether a motion throws other rigs nearly as fast."""
    speeds = [float(throw_many(throw.rig, change).ejection_speed) for change in others]
    return all(speed > _KEPT_SPEED * throw.ejection_speed for speed in speeds)


def _whole_ns(time: float) -> float:
    """Round a time up to whole nanoseconds, as messages have; others would add to the jerk [s]."""
    return 1e-9 * math.ceil(1e9 * time)


def _follow(
    rig: Rig, pulses: Pulses, loads: Limits, cancelled: Cancelled | None
) -> Throw | None:
    """
    Simulate a throw to its end with a motion, scaled down as far as the loads require.

    It is None if the projectile is not thrown, or meets the layer again before it comes down.
    """
    for _ in range(_SCALINGS):
        try:
            engine = replace(rig.engine, motion=pulses.motion_and_back())
            throw = simulate(replace(rig, engine=engine), cancelled=cancelled)
        except ValueError:
            return None
        excess = max(
            throw.peak_strain / loads.max_strain,
            throw.loads.acceleration / loads.max_acceleration,
        )
        if excess <= 1.0 + _LOAD_TOLERANCE:
            return throw if len(throw.ejections) == 1 and throw.ejection_speed > 0.0 else None
        pulses = pulses._replace(heights=pulses.heights / excess)
    return None


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


class _Problem(NamedTuple):
    """Arguments of a search for a motion, and the strains that its solutions have exceeded."""

    rig: Rig
    limits: PlateLimits
    loads: Limits
    cancelled: Cancelled | None
    critical: Critical


def _shortest_time(problem: _Problem) -> tuple[float, float]:
    """Return the shortest time with nearly the largest speed, and the speed; 0 without a throw."""
    longest, *shorter = _times(problem.rig, problem.limits)
    programme = _Programme(problem, longest, is_fine=False)

    def speed_at(time: float) -> float:
        check_cancelled(problem.cancelled)
        return programme.solve(time)[1]

    speed = speed_at(longest)
    if not speed > 0.0:
        return longest, 0.0
    index = bisect.bisect_left(shorter, (1.0 - _WAITING_GAIN) * speed, key=speed_at)
    return [*shorter, longest][index], speed


class _Programme:
    """The linear programmes of a problem, up to a largest time of release."""

    def __init__(
        self,
        problem: _Problem,
        longest: float,
        *,
        is_fine: bool,
        others: Sequence[Mapping[str, float]] = (),
    ) -> None:
        self._rig, self._limits, self._loads, _, self._critical = problem
        self._is_fine = is_fine
        rig, (per_crossing, max_pulses) = problem.rig, _FINE if is_fine else _COARSE
        step = max(rig.crossing_time / per_crossing, longest / max_pulses)
        self._step = _whole_ns(step)
        self._count = math.ceil(longest / self._step) + 1
        self._gravity = 1e3 / self._step  # keeps the projectile in contact, changes nothing else
        states, strains = self._responses(rig)
        self._velocity = states[::_FINER, PROJECTILE_VELOCITY]
        self._strains = (strains[::_FINER] - strains[0]).T
        self._static_strains = strains[0] * (rig.gravity / self._gravity)
        self._forces = [(rig, states[:, PROJECTILE_FORCE])]
        for other in (rig_with(rig, change) for change in others):
            self._forces.append((other, self._responses(other)[0][:, PROJECTILE_FORCE]))

    def _responses(self, rig: Rig) -> tuple[Floats, Floats]:
        """Return states and strains after a pulse of 1 m/s; the forces are without the weight."""
        pulse = replace(rig.engine, motion=Pulses(self._step, np.ones(1)).motion())
        linear = replace(rig.layer, stress_strain_law='linear')
        heavy = replace(rig, engine=pulse, layer=linear, gravity=self._gravity)
        cells = SEARCH_CELLS if linear.needs_cells and not self._is_fine else None
        stepper = make_stepper(heavy, cells=cells, field_points=_HEIGHTS)
        states = np.empty((_FINER * self._count, 7))
        strains, layer = np.empty((len(states), _HEIGHTS)), np.empty((4, _HEIGHTS))
        for n, time in enumerate((self._step / _FINER * np.arange(len(states))).tolist()):
            stepper.advance_to(time)
            stepper.read_layer(layer)
            states[n], strains[n] = stepper.state, layer[3]
        states[:, PROJECTILE_FORCE] -= rig.projectile.mass * heavy.gravity
        return states, strains

    def solve(self, time: float) -> tuple[Pulses | None, float]:
        """Find the pulses with the largest speed at a time; return the pulses and the speed."""
        rig, limits, step = self._rig, self._limits, self._step
        release = min(round(time / step), self._count - 1)
        # Later pulses do not reach the projectile before the release.
        count = max(release - int(rig.crossing_time / step), 1)
        braking = 1.2 * limits.rise_time + 2.0 * limits.acceleration_time
        size = count + math.ceil(braking / step) + 6
        # The unknowns are the control points of the height over speed and step.
        # Differences of control points are pulses.
        # Differences of pulses bound acceleration and jerk.
        rise = np.diff(np.eye(size + 1), axis=0)
        steps, bends = (np.diff(np.pad(rise, ((n, n), (0, 0))), n, axis=0) for n in (1, 2))
        pushes = [self._pushing(*item, release, size) for item in self._forces]
        force, min_force = map(np.concatenate, zip(*pushes, strict=True))
        max_force = self._loads.max_acceleration * rig.projectile.mass
        max_force /= limits.speed * rig.layer.impedance
        min_speed = np.where(np.arange(size) < count, -1.0, 0.0)
        ranges = [
            (force @ rise, min_force, np.full(min_force.shape, max_force)),
            (rise, min_speed, np.ones(size)),
        ]
        for matrix, limit in ((steps, limits.acceleration), (bends, limits.jerk * step)):
            if limit < math.inf:
                bound = np.ones(len(matrix))
                ranges.append((matrix * (limits.speed / (limit * step)), -bound, bound))
        rows = np.concatenate([sign * matrix for matrix, _, _ in ranges for sign in (1.0, -1.0)])
        bounds = np.concatenate([item for _, low, high in ranges for item in (high, -low)])
        is_limit = bounds < math.inf
        goal = np.zeros(size)
        goal[:count] = -self._velocity[release - np.arange(count)]
        goal[count:] = 1e-5 * step / rig.crossing_time  # brake as early as it does not matter
        for _ in range(_MAX_ROUNDS):
            strain, strain_bounds = self._strain_limits(release, size)
            limited = np.concatenate([rows[is_limit], strain @ rise])
            limited_bounds = np.concatenate([bounds[is_limit], strain_bounds])
            result = self._optimise(goal @ rise, limited, limited_bounds)
            if result is None:
                return None, 0.0
            if self._is_fine:
                result = self._smoothest(result, goal @ rise, limited, limited_bounds, bends)
            pulses = limits.speed * (rise @ result)
            excessive = self._excessive(pulses, release)
            if excessive <= self._critical:
                break
            self._critical |= excessive
        pulses[np.abs(pulses) < 1e-6 * np.abs(pulses).max()] = 0.0
        if rig.gravity == 0.0:  # negative rounding errors before the start would release it
            start = int((np.abs(pulses) > 1e-3 * np.abs(pulses).max()).argmax())
            pulses[: int(np.flatnonzero(pulses[:start] < 0.0).max(initial=-1)) + 1] = 0.0
        return Pulses(step, pulses).within(limits), float(-goal[:count] @ pulses[:count])

    def _optimise(self, goal: Floats, rows: Floats, bounds: Floats) -> Floats | None:
        """Solve a linear programme; None if it has no solution."""
        for method, iterations in _METHODS.items():
            result = scipy.optimize.linprog(
                goal,
                A_ub=scipy.sparse.csr_matrix(rows),
                b_ub=bounds,
                bounds=(0.0, self._limits.travel / (self._limits.speed * self._step)),
                method=method,
                options={'maxiter': iterations, 'time_limit': _PROGRAMME_TIME},
            )
            if result.status in (_OPTIMAL, _INFEASIBLE):
                break
        return result.x if result.status == _OPTIMAL else None

    def _smoothest(
        self, fastest: Floats, goal: Floats, rows: Floats, bounds: Floats, bends: Floats
    ) -> Floats:
        """Return the motion with the least change of acceleration that is almost as fast."""
        goals, changes = rows.shape[1], len(bends)
        best = float(goal @ fastest)
        # The additional unknowns are upper bounds of the magnitudes of all changes.
        size = np.eye(changes)
        result = self._optimise(
            np.repeat((0.0, 1.0), (goals, changes)),
            np.block([
                [rows, np.zeros((len(rows), changes))],
                [goal, np.zeros(changes)],
                [bends, -size],
                [-bends, -size],
            ]),
            np.concatenate([
                bounds, [best + _SMOOTHING_LOSS * abs(best)], np.zeros(2 * changes)
            ]),
        )
        return fastest if result is None else result[:goals]

    def _excessive(self, pulses: Floats, release: int) -> Critical:
        """Return the strains of a motion that exceed the limit."""
        excessive: Critical = set()
        for height, response in enumerate(self._strains):
            strain = np.convolve(response[: release + 1], pulses)[: release + 1]
            strain += self._static_strains[height]
            size = np.pad(np.abs(strain), 1)
            chosen = (size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:])
            chosen[::_STRAIN_STRIDE] = True
            chosen &= size[1:-1] > (1.0 + _STRAIN_TOLERANCE) * self._loads.max_strain
            for n in np.flatnonzero(chosen).tolist():
                before = (release - n) * self._step
                excessive.add((height, before, math.copysign(1.0, strain[n])))
        return excessive

    def _strain_limits(self, release: int, size: int) -> tuple[Floats, Floats]:
        """Return rows for the pulses, and bounds, that limit all strains known to be critical."""
        critical = [
            (height, release - round(before / self._step), sign)
            for height, before, sign in sorted(self._critical)
            if before < (release - 1) * self._step
        ]
        rows, bounds = np.zeros((len(critical), size)), np.empty(len(critical))
        for row, (height, n, sign) in enumerate(critical):
            response = self._strains[height, n::-1][:size]
            rows[row, :response.size] = sign * self._limits.speed * response
            bounds[row] = self._loads.max_strain - sign * self._static_strains[height]
        return rows, bounds

    def _pushing(
        self, rig: Rig, force: Floats, release: int, size: int
    ) -> tuple[Floats, Floats]:
        """Return the force on a projectile over time, and its lower bound, against rest."""
        step, nominal = self._step / _FINER, self._rig
        scale = self._limits.speed * nominal.layer.impedance
        index = np.arange(1, _FINER * release + 1)[:, None] - _FINER * np.arange(size)
        rows = np.where(index > 0, force[np.maximum(index, 0)], 0.0) / nominal.layer.impedance
        rows[np.abs(rows) < 1e-9 * np.abs(rows).max()] = 0.0
        least = _MIN_CONTACT_FORCE if rig is nominal else 0.0
        bound = np.full(len(rows), (least - 1.0) * rig.projectile.mass * rig.gravity / scale)
        times = step * np.arange(1, len(rows) + 1)
        crossing = rig.crossing_time
        inside = (times > 1.5 * crossing) & (times < times[-1] - 0.5 * crossing)
        bound[inside] += _MIN_WAVE_FORCE
        # a faster rig may release earlier
        kept = math.ceil(len(rows) * min(1.0, (crossing / nominal.crossing_time) ** 2))
        return rows[:kept], bound[:kept]
