# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Twins in Rerun: the rig to scale, series, waves in the layer, the best layer, and texts.

All times are stamps; a message without one gets that of the state published right before it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import groupby
import math
from operator import itemgetter
from typing import Any

import numpy as np
import rerun as rr
from soft_throw_ros.configuration.interface import FIELD_POINTS, find_topic, Topic, TWIN_TOPICS
from soft_throw_ros.configuration.table import float_of
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording import charts
from soft_throw_ros.recording import rerun_layout as layout
from soft_throw_ros.recording import rerun_text as words
from soft_throw_ros.recording.rerun_layout import BLUE, GREY, RED, WHITE
from soft_throw_ros.recording.twin_journal import DECODING_ERRORS, Stamps, ThrowStart, TwinJournal
from soft_throw_ros.storage import cdr
from soft_throw_ros.storage.message import Channel, Message, SECOND
from soft_throw_ros.twin.results import Floats, Phase

_MILLI = 1e3
_PHASES = dict(enumerate(phase.value for phase in Phase))

_LOG = Topic('/rosout', 'rcl_interfaces/msg/Log', 'What nodes say')

_STEP_BACK = 1_000_000_000
"""Stamps that go back further begin another repetition; smaller steps correct a clock. [ns]"""


@dataclass(kw_only=True)
class _Canvas:
    """A tree of entities; without a `throw`, the origin of `THROW_TIME`, it has only `STAMP`."""

    stream: rr.RecordingStream
    root: str
    throw: ThrowStart | None
    is_live: bool
    delay: int = 0  # which is added to all stamps [ns]
    is_drawn: bool = False  # topics with these names may belong to another machine

    def style(self, name: str, style: rr.AsComponents) -> None:
        """Set the style of an entity, for all times."""
        self.stream.log(f'{self.root}/{name}', style, static=True)

    def draw(self, name: str, stamp: int, *content: rr.AsComponents, stays: bool = False) -> None:
        """Draw until other content comes; what `stays` in a live view reaches late viewers."""
        self.is_drawn = True
        stamp += self.delay
        self.stream.set_time(layout.STAMP, timestamp=np.datetime64(stamp, 'ns'))
        if self.throw is not None:
            self.stream.set_time(layout.THROW_TIME, duration=self.throw.seconds_to(stamp))
        self.stream.log(f'{self.root}/{name}', *content, static=stays and self.is_live)

    def columns(self, name: str, stamps: Stamps, columns: Iterable[rr.ComponentColumn]) -> None:
        """Draw rows of a quantity that changes with every step."""
        self.is_drawn = True
        stamps = stamps + self.delay
        indexes = [rr.TimeColumn(layout.STAMP, timestamp=stamps.astype('datetime64[ns]'))]
        if self.throw is not None:
            seconds = self.throw.seconds_to(stamps)
            indexes.append(rr.TimeColumn(layout.THROW_TIME, duration=seconds))
        self.stream.send_columns(f'{self.root}/{name}', indexes, columns)


