# SPDX-License-Identifier: Apache-2.0
"""Twins in Rerun: the rig to scale, series, waves in the layer, the best layer, and words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
import math

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.configuration import Settings
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.core.rig import Rig, STANDARD_GRAVITY
from soft_throw_ros.recording import rerun_canvas as drawing
from soft_throw_ros.recording import timeseries as series
from soft_throw_ros.recording.energy_map import compute_energy_map, EnergyMap
from soft_throw_ros.recording.message import Message
from soft_throw_ros.recording.timeseries import Floats, SECOND, Stamps, ThrowStart

_MILLI = 1e3

_PHASES = {
    'rest': (0x60, 0x60, 0x60),
    'contact': drawing.ORANGE,
    'flight': drawing.BLUE,
    'landed': drawing.GREEN,
    'returning': drawing.PURPLE,
}

_SERIES: Mapping[str, tuple[tuple[str, ...], tuple[drawing.Colour, ...], float]] = {
    'position': (('plate', 'projectile'), (drawing.GREY, drawing.BLUE), 1.5),
    'velocity': (('plate', 'projectile'), (drawing.GREY, drawing.BLUE), 1.5),
    'force': (('at the plate', 'at the projectile'), (drawing.GREY, drawing.BLUE), 1.5),
    'energy/plate_work': (('work of the plate',), (drawing.GREY,), 4.0),
    'energy/projectile': (('projectile',), (drawing.BLUE,), 1.5),
    'energy/layer': (('layer',), (drawing.ORANGE,), 1.5),
    'energy/total': (('projectile + layer',), (drawing.GREEN,), 1.5),
    'position/measured': (
        ('plate, measured', 'projectile, measured'),
        (drawing.RED, drawing.ORANGE),
        1.0,
    ),
    'position/predicted': (('projectile, predicted',), (drawing.GREEN,), 1.0),
    'residual': (('plate', 'projectile'), (drawing.GREY, drawing.BLUE), 1.0),
}
"""Lines in plots: by entity their names, colours and width."""

_AUXILIARY = {
    TWIN_TOPICS.measured_joint_states: ('position/measured', 1e3),
    TWIN_TOPICS.predicted_joint_states: ('position/predicted', 1e3),
    TWIN_TOPICS.residual: ('residual', 1e6),
}
"""Where positions besides those of the states are drawn, in mm or um."""

_PLOTS = {
    'position': 'Position z (mm)',
    'velocity': 'Velocity v (m/s)',
    'force': 'Compressive force F (N)',
    'energy': 'Energy (mJ)',
    'residual': 'Model less measurement (µm)',
}

_PLOTS_SIZE = 616.0, 650.0
"""Width and height of all plots together in a picture of the default size. [points]"""

_LABEL_SPACE, _LABEL_DISTANCE = 9.0, 20.0
"""What Rerun leaves beside the labels of an axis, and between them at least. [points]"""

_CHARACTERS = {'-': 6.0, '.': 3.5}
_DIGIT = 7.5
"""How wide characters of labels are. [points]"""

_LOG = '/log'

_LEVELS = ((50, 'CRITICAL'), (40, 'ERROR'), (30, 'WARN'), (20, 'INFO'), (0, 'DEBUG'))
"""Levels of rcl_interfaces/Log, and what Rerun calls them."""

_CELLS = 64
"""Into which the layer is divided where it is drawn."""

_PLATE_WIDTH = 1.5
"""Width of the plate, over the diameter of the layer."""

_TOP = 0.93
"""Part of the height of the side view at which the text of what is above it stands."""

_STRAIN_HEIGHT = 58.0
"""Of the chart of strain, whose width is `WIDTH`."""

_DEFAULT_STRAIN = 0.2
"""Where the colours of strain end before a throw has been seen."""

_MOMENT = 0.7
"""When in a contact there is most to see, as part of the ejection time."""

_BEFORE, _AFTER = 0.7, 1.8
"""What plots show before and after the cursor, in periods of the plate."""

_LIVE_BEFORE, _LEAST_LIVE = 4.0, 2.0
"""What they show up to now: in periods of the plate, and at least in seconds."""

_DENSE = 10.0
"""Rows of the layer per period of the plate from which on a line through them is true."""

_RESIDUAL_QUANTILE = 0.9
"""Part of the residuals in a contact that is surely within their plot, unlike spikes."""

_LEAST_RESIDUAL, _DEFAULT_RESIDUAL = 10.0, 100.0  # um

_KEPT_RESIDUALS = 200


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
    decoder : Decoder
        What reads the messages.

    """

    def __init__(
        self,
        name: str,
        *,
        is_live: bool = False,
        is_picture: bool = False,
        throw: ThrowStart | None = None,
    ) -> None:
        self.decoder = series.Decoder()
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
        return not self._twins

    @property
    def moment(self) -> float | None:
        """When in the throw that is shown there is most to see, in time of the rig. [s]"""
        times = [twin.ejection_time for twin in self._twins.values() if twin.ejection_time]
        if self._canvas.throw is None:
            return None
        return _MOMENT * times[0] if times else 0.0

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
        for node, item in self.decoder.decode(messages):
            if isinstance(item, series.LogLine):
                self._log(item)
                continue
            if node not in self._twins:
                self._twins[node] = _TwinView(node, self._canvas, self._pool)
            self._twins[node].draw(item)
        for twin in self._twins.values():
            twin.draw_maps()
        if self._is_live:
            self._arrange()

    def finish(self, *, is_waiting: bool) -> None:
        """Draw what is still being computed, if it is waited for, and arrange everything."""
        for twin in self._twins.values():
            twin.draw_maps(is_waiting=is_waiting)
        self._arrange()

    def _log(self, line: series.LogLine) -> None:
        self._has_log = True
        level = next(name for bound, name in _LEVELS if line.level >= bound)
        columns = rr.TextLog.columns(text=[f'{line.node}: {line.text}'], level=[level])
        self._canvas.send(_LOG, np.array([line.stamp]), columns)

    def _arrange(self) -> None:
        """Send the layout if there is none yet, or it has to be another."""
        views = list(self._twins.values())
        key = [twin.layout_key() for twin in views], self._has_log
        if not views or key == self._arranged:
            return
        self._arranged = key
        layouts = [twin.layout(is_live=self._is_live, has_log=self._has_log) for twin in views]
        self._canvas.arrange(
            rrb.Blueprint(
                layouts[0] if len(layouts) == 1 else rrb.Tabs(*layouts),
                rrb.TopPanel(state='hidden' if self._is_picture else 'expanded'),
                rrb.BlueprintPanel(state='hidden'),
                rrb.SelectionPanel(state='hidden'),
                rrb.TimePanel(
                    state='collapsed',
                    timeline=drawing.STAMP if self._canvas.throw is None else drawing.THROW_TIME,
                    playback_speed=1.0 if self._is_live else min(0.5 * views[0].period, 1.0),
                    play_state='following' if self._is_live else 'paused',
                ),
            )
        )


