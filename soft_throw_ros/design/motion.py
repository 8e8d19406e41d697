# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Find the motion of the plate that throws best within the limits of an actuator.

Notes
-----
While the projectile lies on the layer, the rig is linear in the plate's motion and invariant in
time. A motion is a sum of short pulses of the plate's velocity: quadratic B-splines, whose heights
bound velocity and acceleration at all times. The stepper computes the response to one pulse; those
of all pulses add up. The largest speed of the projectile at a release time T is therefore a linear
programme in the heights of the pulses, whose optimum is global [1]_. Its constraints are a pushing
contact force until T, and limits of the plate's speed, acceleration and travel, of the layer's
strain, and of the projectile's acceleration. Few limits of the strain are active, so the programme
has only those that an earlier solution exceeded. The speed grows with T, since the plate may wait
before it starts; the shortest T with nearly the speed of the longest is used.

For a neo-Hookean layer the programme uses the linear layer of the same modulus at rest. The
stepper simulates the motions for several times of release, with the layer itself, and the best
throw is chosen. A rig that differs by the uncertainties may throw early, where the force nearly
ends. If a motion loses more than 7 % of the speed so, it is designed once more, with a pushing
contact force on the slowest and on the fastest layer and projectile as well, and, if even this one
loses as much, for other times of release.

A wave that leaves the plate later than one crossing time before T cannot reach the projectile
before the release; from then on the plate brakes. A quintic leads it back to its first height. The
knots are at whole nanoseconds, the resolution of trajectory messages.

References
----------
.. [1] L. Schork, J. Gondzio, "Implementation of an interior point method with basis
   preconditioning", Math. Prog. Comp. 12 (2020): of HiGHS, by `scipy.optimize.linprog`.

