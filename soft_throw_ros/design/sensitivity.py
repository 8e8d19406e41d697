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
"""Sensitivity of the score of a layer to the parameters of the rig, and their tolerances."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

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
    r"""
    Influence of one parameter on the score of the recommended layer, all others unchanged.

    Parameters
    ----------
    name : {'thickness', 'wave_speed', 'mass', 'frequency', 'damping_ratio'}
        The parameter.
    value : float
        Its value. [SI]
    sensitivity : float
        :math:`d \ln \alpha / d \ln` of the parameter, for the score. [-]
    tolerance : float
        Largest deviation, up or down, that costs at most `TOLERATED_LOSS` of the score;
        at most half of `value`. [SI]

    """

    name: str
    value: float
    sensitivity: float
    tolerance: float


_RelativeScore: TypeAlias = Callable[[Floats], Floats]
"""Score over that of the recommended layer, for factors of a parameter."""


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

    def relative_score(factors: Floats, *, name: str) -> Floats:
        values: dict[str, Floats | float] = {**layer, name: layer.get(name, 1.0) * factors}
        return score(**values) / best

    steps = _STEPS_WITH_LOSS if rig.layer.needs_cells else _STEPS
    for name, value in {
        **layer,
        'mass': rig.projectile.mass,
        'frequency': rig.engine.frequency,
        'damping_ratio': rig.engine.damping_ratio,
    }.items():
        if value > 0.0:
            score_of = partial(relative_score, name=name)
            less, more = score_of(np.array([1.0 - _SLIGHT_CHANGE, 1.0 + _SLIGHT_CHANGE]))
            yield Sensitivity(
                name=name,
                value=value,
                sensitivity=float(more - less) / (2.0 * _SLIGHT_CHANGE),
                tolerance=value * _tolerance(score_of, steps),
            )


def _tolerance(score_of: _RelativeScore, steps: int) -> float:
    """Find the largest relative change to both sides that costs `TOLERATED_LOSS`, in two scans."""
    low, high = 0.0, _MAX_TOLERANCE
    for _ in range(2):
        changes = np.linspace(low, high, steps + 1)
        scores = np.minimum(score_of(1.0 - changes[1:]), score_of(1.0 + changes[1:]))
        is_lost = scores < 1.0 - TOLERATED_LOSS
        if not is_lost.any():
            return high
        last = int(is_lost.argmax())
        low, high = float(changes[last]), float(changes[last + 1])
    return low
