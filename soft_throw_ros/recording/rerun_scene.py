# SPDX-License-Identifier: Apache-2.0
"""
Twins in Rerun: the rig to scale, series, waves in the layer, what is best; all calls of Rerun.

Times of the scene are those of the messages' stamps, on one timeline. What changes with every step
goes out in columns, many at once; what stays until it is replaced is remembered, for a viewer that
comes later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future
import contextlib
from dataclasses import dataclass
import math
from pathlib import Path
import time
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
import rerun as rr
import rerun.blueprint as rrb
from rerun.experimental import ViewerClient
from soft_throw_ros.core.rig import Rig, STANDARD_GRAVITY
from soft_throw_ros.recording.digest import (
    Beside,
    Digest,
    Floats,
    LayerEnergy,
    LayerStrain,
    LogLine,
    MEASURED,
    Motion,
    Part,
    PhaseChange,
    Places,
    PREDICTED,
    RECOMMENDATION,
    Report,
    RESIDUAL,
    RigChange,
    Stamps,
    THROW_RESULT,
    ThrowPicture,
)
from soft_throw_ros.recording.message import Message
from soft_throw_ros.recording.viewer import free_port, HOST, Viewer, ViewerError
from soft_throw_ros.twin.tick_schedule import SECOND

APPLICATION = 'soft_throw_ros'
"""What Rerun knows the scene by."""

TIMELINE = 'stamp'

EnergyTransfer = Callable[[Rig, Floats, Floats], Floats]
"""Gives alpha of a rig whose layer has other thicknesses [m] and wave speeds [m/s]."""

Use = Literal['live', 'bag', 'picture']

Bytes = NDArray[np.uint8]

# Okabe and Ito's colours, which everybody can tell apart
_GREY = (0xB0, 0xB0, 0xB0)
_WHITE = (0xFF, 0xFF, 0xFF)
_BLUE = (0x56, 0xB4, 0xE9)
_ORANGE = (0xE6, 0x9F, 0x00)
_GREEN = (0x00, 0x9E, 0x73)
_PURPLE = (0xCC, 0x79, 0xA7)
_RED = (0xD5, 0x5E, 0x00)
_BLACK = (0x00, 0x00, 0x00)

Colour = tuple[int, int, int]

_PHASES = {
    'rest': (0x60, 0x60, 0x60),
    'contact': _ORANGE,
    'flight': _BLUE,
    'landed': _GREEN,
    'returning': _PURPLE,
}

_ALPHA = '\N{GREEK SMALL LETTER ALPHA}'

_MILLI = 1e3

_BESIDE: Mapping[str, tuple[str, float, list[str], list[Colour]]] = {
    MEASURED: (
        'position/measured',
        1e3,
        ['plate, measured', 'projectile, measured'],
        [_RED, _ORANGE],
    ),
    PREDICTED: ('position/predicted', 1e3, ['projectile, predicted'], [_GREEN]),
    RESIDUAL: ('residual', 1e6, ['plate', 'projectile'], [_GREY, _BLUE]),
}
"""Where positions beside those of the states are drawn, in mm or um."""

_DIGITS = 4
"""Of numbers in tables."""

_LOG = '/log'

_LEVELS = ((50, 'CRITICAL'), (40, 'ERROR'), (30, 'WARN'), (20, 'INFO'))
"""Levels of rcl_interfaces/Log, and what Rerun calls them."""

# The side view.

_CELLS = 64
"""Into which the layer is divided where it is drawn."""

_PLATE = 1.5
"""Width of the plate, over the diameter of the layer."""

_TOP = 0.93
"""Part of the height of the view that what is above it is told at."""

_STRAIN = 0.2
"""Where the colours of strain end before a throw has been seen."""

# Pictures with axes, in units of the view.

_WIDTH = 200.0
_STRAIN_HEIGHT, _LANDSCAPE_HEIGHT = 58.0, 84.0

_LINE = 4.0
"""Half a line of text."""

_FOOT = 0.08
"""Part of a bar of colours that is beside the title of an axis."""

_BEHIND, _IN_FRONT = 30.0, 40.0
"""Where dots are drawn."""

# Time.

_MOMENT = 0.7
"""When in a contact there is most to see, as part of the ejection time."""

_BEFORE, _AFTER = 0.7, 1.8
"""What is shown before and after that moment, in periods of the plate."""

_LIVE, _SHORTEST = 4.0, 2.0
"""What is shown of the time up to now, in periods of the plate, and at least in seconds."""

# The landscape.

_LANDSCAPE = (160, 100)
"""Thicknesses and wave speeds."""

_STRIDES = (8, 4, 2, 1)
_BUDGET = 1.0
"""The finest is taken that needs no longer: far too heavy a projectile takes minutes. [s]"""

_SMALLEST, _LARGEST = 1e-6, 1e6
"""Of a thickness and a wave speed that may be recommended, in SI units."""

# The viewer.

_SERVER_MEMORY = '256MB'

_ANSWER_TIME = 30.0  # [s]
_PAUSE = 0.25  # [s]
_MOST_PICTURES = 40


def _ramp(anchors: str) -> Bytes:
    """Make 256 colours that go evenly through some."""
    rows = np.array([list(bytes.fromhex(anchor)) for anchor in anchors.split()], float)
    places = np.linspace(0, len(rows) - 1, 256)
    columns = [np.interp(places, np.arange(len(rows)), column) for column in rows.T]
    return np.asarray(np.rint(columns).T, np.uint8)


# For any eyes: PuOr of ColorBrewer where there are two signs, viridis of matplotlib for one.
_SIGNED = _ramp(
    '7f3b08 b35806 e08214 fdb863 fee0b6 f7f7f7 d8daeb b2abd2 8073ac 542788 2d004b'
)  # fmt: skip
_UNSIGNED = _ramp('440154 472d7b 3b528b 2c728e 21918c 28ae80 5ec962 addc30 fde725')


def _colours(values: Floats, low: float, high: float, ramp: Bytes) -> Bytes:
    """Colour values, those that are none in grey."""
    places = np.nan_to_num((values - low) / (high - low))
    colours: Bytes = ramp[np.rint(255.0 * places.clip(0.0, 1.0)).astype(int)]
    colours[np.isnan(values)] = _GREY
    return colours


class _Canvas:
    """Where things are drawn: a recording, if there is one, and a memory of what stays."""

    def __init__(self) -> None:
        self._stream: rr.RecordingStream | None = None
        self._statics: dict[str, Any] = {}
        self._rows: dict[str, tuple[int, list[Any]]] = {}

    def connect(self, stream: rr.RecordingStream | None) -> None:
        """Draw into a recording from now on, what is remembered first; or into none."""
        self._stream = stream
        if stream is not None:
            for path, style in self._statics.items():
                stream.log(path, style, static=True)
            for path, (stamp, columns) in self._rows.items():
                self.send(path, np.array([stamp]), columns)

    def style(self, path: str, style: Any) -> None:
        """Say once how something looks."""
        if path not in self._statics:
            self._statics[path] = style
            if self._stream is not None:
                self._stream.log(path, style, static=True)

    def put(self, path: str, stamp: int, columns: Iterable[Any]) -> None:
        """Draw what stays until something else is put there."""
        self._rows[path] = stamp, list(columns)
        self.send(path, np.array([stamp]), self._rows[path][1])

    def send(self, path: str, stamps: Stamps, columns: Iterable[Any]) -> None:
        """Draw what changes all the time."""
        if self._stream is not None and stamps.size:
            index = rr.TimeColumn(TIMELINE, timestamp=stamps.astype('datetime64[ns]'))
            self._stream.send_columns(path, [index], columns)

    def layout(self, blueprint: rrb.Blueprint) -> None:
        """Arrange the views."""
        if self._stream is not None:
            self._stream.send_blueprint(blueprint)

    # shapes

    def picture(
        self, path: str, stamp: int, pixels: Bytes, *, x: float, y: float, w: float, h: float
    ) -> None:
        """Stretch pixels over a rectangle, whose upper left corner is at x, y."""
        rows, columns = pixels.shape[:2]
        image = rr.Image.columns(buffer=[pixels.tobytes()], format=[_format(columns, rows)])
        place = rr.Transform3D.columns(
            translation=[[x, y, 0.0]], scale=[[w / columns, h / rows, 1.0]]
        )
        self.put(path, stamp, [*image, *place])

    def lines(self, path: str, stamp: int, strips: Sequence[Any], colour: Colour) -> None:
        """Draw thin lines."""
        columns = rr.LineStrips2D.columns(
            strips=[np.array(strip, np.float32) for strip in strips],
            colors=[colour] * len(strips),
            radii=rr.Radius.ui_points([0.5] * len(strips)),
        )
        self.put(path, stamp, columns.partition([len(strips)]))

    def dots(
        self, path: str, stamp: int, dots: Sequence[_Dot], *, order: float = _IN_FRONT
    ) -> None:
        """Draw dots with texts below them."""
        columns = rr.Points2D.columns(
            positions=[[dot.x, dot.y] for dot in dots],
            radii=rr.Radius.ui_points([dot.radius for dot in dots]),
            colors=[dot.colour for dot in dots],
            labels=[dot.text for dot in dots],
        )
        show = rr.Points2D.columns(show_labels=[True], draw_order=[order])
        self.put(path, stamp, [*columns.partition([len(dots)]), *show])


@dataclass(frozen=True, kw_only=True)
class _Dot:
    """A dot, whose radius is in points of the screen, and the text below it."""

    x: float
    y: float
    text: str = ''
    colour: Colour = _GREY
    radius: float = 0.0


def _format(width: int, height: int) -> rr.components.ImageFormat:
    return rr.components.ImageFormat(
        width=width, height=height, color_model='RGB', channel_datatype='U8'
    )


class Scene:
    """
    What is known of the twins, and how it is drawn.

    Parameters
    ----------
    energy_transfer : callable
        What the landscape shows.
    executor : Executor
        What computes it, so that nothing waits for it.
    name : str
        Of the recording, for the viewer.
    use : {'live', 'bag', 'picture'}
        Whether the latest is shown, or a throw, or a throw without what is for the mouse.

    Attributes
    ----------
    digest : Digest
        What reads the messages.

    """

    def __init__(
        self, energy_transfer: EnergyTransfer, executor: Executor, *, name: str, use: Use
    ) -> None:
        self.digest = Digest()
        self._name = name
        self._survey = lambda *request: executor.submit(_survey, energy_transfer, *request)
        self._is_live = use == 'live'
        self._is_picture = use == 'picture'
        self._canvas = _Canvas()
        self._twins: dict[str, _TwinScene] = {}
        self._has_log = False
        self._arranged: Any = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing has come that could be drawn."""
        return not self._twins

    @property
    def moment(self) -> int | None:
        """When there is most to see: in the last contact that is there as a whole. [ns]"""
        moments = [twin.moment for twin in self._twins.values() if twin.moment is not None]
        return moments[0] if moments else None  # whose views are in front

    def connect(self, stream: rr.RecordingStream | None) -> None:
        """Draw into a recording from now on, with what is there already; or into none."""
        if stream is not None:
            stream.send_recording_name(self._name)
        self._canvas.connect(stream)
        self._arranged = None
        if self._is_live:
            self._arrange()

    def show(self, messages: Iterable[Message]) -> None:
        """Draw messages."""
        for prefix, part in self.digest.take(messages):
            if isinstance(part, LogLine):
                self._has_log = True
                self._log(part)
                continue
            if prefix not in self._twins:
                self._twins[prefix] = _TwinScene(prefix, self._canvas, self._survey)
            self._twins[prefix].draw(part)
        for twin in self._twins.values():
            twin.draw_landscapes()
        if self._is_live:
            self._arrange()

    def finish(self, *, is_waiting: bool) -> None:
        """Draw what is still being computed, if it is waited for, and arrange everything."""
        for twin in self._twins.values():
            twin.draw_landscapes(is_waiting=is_waiting)
        self._arrange()

    def _log(self, line: LogLine) -> None:
        level = next((name for bound, name in _LEVELS if line.level >= bound), 'DEBUG')
        text = f'{line.node}: {line.text}'
        self._canvas.send(
            _LOG, np.array([line.stamp]), rr.TextLog.columns(text=[text], level=[level])
        )

    def _arrange(self) -> None:
        """Send the layout if there is none yet, or it has to be another."""
        twins = {prefix: twin.view_key() for prefix, twin in self._twins.items()}
        if not twins or (twins, self._has_log) == self._arranged:
            return
        self._arranged = twins, self._has_log
        layouts = [
            twin.layout(is_live=self._is_live, has_log=self._has_log)
            for twin in self._twins.values()
        ]
        speed = next(iter(self._twins.values())).playback_speed
        self._canvas.layout(
            rrb.Blueprint(
                layouts[0] if len(layouts) == 1 else rrb.Tabs(*layouts),
                rrb.TopPanel(state='hidden' if self._is_picture else 'expanded'),
                rrb.BlueprintPanel(state='hidden'),
                rrb.SelectionPanel(state='hidden'),
                rrb.TimePanel(
                    state='collapsed',
                    timeline=TIMELINE,
                    playback_speed=1.0 if self._is_live else speed,
                    play_state='following' if self._is_live else 'paused',
                ),
            )
        )


