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
"""What is said of a recommendation, for people to read."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.search_space import STRONG_GRAVITY
from soft_throw_ros.design.sensitivity import TOLERATED

if TYPE_CHECKING:
    from soft_throw_ros.design.prediction import PredictedThrow
    from soft_throw_ros.design.recommendation import Recommendation

_CHANGING = {'both': ('thickness', 'wave_speed'), 'library': ('thickness',)}


def summary_of(found: Recommendation, old: Layer, limits: Limits, score_name: str) -> str:
    """Say what changes, what that gives, and how exactly it has to be met."""
    if found.rig.layer == old:
        text = (
            f'the layer as it is cannot be bettered within the limits '
            f'({score_name} {found.score:.2f})'
        )
    else:
        now = f'{found.now_score:.2f}' if found.now_score else 'nothing'
        text = (
            f'{_changes(found, old, limits)}: {_gain(found.gain)} '
            f'({score_name} {now} -> {found.score:.2f})'
        )
    names = _CHANGING.get(found.vary, (found.vary,))
    changing = [item for item in found.sensitivities if item.name in names]
    within = ' or '.join(f'+-{item.deviation}' for item in changing if not item.edge)
    parts = [f'{within} costs {100.0 * TOLERATED:g} %'] if within else []
    parts += [
        f'a little {item.edge} {item.name.replace("_", " ")} falls off an edge'
        for item in changing
        if item.edge
    ]
    return '; '.join([text, *parts])


def _changes(found: Recommendation, old: Layer, limits: Limits) -> str:
    """Name what changes, with what it was and will be."""
    new = found.rig.layer
    changes = [f'layer {found.layer}'] if found.layer else []
    if found.vary != 'wave_speed':
        limit = _at_limit(new.thickness, limits.thickness)
        changes.append(
            f'thickness {1e3 * old.thickness:.4g} -> {1e3 * new.thickness:.4g} mm{limit}'
        )
    if found.vary in ('wave_speed', 'both'):
        limit = _at_limit(new.wave_speed, limits.wave_speed)
        changes.append(
            f'wave speed {old.wave_speed:.4g} -> {new.wave_speed:.4g} m/s{limit}, that is '
            f'modulus {1e-3 * old.youngs_modulus:.4g} -> {1e-3 * new.youngs_modulus:.4g} kPa'
        )
    return ' and '.join(changes)


def _at_limit(value: float, limits: tuple[float, float]) -> str:
    for limit, name in zip(limits, ('smallest', 'largest'), strict=True):
        if math.isclose(value, limit, rel_tol=1e-4):
            return f' (the {name} allowed)'
    return ''


def _gain(gain: float) -> str:
    if gain == math.inf:
        return 'as it is, the layer throws nothing'
    if gain >= 0.95:
        return f'{1.0 + gain:.3g} times the energy'
    if gain >= 0.0:
        return f'{100.0 * gain:.2g} % more energy'
    return f'{-100.0 * gain:.2g} % less energy, for the layer as it is is not within the limits'


def remarks_of(found: Recommendation) -> str:
    """Say what has to be known of a recommendation besides."""
    optimum, rig = found.optimum, found.rig
    remarks = [
        (
            f'for a plate of damping {optimum.damping_ratio:g} the best is a projectile of '
            f'{optimum.mass_ratio:.3f} times the mass of the layer and c_s / (L_s f) = '
            f'{optimum.speed_ratio:.3f}, with alpha {optimum.energy_transfer:.3f} without loss'
        )
    ]
    if rig.gravity_ratio > STRONG_GRAVITY:
        remarks.append(
            f'gravity is {rig.gravity_ratio:.2g} of the largest acceleration of the plate, so '
            'that later swings throw as well'
        )
    if found.peak_strain >= 1.0:
        remarks.append(
            f'a strain of {100.0 * found.peak_strain:.0f} % is more than a layer can be '
            'compressed: lower the amplitude or limit the strain'
        )
    return '; '.join(remarks)


def why_nothing(rig: Rig, vary: str, limits: Limits, free: PredictedThrow | None) -> str:
    """Say why nothing can be recommended, and what could be without limits of the loads."""
    low, high = limits.thickness if vary != 'wave_speed' else (rig.layer.thickness,) * 2
    slow, fast = limits.wave_speed if vary != 'thickness' else (rig.layer.wave_speed,) * 2
    text = f'a thickness from {low:g} to {high:g} m and a wave speed from {slow:g} to {fast:g} m/s'
    if vary == 'library':
        text += ' from the library'
        if limits.max_loss_tangent < math.inf:
            text += f' and a loss tangent of at most {limits.max_loss_tangent:g}'
    if free is not None:
        return (
            f'no layer with {text} keeps a strain of at most {limits.max_strain:g} and an '
            f'acceleration of at most {limits.max_acceleration:g} m/s2; the best without '
            f'these limits has {free.peak_strain:.3g} and {free.peak_acceleration:.4g} m/s2'
        )
    return (
        f'no throw with {text} can be computed: the projectile stays on the layer for too many '
        f'crossings, or gravity ({rig.gravity_ratio:.2g} of the largest acceleration of the '
        'plate) holds it'
    )
