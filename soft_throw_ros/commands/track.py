# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Track round spots through a high-speed video into a CSV file."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
import math
from pathlib import Path

import numpy as np
from soft_throw_ros.commands.options import new_file, positive
from soft_throw_ros.commands.output import (
    CommandParser,
    print_note,
    print_text,
    report_io_errors,
    require,
    run_command,
    written_file,
)
from soft_throw_ros.commands.track_overlay import draw_overlay, PICTURES, VIDEOS
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.identification.spots import BODIES, follow_spots, FollowedSpots, tracks_of
from soft_throw_ros.identification.track_csv import csv_lines
from soft_throw_ros.identification.tracks import (
    dominant_period,
    fall_acceleration,
    Track,
    TrackError,
)
from soft_throw_ros.identification.video import camera_rate, read_pictures

_GRAVITY = 9.81
"""Acceleration by gravity where rigs are filmed. [m/s2]"""

_MAX_ACCELERATION = 1e5
"""Acceleration beyond that of any plate. [m/s2]"""

_MAX_FALL = 1.4
"""Apparent gravity over gravity, or its inverse, beyond which rate or scale is wrong. [-]"""

_MIN_SEEN = 0.5
"""Share of the pictures that must show the plate for an estimate of its frequency. [-]"""

_MAX_RATE_ERROR = 0.01
"""Deviation of the given rate from the one in the file, beyond which a note is printed. [-]"""