class Scene:
    """The drawing of all twins: live, or with times that count from the start of `throw`."""

    def __init__(
        self, stream: rr.RecordingStream, *, is_live: bool = False, throw: ThrowStart | None = None
    ) -> None:
        self.damaged = 0  # number of messages that could not be read
        self.damage = ''  # the error of the first of them
        self._stream = stream
        self._is_live = is_live
        self._new_canvas = partial(_Canvas, stream=stream, throw=throw, is_live=is_live)
        self._canvas = self._new_canvas(root='')
        self._twins: dict[str, _TwinView] = {}
        self._arranged: list[layout.TwinLayout] = []

    def show(self, messages: Iterable[Message]) -> None:
        """Draw messages topic by topic, in an order that respects their dependencies."""
        waiting: dict[str, dict[Topic, list[Message]]] = defaultdict(lambda: defaultdict(list))
        for channel, run in groupby(filter(TwinJournal.reads, messages), itemgetter(0)):
            node, topic = _drawn_topic(channel.topic, channel.type)
            if topic is None:
                continue
            is_state = topic == TWIN_TOPICS.joint_states
            delay_of = self._twin(node).delay_of if is_state else lambda _: 0
            for delay, batch in groupby(run, delay_of):
                is_repetition = is_state and delay > self._twin(node).canvas.delay
                # Earlier messages belong to the former rig, or to the former repetition
                if is_repetition or topic == TWIN_TOPICS.journal:
                    self._draw(node, waiting.pop(node, {}))
                if is_repetition:
                    self._twin(node).canvas.delay = delay
                waiting[node][topic].extend(batch)
        for node, groups in sorted(waiting.items(), reverse=True):  # lines of the log come last
            self._draw(node, groups)
        if self._is_live:
            self.arrange()

    def arrange(self) -> None:
        """Send the layout if it has changed, as every call of `show` does in a live view."""
        log, views = {layout.LOG} if self._canvas.is_drawn else set(), self.drawn_twins()
        twins = [replace(v.layout, present=v.layout.present | log) for v in views]
        if twins != self._arranged:
            self._arranged = twins
            timeline = layout.STAMP if self._canvas.throw is None else layout.THROW_TIME
            self._stream.send_blueprint(layout.arrange(twins, timeline, is_live=self._is_live))

    def _twin(self, node: str) -> _TwinView:
        if node not in self._twins:
            root = rr.new_entity_path(node.split('/'))
            self._twins[node] = _TwinView(node, self._new_canvas(root=root))
        return self._twins[node]

    def drawn_twins(self) -> list[_TwinView]:
        """Return the twins of which anything could be drawn."""
        return [twin for twin in self._twins.values() if twin.canvas.is_drawn]

    def _draw(self, node: str, groups: Mapping[Topic, Sequence[Message]]) -> None:
        """Draw messages of one node, or messages that belong to no node."""
        drawer = self._twin(node) if node else self
        for topic in [topic for topic in _DRAWERS if topic in groups]:
            messages = groups[topic]
            batches = [messages] if topic.joints else [[item] for item in messages]
            for batch in batches:
                self._attempt(partial(_DRAWERS[topic], drawer), batch)

    def _attempt(self, draw: Callable[..., None], messages: Sequence[Message]) -> None:
        """Draw messages at once, or individually if one is damaged or different."""
        try:
            draw(*messages)
        except DECODING_ERRORS as error:
            if len(messages) > 1:
                for message in messages:
                    self._attempt(draw, [message])
            else:
                self.damaged += 1
                self.damage = self.damage or f'{messages[0].channel.topic}: {error!r:.200}'

    def draw_line(self, message: Message) -> None:
        """Show a line of the log at the time of the twin, whose clock may be another one."""
        line = cdr.decode(message)
        stamp = _to_ns(line.stamp)
        for twin in self.drawn_twins()[:1]:
            stamp = twin.stamp_of(message) + twin.canvas.delay
        level = rr.LoggingHandler.LVL2NAME.get(line.level)
        self._canvas.draw(layout.LOG, stamp, rr.TextLog(f'{line.name}: {line.msg}', level=level))


