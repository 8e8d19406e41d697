# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Recordings of Rerun, and shapes that are drawn into them.

Quantities of every step are sent in columns, many rows at once. Latched content, which holds until
it is replaced, is kept and sent again to a viewer that connects later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from soft_throw_ros.recording.charts import Bytes
from soft_throw_ros.recording.timeseries import Stamps, ThrowStart

STAMP = 'stamp'
"""Timeline of the messages' stamps."""

THROW_TIME = 'time since throw'
"""Timeline of the rig, from the start of the throw that is shown."""

Colour = tuple[int, int, int]

# The colours of Okabe and Ito, which people with colour blindness can distinguish.
GREY = (0xB0, 0xB0, 0xB0)
WHITE = (0xFF, 0xFF, 0xFF)
BLUE = (0x56, 0xB4, 0xE9)
ORANGE = (0xE6, 0x9F, 0x00)
GREEN = (0x00, 0x9E, 0x73)
PURPLE = (0xCC, 0x79, 0xA7)
RED = (0xD5, 0x5E, 0x00)
BLACK = (0x00, 0x00, 0x00)

_IN_FRONT = 40.0
"""Draw order of texts [-]: in front of images (-10) and lines (30)."""


class Canvas:
    """
    Draws into a recording, if there is one, and keeps all content that still holds.

    The start of `throw` is the origin of `THROW_TIME`; without it, there is only `STAMP`.
    """

    def __init__(self, throw: ThrowStart | None = None) -> None:
        self.throw = throw
        self._stream: rr.RecordingStream | None = None
        self._kept: dict[tuple[str, str], Callable[[], None]] = {}

    def connect(self, stream: rr.RecordingStream | None) -> None:
        """Draw into a recording from now on, the kept content first; or into none."""
        self._stream = stream
        for draw in self._kept.values():
            draw()

    def log_style(self, path: str, style: rr.AsComponents) -> None:
        """Set the style of an entity once."""
        if ('style', path) not in self._kept:
            self._keep('style', path, partial(self._log_static, path, style))

    def log_latched(self, path: str, stamp: int, *content: rr.AsComponents) -> None:
        """Draw content that holds until an entity gets other content."""
        batches = [batch for item in content for batch in item.as_component_batches()]
        columns = [batch.partition([len(batch.as_arrow_array())]) for batch in batches]
        self._keep('content', path, partial(self.log_columns, path, np.array([stamp]), columns))

    def log_text(self, path: str, stamp: int, text: str) -> None:
        """Write a text (Markdown) that holds until it is replaced."""
        self.log_latched(path, stamp, rr.TextDocument(text, media_type='text/markdown'))

    def _keep(self, kind: str, path: str, draw: Callable[[], None]) -> None:
        self._kept[kind, path] = draw
        draw()

    def _log_static(self, path: str, style: rr.AsComponents) -> None:
        if self._stream is not None:
            self._stream.log(path, style, static=True)

    def log_columns(
        self, path: str, stamps: Stamps, columns: Iterable[rr.ComponentColumn]
    ) -> None:
        """Draw rows of a quantity that changes with every step."""
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


def picture(
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


def lines(strips: Sequence[Sequence[tuple[float, float]]], colour: Colour) -> rr.LineStrips2D:
    """Draw thin lines."""
    radius = rr.Radius.ui_points(0.5)
    return rr.LineStrips2D([np.array(strip) for strip in strips], colors=[colour], radii=radius)


def encoded_image(png: bytes) -> rr.EncodedImage:
    """Return an image that is drawn behind everything else."""
    return rr.EncodedImage(
        contents=png, media_type='image/png', draw_order=-20.0, magnification_filter='linear'
    )


def texts(
    points: Sequence[tuple[float, float]], labels: Sequence[str], colour: Colour = GREY
) -> rr.Points2D:
    """Write texts whose upper edges are a little below points of a view."""
    return rr.Points2D(
        points,
        radii=rr.Radius.ui_points(0.0),
        colors=[colour],
        labels=labels,
        show_labels=True,
        draw_order=_IN_FRONT,
    )