_MAX_GAPS = 3
"""Largest number of gaps of a spot that a note lists."""


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0. Notes on missing samples go to standard error."""
    return run_command(_parser(), _run, args)


def _parser() -> CommandParser:
    parser = CommandParser(
        description=__doc__,
        epilog='Spots are followed from the first picture on: the lowest is taken to be on the '
        'plate, the highest on the projectile. Where one is covered its samples are missing.',
    )
    add = parser.add_argument
    add(
        'video', metavar='VIDEO',
        help='file that FFmpeg reads (Phantom .cine among them), or folder of pictures in the '
        'order of their numbers',
    )
    add(
        '--rate', metavar='HZ', type=positive, required=True,
        help='pictures per second of the camera',
    )
    add(
        '--scale', metavar=('M', 'PIXELS'), type=positive, nargs=2, required=True,
        help='a known length, and its size in the pictures',
    )
    add('--output', metavar='FILE', type=new_file(), help='CSV file (default: standard output)')
    add(
        '--spots', metavar='BODY,...',
        help=f'bodies that the spots are on, from the lowest to the highest: {", ".join(BODIES)}',
    )
    add('--light-spots', action='store_true', help='spots are lighter than their background')
    add(
        '--overlay', metavar='FILE', type=new_file(*PICTURES, *VIDEOS),
        help=f'picture ({", ".join(PICTURES)}) or video ({", ".join(VIDEOS)}) of the spots and '
        'their paths',
    )
    return parser


def _run(arguments: argparse.Namespace) -> int:
    require('a video', 'video', 'imageio', 'av', 'skimage')
    notes: list[str] = []
    with report_io_errors(arguments.video, ValueError):
        recorded = camera_rate(arguments.video)
        if recorded and abs(arguments.rate / recorded - 1.0) > _MAX_RATE_ERROR:
            notes.append(
                f'--rate is {arguments.rate:g}, but the file gives '
                f'{recorded:g} pictures per second'
            )
        tracks = _track_spots(arguments, notes)
    lines = [_title(arguments, tracks), *(f'# {note}' for note in notes), *csv_lines(tracks)]
    text = '\n'.join(lines) + '\n'
    if arguments.output:
        with written_file(arguments.output) as unfinished:
            unfinished.write_text(text, encoding='utf-8')
    else:
        print_text(text)
    for note in notes:
        print_note('track', f'{arguments.video}: {note}')
    return 0


def _title(arguments: argparse.Namespace, tracks: Mapping[str, Track]) -> str:
    """Return the comment on how the tracks were made."""
    length, pixels = arguments.scale
    noises = ', '.join(f'{body} {track.noise:.2g} m' for body, track in tracks.items())
    return (
        f'# From {Path(arguments.video).name}: {arguments.rate:g} pictures per second, '
        f'{pixels:g} pixels are {length:g} m.\n# Noise: {noises}'
    )


def _track_spots(arguments: argparse.Namespace, notes: list[str]) -> dict[str, Track]:
    """Follow spots, and note the pictures that do not show them."""
    bodies = arguments.spots and [body.strip() for body in arguments.spots.split(',')]
    followed = follow_spots(read_pictures(arguments.video), light=arguments.light_spots)
    notes += _gap_notes(followed)
    if followed.late is not None:
        number, spot = followed.late
        message = (
            f'picture {number} shows a round spot at column {spot.column:.0f} row {spot.row:.0f} '
            'that the first picture does not show; all spots must be in full view there, or '
            '--spots must name the bodies of those that are'
        )
        if not bodies:
            raise TrackError(message)
        notes.append(message)
    if arguments.overlay:
        draw_overlay(read_pictures(arguments.video), followed.spots, arguments.overlay)
    length, pixels = arguments.scale
    tracks = tracks_of(followed.spots, bodies, rate=arguments.rate, scale=length / pixels)
    if 'plate' in tracks:
        _check_rate(tracks, rate=arguments.rate, pictures=followed.pictures)
    return tracks


def _gap_notes(followed: FollowedSpots) -> Iterator[str]:
    """Describe the gaps of each spot, except the pictures after it has left the view."""
    for spot in followed.spots:
        gaps = [f'{first} to {last}' for first, last in spot.gaps]
        gaps[_MAX_GAPS:] = [f'{len(gaps) - _MAX_GAPS} more times'] * (len(gaps) > _MAX_GAPS)
        if spot.picture.size and spot.picture[0] > 0:
            gaps.insert(0, f'0 to {spot.picture[0] - 1}')
        last = int(spot.picture[-1]) if spot.picture.size else -1
        if last < followed.pictures - 1 and not spot.has_left:
            gaps.append(f'{last + 1} to the end')
        if gaps:
            yield (
                f'the spot at {spot.location} is not seen as a whole in pictures '
                f'{", ".join(gaps)}; these samples are missing'
            )


def _check_rate(tracks: Mapping[str, Track], *, rate: float, pictures: int) -> None:
    """Raise TrackError if rate and scale give an impossible plate motion or free fall."""
    plate = tracks['plate']
    if plate.time.size < _MIN_SEEN * pictures:
        raise TrackError(
            f'the plate is seen in {plate.time.size} of {pictures} pictures only; the spot on it '
            'must not be covered, nor its size or brightness change'
        )
    frequency, height = 1.0 / dominant_period(plate), 0.5 * float(np.ptp(plate.position))
    acceleration = height * (2.0 * math.pi * frequency) ** 2
    entry = TWIN.by_name['engine.frequency']
    hint = (
        '; --rate is that of the camera, not that at which the video is shown, and --scale a '
        'length in metres'
    )
    reason = ''
    if entry.convert(frequency) is None:
        reason = f'its frequency must be {entry.rule}'
    elif acceleration > _MAX_ACCELERATION:
        reason = f'no plate bears more than {_MAX_ACCELERATION:g} m/s2'
    elif 'projectile' in tracks and acceleration < _GRAVITY:
        reason = 'that is less than gravity and throws nothing'
    if reason:
        raise TrackError(
            f'at {rate:g} pictures per second the plate swings at {frequency:.3g} Hz, which takes '
            f'an acceleration of {acceleration:.3g} m/s2, but {reason}{hint}'
        )
    fall = fall_acceleration(plate, tracks['projectile']) if 'projectile' in tracks else None
    if fall is not None and not 1.0 / _MAX_FALL < fall / _GRAVITY < _MAX_FALL:
        raise TrackError(
            f'at {rate:g} pictures per second the projectile falls with {fall:.3g} m/s2 instead '
            f'of {_GRAVITY:g} m/s2, as with {rate * math.sqrt(_GRAVITY / max(fall, 1e-9)):.4g} '
            f'pictures per second, or another scale{hint}'
        )
