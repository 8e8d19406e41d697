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
"""What the best motion of the plate gives, beside what else the same actuator could do."""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
from dataclasses import dataclass, replace
import math
from typing import get_args, Literal, TypeAlias

import numpy as np
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.plate import motion_of, PlateMotion, SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.evaluate import Cancelled, first_throws, require_uniform, rig_with
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.plate_motion import (
    find_best_layer,
    find_best_motion,
    linear_layer,
    PlateLimits,
    rest_to_rest,
    with_motion,
)
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.recommendation import recommend

Vary: TypeAlias = Literal['motion', 'thickness', 'wave_speed', 'both']

_FREQUENCIES = np.geomspace(0.05, 20.0, 1200)  # of harmonic motions that are tried, over the rig's


@dataclass(frozen=True, kw_only=True)
class MotionDesign(PredictedThrow):
    """
    The best motion of the plate, and what it gives.

    Parameters
    ----------
    rig : Rig
        The rig whose plate moves so, with the layer that was found if one was looked for.
    vary : {'motion', 'thickness', 'wave_speed', 'both'}
        What of the layer was allowed to change; nothing if it is 'motion'.
    limits : PlateLimits
        Of the actuator.
    others : mapping of str to Rig
        What it is to be compared with: the rig `now`, and with the `harmonic` motion and the
        `step` of the same limits that throw best, the `layer` that is best as the plate moves
        now, unless it is a stack, and the `linear` one with the best motion if it is not linear;
        as far as they throw.
    throws : mapping of str to PredictedThrow
        What they give, and the `best`; `both` if the layer was looked for, and then `best` is with
        the layer that there is.
    layer : str
        Empty: it is of no library.
    summary : str
        What is gained, in a sentence.

    """

    rig: Rig
    vary: Vary
    limits: PlateLimits
    others: Mapping[str, Rig]
    throws: Mapping[str, PredictedThrow]
    layer: str = ''
    summary: str = ''

    @property
    def motion(self) -> SampledMotion:
        """How the plate is to move."""
        assert self.rig.engine.motion is not None
        return self.rig.engine.motion

    @property
    def motions(self) -> dict[str, PlateMotion]:
        """How the plate moves in each case; the best one last."""
        shown = [name for name in ('now', 'harmonic', 'step') if name in self.others]
        found = {name: motion_of(self.others[name].engine) for name in shown}
        return {**found, 'best': self.motion}

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        parts = {f'{name}.': vars(throw) for name, throw in self.throws.items() if name != 'best'}
        return super().values() | {
            f'{prefix}{key}': value
            for prefix, part in parts.items()
            for key, value in part.items()
        }


def design_motion(
    rig: Rig,
    plate: PlateLimits | None = None,
    *,
    vary: Vary = 'motion',
    limits: Limits | None = None,
    cancelled: Cancelled | None = None,
) -> MotionDesign:
    """
    Find the motion of the plate that throws best, alone or together with the layer.

    Parameters
    ----------
    rig : Rig
        As it is now.
    plate : PlateLimits, optional
        What the actuator can do; if not given, what it does now.
    vary : {'motion', 'thickness', 'wave_speed', 'both'}
        What of the layer may change besides.
    limits : Limits, optional
        Of the layer, its strain, and the projectile's acceleration.
    cancelled : callable, optional
        Asked every few tenths of a second whether to give up.

    Raises
    ------
    ValueError
        If a choice is unknown, or a stack is to be varied.
    ThrowUnresolvedError
        If nothing is thrown within the limits.
    SearchCancelledError
        If `cancelled` says so.

    Examples
    --------
    >>> design_motion(Rig(gravity=0.0)).summary
    'with the same motor, 15 % more energy by moving the plate so, 14 % by a layer of ...'

    """
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    if vary != 'motion':
        require_uniform(rig)
    plate, limits = plate or PlateLimits.of(rig.engine), limits or Limits()
    own = find_best_motion(rig, plate, loads=limits, cancelled=cancelled).motion
    assert isinstance(own, SampledMotion)
    best = with_motion(rig, own)
    rigs = {'now': rig, 'harmonic': _harmonic(rig, plate, cancelled), 'step': _step(rig, plate)}
    if rig.layer.is_uniform:
        with contextlib.suppress(ThrowUnresolvedError):
            varied = 'both' if vary == 'motion' else vary
            rigs['layer'] = recommend(rig, vary=varied, limits=limits, cancelled=cancelled).rig
    found = {'best': best}
    if vary != 'motion':
        better = find_best_layer(rig, plate, vary, loads=limits, cancelled=cancelled)
        throw = find_best_motion(better, plate, loads=limits, cancelled=cancelled)
        assert isinstance(throw.motion, SampledMotion)
        best = found['both'] = with_motion(better, throw.motion)
    if rig.layer.elasticity != 'linear':
        rigs['linear'] = replace(best, layer=linear_layer(best.layer))
    throws = {}
    for name, each in (rigs | found).items():
        with contextlib.suppress(ThrowUnresolvedError):
            throws[name] = predict(each)
    answer = MotionDesign(
        **vars(throws['both' if vary != 'motion' else 'best']),
        rig=best,
        vary=vary,
        limits=plate,
        others={name: each for name, each in rigs.items() if name in throws},
        throws=throws,
    )
    return replace(answer, summary=_summary(answer))


