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
"""
Aim a throw: find the amplitude, or layer and amplitude, that reach a height or a speed.

What flies up is what leaves for the last time, so re-contacts count here.
"""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
from dataclasses import dataclass, replace
import math
from typing import get_args, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts are imported where they are first used, which takes 0.3 s
from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.rig import LARGEST_STRAIN, Rig
from soft_throw_ros.design.evaluate import (
    Cancelled,
    check_cancelled,
    first_throws,
    last_release,
    LastRelease,
    rig_with,
    SEARCH_CELLS,
)
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.optimise import find_best_layer, Optimum
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.search_space import search_spaces, SearchSpace

Floats = NDArray[np.float64]

Vary: TypeAlias = Literal['amplitude', 'thickness', 'wave_speed', 'both', 'library']

_STEP = 0.1  # of the logarithm of the amplitude, in looking for a bracket, ...
_HIGHEST = 10.0  # and where that ends [m]
_NOTHING = -10.0  # as a logarithm: what is not thrown
_EXACT = 1e-9  # in the logarithm of the amplitude
_JUMP = 1e-5  # likewise; what is found further from the target lies at a jump
_ROUNDS = 4  # of layer and amplitude in turn
_SAME = 1e-6  # amplitudes of two rounds that differ by less are the same
_ITERATIONS = 3  # of the amplitude that a layer needs, which gravity makes depend on itself
_WORTH = 1.1  # times the least amplitude that others may seem to need to be looked at
_OUT_OF_REACH = 1e6  # a speed for which every amplitude that is allowed is needed [m/s]
_NEAREST = 3  # layers that are followed to the last release if none reaches the target
_NO_LOADS = {'max_strain': math.inf, 'max_acceleration': math.inf}
_ROOM = 1e-3  # part of a limit that is left for what is not seen in a search


@dataclass(frozen=True, kw_only=True)
class Target:
    """
    What a throw is to reach; one of the two.

    Parameters
    ----------
    height : float
        How far the projectile rises above where it rests on the layer. [m]
    speed : float
        How fast it leaves. [m/s]

    Raises
    ------
    ValueError
        If both are given or neither, or one is not finite and positive.

    """

    height: float | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        given = [name for name in ('height', 'speed') if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f'give either a height or a speed as target, got {"both" if given else "neither"}'
            )
        name = given[0]
        object.__setattr__(self, name, checks.require_positive(name, getattr(self, name)))

    @property
    def summary(self) -> str:
        """Say what is aimed at."""
        return f'{self.height:g} m high' if self.height else f'{self.speed:g} m/s'

    @property
    def value(self) -> float:
        """Height [m] or speed [m/s]."""
        value = self.height or self.speed
        assert value is not None  # one of them is positive
        return value

    def reached(self, throw: LastRelease | Aim) -> float:
        """Return what of a throw compares with `value`."""
        return throw.height if self.height else throw.speed

    def speed_after(self, rise: float, gravity: float) -> float:
        """Return the speed that reaches it for a projectile that has risen so far [m/s]."""
        if self.height is None:
            return self.value
        return math.sqrt(2.0 * gravity * max(self.height - rise, 1e-3 * self.height))


@dataclass(frozen=True, kw_only=True)
class Aim(PredictedThrow):
    """
    A throw that reaches its target, or the one that comes nearest.

    Parameters
    ----------
    target_height, target_speed : float or None
        What is aimed at. [m], [m/s]
    vary : {'amplitude', 'thickness', 'wave_speed', 'both', 'library'}
        What was allowed to change, the amplitude always.
    layer : str
        Name of the layer in the library, if it was picked there.
    amplitude : float
        Of the plate. [m]
    height : float
        How far the projectile rises above where it rests on the layer; infinite without
        gravity. [m]
    speed : float
        Of its last release. [m/s]
    is_reached : bool
        Whether that is the target.
    rig : Rig
        The rig that throws so.
    summary : str
        What it takes, or why the target is not reached and what would reach it.

    """

    target_height: float | None
    target_speed: float | None
    vary: Vary
    layer: str
    amplitude: float
    height: float
    speed: float
    is_reached: bool
    rig: Rig
    summary: str = ''

    @property
    def layer_text(self) -> str:
        """Describe the layer."""
        name = f'{self.layer}, ' if self.layer else ''
        return f'a layer of {name}{1e3 * self.thickness:.4g} mm and {self.wave_speed:.4g} m/s'

    @property
    def loads_text(self) -> str:
        """Say what it takes."""
        return (
            f'amplitude {1e3 * self.amplitude:.4g} mm, strain {1e2 * self.peak_strain:.3g} %, '
            f'acceleration {self.peak_acceleration:.3g} m/s2'
        )


