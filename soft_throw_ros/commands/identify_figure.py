# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a fit: data, model and residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands.output import written_file
from soft_throw_ros.identification.ejection import Ejection
from soft_throw_ros.identification.least_squares import TrackResidual
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.rig_model import Series

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

# Colours of Okabe and Ito, which colour-blind readers can distinguish
_COLOURS = {'plate': '#000000', 'projectile': '#0072b2'}
_DATA: dict[str, Any] = {'ls': '', 'marker': '.', 'ms': 4.0, 'alpha': 0.5, 'mew': 0.0}
_MILLI, _MICRO = 1e3, 1e6
_PERIODS = 2.5  # length of the enlarged section [plate periods]
_RISES = 2.2  # height of the enlarged section, as a multiple of the rise of the plate
_POINTS = 2000  # number of points of a curve of the model
_MAX_THROWS = 6  # largest number of throws in one figure


def draw_throws(
    result: RigFit, ejection: Ejection | None, summary: Sequence[str], path: Path
) -> None:
    """Draw tracks and model of the first few throws, and a summary above."""
    tracks = list(zip(result.model.series, result.fit.residuals, strict=True))
    bodies = ['plate', 'projectile'][: 1 + bool(result.model.projectiles)]
    figure = _figure(9.6, 3.6 + 1.5 * len(bodies))
    layout: list[Any] = [['near', 'whole'], *([body, body] for body in bodies)]
    panels = figure.subplot_mosaic(layout, height_ratios=[2.6, *[1.0] * len(bodies)])
    for body in bodies[1:]:
        panels[body].sharex(panels['plate'])
    for series, residual in tracks:
        if series.throw < _MAX_THROWS:
            _draw_track(result, series, residual, panels)
    if ejection is not None:
        for panel in panels.values():
            panel.axvline(_MILLI * ejection.first.time.value, color='0.4', lw=0.9, ls=':')
    period = _MILLI / result.rig.engine.frequency
    highest = _MILLI * max(
        float(np.ptp(residual.track.position))
        for series, residual in tracks
        if series.body == 'plate'
    )
    panels['near'].set(
        xlim=(-0.3 * period, _PERIODS * period),
        ylim=(-0.3 * highest, _RISES * highest),
        ylabel='height above rest (mm)',
    )
    panels['near'].legend(loc='upper right')
    for body in bodies:
        panels[body].set(ylabel=f'{body},\ndata - model (µm)')
    panels[bodies[-1]].set(
        xlabel='time since the plate began to move (ms)'
        + (', dotted: the projectile leaves' if ejection is not None else '')
    )
    rows = [', '.join(summary[k:k + 3]) for k in range(0, len(summary), 3)]
    figure.suptitle('\n'.join(rows).replace('+-', '±'), fontsize='medium')
    _save(figure, path)


def _draw_track(
    result: RigFit, series: Series, residual: TrackResidual, panels: Mapping[str, Any]
) -> None:
    """Draw a track, its model and its residuals into the panels of a figure."""
    throw, body, _ = series
    track, colour, start = residual.track, _COLOURS[body], result.start_time(throw).value

    def predict(time: Floats) -> Floats:
        return result.model.trajectory(result.fit.values, throw, body, time).height

    rest_height = predict(np.array([start]))
    since = _MILLI * (track.time - start)
    fine = np.linspace(track.time[0], track.time[-1], _POINTS)
    model = _MILLI * (predict(fine) - rest_height)
    height = _MILLI * (track.position - rest_height)
    for name in ('near', 'whole'):
        label = body if throw == 0 else None
        panels[name].plot(since, height, color=colour, **_DATA)
        panels[name].plot(_MILLI * (fine - start), model, color=colour, lw=1, label=label)
    band = 2.0 * _MICRO * track.noise
    panels[body].axhspan(-band, band, color='0.9', zorder=0)
    panels[body].plot(since, _MICRO * residual.values, color=colour, **_DATA)


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout='constrained')


def _save(figure: Figure, path: Path) -> None:
    with written_file(path) as unfinished:
        figure.savefig(unfinished, format=path.suffix[1:], dpi=150)
