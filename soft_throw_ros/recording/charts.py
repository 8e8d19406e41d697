# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Maps over two axes, drawn by Matplotlib: into files, and as images for Rerun."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
import functools
import io
import time
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import throw_many
from soft_throw_ros.recording.rerun_text import Values
from soft_throw_ros.twin.results import Floats

Bytes = NDArray[np.uint8]
Marks = Iterable[tuple[str, float, float]]
"""Marked points: title, and values on both axes."""

DPI = 100
"""Resolution of the images for Rerun, in pixels per inch, which suits a window of usual size."""

_STRAIN_SIZE = 6.2, 1.9
"""Width and height of the strain of a throw. [inch]"""

STRAIN_BOX = 50, 28, 490, 117
"""Left and upper edge, width and height of the strain within its frame. [pixel]"""

_STRAIN_AXES, _BAR_AXES = (
    (left / 620, 45 / 190, width / 620, 117 / 190) for left, width in ((50, 490), (550, 12))
)
"""The same of the strain and of its bar of colours, from the lower edge, over the frame."""

_BACKGROUND, _TEXT, _LINE = '#0d1011', 'white', '#b0b0b0'

_STYLE: dict[Any, Any] = {
    'axes.edgecolor': _LINE,
    'axes.labelcolor': _TEXT,
    'figure.facecolor': _BACKGROUND,
    'font.size': 9.0,
    'text.color': _TEXT,
    'xtick.color': _LINE,
    'ytick.color': _LINE,
}
"""Style of figures in the viewer, in the colours of Rerun."""

# Both are for any eyes: PuOr of ColorBrewer where there are two signs, viridis for one.
_SIGNED = mpl.colormaps['PuOr'].with_extremes(bad=_LINE)
_UNSIGNED = 'viridis'


_MAP_SIZE = 6.2, 2.5
"""Width and height of the map of all layers. [inch]"""

_MAP_COUNTS = {'thickness': 160, 'wave_speed': 100}
"""Values on each axis of the finest map. [-]"""

_TIME_BUDGET = 1.0
"""The finest map is chosen that needs no longer: too heavy a projectile takes minutes. [s]"""


class MapAxis(NamedTuple):
    """An axis of a map."""

    title: str  # quantity and unit
    values: Floats  # (n,) in the unit of the title, spaced evenly or by a constant factor

    @property
    def scale(self) -> str:
        """Spacing of the values, as Matplotlib names it."""
        values = self.values
        is_log = values.size > 2 and values[0] > 0.0 and np.ptp(np.diff(np.log(values))) < 1e-9
        return 'log' if is_log else 'linear'


def draw_map(
    panel: Any,
    axes: tuple[MapAxis, MapAxis],
    values: Floats,
    *,
    label: str,
    colours: str = _UNSIGNED,
    highest: float | None = None,
    marks: Marks = (),
) -> None:
    """
    Draw values over two axes as colours, with a bar of colours and up to two marks.

    `values`, shape (n, m), are along the first and the second axis, from 0 to `highest`, or the
    largest one; NaN where there are none. The titles of marks are for a legend.
    """
    x, y = axes
    image = panel.pcolormesh(
        x.values, y.values, values.T, cmap=colours, vmin=0.0, vmax=highest, shading='nearest'
    )
    extend = 'neither' if highest is None else 'max'
    panel.figure.colorbar(image, ax=panel, label=label, extend=extend)
    panel.set(facecolor='0.75')
    for letter, axis in zip('xy', axes, strict=True):
        limits = axis.values[0], axis.values[-1]
        panel.set(**{
            f'{letter}scale': axis.scale, f'{letter}label': axis.title, f'{letter}lim': limits
        })
        if axis.scale == 'log':
            ticks = getattr(panel, f'{letter}axis')
            ticks.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            ticks.set_major_formatter('{x:g}')
            ticks.set_minor_locator(NullLocator())
    for marker, (title, *point) in zip('o*', marks, strict=False):
        panel.plot(
            *point, marker, mfc='white', mec='black', ms=9, ls='', label=title, clip_on=False
        )


