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
"""Twins in Rerun: the rig to scale, series, waves in the layer, the best layer, and words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
import math
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.configuration.interface import JOINT_STATE, Topic, TWIN_TOPICS
from soft_throw_ros.recording import rerun_canvas as drawing
from soft_throw_ros.recording import rerun_layout as layout
from soft_throw_ros.recording import rerun_text as words
from soft_throw_ros.recording import timeseries as series
from soft_throw_ros.recording.panels import RecommendationPanel, RigPicture, StrainPicture
from soft_throw_ros.recording.timeseries import Floats, Stamps, ThrowStart
from soft_throw_ros.storage.cdr import decode
from soft_throw_ros.storage.message import Message

_MILLI, _MICRO = 1e3, 1e6

_LOG = Topic('/rosout', 'rcl_interfaces/msg/Log', 'What nodes say')

_LEVELS = ((50, 'CRITICAL'), (40, 'ERROR'), (30, 'WARN'), (20, 'INFO'), (0, 'DEBUG'))
"""Levels of rcl_interfaces/Log and their names in Rerun."""

_MOMENT = 0.7
"""Time of the cursor in a contact, as a fraction of the ejection time."""

Groups = Mapping[Topic, Sequence[Message]]


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
        self._pool = ThreadPoolExecutor(1)  # maps take up to a second, which nothing waits for
        self._twins: dict[str, _TwinView] = {}
        self._has_log = False
        self._arranged: object = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing has come that could be drawn."""
        return not any(twin.is_drawn for twin in self._twins.values())

    @property
    def moment(self) -> float | None:
        """Most interesting time of the shown throw, in time of the rig [s]."""
        times = [twin.ejection_time for twin in self._twins.values() if twin.ejection_time]
        if self._canvas.throw is None:
            return None
        return _MOMENT * times[0] if times else 0.0

    @property
    def span(self) -> tuple[float, float]:
        """From when to when there are states, since the start of the throw that is shown [s]."""
        spans = [twin.span for twin in self._twins.values() if twin.span]
        if not spans or self._canvas.throw is None:
            return -math.inf, math.inf
        begins, ends = zip(*spans, strict=True)
        begin, end = self._canvas.throw.seconds_to(np.array([min(begins), max(ends)]))
        return begin, end

    def connect(self, stream: rr.RecordingStream | None) -> None:
        """Draw into a recording from now on, with all that still holds; or into none."""
        if stream is not None:
            stream.send_recording_name(self._name)
        self._canvas.connect(stream)
        self._arranged = None
        if self._is_live:
            self._arrange()

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
        for node, groups in waiting.items():
            self._read(node, groups)
        for twin in self._twins.values():
            twin.draw_maps()
        if self._is_live:
            self._arrange()

    def finish(self) -> None:
        """Wait for the maps that are not drawn yet, and arrange all panels."""
        for twin in self._twins.values():
            twin.draw_maps(is_waiting=True)
        self._arrange()

    def _read(self, node: str, groups: Groups) -> None:
        """Draw messages of one node, or messages that belong to no node."""
        readers: Mapping[Topic, Callable[..., None]] = {
            _LOG: self._draw_line, TWIN_TOPICS.diagnostics: self._draw_diagnostics
        }
        if node:
            if node not in self._twins:
                self._twins[node] = _TwinView(node, self._canvas, self._pool)
            twin = self._twins[node]
            readers = {topic: partial(read, twin) for topic, read in _READERS.items()}
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
        twins = self._twins.values()
        known = (twin.stamp_of(message) for twin in twins if twin.span is not None)
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

    def _arrange(self) -> None:
        """Send the layout if it has changed."""
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

    def __init__(self, node: str, canvas: drawing.Canvas, pool: ThreadPoolExecutor) -> None:
        self.ejection_time: float | None = None  # of the displayed throw [s]
        self.span: tuple[int, int] | None = None  # stamps of the first and last state [ns]
        # Whether anything was drawn: topics with these names may belong to another machine
        self.is_drawn = False
        self._node = node
        self._root = rr.new_entity_path(node.split('/')) if node.strip('/') else ''
        self._canvas = canvas
        self._reader = series.TwinReader()
        self._period_of_stamps = 1.0  # of the plate, by the clock of the stamps [s]
        self._side = RigPicture(canvas, self._path('side'))
        self._strain = StrainPicture(canvas, self._path('strain'))
        self._recommendation = RecommendationPanel(canvas, self._root, pool)
        self._track: dict[str, str] = {}  # texts by the task of the node
        self._has_residuals = self._has_energies = False
        self._period = 0.0  # of the layout [s]
        self._has_phase_changes = False
        phases = rr.StateConfiguration(
            values=list(layout.PHASES), colors=list(layout.PHASES.values())
        )
        canvas.log_style(self._path('phase'), phases)

    def _path(self, name: str) -> str:
        return f'{self._root}/{name}'

    def _write(self, name: str, stamp: int, text: str) -> None:
        self.is_drawn = True
        self._canvas.log_text(self._path(name), stamp, text)

    def stamp_of(self, message: Message) -> int:
        """Return the time of the step that a message belongs to [ns]."""
        return self._reader.stamp_of(message)

    # the rig

    def read_journal(self, message: Message) -> None:
        """Apply a throw or a rig, and draw the rig."""
        reader = self._reader
        rig, throw = reader.rig, reader.throw
        reader.read_journal(message)
        if reader.rig is None or reader.rig is rig:
            return
        self.is_drawn = True
        is_throw = reader.throw is not None and reader.throw is not throw
        stamp = reader.throw.stamp if reader.throw and is_throw else self.stamp_of(message)
        self._period_of_stamps = 1.0 / (reader.rig.engine.frequency * reader.time_scale)
        self._side.change_rig(stamp, reader.rig)
        self._recommendation.change_rig(stamp, reader.rig, reader.settings)

    # plots

    def _draw_lines(self, name: str, stamps: Stamps, values: Floats) -> None:
        """Draw lines of a plot, of values in SI units."""
        self.is_drawn = True
        names, colours, factor, width = layout.LINES[name]
        widths = np.broadcast_to(width, len(names))
        style = rr.SeriesLines(names=names, colors=colours, widths=widths)
        self._canvas.log_style(self._path(name), style)
        columns = rr.Scalars.columns(scalars=factor * values)
        self._canvas.log_columns(self._path(name), stamps, columns)

    def draw_states(self, messages: Sequence[Message]) -> None:
        states = self._reader.read_states(messages)
        if states is None:
            return
        stamps = states.stamps
        first, last = self.span or (int(stamps[0]), int(stamps[-1]))
        self.span = min(first, int(stamps[0])), max(last, int(stamps[-1]))
        self._draw_lines('position', stamps, states.position)
        self._draw_lines('velocity', stamps, states.velocity)
        self._draw_lines('force', stamps, states.force * [-1.0, 1.0])
        self._side.draw_positions(stamps, states.position)

    def draw_positions(self, messages: Sequence[Message], topic: Topic) -> None:
        positions = self._reader.read_positions(topic, messages)
        if positions is None:
            return
        stamps, position = positions
        self._draw_lines(layout.POSITIONS[topic], stamps, position)
        if topic == TWIN_TOPICS.residual:
            self._has_residuals = True

    # waves in the layer

    def draw_layer(self, messages: Sequence[Message]) -> None:
        layer = self._reader.read_layer(messages)
        if layer is not None:
            self._side.draw_layer(layer)

    def draw_field(self, message: Message) -> None:
        field = self._reader.read_field(message)
        if field is None:
            return
        contact = field.strain[field.times <= (field.ejection_time or field.times[-1])]
        limit = _round_up(max(1.5 * float(np.abs(contact).max()), 1e-6))
        self._side.largest_strain = limit
        self._strain.draw(field, limit)
        throw = self._reader.interpolate_throw(field)
        if throw is not None:
            position, layer = throw
            self._side.draw_positions(field.stamps, position)
            self._side.draw_layer(layer)

    def draw_energies(self, message: Message) -> None:
        energies = self._reader.read_energies(message)
        if energies is None:
            return
        stamps, values = energies
        self._has_energies = True
        stamps = np.append(stamps, stamps[-1] + 1)  # a line ends there, by NaN
        values = np.vstack([values, np.full(values.shape[1], math.nan)])
        self._draw_lines('energy', stamps, values)

    # words

    def draw_phase_changes(self, messages: Sequence[Message]) -> None:
        """Draw phases at the times of their starts."""
        for stamp, phase in self._reader.read_phase_changes(messages):
            self._has_phase_changes = True
            self._draw_phase(stamp, phase)

    def draw_phase(self, message: Message) -> None:
        """Draw a phase at the step of its message, if its start is not recorded."""
        if not self._has_phase_changes:
            self._draw_phase(self.stamp_of(message), str(decode(message).data))

    def _draw_phase(self, stamp: int, phase: str) -> None:
        self.is_drawn = True
        self._canvas.log_latched(self._path('phase'), stamp, rr.StateChange(state=phase))

    def draw_result(self, message: Message) -> None:
        """Write the results of a throw; early results have the stamp of its start."""
        throw, shown = self._reader.throw, self._canvas.throw
        for stamp, _, values in series.read_statuses(message):
            number, time = values.get('throw'), values.get('ejection_time')
            self._reader.note_result(values)
            is_early = values.get('stage') in ('predicted', 'release')
            if throw is not None and is_early and number == throw.number:
                stamp = throw.stamp  # noqa: PLW2901
            self._write('throw_result', stamp, words.throw_text(values))
            if shown is not None and number == shown.number and isinstance(time, float):
                self.ejection_time = time

    def draw_track(self, stamp: int, task: str, status: Any, values: series.Values) -> None:
        """Write the diagnostics of the measured track, one line for each task."""
        if task in words.TRACK_TASKS:
            self._track[task] = words.track_text(task, status, values)
            lines = [self._track[name] for name in words.TRACK_TASKS if name in self._track]
            self._write('track', stamp, '  \n'.join(lines))

    def draw_recommendation(self, message: Message) -> None:
        rig, settings = self._reader.wanted_rig(), self._reader.wanted
        for stamp, status, values in series.read_statuses(message):
            self.is_drawn = True
            self._recommendation.draw(stamp, str(status.message), values, rig, settings)

    def draw_maps(self, *, is_waiting: bool = False) -> None:
        """Draw the maps that are complete; with `is_waiting` wait for all."""
        self._recommendation.draw_maps(is_waiting=is_waiting)

    # layout

    def layout_state(self, *, has_log: bool) -> layout.TwinLayout:
        """Return the state of the layout; sizes that have hardly changed stay the same."""
        throw = self._canvas.throw
        present = {
            'energy': self._has_energies,
            'residual': self._has_residuals,
            'track': self._track,
            layout.LOG: has_log,
        }
        period = self._period_of_stamps * (1.0 if throw is None else throw.time_scale)
        self._period = layout.with_hysteresis(period, self._period)
        return layout.TwinLayout(
            root=self._root,
            title=self._node or '/',
            period=self._period,
            side=self._side.bounds,
            residual_limit=_MICRO * self._reader.settings['measured.residual_threshold'],
            present=frozenset(name for name, is_there in present.items() if is_there),
        )


