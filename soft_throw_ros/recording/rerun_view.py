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
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
import math
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.configuration import Settings
from soft_throw_ros.configuration.interface import FORMER_TOPICS, JOINT_STATE, Topic, TWIN_TOPICS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording import rerun_canvas as drawing
from soft_throw_ros.recording import rerun_layout as layout
from soft_throw_ros.recording import rerun_text as words
from soft_throw_ros.recording import timeseries as series
from soft_throw_ros.recording.energy_map import compute_energy_map, EnergyMap
from soft_throw_ros.recording.message import Message
from soft_throw_ros.recording.rig_picture import RigPicture
from soft_throw_ros.recording.timeseries import Floats, LayerStates, SECOND, Stamps, ThrowStart

_MILLI, _MICRO = 1e3, 1e6

_LOG = Topic('/rosout', 'rcl_interfaces/msg/Log', 'What nodes say')

_LEVELS = ((50, 'CRITICAL'), (40, 'ERROR'), (30, 'WARN'), (20, 'INFO'), (0, 'DEBUG'))
"""Levels of rcl_interfaces/Log, and what Rerun calls them."""

_MOMENT = 0.7
"""When in a contact there is most to see, as part of the ejection time."""

_DENSE = 10.0
"""Rows of the layer per period of the plate from which on a line through them is true."""

_RESIDUAL_QUANTILE = 0.9
"""Part of the residuals in a contact that is surely within their plot, unlike spikes."""

_LEAST_RESIDUAL, _DEFAULT_RESIDUAL = 10.0, 100.0  # um

_KEPT_RESIDUALS = 200

Groups = Mapping[Topic, Sequence[Message]]


