# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Panels of a twin with images: the rig to scale, the strain, and the recommended layer."""

from __future__ import annotations

from matplotlib.ticker import MaxNLocator
import numpy as np
import rerun as rr
from soft_throw_ros.configuration import Settings
from soft_throw_ros.configuration.interface import FIELD_POINTS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording import charts
from soft_throw_ros.recording import rerun_canvas as drawing
from soft_throw_ros.recording import rerun_text as words
from soft_throw_ros.recording.energy_map import draw_energy_map
from soft_throw_ros.recording.timeseries import Floats, LayerStates, Stamps, StrainField, Values

_MILLI = 1e3

_PLATE_WIDTH = 1.5
"""Width of the plate, over the diameter of the layer."""

_DEFAULT_STRAIN = 0.2
"""Upper end of the colours of strain before the first throw. [-]"""


class RigPicture:
    """Plate, layer and projectile: in mm, downwards as Rerun has it."""

    def __init__(self, canvas: drawing.Canvas, path: str) -> None:
        self.largest_strain = _DEFAULT_STRAIN  # where the colours end [-]
        self._canvas = canvas
        self._path = path
        self._layer_width = 0.0  # [mm]
        self._diameter, self._high = 12.0, 60.0  # of the view, before the first rig [mm]
        pixels = rr.components.ImageFormat(
            width=1, height=FIELD_POINTS, color_model='RGB', channel_datatype='U8'
        )
        style = rr.Image.from_fields(format=pixels, magnification_filter='linear')
        canvas.log_style(f'{path}/layer', style)

    @property
    def bounds(self) -> tuple[float, float, float]:
        """Half the width of the view, and its lowest and highest height [mm]."""
        return 1.25 * self._diameter, -0.4 * self._diameter, self._high

    def change_rig(self, stamp: int, rig: Rig) -> None:
        """Draw the bodies of a rig, and a scale of heights on the left."""
        diameter, length = _MILLI * rig.layer.diameter, _MILLI * rig.projectile.length
        self._layer_width = diameter
        high = 1.35 * (_MILLI * rig.layer.thickness + length) + 0.8 * diameter
        self._diameter, self._high = diameter, high
        for name, colour, w, y, h in (
            ('plate', drawing.GREY, _PLATE_WIDTH * diameter, 0.0, 0.15 * diameter),
            ('projectile', drawing.BLUE, diameter, -length, length),
        ):
            body = drawing.picture(np.array([[colour]], np.uint8), x=-0.5 * w, y=y, w=w, h=h)
            self._canvas.log_latched(f'{self._path}/{name}/body', stamp, *body)
        for name, text, y in (
            ('plate/text', 'plate', 0.0),
            ('plate/layer_text', 'layer', -0.5 * _MILLI * rig.layer.thickness),
            ('projectile/text', 'projectile', -0.5 * length),
        ):
            label = drawing.texts([(0.95 * diameter, y)], [text], drawing.WHITE)
            self._canvas.log_latched(f'{self._path}/{name}', stamp, label)
        width, low, high = self.bounds
        locator = MaxNLocator(8, steps=[1, 2, 5, 10])
        ticks = [tick for tick in locator.tick_values(0.0, high) if 0.0 <= tick <= high]
        x = -0.5 * _PLATE_WIDTH * diameter - 0.03 * width
        strips = [[(x, 0.0), (x, -ticks[-1])]]
        strips += [[(x - 0.06 * width, -tick), (x, -tick)] for tick in ticks]
        self._canvas.log_latched(f'{self._path}/ruler', stamp, drawing.lines(strips, drawing.GREY))
        lift = 0.009 * (high - low)  # texts stand below their places
        places = [(x - 0.17 * width, -tick - lift) for tick in ticks]
        numbers = drawing.texts(places, [f'{tick:g}' for tick in ticks])
        self._canvas.log_latched(f'{self._path}/ruler/texts', stamp, numbers)

    def draw_positions(self, stamps: Stamps, position: Floats) -> None:
        """Move plate and projectile."""
        translation = np.zeros((stamps.size, 3))
        for name, height in zip(('plate', 'projectile'), position.T, strict=True):
            translation[:, 1] = -_MILLI * height
            columns = rr.Transform3D.columns(translation=translation)
            self._canvas.log_columns(f'{self._path}/{name}', stamps, columns)

    def draw_layer(self, layer: LayerStates) -> None:
        """Draw the colours of the strain, stretched from the lower to the upper end."""
        pixels = charts.signed_colours(layer.strain[:, ::-1], self.largest_strain)
        width, nothing = self._layer_width, np.zeros_like(layer.top)
        corner = [nothing - 0.5 * width, -_MILLI * layer.top, nothing]
        height = _MILLI * (layer.top - layer.bottom) / FIELD_POINTS
        scale = [nothing + width, height, nothing + 1.0]
        columns = [
            *rr.Image.columns(buffer=[row.tobytes() for row in pixels]),
            *rr.Transform3D.columns(
                translation=np.stack(corner, axis=1), scale=np.stack(scale, axis=1)
            ),
        ]
        self._canvas.log_columns(f'{self._path}/layer', layer.stamps, columns)


