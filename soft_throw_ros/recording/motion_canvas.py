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