def _harmonic(rig: Rig, plate: PlateLimits, cancelled: Cancelled | None) -> Rig:
    """Return the rig with the harmonic motion within the limits that throws best."""
    frequency = rig.engine.frequency * _FREQUENCIES
    omega = 2.0 * math.pi * frequency
    amplitude = np.min(
        [
            plate.speed / omega,
            plate.acceleration / omega**2,
            plate.jerk / omega**3,
            np.full(omega.shape, 0.5 * plate.travel),
        ],
        axis=0,
    )
    growth = _FREQUENCIES if rig.layer.loss == 'kelvin_voigt' else np.ones(omega.size)
    changes = {
        'frequency': frequency,
        'amplitude': amplitude,
        'loss_tangent': rig.layer.loss_tangent * growth,
    }
    harmonic = replace(rig, engine=replace(rig.engine, damping_ratio=0.0, motion=None))
    throws = first_throws(harmonic, changes, cancelled=cancelled)
    best = int(np.nan_to_num(throws.ejection_speed).argmax())
    return rig_with(harmonic, {name: float(values[best]) for name, values in changes.items()})


def _step(rig: Rig, plate: PlateLimits) -> Rig:
    """Return the rig with a plate that goes up as fast as the limits allow, all the way."""
    wait = 3.0 * rig.crossing_time + 1.0 / rig.natural_frequency
    travel = min(plate.travel, plate.speed * (2.0 * plate.rise_time + wait))
    return with_motion(rig, rest_to_rest(plate, travel=travel))


def _summary(answer: MotionDesign) -> str:
    """Say what is gained, and by what."""
    throws = answer.throws
    if 'now' not in throws:
        speed = throws['best'].ejection_speed
        return f'as it is, the rig throws nothing; this motion gives {speed:.3g} m/s'
    now = throws['now'].kinetic_energy

    def gain(name: str) -> str:
        part = throws[name].kinetic_energy / now - 1.0
        return f'{100.0 * part:.2g} % more' if part < 0.995 else f'{1.0 + part:.3g} times the'

    parts = [f'{gain("best")} energy by moving the plate so']
    if 'layer' in throws:
        layer = throws['layer']
        parts.append(
            f'{gain("layer").removesuffix(" more")} by a layer of {1e3 * layer.thickness:.4g} mm '
            f'and {layer.wave_speed:.4g} m/s'
        )
    if 'both' in throws:
        both = throws['both']
        parts.append(
            f'{gain("both").removesuffix(" more")} by both, with '
            f'{1e3 * both.thickness:.4g} mm and {both.wave_speed:.4g} m/s'
        )
    text = f'with the same motor, {", ".join(parts)}'
    if 'linear' in throws:
        speed, linear = answer.ejection_speed, throws['linear'].ejection_speed
        text += f'; {speed:.3g} m/s from this layer, and from a linear one {linear:.3g} m/s'
    motion = answer.motion
    lowest = int(motion.states[:, 0].argmin())
    depth, time = -motion.states[lowest, 0], motion.times[lowest]
    if depth > 0.01 * answer.limits.travel:
        text += f'; the plate goes down first, by {1e3 * depth:.2g} mm in {1e3 * time:.2g} ms'
    return text
