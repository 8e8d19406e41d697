# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Twins in Rerun: the rig to scale, series, waves in the layer, the best layer, and words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from functools import partial
import math
from typing import Any

from matplotlib.ticker import MaxNLocator
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.configuration.interface import (
    FIELD_POINTS,
    JOINT_STATE,
    Topic,
    TWIN_TOPICS,
)
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording import charts
from soft_throw_ros.recording import rerun_layout as layout
from soft_throw_ros.recording import rerun_text as words
from soft_throw_ros.recording import timeseries as series
from soft_throw_ros.recording.charts import Bytes
from soft_throw_ros.recording.rerun_layout import BLACK, BLUE, Colour, GREY, RED, WHITE
from soft_throw_ros.recording.timeseries import Floats, Stamps, ThrowStart, Values
from soft_throw_ros.storage.cdr import decode, stamp_of
from soft_throw_ros.storage.message import Message

_MILLI, _MICRO = 1e3, 1e6

_LOG = Topic('/rosout', 'rcl_interfaces/msg/Log', 'What nodes say')

_LEVELS = ((50, 'CRITICAL'), (40, 'ERROR'), (30, 'WARN'), (20, 'INFO'), (0, 'DEBUG'))
"""Levels of rcl_interfaces/Log and their names in Rerun."""

_PLATE_WIDTH = 1.5
"""Width of the plate, over the diameter of the layer."""

_STEP_BACK = 1_000_000_000
"""Stamps that go back further begin another repetition; smaller steps correct a clock. [ns]"""

_DEFAULT_STRAIN = 0.2
"""Upper end of the colours of strain before the first throw. [-]"""


class Canvas:
    """
    Draws into a recording.

    The start of `throw` is the origin of `THROW_TIME`; without it, there is only `STAMP`. `delay`
    is added to all stamps [ns].
    """

    def __init__(
        self, stream: rr.RecordingStream, throw: ThrowStart | None, *, is_live: bool
    ) -> None:
        self.stream = stream
        self.throw = throw
        self.is_live = is_live
        self.delay = 0

    def style(self, path: str, style: rr.AsComponents) -> None:
        """Set the style of an entity, for all times."""
        self.stream.log(path, style, static=True)

    def draw(self, path: str, stamp: int, *content: rr.AsComponents, stays: bool = False) -> None:
        """
        Draw content that holds until an entity gets other content.

        In a live view, content that `stays` is kept for viewers that connect much later.
        """
        stamp += self.delay
        self.stream.set_time(layout.STAMP, timestamp=np.datetime64(stamp, 'ns'))
        if self.throw is not None:
            self.stream.set_time(layout.THROW_TIME, duration=self.throw.seconds_to(stamp))
        self.stream.log(path, *content, static=stays and self.is_live)

    def columns(self, path: str, stamps: Stamps, columns: Iterable[rr.ComponentColumn]) -> None:
        """Draw rows of a quantity that changes with every step."""
        if not stamps.size:
            return
        stamps = stamps + self.delay
        indexes = [rr.TimeColumn(layout.STAMP, timestamp=stamps.astype('datetime64[ns]'))]
        if self.throw is not None:
            seconds = self.throw.seconds_to(stamps)
            indexes.append(rr.TimeColumn(layout.THROW_TIME, duration=seconds))
        self.stream.send_columns(path, indexes, columns)