class _TwinView:
    """One of the twins."""

    def __init__(self, node: str, canvas: drawing.Canvas, pool: ThreadPoolExecutor) -> None:
        self.ejection_time: float | None = None  # in the throw that is shown
        self._node = node
        self._root = rr.new_entity_path(node.split('/')) if node.strip('/') else ''
        self._canvas = canvas
        self._pool = pool
        self._period_of_stamps = 1.0  # of the plate, by the clock of the stamps [s]
        self._rows_per_period = 0.0  # of the layer's states
        self._side = _SideView(canvas, self._path('side'))
        self._recommendation: series.RecommendationSummary | None = None
        self._throw_start = 0
        self._has_residual = False
        self._residuals = np.zeros(0)  # in the last contacts, or in that which is shown
        self._extents: dict[str, tuple[float, float]] = {}  # of plots, in the throw that is shown
        self._maps: list[tuple[int, Future[EnergyMap]]] = []
        self._map_rig: Rig | None = None
        styles = {
            'phase': rr.StateConfiguration(values=list(_PHASES), colors=list(_PHASES.values())),
            'strain/picture': rr.Image.from_fields(magnification_filter='linear'),
            'margin': rr.TextDocument(' '),
        }
        for name, style in styles.items():
            canvas.style(self._path(name), style)

    def _path(self, name: str) -> str:
        return f'{self._root}/{name}'

    def draw(self, item: series.Item) -> None:
        """Draw something that the messages say."""
        match item:
            case series.RigStates():
                self._draw_states(item)
            case series.Positions(topic=TWIN_TOPICS.joint_states):
                self._side.draw_positions(item.stamps, item.position)
            case series.Positions():
                self._draw_auxiliary(item)
            case series.LayerStates():
                self._side.draw_layer(item)
                self._draw_layer_energy(item)
            case series.StrainField():
                self._draw_strain(item)
            case series.PhaseChange():
                columns = rr.StateChange.columns(state=[item.phase])
                self._canvas.put(self._path('phase'), item.stamp, columns)
            case ThrowStart():
                self._throw_start = item.stamp
            case series.ThrowSummary():
                self._write('throw_result', item.stamp, _throw_text(item.values))
                shown, time = self._canvas.throw, item.values.get('ejection_time')
                if shown and item.values.get('throw') == shown.number and isinstance(time, float):
                    self.ejection_time = time
            case series.RecommendationSummary():
                self._recommendation = item
                self._write('recommendation', item.stamp, _recommendation_text(item))
                if item.rig is not None:
                    self._request_map(item.stamp, item.rig, item.settings)
            case series.RigChange():
                self._period_of_stamps = 1.0 / (item.rig.engine.frequency * item.time_scale)
                self._rows_per_period = item.settings['rate.field'] * self._period_of_stamps
                self._side.change_rig(item.stamp, item.rig)
                if self._map_rig != item.rig:  # the map of what is recommended for it is there
                    self._request_map(item.stamp, item.rig, item.settings)

    # plots

    def _draw_series(self, name: str, stamps: Stamps, values: Floats) -> None:
        lines, colours, width = _SERIES[name]
        style = rr.SeriesLines(names=lines, colors=colours, widths=[width] * len(lines))
        self._canvas.style(self._path(name), style)
        self._canvas.send(self._path(name), stamps, rr.Scalars.columns(scalars=values))
        throw = self._canvas.throw
        if throw is not None:
            periods = (stamps - throw.stamp) / (SECOND * self._period_of_stamps)
            shown = values[(periods > 0.3 - _BEFORE) & (periods < 0.3 + _AFTER)]
            known, plot = shown[np.isfinite(shown)], name.partition('/')[0]
            if known.size:
                low, high = self._extents.get(plot, (math.inf, -math.inf))
                self._extents[plot] = min(low, float(known.min())), max(high, float(known.max()))

    def _draw_states(self, states: series.RigStates) -> None:
        stamps = states.stamps
        self._draw_series('position', stamps, _MILLI * states.position)
        self._draw_series('velocity', stamps, states.velocity)
        self._draw_series('force', stamps, states.force * [-1.0, 1.0])
        self._draw_series('energy/plate_work', stamps, _MILLI * states.plate_work)
        self._draw_series('energy/projectile', stamps, _MILLI * states.projectile_energy)
        self._side.draw_positions(stamps, states.position)

    def _draw_auxiliary(self, positions: series.Positions) -> None:
        name, factor = _AUXILIARY[positions.topic]
        values = factor * positions.position
        self._draw_series(name, positions.stamps, values)
        if name == 'residual':
            self._has_residual = True
            self._keep_residuals(positions.stamps, np.abs(values))

    def _keep_residuals(self, stamps: Stamps, values: Floats) -> None:
        """Keep those of a contact; in flight and after a landing they have no bounds."""
        shown = self._canvas.throw
        if shown is None or shown.stamp == self._throw_start:
            since = (stamps - self._throw_start) / SECOND
            values = values[(since >= 0.0) & (since < self._period_of_stamps)]
            known = values[np.isfinite(values)]
            self._residuals = np.concatenate([self._residuals, known])[-_KEPT_RESIDUALS:]

    def _draw_layer_energy(self, layer: series.LayerStates) -> None:
        """Draw lines through rows that are close together in time, and no others."""
        is_dense = self._rows_per_period >= _DENSE
        if not (is_dense or layer.is_throw):
            return
        for name, energy in (('layer', layer.energy), ('total', layer.total_energy)):
            stamps, values = layer.stamps, _MILLI * energy
            if not is_dense:  # the line must not go on to the next throw
                stamps, values = np.append(stamps, stamps[-1] + 1), np.append(values, math.nan)
            self._draw_series(f'energy/{name}', stamps, values)

    # waves in the layer

    def _draw_strain(self, field: series.StrainField) -> None:
        time = field.ejection_time
        contact = field.strain[field.times <= (time or field.times[-1])]
        limit = drawing.round_up(max(1.5 * float(np.abs(contact).max()), 1e-6))
        self._side.largest_strain = limit
        chart = drawing.Chart(
            canvas=self._canvas,
            path=self._path('strain'),
            stamp=field.start,
            height=_STRAIN_HEIGHT,
            x=drawing.Axis(0.0, _MILLI * float(field.times[-1])),
            y=drawing.Axis(0.0, _MILLI * field.thickness),
        )
        pixels = drawing.colours_of(field.strain.T[::-1], -limit, limit, drawing.SIGNED)
        chart.draw(pixels, titles=('t (ms)', 'y (mm)'))
        chart.draw_bar(drawing.Axis(-100.0 * limit, 100.0 * limit), drawing.SIGNED, title='ε (%)')
        if time is not None:
            chart.draw_line('ejection', chart.x_at(_MILLI * time), f'tₑ {_MILLI * time:.2f} ms')
        stamps = field.stamps()
        strips = np.zeros((stamps.size, 2, 2), np.float32)
        strips[:, :, 0] = np.linspace(0.0, drawing.WIDTH, stamps.size)[:, None]
        strips[:, 1, 1] = _STRAIN_HEIGHT
        gone = np.append(stamps, 2 * stamps[-1] - stamps[-2])
        columns = rr.LineStrips2D.columns(
            strips=strips,
            colors=[drawing.RED] * stamps.size,
            radii=rr.Radius.ui_points([1.0] * stamps.size),
        ).partition([1] * stamps.size + [0])
        self._canvas.send(self._path('strain/now'), gone, columns)

    # the best layer

    def _request_map(self, stamp: int, rig: Rig, settings: Settings) -> None:
        """Have a map computed; what was asked for last is shown last."""
        best = self._recommendation
        values: Mapping[str, float | str] = {} if best is None else best.values
        if best is not None and best.rig not in (None, rig):
            values = {}
            self._write('recommendation', stamp, _UNKNOWN_BEST)  # the table was of another rig
        self._map_rig = rig
        stamp = max([stamp, *(earlier for earlier, _ in self._maps)])
        self._maps.append((stamp, self._pool.submit(compute_energy_map, rig, settings, values)))

    def draw_maps(self, *, is_waiting: bool = False) -> None:
        """Draw the maps that are there by now, or, waiting for them, all."""
        while self._maps and (is_waiting or self._maps[0][1].done()):
            stamp, future = self._maps.pop(0)
            found = future.result()
            axes = (
                drawing.MapAxis(title='Lₛ (mm)', values=_MILLI * found.thickness),
                drawing.MapAxis(title='cₛ (m/s)', values=found.wave_speed),
            )
            marks = [(_MILLI * length, speed, text) for length, speed, text in found.marks]
            path, values = self._path('landscape'), found.energy_transfer.T
            drawing.draw_map(
                self._canvas, path, stamp, axes, values, symbol=found.title, marks=marks
            )

    def _write(self, name: str, stamp: int, text: str) -> None:
        columns = rr.TextDocument.columns(text=[text], media_type=['text/markdown'])
        self._canvas.put(self._path(name), stamp, columns)

    # layout

    @property
    def period(self) -> float:
        """Of the plate, on the timeline that is shown. [s]"""
        throw = self._canvas.throw
        return self._period_of_stamps * (1.0 if throw is None else throw.time_scale)

    def _residual_limit(self) -> float:
        """Return how far the plot of the residual goes, 0 if there is none. [um]"""
        if not self._has_residual:
            return 0.0
        if not self._residuals.size:
            return _DEFAULT_RESIDUAL
        most = float(np.quantile(self._residuals, _RESIDUAL_QUANTILE))
        return drawing.round_up(max(1.5 * most, _LEAST_RESIDUAL), (1.0, 2.0, 5.0, 10.0))

    def layout_key(self) -> object:
        """Return what another layout is needed for."""
        return self.period, self._side.bounds, self._residual_limit()

    def layout(self, *, is_live: bool, has_log: bool) -> rrb.Container:
        """Arrange all there is of the twin."""
        before, after = _BEFORE * self.period, _AFTER * self.period
        if is_live:
            before, after = max(_LIVE_BEFORE * self.period, _LEAST_LIVE), 0.0
        window = rrb.TimeAxis(
            view_range=rr.TimeRange(
                start=rrb.TimeRangeBoundary.cursor_relative(seconds=-before),
                end=rrb.TimeRangeBoundary.cursor_relative(seconds=after),
            )
        )
        limit = self._residual_limit()
        plots = {
            name: rrb.TimeSeriesView(
                origin=self._path(name),
                name=title,
                axis_x=window,
                axis_y=rrb.ScalarAxis(range=(-limit, limit)) if name == 'residual' else None,
                plot_legend=rrb.PlotLegend('RightTop' if name == 'force' else 'LeftTop'),
            )
            for name, title in _PLOTS.items()
            if name != 'residual' or limit
        }
        extents = {**self._extents, 'residual': (-limit, limit)}
        height = _PLOTS_SIZE[1] / len(plots)
        axes = {name: _axis_width(*extents.get(name, (0.0, 10.0)), height) for name in plots}
        widest = max(axes.values())
        lanes = [self._indented(plot, widest - axes[name]) for name, plot in plots.items()]
        phase = rrb.StateTimelineView(origin=self._path('phase'), name='Phase', time_view=window)
        strain, landscape = self._path('strain'), self._path('landscape')
        throw = rrb.TextDocumentView(origin=self._path('throw_result'), name='Throw')
        best = rrb.TextDocumentView(origin=self._path('recommendation'), name='Recommended layer')
        right = [
            (drawing.chart_view(strain, 'Strain ε(y, t) in the throw', _STRAIN_HEIGHT), 2.9),
            (drawing.chart_view(landscape, 'Energy transfer α(Lₛ, cₛ)', drawing.MAP_HEIGHT), 3.8),
            (best, 3.8),
        ]
        if has_log:
            columns = rrb.TextLogColumns(
                timeline_columns=[
                    rrb.encodings.TimelineColumn(name, visible=False)
                    for name in (drawing.STAMP, drawing.THROW_TIME)
                ],
                text_log_columns=['LogLevel', 'Body'],
            )
            right.append((rrb.TextLogView(origin=_LOG, name='Log', columns=columns), 2.1))
        views, shares = zip(*right, strict=True)
        return rrb.Horizontal(
            rrb.Vertical(self._side.view(), throw, row_shares=[3.0, 2.1]),
            rrb.Vertical(
                self._indented(phase, widest),
                *lanes,
                row_shares=[0.35 * len(lanes), *[3.0] * len(lanes)],
            ),
            rrb.Vertical(*views, row_shares=shares),
            column_shares=[2.5, 4.2, 4.2],
            name=self._node or '/',
        )

    def _indented(self, view: rrb.View, width: float) -> rrb.View | rrb.Container:
        """Leave room to the left of a view, so that all begin where the widest axis ends."""
        if width < 1.0:
            return view
        margin = rrb.TextDocumentView(origin=self._path('margin'), name=' ', titlebar=False)
        return rrb.Horizontal(margin, view, column_shares=[width, _PLOTS_SIZE[0] - width])


