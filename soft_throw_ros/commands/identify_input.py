# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Tracks from files: CSV, and bags with messages JointState.

The options of `add_track_options` choose the bodies, columns and units.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
import io
import math
from pathlib import Path

import numpy as np
from soft_throw_ros.commands.options import any_number
from soft_throw_ros.commands.output import CommandParser, report_io_errors
from soft_throw_ros.configuration.interface import JOINT_STATE, JOINTS, TWIN_TOPICS
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.track_csv import read_csv, UNITS
from soft_throw_ros.identification.tracks import (
    FEWEST,
    find_throws,
    split_at_breaks,
    split_into_throws,
    ThrowTracks,
    Track,
    TrackError,
)
from soft_throw_ros.identification.video import is_video
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.recorded_positions import read_positions
from soft_throw_ros.storage.regular_file import read_regular_file

_MAX_BYTES = 1 << 26
"""Size of a CSV file [byte]: minutes of two tracks at 10 kHz."""

_PREFERRED = tuple(
    topic.at('').name for topic in (TWIN_TOPICS.measured_joint_states, TWIN_TOPICS.joint_states)
)
"""Endings of topics by preference: measured positions come before positions of a twin."""

_MAX_FALSE_THROWS = 10  # number of throws up to which noise may have split a record of one throw
_ONE_MOTION = 1.5  # largest residual of a record of one throw, as a multiple of the noise


def add_track_options(parser: CommandParser) -> None:
    """Add the options for reading tracks; `read_throws` and `read_layer` use them."""
    add = parser.add_argument
    add('--unit', choices=UNITS, default='m', help='of heights in CSV files (default %(default)s)')
    add(
        '--from', dest='start', metavar='S', type=any_number, default=-math.inf,
        help='ignore samples before this time',
    )
    add(
        '--to', dest='end', metavar='S', type=any_number, default=math.inf,
        help='ignore samples after this time',
    )


def read_throws(
    path: str, arguments: argparse.Namespace, notes: list[str], *,
    noise: float | None = None, topic: str | None = None,
) -> list[ThrowTracks]:
    """
    Read the throws of a CSV file, or of a topic of a bag; a ValueError names file and line.

    `noise` is the standard deviation of heights, if it is known. A sentence about each defect of
    the tracks is appended to the notes.
    """
    if Path(path).is_dir() or path.endswith(('.mcap', '.mcap.zstd')):
        tracks = _read_bag(path, topic, notes)
    else:
        tracks = _read_csv(path, JOINTS, arguments.unit)
    if 'plate' not in tracks:
        raise TrackError(f'{path}: less than {FEWEST} positions of the plate')
    tracks = {body: replace(track, known_noise=noise) for body, track in tracks.items()}
    plate, projectile = tracks['plate'], tracks.get('projectile')
    whole = ThrowTracks(name=Path(path).name, plate=plate, projectile=projectile)
    with report_io_errors(whole.name, TrackError):
        whole = whole.between(arguments.start, arguments.end)
        whole = _without_lone_samples(whole, notes)
        return [throw for record in split_at_breaks(whole) for throw in _throws_of(record)]


def _without_lone_samples(record: ThrowTracks, notes: list[str]) -> ThrowTracks:
    """Remove isolated samples, and note their number."""

    def leave_out(track: Track) -> Track:
        lone = track.is_lone
        if not lone.any() or (~lone).sum() < FEWEST:
            return track
        first, last = track.time[lone][[0, -1]]
        notes.append(
            f'{record.name}: {lone.sum()} samples from {first:g} s to {last:g} s are far apart, '
            'as those with late stamps; they are left out'
        )
        # the noise is estimated anew: a height that goes with a late stamp may be anything
        return replace(track, time=track.time[~lone], position=track.position[~lone])

    return record.apply(leave_out)


def _throws_of(record: ThrowTracks) -> list[ThrowTracks]:
    """Cut a record into throws, unless a single motion explains the whole record."""
    if len(find_throws(record.plate)) < _MAX_FALSE_THROWS and _is_one_motion(record):
        return [record]
    return split_into_throws(record)


def read_layer(path: str, arguments: argparse.Namespace) -> tuple[Track, Track]:
    """Read bottom and top of a free layer from a CSV file."""
    tracks = _read_csv(path, ('bottom', 'top'), arguments.unit)
    if 'top' not in tracks:
        raise TrackError(f'{path}: must have a time and both ends of the layer, got one end')
    with report_io_errors(path, TrackError):
        bottom, top = (
            tracks[end].between(arguments.start, arguments.end) for end in ('bottom', 'top')
        )
    return bottom, top


def _read_csv(path: str, bodies: Sequence[str], unit: str) -> dict[str, Track]:
    if is_video(path):
        raise TrackError(f'{path}: is a video; first convert it to tracks with soft-throw track')
    with report_io_errors(path):
        text = read_regular_file(path, max_bytes=_MAX_BYTES).decode('utf-8-sig')
    return read_csv(io.StringIO(text, newline=''), path, bodies, unit=unit)


def _is_one_motion(record: ThrowTracks) -> bool:
    """Return whether one motion explains a record that noise seems to split into throws."""
    try:
        residual = fit_plate(record.plate).fit.residuals[0]
    except FitError:
        return False
    return residual.rms < _ONE_MOTION * record.plate.noise


def _read_bag(path: str, topic: str | None, notes: list[str]) -> dict[str, Track]:
    """Read plate and projectile from the requested topic, or from the preferred one of a bag."""
    with BagReader(path) as reader:
        names = {channel.topic for channel in reader.channels if channel.type == JOINT_STATE}
        recorded = read_positions(reader, names, JOINTS)
    with_plate = [
        name
        for name, item in recorded.items()
        if any(math.isfinite(plate) for plate, _ in item.rows.values())
    ]
    best = _choose_topic(path, sorted(with_plate), topic)
    if count := recorded[best].unreadable:
        notes.append(f'{path}: {count} messages on {best!r} are no {JOINT_STATE}, and left out')
    stamps, table = zip(*sorted(recorded[best].rows.items()), strict=True)
    time = 1e-9 * np.array([stamp - stamps[0] for stamp in stamps])
    tracks = {}
    for body, position in zip(JOINTS, np.transpose(table), strict=True):
        is_measured = np.isfinite(position)
        if is_measured.sum() >= FEWEST:
            tracks[body] = Track(time=time[is_measured], position=position[is_measured])
    return tracks


def _choose_topic(path: str, topics: Sequence[str], request: str | None) -> str:
    """Return the requested topic, or the preferred one; raise TrackError if it is not unique."""
    if request is not None:
        best = [topic for topic in topics if topic == request]
    else:
        ranks = [[topic for topic in topics if topic.endswith(end)] for end in _PREFERRED]
        best = next(filter(None, ranks), list(topics))
    if len(best) != 1:
        raise TrackError(
            f'{path}: no topic {request or "of its own"} has positions of a joint plate; those '
            f'that have: {", ".join(topics) or "none"}' + ' (`topic` of --fit-file)' * bool(topics)
        )
    return best[0]
