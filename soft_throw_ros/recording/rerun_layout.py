# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The layout of a twin in Rerun as data: lines of plots and panels of the window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.configuration.interface import ENERGIES, TWIN_TOPICS
from soft_throw_ros.recording import rerun_canvas as drawing
from soft_throw_ros.recording.rerun_canvas import BLUE, Colour, GREEN, GREY, ORANGE, RED

LOG = '/log'
"""Entity with the log of all nodes."""

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
    factor: float = 1.0  # from SI units to the units of the plot
    width: float | tuple[float, ...] = 1.5  # of all lines, or of each


BODIES = ('plate', 'projectile')

LINES = {
    'position': Lines(BODIES, (GREY, BLUE), 1e3),
    'velocity': Lines(BODIES, (GREY, BLUE)),
    'force': Lines(('at the plate', 'at the projectile'), (GREY, BLUE)),
    'energy': Lines(
        ('work of the plate', *ENERGIES[2:4], 'projectile + layer'),
        (GREY, BLUE, ORANGE, GREEN),
        1e3,
        (4.0, 1.5, 1.5, 1.5),
    ),
    'position/measured': Lines(
        ('plate, measured', 'projectile, measured'), (RED, ORANGE), 1e3, 1.0
    ),
    'position/predicted': Lines(('projectile, predicted',), (GREEN,), 1e3, 1.0),
    'residual': Lines(BODIES, (GREY, BLUE), 1e6, 1.0),
}
"""Lines by entity below that of the twin; the first part of its name is the plot."""

POSITIONS = {
    TWIN_TOPICS.measured_joint_states: 'position/measured',
    TWIN_TOPICS.predicted_joint_states: 'position/predicted',
    TWIN_TOPICS.residual: 'residual',
}
"""Entities of positions that are not those of the states."""


class Panel(NamedTuple):
    """A view of the window."""

    name: str  # of the entity, below that of the twin unless it begins with /
    kind: str  # of view
    title: str
    share: float  # of the height of its column


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
        Panel('residual', 'plot', 'Model less measurement (µm)', 3.0),
    )),
    (4.2, (
        Panel('strain', 'image', 'Strain ε(y, t) in the throw', 2.7),
        Panel('landscape', 'image', 'Energy transfer α(Lₛ, cₛ)', 3.5),
        Panel('recommendation', 'text', 'Recommended layer', 4.15),
        Panel('track', 'text', 'Measured track', 1.9),
        Panel(LOG, 'log', 'Log', 2.25),
    )),
)
"""The window of a twin: columns from left to right with their share of the width, top down."""

OPTIONAL = {'energy', 'residual', 'track', LOG}
"""Panels that are left out while they would be empty."""

BEFORE, AFTER = 0.7, 1.8
"""Time that plots show before and after the cursor. [periods of the plate]"""

_LIVE_BEFORE, _LEAST_LIVE = 4.0, 2.0
"""Time that live plots show: [periods of the plate], and at least [s]."""


@dataclass(frozen=True, kw_only=True)
class TwinLayout:
    """Properties of a twin that determine its layout; a change requires a new layout."""

    root: str  # of its entities
    title: str
    period: float  # of the plate, on the timeline that is shown [s]
    side: tuple[float, float, float]  # half the width of the side view, and its heights [mm]
    residual_limit: float  # beyond which the model is reported as wrong [um]
    present: set[str]  # optional panels that are there


def arrange(twin: TwinLayout, *, is_live: bool) -> rrb.Container:
    """Return the container of all panels of a twin."""
    before, after = BEFORE * twin.period, AFTER * twin.period
    if is_live:
        before, after = max(_LIVE_BEFORE * twin.period, _LEAST_LIVE), 0.0
    begin, end = (
        rrb.TimeRangeBoundary.cursor_relative(seconds=seconds) for seconds in (-before, after)
    )
    window = rrb.TimeAxis(view_range=rr.TimeRange(start=begin, end=end))
    shares, columns = [], []
    for share, panels in COLUMNS:
        shown = [item for item in panels if item.name not in OPTIONAL or item.name in twin.present]
        views = [_view(panel, twin, window) for panel in shown]
        shares.append(share)
        columns.append(rrb.Vertical(*views, row_shares=[panel.share for panel in shown]))
    return rrb.Horizontal(*columns, column_shares=shares, name=twin.title)


def _view(panel: Panel, twin: TwinLayout, window: rrb.TimeAxis) -> rrb.View:
    """Return the view of a panel; plots and phases show a time window around the cursor."""
    origin = panel.name if panel.name.startswith('/') else f'{twin.root}/{panel.name}'
    match panel.kind:
        case 'rig':
            half, low, high = twin.side
            bounds = rrb.VisualBounds2D(x_range=[-half, half], y_range=[-high, -low])
            return rrb.Spatial2DView(origin=origin, name=panel.title, visual_bounds=bounds)
        case 'image':
            return rrb.Spatial2DView(origin=origin, name=panel.title)
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
