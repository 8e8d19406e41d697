# SPDX-License-Identifier: Apache-2.0
"""Motions of a plate side by side in a recording of Rerun."""

from __future__ import annotations

from collections.abc import Mapping

import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.recording.rerun_canvas import BLUE, GREEN, GREY, ORANGE, THROW_TIME, WHITE
from soft_throw_ros.recording.timeseries import Floats

_COLOURS = (GREY, BLUE, ORANGE, GREEN)


def draw_motions(
    stream: rr.RecordingStream, motions: Mapping[str, tuple[Floats, Floats, Floats]]
) -> None:
    """
    Draw heights and velocities of plates over the time since the start.

    Parameters
    ----------
    stream : RecordingStream
        To draw into.
    motions : mapping of str to tuple of ndarray
        Times [s], heights [m] and velocities [m/s] by titles; the last one stands out.

    """
    views = []
    for index, folder, name in ((1, 'height', 'Height (m)'), (2, 'velocity', 'Velocity (m/s)')):
        for n, (title, series) in enumerate(motions.items()):
            is_last = n == len(motions) - 1
            path = f'plate/{folder}/{n}'
            colour = WHITE if is_last else _COLOURS[n % len(_COLOURS)]
            style = rr.SeriesLines(colors=colour, names=title, widths=3.0 if is_last else 1.5)
            stream.log(path, style, static=True)
            times = rr.TimeColumn(THROW_TIME, duration=series[0])
            stream.send_columns(path, [times], rr.Scalars.columns(scalars=series[index]))
        views.append(rrb.TimeSeriesView(origin=f'plate/{folder}', name=name))
    stream.send_blueprint(rrb.Blueprint(rrb.Horizontal(*views), collapse_panels=True))
