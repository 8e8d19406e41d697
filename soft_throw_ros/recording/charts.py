# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Maps over two axes, drawn by Matplotlib: into files, and as images for Rerun."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
import io
import time
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import rig_of, rig_values, Settings, TWIN
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import throw_many
from soft_throw_ros.recording.rerun_text import Values
from soft_throw_ros.twin.results import Floats

Bytes = NDArray[np.uint8]

_STYLE: dict[Any, Any] = {
    'figure.facecolor': '#0d1011', 'font.size': 9.0, 'legend.facecolor': '0.3',
    **dict.fromkeys(('axes.labelcolor', 'text.color'), 'white'),
    **dict.fromkeys(('axes.edgecolor', 'xtick.color', 'ytick.color'), '#b0b0b0'),
}
"""Style of figures in the viewer, in the colours of Rerun."""

# Both maps are for any eyes: PuOr of ColorBrewer where there are two signs, viridis for one.
_SIGNED = mpl.colormaps['PuOr'].with_extremes(bad='#b0b0b0')

_MAP_COUNTS = 16, 32, 64, 128  # points on both axes; the finest map in `_TIME_BUDGET` is taken [-]
_TIME_BUDGET = 1.0  # for the map: too heavy a projectile would take minutes [s]


def draw_map(
    panel: Any, axes: Mapping[str, Floats], values: Floats, *, label: str,
    colours: str = 'viridis', highest: float | None = None,
    marks: Iterable[tuple[str, float, float]] = (),
) -> None:
    """
    Draw values, shape (n, m), over two axes as colours from 0 to `highest`; NaN where are none.

    `axes` are their points, spaced evenly or by a constant factor, by title and unit. At most two
    `marks` are titles for a legend, and values on both axes.
    """
    image = panel.pcolormesh(
        *axes.values(), values.T, cmap=colours, vmin=0.0, vmax=highest, shading='nearest'
    )
    extend = 'neither' if highest is None else 'max'
    panel.figure.colorbar(image, ax=panel, label=label, extend=extend)
    panel.set(facecolor='0.75')
    for letter, (title, points) in zip('xy', axes.items(), strict=True):
        panel.set(**{f'{letter}label': title, f'{letter}lim': (points[0], points[-1])})
        if points.size > 2 and points[0] > 0.0 and np.ptp(np.diff(np.log(points))) < 1e-9:
            panel.set(**{f'{letter}scale': 'log'})
            ticks = getattr(panel, f'{letter}axis')
            ticks.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            ticks.set_major_formatter('{x:g}')
            ticks.set_minor_locator(NullLocator())
    for marker, (title, *point) in zip('o*', marks, strict=False):
        panel.plot(
            *point, marker, mfc='white', mec='black', ms=9, ls='', label=title, clip_on=False
        )


def draw_energy_map(values: Values, settings: Settings) -> Figure:
    """
    Draw alpha over the layers within the limits of the settings, and mark two of them.

    `values` are those of `~/recommendation`, with its rig and the recommended layer.
    """
    rig = rig_of({**TWIN.defaults(), **{name: values[name] for name in rig_values(Rig())}})
    lossless = replace(rig, layer=Layer(density=rig.layer.density, diameter=rig.layer.diameter))
    layers = {'now': (rig.layer.thickness, rig.layer.wave_speed)}
    match values.get('thickness'), values.get('wave_speed'):
        case float(thickness), float(wave_speed):
            layers['recommended'] = thickness, wave_speed
    corners = [
        [settings[f'recommendation.{name}_{end}'] for name in ('thickness', 'wave_speed')]
        for end in ('min', 'max')
    ]
    low, high = (function([*corners, *layers.values()], axis=0) for function in (np.min, np.max))
    for count in _MAP_COUNTS:
        begin = time.monotonic()
        thicknesses, wave_speeds = np.geomspace(low, high, count, axis=1)
        layers_of_map = {'thickness': thicknesses[:, None], 'wave_speed': wave_speeds}
        transfer = throw_many(lossless, layers_of_map).energy_transfer
        # Duration of the next grid; the first one loads the kernels
        if count > _MAP_COUNTS[0] and 4.0 * (time.monotonic() - begin) > _TIME_BUDGET:
            break
    axes = {'Lₛ (mm)': 1e3 * thicknesses, 'cₛ (m/s)': wave_speeds}
    marks = [(name, 1e3 * thickness, speed) for name, (thickness, speed) in layers.items()]
    title = 'α, lossless' if rig.layer.loss_tangent else 'α'
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(6.2, 2.5), layout='constrained')
        draw_map(figure.subplots(), axes, transfer, label=title, marks=marks)
        figure.legend(loc='outside upper center', ncols=2)
    return figure


def signed_colours(values: Floats, limit: float) -> Bytes:
    """Return colours, shape (..., 3), of values from -limit to limit; grey for NaN."""
    scaled = np.ma.masked_invalid(0.5 + 0.5 * values / limit)
    return np.ascontiguousarray(_SIGNED(scaled, bytes=True)[..., :3])


def to_png(figure: Figure, *, dpi: float = 100.0) -> bytes:
    """Return a figure as PNG."""
    output = io.BytesIO()
    figure.savefig(output, format='png', dpi=dpi, metadata={'Software': None})
    return output.getvalue()
