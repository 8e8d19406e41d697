# SPDX-License-Identifier: Apache-2.0
"""
Aim a throw: find the amplitude, or layer and amplitude, that reach a height or a speed.

What flies up is what leaves for the last time, so re-contacts count here, unless the layer has
internal loss: then the first release is taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
import math
from typing import get_args, Literal, NamedTuple, TypeAlias

from scipy.optimize import brentq
from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core import checks, normal_modes, travelling_wave
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.stepping import EventLimitError, PROJECTILE_POSITION
from soft_throw_ros.core.travelling_wave import ThrowUnresolvedError
from soft_throw_ros.design.objective import Limits, Peak, problem_of
from soft_throw_ros.design.recommendation import places, predict, Prediction, Span
from soft_throw_ros.design.search import find_summit, Problem

Vary: TypeAlias = Literal['amplitude', 'thickness', 'wave_speed', 'both', 'library']

_AFTER = 2.0  # plate periods for which re-contacts are waited for
_STEP = 0.1  # of the logarithm of the amplitude, in looking for a bracket, ...
_HIGHEST = 10.0  # and where that ends [m]
_NEVER = 10.0  # as a logarithm: what is not thrown
_EXACT = 1e-12  # in the logarithm of the amplitude
_JUMP = 1e-6  # likewise; what is found further from the target lies at a jump
_ROUNDS = 6  # of layer and amplitude in turn
_SAME = 1e-7  # amplitudes of two rounds that differ by less are the same
_MARGIN = 1e-6  # a load this far beyond its limit is at the limit, ...
_ROOM = 1e-5  # and so much is left in a search
_OF_LAYER = ('thickness_min', 'thickness_max', 'wave_speed_min', 'wave_speed_max')


@dataclass(frozen=True, kw_only=True)
class Target:
    """
    What a throw is to reach; one of the two.

    Parameters
    ----------
    height : float
        How far the projectile rises above where it rests; infinite without gravity. [m]
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
                'either a height or a speed must be given as target, got '
                f'{"both" if given else "neither"}'
            )
        name = given[0]
        object.__setattr__(self, name, checks.positive(name, getattr(self, name)))

    @property
    def words(self) -> str:
        """What is aimed at, in words."""
        return f'{self.height:g} m high' if self.height else f'{self.speed:g} m/s'

    @property
    def value(self) -> float:
        """Height [m] or speed [m/s]."""
        value = self.height or self.speed
        assert value is not None  # one of them is positive
        return value

    def reached(self, flight: Flight) -> float:
        """Return what of a flight compares with `value`."""
        return flight.height if self.height else flight.speed

    def speed_after(self, rise: float, gravity: float) -> float:
        """Return the speed that reaches it for a projectile that has risen so far. [m/s]"""
        if self.height is None:
            return self.value
        return math.sqrt(2.0 * gravity * max(self.height - rise, 1e-3 * self.height))


class Flight(NamedTuple):
    """Speed of the last release [m/s], rise until then [m], and the height reached [m]."""

    speed: float
    rise: float
    height: float