class _TwinView:
    """The drawing of one twin, and what it needs to know of earlier messages."""

    def __init__(self, node: str, canvas: _Canvas) -> None:
        self.canvas = canvas
        self._journal = TwinJournal()
        self._readers: dict[Channel, cdr.JointStateReader] = defaultdict(cdr.JointStateReader)
        self._newest = self._last = 0  # stamps of the last states received, and drawn [ns]
        self._delay = 0  # by which stamps have gone back so far [ns]
        self._offset = 0  # from the time of publishing to the stamp [ns]
        self.layout = layout.TwinLayout(canvas.root, node)
        self._layer_at_rest: tuple[rr.AsComponents, ...] = ()
        phases, colours = zip(*layout.PHASES.items(), strict=True)
        canvas.style('phase', rr.StateConfiguration(values=phases, colors=colours))
        for name, line in layout.LINES.items():
            widths = np.broadcast_to(line.widths, len(line.names))
            lines = rr.SeriesLines(names=line.names, colors=line.colours, widths=widths)
            canvas.style(name, lines)
        cursor = rr.LineStrips2D.from_fields(colors=[RED], radii=rr.Radius.ui_points(1.0))
        canvas.style('strain/now', cursor)

    def delay_of(self, state: Message) -> int:
        """Return the delay by which a repetition, whose stamps go back, is drawn last [ns]."""
        last, self._newest = self._newest, cdr.stamp_of(state.data) or self._newest
        if last > self._newest + _STEP_BACK:
            self._delay += last - self._newest
        return self._delay

    def stamp_of(self, message: Message) -> int:
        """Return the stamp of a message without one [ns]."""
        return message.published + self._offset

    def _read_joints(self, messages: Sequence[Message]) -> cdr.JointStates:
        return self._readers[messages[0].channel].read_all([item.data for item in messages])

    # plots

    def draw_joints(self, *messages: Message, topic: Topic) -> None:
        """Draw the lines of a topic, relative to rest if measured; states move the bodies."""
        joints, twin = self._read_joints(messages), self._journal
        names = [twin.settings[f'joint_names.{joint}'] for joint in topic.joints]
        values = {name: getattr(joints, name) for name in topic.quantities}
        counts = {array.shape[1] for array in values.values()}
        if names[0] not in joints.names or counts != {len(joints.names)}:
            return  # of another machine
        column = [joints.names.index(name) if name in joints.names else -1 for name in names]
        for name, array in values.items():
            values[name] = np.where(np.array(column) < 0, math.nan, array[:, column])
        stamps = joints.stamps
        if topic == TWIN_TOPICS.measured_joint_states:
            if twin.rest_heights is None or twin.rig is None:
                return
            values['position'] -= np.array(twin.rest_heights) - [0.0, twin.rig.rest_height]
            stamps = stamps + twin.clock_offset_ns
        for name, line in layout.LINES.items():
            if line.topic == topic:
                self._draw_lines(name, stamps, values[line.quantity])
        if topic == TWIN_TOPICS.joint_states:
            self._last = int(stamps[-1])
            self._offset = self._last - messages[-1].published
            translation = np.zeros((stamps.size, 3))
            for name, height in zip(topic.joints, values['position'].T, strict=True):
                translation[:, 1] = -_MILLI * height
                columns = rr.Transform3D.columns(translation=translation)
                self.canvas.columns(f'side/{name}', stamps, columns)

    def draw_energies(self, message: Message) -> None:
        """Draw the energies of the throw under way."""
        (rows,), throw = _read_cloud(message, TWIN_TOPICS.throw_energies), self._journal.throw
        if throw is not None:
            stamps = throw.stamps_at(rows[:, 0])
            stamps = np.append(stamps, stamps[-1] + 1)  # a line ends there, by NaN
            values = np.pad(rows[:, 1:], ((0, 1), (0, 0)), constant_values=math.nan)
            self._draw_lines('energy', stamps, values)

    def draw_phases(self, *messages: Message) -> None:
        """Draw phases at the times of their starts."""
        joints = self._read_joints(messages)
        if joints.names == TWIN_TOPICS.phase_change.joints:
            states = [_PHASES[number] for (number,) in joints.position.tolist()]
            self.canvas.columns('phase', joints.stamps, rr.StateChange.columns(state=states))

    def _draw_lines(self, name: str, stamps: Stamps, values: Floats) -> None:
        """Draw lines of a plot, of values in SI units."""
        columns = rr.Scalars.columns(scalars=values * layout.LINES[name].factors)
        self.canvas.columns(name, stamps, columns)
        self.layout.present |= {name}

    # the rig to scale: in mm, downwards as Rerun has it

    def draw_journal(self, message: Message) -> None:
        """Apply a line of the journal; draw the rig if it is another one."""
        rig = self._journal.rig
        self._journal.read(message)
        if self._journal.rig is not None and self._journal.rig is not rig:
            self._draw_rig(self.stamp_of(message), self._journal.rig)

    def _draw_rig(self, stamp: int, rig: Rig) -> None:
        """Draw the bodies of a rig with their names, which follow plate and projectile."""
        self.layout.diameter = diameter = _MILLI * rig.layer.diameter
        length, thickness = _MILLI * rig.projectile.length, _MILLI * rig.layer.thickness
        self.layout.height = 1.35 * (thickness + length) + 0.8 * diameter
        scale = self._journal.time_scale if self.canvas.throw is None else 1.0
        self.layout.period = 1.0 / (rig.engine.frequency * scale)
        grey, blue = (np.full((1, 1, 3), colour, np.uint8) for colour in (GREY, BLUE))
        for name, content in {
            'plate/body': _picture(grey, -0.75 * diameter, 0.0, 1.5 * diameter, 0.15 * diameter),
            'projectile/body': _picture(blue, -0.5 * diameter, -length, diameter, length),
            'plate/text': _texts((diameter, 0.0, 'plate'), (diameter, -0.5 * thickness, 'layer')),
            'projectile/text': _texts((diameter, -0.5 * length, 'projectile')),
        }.items():
            self.canvas.draw(f'side/{name}', stamp, *content, stays=True)
        rest, white = _MILLI * rig.rest_height, np.full((FIELD_POINTS, 1, 3), WHITE, np.uint8)
        self._layer_at_rest = _picture(white, -0.5 * diameter, -rest, diameter, rest)
        self.canvas.draw('side/plate/layer', stamp, *self._layer_at_rest)

    def draw_field(self, message: Message) -> None:
        """Draw the strain of the throw under way over time and height, and in the layer."""
        points, throw = _read_cloud(message, TWIN_TOPICS.throw_field), self._journal.throw
        if throw is None:
            return
        times, heights, strain = points[:, 0, 0], points[0, :, 1], points[..., 2]
        ejection_time, end = throw.ejection_time or math.inf, times[-1]
        limit = max(float(np.abs(strain[times <= ejection_time]).max()), 1e-6)
        stamps, width = throw.stamps_at(times), layout.STRAIN_WIDTH
        pixels = charts.signed_colours(strain.T[::-1], limit)
        pixels[:, times.searchsorted(ejection_time):][:, :1] = 0  # a black line
        scale = charts.signed_colours(np.linspace(limit, -limit, FIELD_POINTS)[:, None], limit)
        marks = [
            (-0.1, 1.02, '0'), (width - 0.3, 1.02, f't {_MILLI * end:.3g} ms'),
            (-0.35, 0.0, f'y {_MILLI * heights[-1]:.3g} mm'),
            (width + 0.55, 0.0, f'ε {100.0 * limit:+.3g} %'),
            (width + 0.55, 0.7, f'{-100.0 * limit:+.3g} %'),
        ]
        if ejection_time < end:
            place = width * ejection_time / end
            marks.append((place, -0.3, f'tₑ {_MILLI * ejection_time:.2f} ms'))
        start = int(stamps[0])
        self.canvas.draw('strain/picture', start, *_picture(pixels, 0.0, 0.0, width, 1.0))
        self.canvas.draw('strain/scale', start, *_picture(scale, width + 0.1, 0.0, 0.1, 1.0))
        self.canvas.draw('strain/text', start, *_texts(*marks))
        cursors = np.zeros((stamps.size, 2, 2), np.float32)
        cursors[:, :, 0] = (width * times / end)[:, None]
        cursors[:, 1, 1] = 1.0
        strips = rr.LineStrips2D.columns(strips=cursors).partition([1] * stamps.size + [0])
        after = int(2 * stamps[-1] - stamps[-2])  # when the cursor disappears
        self.canvas.columns('strain/now', np.append(stamps, after), strips)
        length = _MILLI * np.trapezoid(1.0 + strain, heights, axis=1)
        corners, scales = np.zeros((length.size, 3)), np.ones((length.size, 3))
        corners[:, 0], corners[:, 1] = -0.5 * self.layout.diameter, -length
        scales[:, 0], scales[:, 1] = self.layout.diameter, length / FIELD_POINTS
        rows = charts.signed_colours(strain[:, ::-1], limit)
        columns = [
            *rr.Image.columns(buffer=[row.tobytes() for row in rows]),
            *rr.Transform3D.columns(translation=corners, scale=scales),
        ]
        self.canvas.columns('side/plate/layer', stamps, columns)
        self.canvas.draw('side/plate/layer', after, *self._layer_at_rest)

    # texts and the map

    def draw_result(self, message: Message) -> None:
        """Write the results of a throw; early ones from its start on."""
        throw = self._journal.throw
        for stamp, _, values in _read_statuses(message):
            is_early = values.get('stage') in ('predicted', 'release')
            if throw is not None and is_early and values.get('throw') == throw.number:
                stamp = throw.stamp  # noqa: PLW2901
            self._write('throw_result', stamp, words.throw_text(values))

    def draw_recommendation(self, message: Message) -> None:
        """Write the table of a recommendation, and draw the map of its rig."""
        stamp = max(self.stamp_of(message), self._last)
        for _, status, values in _read_statuses(message):
            text = words.recommendation_text(status.message, values)
            self._write('recommendation', stamp, text, stays=True)
            figure = charts.draw_energy_map(values, self._journal.settings)
            image = rr.EncodedImage(contents=charts.to_png(figure), media_type='image/png')
            self.canvas.draw('landscape', stamp, image, stays=True)

    def _write(self, name: str, stamp: int, text: str, *, stays: bool = False) -> None:
        document = rr.TextDocument(text, media_type='text/markdown')
        self.canvas.draw(name, stamp, document, stays=stays)


