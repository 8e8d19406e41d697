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
"""The first release as other models of the layer predict it, for comparison."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any

from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.cell_stepper import first_throws
from soft_throw_ros.core.closed_form import first_release, ThrowUnresolvedError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.twin.results import Release

_CELLS = 64  # by which finite differences predict, ...
_STIFFEST = 1000.0  # up to so many crossings in a plate period, which take long to follow


@lru_cache(maxsize=4)
def predict_by_other_models(rig: Rig, model: str) -> dict[str, Release | None]:
    """Let models other than the given one predict, if they can; None where nothing leaves."""
    ratios: dict[str, Any] = {  # keyword arguments of either kind of function
        'mass_ratio': rig.mass_ratio,
        'speed_ratio': rig.speed_ratio,
        'damping_ratio': rig.engine.damping_ratio,
        'gravity_ratio': rig.gravity_ratio,
    }
    spring_ratio = rig.natural_frequency / rig.engine.frequency
    ways: dict[str, Callable[[], Any]] = {  # each returns its own type with the same three fields
        'spring_mass': partial(spring_mass.first_release, frequency_ratio=spring_ratio)
    }
    if not rig.layer.needs_cells:
        ways['travelling_wave'] = partial(first_release, **ratios)
    if rig.speed_ratio <= _STIFFEST:
        ratios = {**rig.cell_ratios, 'cells': _CELLS}
        ways['finite_difference_elastic'] = partial(
            first_throws, **ratios, crossing_ratio=rig.crossing_ratio
        )
        ways['finite_difference_glued'] = partial(first_throws, **ratios, glued_to='projectile')
    return {name: _released(rig, way) for name, way in ways.items() if name != model}


def _released(rig: Rig, way: Callable[[], Any]) -> Release | None:
    try:
        release = way()
    except ThrowUnresolvedError:
        return None
    return Release(
        ejection_time=float(release.ejection_phase) / rig.engine.frequency,
        ejection_speed=float(release.speed) * rig.engine.speed_scale,
        energy_transfer=float(release.energy_transfer),
    )
