# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Draw the pictures of docs/identify.md from a simulated video, its tracks and the fitted rig.

`python docs/measured/draw.py` writes the pictures to docs/measured, `--output DIR` to another
folder. `--video FILE.avi` writes the video alone, for the commands of the page.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import io
import json
from pathlib import Path
import sys
import tempfile
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from soft_throw_ros.commands import identify, track
from soft_throw_ros.configuration import files, rig_of
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate, throw_many

sys.path.append(str(Path(__file__).resolve().parents[1] / 'paper'))

import style  # noqa: E402

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

PICTURES = ('followed', 'fit', 'better')
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
    path = simulate(RIG, until=DURATION).trajectory(np.maximum(time, 0.0))
    low = Underdamped.of(RIG.engine).position(time) / PIXEL
    high = (path.projectile_position - path.projectile_position[0]) / PIXEL
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


def identified(video: Path, folder: Path) -> tuple[Rig, dict[str, Any]]:
    """Run the commands of the page; return the fitted rig and the report."""
    tracks, parameters = folder / 'tracks.csv', folder / 'my_rig.yaml'
    overlay = ('--overlay', str(folder / 'followed.png'))
    track.main([str(video), *CAMERA, *overlay, '--output', str(tracks)])
    args = [
        *(str(tracks), *OPTIONS, '--json', '--figure', str(folder / 'fit.png')),
        *('--output', str(parameters)),
    ]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        identify.main(args)
    return rig_of(files.read(parameters)), json.loads(printed.getvalue())


def draw_better(rig: Rig, report: dict[str, Any], path: Path) -> None:
    """Draw the energy transfer of the fitted layer for all thicknesses."""
    thicknesses = np.linspace(3e-3, 30e-3, 400)
    figure, axes = style.new_figure(
        'A better layer',
        'Energy transfer over the thickness of a layer of the fitted and of the true material.',
        height=3.6, grid=(1, 1),
    )
    errors = {row['name']: row['error'] for row in report['rows']}
    speeds = rig.layer.wave_speed + errors['layer.wave_speed'] * np.array([-1.0, 0.0, 1.0])
    curves = [_energy_transfer(rig, thicknesses, speed) for speed in speeds.tolist()]
    axes.fill_between(
        1e3 * thicknesses, np.min(curves, axis=0), np.max(curves, axis=0), color=style.SKY,
        alpha=0.5, label='within one error of $c_s$',
    )
    axes.plot(1e3 * thicknesses, curves[1], color=style.BLUE, label='fitted layer')
    true = _energy_transfer(RIG, thicknesses, RIG.layer.wave_speed)
    axes.plot(1e3 * thicknesses, true, color=style.BLACK, ls='--', lw=1.0, label='true layer')
    best = int(np.argmax(curves[1]))
    for thickness, marker, label in (
        (RIG.layer.thickness, 'o', 'as it is'),
        (thicknesses[best], '*', 'recommended'),
    ):
        alpha = float(np.interp(thickness, thicknesses, true))
        axes.plot(
            1e3 * thickness, alpha, marker, color=style.RED, ms=11, mec='white', ls='none',
            label=f'{label}: {1e3 * thickness:.1f} mm, {alpha:.2f}',
        )
    axes.set(xlabel='thickness $L_s$ [mm]', ylabel=r'energy transfer $\alpha$')
    axes.legend(loc='lower right')
    style.save(figure, path)


def _energy_transfer(rig: Rig, thicknesses: Floats, speed: float) -> Floats:
    """Return the energy transfer of layers of some thicknesses with a wave speed."""
    return throw_many(rig, {'thickness': thicknesses, 'wave_speed': speed}).energy_transfer


def main(args: list[str] | None = None) -> int:
    """Draw all pictures; return 0."""
    parser = argparse.ArgumentParser(description='Draw the pictures of docs/identify.md.')
    folder = Path(__file__).resolve().parent
    parser.add_argument('--output', metavar='DIR', type=Path, default=folder)
    parser.add_argument('--video', metavar='FILE', type=Path, help='write the video alone')
    arguments = parser.parse_args(args)
    if arguments.video:
        write_video(arguments.video)
        return 0
    arguments.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        video = Path(temporary) / 'throw.avi'
        write_video(video)
        rig, report = identified(video, Path(temporary))
        with style.settings():
            draw_better(rig, report, Path(temporary) / 'better.png')
        for name in PICTURES:
            path = arguments.output / f'{name}.png'
            picture = Image.open(Path(temporary) / f'{name}.png').convert('RGB').quantize(_COLOURS)
            picture.save(path, optimize=True)
            print(path)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
