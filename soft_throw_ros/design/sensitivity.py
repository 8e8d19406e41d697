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
"""How much the parameters of a rig matter around a recommended layer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.evaluate import Cancelled, SEARCH_CELLS
from soft_throw_ros.design.objective import LayerScore, Objective

Floats = NDArray[np.float64]

WITHIN = 0.05
"""Part of the best score that may be lost within a `Sensitivity`'s interval. [-]"""

TOLERATED = 0.02
"""Part that may be lost within its tolerance. [-]"""

UNITS = {
    'thickness': ('mm', 1e3),
    'wave_speed': ('m/s', 1.0),
    'mass': ('g', 1e3),
    'frequency': ('Hz', 1.0),
    'damping_ratio': ('', 1.0),
}
"""In which units people read the parameters of a `Sensitivity`, and how many make one in SI."""

_SLIGHT = 1e-4  # change of a parameter for its elasticity
_SMALL = 1e-3  # change of a parameter that ...
_AT_EDGE = 0.01  # costs more than this part only at an edge
_FARTHEST = math.log(2.0)  # where the interval ends at the latest


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    r"""
    How much a parameter matters around the recommended layer, all others as they are.

    Parameters
    ----------
    name : {'thickness', 'wave_speed', 'mass', 'frequency', 'damping_ratio'}
        The parameter.
    value : float
        What it is.
    elasticity : float
        :math:`d \ln \alpha / d \ln` of the parameter, for the score. [-]
    low, high : float
        Between these at most `WITHIN` of the score is lost; looked for from half to twice `value`.
    tolerance : float
        What it may be off, up or down, for at most `TOLERATED` to be lost.
    edge : {'', 'less', 'more', 'less or more'}
        On which side, if any, the energy falls off at once.

    """

    name: str
    value: float
    elasticity: float
    low: float
    high: float
    tolerance: float
    edge: str

    @property
    def deviation(self) -> str:
        """Write the tolerance with its unit."""
        unit, scale = UNITS[self.name]
        return f'{scale * self.tolerance:.2g} {unit}'.rstrip()


_Remaining: TypeAlias = Callable[[Floats], Floats]
"""What is left of the best score after changes of a parameter, in logarithms."""


def sensitivities(
    rig: Rig, objective: Objective, cancelled: Cancelled | None = None
) -> Iterator[Sensitivity]:
    """
    Find out how much each parameter matters.

    Parameters
    ----------
    rig : Rig
        With the recommended layer.
    objective : Peak, Robust or Versatile
        What the layer is scored by.
    cancelled : callable, optional
        Asked between batches of throws.

    Raises
    ------
    SearchCancelledError
        If `cancelled` says so.

    """
    score = LayerScore(rig, objective, cells=SEARCH_CELLS, cancelled=cancelled)
    layer = {'thickness': rig.layer.thickness, 'wave_speed': rig.layer.wave_speed}
    best = float(score(**layer)[0])

    def remaining(changes: Floats, *, name: str) -> Floats:
        values: dict[str, Floats | float] = {**layer, name: layer.get(name, 1.0) * np.exp(changes)}
        return score(**values, least=(1.0 - WITHIN) * best) / best

    steps = 12 if rig.layer.needs_cells else 70
    for name, value in {
        **layer,
        'mass': rig.projectile.mass,
        'frequency': rig.engine.frequency,
        'damping_ratio': rig.engine.damping_ratio,
    }.items():
        if value > 0.0:
            yield _sensitivity(name, value, partial(remaining, name=name), steps)


def _sensitivity(name: str, value: float, remaining: _Remaining, steps: int) -> Sensitivity:
    slightly_less, slightly_more, less, more = remaining(
        np.array([-_SLIGHT, _SLIGHT, -_SMALL, _SMALL])
    )
    down, up = (_reach(remaining, sign, steps) for sign in (-1.0, 1.0))
    return Sensitivity(
        name=name,
        value=value,
        elasticity=float(slightly_more - slightly_less) / (2.0 * _SLIGHT),
        low=value * math.exp(down[WITHIN]),
        high=value * math.exp(up[WITHIN]),
        tolerance=value * min(1.0 - math.exp(down[TOLERATED]), math.exp(up[TOLERATED]) - 1.0),
        edge=' or '.join(
            side for side, part in (('less', less), ('more', more)) if part < 1.0 - _AT_EDGE
        ),
    )


def _reach(remaining: _Remaining, sign: float, steps: int) -> dict[float, float]:
    """Find the last change to one side before so much is lost: in steps, then in finer ones."""
    step = sign * _FARTHEST / steps
    scan = remaining(step * np.arange(1.0, steps + 1.0))
    ends = {}
    for lost in (TOLERATED, WITHIN):
        ends[lost] = sign * _FARTHEST
        if (scan < 1.0 - lost).any():
            good = step * int((scan < 1.0 - lost).argmax())
            finer = good + step / steps * np.arange(steps + 1.0)
            is_lost = np.append(remaining(finer[1:-1]) < 1.0 - lost, True)
            ends[lost] = float(finer[is_lost.argmax()])
    return ends
