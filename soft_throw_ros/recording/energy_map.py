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
"""The map of the energy transfer of a rig over all layers, computed and drawn."""

from __future__ import annotations

from collections.abc import Mapping
import time
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure
import numpy as np
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording import charts
from soft_throw_ros.recording.charts import MapAxis
from soft_throw_ros.twin.results import Floats

MAP_SIZE = 620, 250
"""Width and height of the map in the viewer. [pixel]"""

_COUNTS = {'thickness': 160, 'wave_speed': 100}
"""Values on each axis of the finest map. [-]"""

_COARSENESSES = (8, 4, 2, 1)
_TIME_BUDGET = 1.0
"""The finest map is chosen that needs no longer: too heavy a projectile takes minutes. [s]"""

_SMALLEST, _LARGEST = 1e-6, 1e6
"""Limits of plausible recommended thicknesses and wave speeds, in SI units."""

_SAME = 0.01
"""Largest relative difference of two layers that share a mark. [-]"""

_Layer = tuple[float, float]
"""Thickness [m] and wave speed [m/s] of a layer."""


class EnergyMap(NamedTuple):
    """Energy transfer over all layers that are considered."""

    # From each value to the next by the same factor. [m], [m/s]
    thickness: Floats
    wave_speed: Floats
    # A row for each thickness; NaN where nothing is thrown. [-]
    energy_transfer: Floats
    # Text and layer: the layer of the rig, and maybe a recommended one
    marks: tuple[tuple[str, _Layer], ...]
    title: str  # Of the colours

    def draw(self) -> Figure:
        """Draw the map with its marks and a legend."""
        axes = MapAxis('Lₛ (mm)', 1e3 * self.thickness), MapAxis('cₛ (m/s)', self.wave_speed)
        marks = [(text, 1e3 * thickness, speed) for text, (thickness, speed) in self.marks]
        with mpl.rc_context(charts.STYLE):
            figure = charts.new_figure(MAP_SIZE, layout='constrained')
            panel = figure.subplots()
            charts.draw_map(panel, axes, self.energy_transfer, label=self.title, marks=marks)
            figure.legend(
                loc='outside upper center', ncols=2, facecolor='0.3', labelcolor='white',
                frameon=True,
            )
        return figure


def energy_transfer(rig: Rig, thickness: Floats, wave_speed: Floats) -> Floats:
    """Compute alpha of a rig with other layers, without loss; NaN where nothing is thrown [-]."""
    releases = first_releases(
        mass_ratio=rig.projectile.mass / (rig.layer.density * rig.layer.section * thickness),
        speed_ratio=wave_speed / (thickness * rig.engine.frequency),
        damping_ratio=rig.engine.damping_ratio,
        gravity_ratio=rig.gravity_ratio,
    )
    return np.asarray(releases.energy_transfer)


def compute_energy_map(
    rig: Rig, settings: Settings, recommendation: Mapping[str, float | str]
) -> EnergyMap:
    """
    Compute the map for a rig; the marks are within it.

    The limits in the settings of the twin select the layers. The marks use the values of
    `~/recommendation` for this rig, which may be empty, so that they agree with the table.
    """
    now, best = (rig.layer.thickness, rig.layer.wave_speed), _layer_of(recommendation, '')
    is_same = best is not None and np.allclose(now, best, rtol=_SAME)
    name = 'now, as recommended' if is_same else 'now'
    marks = [(_mark_text(name, rig, now, recommendation, 'now.'), now)]
    if best is not None and not is_same:
        marks.append((_mark_text('recommended', rig, best, recommendation, ''), best))
    limits = {}
    for column, axis in enumerate(_COUNTS):
        low, high = (settings[f'recommendation.{axis}_{limit}'] for limit in ('min', 'max'))
        marked = [layer[column] for _, layer in marks]
        limits[axis] = min(low, *marked), max(high, *marked)
    for coarseness in _COARSENESSES:
        begin = time.monotonic()
        thickness, wave_speed = (
            np.geomspace(*limits[axis], count // coarseness) for axis, count in _COUNTS.items()
        )
        values = energy_transfer(rig, thickness[:, None], wave_speed)
        if 4.0 * (time.monotonic() - begin) > _TIME_BUDGET:  # duration of the next grid
            break
    title = 'α, lossless' if rig.layer.loss_tangent else 'α'
    return EnergyMap(thickness, wave_speed, values, tuple(marks), title)


def _mark_text(
    name: str, rig: Rig, layer: _Layer, recommendation: Mapping[str, float | str], prefix: str
) -> str:
    """Return the text of a mark, with the recommendation's alpha if it is of the same layer."""
    stated = _layer_of(recommendation, prefix)
    alpha = recommendation.get(f'{prefix}energy_transfer')
    is_known = stated is not None and np.allclose(layer, stated, rtol=1e-6)
    if not (is_known and isinstance(alpha, float)):
        alpha = float(energy_transfer(rig, *np.array(layer)))
    return f'{name}: α {alpha:.3f}' if alpha > 0.0 else f'{name}: no release'


def _layer_of(values: Mapping[str, float | str], prefix: str) -> _Layer | None:
    """Return thickness and wave speed if they could be those of a layer."""
    match values.get(f'{prefix}thickness'), values.get(f'{prefix}wave_speed'):
        case float(thickness), float(wave_speed):
            if all(_SMALLEST < value < _LARGEST for value in (thickness, wave_speed)):
                return thickness, wave_speed
    return None
