# SPDX-License-Identifier: Apache-2.0
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
from scipy.optimize import brentq
from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.stepper import FirstThrows
from soft_throw_ros.design.evaluate import (
    Cancelled,
    first_throws,
    last_release,
    SEARCH_CELLS,
    SearchCancelledError,
)
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.optimise import find_best_layer
from soft_throw_ros.design.recommendation import (
    grid_step,
    predict,
    Prediction,
    search_spaces,
    SearchSpace,
)
from soft_throw_ros.design.uncertainty import Variants

Floats = NDArray[np.float64]

Vary: TypeAlias = Literal['amplitude', 'thickness', 'wave_speed', 'both', 'library']

MAX_STRAIN = 1.0
"""Beyond it a layer would be compressed by more than its thickness, so nothing is aimed so. [-]"""

_STEP = 0.1  # of the logarithm of the amplitude, in looking for a bracket, ...
_HIGHEST = 10.0  # and where that ends [m]
_NOTHING = -10.0  # as a logarithm: what is not thrown
_EXACT = 1e-9  # in the logarithm of the amplitude
_JUMP = 1e-5  # likewise; what is found further from the target lies at a jump
_ROUNDS = 4  # of layer and amplitude in turn
_SAME = 1e-6  # amplitudes of two rounds that differ by less are the same
_ITERATIONS = 3  # of the amplitude that a layer needs, which gravity makes depend on itself
_WORTH = 1.1  # times the least amplitude that others may seem to need to be looked at
_NEAREST = 3  # layers that are followed to the last release if none reaches the target
_MARGIN = 1e-6  # a load this far beyond its limit is at the limit, ...
_ROOM = 1e-3  # and so much is left for what is not seen in a search


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
        """What is aimed at, in words."""
        return f'{self.height:g} m high' if self.height else f'{self.speed:g} m/s'

    @property
    def value(self) -> float:
        """Height [m] or speed [m/s]."""
        value = self.height or self.speed
        assert value is not None  # one of them is positive
        return value

    def reached(self, flight: FreeFlight) -> float:
        """Return what of a flight compares with `value`."""
        return flight.height if self.height else flight.speed

    def speed_after(self, rise: float, gravity: float) -> float:
        """Return the speed that reaches it for a projectile that has risen so far. [m/s]"""
        if self.height is None:
            return self.value
        return math.sqrt(2.0 * gravity * max(self.height - rise, 1e-3 * self.height))


class FreeFlight(NamedTuple):
    """Speed of the last release [m/s], rise until then [m], and the height reached [m]."""

    speed: float
    rise: float
    height: float


def fly(rig: Rig) -> FreeFlight:
    r"""
    Follow a throw until the projectile has left for good.

    Parameters
    ----------
    rig : Rig
        What throws.

    Returns
    -------
    FreeFlight
        The height counts from where the projectile rested on the layer.

    Raises
    ------
    ThrowUnresolvedError
        If the projectile does not leave.

    Examples
    --------
    >>> flight = fly(Rig())
    >>> round(flight.speed, 4), round(1e3 * flight.height, 2)
    (1.375, 100.51)

    """
    last = last_release(rig)
    if rig.gravity == 0.0:
        return FreeFlight(last.speed, last.rise, math.inf)
    height = last.rise + max(last.speed, 0.0) ** 2 / (2.0 * rig.gravity)
    return FreeFlight(last.speed, last.rise, height)


