# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Aim a throw: find the amplitude, or layer and amplitude, that reach a height or a speed.

The layer is searched by first releases, which are fast to compute. The amplitude is solved for by
the last release, because re-contacts change the flight.
"""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
from dataclasses import dataclass, replace
import math
from typing import get_args, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts are imported where they are first used, which takes 0.3 s
from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.material import LARGEST_STRAIN
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import (
    Cancelled,
    check_cancelled,
    last_release,
    LastRelease,
    rig_with,
    SEARCH_CELLS,
    throw_many,
)
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.optimise import find_best_layer, Optimum
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.search_space import search_spaces, SearchSpace

Floats = NDArray[np.float64]

AimVary: TypeAlias = Literal['amplitude', 'thickness', 'wave_speed', 'both', 'library']

_BRACKET_STEP = 0.1
"""Step of the logarithm of the amplitude in the search for a bracket. [-]"""

_MAX_BRACKET = 10.0
"""Amplitude at which the search for a bracket ends. [m]"""

_UNRELEASED = -10.0
"""Logarithm of reached over target that stands for a throw without a release. [-]"""

_AMPLITUDE_TOLERANCE = 1e-9
"""Error of the logarithm of the amplitude. [-]"""

_TARGET_TOLERANCE = 1e-5
"""Relative error of the target; a solution that misses it by more lies at a jump. [-]"""

_LOAD_TOLERANCE = 1e-6
"""Relative excess of a load over its limit that is rounding. [-]"""

_GRAVITY_ITERATIONS = 3
"""Iterations of the amplitude that a layer needs, which gravity makes depend on itself."""

_MAX_FOLLOWED = 5
"""Number of layers, the best by their first releases, that are followed to the last release."""

_LOAD_MARGIN = 2e-3
"""Part of a limit that the search for a layer leaves for the error of its loads. [-]"""

_AT_LIMIT = 0.99
"""Share of a limit that makes the limit the reason for a missed target. [-]"""


@dataclass(frozen=True, kw_only=True)
class Target:
    """
    Height or speed that a throw shall reach; exactly one of the two.

    Parameters
    ----------
    height : float
        Rise of the projectile above its rest position on the layer. [m]
    speed : float
        Speed of the projectile at its last release. [m/s]

    Raises
    ------
    ValueError
        If both are given or neither, or one is not finite and positive.

    """

    height: float | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        names = [name for name, value in vars(self).items() if value is not None]
        if len(names) != 1:
            raise ValueError(
                f'give either a height or a speed as target, got {"both" if names else "neither"}'
            )
        name = names[0]
        object.__setattr__(self, name, checks.require_positive(name, getattr(self, name)))

    @property
    def value(self) -> float:
        """Height [m] or speed [m/s]."""
        value = self.height or self.speed
        assert value is not None  # the constructor ensures a positive height or speed
        return value

    def reached(self, throw: LastRelease | Aim) -> float:
        """Return the height or the speed of a throw, to be compared with `value`."""
        return throw.height if self.height else throw.speed

    def speed_needed(self, gravity: float, rise: float = 0.0) -> float:
        """Return the speed that reaches the target from a height above the rest position [m/s]."""
        if self.height is None:
            return self.value
        return math.sqrt(2.0 * gravity * max(self.height - rise, 1e-3 * self.height))


@dataclass(frozen=True, kw_only=True)
class Aim(PredictedThrow):
    """A throw that reaches its target, or the throw that reaches most."""

    target_height: float | None
    """The target, or None. [m]"""
    target_speed: float | None
    """The target, or None. [m/s]"""
    vary: AimVary
    """Part of the layer that was allowed to change, besides the amplitude."""
    layer: str
    """Name of the layer in the library, if it was picked there."""
    amplitude: float
    """Amplitude of the plate. [m]"""
    height: float
    """Rise of the projectile above its rest position; infinite without gravity. [m]"""
    speed: float
    """Speed at the last release. [m/s]"""
    is_reached: bool
    """Whether the throw reaches the target."""
    limited_by: str = ''
    """
    Names of the limits that keep the throw from its target, among `max_amplitude`, `max_strain`
    and `max_acceleration`; empty if it is reached, or no amplitude reaches it.
    """
    rig: Rig
    """The rig of this throw."""


def aim(
    rig: Rig,
    target: Target,
    *,
    vary: AimVary = 'amplitude',
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
        Rig with the present layer; its amplitude is not used.
    target : Target
        Height or speed to reach.
    vary : {'amplitude', 'thickness', 'wave_speed', 'both', 'library'}
        The part of the layer that may change besides the amplitude.
    limits, materials, cancelled : optional
        As for `recommend`; a strain of `core.material.LARGEST_STRAIN` is never exceeded.
    max_amplitude : float
        Largest amplitude of the plate. [m]

    Returns
    -------
    Aim
        If the target is out of reach, the throw that reaches most within the limits.

    Raises
    ------
    ValueError
        If a choice is unknown, `max_amplitude` is not positive, the layer is not of one material,
        or the target is a height and there is no gravity.
    ThrowUnresolvedError
        If nothing is thrown at all within the limits.
    SearchCancelledError
        If `cancelled` returns True.

    Notes
    -----
    Without gravity the speed is proportional to the amplitude. With gravity it may jump, where a
    later swing of the plate throws; the smallest amplitude is looked for upwards from where the
    first swing would do without gravity.

    Examples
    --------
    >>> throw = aim(Rig(), Target(height=0.15))
    >>> round(1e3 * throw.amplitude, 3), throw.is_reached
    (2.453, True)

    """
    limits = limits or Limits()
    checks.require_positive('max_amplitude', max_amplitude)
    if vary not in get_args(AimVary):
        raise ValueError(f'vary must be one of {", ".join(get_args(AimVary))}, got {vary!r}')
    if rig.engine.motion:
        raise ValueError(
            'aiming needs a plate whose amplitude can be set, got a motion from a file'
        )
    if target.height is not None and rig.gravity == 0.0:
        raise ValueError('a height needs gravity, got gravity 0; aim at a speed instead')
    limits = replace(limits, max_strain=min(limits.max_strain, LARGEST_STRAIN))
    search = _AimSearch(
        target=target, vary=vary, limits=limits, max_amplitude=max_amplitude, cancelled=cancelled
    )
    spaces = search_spaces(rig, vary, limits, materials or {})
    options = [(space, best) for space in spaces if (best := search.best_layer(space)) is not None]
    options = sorted(options, key=lambda option: -option[1].score)[:_MAX_FOLLOWED]
    throws = [throw for option in options if (throw := search.solve(*option)) is not None]
    if throws:
        return min(throws, key=lambda throw: throw.amplitude)
    throws = [throw for option in options if (throw := search.closest(*option)) is not None]
    if not throws:
        text = f'{target.height:g} m high' if target.height else f'{target.speed:g} m/s'
        raise ThrowUnresolvedError(f'no throw is possible within the limits, target {text}')
    closest = max(throws, key=target.reached)
    limited_by = ', '.join(search.active_limits(closest, _AT_LIMIT))
    return replace(closest, is_reached=False, limited_by=limited_by)