def _axis_width(low: float, high: float, height: float) -> float:
    """Return how much Rerun needs for the labels beside a plot, at powers of ten. [points]"""
    extent = max(high - low, 1e-9)
    step = 10.0 ** math.ceil(math.log10(_LABEL_DISTANCE * extent / height))
    numbers = range(math.ceil(low / step), math.floor(high / step) + 1)
    labels = [f'{step * number:g}' for number in numbers]
    widths = [sum(_CHARACTERS.get(each, _DIGIT) for each in label) for label in labels]
    return _LABEL_SPACE + max(widths, default=_DIGIT)


class _SideView:
    """
    The rig from the side, to scale: in mm, downwards as Rerun has it.

    Attributes
    ----------
    largest_strain : float
        Where the colours of strain end. [-]

    """

    def __init__(self, canvas: drawing.Canvas, path: str) -> None:
        self.largest_strain = _DEFAULT_STRAIN
        self._canvas = canvas
        self._path = path
        self._rig: Rig | None = None
        style = rr.Image.from_fields(
            format=drawing.image_format(1, _CELLS), magnification_filter='linear'
        )
        canvas.style(f'{path}/layer', style)

    def draw_positions(self, stamps: Stamps, position: Floats) -> None:
        """Move plate and projectile."""
        translation = np.zeros((stamps.size, 3))
        for name, height in zip(('plate', 'projectile'), position.T, strict=True):
            translation[:, 1] = -_MILLI * height
            columns = rr.Transform3D.columns(translation=translation)
            self._canvas.send(f'{self._path}/{name}', stamps, columns)
        # what is above the view can be told by its text
        translation[:, 1] = translation[:, 1].clip(min=-_TOP * self.bounds[2])
        columns = rr.Transform3D.columns(translation=translation)
        self._canvas.send(f'{self._path}/projectile_text', stamps, columns)

    def draw_layer(self, layer: series.LayerStates) -> None:
        """Colour cells that are even in height, wherever their matter is."""
        if self._rig is None:
            return
        bottom, top = layer.height[:, 0], layer.height[:, -1]
        parts = (np.arange(_CELLS)[::-1] + 0.5) / _CELLS
        rows = zip(bottom, top, layer.height, layer.strain, strict=True)
        strain = np.array(
            [np.interp(low + parts * (high - low), *curve) for low, high, *curve in rows]
        )
        limit = self.largest_strain
        pixels = drawing.colours_of(strain, -limit, limit, drawing.SIGNED)
        diameter = _MILLI * self._rig.layer.diameter
        nothing, one = np.zeros_like(top), np.ones_like(top)
        corner = np.stack([nothing - 0.5 * diameter, -_MILLI * top, nothing], axis=1)
        scale = np.stack([diameter * one, _MILLI * (top - bottom) / _CELLS, one], axis=1)
        columns = [
            *rr.Image.columns(buffer=[row.tobytes() for row in pixels]),
            *rr.Transform3D.columns(translation=corner, scale=scale),
        ]
        self._canvas.send(f'{self._path}/layer', layer.stamps, columns)

    def change_rig(self, stamp: int, rig: Rig) -> None:
        """Draw the bodies of a rig, and heights to the left of them."""
        self._rig = rig
        diameter, length = _MILLI * rig.layer.diameter, _MILLI * rig.projectile.length
        for name, colour, w, y, h in (
            ('plate', drawing.GREY, _PLATE_WIDTH * diameter, 0.0, 0.15 * diameter),
            ('projectile', drawing.BLUE, diameter, -length, length),
        ):
            path, pixel = f'{self._path}/{name}/body', np.array([[colour]], np.uint8)
            self._canvas.picture(path, stamp, pixel, x=-0.5 * w, y=y, w=w, h=h)
        for name, text, y in (
            ('plate/text', 'plate', 0.0),
            ('plate/layer_text', 'layer', -0.5 * _MILLI * rig.layer.thickness),
            ('projectile_text', 'projectile', -0.5 * length),
        ):
            texts = [drawing.Text(0.95 * diameter, y, text, drawing.WHITE)]
            self._canvas.texts(f'{self._path}/{name}', stamp, texts)
        width, low, high = self.bounds
        ticks = drawing.Axis(0.0, high).ticks(8)
        x = -0.5 * _PLATE_WIDTH * diameter - 0.03 * width
        strips = [[(x, 0.0), (x, -ticks[-1])]]
        strips += [[(x - 0.06 * width, -tick), (x, -tick)] for tick in ticks]
        self._canvas.lines(f'{self._path}/ruler', stamp, strips, drawing.GREY)
        lift = 0.009 * (high - low)  # texts stand below their places
        texts = [drawing.Text(x - 0.17 * width, -tick - lift, f'{tick:g}') for tick in ticks]
        self._canvas.texts(f'{self._path}/ruler/texts', stamp, texts)

    @property
    def bounds(self) -> tuple[float, float, float]:
        """Half the width of the view, and its lowest and highest height. [mm]"""
        if self._rig is None:
            return 15.0, -5.0, 60.0
        diameter = _MILLI * self._rig.layer.diameter
        content = _MILLI * (self._rig.layer.thickness + self._rig.projectile.length)
        return 1.25 * diameter, -0.4 * diameter, 1.35 * content + 0.8 * diameter

    def view(self) -> rrb.Spatial2DView:
        """Make the view."""
        half, low, high = self.bounds
        bounds = rrb.VisualBounds2D(x_range=[-half, half], y_range=[-high, -low])
        return rrb.Spatial2DView(origin=self._path, name='Rig, z (mm)', visual_bounds=bounds)