class _TwinScene:
    """One of the twins."""

    def __init__(self, prefix: str, canvas: _Canvas, survey: Callable[..., Future[Any]]) -> None:
        self.moment: int | None = None
        self._prefix = prefix
        self._root = rr.new_entity_path(prefix.split('/')) if prefix.strip('/') else ''
        self._canvas = canvas
        self._survey = survey
        self._rig: Rig | None = None
        self._settings: Mapping[str, Any] = {}
        self._largest_strain = _STRAIN
        self._recommended: tuple[float, float] | None = None
        self._beside: set[str] = set()
        self._landscape_stamp = 0
        self._landscapes: list[tuple[int, Future[_Landscape]]] = []
        self._set_styles()

    def _path(self, name: str) -> str:
        return f'{self._root}/{name}'

    def _set_styles(self) -> None:
        for name, lines, colours in (
            ('position', ['plate', 'projectile'], [_GREY, _BLUE]),
            ('velocity', ['plate', 'projectile'], [_GREY, _BLUE]),
            ('force', ['at the plate', 'at the projectile'], [_GREY, _BLUE]),
            ('energy/work', ['work of the plate'], [_GREY]),
            ('energy/projectile', ['projectile'], [_BLUE]),
        ):
            width = 4.0 if name == 'energy/work' else 1.5
            style = rr.SeriesLines(names=lines, colors=colours, widths=[width] * len(lines))
            self._canvas.style(self._path(name), style)
        for name, points, colour in (
            ('energy/layer', 'layer', _ORANGE),
            ('energy/total', 'projectile + layer', _GREEN),
        ):
            self._canvas.style(
                self._path(name), rr.SeriesPoints(names=points, colors=colour, marker_sizes=1.5)
            )
        self._canvas.style(
            self._path('phase'),
            rr.StateConfiguration(values=list(_PHASES), colors=list(_PHASES.values())),
        )
        self._canvas.style(
            self._path('side/layer'),
            rr.Image.from_fields(format=_format(1, _CELLS), magnification_filter='linear'),
        )
        self._canvas.style(
            self._path('strain/picture'), rr.Image.from_fields(magnification_filter='linear')
        )

    def draw(self, part: Part) -> None:
        """Draw something that the messages say."""
        match part:
            case Motion():
                self._draw_motion(part)
            case Places():
                self._draw_places(part.stamps, part.position)
            case Beside():
                self._draw_beside(part)
            case LayerStrain():
                self._draw_layer(part)
            case LayerEnergy():
                self._draw_series('energy/layer', part.stamps, _MILLI * part.layer)
                self._draw_series('energy/total', part.stamps, _MILLI * part.total)
            case ThrowPicture():
                self._draw_picture(part)
            case PhaseChange():
                columns = rr.StateChange.columns(state=[part.phase])
                self._canvas.put(self._path('phase'), part.stamp, columns)
            case Report():
                self._draw_report(part)
            case RigChange():
                self._take_rig(part)

    # series

    def _draw_series(self, name: str, stamps: Stamps, values: Floats) -> None:
        self._canvas.send(self._path(name), stamps, rr.Scalars.columns(scalars=values))

    def _draw_motion(self, motion: Motion) -> None:
        self._draw_series('position', motion.stamps, _MILLI * motion.position)
        self._draw_series('velocity', motion.stamps, motion.velocity)
        self._draw_series('force', motion.stamps, motion.force * [-1.0, 1.0])
        self._draw_series('energy/work', motion.stamps, _MILLI * motion.plate_work)
        self._draw_series('energy/projectile', motion.stamps, _MILLI * motion.projectile_energy)
        self._draw_places(motion.stamps, motion.position)

    def _draw_beside(self, beside: Beside) -> None:
        name, factor, lines, colours = _BESIDE[beside.kind]
        if beside.kind not in self._beside:
            self._beside.add(beside.kind)
            self._canvas.style(
                self._path(name),
                rr.SeriesLines(names=lines, colors=colours, widths=[1.0] * len(lines)),
            )
        self._draw_series(name, beside.stamps, factor * beside.position)

    # side view, in mm, downwards as Rerun has it

    def _draw_places(self, stamps: Stamps, position: Floats) -> None:
        for name, height in zip(('plate', 'projectile'), position.T, strict=True):
            translation = np.zeros((stamps.size, 3))
            translation[:, 1] = -_MILLI * height
            columns = rr.Transform3D.columns(translation=translation)
            self._canvas.send(self._path(f'side/{name}'), stamps, columns)
        # what is above the view can be told by its text
        translation[:, 1] = translation[:, 1].clip(min=-_TOP * self._bounds()[2])
        columns = rr.Transform3D.columns(translation=translation)
        self._canvas.send(self._path('side/projectile_text'), stamps, columns)

    def _draw_layer(self, layer: LayerStrain) -> None:
        """Colour cells that are even in height, wherever their matter is."""
        if self._rig is None:
            return
        heights = layer.heights()
        bottom, top = heights[:, 0], heights[:, -1]
        places = (np.arange(_CELLS)[::-1] + 0.5) / _CELLS
        strain = np.array(
            [
                np.interp(low + places * (high - low), height, values)
                for low, high, height, values in zip(
                    bottom, top, heights, layer.strain, strict=True
                )
            ]
        )
        pixels = _colours(strain, -self._largest_strain, self._largest_strain, _SIGNED)
        diameter = _MILLI * self._rig.layer.diameter
        translation = np.zeros((layer.stamps.size, 3))
        translation[:, 0] = -0.5 * diameter
        translation[:, 1] = -_MILLI * top
        scale = np.ones((layer.stamps.size, 3))
        scale[:, 0] = diameter
        scale[:, 1] = _MILLI * (top - bottom) / _CELLS
        self._canvas.send(
            self._path('side/layer'),
            layer.stamps,
            [
                *rr.Image.columns(buffer=[row.tobytes() for row in pixels]),
                *rr.Transform3D.columns(translation=translation, scale=scale),
            ],
        )

    def _take_rig(self, change: RigChange) -> None:
        rig, stamp = change.rig, change.stamp
        self._rig, self._settings = rig, change.settings
        diameter, length = _MILLI * rig.layer.diameter, _MILLI * rig.projectile.length
        for name, colour, w, y, h in (
            ('plate', _GREY, _PLATE * diameter, 0.0, 0.15 * diameter),
            ('projectile', _BLUE, diameter, -length, length),
        ):
            path = self._path(f'side/{name}/body')
            pixel = np.array([[colour]], np.uint8)
            self._canvas.picture(path, stamp, pixel, x=-0.5 * w, y=y, w=w, h=h)
        for name, text, y in (
            ('plate/text', 'plate', 0.0),
            ('plate/layer_text', 'layer', -0.5 * _MILLI * rig.layer.thickness),
            ('projectile_text', 'projectile', -0.5 * length),
        ):
            dot = _Dot(x=0.95 * diameter, y=y, text=text, colour=_WHITE)
            self._canvas.dots(self._path(f'side/{name}'), stamp, [dot])
        self._draw_ruler(stamp)
        self._request_landscape(stamp)

    def _bounds(self) -> tuple[float, float, float]:
        """Return half the width, lowest and highest height of the side view. [mm]"""
        if self._rig is None:
            return 15.0, -5.0, 60.0
        diameter = _MILLI * self._rig.layer.diameter
        content = _MILLI * (self._rig.layer.thickness + self._rig.projectile.length)
        return 1.25 * diameter, -0.4 * diameter, 1.35 * content + 0.8 * diameter

    def _draw_ruler(self, stamp: int) -> None:
        width, low, high = self._bounds()
        ticks = _ticks(0.0, high, 8)
        x = -0.5 * _PLATE * _MILLI * self._rig.layer.diameter - 0.03 * width if self._rig else 0.0
        strips = [[(x, 0.0), (x, -ticks[-1])]]
        strips += [[(x - 0.06 * width, -tick), (x, -tick)] for tick in ticks]
        self._canvas.lines(self._path('side/ruler'), stamp, strips, _GREY)
        lift = 0.009 * (high - low)  # texts stand below their dots
        self._canvas.dots(
            self._path('side/ruler/texts'),
            stamp,
            [_Dot(x=x - 0.17 * width, y=-tick - lift, text=f'{tick:g}') for tick in ticks],
        )

    # waves in the layer

    def _draw_picture(self, picture: ThrowPicture) -> None:
        end = picture.ejection_time or picture.times[-1]
        contact = picture.strain[picture.times <= end]
        self._largest_strain = _rounded_up(1.5 * float(np.abs(contact).max()))
        chart = _Chart(
            self._canvas,
            self._path('strain'),
            picture.start,
            height=_STRAIN_HEIGHT,
            x=_Axis(0.0, _MILLI * float(picture.times[-1])),
            y=_Axis(0.0, _MILLI * picture.thickness),
        )
        limit = self._largest_strain
        chart.draw(
            _colours(picture.strain.T[::-1], -limit, limit, _SIGNED),
            titles=('t (ms)', 'y (mm)'),
        )
        bar = _Axis(-100.0 * limit, 100.0 * limit)
        chart.draw_bar(bar, _SIGNED, title='ε (%)')
        if picture.ejection_time is not None:
            x = chart.x_at(_MILLI * picture.ejection_time)
            chart.draw_line('ejection', x, f'tₑ {_MILLI * picture.ejection_time:.2f} ms')
            middle = _MOMENT * picture.ejection_time * SECOND / picture.time_scale
            self.moment = picture.start + round(middle)
        stamps = picture.stamps()
        strips = np.zeros((stamps.size, 2, 2), np.float32)
        strips[:, :, 0] = np.linspace(0.0, _WIDTH, stamps.size)[:, None]
        strips[:, 1, 1] = _STRAIN_HEIGHT
        gone = np.append(stamps, 2 * stamps[-1] - stamps[-2])
        columns = rr.LineStrips2D.columns(
            strips=strips,
            colors=[_RED] * stamps.size,
            radii=rr.Radius.ui_points([1.0] * stamps.size),
        ).partition([1] * stamps.size + [0])
        self._canvas.send(self._path('strain/now'), gone, columns)

    # what is best

    def _request_landscape(self, stamp: int) -> None:
        """Have it computed; whatever was asked for last is shown last."""
        self._landscape_stamp = max(stamp, self._landscape_stamp)
        if self._rig is not None:
            future = self._survey(self._rig, self._settings, self._recommended)
            self._landscapes.append((self._landscape_stamp, future))

    def draw_landscapes(self, *, is_waiting: bool = False) -> None:
        """Draw the landscapes that are there by now, or, waiting for them, all."""
        while self._landscapes and (is_waiting or self._landscapes[0][1].done()):
            stamp, future = self._landscapes.pop(0)
            self._draw_landscape(stamp, future.result())

    def _draw_landscape(self, stamp: int, landscape: _Landscape) -> None:
        chart = _Chart(
            self._canvas,
            self._path('landscape'),
            stamp,
            height=_LANDSCAPE_HEIGHT,
            x=_Axis.over(_MILLI * landscape.thickness),
            y=_Axis.over(landscape.wave_speed),
        )
        values = landscape.energy_transfer
        highest = _highest(values)
        chart.draw(_colours(values[::-1], 0.0, highest, _UNSIGNED), titles=('Lₛ (mm)', 'cₛ (m/s)'))
        chart.draw_bar(_Axis(0.0, highest), _UNSIGNED, title=_ALPHA)
        chart.draw_marks(
            [(_MILLI * mark.thickness, mark.wave_speed, mark.text) for mark in landscape.marks]
        )

    # words

    def _draw_report(self, report: Report) -> None:
        if report.kind == THROW_RESULT:
            text = _throw_text(report)
        else:
            text = _recommendation_text(report)
            self._recommended = None
            match report.values.get('thickness'), report.values.get('wave_speed'):
                case float(thickness), float(wave_speed) if _are_layer(thickness, wave_speed):
                    self._recommended = thickness, wave_speed
            self._request_landscape(report.stamp)
        columns = rr.TextDocument.columns(text=[text], media_type=['text/markdown'])
        self._canvas.put(self._path(report.kind), report.stamp, columns)

    # layout

    @property
    def _period(self) -> float:
        """Of the plate, by the clock of the stamps. [s]"""
        if self._rig is None:
            return 1.0
        return 1.0 / (self._rig.engine.frequency * float(self._settings['time_scale']))

    @property
    def playback_speed(self) -> float:
        """At which a throw can be followed. [-]"""
        return min(0.5 * self._period, 1.0)

    def view_key(self) -> Any:
        """Return what another layout is needed for."""
        return self._period, self._bounds(), RESIDUAL in self._beside

    def layout(self, *, is_live: bool, has_log: bool) -> rrb.Container:
        """Arrange all there is of the twin."""
        before, after = _BEFORE * self._period, _AFTER * self._period
        if is_live:
            before, after = max(_LIVE * self._period, _SHORTEST), 0.0
        window = rrb.TimeAxis(
            view_range=rr.TimeRange(
                start=rrb.TimeRangeBoundary.cursor_relative(seconds=-before),
                end=rrb.TimeRangeBoundary.cursor_relative(seconds=after),
            )
        )
        series = [
            rrb.TimeSeriesView(
                origin=self._path(name),
                name=title,
                axis_x=window,
                plot_legend=rrb.PlotLegend('RightTop' if name == 'force' else 'LeftTop'),
            )
            for name, title in (
                ('position', 'Position z (mm)'),
                ('velocity', 'Velocity v (m/s)'),
                ('force', 'Compressive force F (N)'),
                ('energy', 'Energy (mJ)'),
                ('residual', 'Model less measurement (µm)'),
            )
            if name != 'residual' or RESIDUAL in self._beside
        ]
        half, low, high = self._bounds()
        side = rrb.Spatial2DView(
            origin=self._path('side'),
            name='Rig, z (mm)',
            visual_bounds=rrb.VisualBounds2D(x_range=[-half, half], y_range=[-high, -low]),
        )
        phase = rrb.StateTimelineView(origin=self._path('phase'), name='Phase', time_view=window)
        charts = [
            _chart_view(self._path(name), title, height)
            for name, title, height in (
                ('strain', 'Strain ε(y, t) in the throw', _STRAIN_HEIGHT),
                ('landscape', f'Energy transfer {_ALPHA}(Lₛ, cₛ)', _LANDSCAPE_HEIGHT),
            )
        ]
        throw = rrb.TextDocumentView(origin=self._path(THROW_RESULT), name='Throw')
        best = rrb.TextDocumentView(origin=self._path(RECOMMENDATION), name='Recommended layer')
        right, shares = [*charts, best], [3.0, 4.1, 3.6]
        if has_log:
            columns = rrb.TextLogColumns(
                timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
                text_log_columns=['LogLevel', 'Body'],
            )
            right.append(rrb.TextLogView(origin=_LOG, name='Log', columns=columns))
            shares.append(1.6)
        return rrb.Horizontal(
            rrb.Vertical(side, throw, row_shares=[3.0, 2.1]),
            rrb.Vertical(phase, *series, row_shares=[1.4, *[3.0] * len(series)]),
            rrb.Vertical(*right, row_shares=shares),
            column_shares=[2.5, 4.2, 4.2],
            name=self._prefix or '/',
        )


