# SPDX-License-Identifier: Apache-2.0
"""What the settings of the twin ask of a layer, and the answer."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.design.aiming import Aim, aim, Target
from soft_throw_ros.design.evaluate import Cancelled
from soft_throw_ros.design.objective import Limits, Objective, Peak, Robust, Versatile
from soft_throw_ros.design.recommendation import recommend, Recommendation
from soft_throw_ros.design.uncertainty import Uncertainties

Answer: TypeAlias = Recommendation | Aim


def answer(settings: Settings, *, cancelled: Cancelled | None = None) -> Answer:
    """
    Recommend a layer, or aim, as the settings ask.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings of the twin; of them count those of the rig, `recommendation.*` and
        `uncertainty.*`.
    cancelled : callable, optional
        Asked every few tenths of a second whether to give up.

    Raises
    ------
    ValueError
        If that cannot be done, saying why.
    SearchCancelledError
        If `cancelled` says so.

    """
    rig, asked = rig_of(settings), _group(settings, 'recommendation')
    search: dict[str, Any] = {
        'vary': asked['vary'],
        'limits': limits_of(settings),
        'materials': library(str(settings['layer.library'])).materials,
        'cancelled': cancelled,
    }
    if asked['objective'] == 'aim':
        height, speed = asked['target_height'] or None, asked['target_speed'] or None
        if height is None and speed is None:
            raise ValueError(
                'nothing to aim at: recommendation.target_height (--target-height) or '
                'recommendation.target_speed (--target-speed) must be above 0, got 0 for both'
            )
        target = Target(height=height, speed=speed)
        return aim(rig, target, max_amplitude=asked['max_amplitude'], **search)
    if asked['vary'] == 'amplitude':
        raise ValueError(
            "recommendation.vary 'amplitude' is for recommendation.objective 'aim' alone, got "
            f'{asked["objective"]!r}'
        )
    return recommend(rig, objective=objective_of(settings), **search)


def limits_of(settings: Settings) -> Limits:
    """Return the limits that the settings set; 0 is none."""
    asked = _group(settings, 'recommendation')
    layer = ('thickness_min', 'thickness_max', 'wave_speed_min', 'wave_speed_max')
    loads = ('max_strain', 'max_acceleration', 'max_loss_tangent')
    return Limits(
        **{name: asked[name] for name in layer},
        **{name: asked[name] or math.inf for name in loads},
    )


def uncertainties_of(settings: Settings) -> Uncertainties:
    """Return how far the rig may be off, by the settings."""
    return Uncertainties(**_group(settings, 'uncertainty'))


def objective_of(settings: Settings) -> Objective:
    """Return what a layer is to be good at, by the settings."""
    asked = _group(settings, 'recommendation')
    if asked['objective'] == 'robust':
        return Robust(uncertainties=uncertainties_of(settings), quantile=asked['quantile'])
    if asked['objective'] == 'versatile':
        return Versatile(masses=asked['masses'], frequencies=asked['frequencies'])
    return Peak()


def _group(settings: Settings, group: str) -> dict[str, Any]:
    """Return the settings of a group by their last names."""
    return {
        name.partition('.')[2]: value
        for name, value in settings.items()
        if name.startswith(f'{group}.')
    }
