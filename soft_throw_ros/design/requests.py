# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Answers to the settings of the twin: recommendations, aims and motions."""

from __future__ import annotations

from dataclasses import fields
from functools import partial
import math
from typing import TypeAlias

from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.batch import Cancelled
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.aiming import Aim, aim
from soft_throw_ros.design.motion import design_motion, MotionDesign, PlateLimits
from soft_throw_ros.design.recommendation import recommend, Recommendation
from soft_throw_ros.design.score import Limits, Objective, peak, robust, versatile
from soft_throw_ros.design.uncertainty import Uncertainties

RequestResult: TypeAlias = Recommendation | Aim | MotionDesign


def solve_request(
    settings: Settings, *, rig: Rig | None = None, cancelled: Cancelled | None = None
) -> RequestResult:
    """
    Recommend a layer or a motion, or aim, by the complete settings of the twin.

    `rig` is the rig that the settings describe, if it exists already. A ValueError has the reason
    why a request is impossible; SearchCancelledError follows when `cancelled` returns True.
    """
    rig, limits = rig or rig_of(settings), limits_of(settings)
    request = {name.removeprefix('recommendation.'): value for name, value in settings.items()}
    uncertainties = Uncertainties.from_settings(settings)
    if request['objective'] == 'aim':
        height, speed = request['target_height'] or None, request['target_speed'] or None
        return aim(rig, height=height, speed=speed, limits=limits, cancelled=cancelled)
    if request['vary'] == 'motion':
        if request['objective'] != 'peak':
            rule = "recommendation.vary 'motion' is for recommendation.objective 'peak' alone"
            raise ValueError(f'{rule}, got {request["objective"]!r}')
        now = vars(PlateLimits.of(rig.engine))
        plate = PlateLimits(**{name: request.get(f'plate_{name}') or now[name] for name in now})
        return design_motion(
            rig, plate, limits=limits, uncertainties=uncertainties, cancelled=cancelled
        )
    masses, frequencies = request['masses'], request['frequencies']
    objectives: dict[str, Objective] = {
        'peak': peak,
        'robust': partial(robust, uncertainties=uncertainties),
        'versatile': partial(versatile, masses=masses, frequencies=frequencies),
    }
    is_from_library = request['vary'] == 'library'
    return recommend(
        rig,
        vary=request['vary'],
        objective=objectives[request['objective']],
        limits=limits,
        materials=library(settings['layer.library']).materials if is_from_library else None,
        uncertainties=uncertainties,
        cancelled=cancelled,
    )


def limits_of(settings: Settings) -> Limits:
    """Return the limits that the settings set; 0 is none."""
    values = {item.name: settings[f'recommendation.{item.name}'] for item in fields(Limits)}
    return Limits(**{name: value or math.inf for name, value in values.items()})