def _chart_view(origin: str, title: str, height: float) -> rrb.Spatial2DView:
    """Make the view of a `_Chart`."""
    return rrb.Spatial2DView(
        origin=origin,
        name=title,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-0.1 * _WIDTH, 1.13 * _WIDTH],
            y_range=[-2.5 * _LINE, height + 4.5 * _LINE],
        ),
    )


def _are_layer(thickness: float, wave_speed: float) -> bool:
    """Tell whether there could be a layer with such values."""
    return all(_SMALLEST < value < _LARGEST for value in (thickness, wave_speed))


@dataclass(frozen=True, kw_only=True)
class _Mark:
    """A layer in the landscape."""

    thickness: float
    wave_speed: float
    text: str


@dataclass(frozen=True, kw_only=True)
class _Landscape:
    """Energy transfer, a row for each wave speed, and layers to be marked."""

    thickness: Floats
    wave_speed: Floats
    energy_transfer: Floats
    marks: tuple[_Mark, ...]


def _survey(
    energy_transfer: EnergyTransfer,
    rig: Rig,
    settings: Mapping[str, Any],
    recommended: tuple[float, float] | None,
) -> _Landscape:
    """Compute what the landscape shows, as far as layers are considered, and those marked."""
    now = rig.layer.thickness, rig.layer.wave_speed
    places = [now] if recommended is None else [now, recommended]
    ranges = [
        np.geomspace(
            min(settings[f'recommendation.{name}_min'], *values),
            max(settings[f'recommendation.{name}_max'], *values),
            count,
        )
        for name, values, count in zip(
            ('thickness', 'wave_speed'), zip(*places, strict=True), _LANDSCAPE, strict=True
        )
    ]
    thickness, wave_speed = ranges
    at_places = energy_transfer(rig, *np.array(places).T)
    words = [f'{_ALPHA} {value:.3f}' if value > 0.0 else 'no release' for value in at_places]
    names = ['now', 'recommended']
    if recommended is not None and np.allclose(now, recommended, rtol=0.01):
        places, names = [now], ['now, as recommended']
    if rig.layer.loss_tangent:
        names = [f'{name}, without loss' for name in names]
    for stride in _STRIDES:
        begin = time.monotonic()
        values = energy_transfer(rig, thickness[None, ::stride], wave_speed[::stride, None])
        if 4.0 * (time.monotonic() - begin) > _BUDGET:  # what the next one takes
            break
    return _Landscape(
        thickness=thickness,
        wave_speed=wave_speed,
        energy_transfer=values,
        marks=tuple(
            _Mark(thickness=place[0], wave_speed=place[1], text=f'{name}: {word}')
            for name, place, word in zip(names, places, words, strict=False)
        ),
    )