def fly(rig: Rig) -> Flight:
    r"""
    Follow a throw until the projectile has left for good.

    Parameters
    ----------
    rig : Rig
        What throws. With loss in its layer, only the first release is taken.

    Returns
    -------
    Flight
        As the stepper has it: without loss its speed is off by 1e-6 of :math:`A \omega` at most.

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
    engine = rig.engine
    ratios = {
        'mass_ratio': rig.mass_ratio,
        'speed_ratio': rig.speed_ratio,
        'damping_ratio': engine.damping_ratio,
        'gravity_ratio': rig.gravity_ratio,
    }
    loss = rig.layer.loss_tangent
    if loss > 0.0:
        release = normal_modes.first_release(**ratios, loss_tangent=loss)
        speed = float(release.speed) * engine.speed_scale
        rise = normal_modes.first_rise(**ratios, loss_tangent=loss) * engine.amplitude
    else:
        release = travelling_wave.first_release(**ratios)
        stepper = Stepper(rig, field_points=2)
        try:
            stepper.advance_to((float(release.ejection_phase) + _AFTER) / engine.frequency)
        except EventLimitError as error:
            raise ThrowUnresolvedError(f'the projectile chatters without end: {error}') from error
        last = None
        for event in stepper.events():
            if event.kind == 'release':
                last = event
            elif event.velocity <= 0.0 and rig.gravity > 0.0:
                break  # it has come down
        assert last is not None  # the closed form has found one
        speed = last.velocity
        stepper.reset()
        stepper.advance_to(last.time)
        rise = float(stepper.state[PROJECTILE_POSITION]) - stepper.rest_position
    if rig.gravity == 0.0:
        return Flight(speed, rise, math.inf)
    return Flight(speed, rise, rise + max(speed, 0.0) ** 2 / (2.0 * rig.gravity))


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
        How far the projectile rises; infinite without gravity. [m]
    speed : float
        Of its last release. [m/s]
    is_reached : bool
        Whether that is the target.
    rig : Rig
        The rig that throws so.
    why : str
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
    why: str

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
        What must not be exceeded. Those of the layer do not concern what may not change.
    max_amplitude : float
        That the plate can do. [m]
    materials : mapping of str to Material, optional
        From which one is picked, if `vary` is 'library'.

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
    checks.positive('max_amplitude', max_amplitude)
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    if type(rig.layer) is not Layer:  # a graded one is a kind of it
        raise ValueError(f'only layers of one material are aimed with, got {rig.layer!r}')
    if target.height is not None and rig.gravity == 0.0:
        raise ValueError('a height needs gravity, got gravity 0; aim at a speed instead')
    task = _Task(rig, target, limits, max_amplitude)
    # what each layer needs when its loads do not matter: it never needs less
    free = replace(limits, max_strain=math.inf, max_acceleration=math.inf)
    choices = list(_choices(task, vary, materials or {}))
    needed = [(shot, choice) for choice in choices if (shot := _reach(task, choice, free))]
    needed.sort(key=lambda pair: pair[0].amplitude)
    best: _Shot | None = None
    for easiest, choice in needed:
        if best is None or easiest.amplitude < best.amplitude:
            shot = _reach(task, choice, limits) if task.excess(easiest) else easiest
            if shot is not None and not task.excess(shot):
                best = shot if best is None or shot.amplitude < best.amplitude else best
    if best is not None:
        return _aim(task, vary, best, _how(task, best), is_reached=True)
    nearest = [shot for choice in choices if (shot := _approach(task, choice))]
    if not nearest:
        raise ThrowUnresolvedError(
            f'nothing is thrown within the limits, let alone {target.words}'
        )
    most = max(nearest, key=lambda shot: target.reached(shot.flight))
    reason = task.excess(needed[0][0]) if needed else ''
    return _aim(task, vary, most, _why_not(task, vary, reason, most), is_reached=False)


class _Shot(NamedTuple):
    """A rig, the name of its layer in the library, and what its throw gives."""

    rig: Rig
    layer: str
    flight: Flight
    prediction: Prediction

    @classmethod
    def of(cls, rig: Rig, layer: str) -> _Shot:
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

    def excess(self, shot: _Shot) -> str:
        """Say what of a shot is beyond the limits; nothing if nothing is."""
        loads = shot.prediction
        words = [
            f'{what} of {scale * value:.3g}{unit} instead of at most {scale * limit:.3g}{unit}'
            for what, value, limit, scale, unit in (
                ('an amplitude', shot.amplitude, self.max_amplitude, 1e3, ' mm'),
                ('a strain', loads.peak_strain, self.limits.max_strain, 1e2, ' %'),
                ('an acceleration', loads.peak_acceleration, self.limits.max_acceleration,
                 1.0, ' m/s2'),
            )
            if value > limit * (1.0 + _MARGIN)
        ]  # fmt: skip
        return ' and '.join(words)


class _Choice(NamedTuple):
    """A layer with what may vary of it, and its name in the library."""

    rig: Rig
    layer: str
    thickness: Span | None
    wave_speed: Span | None


def _choices(task: _Task, vary: Vary, materials: Mapping[str, Material]) -> Iterator[_Choice]:
    """Yield what there is to choose from."""
    limits = task.limits
    if vary == 'library':
        for place in places(task.rig, limits, materials):
            yield _Choice(place.rig, place.layer, place.thickness, None)
    else:
        thickness = limits.thickness if vary in ('thickness', 'both') else None
        wave_speed = limits.wave_speed if vary in ('wave_speed', 'both') else None
        yield _Choice(task.rig, '', thickness, wave_speed)


def _with_amplitude(rig: Rig, amplitude: float) -> Rig:
    return replace(rig, engine=replace(rig.engine, amplitude=amplitude))


def _reach(task: _Task, choice: _Choice, limits: Limits) -> _Shot | None:
    """Find layer and amplitude that reach the target; None if no layer keeps the limits."""
    target = task.target
    rise = 0.0
    speed = target.speed_after(rise, choice.rig.gravity)
    rig = _with_amplitude(choice.rig, speed / choice.rig.engine.angular_frequency)
    for _ in range(_ROUNDS):
        before = rig
        if choice.thickness or choice.wave_speed:
            speed = target.speed_after(rise, rig.gravity)
            problem = problem_of(rig, Peak(), _tightened(limits), target_speed=speed)
            layer = _best_layer(problem, choice, rig)
            if layer is None:
                return None
            rig = replace(rig, layer=layer)
        amplitude = _amplitude(rig, target)
        if amplitude is None:
            return None
        rig = _with_amplitude(rig, amplitude)
        shot = _Shot.of(rig, choice.layer)
        rise = shot.flight.rise
        is_same = abs(amplitude / before.engine.amplitude - 1.0) < _SAME
        if is_same or not (choice.thickness or choice.wave_speed):
            break
    return shot


def _approach(task: _Task, choice: _Choice) -> _Shot | None:
    """Find layer and amplitude that reach the most within the limits; None if none throws."""
    rig = _with_amplitude(choice.rig, task.max_amplitude)
    shot = None
    for _ in range(_ROUNDS):
        before = rig.engine.amplitude
        if choice.thickness or choice.wave_speed:
            problem = problem_of(rig, Peak(), task.limits)
            problem = problem._replace(cap=task.max_amplitude / rig.engine.amplitude)
            layer = _best_layer(problem, choice, rig)
            if layer is None:
                return None
            rig = replace(rig, layer=layer)
        try:
            for _ in range(_ROUNDS):
                rig = _with_amplitude(rig, _allowed_amplitude(rig, task))
            shot = _Shot.of(rig, choice.layer)
        except ThrowUnresolvedError:
            return None
        if abs(rig.engine.amplitude / before - 1.0) < _SAME:
            break
    return shot


def _best_layer(problem: Problem, choice: _Choice, rig: Rig) -> Layer | None:
    """Find the best layer for a problem, which counts from that of the rig."""
    given = rig.layer
    thickness = choice.thickness or (given.thickness, given.thickness)
    wave_speed = choice.wave_speed or (given.wave_speed, given.wave_speed)
    summit = find_summit(
        problem,
        thickness_factors=(thickness[0] / given.thickness, thickness[1] / given.thickness),
        wave_speed_factors=(wave_speed[0] / given.wave_speed, wave_speed[1] / given.wave_speed),
    )
    if math.isnan(summit.score):
        return None
    return replace(
        given,
        thickness=min(max(given.thickness * summit.thickness_factor, thickness[0]), thickness[1]),
        wave_speed=min(
            max(given.wave_speed * summit.wave_speed_factor, wave_speed[0]), wave_speed[1]
        ),
    )


def _tightened(limits: Limits) -> Limits:
    """Leave room for what a search by steps does not see."""
    return replace(
        limits,
        max_strain=limits.max_strain * (1.0 - _ROOM),
        max_acceleration=limits.max_acceleration * (1.0 - _ROOM),
    )


def _allowed_amplitude(rig: Rig, task: _Task) -> float:
    """Scale the amplitude to what the limits allow, were the loads proportional to it."""
    loads = predict(rig)
    factor = min(
        task.limits.max_strain / loads.peak_strain,
        task.limits.max_acceleration / loads.peak_acceleration,
    )
    return min(rig.engine.amplitude * factor, task.max_amplitude)


def _amplitude(rig: Rig, target: Target) -> float | None:
    """Find the smallest amplitude that reaches a target with a layer; None if none does."""

    def excess(logarithm: float) -> float:
        """Compute the logarithm of what is reached over the target."""
        try:
            flight = fly(_with_amplitude(rig, math.exp(logarithm)))
        except ThrowUnresolvedError:
            return -_NEVER
        reached = target.reached(flight)
        return math.log(reached / target.value) if reached > 0.0 else -_NEVER

    free = fly(replace(rig, gravity=0.0)).speed
    if free <= 0.0:
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


def _aim(task: _Task, vary: Vary, shot: _Shot, why: str, *, is_reached: bool) -> Aim:
    return Aim(
        **vars(shot.prediction),
        target_height=task.target.height,
        target_speed=task.target.speed,
        vary=vary,
        layer=shot.layer,
        amplitude=shot.amplitude,
        height=shot.flight.height,
        speed=shot.flight.speed,
        is_reached=is_reached,
        rig=shot.rig,
        why=why,
    )


def _layer_in_words(shot: _Shot) -> str:
    layer = shot.rig.layer
    name = f'{shot.layer}, ' if shot.layer else ''
    return f'{name}{1e3 * layer.thickness:.4g} mm and {layer.wave_speed:.4g} m/s'


def _loads_in_words(shot: _Shot) -> str:
    loads = shot.prediction
    return (
        f'amplitude {1e3 * shot.amplitude:.4g} mm, strain {1e2 * loads.peak_strain:.3g} %, '
        f'acceleration {loads.peak_acceleration:.3g} m/s2'
    )


def _how(task: _Task, shot: _Shot) -> str:
    """Say what reaches the target."""
    changed = shot.rig.layer != task.rig.layer
    layer = (
        f'a layer of {_layer_in_words(shot)}' if changed or shot.layer else 'the layer as it is'
    )
    return f'{layer} reaches {task.target.words}: {_loads_in_words(shot)}'


def _why_not(task: _Task, vary: Vary, reason: str, most: _Shot) -> str:
    """Say why the target is not reached, and what would reach it."""
    flight = most.flight
    reached = f'{flight.height:.4g} m high' if task.target.height else f'{flight.speed:.4g} m/s'
    text = (
        f'{task.target.words} is not reached: '
        f'{f"it takes {reason}" if reason else "no amplitude does it"}; '
        f'the most is {reached}, with {_loads_in_words(most)}'
    )
    if vary == 'amplitude':
        other = next(_choices(task, 'both', {}))
        shot = _reach(task, other, task.limits)
        if shot is not None and not task.excess(shot):
            text += f'; a layer of {_layer_in_words(shot)} would do it: {_loads_in_words(shot)}'
    return text