def draw_strain(canvas: drawing.Canvas, path: str, field: StrainField, limit: float) -> None:
    """
    Draw the strain over time and height in one throw, with axes, the ejection and a moving cursor.

    The colours end at a limit to either side [-].
    """
    log, stamps = canvas.log_latched, field.stamps
    start, end = int(stamps[0]), float(field.times[-1])
    x, y, width, height = charts.FRAME_BOX
    frame = charts.strain_frame(_MILLI * end, _MILLI * field.thickness, 100.0 * limit)
    log(f'{path}/frame', start, drawing.encoded_image(frame))
    pixels = charts.signed_colours(field.strain.T[::-1], limit)
    log(f'{path}/picture', start, *drawing.picture(pixels, x=x, y=y, w=width, h=height))
    strips, places, titles = [], [], []  # nothing replaces the line of another throw
    ejection_time = field.throw.ejection_time
    if ejection_time is not None:
        at = x + width * ejection_time / end
        strips, places = [[(at, y), (at, y + height)]], [(at, y - 37.0)]
        titles = [f'tₑ {_MILLI * ejection_time:.2f} ms']
    log(f'{path}/ejection', start, drawing.lines(strips, drawing.BLACK))
    log(f'{path}/ejection/text', start, drawing.texts(places, titles))
    cursors = np.zeros((stamps.size, 2, 2), np.float32)
    cursors[:, :, 0] = (x + width * field.times / end)[:, None]
    cursors[:, :, 1] = y, y + height
    style = rr.LineStrips2D.from_fields(colors=[drawing.RED], radii=rr.Radius.ui_points(1.0))
    canvas.log_style(f'{path}/now', style)
    columns = rr.LineStrips2D.columns(strips=cursors).partition([1] * stamps.size + [0])
    after = 2 * stamps[-1] - stamps[-2]  # when the cursor disappears
    canvas.log_columns(f'{path}/now', np.append(stamps, after), columns)


class RecommendationPanel:
    """Table and map below the root of a twin."""

    def __init__(self, canvas: drawing.Canvas, root: str) -> None:
        self._canvas = canvas
        self._root = root
        self._rig: Rig | None = None  # of the table and the map; None while unknown
        self._message = words.NO_RECOMMENDATION  # of the last recommendation
        self._values: Values = {}
        self._stamp = 0  # of the table and the map [ns]

    def change_rig(self, stamp: int, rig: Rig, settings: Settings) -> None:
        """Draw the map of a rig, without a recommendation if the last one is of another rig."""
        if self._rig is None:  # the recommendation may have come before the journal
            self.draw(stamp, self._message, self._values, rig, settings)
        elif self._rig != rig:
            self.draw(stamp, words.NO_RECOMMENDATION, {}, rig, settings)

    def draw(
        self, stamp: int, message: str, values: Values, rig: Rig | None, settings: Settings
    ) -> None:
        """Write the table of a recommendation, and draw the map of its rig if that is known."""
        self._rig, self._message, self._values = rig, message, values
        self._stamp = max(self._stamp, stamp)  # the last one is shown last
        text = words.recommendation_text(message, values)
        self._canvas.log_text(f'{self._root}/recommendation', self._stamp, text)
        if rig is not None:
            image = drawing.encoded_image(charts.to_png(draw_energy_map(rig, settings, values)))
            self._canvas.log_latched(f'{self._root}/landscape', self._stamp, image)
