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
"""
Recordings of Rerun: what is drawn into them, as shapes and charts.

What changes with every step goes out in columns, many rows at once; what stays until it is
replaced is remembered, for a viewer that comes later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.recording.timeseries import Floats, Stamps, ThrowStart

STAMP = 'stamp'
"""Timeline of the messages' stamps."""

THROW_TIME = 'time since throw'
"""Timeline of the rig, from the start of the throw that is shown."""

Bytes = NDArray[np.uint8]
Colour = tuple[int, int, int]

# Okabe and Ito's colours, which everybody can tell apart
GREY = (0xB0, 0xB0, 0xB0)
WHITE = (0xFF, 0xFF, 0xFF)
BLUE = (0x56, 0xB4, 0xE9)
ORANGE = (0xE6, 0x9F, 0x00)
GREEN = (0x00, 0x9E, 0x73)
PURPLE = (0xCC, 0x79, 0xA7)
RED = (0xD5, 0x5E, 0x00)
BLACK = (0x00, 0x00, 0x00)

WIDTH, MAP_HEIGHT = 200.0, 84.0
"""Of a chart, and of a map, in units of its view."""

_LINE = 4.0
"""Half a line of text, in units of the view."""

_BAR_FOOT = 0.08
"""Part of a bar of colours that is beside the title of an axis, and has no ticks."""

_BEHIND, _IN_FRONT = 30.0, 40.0
"""Where dots are drawn."""


def _ramp(anchors: str) -> Bytes:
    """Make 256 colours that go evenly through some."""
    rows = np.array([list(bytes.fromhex(anchor)) for anchor in anchors.split()], float)
    places = np.linspace(0, len(rows) - 1, 256)
    columns = [np.interp(places, np.arange(len(rows)), column) for column in rows.T]
    return np.asarray(np.rint(columns).T, np.uint8)


# For any eyes: PuOr of ColorBrewer where there are two signs, viridis of matplotlib for one.
SIGNED = _ramp(
    '7f3b08 b35806 e08214 fdb863 fee0b6 f7f7f7 d8daeb b2abd2 8073ac 542788 2d004b'
)
UNSIGNED = _ramp('440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725')


def colours_of(values: Floats, low: float, high: float, ramp: Bytes) -> Bytes:
    """Colour values, those that are none in grey."""
    places = np.nan_to_num((values - low) / (high - low))
    colours: Bytes = ramp[np.rint(255.0 * places.clip(0.0, 1.0)).astype(int)]
    colours[np.isnan(values)] = GREY
    return colours


class Canvas:
    """
    Where things are drawn: a recording, if there is one, and a memory of what stays.

    Parameters
    ----------
    throw : ThrowStart, optional
        The throw whose start is the origin of `THROW_TIME`; without, there is only `STAMP`.

    """

    def __init__(self, throw: ThrowStart | None = None) -> None:
        self.throw = throw
        self._stream: rr.RecordingStream | None = None
        self._kept: dict[tuple[str, str], Callable[[], None]] = {}

    def connect(self, stream: rr.RecordingStream | None) -> None:
        """Draw into a recording from now on, what is remembered first; or into none."""
        self._stream = stream
        for draw in self._kept.values():
            draw()

    def style(self, path: str, style: rr.AsComponents) -> None:
        """Say once how something looks."""
        if ('style', path) not in self._kept:
            self._keep('style', path, partial(self._log, path, style))

    def put(self, path: str, stamp: int, *content: rr.AsComponents) -> None:
        """Draw what stays until something else is put there."""
        batches = [batch for each in content for batch in each.as_component_batches()]
        columns = [batch.partition([len(batch.as_arrow_array())]) for batch in batches]
        self._keep('content', path, partial(self.send, path, np.array([stamp]), columns))

    def _keep(self, kind: str, path: str, draw: Callable[[], None]) -> None:
        self._kept[kind, path] = draw
        draw()

    def _log(self, path: str, style: rr.AsComponents) -> None:
        if self._stream is not None:
            self._stream.log(path, style, static=True)

    def send(self, path: str, stamps: Stamps, columns: Iterable[rr.ComponentColumn]) -> None:
        """Draw what changes all the time."""
        if self._stream is None or not stamps.size:
            return
        indexes = [rr.TimeColumn(STAMP, timestamp=stamps.astype('datetime64[ns]'))]
        if self.throw is not None:
            indexes.append(rr.TimeColumn(THROW_TIME, duration=self.throw.seconds_to(stamps)))
        self._stream.send_columns(path, indexes, columns)

    def arrange(self, blueprint: rrb.Blueprint) -> None:
        """Arrange the views."""
        if self._stream is not None:
            self._stream.send_blueprint(blueprint)


# shapes


class Text(NamedTuple):
    """A text whose upper edge is a little below a place in the view."""

    x: float
    y: float
    text: str
    colour: Colour = GREY


