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
"""What is shown of a twin in Rerun, and where: lines of plots, panels of the window, as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.recording import rerun_canvas as drawing
from soft_throw_ros.recording.rerun_canvas import BLUE, Colour, GREEN, GREY, ORANGE, RED

LOG = '/log'
"""Where lines of the log are, of all nodes."""

STRAIN_HEIGHT = 58.0
"""Of the chart of strain, whose width is `WIDTH`."""

PHASES = {
    'rest': (0x60, 0x60, 0x60),
    'contact': ORANGE,
    'flight': BLUE,
    'landed': GREEN,
    'returning': drawing.PURPLE,
}


class Lines(NamedTuple):
    """Lines of a plot, in one entity."""

    names: tuple[str, ...]
    colours: tuple[Colour, ...]
    factor: float = 1.0  # from SI units to those of the plot
    width: float = 1.5


BODIES = ('plate', 'projectile')

LINES = {
    'position': Lines(BODIES, (GREY, BLUE), 1e3),
    'velocity': Lines(BODIES, (GREY, BLUE)),
    'force': Lines(('at the plate', 'at the projectile'), (GREY, BLUE)),
    'energy/plate_work': Lines(('work of the plate',), (GREY,), 1e3, 4.0),
    'energy/projectile': Lines(('projectile',), (BLUE,), 1e3),
    'energy/layer': Lines(('layer',), (ORANGE,), 1e3),
    'energy/total': Lines(('projectile + layer',), (GREEN,), 1e3),
    'position/measured': Lines(
        ('plate, measured', 'projectile, measured'), (RED, ORANGE), 1e3, 1.0
    ),
    'position/predicted': Lines(('projectile, predicted',), (GREEN,), 1e3, 1.0),
    'residual': Lines(BODIES, (GREY, BLUE), 1e6, 1.0),
}
"""By the entity below that of the twin; its first part is the plot."""

POSITIONS = {
    TWIN_TOPICS.measured_joint_states: 'position/measured',
    TWIN_TOPICS.predicted_joint_states: 'position/predicted',
    TWIN_TOPICS.residual: 'residual',
}
"""Where positions besides those of the states are drawn."""


class Panel(NamedTuple):
    """A view of the window."""

    name: str  # of the entity, below that of the twin unless it begins with /
    kind: str  # of view
    title: str
    share: float  # of the height of its column
    is_optional: bool = False  # whether it is there only if there is something to show


COLUMNS = (
    (2.5, (
        Panel('side', 'rig', 'Rig, z (mm)', 3.0),
        Panel('throw_result', 'text', 'Throw', 2.75),
    )),
    (4.2, (
        Panel('phase', 'phase', 'Phase', 1.5),
        Panel('position', 'plot', 'Position z (mm)', 3.0),
        Panel('velocity', 'plot', 'Velocity v (m/s)', 3.0),
        Panel('force', 'plot', 'Compressive force F (N)', 3.0),
        Panel('energy', 'plot', 'Energy (mJ)', 3.0),
        Panel('residual', 'plot', 'Model less measurement (µm)', 3.0, is_optional=True),
    )),
    (4.2, (
        Panel('strain', 'strain', 'Strain ε(y, t) in the throw', 2.7),
        Panel('landscape', 'map', 'Energy transfer α(Lₛ, cₛ)', 3.5),
        Panel('recommendation', 'text', 'Recommended layer', 4.15),
        Panel('track', 'text', 'Measured track', 1.9, is_optional=True),
        Panel(LOG, 'log', 'Log', 2.25, is_optional=True),
    )),
)
"""The window of a twin: columns from left to right with their share of the width, top down."""

_PLOTS_SIZE = 616.0, 650.0
"""Width and height of all plots together in a picture of the default size. [points]"""

_LABEL_SPACE, _LABEL_DISTANCE = 9.0, 20.0
"""What Rerun leaves beside the labels of an axis, and between them at least. [points]"""

_CHARACTERS = {'-': 6.0, '.': 3.5}
_DIGIT = 7.5
"""How wide characters of labels are. [points]"""

BEFORE, AFTER = 0.7, 1.8
"""What plots show before and after the cursor, in periods of the plate."""

_LIVE_BEFORE, _LEAST_LIVE = 4.0, 2.0
"""What they show up to now: in periods of the plate, and at least in seconds."""


@dataclass(frozen=True, kw_only=True)
class TwinLayout:
    """What the layout of a twin depends on; with another one it has to be sent anew."""

    root: str  # of its entities
    title: str
    period: float  # of the plate, on the timeline that is shown [s]
    side: tuple[float, float, float]  # half the width of the side view, and its heights [mm]
    residual_limit: float  # of the residual's plot [um]
    present: frozenset[str]  # optional panels that are there
    # Lowest and highest value of each plot, by which only the width of its labels changes
    extents: Mapping[str, tuple[float, float]] = field(compare=False)


def settled(now: float, before: float, least: float = 1.0 / 1.15, most: float = 1.15) -> float:
    """
    Return a size as it was before if now it is much the same, over it from `least` to `most`.

    A layout that is sent anew takes back what somebody has arranged by hand, and Rerun's server
    keeps every one: a megabyte each time that a calibrator corrects a rig a little.

    Examples
    --------
    >>> settled(1.1, 1.0), settled(1.2, 1.0)
    (1.0, 1.2)

    """
    return before if least * before <= now <= most * before else now


def arrange(twin: TwinLayout, *, is_live: bool) -> rrb.Container:
    """Arrange all there is of a twin."""
    before, after = BEFORE * twin.period, AFTER * twin.period
    if is_live:
        before, after = max(_LIVE_BEFORE * twin.period, _LEAST_LIVE), 0.0
    begin, end = (
        rrb.TimeRangeBoundary.cursor_relative(seconds=seconds) for seconds in (-before, after)
    )
    window = rrb.TimeAxis(view_range=rr.TimeRange(start=begin, end=end))
    shares, columns = [], []
    for share, panels in COLUMNS:
        shown = [each for each in panels if not each.is_optional or each.name in twin.present]
        views = _aligned(shown, [_view(panel, twin, window) for panel in shown], twin)
        shares.append(share)
        columns.append(rrb.Vertical(*views, row_shares=[panel.share for panel in shown]))
    return rrb.Horizontal(*columns, column_shares=shares, name=twin.title)


def _view(panel: Panel, twin: TwinLayout, window: rrb.TimeAxis) -> rrb.View:
    """Make the view of a panel; plots and phases show a window of time around the cursor."""
    origin = panel.name if panel.name.startswith('/') else f'{twin.root}/{panel.name}'
    match panel.kind:
        case 'rig':
            half, low, high = twin.side
            bounds = rrb.VisualBounds2D(x_range=[-half, half], y_range=[-high, -low])
            return rrb.Spatial2DView(origin=origin, name=panel.title, visual_bounds=bounds)
        case 'strain' | 'map':
            height = STRAIN_HEIGHT if panel.kind == 'strain' else drawing.MAP_HEIGHT
            return drawing.chart_view(origin, panel.title, height)
        case 'phase':
            return rrb.StateTimelineView(origin=origin, name=panel.title, time_view=window)
        case 'plot':
            limit = twin.residual_limit
            return rrb.TimeSeriesView(
                origin=origin,
                name=panel.title,
                axis_x=window,
                axis_y=rrb.ScalarAxis(range=(-limit, limit)) if panel.name == 'residual' else None,
                plot_legend=rrb.PlotLegend('RightTop' if panel.name == 'force' else 'LeftTop'),
            )
        case 'log':
            hidden = [
                rrb.encodings.TimelineColumn(name, visible=False)
                for name in (drawing.STAMP, drawing.THROW_TIME)
            ]
            columns = rrb.TextLogColumns(
                timeline_columns=hidden, text_log_columns=['LogLevel', 'Body']
            )
            return rrb.TextLogView(origin=origin, name=panel.title, columns=columns)
        case _:
            return rrb.TextDocumentView(origin=origin, name=panel.title)


def _aligned(
    panels: Sequence[Panel], views: Sequence[rrb.View], twin: TwinLayout
) -> list[rrb.View | rrb.Container]:
    """Leave room to the left of views, so that all begin where the widest labels end."""
    if not any(panel.kind == 'plot' for panel in panels):
        return list(views)
    extents = {**twin.extents, 'residual': (-twin.residual_limit, twin.residual_limit)}
    height = _PLOTS_SIZE[1] / sum(panel.kind == 'plot' for panel in panels)
    widths = [
        _axis_width(*extents.get(panel.name, (0.0, 10.0)), height) if panel.kind == 'plot' else 0.0
        for panel in panels
    ]
    aligned: list[rrb.View | rrb.Container] = []
    for view, width in zip(views, widths, strict=True):
        room = max(widths) - width
        if room < 1.0:
            aligned.append(view)
            continue
        margin = rrb.TextDocumentView(origin=f'{twin.root}/margin', name=' ', titlebar=False)
        shares = [room, _PLOTS_SIZE[0] - room]
        aligned.append(rrb.Horizontal(margin, view, column_shares=shares))
    return aligned


def _axis_width(low: float, high: float, height: float) -> float:
    """Return how much Rerun needs for the labels beside a plot, at powers of ten [points]."""
    extent = max(high - low, 1e-9)
    step = 10.0 ** math.ceil(math.log10(_LABEL_DISTANCE * extent / height))
    numbers = range(math.ceil(low / step), math.floor(high / step) + 1)
    labels = [f'{step * number:g}' for number in numbers]
    widths = [sum(_CHARACTERS.get(each, _DIGIT) for each in label) for label in labels]
    return _LABEL_SPACE + max(widths, default=_DIGIT)
