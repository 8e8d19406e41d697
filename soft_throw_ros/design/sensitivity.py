# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sensitivity of the score of a layer to the parameters of the rig, and their tolerances."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import Cancelled, SEARCH_CELLS
from soft_throw_ros.design.objective import LayerScore, Objective

Floats = NDArray[np.float64]

TOLERATED_LOSS = 0.02
"""Part of the score that may be lost within the tolerance of a parameter. [-]"""

_SLIGHT_CHANGE = 1e-4
"""Relative change of a parameter in the difference quotient of its sensitivity. [-]"""

_MAX_TOLERANCE = 0.5
"""Largest relative change of a parameter in the search for its tolerance. [-]"""

_STEPS, _STEPS_WITH_LOSS = 70, 12
"""Steps of the search for a tolerance, and again of each step; throws with loss take longer."""


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Influence of one parameter on the score of the recommended layer, all others unchanged."""

    name: str
    """`thickness`, `wave_speed`, `mass`, `frequency` or `damping_ratio`."""
    value: float
    """Value of the parameter. [SI]"""
    sensitivity: float
    r""":math:`d \ln \alpha / d \ln` of the parameter, for the score. [-]"""
    tolerance: float
    """Largest deviation, up or down, that costs `TOLERATED_LOSS`; at most half of `value`. [SI]"""


def sensitivities(
    rig: Rig, objective: Objective, cancelled: Cancelled | None = None
) -> Iterator[Sensitivity]:
    """
    Compute the sensitivity and the tolerance of each parameter of a rig with its best layer.

    The objective scores the layer; `cancelled` is that of `throw_many`.
    """
    score = LayerScore(rig, objective, cells=SEARCH_CELLS, cancelled=cancelled)
    layer = {'thickness': rig.layer.thickness, 'wave_speed': rig.layer.wave_speed}
    best = float(score(**layer)[0])
    steps = _STEPS_WITH_LOSS if rig.layer.needs_cells else _STEPS
    for name, value in {
        **layer,
        'mass': rig.projectile.mass,
        'frequency': rig.engine.frequency,
        'damping_ratio': rig.engine.damping_ratio,
    }.items():
        if not value > 0.0:
            continue

        def relative_score(factors: Floats, name: str = name) -> Floats:
            values: dict[str, Floats | float] = {**layer, name: layer.get(name, 1.0) * factors}
            return score(**values) / best

        less, more = relative_score(np.array([1.0 - _SLIGHT_CHANGE, 1.0 + _SLIGHT_CHANGE]))
        yield Sensitivity(
            name=name,
            value=value,
            sensitivity=float(more - less) / (2.0 * _SLIGHT_CHANGE),
            tolerance=value * _tolerance(relative_score, steps),
        )


def _tolerance(relative_score: Callable[[Floats], Floats], steps: int) -> float:
    """Find the largest relative change to both sides that costs `TOLERATED_LOSS`, in two scans."""
    low, high = 0.0, _MAX_TOLERANCE
    for _ in range(2):
        changes = np.linspace(low, high, steps + 1)
        less, more = (relative_score(1.0 + sign * changes[1:]) for sign in (-1.0, 1.0))
        is_lost = np.minimum(less, more) < 1.0 - TOLERATED_LOSS
        if not is_lost.any():
            return high
        last = int(is_lost.argmax())
        low, high = float(changes[last]), float(changes[last + 1])
    return low
