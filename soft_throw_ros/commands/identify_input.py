# SPDX-License-Identifier: Apache-2.0
"""
Tracks from files: CSV, bags with messages JointState, high-speed videos.

What to read, and how, is said by the options of the command `identify`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
import contextlib
from dataclasses import replace
import math
import mimetypes
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands.options import number_or_text
from soft_throw_ros.commands.output import naming, require
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.track_csv import csv_lines, read_csv
from soft_throw_ros.identification.tracks import (
    FEWEST,
    find_throws,
    split_at_breaks,
    split_into_throws,
    ThrowTracks,
    Track,
    TrackError,
)
from soft_throw_ros.identification.video import (
    BODIES,
    follow_spots,
    Picture,
    space_time,
    SpaceTime,
    tracks_of,
)
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.cdr import decode_joint_states, MessageError

Floats = NDArray[np.float64]

_BODIES = ('plate', 'projectile')
_TYPE = 'sensor_msgs/msg/JointState'
_PREFERRED = ('/measured_joint_states', '/joint_states')
"""How topics end that are read before others: what is measured, then what the twin says."""

_MAX_FALSE_THROWS = 10  # that a record of one may be taken for because of its noise
_ONE_MOTION = 1.5  # times the noise that one motion leaves of a record at most, if it is of one
_MAX_CHANNELS = 4  # of a picture at most; a stack has more


def add_video_options(parser: argparse.ArgumentParser) -> None:
    """Add options for videos; `check_video_options` refuses what cannot be."""
    add = parser.add_argument_group(
        'videos',
        'files, or folders of pictures in the order of their numbers. Dark round spots are '
        'followed from the first picture on: the lowest is taken to be on the plate, the highest '
        'on the projectile.',
    ).add_argument
    add('--video', metavar='FILE', action='append', default=[], help='video of throws')
    add('--rate', metavar='HZ', type=number_or_text, help='pictures per second of the camera')
    add(
        '--scale', metavar=('M', 'PIXELS'), type=number_or_text, nargs=2,
        help='a length that is known, and how long it is in the pictures',
    )  # fmt: skip
    add(
        '--spots', metavar='BODY,...',
        help=f'what each spot is on, from the lowest to the highest: {", ".join(BODIES)}',
    )  # fmt: skip
    add('--tracks', metavar='FILE', type=Path, help='CSV file to write what was followed into')
    add(
        '--line', metavar=('COLUMN', 'FIRST', 'LAST'), type=int, nargs=3,
        help='with the video of a free layer: follow its edges along a vertical line, in the '
        'pixels of that column from row to row, instead of spots',
    )  # fmt: skip
    add('--space-time', metavar='FILE', type=Path, help='picture of that line over time to draw')


def check_video_options(arguments: argparse.Namespace) -> None:
    """Refuse what cannot be by a ValueError that names the option."""
    layers = [path for _, path in arguments.free_layer]
    videos = arguments.video + [path for path in layers if _is_video(path)]
    if not videos:
        for name in ('rate', 'scale', 'spots', 'tracks', 'line', 'space_time'):
            if getattr(arguments, name) is not None:
                raise ValueError(f'argument --{name.replace("_", "-")}: is for videos')
        return
    for name, values in (('rate', [arguments.rate]), ('scale', arguments.scale or [None])):
        for value in values:
            if value is None:
                raise ValueError(f'argument --{name}: must be given with a video')
            if not isinstance(value, float) or not 0.0 < value < math.inf:
                raise ValueError(f'argument --{name}: must be finite and positive, got {value}')
    for name in ('tracks', 'line'):
        if getattr(arguments, name) and len(videos) > 1:
            raise ValueError(f'argument --{name}: is for one video at a time, got {len(videos)}')
    if arguments.line and arguments.video:
        raise ValueError('argument --line: is for the video of a free layer')
    if arguments.space_time and not arguments.line:
        raise ValueError('argument --space-time: needs --line')
    require('a video', 'video', 'imageio', 'av', 'skimage')


def read_throws(path: str, arguments: argparse.Namespace) -> list[ThrowTracks]:
    """Read the throws of a CSV file, a bag or a video; a ValueError names file and line."""
    if path in arguments.video:
        tracks = _read_throw_video(path, arguments)
    elif Path(path).is_dir() or path.endswith(('.mcap', '.mcap.zstd')):
        tracks = _read_bag(path, arguments.topic)
    else:
        tracks = _read_csv(path, _BODIES, arguments.unit)
    if 'plate' not in tracks:
        raise TrackError(f'{path}: less than {FEWEST} positions of the plate')
    whole = ThrowTracks(
        name=Path(path).name,
        plate=_with_noise(tracks['plate'], arguments),
        projectile=_with_noise(tracks['projectile'], arguments)
        if 'projectile' in tracks
        else None,
    )
    with _naming(whole.name):
        whole = whole.between(arguments.start, arguments.end)
        return [throw for part in split_at_breaks(whole) for throw in _throws_of(part)]


def _throws_of(record: ThrowTracks) -> list[ThrowTracks]:
    """Cut a record into throws, unless one motion explains it."""
    if len(find_throws(record.plate)) < _MAX_FALSE_THROWS and _is_one_motion(record):
        return [record]
    return split_into_throws(record)


def read_layer(
    path: str, arguments: argparse.Namespace
) -> tuple[tuple[Track, Track], SpaceTime | None]:
    """Read bottom and top of a free layer; of a video, too, the line they were followed along."""
    line = None
    if _is_video(path):
        tracks, line = _read_layer_video(path, arguments)
    else:
        tracks = _read_csv(path, ('bottom', 'top'), arguments.unit)
    if 'top' not in tracks:
        raise TrackError(f'{path}: must have a time and both ends of the layer, got one end')
    with _naming(path):
        bottom, top = (
            _with_noise(tracks[end], arguments).between(arguments.start, arguments.end)
            for end in ('bottom', 'top')
        )
    return (bottom, top), line


@contextlib.contextmanager
def _naming(name: str) -> Iterator[None]:
    """Name the file of which tracks are refused."""
    try:
        yield
    except TrackError as error:
        raise TrackError(f'{name}: {error}') from None


def _with_noise(track: Track, arguments: argparse.Namespace) -> Track:
    return track if arguments.noise is None else replace(track, known_noise=arguments.noise)


def _read_csv(path: str, bodies: Sequence[str], unit: str) -> dict[str, Track]:
    with naming(path), Path(path).open(encoding='utf-8-sig', newline='') as file:
        return read_csv(file, path, bodies, unit=unit)


def _is_one_motion(record: ThrowTracks) -> bool:
    """Tell whether one motion explains a record that noise makes look like several throws."""
    try:
        residual = fit_plate(record.plate).fit.residuals[0]
    except FitError:
        return False
    return residual.rms < _ONE_MOTION * record.plate.noise


def _read_bag(path: str, topic: str | None) -> dict[str, Track]:
    """Read plate and projectile from the topic that was asked for, or the best of a bag."""
    datas: dict[str, list[bytes]] = {}
    with BagReader(path) as reader:
        names = {channel.topic for channel in reader.channels if channel.type == _TYPE}
        for message in reader.messages(names):
            datas.setdefault(message.channel.topic, []).append(message.data)
    rows: dict[str, Floats] = {}
    for name, some in datas.items():
        try:
            rows[name] = _read_positions(some)
        except MessageError as error:
            if name == topic:
                raise TrackError(f'{path}: {topic}: {error}') from None
    found = sorted(name for name, each in rows.items() if np.isfinite(each[:, 1]).any())
    if topic is None:
        ranks = [[name for name in found if name.endswith(ending)] for ending in _PREFERRED]
        best = next(filter(None, ranks), found)
    else:
        best = [name for name in found if name == topic]
    if len(best) != 1:
        raise TrackError(
            f'{path}: no topic {topic or "of its own"} has positions of a joint plate; those '
            f'that have: {", ".join(found) or "none"}' + (' (choose with --topic)' * bool(found))
        )
    time, *heights = rows[best[0]].T
    return {
        body: Track(time=time[np.isfinite(each)], position=each[np.isfinite(each)])
        for body, each in zip(_BODIES, heights, strict=True)
        if np.isfinite(each).sum() >= FEWEST
    }


def _read_positions(datas: Sequence[bytes]) -> Floats:
    """
    Read times since the first message, and heights of both bodies, NaN where one has none.

    Some messages may be of other joints, as of the plate alone.
    """
    by_length: dict[int, list[bytes]] = {}
    for data in datas:
        by_length.setdefault(len(data), []).append(data)
    stamps, heights = [], []
    for some in by_length.values():
        states = decode_joint_states(some)
        stamps.append(states.stamps)
        columns = np.full((states.stamps.size, len(_BODIES)), np.nan)
        for column, body in enumerate(_BODIES):
            if body in states.names and states.position.size:
                columns[:, column] = states.position[:, states.names.index(body)]
        heights.append(columns)
    stamps_ns, first = np.unique(np.concatenate(stamps), return_index=True)
    time = 1e-9 * (stamps_ns - stamps_ns[0])
    return np.column_stack([time, np.concatenate(heights)[first]])


# videos


def _read_throw_video(path: str, arguments: argparse.Namespace) -> dict[str, Track]:
    """Follow the spots of a throw."""
    with _naming_video(path):
        bodies = arguments.spots and [body.strip() for body in arguments.spots.split(',')]
        spots = follow_spots(_pictures(path))
        tracks = tracks_of(spots, bodies, rate=arguments.rate, scale=_scale(arguments))
    _save(tracks, path, arguments)
    return tracks


def _read_layer_video(
    path: str, arguments: argparse.Namespace
) -> tuple[dict[str, Track], SpaceTime | None]:
    """Follow bottom and top of a free layer, by spots or along a line."""
    line = None
    known = {'rate': arguments.rate, 'scale': _scale(arguments)}
    with _naming_video(path):
        if arguments.line:
            column, first, last = arguments.line
            line = space_time(_pictures(path), column=column, first=first, last=last, **known)
            bottom, top = line.edges()
        else:
            spots = follow_spots(_pictures(path))
            ends = tracks_of([spots[0], spots[-1]][: len(spots)], **known)
            if 'projectile' not in ends:
                raise TrackError('one spot is followed, where bottom and top are needed')
            bottom, top = ends['plate'], ends['projectile']
    tracks = {'bottom': bottom, 'top': top}
    _save(tracks, path, arguments)
    return tracks, line


def _pictures(path: str) -> Iterator[Picture]:
    """Read the pictures of a video, of a file of them or of a folder, in grey levels."""
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


def _scale(arguments: argparse.Namespace) -> float:
    length, size = arguments.scale
    return float(length / size)


def _is_video(path: str) -> bool:
    """Tell whether it is a video or a folder of pictures, by its name."""
    return Path(path).is_dir() or _kind(path) in ('video', 'image')


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
