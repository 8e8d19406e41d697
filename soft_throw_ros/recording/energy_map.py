# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The map of the energy transfer of a rig over all layers."""

from __future__ import annotations

import time

import matplotlib as mpl
from matplotlib.figure import Figure
import numpy as np
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.rig import ratios_of, Rig, values_of
from soft_throw_ros.recording import charts
from soft_throw_ros.recording.charts import MapAxis
from soft_throw_ros.recording.timeseries import Values
from soft_throw_ros.twin.results import Floats

_SIZE = 6.2, 2.5
"""Width and height of the picture. [inch]"""

_COUNTS = {'thickness': 160, 'wave_speed': 100}
"""Values on each axis of the finest map. [-]"""

_COARSENESSES = (8, 4, 2, 1)
_TIME_BUDGET = 1.0
"""The finest map is chosen that needs no longer: too heavy a projectile takes minutes. [s]"""

_SAME = 0.01
"""Largest relative difference of two layers that share a mark. [-]"""

_MILLI = 1e3


def energy_transfer(rig: Rig, thickness: Floats, wave_speed: Floats) -> Floats:
    """Compute alpha of a rig with other layers, without loss; NaN where nothing is thrown [-]."""
    values = {**values_of(rig), 'thickness': thickness, 'wave_speed': wave_speed}
    return np.asarray(first_releases(**ratios_of(rig, values).lossless).energy_transfer)


def draw_energy_map(rig: Rig, settings: Settings, recommendation: Values) -> Figure:
    """
    Draw the map for a rig with its marks and a legend; the marks are within it.

    The limits in the settings of the twin select the layers. The marks use the values of
    `~/recommendation` for this rig, which may be empty, so that they agree with the table.
    """
    layers = [('now', 'now.', (rig.layer.thickness, rig.layer.wave_speed))]
    match [recommendation.get(name) for name in _COUNTS]:
        case float(thickness), float(wave_speed):
            if np.allclose(layers[0][2], (thickness, wave_speed), rtol=_SAME):
                layers = [('now, as recommended', *layers[0][1:])]
            else:
                layers.append(('recommended', '', (thickness, wave_speed)))
    marks = []
    for name, prefix, layer in layers:
        alpha = recommendation.get(f'{prefix}energy_transfer')
        if not isinstance(alpha, float):
            alpha = float(energy_transfer(rig, *np.array(layer)))
        text = f'α {alpha:.3f}' if alpha > 0.0 else 'no release'
        marks.append((f'{name}: {text}', _MILLI * layer[0], layer[1]))
    limits = {}
    for column, axis in enumerate(_COUNTS):
        low, high = (settings[f'recommendation.{axis}_{limit}'] for limit in ('min', 'max'))
        marked = [layer[column] for *_, layer in layers]
        limits[axis] = min(low, *marked), max(high, *marked)
    for coarseness in _COARSENESSES:
        begin = time.monotonic()
        thicknesses, wave_speeds = (
            np.geomspace(*limits[axis], count // coarseness) for axis, count in _COUNTS.items()
        )
        transfer = energy_transfer(rig, thicknesses[:, None], wave_speeds)
        if 4.0 * (time.monotonic() - begin) > _TIME_BUDGET:  # duration of the next grid
            break
    axes = MapAxis('Lₛ (mm)', _MILLI * thicknesses), MapAxis('cₛ (m/s)', wave_speeds)
    title = 'α, lossless' if rig.layer.loss_tangent else 'α'
    with mpl.rc_context(charts.STYLE):
        figure = Figure(figsize=_SIZE, layout='constrained')
        charts.draw_map(figure.subplots(), axes, transfer, label=title, marks=marks)
        figure.legend(
            loc='outside upper center', ncols=2, facecolor='0.3', labelcolor='white',
            frameon=True,
        )
    return figure
