# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sentences that describe recommendations, aims and designed motions."""

from __future__ import annotations

from collections.abc import Mapping
import math

from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throws import STRONG_GRAVITY
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.motion import MotionDesign
from soft_throw_ros.design.recommendation import (
    MAX_STUCK_FRACTION,
    Recommendation,
    TOLERATED_LOSS,
)
from soft_throw_ros.design.requests import limits_of, RequestResult
from soft_throw_ros.design.score import Limits


def summary_of(best: RequestResult, rig: Rig, settings: Settings) -> str:
    """Describe the answer to the settings of a present rig in a sentence."""
    if isinstance(best, Aim):
        return _aim_summary(best, settings)
    if isinstance(best, MotionDesign):
        return motion_summary(best)
    is_peak = settings['recommendation.objective'] == 'peak'
    score_name = 'alpha' if is_peak else 'worst alpha'
    return _recommendation_summary(best, rig.layer, limits_of(settings), score_name)


def _recommendation_summary(
    best: Recommendation, old: Layer, limits: Limits, score_name: str
) -> str:
    """Describe the new layer, the gain of energy, the tolerances, and doubts."""
    if best.rig.layer == old:
        text = f'keep your layer: none within the limits is better ({score_name} {best.score:.2f})'
    else:
        now = f'{best.now_score:.2f} -> ' if best.now_score else ''
        text = (
            f'{_changes(best, old, limits)}: {_gain(best.gain)}{_excuse(best)} '
            f'({score_name} {now}{best.score:.2f})'
        )
    if best.stuck_fraction > MAX_STUCK_FRACTION:
        text = f'no release in {100.0 * best.stuck_fraction:.2g} % of all cases; {text}'
    text += (
        f'; +-{1e3 * best.tolerances["thickness"]:.2g} mm or '
        f'+-{best.tolerances["wave_speed"]:.2g} m/s costs {100.0 * TOLERATED_LOSS:g} %'
    )
    if best.rig.gravity_ratio > STRONG_GRAVITY:
        text += (
            f'; gravity is {best.rig.gravity_ratio:.2g} of the largest acceleration of the plate, '
            'so that later swings of the plate throw as well'
        )
    if best.peak_strain >= 1.0:
        text += (
            f'; no layer can be compressed by {100.0 * best.peak_strain:.0f} %: lower the '
            'amplitude or limit the strain'
        )
    return text


def _changes(best: Recommendation, old: Layer, limits: Limits) -> str:
    """Name the parameters that change, with their old and new values."""
    new = best.rig.layer
    changes = [f'layer {best.layer}'] if best.layer else []
    if best.vary != 'wave_speed':
        limit = _at_limit(new.thickness, limits.thickness)
        changes.append(
            f'thickness {1e3 * old.thickness:.4g} -> {1e3 * new.thickness:.4g} mm{limit}'
        )
    if best.vary in ('wave_speed', 'both'):
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
        return 'the present layer throws nothing'
    if gain >= 0.95:
        return f'{1.0 + gain:.3g} times the energy'
    if gain >= 0.0:
        return f'{100.0 * gain:.2g} % more energy'
    return f'{-100.0 * gain:.2g} % less energy'


def _excuse(best: Recommendation) -> str:
    """Say why a layer is recommended that throws with less energy."""
    if best.gain >= 0.0:
        return ''
    if best.now_stuck_fraction > MAX_STUCK_FRACTION:
        return f', but the present layer has no release in {100.0 * best.now_stuck_fraction:.2g} %'
    return ', because the present layer exceeds the limits'


def _aim_summary(best: Aim, settings: Settings) -> str:
    """Describe the amplitude that reaches a target, and the loads."""
    speed = settings['recommendation.target_speed']
    height = settings['recommendation.target_height']
    return (
        f'amplitude {1e3 * settings["engine.amplitude"]:.4g} -> {1e3 * best.amplitude:.4g} mm '
        f'reaches {f"{speed:g} m/s" if speed else f"{height:g} m high"}: strain '
        f'{1e2 * best.peak_strain:.3g} %, acceleration {best.peak_acceleration:.3g} m/s2'
    )


def motion_summary(design: MotionDesign) -> str:
    """Describe the gain of energy, and the way down of the plate."""
    now, speed = design.now, design.ejection_speed
    if now is None:
        return f'the present motion throws nothing; the designed one gives {speed:.3g} m/s'
    gain = _gain(design.kinetic_energy / now.kinetic_energy - 1.0)
    text = (
        f'with the same motor, {gain} by the best motion (ejection speed '
        f'{now.ejection_speed:.4g} -> {speed:.4g} m/s)'
    )
    motion = design.motion
    lowest = int(motion.states[:, 0].argmin())
    depth, time = -motion.states[lowest, 0], motion.times[lowest]
    if depth > 0.01 * design.limits.travel:
        text += f'; the plate goes down first, by {1e3 * depth:.2g} mm in {1e3 * time:.2g} ms'
    return text


def uncertainty_text(values: Mapping[str, float]) -> str:
    """Describe the intervals of a prediction, given as `PredictionUncertainty.values`."""
    scales = {'ejection_time': (1e3, '.3f'), 'ejection_speed': (1.0, '.4f'),
              'energy_transfer': (1.0, '.3f')}
    time, speed, transfer = (
        ' to '.join(f'{scale * values[f"{name}.{end}"]:{digits}}' for end in ('low', 'high'))
        for name, (scale, digits) in scales.items()
    )
    text = f'{time} ms, {speed} m/s, alpha {transfer}'
    if values['jumps']:
        text += ', with a jump between'
    if values['stuck_fraction'] > 0.0:
        text += f'; no release in {100.0 * values["stuck_fraction"]:.2g} % of all cases'
    return text