@dataclass(frozen=True)
class _Axis:
    """From one value to another."""

    low: float
    high: float
    is_log: bool = False

    @classmethod
    def over(cls, values: Floats) -> _Axis:
        """Make the axis of values that grow by the same factor each."""
        return cls(float(values[0]), float(values[-1]), is_log=True)

    @classmethod
    def around(cls, values: Floats) -> _Axis:
        """Make the axis of pixels around values that grow by the same step or factor each."""
        if values.size > 2 and values[0] > 0.0 and not np.allclose(np.diff(values, 2), 0.0):
            half = 0.5 * math.log(values[1] / values[0])
            low, high = math.exp(-half) * values[0], math.exp(half) * values[-1]
            return cls(float(low), float(high), is_log=True)
        half = 0.5 * (values[1] - values[0])
        return cls(float(values[0] - half), float(values[-1] + half))

    def part(self, value: float) -> float:
        """Return where a value is, from 0 to 1."""
        if self.is_log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def ticks(self, count: int) -> list[float]:
        """Return round values, about so many."""
        if not self.is_log:
            return _ticks(self.low, self.high, count)
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)))
        values = [digit * 10.0**decade for decade in decades for digit in (1, 2, 5)]
        return [value for value in values if 0.999 * self.low <= value <= 1.001 * self.high]