@dataclass(frozen=True, kw_only=True)
class Aim(Prediction):
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
    summary: str

    def values(self) -> dict[str, float | str | bool]:
        """Return all that is one value by its name."""
        return {
            name: value
            for name, value in vars(self).items()
            if name != 'rig' and value is not None
        }


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
    limits : Limits, optional
        What must not be exceeded; a strain of `MAX_STRAIN` never is. Those of the layer do not
        concern what may not change.
    max_amplitude : float
        That the plate can do. [m]
    materials : mapping of str to Material, optional
        From which one is picked, if `vary` is 'library'.
    cancelled : callable, optional
        Asked between batches of throws, some tenths of a second each, whether to give up.

    Returns
    -------
    Aim
        If the target is not within reach, the throw that comes nearest to it.

    Raises
    ------
    ValueError
        If a choice is unknown, `max_amplitude` is not positive, the layer is graded, or a height
        is aimed at without gravity.
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
    if type(rig.layer) is not Layer:  # a graded one is a kind of it
        raise ValueError(f'only layers of one material are aimed with, got {rig.layer!r}')
    if target.height is not None and rig.gravity == 0.0:
        raise ValueError('a height needs gravity, got gravity 0; aim at a speed instead')
    limits = replace(limits, max_strain=min(limits.max_strain, MAX_STRAIN))
    task = _Task(rig, target, limits, max_amplitude, cancelled)
    spaces = list(search_spaces(rig, vary, limits, materials or {}))
    # What each layer needs when its loads do not matter: it never needs less.
    free = replace(limits, max_strain=math.inf, max_acceleration=math.inf)
    speed = target.speed_after(0.0, rig.gravity)
    guesses = [_layer_that_needs_least(task, space, space.rig, free, speed) for space in spaces]
    order = sorted((guess.amplitude, i) for i, guess in enumerate(guesses) if guess is not None)
    easiest: _Candidate | None = None
    best: _Candidate | None = None
    for amplitude, i in order:
        # Re-contacts may make a throw better than its first release tells, but not by so much.
        if best is not None and amplitude > _WORTH * best.amplitude:
            break
        found = _reach(task, spaces[i], free)
        if found is not None and (easiest is None or found.amplitude < easiest.amplitude):
            easiest = found
        if found is not None and task.excess(found):
            found = _reach(task, spaces[i], limits)
        if found is not None and not task.excess(found):
            best = found if best is None or found.amplitude < best.amplitude else best
    if best is not None:
        return _aim(task, vary, best, _how(task, best), is_reached=True)
    most = _approach(task, spaces)
    if most is None:
        raise ThrowUnresolvedError(
            f'nothing is thrown within the limits, let alone {target.summary}'
        )
    reason = task.excess(easiest) if easiest is not None else ''
    return _aim(task, vary, most, _why_not(task, vary, reason, most), is_reached=False)


class _Candidate(NamedTuple):
    """A rig, the name of its layer in the library, and what its throw gives."""

    rig: Rig
    layer: str
    flight: FreeFlight
    prediction: Prediction

    @classmethod
    def of(cls, rig: Rig, layer: str) -> _Candidate:
        """Throw."""
        return cls(rig, layer, fly(rig), predict(rig))

    @property
    def amplitude(self) -> float:
        """Of the plate. [m]"""
        return self.rig.engine.amplitude


class _Task(NamedTuple):
    """What is asked."""

    rig: Rig
    target: Target
    limits: Limits
    max_amplitude: float
    cancelled: Cancelled | None

    def excess(self, found: _Candidate) -> str:
        """Say what of a throw is beyond the limits; nothing if nothing is."""
        loads = found.prediction
        parts = [
            f'{what} of {scale * value:.3g}{unit} instead of at most {scale * limit:.3g}{unit}'
            for what, value, limit, scale, unit in (
                ('an amplitude', found.amplitude, self.max_amplitude, 1e3, ' mm'),
                ('a strain', loads.peak_strain, self.limits.max_strain, 1e2, ' %'),
                ('an acceleration', loads.peak_acceleration, self.limits.max_acceleration,
                 1.0, ' m/s2'),
            )
            if value > limit * (1.0 + _MARGIN)
        ]  # fmt: skip
        return ' and '.join(parts)


class _Throws(NamedTuple):
    """Throws from layers of a rig, at an amplitude for each."""

    rig: Rig
    wave_speed: Floats
    amplitude: Floats
    throws: FirstThrows

    @classmethod
    def compute(
        cls,
        task: _Task,
        rig: Rig,
        thickness: Floats,
        wave_speed: Floats,
        amplitude: Floats,
        *,
        loads: bool,
    ) -> _Throws:
        """Throw."""
        ratios, _ = Variants.of(rig).ratios(rig, thickness, wave_speed)
        omega = rig.engine.angular_frequency
        ratios = ratios._replace(gravity_ratio=rig.gravity / (amplitude * omega * omega))
        throws = first_throws(ratios, loads=loads, cells=SEARCH_CELLS, cancelled=task.cancelled)
        return cls(rig, wave_speed, amplitude, throws)

    def needed(self, speed: float) -> Floats:
        """Compute the amplitudes that give a speed, as far as gravity stays as it is."""
        relative = np.where(self.throws.speed > 0.0, self.throws.speed, np.inf)
        amplitude: Floats = np.asarray(speed / (relative * self.rig.engine.angular_frequency))
        return np.where(amplitude > 0.0, amplitude, np.inf)

    def allowed(self, limits: Limits) -> Floats:
        """Compute the amplitudes that the limits allow, were the loads proportional to them."""
        omega = self.rig.engine.angular_frequency
        strain = self.throws.peak_strain * self.amplitude * omega / self.wave_speed
        acceleration = self.throws.peak_acceleration * self.amplitude * omega * omega
        factor = np.minimum(limits.max_strain / strain, limits.max_acceleration / acceleration)
        return np.where(self.throws.speed > 0.0, self.amplitude * factor, 0.0)


