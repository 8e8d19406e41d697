# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Tracks from files: CSV, and bags with messages JointState.

The options of `add_track_options` choose the bodies, columns and units.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
from dataclasses import replace
from functools import partial
import io
import math
from pathlib import Path

import numpy as np
from soft_throw_ros.commands.options import any_number
from soft_throw_ros.commands.output import CommandParser, report_io_errors
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.interface import JOINT_STATE, JOINTS, TWIN_TOPICS
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.track_csv import read_csv, TIME_UNITS, UNITS, unused_columns
from soft_throw_ros.identification.tracks import (
    dominant_period,
    FEWEST,
    find_throws,
    split_at_breaks,
    ThrowTracks,
    Track,
    TrackError,
)
from soft_throw_ros.identification.video import is_video
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.recorded_positions import read_positions
from soft_throw_ros.storage.regular_file import read_regular_file

# Endings of topics by preference: measured positions come before positions of a twin
_PREFERRED = tuple(
    topic.at('').name for topic in (TWIN_TOPICS.measured_joint_states, TWIN_TOPICS.joint_states)
)
_MAX_BYTES = 1 << 26  # size of a CSV file [byte]: minutes of two tracks at 10 kHz
_MAX_INTERVAL = 0.01  # usual time between samples, above which the unit of time is doubtful [s]
_MAX_FALSE_THROWS = 10  # number of throws up to which noise may have split a record of one throw
_ONE_MOTION = 1.5  # largest residual of a record of one throw, as a multiple of the noise


def add_track_options(parser: CommandParser) -> None:
    """Add the options for reading tracks; `read_throws` and `read_layer` use them."""
    add = parser.add_argument
    add('--unit', choices=UNITS, default='m',
        help='unit of heights in CSV files whose labels have none (default %(default)s)')
    add('--time-unit', choices=TIME_UNITS, default='s', help='the same of times (default s)')
    add('--from', dest='start', metavar='S', type=any_number, default=-math.inf,
        help='ignore samples before this time')
    add('--to', dest='end', metavar='S', type=any_number, default=math.inf,
        help='ignore samples after this time')


def read_throws(
    arguments: argparse.Namespace, *,
    noise: float | None = None, stamp_error: float = 0.0, topic: str | None = None,
) -> tuple[list[ThrowTracks], list[str]]:
    """
    Read the throws of CSV files, and of a topic of bags; return them with notes on defects.

    `noise` is the standard deviation of heights, if it is known, and `stamp_error` that of times
    [s]. A ValueError names the file and the line.
    """
    throws: list[ThrowTracks] = []
    notes: list[str] = []
    for path in arguments.files:
        if Path(path).is_dir() or path.endswith(('.mcap', '.mcap.zstd')):
            tracks = _read_bag(path, topic, notes)
        else:
            tracks = _read_csv(path, JOINTS, arguments, notes)
        if 'plate' not in tracks:
            raise TrackError(f'{path}: less than {FEWEST} positions of the plate')
        record = ThrowTracks(name=Path(path).name, **{
            body: replace(track, known_noise=noise, stamp_error=stamp_error)
            for body, track in tracks.items()
        })
        with report_io_errors(record.name, TrackError):
            record = record.between(arguments.start, arguments.end)
            _check_time(record.plate)
            record = record.apply(partial(_without_standstill, record.name, notes))
            throws += _throws_of(record, notes)
    return throws, notes


def _check_time(plate: Track) -> None:
    """Refuse times that are in another unit, which would take minutes to fit."""
    frequency, entry = 1.0 / dominant_period(plate), TWIN.by_name['engine.frequency']
    if plate.interval > _MAX_INTERVAL and frequency < entry.low:
        raise TrackError(
            f'the plate would swing with {frequency:.2g} Hz, which must be {entry.rule}; the unit '
            'of time is not s: see --time-unit ms, or divide numbers of pictures by their rate'
        )


def _without_standstill(name: str, notes: list[str], track: Track) -> Track:
    """Remove samples that stand still while the body moves, and note them."""
    still = track.is_stuck
    if not still.any():
        return track
    first, last = track.time[still][[0, -1]]
    notes.append(
        f'{name}: {still.sum()} samples from {first:g} s to {last:g} s stand still at '
        f'{track.position[still][0]:.6g} m while the body moves; they are left out'
    )
    return track.where(~still)


def _throws_of(record: ThrowTracks, notes: list[str]) -> list[ThrowTracks]:
    """Cut a record into throws; leave out the parts in which the plate does not jump."""
    parts: list[ThrowTracks] = []
    for part in split_at_breaks(record):
        spans = find_throws(part.plate)
        if len(spans) < _MAX_FALSE_THROWS:
            with contextlib.suppress(FitError):
                # one motion explains what noise seems to split into throws
                if fit_plate(part.plate).residuals[0].rms < _ONE_MOTION * part.plate.noise:
                    spans = []
        parts += part.split(spans, 'throw')
    throws = []
    for part in parts if len(parts) > 1 else ():
        try:
            fit_plate(part.plate)
        except FitError as error:
            notes.append(f'{part.name} is left out: {error}')
        else:
            throws.append(part)
    return throws or parts


def read_layer(path: str, arguments: argparse.Namespace) -> tuple[Track, Track]:
    """Read bottom and top of a free layer from a CSV file."""
    tracks = _read_csv(path, ('bottom', 'top'), arguments, [])
    if 'top' not in tracks:
        raise TrackError(f'{path}: must have a time and both ends of the layer, got one end')
    with report_io_errors(path, TrackError):
        bottom, top = (
            tracks[end].between(arguments.start, arguments.end) for end in ('bottom', 'top')
        )
    return bottom, top


def _read_csv(
    path: str, bodies: Sequence[str], arguments: argparse.Namespace, notes: list[str]
) -> dict[str, Track]:
    if is_video(path):
        raise TrackError(f'{path}: is a video; first convert it to tracks with soft-throw track')
    with report_io_errors(path):
        text = read_regular_file(path, max_bytes=_MAX_BYTES).decode('utf-8-sig')
    tracks = read_csv(
        io.StringIO(text, newline=''), path, bodies,
        unit=arguments.unit, time_unit=arguments.time_unit,
    )
    if unused := unused_columns(text.splitlines(), bodies):
        notes.append(f'{path}: columns that are not used: {", ".join(unused)}')
    return tracks


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
    if not with_plate:
        others = sorted(set().union(*(item.names for item in recorded.values())))
        raise TrackError(f'{path}: no joint is named plate, got {", ".join(others) or "none"}')
    best = _choose_topic(path, sorted(with_plate), topic)
    if count := recorded[best].unreadable:
        notes.append(f'{path}: {count} messages on {best!r} are no {JOINT_STATE}, and left out')
    stamps, table = zip(*sorted(recorded[best].rows.items()), strict=True)
    time = 1e-9 * recorded[best].time_scale * np.array([stamp - stamps[0] for stamp in stamps])
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