class Scene:
    """
    The drawing of all twins.

    A live drawing shows the latest messages; else times count from the start of `throw`. A picture
    has no panels for the mouse.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        *,
        is_live: bool = False,
        is_picture: bool = False,
        throw: ThrowStart | None = None,
    ) -> None:
        self.damaged = 0  # number of messages that could not be read
        self.damage = ''  # the error of the first of them
        self._is_picture = is_picture
        self._canvas = Canvas(stream, throw, is_live=is_live)
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

    def show(self, messages: Iterable[Message]) -> None:
        """Draw messages topic by topic, in an order that respects their dependencies."""
        waiting: dict[str, dict[Topic, list[Message]]] = {}
        for message in messages:
            node, topic = _identify(message.channel.topic, message.channel.type)
            if topic is None:
                continue
            is_state = topic == TWIN_TOPICS.joint_states
            back = self._twin(node).step_back(message) if is_state else 0
            # Earlier messages belong to the former rig, or to the former repetition
            if back or topic == TWIN_TOPICS.journal:
                self._read(node, waiting.pop(node, {}))
            if back:
                self._twin(node).begin_again(back)
            waiting.setdefault(node, {}).setdefault(topic, []).append(message)
        for node, groups in sorted(waiting.items(), reverse=True):  # lines of the log come last
            self._read(node, groups)
        if self._canvas.is_live:
            self.arrange()

    def _read(self, node: str, groups: Mapping[Topic, Sequence[Message]]) -> None:
        """Draw messages of one node, or messages that belong to no node."""
        readers: Mapping[Topic, Callable[..., None]] = {
            _LOG: self._draw_line, TWIN_TOPICS.diagnostics: self._draw_diagnostics
        }
        if node:
            twin = self._twin(node)
            readers = {topic: partial(twin.show, topic) for topic in series.READERS}
        for topic, read in readers.items():
            messages = groups.get(topic, ())
            at_once = [messages] if messages and topic.type == JOINT_STATE else messages
            for data in at_once:
                self._attempt(read, data)

    def _twin(self, node: str) -> _TwinView:
        if node not in self._twins:
            self._twins[node] = _TwinView(node, copy(self._canvas))
        return self._twins[node]

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
        known = (twin.shown_stamp(message) for twin in self._twins.values() if twin.is_drawn)
        stamp = next(known, series.to_ns(line.stamp))
        level = next(name for bound, name in _LEVELS if line.level >= bound)
        self._has_log = True
        columns = rr.TextLog.columns(text=[f'{line.name}: {line.msg}'], level=[level])
        self._canvas.columns(layout.LOG, np.array([stamp]), columns)

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
        is_live, throw = self._canvas.is_live, self._canvas.throw
        views = [layout.arrange(twin, is_live=is_live) for twin in twins]
        self._canvas.stream.send_blueprint(
            rrb.Blueprint(
                views[0] if len(views) == 1 else rrb.Tabs(*views),
                rrb.TopPanel(state='hidden' if self._is_picture else 'expanded'),
                rrb.BlueprintPanel(state='hidden'),
                rrb.SelectionPanel(state='hidden'),
                rrb.TimePanel(
                    state='collapsed',
                    timeline=layout.STAMP if throw is None else layout.THROW_TIME,
                    playback_speed=1.0 if is_live else min(0.5 * twins[0].period, 1.0),
                    play_state='following' if is_live else 'paused',
                ),
            )
        )


class _TwinView:
    """The drawing of one twin from its messages."""

    def __init__(self, node: str, canvas: Canvas) -> None:
        self.reader = series.TwinReader()
        # Whether anything was drawn: topics with these names may belong to another machine
        self.is_drawn = False
        self._node = node
        self._root = rr.new_entity_path(node.split('/'))
        self._canvas = canvas
        self._rig: Rig | None = None  # of the table and the map; None while unknown
        self._last = self._stamp = 0  # stamps of the last state, and of the table and the map [ns]
        self._recommendation: tuple[str, Values] = words.NO_RECOMMENDATION, {}  # the last one
        self._largest_strain = _DEFAULT_STRAIN  # where the colours end [-]
        self._track: dict[str, str] = {}  # texts by the task of the node
        self._present: set[str] = set()  # optional panels that are there
        self._size = 12.0, 60.0  # of the side view, before the first rig: diameter, height [mm]
        phases = rr.StateConfiguration(
            values=list(layout.PHASES), colors=list(layout.PHASES.values())
        )
        canvas.style(self._path('phase'), phases)
        for name, (titles, colours, _, width) in layout.LINES.items():
            widths = np.broadcast_to(width, len(titles))
            style = rr.SeriesLines(names=titles, colors=colours, widths=widths)
            canvas.style(self._path(name), style)
        pixels = rr.components.ImageFormat(
            width=1, height=FIELD_POINTS, color_model='RGB', channel_datatype='U8'
        )
        layer = rr.Image.from_fields(format=pixels, magnification_filter='linear')
        canvas.style(self._path('side/layer'), layer)
        cursor = rr.LineStrips2D.from_fields(colors=[RED], radii=rr.Radius.ui_points(1.0))
        canvas.style(self._path('strain/now'), cursor)

    def _path(self, name: str) -> str:
        return f'{self._root}/{name}'

    def step_back(self, state: Message) -> int:
        """Return how far stamps go back to a state, as when a replay repeats a bag, or 0 [ns]."""
        last, self._last = self._last, stamp_of(state.data) or self._last
        return last - self._last if last > self._last + _STEP_BACK else 0

    def begin_again(self, back: int) -> None:
        """Draw all that follows after what is drawn, although stamps have gone back [ns]."""
        self._canvas.delay += back
        self.reader.forget_states()
        self._stamp = self._last
        self._draw_recommendation(self._last, self._rig)

    def shown_stamp(self, message: Message) -> int:
        """Return where a message without a stamp is drawn [ns]."""
        return self.reader.stamp_of(message) + self._canvas.delay

    def show(self, topic: Topic, data: Message | Sequence[Message]) -> None:
        """Read and draw a message, or several messages of joints."""
        content = series.READERS[topic](self.reader, data)
        if content:
            self.is_drawn = True
            _DRAWERS[topic](self, content)

    # plots

    def draw_lines(self, lines: tuple[Stamps, Floats], name: str) -> None:
        """Draw lines of a plot, of values in SI units."""
        stamps, values = lines
        columns = rr.Scalars.columns(scalars=layout.LINES[name].factor * values)
        self._canvas.columns(self._path(name), stamps, columns)
        self._present.add(name)

    def draw_states(self, states: series.RigStates) -> None:
        self.draw_lines((states.stamps, states.position), 'position')
        self.draw_lines((states.stamps, states.velocity), 'velocity')
        self.draw_lines((states.stamps, states.force * [-1.0, 1.0]), 'force')
        self._draw_positions(states.stamps, states.position)

    def draw_energies(self, energies: tuple[Stamps, Floats]) -> None:
        stamps, values = energies
        stamps = np.append(stamps, stamps[-1] + 1)  # a line ends there, by NaN
        values = np.vstack([values, np.full(values.shape[1], math.nan)])
        self.draw_lines((stamps, values), 'energy')

    # the rig to scale: in mm, downwards as Rerun has it

    def draw_rig(self, change: tuple[int, Rig]) -> None:
        """Draw the bodies of a rig, and a scale of heights on the left."""
        stamp, rig = change
        draw, path = partial(self._canvas.draw, stays=True), self._path('side')
        diameter, length = _MILLI * rig.layer.diameter, _MILLI * rig.projectile.length
        thickness = _MILLI * rig.layer.thickness
        high, width = 1.35 * (thickness + length) + 0.8 * diameter, _PLATE_WIDTH * diameter
        self._size = diameter, high
        for name, colour, w, y, h in (
            ('plate', GREY, width, 0.0, 0.15 * diameter),
            ('projectile', BLUE, diameter, -length, length),
        ):
            body = _picture(np.array([[colour]], np.uint8), x=-0.5 * w, y=y, w=w, h=h)
            draw(f'{path}/{name}/body', stamp, *body)
        for name, text, y in (
            ('plate/text', 'plate', 0.0),
            ('plate/layer_text', 'layer', -0.5 * thickness),
            ('projectile/text', 'projectile', -0.5 * length),
        ):
            draw(f'{path}/{name}', stamp, _texts([(0.95 * diameter, y)], [text], WHITE))
        locator = MaxNLocator(8, steps=[1, 2, 5, 10])
        ticks = [tick for tick in locator.tick_values(0.0, high) if 0.0 <= tick <= high]
        x, mark = -0.55 * width, 0.08 * diameter
        strips = [[(x, 0.0), (x, -ticks[-1])]]
        strips += [[(x - mark, -tick), (x, -tick)] for tick in ticks]
        draw(f'{path}/ruler', stamp, _lines(strips, GREY))
        lift = 0.009 * (high + 0.4 * diameter)  # texts stand below their places
        places = [(x - 0.21 * diameter, -tick - lift) for tick in ticks]
        draw(f'{path}/ruler/texts', stamp, _texts(places, [f'{tick:g}' for tick in ticks]))
        if self._rig not in (None, rig):  # the last recommendation is of another rig
            self._recommendation = words.NO_RECOMMENDATION, {}
        if self._rig != rig:
            self._draw_recommendation(stamp, rig)

    def _draw_positions(self, stamps: Stamps, position: Floats) -> None:
        """Move plate and projectile."""
        translation = np.zeros((stamps.size, 3))
        for name, height in zip(('plate', 'projectile'), position.T, strict=True):
            translation[:, 1] = -_MILLI * height
            columns = rr.Transform3D.columns(translation=translation)
            self._canvas.columns(self._path(f'side/{name}'), stamps, columns)

    def draw_layer(self, layer: series.LayerStates) -> None:
        """Draw the colours of the strain, stretched from the lower to the upper end."""
        pixels = charts.signed_colours(layer.strain[:, ::-1], self._largest_strain)
        width, count = self._size[0], layer.top.size
        corner, scale = np.zeros((count, 3)), np.ones((count, 3))
        corner[:, 0], corner[:, 1] = -0.5 * width, -_MILLI * layer.top
        scale[:, 0], scale[:, 1] = width, _MILLI * (layer.top - layer.bottom) / FIELD_POINTS
        columns = [
            *rr.Image.columns(buffer=[row.tobytes() for row in pixels]),
            *rr.Transform3D.columns(translation=corner, scale=scale),
        ]
        self._canvas.columns(self._path('side/layer'), layer.stamps, columns)

    # the strain over time and height in one throw

    def draw_field(self, field: series.StrainField) -> None:
        """Draw the strain with axes, the ejection and a moving cursor, and the rig over time."""
        contact = field.strain[field.times <= (field.throw.ejection_time or field.times[-1])]
        limit = _round_up(max(1.5 * float(np.abs(contact).max()), 1e-6))
        self._largest_strain = limit
        path, stamps, draw = self._path('strain'), field.stamps, self._canvas.draw
        start, end = int(stamps[0]), float(field.times[-1])
        x, y, width, height = charts.FRAME_BOX
        frame = charts.strain_frame(_MILLI * end, _MILLI * field.thickness, 100.0 * limit)
        draw(f'{path}/frame', start, _encoded_image(frame))
        pixels = charts.signed_colours(field.strain.T[::-1], limit)
        draw(f'{path}/picture', start, *_picture(pixels, x=x, y=y, w=width, h=height))
        strips, places, titles = [], [], []  # nothing replaces the line of another throw
        ejection_time = field.throw.ejection_time
        if ejection_time is not None:
            at = x + width * ejection_time / end
            strips, places = [[(at, y), (at, y + height)]], [(at, y - 37.0)]
            titles = [f'tₑ {_MILLI * ejection_time:.2f} ms']
        draw(f'{path}/ejection', start, _lines(strips, BLACK))
        draw(f'{path}/ejection/text', start, _texts(places, titles))
        cursors = np.zeros((stamps.size, 2, 2), np.float32)
        cursors[:, :, 0] = (x + width * field.times / end)[:, None]
        cursors[:, :, 1] = y, y + height
        columns = rr.LineStrips2D.columns(strips=cursors).partition([1] * stamps.size + [0])
        after = 2 * stamps[-1] - stamps[-2]  # when the cursor disappears
        self._canvas.columns(f'{path}/now', np.append(stamps, after), columns)
        throw = self.reader.interpolate_throw(field)
        if throw is not None:
            position, layer = throw
            self._draw_positions(stamps, position)
            self.draw_layer(layer)

    # words

    def _write(self, name: str, stamp: int, text: str, *, stays: bool = False) -> None:
        document = rr.TextDocument(text, media_type='text/markdown')
        self._canvas.draw(self._path(name), stamp, document, stays=stays)

    def draw_phases(self, changes: Sequence[tuple[int, str]]) -> None:
        """Draw phases at the times of their starts."""
        for stamp, phase in changes:
            self._canvas.draw(self._path('phase'), stamp, rr.StateChange(state=phase))

    def draw_results(self, results: Sequence[tuple[int, Values]]) -> None:
        """Write the results of throws."""
        for stamp, values in results:
            self._write('throw_result', stamp, words.throw_text(values))

    def draw_track(self, stamp: int, task: str, status: Any, values: Values) -> None:
        """Write the diagnostics of the measured track, one line for each task."""
        if task in words.TRACK_TASKS:
            self.is_drawn = True
            self._present.add('track')
            self._track[task] = words.track_text(task, status, values)
            lines = [self._track[name] for name in words.TRACK_TASKS if name in self._track]
            self._write('track', stamp, '  \n'.join(lines))

    def draw_recommendations(self, recommendations: Sequence[tuple[int, str, Values]]) -> None:
        """Write recommendations, and draw the maps of their rig."""
        for stamp, text, values in recommendations:
            self._recommendation = text, values
            self._draw_recommendation(stamp, self.reader.wanted_rig())

    def _draw_recommendation(self, stamp: int, rig: Rig | None) -> None:
        """Write the table of the last recommendation, and draw the map of a rig."""
        self._rig, (message, values) = rig, self._recommendation
        if stamp > self._stamp - _STEP_BACK:  # else it is of the next repetition
            stamp = max(self._stamp, stamp)  # the last one is shown last
        self._stamp = stamp
        text = words.recommendation_text(message, values)
        self._write('recommendation', stamp, text, stays=True)
        if rig is not None:
            figure = charts.draw_energy_map(rig, self.reader.wanted, values)
            image = _encoded_image(charts.to_png(figure))
            self._canvas.draw(self._path('landscape'), stamp, image, stays=True)

    # layout

    def layout_state(self, *, has_log: bool) -> layout.TwinLayout:
        """Return the state of the layout."""
        reader, (diameter, high) = self.reader, self._size
        scale = reader.time_scale if self._canvas.throw is None else 1.0
        period = 1.0 if reader.rig is None else 1.0 / (reader.rig.engine.frequency * scale)
        return layout.TwinLayout(
            root=self._root,
            title=self._node,
            period=period,
            side=(1.25 * diameter, -0.4 * diameter, high),
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


def _round_up(value: float) -> float:
    """Return a round number that is not less than a positive one."""
    unit = 10.0 ** math.floor(math.log10(value))
    return unit * next(digit for digit in (1.0, 1.5, 2.0, 3.0, 5.0, 10.0) if digit * unit >= value)


# shapes


def _picture(
    pixels: Bytes, *, x: float, y: float, w: float, h: float
) -> tuple[rr.AsComponents, rr.AsComponents]:
    """Stretch pixels over a rectangle, whose upper left corner is at x, y."""
    rows, columns = pixels.shape[:2]
    # The buffer has an explicit size, because Rerun drops sides of one pixel from an array.
    image = rr.Image(
        bytes=pixels.tobytes(), width=columns, height=rows, color_model='RGB', datatype='U8',
        magnification_filter='linear',
    )
    scale = [w / columns, h / rows, 1.0]
    return image, rr.Transform3D(translation=[x, y, 0.0], scale=scale)


def _lines(strips: Sequence[Sequence[tuple[float, float]]], colour: Colour) -> rr.LineStrips2D:
    """Draw thin lines."""
    radius = rr.Radius.ui_points(0.5)
    return rr.LineStrips2D([np.array(strip) for strip in strips], colors=[colour], radii=radius)


def _encoded_image(png: bytes) -> rr.EncodedImage:
    """Return an image that is drawn behind everything else."""
    return rr.EncodedImage(
        contents=png, media_type='image/png', draw_order=-20.0, magnification_filter='linear'
    )


def _texts(
    points: Sequence[tuple[float, float]], labels: Sequence[str], colour: Colour = GREY
) -> rr.Points2D:
    """Write texts whose upper edges are a little below points of a view."""
    return rr.Points2D(
        points,
        radii=rr.Radius.ui_points(0.0),
        colors=[colour],
        labels=labels,
        show_labels=True,
        draw_order=40.0,  # in front of images (-10) and lines (30)
    )