# what is said of a throw and of a layer: key, title, and factor from SI units
_THROW_ROWS = (
    ('ejection_time', 'ejection time tₑ (ms)', 1e3),
    ('ejection_speed', 'ejection speed Vₑ (m/s)', 1.0),
    ('energy_transfer', 'energy transfer α', 1.0),
    ('last_energy_transfer', 'α at the last release', 1.0),
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
    ('energy_transfer', 'energy transfer α', 1.0),
    ('ejection_time', 'ejection time tₑ (ms)', 1e3),
    ('ejection_speed', 'ejection speed Vₑ (m/s)', 1.0),
    ('peak_strain', 'peak strain (%)', 1e2),
    ('peak_acceleration', 'peak acceleration (g)', 1.0 / STANDARD_GRAVITY),
)

_MODELS = {
    'travelling_wave': 'wave',
    'finite_difference': 'grid',
    'finite_difference_elastic': 'elastic',
    'finite_difference_glued': 'glued on',
    'spring_mass': 'spring',
}
"""What other models are called where there is little room."""

_STAGES = {'final': 'in all', 'predicted': 'as it will be'}

_UNKNOWN_BEST = 'The rig has changed; what is recommended for it has not come yet.'

_VARIED = {'thickness': 'other thickness', 'wave_speed': 'other wave speed', 'both': 'both'}


