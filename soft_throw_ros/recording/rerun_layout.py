# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The window of a twin in Rerun: lines of plots, and the arrangement of all views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.configuration.interface import ENERGIES, Topic, TWIN_TOPICS

STAMP = 'stamp'
"""Timeline of the messages' stamps."""

THROW_TIME = 'time since throw'
"""Timeline of the rig, from the start of the throw that is shown."""

LOG = 'log'
"""Entity with the log of all nodes."""

# The colours of Okabe and Ito, which people with colour blindness can distinguish.
GREY = (0xB0, 0xB0, 0xB0)
WHITE = (0xFF, 0xFF, 0xFF)
BLUE = (0x56, 0xB4, 0xE9)
ORANGE = (0xE6, 0x9F, 0x00)
GREEN = (0x00, 0x9E, 0x73)
PURPLE = (0xCC, 0x79, 0xA7)
RED = (0xD5, 0x5E, 0x00)

PHASES = {
    'rest': (0x60, 0x60, 0x60), 'contact': ORANGE, 'flight': BLUE, 'landed': GREEN,
    'returning': PURPLE,
}


class Lines(NamedTuple):
    """Lines of a plot, in one entity."""

    title: str  # of the plot; empty for lines that are added to one
    topic: Topic
    quantity: str  # of its messages JointState; empty for a cloud
    names: tuple[str, ...]
    colours: tuple[tuple[int, int, int], ...]
    factors: float | tuple[float, ...] = 1.0  # from SI units to the units of the plot
    widths: float | tuple[float, ...] = 1.0  # of all lines, or of each


_STATES = TWIN_TOPICS.joint_states
_BODIES = ('plate', 'projectile')

LINES = {
    'position': Lines('Position z (mm)', _STATES, 'position', _BODIES, (GREY, BLUE), 1e3, 1.5),
    'velocity': Lines('Velocity v (m/s)', _STATES, 'velocity', _BODIES, (GREY, BLUE), 1.0, 1.5),
    'force': Lines(
        'Compressive force F (N)', _STATES, 'effort', ('at the plate', 'at the projectile'),
        (GREY, BLUE), (-1.0, 1.0), 1.5,
    ),
    'energy': Lines(
        'Energy (mJ)', TWIN_TOPICS.throw_energies, '',
        ('work of the plate', *ENERGIES[2:4], 'projectile + layer'),
        (GREY, BLUE, ORANGE, GREEN), 1e3, (4.0, 1.5, 1.5, 1.5),
    ),
    'position/measured': Lines(
        '', TWIN_TOPICS.measured_joint_states, 'position',
        ('plate, measured', 'projectile, measured'), (RED, ORANGE), 1e3,
    ),
    'position/predicted': Lines(
        '', TWIN_TOPICS.predicted_joint_states, 'position', ('projectile, predicted',), (GREEN,),
        1e3,
    ),
    'residual': Lines(
        'Model less measurement (µm)', TWIN_TOPICS.residual, 'position', _BODIES, (GREY, BLUE),
        1e6,
    ),
}
"""Lines by entity below that of the twin; the first part of its name is the plot."""

_OPTIONAL = {'energy', 'residual', LOG}
"""Panels that are left out while they would be empty."""

STRAIN_WIDTH = 4.0
"""Width of the picture of the strain over time, whose height is 1, in its view."""

_STRAIN = rrb.VisualBounds2D(x_range=[-0.5, STRAIN_WIDTH + 0.9], y_range=[-0.4, 1.3])

_BEFORE, _AFTER = 0.7, 1.8  # that plots show before and after the cursor [periods of the plate]
_LIVE_BEFORE, _LEAST_LIVE = 4.0, 2.0  # that live plots show [periods of the plate], [s] at least


@dataclass
class TwinLayout:
    """Properties of a twin that determine its layout; a change requires a new layout."""

    root: str  # of its entities
    title: str
    period: float = 1.0  # of the plate, on the timeline that is shown [s]
    diameter: float = 12.0  # of the layer [mm]
    height: float = 60.0  # of the side view above the plate [mm]
    present: frozenset[str] = frozenset()  # optional panels that are there


def arrange(twins: Sequence[TwinLayout], timeline: str, *, is_live: bool) -> rrb.Blueprint:
    """Return the window of one twin, or of several ones in tabs."""
    views = [_arrange_twin(twin, is_live=is_live) for twin in twins]
    return rrb.Blueprint(
        views[0] if len(views) == 1 else rrb.Tabs(*views),
        rrb.TopPanel(state='expanded' if is_live else 'collapsed'),
        rrb.BlueprintPanel(state='hidden'),
        rrb.SelectionPanel(state='hidden'),
        rrb.TimePanel(
            state='collapsed', timeline=timeline,
            playback_speed=1.0 if is_live else min(0.5 * twins[0].period, 1.0),
            play_state='following' if is_live else 'paused',
        ),
    )


def _arrange_twin(twin: TwinLayout, *, is_live: bool) -> rrb.Container:
    """Return all panels of a twin; plots and phases show a time window around the cursor."""
    before, after = _BEFORE * twin.period, _AFTER * twin.period
    if is_live:
        before, after = max(_LIVE_BEFORE * twin.period, _LEAST_LIVE), 0.0
    begin, end = (
        rrb.TimeRangeBoundary.cursor_relative(seconds=seconds) for seconds in (-before, after)
    )
    window = rrb.TimeAxis(view_range=rr.TimeRange(start=begin, end=end))
    half = 1.25 * twin.diameter
    side = rrb.VisualBounds2D(x_range=[-half, half], y_range=[-twin.height, 0.32 * half])
    hidden = [rrb.encodings.TimelineColumn(name, visible=False) for name in (STAMP, THROW_TIME)]
    log = rrb.TextLogColumns(timeline_columns=hidden, text_log_columns=['LogLevel', 'Body'])
    picture, text = rrb.Spatial2DView, rrb.TextDocumentView

    def plot(entity: str, title: str) -> tuple[Any, ...]:
        return 3.0, entity, rrb.TimeSeriesView, title, {
            'axis_x': window,
            'plot_legend': rrb.PlotLegend('RightTop' if entity == 'force' else 'LeftTop'),
        }

    def column(*panels: tuple[Any, ...]) -> rrb.Container:
        """Stack panels: share of the height, entity, kind of view, title, options of the view."""
        shares, views = [], []
        for share, entity, kind, title, options in panels:
            if entity not in _OPTIONAL - twin.present:
                root = '' if entity == LOG else twin.root
                shares.append(share)
                views.append(kind(origin=f'{root}/{entity}', name=title, **options))
        return rrb.Vertical(*views, row_shares=shares)

    return rrb.Horizontal(
        column(
            (3.0, 'side', picture, 'Rig, to scale', {'visual_bounds': side}),
            (2.75, 'throw_result', text, 'Throw', {}),
        ),
        column(
            (1.5, 'phase', rrb.StateTimelineView, 'Phase', {'time_view': window}),
            *(plot(entity, line.title) for entity, line in LINES.items() if line.title),
        ),
        column(
            (2.7, 'strain', picture, 'Strain ε(y, t) in the throw', {'visual_bounds': _STRAIN}),
            (3.5, 'landscape', picture, 'Energy transfer α(Lₛ, cₛ)', {}),
            (4.15, 'recommendation', text, 'Recommended layer', {}),
            (2.25, LOG, rrb.TextLogView, 'Log', {'columns': log}),
        ),
        column_shares=[2.5, 4.2, 4.2], name=twin.title,
    )
