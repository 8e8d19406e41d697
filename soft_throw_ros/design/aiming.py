# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Aim a throw at a height or a speed of its last release, by the amplitude of the plate."""

from __future__ import annotations

from dataclasses import dataclass, replace
import functools
import math

import scipy  # its parts are imported where they are first used, which takes 0.3 s
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.core import checks
from soft_throw_ros.core.batch import Cancelled, ThrowUnresolvedError
from soft_throw_ros.core.material import LARGEST_STRAIN
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import rig_with, simulate, Throw
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.score import Limits

_MAX_AMPLITUDE = TWIN.by_name['engine.amplitude'].high  # where the search ends [m]
_BRACKET_STEP = 0.1  # step of the logarithm of the amplitude in the search for a bracket [-]


@dataclass(frozen=True, kw_only=True)
class Aim(PredictedThrow):
    """A throw that reaches its target."""

    amplitude: float  # amplitude of the plate [m]
    height: float  # rise of the projectile above its rest position; infinite without gravity [m]
    speed: float  # speed at the last release [m/s]
    rig: Rig  # the rig of this throw
    present: Rig  # the rig as it is

    @property
    def summary(self) -> str:
        """A sentence with the amplitude, what it reaches, and the loads."""
        height = f' and {self.height:.4g} m high' if self.height < math.inf else ''
        return (
            f'amplitude {1e3 * self.present.engine.amplitude:.4g} -> {1e3 * self.amplitude:.4g} '
            f'mm reaches {self.speed:.4g} m/s{height}: strain {1e2 * self.peak_strain:.3g} %, '
            f'acceleration {self.peak_acceleration:.3g} m/s2'
        )


def aim(
    rig: Rig,
    *,
    height: float | None = None,
    speed: float | None = None,
    limits: Limits | None = None,
    cancelled: Cancelled | None = None,
) -> Aim:
    """
    Find the smallest amplitude that reaches a height or a speed.

    The height [m] is above the rest position, the speed [m/s] that of the last release. Besides
    the limits of strain and acceleration, `LARGEST_STRAIN` is never exceeded.

    Notes
    -----
    With gravity the speed may jump where a later swing of the plate throws; the amplitude is
    looked for upwards from where the first swing would do without gravity.

    Examples
    --------
    >>> round(1e3 * aim(Rig(), height=0.15).amplitude, 3)
    2.453

    """
    if (height is None) == (speed is None):
        raise ValueError(f'give either a height or a speed, got height {height}, speed {speed}')
    if rig.engine.motion:
        raise ValueError('aiming needs a plate without a motion file, whose amplitude can be set')
    if height is not None and rig.gravity == 0.0:
        raise ValueError('a height needs gravity, got gravity 0; aim at a speed instead')
    target = checks.require_all('target', speed if height is None else height, 'positive')
    goal = f'{target:g} m/s' if height is None else f'{target:g} m high'
    needed = target if height is None else math.sqrt(2.0 * rig.gravity * target)

    @functools.cache
    def throw_with(logarithm: float) -> Throw:
        """Simulate the throw with an amplitude."""
        changed = rig_with(rig, {'amplitude': math.exp(logarithm)})
        return simulate(changed, cancelled=cancelled)

    def excess(logarithm: float) -> float:
        """Compute the relative excess over the target, -1 without a release."""
        try:
            throw = throw_with(logarithm)
        except ThrowUnresolvedError:
            return -1.0
        reached = throw.last_release.velocity if height is None else throw.flight_height
        return float(reached / target - 1.0)

    free = simulate(replace(rig, gravity=0.0), cancelled=cancelled).last_release.velocity
    low = math.log(rig.engine.amplitude * needed / free)
    while excess(low) >= 0.0:
        low -= _BRACKET_STEP
    high = low + _BRACKET_STEP
    while excess(high) < 0.0 and high < math.log(_MAX_AMPLITUDE):
        low, high = high, high + _BRACKET_STEP
    is_reached = excess(high) >= 0.0
    logarithm = float(scipy.optimize.brentq(excess, low, high)) if is_reached else high
    amplitude = math.exp(logarithm)
    # at a jump the target is passed and not reached
    if amplitude > _MAX_AMPLITUDE or abs(excess(logarithm)) > 1e-5:
        raise ThrowUnresolvedError(f'no amplitude up to {_MAX_AMPLITUDE:g} m reaches {goal}')
    last, limits = throw_with(logarithm), limits or Limits()
    throw = predict(last.rig)
    for name, value, limit in (
        ('strain', throw.peak_strain, min(limits.max_strain, LARGEST_STRAIN)),
        ('acceleration', throw.peak_acceleration, limits.max_acceleration),
    ):
        if value > limit:
            raise ThrowUnresolvedError(
                f'{goal} takes an amplitude of {1e3 * amplitude:.4g} mm and a peak {name} of '
                f'{value:.4g}, which must be at most {limit:g}'
            )
    return Aim(
        **vars(throw), amplitude=amplitude, height=last.flight_height,
        speed=last.last_release.velocity, rig=last.rig, present=rig,
    )
