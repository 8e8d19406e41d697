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
Tracks from high-speed videos: what to follow, and how, is said by options of `identify`.

What cannot be is refused before anything is computed from it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
import contextlib
import math
from pathlib import Path
import sys

import numpy as np
from soft_throw_ros.commands.identify_overlay import draw_overlay, PICTURES, VIDEOS
from soft_throw_ros.commands.options import new_file, positive
from soft_throw_ros.commands.output import naming, require
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.identification.spots import BODIES, follow_spots, Spot, tracks_of
from soft_throw_ros.identification.track_csv import csv_lines
from soft_throw_ros.identification.tracks import dominant_period, Track, TrackError
from soft_throw_ros.identification.video import (
    camera_rate,
    is_video,
    read_pictures,
    space_time,
    SpaceTime,
)

_OPTIONS = ('rate', 'scale', 'spots', 'light_spots', 'overlay', 'tracks', 'line', 'space_time')
_GRAVITY = 9.81  # of all rigs that are filmed [m/s^2]
_MAX_ACCELERATION = 1e5  # of a plate [m/s^2]
_MAX_RATE_ERROR = 0.01  # of the rate that is given, from the one in the file
_MAX_GAPS = 3  # of a spot that are listed


def add_video_options(parser: argparse.ArgumentParser) -> None:
    """Add options for videos; `check_video_options` refuses what cannot be."""
    add = parser.add_argument_group(
        'videos',
        'files (Phantom .cine among them), or folders of pictures in the order of their numbers. '
        'Dark round spots are followed from the first picture on: the lowest is taken to be on '
        'the plate, the highest on the projectile. Where one is covered its samples are missing.',
    ).add_argument
    add('--video', metavar='FILE', action='append', default=[], help='video of throws')
    add('--rate', metavar='HZ', type=positive, help='pictures per second of the camera')
    add(
        '--scale', metavar=('M', 'PIXELS'), type=positive, nargs=2,
        help='a length that is known, and how long it is in the pictures',
    )
    add(
        '--spots', metavar='BODY,...',
        help=f'what each spot is on, from the lowest to the highest: {", ".join(BODIES)}',
    )
    add('--light-spots', action='store_true', help='spots are lighter than what is around them')
    add(
        '--overlay', metavar='FILE', type=new_file(*PICTURES, *VIDEOS),
        help=f'picture ({", ".join(PICTURES)}) or video ({", ".join(VIDEOS)}) to draw, of what '
        'was followed',
    )
    add('--tracks', metavar='FILE', type=new_file(), help='CSV file to write what was followed')
    add(
        '--line', metavar=('COLUMN', 'FIRST', 'LAST'), type=int, nargs=3,
        help='with the video of a free layer: follow its edges along a vertical line, in the '
        'pixels of that column from row to row, instead of spots',
    )
    add(
        '--space-time', metavar='FILE', type=new_file(*PICTURES),
        help='picture of that line over time to draw',
    )


def check_video_options(arguments: argparse.Namespace) -> None:
    """Refuse options that do not go together by a ValueError that names one."""
    layers = [path for _, path in arguments.free_layer]
    videos = arguments.video + [path for path in layers if is_video(path)]
    given = [name for name in _OPTIONS if getattr(arguments, name) not in (None, False)]
    for is_so, names, reason in (
        (not videos, _OPTIONS[arguments.plan:], 'is for videos'),
        (len(videos) > 1, ('tracks', 'line', 'overlay'),
         f'is for one video at a time, got {len(videos)}'),
        (bool(arguments.video), ('line',), 'is for the video of a free layer'),
        (bool(arguments.line), ('overlay',), 'is for spots; --space-time draws a line'),
        (not arguments.line, ('space_time',), 'needs --line'),
    ):
        for name in names:
            if is_so and name in given:
                raise ValueError(f'argument --{name.replace("_", "-")}: {reason}')
    if videos:
        for name in ('rate', 'scale'):
            if name not in given:
                raise ValueError(f'argument --{name}: must be given with a video')
        require('a video', 'video', 'imageio', 'av', 'skimage')


def read_throw_video(path: str, arguments: argparse.Namespace) -> dict[str, Track]:
    """Follow the spots of a throw."""
    with _naming_video(path):
        bodies = arguments.spots and [body.strip() for body in arguments.spots.split(',')]
        spots = _follow(path, arguments)
        length, pixels = arguments.scale
        tracks = tracks_of(spots, bodies, rate=arguments.rate, scale=length / pixels)
        if 'plate' in tracks:
            _check_rate(tracks, arguments.rate)
    _save(tracks, path, arguments)
    return tracks


