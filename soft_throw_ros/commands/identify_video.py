# SPDX-License-Identifier: Apache-2.0
"""Tracks from high-speed videos, and options that say how to read them."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import math
import mimetypes
from pathlib import Path
import re

from soft_throw_ros.commands.options import number_or_text
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.track_csv import csv_lines
from soft_throw_ros.identification.tracks import Track, TrackError
from soft_throw_ros.identification.video import (
    BODIES,
    follow_spots,
    Picture,
    space_time,
    SpaceTime,
    tracks_of,
)

_MAX_CHANNELS = 4  # of a picture at most; a stack has more


def add_video_options(parser: argparse.ArgumentParser) -> None:
    """Add options for videos; `check_video_options` refuses what cannot be."""
    group = parser.add_argument_group(
        'videos',
        'files, or folders of pictures in the order of their numbers. Dark round spots are '
        'followed from the first picture on: the lowest is taken to be on the plate, the highest '
        'on the projectile.',
    )
    group.add_argument(
        '--video', metavar='FILE', action='append', default=[], help='video of throws'
    )
    group.add_argument(
        '--rate', metavar='HZ', type=number_or_text, help='pictures per second of the camera'
    )
    group.add_argument(
        '--scale',
        metavar=('M', 'PIXELS'),
        type=number_or_text,
        nargs=2,
        help='a length that is known, and how long it is in the pictures',
    )
    group.add_argument(
        '--spots',
        metavar='BODY,...',
        help=f'what each spot is on, from the lowest to the highest: {", ".join(BODIES)}',
    )
    group.add_argument(
        '--tracks', metavar='FILE', type=Path, help='CSV file to write what was followed into'
    )
    group.add_argument(
        '--line',
        metavar=('COLUMN', 'FIRST', 'LAST'),
        type=int,
        nargs=3,
        help='with the video of a free layer: follow its edges along a vertical line, in the '
        'pixels of that column from row to row, instead of spots',
    )
    group.add_argument(
        '--space-time', metavar='FILE', type=Path, help='picture of that line over time to draw'
    )


def is_video(path: str) -> bool:
    """Tell whether it is a video or a folder of pictures, by its name."""
    return Path(path).is_dir() or _kind(path) in ('video', 'image')


def check_video_options(arguments: argparse.Namespace) -> None:
    """
    Refuse what cannot be.

    Raises
    ------
    ValueError
        Naming the option.

    """
    layers = [path for _, path in arguments.free_layer]
    videos = arguments.video + [path for path in layers if is_video(path)]
    given = {
        name: getattr(arguments, name)
        for name in ('rate', 'scale', 'spots', 'tracks', 'line', 'space_time')
    }
    if not videos:
        for name, value in given.items():
            if value is not None:
                raise ValueError(f'argument --{name.replace("_", "-")}: is for videos')
        return
    for name, values in (('rate', [arguments.rate]), ('scale', arguments.scale or [None])):
        if None in values:
            raise ValueError(f'argument --{name}: must be given with a video')
        for value in values:
            if not isinstance(value, float) or not 0.0 < value < math.inf:
                raise ValueError(f'argument --{name}: must be finite and positive, got {value}')
    if (arguments.tracks or arguments.line) and len(videos) > 1:
        option = '--tracks' if arguments.tracks else '--line'
        raise ValueError(f'argument {option}: is for one video at a time, got {len(videos)}')
    if arguments.line and arguments.video:
        raise ValueError('argument --line: is for the video of a free layer')
    if arguments.space_time and not arguments.line:
        raise ValueError('argument --space-time: needs --line')


def read_throw(path: str, arguments: argparse.Namespace) -> dict[str, Track]:
    """
    Follow the spots of a throw.

    Raises
    ------
    ValueError
        If it is no video, or shows none; or if what is needed for it is not installed.

    """
    with _naming_file(path):
        bodies = arguments.spots and [body.strip() for body in arguments.spots.split(',')]
        spots = follow_spots(pictures(path))
        tracks = tracks_of(spots, bodies, rate=arguments.rate, scale=_scale(arguments))
    _save(tracks, path, arguments)
    return tracks


def read_layer(
    path: str, arguments: argparse.Namespace
) -> tuple[tuple[Track, Track], SpaceTime | None]:
    """
    Follow bottom and top of a free layer, by spots or along a line.

    Returns
    -------
    (Track, Track), SpaceTime or None
        The line, if there is one.

    Raises
    ------
    ValueError
        As for `read_throw`.

    """
    line = None
    known = {'rate': arguments.rate, 'scale': _scale(arguments)}
    with _naming_file(path):
        if arguments.line:
            column, first, last = arguments.line
            line = space_time(pictures(path), column=column, first=first, last=last, **known)
            bottom, top = line.edges()
        else:
            spots = follow_spots(pictures(path))
            ends = tracks_of([spots[0], spots[-1]][: len(spots)], **known)
            if 'projectile' not in ends:
                raise TrackError('one spot is followed, where bottom and top are needed')
            bottom, top = ends['plate'], ends['projectile']
    _save({'bottom': bottom, 'top': top}, path, arguments)
    return (bottom, top), line


def pictures(path: str) -> Iterator[Picture]:
    """
    Read the pictures of a video, in grey levels.

    Parameters
    ----------
    path : str
        Of a video, of a file of pictures, or of a folder of pictures.

    Raises
    ------
    TrackError
        If there are none.
    ImportError, OSError, ValueError
        If that cannot be read.

    """
    from imageio import v3 as imageio

    if Path(path).is_dir():
        files = [each for each in Path(path).iterdir() if _kind(str(each)) == 'image']
        if not files:
            raise TrackError('there is no picture in this folder')
        for file in sorted(files, key=_by_number):
            yield from _grey(imageio.imread(file))
    elif _kind(path) == 'video':
        for picture in imageio.imiter(path, plugin='pyav', format='gray'):
            yield from _grey(picture)
    elif _kind(path) == 'image':
        yield from _grey(imageio.imread(path))
    else:
        raise TrackError('must be a video or a folder of pictures')


@contextlib.contextmanager
def _naming_file(path: str) -> Iterator[None]:
    """Have all that may go wrong with a file said in a sentence that names it."""
    try:
        yield
    except ImportError as error:
        reason = str(error).partition('\n')[0]
        raise FitError(
            f"a video needs what pip installs with 'soft_throw_ros[video]': {reason}"
        ) from None
    except OSError as error:
        reason = error.strerror or str(error).partition('\n')[0]
        raise TrackError(f'{path}: {reason}') from None
    except ValueError as error:
        raise TrackError(f'{path}: {error}') from None


def _save(tracks: dict[str, Track], path: str, arguments: argparse.Namespace) -> None:
    """Write tracks into a file, if one is asked for."""
    if arguments.tracks is None:
        return
    length, pixels = arguments.scale
    origin = (
        f'# From {Path(path).name}: {arguments.rate:g} pictures per second, {pixels:g} pixels '
        f'are {length:g} m.'
    )
    noises = ', '.join(f'{body} {track.noise:.2g} m' for body, track in tracks.items())
    try:
        with atomic_file(arguments.tracks) as unfinished:
            text = '\n'.join([origin, f'# Noise: {noises}', *csv_lines(tracks)])
            unfinished.write_text(f'{text}\n', encoding='utf-8')
    except OSError as error:
        raise ValueError(f'{arguments.tracks}: {error.strerror}') from None


def _scale(arguments: argparse.Namespace) -> float:
    length, size = arguments.scale
    return float(length / size)


def _kind(path: str) -> str:
    return (mimetypes.guess_type(path)[0] or '').partition('/')[0]


def _grey(levels: Picture) -> Iterator[Picture]:
    """Yield the pictures of a stack, or the only one, without colours."""
    if levels.ndim == 2:
        yield levels
    elif levels.ndim == 3 and levels.shape[-1] <= _MAX_CHANNELS:
        yield levels[..., :3].mean(axis=-1)
    else:
        for each in levels:
            yield from _grey(each)


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sort `frame_2` before `frame_10`."""
    return [
        (int(part), '') if part.isdecimal() else (0, part)
        for part in re.split(r'(\d+)', path.name, flags=re.ASCII)
    ]
