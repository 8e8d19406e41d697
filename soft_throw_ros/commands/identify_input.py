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
Tracks from files: CSV, bags with messages JointState, and videos.

What to read, and how, is said by the options of the command `identify`.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
import contextlib
from dataclasses import replace
import math
from pathlib import Path
import sys

import numpy as np
from soft_throw_ros.commands.identify_video import read_layer_video, read_throw_video
from soft_throw_ros.commands.output import naming
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.track_csv import read_csv
from soft_throw_ros.identification.tracks import (
    FEWEST,
    find_throws,
    split_at_breaks,
    split_into_throws,
    ThrowTracks,
    Track,
    TrackError,
)
from soft_throw_ros.identification.video import is_video, SpaceTime
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.cdr import JointStateReader, MessageError

_BODIES = ('plate', 'projectile')
_TYPE = 'sensor_msgs/msg/JointState'
_PREFERRED = ('/measured_joint_states', '/joint_states')
"""How topics end that are read before others: what is measured, then what the twin says."""

_MAX_FALSE_THROWS = 10  # that a record of one may be taken for because of its noise
_ONE_MOTION = 1.5  # times the noise that one motion leaves of a record at most, if it is of one


def read_throws(path: str, arguments: argparse.Namespace) -> list[ThrowTracks]:
    """Read the throws of a CSV file, a bag or a video; a ValueError names file and line."""
    if path in arguments.video:
        tracks = read_throw_video(path, arguments)
    elif Path(path).is_dir() or path.endswith(('.mcap', '.mcap.zstd')):
        tracks = _read_bag(path, arguments.topic)
    else:
        tracks = _read_csv(path, _BODIES, arguments.unit)
    if 'plate' not in tracks:
        raise TrackError(f'{path}: less than {FEWEST} positions of the plate')
    tracks = {body: _with_noise(track, arguments) for body, track in tracks.items()}
    plate, projectile = tracks['plate'], tracks.get('projectile')
    whole = ThrowTracks(name=Path(path).name, plate=plate, projectile=projectile)
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
    if is_video(path):
        tracks, line = read_layer_video(path, arguments)
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
    heights: dict[str, dict[int, list[float]]] = {}  # by topic and stamp [ns]
    readers: dict[str, JointStateReader] = defaultdict(JointStateReader)
    unreadable: Counter[str] = Counter()
    with BagReader(path) as reader:
        names = {channel.topic for channel in reader.channels if channel.type == _TYPE}
        for message in reader.messages(names):
            name = message.channel.topic
            try:
                values = readers[name].read(message.data)
            except MessageError:
                unreadable[name] += 1
                continue
            # some may be of other joints, as of the plate alone
            seen = dict(zip(values.names, values.position))  # noqa: B905  or without positions
            row = [seen.get(body, math.nan) for body in _BODIES]
            heights.setdefault(name, {}).setdefault(values.stamp_ns, row)
        damage = reader.damage
    if damage:
        print(f'identify: {damage}; what can be read is taken', file=sys.stderr)
    found = sorted(
        name
        for name, rows in heights.items()
        if any(math.isfinite(plate) for plate, _ in rows.values())
    )
    ranks = [[name for name in found if name.endswith(ending)] for ending in _PREFERRED]
    best = next(filter(None, ranks), found)
    if topic is not None:
        best = [name for name in found if name == topic]
    if len(best) != 1:
        raise TrackError(
            f'{path}: no topic {topic or "of its own"} has positions of a joint plate; those '
            f'that have: {", ".join(found) or "none"}' + (' (choose with --topic)' * bool(found))
        )
    if count := unreadable[best[0]]:
        print(
            f'identify: {path}: {count} messages on {best[0]!r} are no {_TYPE}, and left out',
            file=sys.stderr,
        )
    rows = sorted(heights[best[0]].items())
    time = 1e-9 * np.array([stamp - rows[0][0] for stamp, _ in rows])
    tracks = {}
    for body, each in zip(_BODIES, np.array([row for _, row in rows]).T, strict=True):
        is_seen = np.isfinite(each)
        if is_seen.sum() >= FEWEST:
            tracks[body] = Track(time=time[is_seen], position=each[is_seen])
    return tracks