def picture(
    pixels: Bytes, *, x: float, y: float, w: float, h: float
) -> tuple[rr.AsComponents, rr.AsComponents]:
    """Stretch pixels over a rectangle, whose upper left corner is at x, y."""
    rows, columns = pixels.shape[:2]
    # from an array, Rerun would leave out sides of one pixel
    image = rr.Image(
        bytes=pixels.tobytes(), width=columns, height=rows, color_model='RGB', datatype='U8'
    )
    scale = [w / columns, h / rows, 1.0]
    return image, rr.Transform3D(translation=[x, y, 0.0], scale=scale)


def lines(strips: Sequence[Sequence[tuple[float, float]]], colour: Colour) -> rr.LineStrips2D:
    """Draw thin lines."""
    radius = rr.Radius.ui_points(0.5)
    return rr.LineStrips2D([np.array(strip) for strip in strips], colors=[colour], radii=radius)


def texts(rows: Sequence[Text]) -> rr.Points2D:
    """Write texts."""
    return rr.Points2D(
        [(row.x, row.y) for row in rows],
        radii=rr.Radius.ui_points(0.0),
        colors=[row.colour for row in rows],
        labels=[row.text for row in rows],
        show_labels=True,
        draw_order=_IN_FRONT,
    )


@dataclass(frozen=True)
class Axis:
    """From one value to another."""

    low: float
    high: float
    is_log: bool = False

    @classmethod
    def of_pixels(cls, values: Floats) -> Axis:
        """Make the axis of pixels around values that grow by the same step or factor each."""
        if values.size > 2 and values[0] > 0.0 and not np.allclose(np.diff(values, 2), 0.0):
            half = math.sqrt(values[1] / values[0])
            return cls(float(values[0] / half), float(values[-1] * half), is_log=True)
        half = 0.5 * (values[1] - values[0])
        return cls(float(values[0] - half), float(values[-1] + half))

    def part(self, value: float) -> float:
        """Return where a value is, from 0 to 1."""
        if self.is_log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def ticks(self, count: int) -> list[float]:
        """Return round values, about so many."""
        if self.is_log:
            decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)))
            values = [digit * 10.0**decade for decade in decades for digit in (1, 2, 5)]
            return [value for value in values if 0.999 * self.low <= value <= 1.001 * self.high]
        step = round_up(0.99 * (self.high - self.low) / count, (1.0, 2.0, 5.0, 10.0))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [step * n for n in range(first, last + 1)]


def round_up(value: float, digits: Sequence[float] = (1.0, 1.5, 2.0, 3.0, 5.0, 10.0)) -> float:
    """Return a round number that is not less than a positive one."""
    unit = 10.0 ** math.floor(math.log10(value))
    return unit * next(digit for digit in digits if digit * unit >= value)


@dataclass(frozen=True, kw_only=True)
class Chart:
    """A picture with axes, of `WIDTH`. Coordinates of the view: x from 0, y from 0 downwards."""

    canvas: Canvas
    path: str  # of its entity
    stamp: int  # when it begins to hold [ns]
    height: float  # of the picture
    x: Axis  # to the right
    y: Axis  # upwards

    def x_at(self, value: float) -> float:
        """Return where a value of the x-axis is."""
        return WIDTH * self.x.part(value)

    def y_at(self, value: float) -> float:
        """Return where a value of the y-axis is."""
        return self.height * (1.0 - self.y.part(value))

    def put(self, name: str, *content: rr.AsComponents) -> None:
        """Draw a part of it."""
        self.canvas.put(f'{self.path}/{name}', self.stamp, *content)

    def draw(self, pixels: Bytes, *, titles: tuple[str, str]) -> None:
        """Draw picture, frame, ticks and titles."""
        height = self.height
        self.put('picture', *picture(pixels, x=0.0, y=0.0, w=WIDTH, h=height))
        x_ticks = [(self.x_at(tick), f'{tick:g}') for tick in self.x.ticks(6)]
        y_ticks = [(self.y_at(tick), f'{tick:g}') for tick in self.y.ticks(5)]
        short, left = 0.4 * _LINE, -1.8 * _LINE
        strips = [[(0.0, 0.0), (WIDTH, 0.0), (WIDTH, height), (0.0, height), (0.0, 0.0)]]
        strips += [[(x, height), (x, height + short)] for x, _ in x_ticks]
        strips += [[(-short, y), (0.0, y)] for y, _ in y_ticks]
        self.put('frame', lines(strips, GREY))
        rows = [Text(x, height + short, text) for x, text in x_ticks]
        rows += [Text(left, y - _LINE, text) for y, text in y_ticks]
        rows.append(Text(1.075 * WIDTH, height + short, titles[0], WHITE))
        rows.append(Text(left, -2.6 * _LINE, titles[1], WHITE))
        self.put('texts', texts(rows))

    def draw_bar(self, axis: Axis, ramp: Bytes, *, title: str) -> None:
        """Draw what the colours mean, to the right."""
        left, thick = WIDTH + _LINE, 1.2 * _LINE
        self.put('bar', *picture(ramp[::-1, None], x=left, y=0.0, w=thick, h=self.height))
        x = left + thick + 1.8 * _LINE
        places = [(axis.part(tick), f'{tick:g}') for tick in axis.ticks(4)]
        rows = [
            Text(x, self.height * (1.0 - part) - _LINE, text)
            for part, text in places
            if part > _BAR_FOOT
        ]
        rows.append(Text(left + thick, -2.6 * _LINE, title, WHITE))
        self.put('bar_texts', texts(rows))

    def draw_line(self, name: str, value: float | None, text: str = '') -> None:
        """Draw a vertical line with a text at its top; None takes it away."""
        places = [] if value is None else [self.x_at(value)]
        self.put(name, lines([[(x, 0.0), (x, self.height)] for x in places], BLACK))
        self.put(f'{name}/text', texts([Text(x, -2.6 * _LINE, text, WHITE) for x in places]))

    def draw_marks(self, marks: Sequence[tuple[float, float, str]]) -> None:
        """Draw up to two dots with a dark rim, and their texts, that of the upper one above it."""
        places = [(self.x_at(x), self.y_at(y)) for x, y, _ in marks]
        upper = min(range(len(marks)), key=lambda index: places[index][1], default=0)
        rows = [
            Text(
                min(max(x, 0.15 * WIDTH), 0.85 * WIDTH),
                y - 3.6 * _LINE if index == upper and len(marks) > 1 else y + 0.6 * _LINE,
                marks[index][2],
                WHITE,
            )
            for index, (x, y) in enumerate(places)
        ]
        for name, radius, colours, order in (
            ('rims', 6.0, (BLACK, BLACK), _BEHIND),
            ('marks', 4.0, (WHITE, RED), _IN_FRONT),
        ):
            size = rr.Radius.ui_points(radius)
            dots = rr.Points2D(places, radii=size, colors=colours[: len(marks)], draw_order=order)
            self.put(name, dots)
        self.put('mark_texts', texts(rows))