_DRAWERS: Mapping[Topic, Callable[..., None]] = {
    _LOG: Scene.draw_line,
    TWIN_TOPICS.journal: _TwinView.draw_journal,
    **{
        line.topic: partial(_TwinView.draw_joints, topic=line.topic)
        for line in layout.LINES.values() if line.quantity
    },
    TWIN_TOPICS.phase_change: _TwinView.draw_phases,
    TWIN_TOPICS.throw_result: _TwinView.draw_result,
    TWIN_TOPICS.recommendation: _TwinView.draw_recommendation,
    TWIN_TOPICS.throw_field: _TwinView.draw_field,
    TWIN_TOPICS.throw_energies: _TwinView.draw_energies,
}
"""Methods that draw a message, or several ones of joints, and need the data of earlier methods."""


def is_drawn(topic: str, type_name: str) -> bool:
    """Return whether anything of such a topic is drawn, be it of a twin or of the whole system."""
    return _drawn_topic(topic, type_name)[1] is not None


@cache
def _drawn_topic(name: str, type_name: str) -> tuple[str, Topic | None]:
    """Return node and topic of a name: no node if of all, no topic if it is not drawn."""
    if type_name == _LOG.type:
        return '', _LOG
    node, topic = find_topic(name, type_name) or ('', None)
    return (node, topic) if topic in _DRAWERS else ('', None)