class Scene:
    """
    What is known of the twins, and how it is drawn.

    Parameters
    ----------
    name : str
        Of the recording, for the viewer.
    is_live : bool
        Whether the latest is shown, or a throw.
    is_picture : bool
        Whether what is for the mouse is left out.
    throw : ThrowStart, optional
        The throw that is shown, from whose start times are counted.

    Attributes
    ----------
    damaged : int
        Messages that could not be read.
    damage : str
        Why the first of them could not.

    """

    def __init__(
        self,
        name: str,
        *,
        is_live: bool = False,
        is_picture: bool = False,
        throw: ThrowStart | None = None,
    ) -> None:
        self.damaged = 0
        self.damage = ''
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
        """When in the throw that is shown there is most to see, in time of the rig [s]."""
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
        """Draw into a recording from now on, with what is there already; or into none."""
        if stream is not None:
            stream.send_recording_name(self._name)
        self._canvas.connect(stream)
        self._arranged = None
        if self._is_live:
            self._arrange()

    def show(self, messages: Iterable[Message]) -> None:
        """Draw messages, those of each topic at once, in an order in which each has its needs."""
        waiting: dict[str, dict[Topic, list[Message]]] = {}
        for message in messages:
            node, topic = _identify(message.channel.topic, message.channel.type)
            if topic is None:
                continue
            if topic == TWIN_TOPICS.journal:  # what came before it is of the rig as it was
                self._read(node, waiting.pop(node, {}))
            waiting.setdefault(node, {}).setdefault(topic, []).append(message)
        for node, groups in waiting.items():
            self._read(node, groups)
        for twin in self._twins.values():
            twin.draw_maps()
        if self._is_live:
            self._arrange()

    def finish(self, *, is_waiting: bool) -> None:
        """Draw what is still being computed, if it is waited for, and arrange everything."""
        for twin in self._twins.values():
            twin.draw_maps(is_waiting=is_waiting)
        self._arrange()

    def _read(self, node: str, groups: Groups) -> None:
        """Draw messages of one node, or of all."""
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
        """Read a message, or several, one by one if one is damaged, or unlike the others."""
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
        """Show a line of the log, which is stamped by another clock where time is simulated."""
        line = series.read_message(message)
        twins = self._twins.values()
        known = (twin.stamp_of(message) for twin in twins if twin.span is not None)
        stamp = next(known, series.to_ns(line.stamp))
        level = next(name for bound, name in _LEVELS if line.level >= bound)
        self._has_log = True
        columns = rr.TextLog.columns(text=[f'{line.name}: {line.msg}'], level=[level])
        self._canvas.send(layout.LOG, np.array([stamp]), columns)

    def _draw_diagnostics(self, message: Message) -> None:
        """Show what is of a measured track: of a twin itself, or of one beside its calibrator."""
        for stamp, status, values in series.read_statuses(message):
            node, _, task = str(status.name).rpartition(': ')
            for name, twin in self._twins.items():
                is_beside = name.rpartition('/')[0] == node.rpartition('/')[0]
                if name == node or (is_beside and task == 'identification'):
                    twin.draw_track(stamp, task, status, values)

    def _arrange(self) -> None:
        """Send the layout if there is none yet, or it has to be another."""
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
    """
    One of the twins: reads its messages and draws what they say.

    Attributes
    ----------
    ejection_time : float or None
        In the throw that is shown. [s]
    span : tuple of int or None
        Stamps of the first and the last state. [ns]
    is_drawn : bool
        Whether there is anything of it; topics of its names may be of another machine.

    """

    def __init__(self, node: str, canvas: drawing.Canvas, pool: ThreadPoolExecutor) -> None:
        self.ejection_time: float | None = None
        self.span: tuple[int, int] | None = None
        self.is_drawn = False
        self._node = node
        self._root = rr.new_entity_path(node.split('/')) if node.strip('/') else ''
        self._canvas = canvas
        self._pool = pool
        self._reader = series.TwinReader()
        self._period_of_stamps = 1.0  # of the plate, by the clock of the stamps [s]
        self._side = RigPicture(canvas, self._path('side'))
        self._recommendation: tuple[Rig | None, series.Values] = (
            None,
            {},
        )  # and for which rig it is
        self._is_former = False  # whether the energy of its layer is not recorded
        self._track: dict[str, str] = {}  # what is said of it, by the task of the node
        self._residuals: Floats | None = None  # in the last contacts, or in that which is shown
        self._period = self._residual_limit = 0.0  # of the layout [s], [um]
        self._extents: dict[str, tuple[float, float]] = {}  # of plots, in the throw that is shown
        self._maps: list[tuple[int, Future[EnergyMap]]] = []
        self._map_rig: Rig | None = None
        phases = rr.StateConfiguration(
            values=list(layout.PHASES), colors=list(layout.PHASES.values())
        )
        smooth = rr.Image.from_fields(magnification_filter='linear')
        canvas.style(self._path('phase'), phases)
        canvas.style(self._path('strain/picture'), smooth)
        canvas.style(self._path('margin'), rr.TextDocument(' '))

    def _path(self, name: str) -> str:
        return f'{self._root}/{name}'

    def _write(self, name: str, stamp: int, text: str) -> None:
        self.is_drawn = True
        document = rr.TextDocument(text, media_type='text/markdown')
        self._canvas.put(self._path(name), stamp, document)

    def stamp_of(self, message: Message) -> int:
        """Return the time of the step with which something was published [ns]."""
        return self._reader.stamp_of(message)

    # the rig

    def read_journal(self, message: Message) -> None:
        """Take over a throw or a rig, and draw the latter."""
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
        if self._map_rig != reader.rig:  # the map of what is recommended for it is there
            self._request_map(stamp, reader.rig, reader.settings)

    # plots

    def _draw_lines(self, name: str, stamps: Stamps, values: Floats) -> None:
        """Draw lines of a plot, of values in SI units."""
        self.is_drawn = True
        names, colours, factor, width = layout.LINES[name]
        style = rr.SeriesLines(names=names, colors=colours, widths=[width] * len(names))
        self._canvas.style(self._path(name), style)
        self._canvas.send(self._path(name), stamps, rr.Scalars.columns(scalars=factor * values))
        throw = self._canvas.throw
        if throw is not None:
            periods = (stamps - throw.stamp) / (SECOND * self._period_of_stamps)
            shown = (periods > 0.3 - layout.BEFORE) & (periods < 0.3 + layout.AFTER)
            known, plot = factor * values[shown], name.partition('/')[0]
            known = known[np.isfinite(known)]
            if known.size:
                low, high = self._extents.get(plot, (math.inf, -math.inf))
                self._extents[plot] = min(low, float(known.min())), max(high, float(known.max()))

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
        self._draw_lines('energy/plate_work', stamps, states.plate_work)
        self._draw_lines('energy/projectile', stamps, states.projectile_energy)
        self._side.draw_positions(stamps, states.position)

    def draw_positions(self, messages: Sequence[Message], topic: Topic) -> None:
        found = self._reader.read_positions(topic, messages)
        if found is None:
            return
        stamps, position = found
        self._draw_lines(layout.POSITIONS[topic], stamps, position)
        if topic == TWIN_TOPICS.residual:
            self._keep_residuals(stamps, np.abs(position))

    def _keep_residuals(self, stamps: Stamps, values: Floats) -> None:
        """Keep those of a contact; in flight and after a landing they have no bounds."""
        before = np.zeros(0) if self._residuals is None else self._residuals
        self._residuals = before
        shown, throw = self._canvas.throw, self._reader.throw
        if throw is not None and (shown is None or shown.stamp == throw.stamp):
            since = (stamps - throw.stamp) / SECOND
            values = values[(since >= 0.0) & (since < self._period_of_stamps)]
            known = values[np.isfinite(values)]
            self._residuals = np.concatenate([before, known])[-_KEPT_RESIDUALS:]

    # waves in the layer

    def draw_layer(self, messages: Sequence[Message]) -> None:
        layer = self._reader.read_layer(messages)
        if layer is not None:
            self._side.draw_layer(layer)
            if self._is_dense():
                self._draw_layer_energy(layer)

    def draw_former_layer(self, message: Message) -> None:
        layer = self._reader.read_former_strain(message)
        self._is_former = True
        if layer is not None:
            self._side.draw_layer(layer)

    def _is_dense(self) -> bool:
        """Tell whether the layer comes so often that a line through its energies is true."""
        rows = self._reader.settings['rate.field'] * self._period_of_stamps
        return bool(rows >= _DENSE and not self._is_former)

    def _draw_layer_energy(self, layer: LayerStates) -> None:
        for name, energy in (('layer', layer.energy), ('total', layer.total_energy)):
            stamps, values = layer.stamps, energy
            if not self._is_dense():  # the line must not go on to the next throw
                stamps, values = np.append(stamps, stamps[-1] + 1), np.append(values, math.nan)
            self._draw_lines(f'energy/{name}', stamps, values)

    def draw_field(self, message: Message) -> None:
        field = self._reader.read_field(message)
        if field is None:
            return
        time, stamps, start = field.ejection_time, field.stamps, int(field.stamps[0])
        contact = field.strain[field.times <= (time or field.times[-1])]
        limit = drawing.round_up(max(1.5 * float(np.abs(contact).max()), 1e-6))
        self._side.largest_strain = limit
        chart = drawing.Chart(
            canvas=self._canvas,
            path=self._path('strain'),
            stamp=start,
            height=layout.STRAIN_HEIGHT,
            x=drawing.Axis(0.0, _MILLI * float(field.times[-1])),
            y=drawing.Axis(0.0, _MILLI * field.thickness),
        )
        pixels = drawing.colours_of(field.strain.T[::-1], -limit, limit, drawing.SIGNED)
        chart.draw(pixels, titles=('t (ms)', 'y (mm)'))
        chart.draw_bar(drawing.Axis(-100.0 * limit, 100.0 * limit), drawing.SIGNED, title='ε (%)')
        at = None if time is None else _MILLI * time
        chart.draw_line('ejection', at, '' if at is None else f'tₑ {at:.2f} ms')
        strips = np.zeros((stamps.size, 2, 2), np.float32)
        strips[:, :, 0] = np.linspace(0.0, drawing.WIDTH, stamps.size)[:, None]
        strips[:, 1, 1] = layout.STRAIN_HEIGHT
        gone = np.append(stamps, 2 * stamps[-1] - stamps[-2])
        columns = rr.LineStrips2D.columns(
            strips=strips,
            colors=[drawing.RED] * stamps.size,
            radii=rr.Radius.ui_points([1.0] * stamps.size),
        ).partition([1] * stamps.size + [0])
        self._canvas.send(self._path('strain/now'), gone, columns)
        throw = self._reader.see_throw(field)
        if throw is not None:
            position, layer = throw
            self._side.draw_positions(stamps, position)
            self._side.draw_layer(layer)
            self._draw_layer_energy(layer)

    # words

    def draw_phase(self, message: Message) -> None:
        self.is_drawn = True
        state = rr.StateChange(state=series.read_text(message))
        self._canvas.put(self._path('phase'), self.stamp_of(message), state)

    def draw_result(self, message: Message) -> None:
        """Write what a throw gave; up to the release at its start, as the field has it."""
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
        """Write what diagnostics say of the measured track, that of each task with its stamp."""
        if task in words.TRACK_TASKS:
            self._track[task] = words.track_text(task, status, values)
            parts = [self._track[each] for each in words.TRACK_TASKS if each in self._track]
            self._write('track', stamp, '  \n'.join(parts))

    # the best layer

    def draw_recommendation(self, message: Message) -> None:
        reader = self._reader
        rig = reader.wanted_rig()
        for stamp, status, values in series.read_statuses(message):
            self._recommendation = rig, values
            text = words.recommendation_text(str(status.message), values)
            self._write('recommendation', stamp, text)
            if rig is not None:
                self._request_map(stamp, rig, reader.wanted)

    def _request_map(self, stamp: int, rig: Rig, settings: Settings) -> None:
        """Have a map computed; what was asked for last is shown last."""
        recommended_for, values = self._recommendation
        if recommended_for not in (None, rig):
            values = {}
            self._write('recommendation', stamp, words.UNKNOWN_BEST)  # it was of another rig
        self._map_rig = rig
        stamp = max([stamp, *(earlier for earlier, _ in self._maps)])
        self._maps.append((stamp, self._pool.submit(compute_energy_map, rig, settings, values)))

    def draw_maps(self, *, is_waiting: bool = False) -> None:
        """Draw the maps that are there by now, or, waiting for them, all."""
        while self._maps and (is_waiting or self._maps[0][1].done()):
            stamp, future = self._maps.pop(0)
            found = future.result()
            axes = (
                drawing.MapAxis('Lₛ (mm)', _MILLI * found.thickness),
                drawing.MapAxis('cₛ (m/s)', found.wave_speed),
            )
            marks = [(_MILLI * length, speed, text) for length, speed, text in found.marks]
            panel = drawing.MapPanel('landscape', '', found.title, found.energy_transfer)
            drawing.draw_map(self._canvas, stamp, axes, panel, marks, root=self._root)

    # layout

    def layout_state(self, *, has_log: bool) -> layout.TwinLayout:
        """Return what the layout depends on; what is much as it was stays as it was."""
        throw, residuals = self._canvas.throw, self._residuals
        limit = 0.0
        if residuals is not None:
            most = _DEFAULT_RESIDUAL
            if residuals.size:
                most = 1.5 * _MICRO * float(np.quantile(residuals, _RESIDUAL_QUANTILE))
            limit = drawing.round_up(max(most, _LEAST_RESIDUAL), (1.0, 2.0, 5.0, 10.0))
            limit = self._residual_limit = layout.settled(limit, self._residual_limit, 0.3, 1.0)
        present = {'residual': residuals is not None, 'track': self._track, layout.LOG: has_log}
        period = self._period_of_stamps * (1.0 if throw is None else throw.time_scale)
        self._period = layout.settled(period, self._period)
        return layout.TwinLayout(
            root=self._root,
            title=self._node or '/',
            period=self._period,
            side=self._side.bounds,
            residual_limit=limit,
            present=frozenset(name for name, is_there in present.items() if is_there),
            extents=self._extents,
        )


