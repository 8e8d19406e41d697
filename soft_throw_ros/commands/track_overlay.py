# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Draw the followed spots and their gaps over a video."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, cycle, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands.output import written_file
from soft_throw_ros.identification.spots import Picture, Spot

Bytes = NDArray[np.uint8]

PICTURES = ('.png', '.pdf', '.svg')
VIDEOS = {'.mp4': 'mp4', '.mkv': 'matroska', '.avi': 'avi'}
"""FFmpeg's names of formats by suffix."""

# Okabe and Ito's colours, distinguishable by colour-blind readers
_COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9')
_RADIUS = 8.0  # radius of the ring around a spot [px]
_MIN_HEIGHT = 480  # height of a video up to which pictures are enlarged [px]
_SHOWN_RATE = 25  # pictures per second of a video [Hz]
_TAIL = 40  # number of pictures for which a video shows the path of a spot


def draw_overlay(pictures: Iterable[Picture], spots: Sequence[Spot], path: Path) -> None:
    """
    Draw the followed spots over the pictures, into a picture or a video.

    A picture shows the paths of the spots over the first picture, and their rows over the picture
    number. A video shows a ring around each spot in the pictures that contain the spot.

    """
    with written_file(path) as unfinished:
        if path.suffix in PICTURES:
            _draw_picture(next(iter(pictures)), spots, unfinished, path.suffix[1:])
        else:
            _write_video(_frames(pictures, spots), unfinished, VIDEOS[path.suffix])


def _draw_picture(picture: Picture, spots: Sequence[Spot], path: Path, form: str) -> None:
    """Draw the first picture with paths, and rows over pictures."""
    from matplotlib.figure import Figure

    rows, columns = picture.shape
    width = np.clip(4.2 * columns / rows, 1.0, 6.0)
    figure = Figure(figsize=(4.6 + width, 4.6), layout='constrained')
    shown, over_time = figure.subplots(1, 2, sharey=True, width_ratios=[width, 4.2])
    shown.imshow(picture, cmap='gray', aspect='auto')
    shown.set(xlabel='column [px]', ylabel='row [px]')
    over_time.set(xlabel='picture')
    for spot, colour in zip(spots, cycle(_COLOURS)):
        breaks = np.flatnonzero(np.diff(spot.picture) > 1) + 1
        for indices in np.split(np.arange(spot.row.size), breaks):
            shown.plot(spot.column[indices], spot.row[indices], color=colour, lw=1.4)
            over_time.plot(spot.picture[indices], spot.row[indices], color=colour, lw=1.4)
        for first, last in spot.gaps:
            over_time.axvspan(first, last, color=colour, alpha=0.15, lw=0)
        if spot.row.size:
            shown.plot(spot.column[0], spot.row[0], 'o', mfc='none', ms=10, color=colour)
    over_time.set_title('shaded: spot not fully visible', fontsize='small', loc='left')
    for axes in (shown, over_time):
        axes.spines[['top', 'right']].set_visible(False)
    figure.savefig(path, dpi=120, format=form)


def _frames(pictures: Iterable[Picture], spots: Sequence[Spot]) -> Iterator[Bytes]:
    """Draw rings and recent paths into every picture."""
    colours = [
        np.array([int(colour[index:index + 2], 16) for index in (1, 3, 5)], dtype=np.uint8)
        for colour in islice(cycle(_COLOURS), len(spots))
    ]
    low = high = None
    for number, picture in enumerate(pictures):
        if low is None or high is None:
            low, high = (float(level) for level in np.percentile(picture, (0.1, 99.9)))
        grey = np.clip(255.0 * (picture - low) / max(high - low, 1e-12), 0.0, 255.0)
        factor = 2 * max(1, round(0.5 * _MIN_HEIGHT / picture.shape[0]))
        frame = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
        frame = frame.repeat(factor, axis=0).repeat(factor, axis=1)
        for spot, colour in zip(spots, colours, strict=True):
            _mark(frame, spot, number, colour, factor)
        yield frame


def _mark(frame: Bytes, spot: Spot, number: int, colour: Bytes, factor: int) -> None:
    """Draw the recent path of a spot, and a ring if this picture shows the spot."""
    from skimage.draw import circle_perimeter

    late = (spot.picture <= number) & (spot.picture > number - _TAIL)
    path = (factor * (np.stack([spot.row[late], spot.column[late]]) + 0.5)).astype(int)
    frame[tuple(path)] = colour
    if late.any() and spot.picture[late][-1] == number:
        row, column = path[:, -1].tolist()
        for radius in (round(factor * _RADIUS), round(factor * _RADIUS) + 1):
            frame[circle_perimeter(row, column, radius, shape=frame.shape[:2])] = colour


def _write_video(frames: Iterator[Bytes], path: Path, form: str) -> None:
    """Write frames as a video in a format that common players support."""
    import av

    codec = 'libx264' if 'libx264' in av.codecs_available else 'mpeg4'
    with av.open(str(path), 'w', format=form) as file:
        stream = file.add_stream(codec, rate=_SHOWN_RATE)
        stream.pix_fmt = 'yuv420p'
        first = next(frames)
        stream.height, stream.width = first.shape[:2]
        for frame in chain([first], frames):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format='rgb24')))
        file.mux(stream.encode())
