# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Draw the pictures of docs/identify.md from a simulated video and its tracks.

`--video FILE.avi` writes the video alone, for the commands of the page.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
import tempfile

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from soft_throw_ros.commands import identify, track
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.stepper import PROJECTILE_POSITION
from soft_throw_ros.core.throw import simulate

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

RIG = Rig(
    engine=Engine(frequency=58.0, damping_ratio=0.05, amplitude=1.3e-3),
    layer=Layer(thickness=7e-3, wave_speed=6.9),
    projectile=Projectile(mass=1.2e-3),
)
"""The rig in the video."""

RATE = 5000.0
"""Frame rate of the camera. [Hz]"""

PIXEL = 1e-4
"""Size of a pixel on the rig. [m]"""

CAMERA = ('--rate', '5000', '--scale', '0.012', '120')
OPTIONS = (
    *('--one-camera', '--thickness', '0.007', '--mass', '0.0012'),
    *('--diameter', '0.012', '--density', '1000'),
)
SHAPE = (300, 64)
"""Rows and columns of the video. [px]"""

START = 0.008
"""Start of the throw. [s]"""

DURATION = 0.045
"""Duration of the video. [s]"""

_COLOURS = 48
"""Number of colours, which keeps the files small."""


def pictures() -> Iterator[Bytes]:
    """Yield noisy pictures of a throw: three dark spots."""
    rng = np.random.default_rng(0)
    time = np.arange(0.0, DURATION, 1.0 / RATE) - START
    states, _ = simulate(RIG, until=DURATION).trajectory(np.maximum(time, 0.0))
    rise = states[:, PROJECTILE_POSITION] - states[0, PROJECTILE_POSITION]
    low = Underdamped.of(RIG.engine).position(time) / PIXEL
    high = rise / PIXEL
    rows, columns = np.indices(SHAPE)
    for plate, projectile in zip(low, high, strict=True):
        levels = np.full(SHAPE, 200.0)
        for row, column in (
            (280.3 - plate, 30.2),
            (220.6 - 0.5 * (plate + projectile), 33.4),
            (155.1 - projectile, 31.3),
        ):
            distance = np.hypot(rows - row, columns - column)
            levels -= 140.0 / (1.0 + np.exp((distance - 4.0) / 0.6))
        noisy = levels + 4.0 * rng.normal(size=SHAPE)
        yield np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def write_video(path: Path) -> None:
    """Write the pictures to a lossless video."""
    with av.open(str(path), 'w') as file:
        stream = file.add_stream('ffv1', rate=25)
        stream.height, stream.width = SHAPE
        stream.pix_fmt = 'gray'
        for picture in pictures():
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format='gray')))
        file.mux(stream.encode())


def main() -> None:
    """Draw all pictures by the commands of the page."""
    parser = argparse.ArgumentParser(description='Draw the pictures of docs/identify.md.')
    parser.add_argument('--video', metavar='FILE', type=Path, help='write the video alone')
    arguments = parser.parse_args()
    if arguments.video:
        write_video(arguments.video)
        return
    with tempfile.TemporaryDirectory() as temporary:
        names = 'throw.avi', 'tracks.csv', 'followed.png', 'fit.png'
        video, tracks, *drawn = (f'{temporary}/{name}' for name in names)
        write_video(Path(video))
        track.main([video, *CAMERA, '--overlay', drawn[0], '--output', tracks])
        identify.main([tracks, *OPTIONS, '--figure', drawn[1]])
        for path in map(Path, drawn):
            picture = Image.open(path).convert('RGB').quantize(_COLOURS)
            picture.save(Path(__file__).with_name(path.name), optimize=True)


if __name__ == '__main__':
    main()