def _with_amplitude(rig: Rig, amplitude: float) -> Rig:
    return replace(rig, engine=replace(rig.engine, amplitude=amplitude))


class _Need(NamedTuple):
    """A layer, and the amplitude that it needs by its first release. [m]"""

    layer: Layer
    amplitude: float


def _reach(task: _Task, space: SearchSpace, limits: Limits) -> _Candidate | None:
    """Find layer and amplitude that reach the target; None if no layer keeps the limits."""
    target = task.target
    rise = 0.0
    found = None
    rig = space.rig
    for _ in range(_ROUNDS):
        speed = target.speed_after(rise, rig.gravity)
        need = _layer_that_needs_least(task, space, rig, limits, speed)
        if need is None:
            return None
        rig = replace(rig, layer=need.layer)
        amplitude = _amplitude(rig, target, task.cancelled)
        if amplitude is None:
            return None
        is_same = abs(amplitude / rig.engine.amplitude - 1.0) < _SAME
        rig = _with_amplitude(rig, amplitude)
        found = _Candidate.of(rig, space.name)
        rise = found.flight.rise
        if is_same or _is_one(space):
            break
    return found


def _is_one(space: SearchSpace) -> bool:
    """Tell whether there is but one layer to choose."""
    return all(low == high for low, high in space.layers)


def _layer_that_needs_least(
    task: _Task, space: SearchSpace, rig: Rig, limits: Limits, speed: float
) -> _Need | None:
    """Find the layer that reaches a speed with the least amplitude."""
    limits = replace(
        limits,
        max_strain=limits.max_strain * (1.0 - _ROOM),
        max_acceleration=limits.max_acceleration * (1.0 - _ROOM),
    )
    has_limits = limits.of_loads and not _is_one(space)

    def score(thickness: Floats, wave_speed: Floats, *, least: Floats) -> Floats:
        """Compute what the amplitudes needed are below a metre."""
        amplitude = np.full(thickness.shape, speed / rig.engine.angular_frequency)
        for _ in range(_ITERATIONS if rig.gravity > 0.0 else 1):
            step = _Throws.compute(task, rig, thickness, wave_speed, amplitude, loads=False)
            amplitude = np.minimum(step.needed(speed), _HIGHEST)
        result = np.where(amplitude < _HIGHEST, 1.0 / amplitude, 0.0)
        alive = np.flatnonzero(result > least)
        if has_limits and alive.size:
            loaded = _Throws.compute(
                task, rig, thickness[alive], wave_speed[alive], amplitude[alive], loads=True
            )
            result[alive] *= loaded.allowed(limits) >= amplitude[alive]
        return result

    best = find_best_layer(score, space.layers, step=grid_step(space))
    if best is None:
        return None
    layer = replace(rig.layer, thickness=best.thickness, wave_speed=best.wave_speed)
    return _Need(layer, 1.0 / best.score)


def _approach(task: _Task, spaces: list[SearchSpace]) -> _Candidate | None:
    """Find layer and amplitude that reach the most within the limits; None if none throws."""
    found = []
    for space in spaces:
        nearest = _layer_that_reaches_most(task, space)
        if nearest is not None:
            speed, rig = nearest
            found.append((speed, rig, space.name))
    found.sort(key=lambda item: -item[0])
    candidates = []
    for _, rig, name in found[:_NEAREST]:
        with contextlib.suppress(ThrowUnresolvedError):
            candidates.append(_Candidate.of(rig, name))
    return max(candidates, key=lambda each: task.target.reached(each.flight), default=None)