def read_layer_video(
    path: str, arguments: argparse.Namespace
) -> tuple[dict[str, Track], SpaceTime | None]:
    """Follow bottom and top of a free layer, by spots or along a line."""
    line, (length, pixels) = None, arguments.scale
    known = {'rate': arguments.rate, 'scale': length / pixels}
    with _naming_video(path):
        if arguments.line:
            column, first, last = arguments.line
            line = space_time(read_pictures(path), column=column, first=first, last=last, **known)
            bottom, top = line.edges()
        else:
            spots = _follow(path, arguments)
            ends = tracks_of([spots[0], spots[-1]][: len(spots)], **known)
            if 'projectile' not in ends:
                raise TrackError('one spot is followed, where bottom and top are needed')
            bottom, top = ends['plate'], ends['projectile']
    tracks = {'bottom': bottom, 'top': top}
    _save(tracks, path, arguments)
    return tracks, line


def _follow(path: str, arguments: argparse.Namespace) -> list[Spot]:
    """Follow spots, say what was not seen of them, and draw it if that is asked for."""
    recorded = camera_rate(path)
    if recorded and abs(arguments.rate / recorded - 1.0) > _MAX_RATE_ERROR:
        print(
            f'identify: {path}: --rate is {arguments.rate:g}, but the file says that it was '
            f'taken with {recorded:g} pictures per second',
            file=sys.stderr,
        )
    spots = follow_spots(read_pictures(path), light=arguments.light_spots)
    end = max((int(spot.picture[-1]) for spot in spots if spot.picture.size), default=0)
    for spot in spots:
        gaps = [f'{first} to {last}' for first, last in spot.gaps]
        gaps[_MAX_GAPS:] = [f'{len(gaps) - _MAX_GAPS} more times'] * (len(gaps) > _MAX_GAPS)
        if spot is not spots[-1] and spot.picture.size > 0 and spot.picture[-1] < end:
            gaps.append(f'{spot.picture[-1] + 1} to the end')  # the highest one may leave
        if gaps:
            print(
                f'identify: {path}: the spot at {spot.place} is not seen as a whole in pictures '
                f'{", ".join(gaps)}; these samples are missing',
                file=sys.stderr,
            )
    if arguments.overlay:
        with naming(arguments.overlay):
            draw_overlay(read_pictures(path), spots, arguments.overlay)
    return spots


def _check_rate(tracks: Mapping[str, Track], rate: float) -> None:
    """Refuse a rate or scale with which no plate moves, or none throws."""
    plate = tracks['plate']
    frequency, height = 1.0 / dominant_period(plate), 0.5 * float(np.ptp(plate.position))
    acceleration = height * (2.0 * math.pi * frequency) ** 2
    entry = TWIN.by_name['engine.frequency']
    reason = ''
    if not entry.allows(frequency):
        reason = f'its frequency must be {entry.rule}'
    elif acceleration > _MAX_ACCELERATION:
        reason = f'no plate bears more than {_MAX_ACCELERATION:g} m/s2'
    elif 'projectile' in tracks and acceleration < _GRAVITY:
        reason = 'that is less than gravity and throws nothing'
    if reason:
        raise TrackError(
            f'at {rate:g} pictures per second the plate swings at {frequency:.3g} Hz, which takes '
            f'an acceleration of {acceleration:.3g} m/s2, but {reason}; --rate is that of the '
            'camera, not that at which the video is shown, and --scale a length in metres'
        )


@contextlib.contextmanager
def _naming_video(path: str) -> Iterator[None]:
    """Have all that may go wrong with a video said in a sentence that names it."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error).partition('\n')[0]
        raise TrackError(f'{path}: {reason}') from None
    except ValueError as error:
        raise TrackError(f'{path}: {error}') from None


def _save(tracks: Mapping[str, Track], path: str, arguments: argparse.Namespace) -> None:
    """Write tracks into a file, if one is asked for."""
    if arguments.tracks is None:
        return
    length, pixels = arguments.scale
    noises = ', '.join(f'{body} {track.noise:.2g} m' for body, track in tracks.items())
    how = f'{arguments.rate:g} pictures per second, {pixels:g} pixels are {length:g} m'
    lines = [
        f'# From {Path(path).name}: {how}.',
        f'# Noise: {noises}',
        *csv_lines(tracks),
    ]
    with naming(arguments.tracks), atomic_file(arguments.tracks) as unfinished:
        unfinished.write_text('\n'.join(lines) + '\n', encoding='utf-8')