"""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Iterator, Sequence
import contextlib
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

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
from soft_throw_ros.design.prediction import gain_text, predict, PredictedThrow, Uncertainties
from soft_throw_ros.design.score import Limits

Floats = NDArray[np.float64]

_COARSE, _FINE = 120, 300  # pulses until the longest T, to find the best T and the motion
_FINER = 2  # times per pulse at which the layer has to push the projectile
_HEIGHTS = 9  # points of the layer, from plate to projectile, whose strain is limited
_NEGLIGIBLE = 5e-4  # relative change of a speed or a load below the accuracy of a design [-]
_MIN_CONTACT_FORCE = 0.2  # smallest force on the projectile over its weight [-]
_MIN_WAVE_FORCE = 1e-3  # the same in the contact, over the largest speed times impedance [-]
_KEPT_SPEED = 0.93  # share of the speed that a motion keeps on other rigs [-]
_PROGRAMME_ERROR = 0.01  # relative deficit of the simulated speed against the programme [-]
_TIME_FACTORS = (1.0, 0.95, 1.06, 0.85, 0.6, 0.4)  # of the time of release, tried in turn
_METHODS = {'highs-ipm': 300, 'highs-ds': 20000}  # in turn, and iterations; some do not converge
_RETURN_SHARE = 0.25  # peak speed and acceleration of the way back, over the motion's [-]


@dataclass(frozen=True, kw_only=True)
class PlateLimits:
    """Limits of an actuator: largest magnitudes, of which all but the speed may be infinite."""

    speed: float  # [m/s]
    acceleration: float = math.inf  # [m/s2]
    travel: float = math.inf  # from the lowest to the highest position [m]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == 'speed' or value != math.inf:
                checks.require_all(name, value, 'positive')

    @classmethod
    def of(cls, engine: Engine) -> PlateLimits:
        """Return the limits of the present motion of an engine."""
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
    def rise_time(self) -> float:
        """Time to reach the largest speed [s]."""
        return self.speed / self.acceleration


class Pulses(NamedTuple):
    """A motion of the plate: a series of quadratic B-splines in its velocity."""

    step: float  # time between neighbours [s]
    heights: Floats  # coefficients of the B-splines [m/s]

    def motion(self) -> SampledMotion:
        """Return the motion, without the rest before and after it."""
        c = np.pad(np.trim_zeros(self.heights), 3)
        velocity, acceleration = 0.5 * (c[1:-1] + c[2:]), np.diff(c)[1:] / self.step
        rise = self.step * velocity[:-1]
        rise += self.step**2 * (2.0 * acceleration[:-1] + acceleration[1:]) / 6.0
        states = np.column_stack([np.append(0.0, np.cumsum(rise)), velocity, acceleration])
        return SampledMotion(self.step * np.arange(float(len(states))), states)

    def motion_and_back(self) -> SampledMotion:
        """Return the motion with a quintic back to its first height, slow beside the motion."""
        motion = self.motion()
        distance = abs(float(motion.states[-1, 0]))
        speed = _RETURN_SHARE * np.abs(self.heights).max()
        acceleration = _RETURN_SHARE * np.abs(np.diff(self.heights)).max() / self.step
        # peaks of a quintic from rest to rest, of height and duration 1, are 1.875 and 5.77
        duration = max(1.875 * distance / speed, math.sqrt(5.774 * distance / acceleration))
        if duration <= self.step:  # the distance is rounding
            return motion
        end = motion.end_time + _whole_ns(duration)
        return SampledMotion(np.append(motion.times, end), np.vstack([motion.states, np.zeros(3)]))

    def within(self, limits: PlateLimits) -> Pulses:
        """Return the motion, scaled down if it exceeds a limit at any time."""
        excesses = (
            np.abs(self.heights).max() / limits.speed,
            np.abs(np.diff(np.pad(self.heights, 1))).max() / (limits.acceleration * self.step),
            np.ptp(np.cumsum(np.pad(self.heights, 1))) * self.step / limits.travel,
        )
        return self._replace(heights=self.heights / max(1.0, *excesses))


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
            gain = self.kinetic_energy / now.kinetic_energy - 1.0
            if self.ejection_speed < (1.0 + _NEGLIGIBLE) * now.ejection_speed:
                return (
                    'keep your motion: none within the limits of the motor is better '
                    f'(ejection speed {now.ejection_speed:.4g} m/s)'
                )
            text = (
                f'with the same motor, {gain_text(gain)} by the best motion (ejection speed '
                f'{now.ejection_speed:.4g} -> {self.ejection_speed:.4g} m/s)'
            )
        lowest = int(motion.states[:, 0].argmin())
        depth, time = -motion.states[lowest, 0], motion.times[lowest]
        if depth > 0.01 * self.limits.travel:
            text += f'; the plate goes down first, by {1e3 * depth:.2g} mm in {1e3 * time:.2g} ms'
        return text


def design_motion(
    rig: Rig,
    plate: PlateLimits | None = None,
    *,
    limits: Limits | None = None,
    uncertainties: Uncertainties | None = None,
    cancelled: Cancelled | None = None,
) -> MotionDesign:
    """
    Find the motion that throws a rig's projectile fastest.

    The limits of the plate are those of its present motion if none are given. The motion throws
    nearly as fast on the slowest and on the fastest layer and projectile within the uncertainties,
    if they are given. The plate comes to rest at its first height, and does not meet the
    projectile before that has come down. The speed is within 0.5 % of the known optima of a plate
    that goes up as fast as it can.

    Examples
    --------
    >>> design = design_motion(Rig(gravity=0.0))
    >>> round(design.kinetic_energy / design.now.kinetic_energy, 2)
    1.15

    """
    plate, loads = plate or PlateLimits.of(rig.engine), limits or Limits()
    others = _corners(rig, uncertainties) if uncertainties else []
    longest, *shorter = _times(rig, plate)
    coarse = _Programme(rig, plate, loads, longest)

    def speed_at(time: float) -> float:
        check_cancelled(cancelled)
        return coarse.solve(time)[1]

    def throw_at(time: float, others: Sequence[Rig] = ()) -> Throw | None:
        check_cancelled(cancelled)
        pulses, _ = _Programme(rig, plate, loads, time, coarse=coarse, others=others).solve(time)
        return pulses and _follow(rig, pulses, loads, cancelled)

    promised = speed_at(longest)
    index = bisect.bisect_left(shorter, (1.0 - _NEGLIGIBLE) * promised, key=speed_at)
    time = [*shorter, longest][index]
    is_exact = rig.layer.stress_strain_law == 'linear'
    best, kept = None, -math.inf
    for time_factor in _TIME_FACTORS if promised > 0.0 else ():
        for rigs in ([], others):
            if not (throw := throw_at(time_factor * time, rigs)):
                break
            speed = _slowest(throw, others)
            if speed > kept:
                best, kept = throw, speed
            if speed > _KEPT_SPEED * throw.ejection_speed:
                break
        if (
            is_exact and best and kept > _KEPT_SPEED * best.ejection_speed
            and best.ejection_speed > (1.0 - _PROGRAMME_ERROR) * promised
        ):
            break
    if best is None:
        raise ThrowUnresolvedError(
            f'no motion of the plate throws within {plate} and strain {loads.max_strain:g}, '
            f'acceleration {loads.max_acceleration:g} m/s2'
        )
    predicted, now, worst = predict(best.rig), None, None
    with contextlib.suppress(ThrowUnresolvedError):
        now = predict(rig)
    with contextlib.suppress(ThrowUnresolvedError):
        cases = [predict(replace(other, engine=best.rig.engine)) for other in others]
        worst = min([predicted, *cases], key=lambda case: case.ejection_speed)
    return MotionDesign(
        **vars(predicted), rig=best.rig, present=rig, limits=plate, now=now, worst=worst
    )


def _corners(rig: Rig, uncertainties: Uncertainties) -> list[Rig]:
    """Return the rigs with the slowest and with the fastest layer and projectile."""
    offsets = np.array([[-1.0, 1.0, 1.0, 0.0, 0.0], [1.0, -1.0, -1.0, 0.0, 0.0]])
    speed, thickness = rig.layer.wave_speed, rig.layer.thickness
    return [
        rig_with(rig, {'wave_speed': speed + error, 'thickness': thickness + size, 'mass': mass})
        for error, size, mass, *_ in uncertainties.variants(rig, offsets).tolist()
    ]


def _slowest(throw: Throw, others: Iterable[Rig]) -> float:
    """Return the lowest speed of the motion of a throw on its rig and on others [m/s]."""
    rigs = [replace(other, engine=throw.rig.engine) for other in others]
    speeds = [float(throw_many(other).ejection_speed) for other in rigs]
    return float(np.min(np.nan_to_num([throw.ejection_speed, *speeds])))


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


def _whole_ns(time: float) -> float:
    """Round a time up to whole nanoseconds, the resolution of messages [s]."""
    return 1e-9 * math.ceil(1e9 * time)


def _follow(
    rig: Rig, pulses: Pulses, loads: Limits, cancelled: Cancelled | None
) -> Throw | None:
    """Return the throw by a motion, scaled down for the loads; None unless it is thrown once."""
    while True:
        try:
            engine = replace(rig.engine, motion=pulses.motion_and_back())
            throw = simulate(replace(rig, engine=engine), cancelled=cancelled)
        except ValueError:
            return None
        excess = max(
            throw.loads.strain / loads.max_strain,
            throw.loads.acceleration / loads.max_acceleration,
        )
        if excess <= 1.0:
            return throw if len(throw.ejections) == 1 and throw.ejection_speed > 0.0 else None
        pulses = pulses._replace(heights=pulses.heights / ((1.0 + _NEGLIGIBLE) * excess))


class _Programme:
    """The linear programmes for times of release up to a largest one."""

    # The unknowns are the control points of the height over speed and step. Their differences are
    # pulses over speed, whose differences bound the acceleration.

    def __init__(
        self, rig: Rig, limits: PlateLimits, loads: Limits, longest: float, *,
        coarse: _Programme | None = None, others: Iterable[Rig] = (),
    ) -> None:
        self._rig, self._limits, self._loads, self._is_fine = rig, limits, loads, bool(coarse)
        self._step = _whole_ns(longest / (_FINE if coarse else _COARSE))
        self._count = math.ceil(longest / self._step) + 1
        self._gravity = 1e3 / self._step  # keeps the projectile in contact, changes nothing else
        states, strains = self._responses(rig)
        self._velocity = states[::_FINER, PROJECTILE_VELOCITY]
        self._strains = (strains[::_FINER] - strains[0]).T
        self._static_strains = strains[0] * (rig.gravity / self._gravity)
        responses = [(rig, states)]
        responses += [(other, self._responses(other)[0]) for other in others]
        self._forces = [(other, states[:, PROJECTILE_FORCE]) for other, states in responses]
        # strains that solutions exceeded, by their height and steps before the release
        self._exceeded = np.zeros(self._strains.shape, bool)
        if coarse:
            heights, steps = coarse._exceeded.nonzero()
            steps = np.rint(steps * coarse._step / self._step).astype(int)
            self._exceeded[heights, np.minimum(steps, self._count - 1)] = True

    def _responses(self, rig: Rig) -> tuple[Floats, Floats]:
        """Return states and strains after a pulse of 1 m/s; the forces are without the weight."""
        pulse = replace(rig.engine, motion=Pulses(self._step, np.ones(1)).motion())
        linear = replace(rig.layer, stress_strain_law='linear')
        heavy = replace(rig, engine=pulse, layer=linear, gravity=self._gravity)
        cells = SEARCH_CELLS if linear.needs_cells and not self._is_fine else None
        stepper = make_stepper(heavy, cells=cells, field_points=_HEIGHTS)
        states = np.empty((_FINER * self._count, 7))
        strains = np.empty((len(states), _HEIGHTS))
        for n, time in enumerate((self._step / _FINER * np.arange(len(states))).tolist()):
            stepper.advance_to(time)
            states[n], strains[n] = stepper.state, stepper.read_layer()[3]
        states[:, PROJECTILE_FORCE] -= rig.projectile.mass * heavy.gravity
        return states, strains

    def solve(self, time: float) -> tuple[Pulses | None, float]:
        """Find the pulses with the largest speed at a time; return the pulses and the speed."""
        rig, limits, step = self._rig, self._limits, self._step
        release = min(round(time / step), self._count - 1)
        # Later pulses do not reach the projectile before the release.
        count = max(release - int(rig.crossing_time / step), 1)
        size = count + math.ceil(1.2 * limits.rise_time / step) + 6
        rise, pulse = np.diff(np.eye(size + 1), axis=0), np.eye(size)
        goal = np.zeros(size)
        goal[:count] = -self._velocity[release - np.arange(count)]
        goal[count:] = 1e-5 * step / rig.crossing_time  # brake as early as it does not matter
        force, least = map(np.concatenate, zip(
            *(self._pushing(*item, release, size) for item in self._forces), strict=True
        ))
        # rows for the pulses over the largest speed, and their upper bounds
        parts = [
            (-force, -least),
            (pulse, np.ones(size)),
            (-pulse, np.where(np.arange(size) < count, 1.0, 0.0)),
        ]
        if self._loads.max_acceleration < math.inf:
            most = self._loads.max_acceleration * rig.projectile.mass
            most /= limits.speed * rig.layer.impedance
            parts.append((force, np.full(least.shape, most)))
        if limits.acceleration < math.inf:
            steps = np.diff(np.pad(pulse, ((1, 1), (0, 0))), axis=0)
            most = limits.acceleration * step / limits.speed
            parts += [(sign * steps, np.full(len(steps), most)) for sign in (-1.0, 1.0)]
        strains = _lagged(self._strains, np.arange(release + 1), size)
        exceeded = self._exceeded[:, release::-1]  # by the steps after the start, a view
        is_new = np.True_
        while is_new:
            static = self._static_strains[exceeded.nonzero()[0]]
            limited = [
                (sign * limits.speed * strains[exceeded], self._loads.max_strain - sign * static)
                for sign in (-1.0, 1.0)
            ]
            rows, bounds = map(np.concatenate, zip(*parts, *limited, strict=True))
            result = self._optimise(goal @ rise, rows @ rise, bounds)
            if result is None:
                return None, 0.0
            if self._is_fine:
                result = self._smoothest(result, goal @ rise, rows @ rise, bounds)
            pulses = limits.speed * (rise @ result)
            strain = np.abs(strains @ pulses + self._static_strains[:, None])
            new = strain > (1.0 + _NEGLIGIBLE) * self._loads.max_strain
            is_new = (new & ~exceeded).any()
            exceeded |= new
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
                options={'maxiter': iterations},
            )
            if result.status in (0, 2):  # optimal, or infeasible
                break
        return result.x if result.status == 0 else None

    def _smoothest(self, fastest: Floats, goal: Floats, rows: Floats, bounds: Floats) -> Floats:
        """Return the motion with the least change of acceleration that is almost as fast."""
        rise = np.diff(np.eye(goal.size), axis=0)
        bends = np.diff(np.pad(rise, ((2, 2), (0, 0))), 2, axis=0)
        best, size = float(goal @ fastest), np.eye(len(bends))
        # The additional unknowns are upper bounds of the magnitudes of all changes.
        result = self._optimise(
            np.repeat((0.0, 1.0), bends.shape[::-1]),
            np.block([
                [rows, np.zeros((len(rows), len(size)))],
                [goal, np.zeros(len(size))],
                [bends, -size],
                [-bends, -size],
            ]),
            np.concatenate([
                bounds, [best + _NEGLIGIBLE * abs(best)], np.zeros(2 * len(size))
            ]),
        )
        return fastest if result is None else result[:goal.size]

    def _pushing(
        self, rig: Rig, force: Floats, release: int, size: int
    ) -> tuple[Floats, Floats]:
        """Return the force on a projectile over time, and its lower bound, against rest."""
        step, nominal = self._step / _FINER, self._rig
        rows = _lagged(force, np.arange(1, _FINER * release + 1), size, _FINER)
        rows /= nominal.layer.impedance
        rows[np.abs(rows) < 1e-9 * np.abs(rows).max()] = 0.0
        least = _MIN_CONTACT_FORCE - 1.0
        scale = self._limits.speed * nominal.layer.impedance
        bound = np.full(len(rows), least * rig.projectile.mass * rig.gravity / scale)
        times = step * np.arange(1, len(rows) + 1)
        crossing = rig.crossing_time
        bound[(times > 1.5 * crossing) & (times < times[-1] - 0.5 * crossing)] += _MIN_WAVE_FORCE
        # a faster rig may release earlier
        kept = math.ceil(len(rows) * min(1.0, (crossing / nominal.crossing_time) ** 2))
        return rows[:kept], bound[:kept]


def _lagged(response: Floats, indices: NDArray[np.intp], size: int, stride: int = 1) -> Floats:
    """Return the responses to pulses at some indices of time, one column for each pulse."""
    lag = indices[:, None] - stride * np.arange(size)
    return np.where(lag > 0, response[..., np.maximum(lag, 0)], 0.0)