_READERS: Mapping[Topic, Callable[..., None]] = {
    TWIN_TOPICS.journal: _TwinView.read_journal,
    TWIN_TOPICS.joint_states: _TwinView.draw_states,
    **{topic: partial(_TwinView.draw_positions, topic=topic) for topic in layout.POSITIONS},
    TWIN_TOPICS.layer_joint_states: _TwinView.draw_layer,
    FORMER_TOPICS.strain: _TwinView.draw_former_layer,
    TWIN_TOPICS.phase: _TwinView.draw_phase,
    TWIN_TOPICS.throw_result: _TwinView.draw_result,
    TWIN_TOPICS.recommendation: _TwinView.draw_recommendation,
    TWIN_TOPICS.throw_field: _TwinView.draw_field,
}
"""What draws the messages of a topic, in an order in which one needs those before it."""


def is_shown(topic: str, type_name: str) -> bool:
    """Tell whether such a topic is one of a twin that is drawn."""
    return _identify(topic, type_name)[1] in _READERS


def _identify(name: str, type_name: str) -> tuple[str, Topic | None]:
    """Find of which node a topic is, empty if of several, and which; None if it is not drawn."""
    if type_name == _LOG.type:
        return '', _LOG
    node, topic = series.identify(name, type_name)
    is_drawn = topic in _READERS or topic == TWIN_TOPICS.diagnostics
    return (node, topic) if is_drawn else ('', None)