def aim(
    rig: Rig,
    target: Target,
    *,
    vary: Vary = 'amplitude',
    limits: Limits | None = None,
    max_amplitude: float = 0.1,
    materials: Mapping[str, Material] | None = None,
    cancelled: Cancelled | None = None,
) -> Aim:
    """
    Find the smallest amplitude that reaches a target, with this layer or the best one.

    Parameters
    ----------
    rig : Rig
        With the layer that it has now; its amplitude does not matter.
    target : Target
        What is to be reached.
    vary : {'amplitude', 'thickness', 'wave_speed', 'both', 'library'}
        What may change of the layer besides the amplitude.
    limits, materials, cancelled : optional
        As for `recommend`; a strain of `core.rig.LARGEST_STRAIN` is never exceeded.
    max_amplitude : float
        That the plate can do. [m]

    Returns
    -------
    Aim
        If the target is not within reach, the throw that comes nearest to it.

    Raises
    ------
    ValueError
        If a choice is unknown, `max_amplitude` is not positive, the layer is not of one material,
        or a height is aimed at without gravity.
    ThrowUnresolvedError
        If nothing is thrown at all within the limits.
    SearchCancelledError
        If `cancelled` says so.

    Notes
    -----
    Without gravity the speed is proportional to the amplitude. With gravity it may jump, where a
    later swing of the plate throws; the smallest amplitude is looked for upwards from where the
    first swing would do without gravity. Amplitude and layer are improved in turn, since the best
    layer for a speed depends on the amplitude through gravity alone.

    Examples
    --------
    >>> found = aim(Rig(), Target(height=0.15))
    >>> round(1e3 * found.amplitude, 3), found.is_reached
    (2.453, True)

    """
    limits = limits or Limits()
    checks.require_positive('max_amplitude', max_amplitude)
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    if rig.engine.motion:
        raise ValueError(
            'aiming needs a plate whose amplitude can be set, got a motion from a file'
        )
    if target.height is not None and rig.gravity == 0.0:
        raise ValueError('a height needs gravity, got gravity 0; aim at a speed instead')
    limits = replace(limits, max_strain=min(limits.max_strain, LARGEST_STRAIN))
    task = _Task(rig, target, vary, limits, max_amplitude, cancelled)
    spaces = search_spaces(rig, vary, limits, materials or {})
    drafts = [(best, space) for space in spaces if (best := task.search(space)) is not None]
    drafts.sort(key=lambda draft: -draft[0].score)
    found: Aim | None = None
    for best, space in drafts:
        # Re-contacts may make a throw better than its first release tells, but not by so much.
        if found is not None and max_amplitude / best.score > _WORTH * found.amplitude:
            break
        throw = task.reach(space, best)
        if throw is not None and not task.excess(throw):
            found = throw if found is None or throw.amplitude < found.amplitude else found
    if found is not None:
        return replace(found, is_reached=True, summary=_how(task, found))
    most = task.approach(drafts)
    if most is None:
        raise ThrowUnresolvedError(
            f'nothing is thrown within the limits, let alone {target.summary}'
        )
    free = task.without_limits()
    throws = (free.reach(space) for _, space in drafts[:_NEAREST])
    reached = [throw for throw in throws if throw is not None]
    easiest = min(reached, key=lambda throw: throw.amplitude, default=None)
    return replace(most, summary=_why_not(task, easiest, most))