class _Chart:
    """
    A picture with axes, of `_WIDTH`. Coordinates are those of the view: x from 0, y from 0 down.

    Texts stand below their dots.
    """

    def __init__(
        self, canvas: _Canvas, path: str, stamp: int, *, height: float, x: _Axis, y: _Axis
    ) -> None:
        self._canvas = canvas
        self._path = path
        self._stamp = stamp
        self._height = height
        self._x, self._y = x, y

    def x_at(self, value: float) -> float:
        """Return where a value of the x-axis is."""
        return _WIDTH * self._x.part(value)

    def y_at(self, value: float) -> float:
        """Return where a value of the y-axis is."""
        return self._height * (1.0 - self._y.part(value))

    def draw(self, pixels: Bytes, *, titles: tuple[str, str]) -> None:
        """Draw picture, frame, ticks and titles."""
        height = self._height
        self._canvas.picture(
            f'{self._path}/picture', self._stamp, pixels, x=0.0, y=0.0, w=_WIDTH, h=height
        )
        x_ticks = [(self.x_at(tick), f'{tick:g}') for tick in self._x.ticks(6)]
        y_ticks = [(self.y_at(tick), f'{tick:g}') for tick in self._y.ticks(5)]
        short, left = 0.4 * _LINE, -1.8 * _LINE
        strips = [[(0.0, 0.0), (_WIDTH, 0.0), (_WIDTH, height), (0.0, height), (0.0, 0.0)]]
        strips += [[(x, height), (x, height + short)] for x, _ in x_ticks]
        strips += [[(-short, y), (0.0, y)] for y, _ in y_ticks]
        self._canvas.lines(f'{self._path}/frame', self._stamp, strips, _GREY)
        dots = [_Dot(x=x, y=height + short, text=text) for x, text in x_ticks]
        dots += [_Dot(x=left, y=y - _LINE, text=text) for y, text in y_ticks]
        dots += [
            _Dot(x=1.075 * _WIDTH, y=height + short, text=titles[0], colour=_WHITE),
            _Dot(x=left, y=-2.6 * _LINE, text=titles[1], colour=_WHITE),
        ]
        self._canvas.dots(f'{self._path}/texts', self._stamp, dots)

    def draw_bar(self, axis: _Axis, ramp: Bytes, *, title: str) -> None:
        """Draw what the colours mean, to the right."""
        left, thick = _WIDTH + _LINE, 1.2 * _LINE
        self._canvas.picture(
            f'{self._path}/bar',
            self._stamp,
            ramp[::-1, None],
            x=left,
            y=0.0,
            w=thick,
            h=self._height,
        )
        dots = [
            _Dot(
                x=left + thick + 1.8 * _LINE,
                y=self._height * (1.0 - axis.part(tick)) - _LINE,
                text=f'{tick:g}',
            )
            for tick in axis.ticks(4)
            if axis.part(tick) > _FOOT
        ]
        dots.append(_Dot(x=left + thick, y=-2.6 * _LINE, text=title, colour=_WHITE))
        self._canvas.dots(f'{self._path}/bar_texts', self._stamp, dots)

    def draw_line(self, name: str, x: float, text: str) -> None:
        """Draw a vertical line with a text at its top."""
        path = f'{self._path}/{name}'
        self._canvas.lines(path, self._stamp, [[(x, 0.0), (x, self._height)]], _BLACK)
        dot = _Dot(x=x, y=-2.6 * _LINE, text=text, colour=_WHITE)
        self._canvas.dots(f'{path}/text', self._stamp, [dot])

    def draw_marks(self, marks: Sequence[tuple[float, float, str]]) -> None:
        """Draw dots with a dark rim, and texts: that of the upper one above it."""
        places = [(self.x_at(x), self.y_at(y)) for x, y, _ in marks]
        top = min(range(len(marks)), key=lambda index: places[index][1])
        rims, dots, texts = [], [], []
        for index, (x, y) in enumerate(places):
            rims.append(_Dot(x=x, y=y, colour=_BLACK, radius=6.0))
            dots.append(_Dot(x=x, y=y, colour=(_WHITE, _RED)[index], radius=4.0))
            is_above = index == top and len(marks) > 1
            texts.append(
                _Dot(
                    x=min(max(x, 0.15 * _WIDTH), 0.85 * _WIDTH),
                    y=y - 3.6 * _LINE if is_above else y + 0.6 * _LINE,
                    text=marks[index][2],
                    colour=_WHITE,
                )
            )
        self._canvas.dots(f'{self._path}/rims', self._stamp, rims, order=_BEHIND)
        self._canvas.dots(f'{self._path}/marks', self._stamp, dots)
        self._canvas.dots(f'{self._path}/mark_texts', self._stamp, texts)