_READERS: Mapping[Topic, Callable[..., None]] = {
    TWIN_TOPICS.journal: _TwinView.read_journal,
    TWIN_TOPICS.joint_states: _TwinView.draw_states,
    **{topic: partial(_TwinView.draw_positions, topic=topic) for topic in layout.POSITIONS},
    TWIN_TOPICS.layer_joint_states: _TwinView.draw_layer,
    TWIN_TOPICS.phase_change: _TwinView.draw_phase_changes,
    TWIN_TOPICS.phase: _TwinView.draw_phase,
    TWIN_TOPICS.throw_result: _TwinView.draw_result,
    TWIN_TOPICS.recommendation: _TwinView.draw_recommendation,
    TWIN_TOPICS.throw_field: _TwinView.draw_field,
    TWIN_TOPICS.throw_energies: _TwinView.draw_energies,
}
"""Methods that draw the messages of each topic; later methods need the data of earlier ones."""


def _round_up(value: float) -> float:
    """Return a round number that is not less than a positive one."""
    unit = 10.0 ** math.floor(math.log10(value))
    return unit * next(digit for digit in (1.0, 1.5, 2.0, 3.0, 5.0, 10.0) if digit * unit >= value)


def is_shown(topic: str, type_name: str) -> bool:
    """Return whether a topic is one of a twin that is drawn."""
    return _identify(topic, type_name)[1] in _READERS


def is_drawn(topic: str, type_name: str) -> bool:
    """Return whether anything of such a topic is drawn, be it of a twin or of the whole system."""
    return _identify(topic, type_name)[1] is not None


def _identify(name: str, type_name: str) -> tuple[str, Topic | None]:
    """Return node and topic of a name: no node if of all, no topic if it is not drawn."""
    if type_name == _LOG.type:
        return '', _LOG
    node, topic = series.identify(name, type_name)
    is_drawn = topic in _READERS or topic == TWIN_TOPICS.diagnostics
    return (node, topic) if is_drawn else ('', None)