def _read_cloud(message: Message, topic: Topic) -> Floats:
    """Read the points of a cloud with the fields of a topic, shape (rows, columns, fields)."""
    cloud, count = cdr.decode(message), len(topic.axes)
    names = tuple(field.name for field in cloud.fields)
    shape = cloud.height, cloud.width, count
    if names != topic.axes or len(cloud.data) != 8 * math.prod(shape) or min(shape) < 1:
        raise cdr.MessageError(f'a cloud of {", ".join(topic.axes)}, got {", ".join(names)}')
    return np.frombuffer(bytes(cloud.data), '<f8').reshape(shape)


def _read_statuses(message: Message) -> Iterator[tuple[int, Any, words.Values]]:
    """Yield stamp, status and its named values, for each status of a DiagnosticArray."""
    array = cdr.decode(message)
    for status in array.status:
        texts = {str(item.key): str(item.value) for item in status.values}
        numbers = {key: number for key in texts if (number := float_of(texts[key])) is not None}
        yield _to_ns(array.header.stamp), status, {**texts, **numbers}


def _to_ns(time: Any) -> int:  # a builtin_interfaces/Time
    return int(time.sec * SECOND + time.nanosec)


def _picture(
    pixels: charts.Bytes, x: float, y: float, width: float, height: float
) -> tuple[rr.AsComponents, rr.AsComponents]:
    """Stretch pixels over a rectangle, whose upper left corner is at x, y."""
    rows, columns = pixels.shape[:2]
    # The buffer has an explicit size, because Rerun drops sides of one pixel from an array.
    image = rr.Image(
        bytes=pixels.tobytes(), width=columns, height=rows, color_model='RGB', datatype='U8',
        magnification_filter='linear',
    )
    scale = [width / columns, height / rows, 1.0]
    return image, rr.Transform3D(translation=[x, y, 0.0], scale=scale)


def _texts(*places: tuple[float, float, str]) -> list[rr.AsComponents]:
    """Return texts in front of images, each a little below a point x, y of a view."""
    return [rr.Points2D(
        [(x, y) for x, y, _ in places], labels=[text for *_, text in places], show_labels=True,
        colors=[WHITE], radii=rr.Radius.ui_points(0.0), draw_order=40.0,
    )]