class _Needs(NamedTuple):
    """Amplitudes that layers need, infinite if they throw nothing, and are allowed [m]."""

    needed: Floats
    allowed: Floats


class _Task(NamedTuple):
    """What is asked."""

    rig: Rig
    target: Target
    vary: Vary
    limits: Limits
    max_amplitude: float
    cancelled: Cancelled | None

    def without_limits(self) -> _Task:
        """Return the same with whatever amplitude and loads it takes."""
        return self._replace(limits=replace(self.limits, **_NO_LOADS), max_amplitude=_HIGHEST)

    def excess(self, throw: Aim) -> str:
        """Say what of a throw is beyond the limits; nothing if nothing is."""
        limits = self.limits
        return ' and '.join(
            f'{what} of {value:.3g}{unit} instead of at most {limit:.3g}{unit}'
            for what, value, limit, unit in (
                ('an amplitude', 1e3 * throw.amplitude, 1e3 * self.max_amplitude, ' mm'),
                ('a strain', 1e2 * throw.peak_strain, 1e2 * limits.max_strain, ' %'),
                ('an acceleration', throw.peak_acceleration, limits.max_acceleration, ' m/s2'),
            )
            if value > limit * (1.0 + 1e-6)  # what is at its limit may be rounded up
        )

    def throw(self, rig: Rig, layer: str) -> Aim:
        """Follow a throw."""
        last = last_release(rig)
        return Aim(
            **vars(predict(rig)),
            target_height=self.target.height,
            target_speed=self.target.speed,
            vary=self.vary,
            layer=layer,
            amplitude=rig.engine.amplitude,
            height=last.height,
            speed=last.speed,
            is_reached=False,
            rig=rig,
        )

    def needs(
        self, rig: Rig, thickness: Floats, wave_speed: Floats, speed: float, *, room: float = 0.0
    ) -> _Needs:
        """Find what layers need for a speed, and are allowed, by their first releases."""
        omega = rig.engine.angular_frequency
        amplitude = np.full(np.shape(thickness), min(speed / omega, self.max_amplitude))
        # Without gravity all is proportional to the amplitude, and found at once.
        for _ in range(_ITERATIONS if rig.gravity > 0.0 else 1):
            changes = {'thickness': thickness, 'wave_speed': wave_speed, 'amplitude': amplitude}
            throws = first_throws(
                rig, changes, loads=self.limits.of_loads, cells=SEARCH_CELLS,
                cancelled=self.cancelled,
            )
            thrown = np.maximum(np.nan_to_num(throws.ejection_speed), 1e-300)
            needed = amplitude * speed / thrown
            allowed = np.full(amplitude.shape, self.max_amplitude)
            for limit, load in (
                (self.limits.max_strain, throws.peak_strain),
                (self.limits.max_acceleration, throws.peak_acceleration),
            ):
                if limit < math.inf:
                    allowed = np.fmin(allowed, (1.0 - room) * amplitude * limit / load)
            amplitude = np.minimum(needed, allowed)
        return _Needs(needed, allowed)

    def search(
        self, space: SearchSpace, rig: Rig | None = None, rise: float = 0.0
    ) -> Optimum | None:
        """
        Find the layer that needs the least amplitude, or that reaches most if none does.

        Its score is `max_amplitude` over the amplitude that it needs, or below 1 the part of the
        speed that it reaches.
        """
        there = rig or space.rig
        speed = self.target.speed_after(rise, there.gravity)
        free = self._replace(limits=replace(self.limits, **_NO_LOADS))

        def score(thickness: Floats, wave_speed: Floats, *, least: Floats) -> Floats:
            # Loads take long, and only make it worse.
            scores = self.max_amplitude / free.needs(there, thickness, wave_speed, speed).needed
            alive = scores >= least
            if self.limits.of_loads and alive.any():
                place = thickness[alive], wave_speed[alive]
                room = 0.0 if space.is_single else _ROOM
                needed, allowed = self.needs(there, *place, speed, room=room)
                parts = np.minimum(allowed / needed, 1.0 - 1e-9)
                scores[alive] = np.where(needed <= allowed, self.max_amplitude / needed, parts)
            return np.where(scores >= least, scores, 0.0)

        return find_best_layer(score, space.layers, step=space.step)

    def reach(self, space: SearchSpace, best: Optimum | None = None) -> Aim | None:
        """Find layer and amplitude that reach the target; None if no layer keeps the limits."""
        rig, rise = space.rig, 0.0
        throw: Aim | None = None
        for _ in range(_ROUNDS):
            best = best or self.search(space, rig, rise)
            if best is None or (best.score < 1.0 and not space.is_single):
                return None
            rig = space._replace(rig=rig).rig_with(best)
            amplitude = self.amplitude(rig)
            if amplitude is None:
                return None
            is_same = abs(amplitude / rig.engine.amplitude - 1.0) < _SAME
            rig = rig_with(rig, {'amplitude': amplitude})
            throw = self.throw(rig, space.name)
            if is_same or space.is_single:
                break
            if rig.gravity > 0.0:
                rise = throw.height - throw.speed**2 / (2.0 * rig.gravity)
            best = None
        return throw

    def approach(self, drafts: list[tuple[Optimum, SearchSpace]]) -> Aim | None:
        """Follow the layers that reach the most within the limits; None if none throws."""
        throws = []
        for best, space in drafts[:_NEAREST]:
            rig = space.rig_with(best)
            place = np.array([best.thickness]), np.array([best.wave_speed])
            allowed = float(self.needs(rig, *place, _OUT_OF_REACH).allowed[0])
            with contextlib.suppress(ThrowUnresolvedError):
                throws.append(self.throw(rig_with(rig, {'amplitude': allowed}), space.name))
        return max(throws, key=self.target.reached, default=None)

    def amplitude(self, rig: Rig) -> float | None:
        """Find the smallest amplitude that reaches the target with a layer; None if none does."""
        target = self.target

        def excess(logarithm: float) -> float:
            """Compute the logarithm of what is reached over the target."""
            check_cancelled(self.cancelled)
            try:
                there = rig_with(rig, {'amplitude': math.exp(logarithm)})
                reached = target.reached(last_release(there))
            except ThrowUnresolvedError:
                return _NOTHING
            return math.log(reached / target.value) if reached > 0.0 else _NOTHING

        try:
            free = last_release(replace(rig, gravity=0.0)).speed
        except ThrowUnresolvedError:
            return None
        low = math.log(rig.engine.amplitude * target.speed_after(0.0, rig.gravity) / free)
        if rig.gravity == 0.0:
            return math.exp(low)
        while excess(low) >= 0.0:
            low -= _STEP
        high = low + _STEP
        while excess(high) < 0.0:
            low, high = high, high + _STEP
            if high > math.log(_HIGHEST):
                return None
        logarithm = scipy.optimize.brentq(excess, low, high, xtol=_EXACT, rtol=_EXACT)
        # a jump over the target is no solution
        return math.exp(logarithm) if abs(excess(logarithm)) < _JUMP else None


def _how(task: _Task, found: Aim) -> str:
    """Say what reaches the target."""
    is_other = found.layer or found.rig.layer != task.rig.layer
    layer = found.layer_text if is_other else 'the layer as it is'
    return f'{layer} reaches {task.target.summary}: {found.loads_text}'


def _why_not(task: _Task, easiest: Aim | None, most: Aim) -> str:
    """Say why the target is not reached, and what would reach it."""
    excess = task.excess(easiest) if easiest is not None else ''
    reached = f'{most.height:.4g} m high' if task.target.height else f'{most.speed:.4g} m/s'
    text = (
        f'{task.target.summary} is not reached: '
        f'{f"it takes {excess}" if excess else "no amplitude does it"}; '
        f'the most is {reached}, with {most.loads_text}'
    )
    if task.vary == 'amplitude':
        (other,) = search_spaces(task.rig, 'both', task.limits, {})
        found = task.reach(other)
        if found is not None and not task.excess(found):
            text += f'; {found.layer_text} would do it: {found.loads_text}'
    return text
