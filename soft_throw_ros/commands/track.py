# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Track round spots through a high-speed video into a CSV file."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
import math
from pathlib import Path

import numpy as np
from soft_throw_ros.commands import options, output
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.identification.spots import BODIES, follow_spots, Spot, tracks_of
from soft_throw_ros.identification.track_csv import csv_lines
from soft_throw_ros.identification.tracks import (
    dominant_period,
    fall_acceleration,
    Track,
    TrackError,
)
from soft_throw_ros.identification.video import read_pictures

_GRAVITY = 9.81  # acceleration by gravity where rigs are filmed [m/s2]
_MAX_ACCELERATION = 1e5  # acceleration beyond that of any plate [m/s2]
_MAX_FALL = 1.4  # apparent gravity over gravity, or its inverse, beyond which a rate is wrong
_MIN_SEEN = 0.5  # share of the pictures that must show the plate for its frequency


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0. Notes on missing samples go to standard error."""
    parser = output.CommandParser(description=__doc__)
    add = parser.add_argument
    add('video', metavar='VIDEO', help='file that FFmpeg reads, or folder of numbered pictures')
    add('--rate', metavar='HZ', type=options.positive, required=True, help='that of the camera')
    add('--scale', metavar=('M', 'PIXELS'), type=options.positive, nargs=2, required=True,
        help='a known length, and its size in the pictures')
    add('--output', metavar='FILE', type=options.new_file(), help='CSV (default: standard output)')
    add('--spots', metavar='BODY,...',
        help=f'bodies of the spots from below: {", ".join(BODIES)} (default: the lowest is on the '
        'plate, the highest on the projectile)')
    add('--light-spots', action='store_true', help='spots are lighter than their background')
    add('--overlay', metavar='FILE.png', type=options.new_file('.png'),
        help='picture of the paths of the spots')
    return output.run_command(parser, _run, args)


def _run(arguments: argparse.Namespace) -> int:
    output.require('a video', 'video', 'imageio', 'av', 'trackpy')
    (length, pixels), rate = arguments.scale, arguments.rate
    bodies = arguments.spots and [body.strip() for body in arguments.spots.split(',')]
    with output.report_io_errors(arguments.video, ValueError):
        spots, count = follow_spots(read_pictures(arguments.video), light=arguments.light_spots)
        if arguments.overlay:
            _draw_overlay(arguments.video, spots, arguments.overlay)
        tracks = tracks_of(spots, bodies, rate=rate, scale=length / pixels)
        if 'plate' in tracks:
            _check_rate(tracks, rate=rate, pictures=count)
    notes = list(_gap_notes(spots, count))
    noises = ', '.join(f'{body} {track.noise:.2g} m' for body, track in tracks.items())
    scale = f'{rate:g} pictures per second, {pixels:g} pixels are {length:g} m.'
    lines = [
        f'# From {Path(arguments.video).name}: {scale}',
        f'# Noise: {noises}',
        *(f'# {note}' for note in notes),
        *csv_lines(tracks),
    ]
    if arguments.output:
        with output.written_file(arguments.output) as unfinished:
            unfinished.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    else:
        output.print_lines(lines)
    for note in notes:
        output.print_note('track', f'{arguments.video}: {note}')
    return 0


def _gap_notes(spots: Sequence[Spot], count: int) -> Iterator[str]:
    """Describe the gaps of each spot, except the pictures after it has left the view."""
    for spot in spots:
        end = [] if spot.has_left else [count]
        gaps = [
            f'{before + 1} to {after - 1}'
            for before, after in pairwise([-1, *spot.picture, *end])
            if after > before + 1
        ]
        if gaps:
            yield f'the spot at {spot.location} is not seen in pictures {", ".join(gaps)}'


def _check_rate(tracks: Mapping[str, Track], *, rate: float, pictures: int) -> None:
    """Raise TrackError if rate and scale give an impossible plate motion or free fall."""
    plate, projectile = tracks['plate'], tracks.get('projectile')
    if plate.time.size < _MIN_SEEN * pictures:
        raise TrackError(
            f'the plate is seen in {plate.time.size} of {pictures} pictures only; the spot on it '
            'must not be covered, nor its size or brightness change'
        )
    frequency, height = 1.0 / dominant_period(plate), 0.5 * float(np.ptp(plate.position))
    acceleration = height * (2.0 * math.pi * frequency) ** 2
    entry, lowest = TWIN.by_name['engine.frequency'], _GRAVITY if projectile else 0.0
    at_rate = f'at {rate:g} pictures per second the'
    hint = '; --rate is that of the camera, and --scale a length in metres'
    if entry.convert(frequency) is None or not lowest < acceleration < _MAX_ACCELERATION:
        raise TrackError(
            f'{at_rate} plate swings at {frequency:.3g} Hz with {acceleration:.3g} m/s2, which '
            f'must be {entry.rule} and {lowest:g} to {_MAX_ACCELERATION:g} m/s2{hint}'
        )
    fall = projectile and fall_acceleration(plate, projectile)
    if fall and not 1.0 / _MAX_FALL < fall / _GRAVITY < _MAX_FALL:
        raise TrackError(
            f'{at_rate} projectile falls with {fall:.3g} m/s2 instead of {_GRAVITY:g} m/s2{hint}'
        )


def _draw_overlay(video: str, spots: Sequence[Spot], path: Path) -> None:
    """Draw the first picture with the paths of the spots, and their rows over the pictures."""
    from matplotlib.figure import Figure

    picture = next(iter(read_pictures(video)))
    figure = Figure(figsize=(8.0, 4.6), layout='constrained')
    shown, over_time = figure.subplots(1, 2, sharey=True)
    shown.imshow(picture, cmap='gray', aspect='equal', interpolation='nearest')
    shown.set(xlabel='column [px]', ylabel='row [px]')
    over_time.set(xlabel='picture', title='gaps: spot not fully visible')
    for spot in (spot for spot in spots if spot.picture):
        numbers = np.arange(spot.picture[0], spot.picture[-1] + 1)
        centres = np.full((numbers.size, 2), np.nan)
        centres[np.array(spot.picture) - numbers[0]] = spot.centre
        (line,) = shown.plot(centres[:, 1], centres[:, 0])
        over_time.plot(numbers, centres[:, 0], color=line.get_color())
        shown.plot(spot.first[1], spot.first[0], 'o', mfc='none', ms=10, color=line.get_color())
    with output.written_file(path) as unfinished:
        figure.savefig(unfinished, dpi=120, format='png')
