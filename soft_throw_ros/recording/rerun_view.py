# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Twins in Rerun: the rig to scale, series, waves in the layer, the best layer, and words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
import math
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.configuration.interface import JOINT_STATE, Topic, TWIN_TOPICS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording import rerun_canvas as drawing
from soft_throw_ros.recording import rerun_layout as layout
from soft_throw_ros.recording import rerun_text as words
from soft_throw_ros.recording import timeseries as series
from soft_throw_ros.recording.panels import draw_strain, RecommendationPanel, RigPicture
from soft_throw_ros.recording.timeseries import Floats, Stamps, ThrowStart, Values
from soft_throw_ros.storage.cdr import decode
from soft_throw_ros.storage.message import Message

_MICRO = 1e6

_LOG = Topic('/rosout', 'rcl_interfaces/msg/Log', 'What nodes say')

_LEVELS = ((50, 'CRITICAL'), (40, 'ERROR'), (30, 'WARN'), (20, 'INFO'), (0, 'DEBUG'))
"""Levels of rcl_interfaces/Log and their names in Rerun."""


class Scene:
    """
    The drawing of all twins.

    Parameters
    ----------
    name : str
        Name of the recording in the viewer.
    is_live : bool
        Whether the latest messages are shown instead of a throw.
    is_picture : bool
        Whether panels for the mouse are left out.
    throw : ThrowStart, optional
        The throw that is shown; times count from its start.

    """

    def __init__(
        self,
        name: str,
        *,
        is_live: bool = False,
        is_picture: bool = False,
        throw: ThrowStart | None = None,
    ) -> None:
        self.damaged = 0  # number of messages that could not be read
        self.damage = ''  # the error of the first of them
        self._name = name
        self._is_live = is_live
        self._is_picture = is_picture
        self._canvas = drawing.Canvas(throw)
        self._twins: dict[str, _TwinView] = {}
        self._has_log = False
        self._arranged: object = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing has come that could be drawn."""
        return not any(twin.is_drawn for twin in self._twins.values())

    @property
    def span(self) -> tuple[float, float]:
        """Stamps of the first and the last state of all twins [ns]."""
        first, last = zip(*(twin.reader.span for twin in self._twins.values()), strict=True)
        return min(first), max(last)

    def connect(self, stream: rr.RecordingStream | None) -> None:
        """Draw into a recording from now on, with all that still holds; or into none."""
        if stream is not None:
            stream.send_recording_name(self._name)
        self._canvas.connect(stream)
        self._arranged = None
        if self._is_live:
            self.arrange()

    def show(self, messages: Iterable[Message]) -> None:
        """Draw messages topic by topic, in an order that respects their dependencies."""
        waiting: dict[str, dict[Topic, list[Message]]] = {}
        for message in messages:
            node, topic = _identify(message.channel.topic, message.channel.type)
            if topic is None:
                continue
            if topic == TWIN_TOPICS.journal:  # earlier messages belong to the former rig
                self._read(node, waiting.pop(node, {}))
            waiting.setdefault(node, {}).setdefault(topic, []).append(message)
        for node, groups in sorted(waiting.items(), reverse=True):  # lines of the log come last
            self._read(node, groups)
        if self._is_live:
            self.arrange()

    def _read(self, node: str, groups: Mapping[Topic, Sequence[Message]]) -> None:
        """Draw messages of one node, or messages that belong to no node."""
        readers: Mapping[Topic, Callable[..., None]] = {
            _LOG: self._draw_line, TWIN_TOPICS.diagnostics: self._draw_diagnostics
        }
        if node:
            if node not in self._twins:
                self._twins[node] = _TwinView(node, self._canvas)
            twin = self._twins[node]
            readers = {topic: partial(twin.show, topic) for topic in series.READERS}
        for topic, read in readers.items():
            messages = groups.get(topic, ())
            at_once = [messages] if messages and topic.type == JOINT_STATE else messages
            for data in at_once:
                self._attempt(read, data)

    def _attempt(self, read: Callable[..., None], data: Message | Sequence[Message]) -> None:
        """Read messages at once, or individually if one is damaged or different."""
        try:
            read(data)
        except series.DECODING_ERRORS as error:
            if not isinstance(data, Message) and len(data) > 1:
                for message in data:
                    self._attempt(read, [message])
                return
            message = data if isinstance(data, Message) else data[0]
            self.damaged += 1
            self.damage = self.damage or f'{message.channel.topic}: {error}'

    def _draw_line(self, message: Message) -> None:
        """Show a line of the log at the time of the twin, whose clock may be another one."""
        line = decode(message)
        known = (t.reader.stamp_of(message) for t in self._twins.values() if t.is_drawn)
        stamp = next(known, series.to_ns(line.stamp))
        level = next(name for bound, name in _LEVELS if line.level >= bound)
        self._has_log = True
        columns = rr.TextLog.columns(text=[f'{line.name}: {line.msg}'], level=[level])
        self._canvas.log_columns(layout.LOG, np.array([stamp]), columns)

    def _draw_diagnostics(self, message: Message) -> None:
        """Show diagnostics of a measured track, from a twin or from its calibrator."""
        for stamp, status, values in series.read_statuses(message):
            node, _, task = str(status.name).rpartition(': ')
            for name, twin in self._twins.items():
                is_beside = name.rpartition('/')[0] == node.rpartition('/')[0]
                if name == node or (is_beside and task == 'identification'):
                    twin.draw_track(stamp, task, status, values)

    def arrange(self) -> None:
        """Send the layout if it has changed, as every call of `show` does in a live view."""
        drawn = [twin for twin in self._twins.values() if twin.is_drawn]
        twins = [twin.layout_state(has_log=self._has_log) for twin in drawn]
        if not twins or twins == self._arranged:
            return
        self._arranged = twins
        views = [layout.arrange(twin, is_live=self._is_live) for twin in twins]
        self._canvas.arrange(
            rrb.Blueprint(
                views[0] if len(views) == 1 else rrb.Tabs(*views),
                rrb.TopPanel(state='hidden' if self._is_picture else 'expanded'),
                rrb.BlueprintPanel(state='hidden'),
                rrb.SelectionPanel(state='hidden'),
                rrb.TimePanel(
                    state='collapsed',
                    timeline=drawing.STAMP if self._canvas.throw is None else drawing.THROW_TIME,
                    playback_speed=1.0 if self._is_live else min(0.5 * twins[0].period, 1.0),
                    play_state='following' if self._is_live else 'paused',
                ),
            )
        )


class _TwinView:
    """The drawing of one twin from its messages."""

    def __init__(self, node: str, canvas: drawing.Canvas) -> None:
        self.reader = series.TwinReader()
        # Whether anything was drawn: topics with these names may belong to another machine
        self.is_drawn = False
        self._node = node
        self._root = rr.new_entity_path(node.split('/'))
        self._canvas = canvas
        self._side = RigPicture(canvas, self._path('side'))
        self._recommendation = RecommendationPanel(canvas, self._root)
        self._track: dict[str, str] = {}  # texts by the task of the node
        self._present: set[str] = set()  # optional panels that are there
        phases = rr.StateConfiguration(
            values=list(layout.PHASES), colors=list(layout.PHASES.values())
        )
        canvas.log_style(self._path('phase'), phases)

    def _path(self, name: str) -> str:
        return f'{self._root}/{name}'

    def show(self, topic: Topic, data: Message | Sequence[Message]) -> None:
        """Read and draw a message, or several messages of joints."""
        content = series.READERS[topic](self.reader, data)
        if content:
            self.is_drawn = True
            _DRAWERS[topic](self, content)

    def draw_rig(self, change: tuple[int, Rig]) -> None:
        stamp, rig = change
        self._side.change_rig(stamp, rig)
        self._recommendation.change_rig(stamp, rig, self.reader.settings)

    # plots

    def draw_lines(self, lines: tuple[Stamps, Floats], name: str) -> None:
        """Draw lines of a plot, of values in SI units."""
        stamps, values = lines
        names, colours, factor, width = layout.LINES[name]
        widths = np.broadcast_to(width, len(names))
        style = rr.SeriesLines(names=names, colors=colours, widths=widths)
        self._canvas.log_style(self._path(name), style)
        columns = rr.Scalars.columns(scalars=factor * values)
        self._canvas.log_columns(self._path(name), stamps, columns)
        if name in layout.OPTIONAL:
            self._present.add(name)

    def draw_states(self, states: series.RigStates) -> None:
        self.draw_lines((states.stamps, states.position), 'position')
        self.draw_lines((states.stamps, states.velocity), 'velocity')
        self.draw_lines((states.stamps, states.force * [-1.0, 1.0]), 'force')
        self._side.draw_positions(states.stamps, states.position)

    def draw_energies(self, energies: tuple[Stamps, Floats]) -> None:
        stamps, values = energies
        stamps = np.append(stamps, stamps[-1] + 1)  # a line ends there, by NaN
        values = np.vstack([values, np.full(values.shape[1], math.nan)])
        self.draw_lines((stamps, values), 'energy')

    # waves in the layer

    def draw_layer(self, layer: series.LayerStates) -> None:
        self._side.draw_layer(layer)

    def draw_field(self, field: series.StrainField) -> None:
        contact = field.strain[field.times <= (field.throw.ejection_time or field.times[-1])]
        limit = _round_up(max(1.5 * float(np.abs(contact).max()), 1e-6))
        self._side.largest_strain = limit
        draw_strain(self._canvas, self._path('strain'), field, limit)
        throw = self.reader.interpolate_throw(field)
        if throw is not None:
            position, layer = throw
            self._side.draw_positions(field.stamps, position)
            self._side.draw_layer(layer)

    # words

    def draw_phases(self, changes: Sequence[tuple[int, str]]) -> None:
        """Draw phases at the times of their starts."""
        for stamp, phase in changes:
            self._canvas.log_latched(self._path('phase'), stamp, rr.StateChange(state=phase))

    def draw_results(self, results: Sequence[tuple[int, Values]]) -> None:
        """Write the results of throws."""
        for stamp, values in results:
            self._canvas.log_text(self._path('throw_result'), stamp, words.throw_text(values))

    def draw_track(self, stamp: int, task: str, status: Any, values: Values) -> None:
        """Write the diagnostics of the measured track, one line for each task."""
        if task in words.TRACK_TASKS:
            self.is_drawn = True
            self._present.add('track')
            self._track[task] = words.track_text(task, status, values)
            lines = [self._track[name] for name in words.TRACK_TASKS if name in self._track]
            self._canvas.log_text(self._path('track'), stamp, '  \n'.join(lines))

    def draw_recommendations(self, recommendations: Sequence[tuple[int, str, Values]]) -> None:
        """Write recommendations, and draw the maps of their rig."""
        for stamp, text, values in recommendations:
            rig, settings = self.reader.wanted_rig(), self.reader.wanted
            self._recommendation.draw(stamp, text, values, rig, settings)

    # layout

    def layout_state(self, *, has_log: bool) -> layout.TwinLayout:
        """Return the state of the layout."""
        reader = self.reader
        scale = reader.time_scale if self._canvas.throw is None else 1.0
        period = 1.0 if reader.rig is None else 1.0 / (reader.rig.engine.frequency * scale)
        return layout.TwinLayout(
            root=self._root,
            title=self._node,
            period=period,
            side=self._side.bounds,
            residual_limit=_MICRO * reader.settings['measured.residual_threshold'],
            present=self._present | ({layout.LOG} if has_log else set()),
        )


_DRAWERS: Mapping[Topic, Callable[[_TwinView, Any], None]] = {
    TWIN_TOPICS.journal: _TwinView.draw_rig,
    TWIN_TOPICS.joint_states: _TwinView.draw_states,
    **{
        topic: partial(_TwinView.draw_lines, name=name) for topic, name in layout.POSITIONS.items()
    },
    TWIN_TOPICS.layer_joint_states: _TwinView.draw_layer,
    TWIN_TOPICS.phase_change: _TwinView.draw_phases,
    TWIN_TOPICS.throw_result: _TwinView.draw_results,
    TWIN_TOPICS.recommendation: _TwinView.draw_recommendations,
    TWIN_TOPICS.throw_field: _TwinView.draw_field,
    TWIN_TOPICS.throw_energies: _TwinView.draw_energies,
}
"""Methods that draw the content of each topic, as `timeseries.READERS` reads it."""


def _round_up(value: float) -> float:
    """Return a round number that is not less than a positive one."""
    unit = 10.0 ** math.floor(math.log10(value))
    return unit * next(digit for digit in (1.0, 1.5, 2.0, 3.0, 5.0, 10.0) if digit * unit >= value)


def is_drawn(topic: str, type_name: str) -> bool:
    """Return whether anything of such a topic is drawn, be it of a twin or of the whole system."""
    return _identify(topic, type_name)[1] is not None


def _identify(name: str, type_name: str) -> tuple[str, Topic | None]:
    """Return node and topic of a name: no node if of all, no topic if it is not drawn."""
    if type_name == _LOG.type:
        return '', _LOG
    node, topic = series.identify(name, type_name)
    is_drawn = topic in _DRAWERS or topic == TWIN_TOPICS.diagnostics
    return (node, topic) if is_drawn else ('', None)