def _ticks(low: float, high: float, count: int) -> list[float]:
    """Return round values between two others, about so many."""
    step = (high - low) / count
    unit = 10.0 ** math.floor(math.log10(step))
    step = unit * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * unit >= 0.99 * step)
    first = math.ceil(low / step - 1e-9)
    return [step * n for n in range(first, math.floor(high / step + 1e-9) + 1)]


def _rounded_up(value: float) -> float:
    """Return a round number that is not less."""
    if value <= 0.0:
        return _STRAIN
    unit = 10.0 ** math.floor(math.log10(value))
    return unit * next(
        factor
        for factor in (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
        if factor * unit >= value
    )


def _highest(values: Floats) -> float:
    """Return the largest value that is a number."""
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size and known.max() > 0.0 else 1.0


# What is said of a throw and of a layer: key, title, and factor from SI units.
_THROW_ROWS = (
    ('ejection_time', 'ejection time tₑ (ms)', 1e3),
    ('ejection_speed', 'ejection speed Vₑ (m/s)', 1.0),
    ('energy_transfer', f'energy transfer {_ALPHA}', 1.0),
    ('last_energy_transfer', f'{_ALPHA} at the last release', 1.0),
    ('peak_plate_speed', 'plate speed Vₚ* (m/s)', 1.0),
    ('peak_strain', 'peak strain (%)', 1e2),
    ('peak_acceleration', 'peak acceleration (g)', 1.0 / STANDARD_GRAVITY),
    ('peak_force', 'peak force on plate (N)', 1.0),
    ('plate_work', 'work of the plate (mJ)', 1e3),
    ('apex_height', 'apex (mm)', 1e3),
    ('lead', 'release known before (ms)', 1e3),
    ('residual.position_rms', 'model off by, rms (µm)', 1e6),
    ('residual.ejection_time_error', 'and tₑ by (µs)', 1e6),
    ('residual.ejection_speed_error', 'and Vₑ by (m/s)', 1.0),
)

_LAYER_ROWS = (
    ('thickness', 'thickness Lₛ (mm)', 1e3),
    ('wave_speed', 'wave speed cₛ (m/s)', 1.0),
    ('youngs_modulus', 'modulus Eₛ (kPa)', 1e-3),
    ('energy_transfer', f'energy transfer {_ALPHA}', 1.0),
    ('ejection_time', 'ejection time tₑ (ms)', 1e3),
    ('ejection_speed', 'ejection speed Vₑ (m/s)', 1.0),
    ('peak_strain', 'peak strain (%)', 1e2),
    ('peak_acceleration', 'peak acceleration (g)', 1.0 / STANDARD_GRAVITY),
)


# What other models are called where there is little room.
_MODELS = {
    'travelling_wave': 'wave',
    'finite_difference': 'grid',
    'finite_difference_elastic': 'elastic',
    'finite_difference_glued': 'glued on',
    'spring_mass': 'spring',
}


def _throw_text(report: Report) -> str:
    """Write what a throw gave, and what other models say."""
    values = report.values
    models = [
        key.removesuffix('.ejection_time') for key in values if key.endswith('.ejection_time')
    ]
    throw = values.get('throw')
    stages = {'final': 'in all', 'predicted': 'as it will be'}
    stage = stages.get(str(values.get('stage')), 'up to the release')
    if not values.get('recontacts'):
        values = {key: value for key, value in values.items() if not key.startswith('last_')}
    heads = ['twin', *(_MODELS.get(model, model) for model in models)]
    text = _table(values, _THROW_ROWS, heads, ['', *(f'{model}.' for model in models)])
    number = f'{throw:.0f}' if isinstance(throw, float) else '?'
    return f'**Throw {number}**, {stage}\n\n{text}{_strain_note(values)}'


def _strain_note(values: Mapping[str, Any]) -> str:
    strain, limit = values.get('peak_strain'), values.get('max_strain')
    if isinstance(strain, float) and isinstance(limit, float) and strain > limit:
        return f'\nStrain beyond {100.0 * limit:.3g} %: a real layer is no longer linear.\n'
    return ''


def _recommendation_text(report: Report) -> str:
    """Write what layer is recommended, beside that which is there."""
    if 'now.thickness' not in report.values:
        return f'{report.message}\n'
    vary = report.values.get('vary')
    choices = {'thickness': 'other thickness', 'wave_speed': 'other wave speed', 'both': 'both'}
    heads = ['now', *(f'**{head}**' if key == vary else head for key, head in choices.items())]
    prefixes = ['now.', *(f'by_{key}.' for key in choices)]
    if vary == 'library':
        heads.append(f'**{report.values.get("layer")}**')
        prefixes.append('')
    return _table(report.values, _LAYER_ROWS, heads, prefixes)


def _table(
    values: Mapping[str, Any],
    rows: Sequence[tuple[str, str, float]],
    heads: Sequence[str],
    prefixes: Sequence[str],
) -> str:
    """Write a table in Markdown, of those rows that there is something of."""
    lines = ['| | ' + ' | '.join(heads) + ' |', '|:--|' + '--:|' * len(heads)]
    for key, title, factor in rows:
        cells = [_cell(values.get(prefix + key), factor) for prefix in prefixes]
        if any(cells):
            lines.append(f'| {title} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines) + '\n'


def _cell(value: Any, factor: float) -> str:
    if not isinstance(value, float):
        return ''
    return f'{factor * value:.{_DIGITS}g}'


# maps


@dataclass(frozen=True, kw_only=True, eq=False)
class MapAxis:
    """
    An axis of a map.

    Parameters
    ----------
    title : str
        What it is, with its unit.
    values : ndarray, shape (n,)
        In that unit; from each to the next by the same step, or by the same factor.

    """

    title: str
    values: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class MapPanel:
    """
    What a map shows.

    Parameters
    ----------
    name : str
        Of the entity.
    title, symbol : str
        What it is, and how that is written.
    values : ndarray, shape (n, m)
        Along the first and the second axis, from 0 on; NaN where there is none.
    highest : float or None
        Where the colours end; at the largest value if not given.

    """

    name: str
    title: str
    symbol: str
    values: Floats
    highest: float | None = None


def draw_landscape(
    stream: rr.RecordingStream,
    *,
    name: str,
    axes: tuple[MapAxis, MapAxis],
    panels: Sequence[MapPanel],
    marks: Sequence[tuple[float, float, str]] = (),
) -> None:
    """
    Draw maps over two axes side by side. The values are beside them, as tensors.

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
        Up to two places to be marked in each: values on the axes, and a text.

    """
    stream.send_recording_name(name)
    canvas = _Canvas()
    canvas.connect(stream)
    x, y = axes
    for panel in panels:
        chart = _Chart(
            canvas,
            f'/{panel.name}',
            0,
            height=_LANDSCAPE_HEIGHT,
            x=_Axis.around(x.values),
            y=_Axis.around(y.values),
        )
        highest = panel.highest or _highest(panel.values)
        pixels = _colours(panel.values.T[::-1], 0.0, highest, _UNSIGNED)
        chart.draw(pixels, titles=(x.title, y.title))
        chart.draw_bar(_Axis(0.0, highest), _UNSIGNED, title=panel.symbol)
        if marks:
            chart.draw_marks(marks)
        tensor = rr.Tensor(panel.values, dim_names=[x.title, y.title])
        stream.log(f'/values/{panel.name}', tensor, static=True)
    views = [_chart_view(f'/{each.name}', each.title, _LANDSCAPE_HEIGHT) for each in panels]
    canvas.layout(
        rrb.Blueprint(
            rrb.Vertical(*views),
            rrb.BlueprintPanel(state='hidden'),
            rrb.SelectionPanel(state='hidden'),
            rrb.TimePanel(state='hidden', timeline=TIMELINE),
        )
    )


# where it goes


def new_stream() -> rr.RecordingStream:
    """Begin a recording, which goes nowhere yet."""
    return rr.RecordingStream(
        APPLICATION, batcher_config=rr.ChunkBatcherConfig.LOW_LATENCY(), send_properties=False
    )


def save_to(stream: rr.RecordingStream, path: Path, *, is_live: bool) -> None:
    """
    Have a recording written to a file.

    Raises
    ------
    OSError
        If that cannot be done.

    """
    try:
        stream.save(path, write_footer=not is_live)  # whose size grows with time, in memory
    except RuntimeError as error:
        raise OSError(str(error)) from None


def connect_to(stream: rr.RecordingStream, port: int) -> None:
    """Have a recording sent to a viewer, or to the next one, if the last has ended."""
    stream.connect_grpc(_url(port))


def serve_at(stream: rr.RecordingStream, port: int) -> None:
    """Have a recording sent to viewers that connect, on this machine only."""
    stream.set_sinks(
        rr.GrpcServerSink(bind_ip=HOST, port=port, server_memory_limit=_SERVER_MEMORY)
    )


def flush(stream: rr.RecordingStream, seconds: float) -> bool:
    """Send what waits, and tell whether it went."""
    try:
        stream.flush(timeout_sec=seconds)
    except RuntimeError:
        return False
    return True


def go_to(stream: rr.RecordingStream, port: int, moment: int) -> None:
    """Have a viewer show some moment of a recording that was sent to it, if it can do that."""
    store = f'Recording:{APPLICATION}:{stream.get_recording_id()}'
    with contextlib.suppress(RuntimeError, ConnectionError):
        client = ViewerClient.connect(_url(port))
        _wait_for(lambda: any(each.store_id == store for each in client.get_state().recordings))
        client.set_time(
            TIMELINE, timestamp=np.datetime64(moment, 'ns'), play_state='paused', recording=store
        )


def photograph(recording: Path, *, size: tuple[int, int], moment: int | None) -> bytes:
    """
    Show a recording in a viewer without a window, and return what it looks like, as PNG.

    Raises
    ------
    ViewerError
        If there is no viewer, or it finds no graphics.

    """
    width, height = size
    options = ('--headless', '--window-size', f'{width}x{height}', recording)
    with Viewer(free_port(), *options) as viewer:
        try:
            client = ViewerClient.connect(_url(viewer.port))
            _wait_for(lambda: _has_loaded(client))
            if moment is not None:
                client.set_time(
                    TIMELINE, timestamp=np.datetime64(moment, 'ns'), play_state='paused'
                )
            return _still_picture(client)
        except (RuntimeError, ConnectionError) as error:
            viewer.check()
            raise ViewerError(f'the viewer does not draw: {error}') from None


def _has_loaded(client: ViewerClient) -> bool:
    state = client.get_state()
    return bool(state.recordings and state.views and not state.loading)


def _still_picture(client: ViewerClient) -> bytes:
    """Return a picture in which nothing moves any more, as axes do for a while."""
    picture = b''
    for _ in range(_MOST_PICTURES):
        before, picture = picture, client.take_screenshot()
        if picture == before:
            break
        time.sleep(_PAUSE)
    return picture


def _wait_for(is_so: Callable[[], bool]) -> None:
    """Ask until it is so."""
    deadline = time.monotonic() + _ANSWER_TIME
    while not is_so():
        if time.monotonic() > deadline:
            raise RuntimeError(f'not within {_ANSWER_TIME:g} s')
        time.sleep(_PAUSE)


def _url(port: int) -> str:
    return f'rerun+http://{HOST}:{port}/proxy'