def _layer_that_reaches_most(task: _Task, space: SearchSpace) -> tuple[float, Rig] | None:
    """Find the layer whose projectile leaves fastest within the limits: (speed, rig)."""
    omega = space.rig.engine.angular_frequency

    def throw(thickness: Floats, wave_speed: Floats) -> tuple[Floats, Floats]:
        """Compute the amplitudes allowed, and the speeds that they give."""
        amplitude = np.full(np.shape(thickness), task.max_amplitude)
        for _ in range(_ITERATIONS):
            step = _Throws.compute(task, space.rig, thickness, wave_speed, amplitude, loads=True)
            allowed = np.minimum(step.allowed(task.limits), task.max_amplitude)
            amplitude = np.where(allowed > 0.0, allowed, amplitude)
        speed = np.where(step.throws.speed > 0.0, step.throws.speed, 0.0)
        return amplitude, amplitude * speed * omega

    def score(thickness: Floats, wave_speed: Floats, *, least: Floats) -> Floats:
        _, speed = throw(thickness, wave_speed)
        return np.where(speed >= least, speed, 0.0)

    best = find_best_layer(score, space.layers, step=grid_step(space))
    if best is None:
        return None
    amplitude, _ = throw(np.array([best.thickness]), np.array([best.wave_speed]))
    layer = replace(space.rig.layer, thickness=best.thickness, wave_speed=best.wave_speed)
    return best.score, _with_amplitude(replace(space.rig, layer=layer), float(amplitude[0]))


def _amplitude(rig: Rig, target: Target, cancelled: Cancelled | None) -> float | None:
    """Find the smallest amplitude that reaches a target with a layer; None if none does."""

    def excess(logarithm: float) -> float:
        """Compute the logarithm of what is reached over the target."""
        if cancelled is not None and cancelled():
            raise SearchCancelledError('the search was cancelled')
        try:
            flight = fly(_with_amplitude(rig, math.exp(logarithm)))
        except ThrowUnresolvedError:
            return _NOTHING
        reached = target.reached(flight)
        return math.log(reached / target.value) if reached > 0.0 else _NOTHING

    try:
        free = fly(replace(rig, gravity=0.0)).speed
    except ThrowUnresolvedError:
        return None
    speed = target.speed_after(0.0, rig.gravity)
    low = math.log(rig.engine.amplitude * speed / free)
    if rig.gravity == 0.0:
        return math.exp(low)
    while excess(low) >= 0.0:
        low -= _STEP
    high = low + _STEP
    while excess(high) < 0.0:
        low, high = high, high + _STEP
        if high > math.log(_HIGHEST):
            return None
    logarithm = brentq(excess, low, high, xtol=_EXACT, rtol=_EXACT)
    # a jump over the target is no solution
    return math.exp(logarithm) if abs(excess(logarithm)) < _JUMP else None


def _aim(task: _Task, vary: Vary, found: _Candidate, summary: str, *, is_reached: bool) -> Aim:
    return Aim(
        **vars(found.prediction),
        target_height=task.target.height,
        target_speed=task.target.speed,
        vary=vary,
        layer=found.layer,
        amplitude=found.amplitude,
        height=found.flight.height,
        speed=found.flight.speed,
        is_reached=is_reached,
        rig=found.rig,
        summary=summary,
    )


def _describe_layer(found: _Candidate) -> str:
    layer = found.rig.layer
    name = f'{found.layer}, ' if found.layer else ''
    return f'{name}{1e3 * layer.thickness:.4g} mm and {layer.wave_speed:.4g} m/s'


def _describe_loads(found: _Candidate) -> str:
    loads = found.prediction
    return (
        f'amplitude {1e3 * found.amplitude:.4g} mm, strain {1e2 * loads.peak_strain:.3g} %, '
        f'acceleration {loads.peak_acceleration:.3g} m/s2'
    )


def _how(task: _Task, found: _Candidate) -> str:
    """Say what reaches the target."""
    changed = found.rig.layer != task.rig.layer
    layer = (
        f'a layer of {_describe_layer(found)}' if changed or found.layer else 'the layer as it is'
    )
    return f'{layer} reaches {task.target.summary}: {_describe_loads(found)}'


def _why_not(task: _Task, vary: Vary, reason: str, most: _Candidate) -> str:
    """Say why the target is not reached, and what would reach it."""
    flight = most.flight
    reached = f'{flight.height:.4g} m high' if task.target.height else f'{flight.speed:.4g} m/s'
    text = (
        f'{task.target.summary} is not reached: '
        f'{f"it takes {reason}" if reason else "no amplitude does it"}; '
        f'the most is {reached}, with {_describe_loads(most)}'
    )
    if vary == 'amplitude':
        (other,) = search_spaces(task.rig, 'both', task.limits, {})
        found = _reach(task, other, task.limits)
        if found is not None and not task.excess(found):
            text += f'; a layer of {_describe_layer(found)} would do it: {_describe_loads(found)}'
    return text