def chart_view(origin: str, title: str, height: float) -> rrb.Spatial2DView:
    """Make the view of a `Chart`."""
    x_range, y_range = [-0.1 * WIDTH, 1.13 * WIDTH], [-2.5 * _LINE, height + 4.5 * _LINE]
    bounds = rrb.VisualBounds2D(x_range=x_range, y_range=y_range)
    return rrb.Spatial2DView(origin=origin, name=title, visual_bounds=bounds)


# maps of designs


class MapAxis(NamedTuple):
    """An axis of a map."""

    title: str  # What it is, with its unit
    # (n,) In that unit; from each to the next by the same step, or by the same factor
    values: Floats


class MapPanel(NamedTuple):
    """What a map shows."""

    name: str  # Of the entity
    # What it is, and how that is written
    title: str
    symbol: str
    # (n, m) Along the first and the second axis, from 0 on; NaN where there is none
    values: Floats
    highest: float | None = None  # Where the colours end; at the largest value if not given


Marks = Sequence[tuple[float, float, str]]
"""Up to two places to be marked in a map: values on the axes, and a text."""


def draw_landscape(
    stream: rr.RecordingStream,
    *,
    name: str,
    axes: tuple[MapAxis, MapAxis],
    panels: Sequence[MapPanel],
    marks: Marks = (),
) -> None:
    """
    Draw maps over two axes, one above the other. The values are beside them, as tensors.

    Parameters
    ----------
    stream : RecordingStream
        Where to; it has no time.
    name : str
        Of the recording, for the viewer.
    axes : tuple of MapAxis
        To the right, and upwards.
    panels : sequence of MapPanel
        The maps.
    marks : sequence of tuple
        The places to be marked in each.

    """
    stream.send_recording_name(name)
    canvas = Canvas()
    canvas.connect(stream)
    for panel in panels:
        draw_map(canvas, 0, axes, panel, marks, root='')
        tensor = rr.Tensor(panel.values, dim_names=[axis.title for axis in axes])
        stream.log(f'/values/{panel.name}', tensor, static=True)
    views = [chart_view(f'/{each.name}', each.title, MAP_HEIGHT) for each in panels]
    canvas.arrange(
        rrb.Blueprint(
            rrb.Vertical(*views),
            rrb.BlueprintPanel(state='hidden'),
            rrb.SelectionPanel(state='hidden'),
            rrb.TimePanel(state='hidden', timeline=STAMP),
        )
    )


def draw_map(
    canvas: Canvas, stamp: int, axes: Sequence[MapAxis], panel: MapPanel, marks: Marks, *,
    root: str,
) -> None:
    """Draw a map, as an entity below a root, from some time on [ns]."""
    values, highest = panel.values, panel.highest
    if highest is None:
        known = values[np.isfinite(values)]
        highest = float(known.max()) if known.size and known.max() > 0.0 else 1.0
    x, y = (Axis.of_pixels(axis.values) for axis in axes)
    path = f'{root}/{panel.name}'
    chart = Chart(canvas=canvas, path=path, stamp=stamp, height=MAP_HEIGHT, x=x, y=y)
    pixels = colours_of(values.T[::-1], 0.0, highest, UNSIGNED)
    chart.draw(pixels, titles=(axes[0].title, axes[1].title))
    chart.draw_bar(Axis(0.0, highest), UNSIGNED, title=panel.symbol)
    chart.draw_marks(marks)