def _throw_text(values: Mapping[str, float | str]) -> str:
    """Write what a throw gave, and what other models say."""
    models = [
        key.removesuffix('.ejection_time') for key in values if key.endswith('.ejection_time')
    ]
    if not values.get('recontacts'):
        values = {key: value for key, value in values.items() if not key.startswith('last_')}
    columns = {'twin': '', **{_MODELS.get(model, model): f'{model}.' for model in models}}
    number, strain, limit = (values.get(key) for key in ('throw', 'peak_strain', 'max_strain'))
    text = f'**Throw {f"{number:.0f}" if isinstance(number, float) else "?"}**, '
    text += _STAGES.get(str(values.get('stage')), 'up to the release')
    text += f'\n\n{_table(values, _THROW_ROWS, columns)}'
    if isinstance(strain, float) and isinstance(limit, float) and strain > limit:
        text += f'\nStrain beyond {100.0 * limit:.3g} %: a real layer is no longer linear.\n'
    return text


def _recommendation_text(summary: series.RecommendationSummary) -> str:
    """Write what layer is recommended, beside that which is there."""
    values = summary.values
    if 'now.thickness' not in values:
        return f'{summary.message}\n'
    vary = values.get('vary')
    columns = {'now': 'now.'}
    for key, head in _VARIED.items():
        columns[f'**{head}**' if key == vary else head] = f'by_{key}.'
    if vary == 'library':
        columns[f'**{values.get("layer")}**'] = ''
    return _table(values, _LAYER_ROWS, columns)


def _table(
    values: Mapping[str, float | str],
    rows: Sequence[tuple[str, str, float]],
    columns: Mapping[str, str],
) -> str:
    """Write a table in Markdown, of rows that there is something of; columns have prefixes."""
    lines = ['| | ' + ' | '.join(columns) + ' |', '|:--|' + '--:|' * len(columns)]
    for key, title, factor in rows:
        found = [values.get(prefix + key) for prefix in columns.values()]
        cells = [f'{factor * each:.4g}' if isinstance(each, float) else '' for each in found]
        if any(cells):
            lines.append(f'| {title} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines) + '\n'