@functools.lru_cache(maxsize=16)
def strain_frame(
    duration: float, thickness: float, limit: float, ejection_time: float | None
) -> bytes:
    """
    Draw the axes around the strain of a throw, and the bar of its colours, as PNG.

    The strain itself is another image, in `STRAIN_BOX`, since many throws have the same frame, and
    one takes 100 ms. The axes end at `duration` [s] and `thickness` [m], the colours at `limit`.
    """
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=_STRAIN_SIZE)
        panel = figure.add_axes(_STRAIN_AXES)
        panel.set(
            xlim=(0.0, 1e3 * duration), ylim=(0.0, 1e3 * thickness),
            xlabel='t (ms)', ylabel='y (mm)',
        )
        if ejection_time is not None:
            panel.text(
                ejection_time / duration, 1.04, f'tₑ {1e3 * ejection_time:.2f} ms', ha='center',
                transform=panel.transAxes,
            )
        colours = ScalarMappable(Normalize(-100.0 * limit, 100.0 * limit), _SIGNED)
        figure.colorbar(colours, cax=figure.add_axes(_BAR_AXES), label='ε (%)')
        return to_png(figure)


def _energy_transfer(rig: Rig, thickness: Floats, wave_speed: Floats) -> Floats:
    """Compute alpha of a rig with other layers, without loss; NaN where nothing is thrown [-]."""
    layer = Layer(density=rig.layer.density, diameter=rig.layer.diameter)
    rig = replace(rig, engine=replace(rig.engine, motion=None), layer=layer)
    return throw_many(rig, {'thickness': thickness, 'wave_speed': wave_speed}).energy_transfer


def draw_energy_map(rig: Rig, settings: Settings, recommendation: Values) -> Figure:
    """
    Draw the map for a rig with its marks and a legend; the marks are within it.

    The limits in the settings of the twin select the layers. The marks use the values of
    `~/recommendation` for this rig, which may be empty, so that they agree with the table.
    """
    layers = {'now': (rig.layer.thickness, rig.layer.wave_speed)}
    match [recommendation.get(name) for name in _MAP_COUNTS]:
        case float(thickness), float(wave_speed):
            layers['recommended'] = thickness, wave_speed
    marks, limits = [], {}
    for name, layer in layers.items():
        alpha = recommendation.get('now.energy_transfer' if name == 'now' else 'energy_transfer')
        if not isinstance(alpha, float):
            alpha = float(_energy_transfer(rig, *np.array(layer)))
        text = f'α {alpha:.3f}' if alpha > 0.0 else 'no release'
        marks.append((f'{name}: {text}', 1e3 * layer[0], layer[1]))
    for column, axis in enumerate(_MAP_COUNTS):
        low, high = (settings[f'recommendation.{axis}_{limit}'] for limit in ('min', 'max'))
        marked = [layer[column] for layer in layers.values()]
        limits[axis] = min(low, *marked), max(high, *marked)
    for coarseness in (8, 4, 2, 1):
        begin = time.monotonic()
        thicknesses, wave_speeds = (
            np.geomspace(*limits[axis], count // coarseness) for axis, count in _MAP_COUNTS.items()
        )
        transfer = _energy_transfer(rig, thicknesses[:, None], wave_speeds)
        if 4.0 * (time.monotonic() - begin) > _TIME_BUDGET:  # duration of the next grid
            break
    axes = MapAxis('Lₛ (mm)', 1e3 * thicknesses), MapAxis('cₛ (m/s)', wave_speeds)
    title = 'α, lossless' if rig.layer.loss_tangent else 'α'
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=_MAP_SIZE, layout='constrained')
        draw_map(figure.subplots(), axes, transfer, label=title, marks=marks)
        figure.legend(
            loc='outside upper center', ncols=2, facecolor='0.3', labelcolor='white',
            frameon=True,
        )
    return figure


def signed_colours(values: Floats, limit: float) -> Bytes:
    """Return colours, shape (..., 3), of values from -limit to limit; grey for NaN."""
    scaled = np.ma.masked_invalid(0.5 + 0.5 * values / limit)
    return np.ascontiguousarray(_SIGNED(scaled, bytes=True)[..., :3])


def to_png(figure: Figure, *, dpi: float = DPI) -> bytes:
    """Return a figure as PNG."""
    output = io.BytesIO()
    figure.savefig(output, format='png', dpi=dpi, metadata={'Software': None})
    return output.getvalue()