@dataclass(frozen=True, kw_only=True)
class _AimSearch:
    """A search for the smallest amplitude within limits; the fields are arguments of `aim`."""

    target: Target
    vary: AimVary
    limits: Limits
    max_amplitude: float
    cancelled: Cancelled | None

    def active_limits(self, throw: Aim, share: float = 1.0) -> list[str]:
        """Return the names of the limits that a throw exceeds, or exceeds a share of."""
        return [
            name
            for name, value, limit in (
                ('max_amplitude', throw.amplitude, self.max_amplitude),
                ('max_strain', throw.peak_strain, self.limits.max_strain),
                ('max_acceleration', throw.peak_acceleration, self.limits.max_acceleration),
            )
            if value > share * limit * (1.0 + _LOAD_TOLERANCE)
        ]

    def best_layer(self, space: SearchSpace, rise: float = 0.0) -> Optimum | None:
        """
        Find the layer that needs the smallest amplitude, or reaches most if none reaches enough.

        Its score is `max_amplitude` over the amplitude that it needs, or below 1 the part of the
        needed speed that it reaches within the limits. `rise` is the height of the last release
        above the rest position. [m]
        """
        speed = self.target.speed_needed(space.rig.gravity, rise)
        margin = 0.0 if space.is_single else _LOAD_MARGIN

        def score(thickness: Floats, wave_speed: Floats) -> Floats:
            needed, allowed = self._amplitudes(space.rig, thickness, wave_speed, speed, margin)
            shares = np.minimum(allowed / needed, 1.0 - 1e-9)
            return np.where(needed <= allowed, self.max_amplitude / needed, shares)

        return find_best_layer(
            score, space.layers, step=space.grid_step(loads=True), tolerance=1e-4
        )

    def solve(self, space: SearchSpace, best: Optimum) -> Aim | None:
        """
        Solve for the amplitude that reaches the target with a layer; None without a solution.

        A layer that may vary is searched once more with the height of the first solution's
        release, because it may lie at the edge of a jump.
        """
        first = self._solve_with(space, best)
        throws = [first]
        if first is not None and not space.is_single and first.rig.gravity > 0.0:
            rise = first.height - first.speed**2 / (2.0 * first.rig.gravity)
            better = self.best_layer(space._replace(rig=first.rig), rise)
            throws.append(better and self._solve_with(space, better))
        allowed = [throw for throw in throws if throw and not self.active_limits(throw)]
        return min(allowed, key=lambda throw: throw.amplitude, default=None)

    def _solve_with(self, space: SearchSpace, best: Optimum) -> Aim | None:
        """Solve for the amplitude with a layer, limits apart; None without a solution."""
        if best.score < 1.0 and not space.is_single:
            return None
        rig = space.rig_with(best)
        amplitude = self._amplitude(rig)
        return None if amplitude is None else self._throw(rig, amplitude, space.name)

    def closest(self, space: SearchSpace, best: Optimum) -> Aim | None:
        """Follow the throw of a layer that reaches most within the limits; None if none does."""
        rig = space.rig_with(best)
        layer = np.array([best.thickness]), np.array([best.wave_speed])
        _, allowed = self._amplitudes(rig, *layer, math.inf, 0.0)
        with contextlib.suppress(ThrowUnresolvedError):
            return self._throw(rig, float(allowed[0]), space.name)
        return None

    def _throw(self, rig: Rig, amplitude: float, layer: str) -> Aim:
        """Follow a throw to its last release."""
        rig = rig_with(rig, {'amplitude': amplitude})
        last = last_release(rig)
        return Aim(
            **vars(predict(rig)),
            target_height=self.target.height,
            target_speed=self.target.speed,
            vary=self.vary,
            layer=layer,
            amplitude=amplitude,
            height=last.height,
            speed=last.speed,
            is_reached=True,
            rig=rig,
        )

    def _amplitudes(
        self, rig: Rig, thickness: Floats, wave_speed: Floats, speed: float, margin: float
    ) -> tuple[Floats, Floats]:
        """Return the amplitudes that layers need for a speed, and may have, by first releases."""
        start = min(speed / rig.engine.angular_frequency, self.max_amplitude)
        amplitude = np.full(np.shape(thickness), start)
        needed = allowed = amplitude
        # Without gravity everything is proportional to the amplitude.
        for _ in range(_GRAVITY_ITERATIONS if rig.gravity > 0.0 else 1):
            changes = {'thickness': thickness, 'wave_speed': wave_speed, 'amplitude': amplitude}
            throws = throw_many(
                rig, changes, loads=self.limits.of_loads, cells=SEARCH_CELLS,
                cancelled=self.cancelled,
            )
            speeds = np.maximum(np.nan_to_num(throws.ejection_speed), 1e-300)
            needed = amplitude * speed / speeds
            allowed = np.full(amplitude.shape, self.max_amplitude)
            for limit, load in (
                (self.limits.max_strain, throws.peak_strain),
                (self.limits.max_acceleration, throws.peak_acceleration),
            ):
                if limit < math.inf:
                    allowed = np.fmin(allowed, (1.0 - margin) * amplitude * limit / load)
            amplitude = np.minimum(needed, allowed)
        return needed, allowed

    def _amplitude(self, rig: Rig) -> float | None:
        """Find the smallest amplitude that reaches the target with a layer; None if none does."""
        target = self.target

        def excess(logarithm: float) -> float:
            """Compute the logarithm of reached over target."""
            check_cancelled(self.cancelled)
            try:
                last = last_release(rig_with(rig, {'amplitude': math.exp(logarithm)}))
            except ThrowUnresolvedError:
                return _UNRELEASED
            reached = target.reached(last)
            return math.log(reached / target.value) if reached > 0.0 else _UNRELEASED

        try:
            free = last_release(replace(rig, gravity=0.0)).speed
        except ThrowUnresolvedError:
            return None
        low = math.log(rig.engine.amplitude * target.speed_needed(rig.gravity) / free)
        if rig.gravity == 0.0:
            return math.exp(low)
        while excess(low) >= 0.0:
            low -= _BRACKET_STEP
        high = low + _BRACKET_STEP
        while excess(high) < 0.0:
            low, high = high, high + _BRACKET_STEP
            if high > math.log(_MAX_BRACKET):
                return None
        logarithm = float(scipy.optimize.brentq(
            excess, low, high, xtol=_AMPLITUDE_TOLERANCE, rtol=_AMPLITUDE_TOLERANCE
        ))
        # A jump across the target is no solution.
        return math.exp(logarithm) if abs(excess(logarithm)) < _TARGET_TOLERANCE else None
