# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The first release as other models of the layer predict it, for comparison."""

from __future__ import annotations

from functools import lru_cache

from soft_throw_ros.configuration.interface_numbers import OTHER_MODELS
from soft_throw_ros.core.models import MODELS
from soft_throw_ros.core.rig import model_for, Rig
from soft_throw_ros.core.throws import throw_many
from soft_throw_ros.twin.results import Release

_CELLS = 64
"""Number of cells of the models with cells."""

_MAX_SPEED_RATIO = 1000.0
"""Most crossings of the wave per plate period; beyond, models with cells are too slow. [-]"""


@lru_cache(maxsize=4)
def predict_by_other_models(rig: Rig, model: str) -> dict[str, Release | None]:
    """Predict the release by the other applicable models; None without a release."""
    return {
        name: _first_release(rig, name)
        for name in OTHER_MODELS
        if name != model
        and name == model_for(rig, name)
        and (MODELS[name].batch != 'cells' or rig.speed_ratio <= _MAX_SPEED_RATIO)
    }


def _first_release(rig: Rig, model: str) -> Release | None:
    throws = throw_many(rig, model=model, cells=_CELLS)
    time, speed, transfer = map(float, throws[:3])
    if not speed > 0.0:
        return None
    return Release(ejection_time=time, ejection_speed=speed, energy_transfer=transfer)
