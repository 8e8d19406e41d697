# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Motions of a plate from files: times and heights as CSV, or a bag that holds them.

A file is read once in a process, so that one name means one motion. A journal contains the motions
of its files, see `encode`, and a repetition of the run takes them from there.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from functools import lru_cache
import math
from pathlib import Path
from typing import Any, TypeAlias
import zlib

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.csv_rows import Column, read_columns
from soft_throw_ros.configuration.interface import JOINT_STATE, JOINTS
from soft_throw_ros.configuration.recorded_motion import MAX_END_SPEED, motion_from_record
from soft_throw_ros.configuration.table import ParameterError, quote
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.storage.message import BagError, SECOND
from soft_throw_ros.storage.regular_file import open_regular_file, read_regular_file

Floats = NDArray[np.float64]

PARAMETER = 'engine.motion_file'

_COLUMNS = {
    'time': Column(('t', 'time'), {'s': 1.0, 'ms': 1e-3}, 's'),
    'height': Column(
        ('z', 'height', 'position', 'plate', 'z_plate', 'zp', 'z_p'),
        {'m': 1.0, 'mm': 1e-3, 'um': 1e-6},
        'm',
    ),
    'velocity': Column(('velocity',), {'m/s': 1.0}, 'm/s', needs_label=True),
    'acceleration': Column(('acceleration',), {'m/s2': 1.0}, 'm/s2', needs_label=True),
}
_STATES = ('height', 'velocity', 'acceleration')
_JOINT = JOINTS[0]
_BAGS = ('.mcap', '.zstd')
_STILL = 0.05
"""Duration of the rest that ends a throw in a bag. [s]"""

_AT_REST = 0.02
"""Range of a plate that is still, over its whole range. [-]"""

_BYTES = 1 << 26
"""Size of an unpacked motion of a journal, eight times the largest CSV file in numbers. [byte]"""

_MAX_BYTES = 1 << 24
"""Size of a CSV file [byte]: 100 s at 2.5 kHz."""

_MAX_BAG_BYTES = 1 << 28
"""Size of a file of a bag [byte]: minutes of a measured rig."""

MotionSource: TypeAlias = Callable[[str], SampledMotion]
"""Returns the motion of a plate by the path of its file."""


def read(path: str | Path) -> SampledMotion:
    """
    Read the motion of a plate from a file, see `recorded_motion.motion_from_record`.

    The file is a CSV of times and heights, see `_COLUMNS` for its labels; with the columns
    `velocity` and `acceleration`, the motion is exact. Or it is a bag, as a folder or an `.mcap`
    file: the joint `plate` of its JointState messages, preferably measured ones, in the first
    throw. ParameterError has file and line.
    """
    name = str(path)
    try:
        changed = Path(name).stat().st_mtime_ns
        return _read(name, changed)
    except OSError as error:
        raise ParameterError(f'{name}: {error.strerror}', PARAMETER) from None


@lru_cache(maxsize=4)  # each change of the rig asks again
def encode(motion: SampledMotion) -> str:
    """Write a motion as text for a journal, which takes milliseconds."""
    rows = np.column_stack([motion.times, motion.states]).astype('<f8')
    return base64.b64encode(zlib.compress(rows.tobytes(), 1)).decode()


def decode(text: str) -> SampledMotion:
    """Decode a motion; raise ValueError if the text is none."""
    try:
        data = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), _BYTES)
        rows = np.frombuffer(data, '<f8').reshape(-1, 4)
        return SampledMotion(rows[:, 0].copy(), rows[:, 1:].copy())
    except (TypeError, ValueError, zlib.error) as error:
        raise ValueError(f'no motion can be read, {error}, from {quote(text)}') from error


def to_csv(motion: SampledMotion) -> str:
    """Write a motion as CSV that `read` reads."""
    rows = np.column_stack([motion.times, motion.states]).tolist()
    lines = ['t [s],z [m],velocity [m/s],acceleration [m/s2]']
    return '\n'.join([*lines, *(','.join(map(repr, row)) for row in rows)]) + '\n'


def trajectory_points(motion: SampledMotion) -> list[dict[str, Any]]:
    """Return a motion as the fields of messages `trajectory_msgs/JointTrajectoryPoint`."""
    points = []
    for time, *state in np.column_stack([motion.times, motion.states]).tolist():
        seconds, nanoseconds = divmod(round(1e9 * time), 1_000_000_000)
        names = ('positions', 'velocities', 'accelerations')
        points.append({
            **{name: [value] for name, value in zip(names, state, strict=True)},
            'time_from_start': {'sec': seconds, 'nanosec': nanoseconds},
        })
    return points


@lru_cache(maxsize=64)
def _read(name: str, _changed: int) -> SampledMotion:
    """Read a file that has changed at a time [ns]."""
    path = Path(name)
    if path.is_dir() or path.suffix in _BAGS:
        times, heights = _first_throw(*_read_bag(path))
        return _motion(name, times, heights[:, None])
    try:
        lines = read_regular_file(path, max_bytes=_MAX_BYTES).decode('utf-8-sig').splitlines()
        columns = read_columns(lines, name, _COLUMNS)
    except UnicodeDecodeError:
        raise ParameterError(f'{name}: is no UTF-8 text', PARAMETER) from None
    except ValueError as error:
        raise ParameterError(str(error), PARAMETER) from None
    states = _STATES if set(_STATES) <= set(columns) else _STATES[:1]
    return _motion(name, columns['time'], np.stack([columns[key] for key in states], axis=1))


def _motion(name: str, times: Floats, states: Floats) -> SampledMotion:
    """Make a motion of heights, or of heights with velocities and accelerations."""
    try:
        if states.shape[1] == 1:
            return motion_from_record(times, states[:, 0])
        _require_rest(states)
        states[:, 0] -= states[0, 0]
        return SampledMotion(times - times[0], states)
    except ValueError as error:
        raise ParameterError(f'{name}: {error}', PARAMETER) from None


def _require_rest(states: Floats) -> None:
    start, end = states[[0, -1], 1].tolist()
    if start != 0.0 or abs(end) > MAX_END_SPEED * np.abs(states[:, 1]).max():
        raise ValueError(f'the plate must start and end at rest, got {start:g} and {end:g} m/s')


def _read_bag(path: Path) -> tuple[Floats, Floats]:
    """Return times and heights of the plate from the best topic of a bag."""
    from soft_throw_ros.storage.bag_reader import BagReader
    from soft_throw_ros.storage.recorded_positions import read_positions

    for file in path.glob('*.mcap') if path.is_dir() else [path]:
        open_regular_file(file, max_bytes=_MAX_BAG_BYTES).close()
    try:
        with BagReader(path) as reader:
            topics = {channel.topic for channel in reader.channels if channel.type == JOINT_STATE}
            recorded = read_positions(reader, topics, [_JOINT])
    except BagError as error:
        raise ParameterError(str(error), PARAMETER) from None
    series = {
        topic: [(stamp, height) for stamp, (height,) in item.rows.items() if math.isfinite(height)]
        for topic, item in recorded.items()
    }
    best = max(series, key=lambda topic: ('measured' in topic, len(series[topic])), default='')
    if not series.get(best):
        names = ', '.join(sorted(set().union(*(item.names for item in recorded.values()))))
        raise ParameterError(
            f'{path}: no JointState has a joint {_JOINT!r}, got {names or "none"}', PARAMETER
        )
    stamps, heights = map(np.array, zip(*sorted(series[best]), strict=True))
    scale = recorded[best].time_scale
    return scale * (stamps // SECOND + 1e-9 * (stamps % SECOND)), heights


def _first_throw(t: Floats, z: Floats) -> tuple[Floats, Floats]:
    """Return the part of a record until the plate is at rest after the first throw."""
    small = _AT_REST * np.ptp(z)
    started = int((np.abs(z - np.median(z[:8])) > 10.0 * small).argmax())
    end = t.size
    for first in range(started, t.size):
        stop = int(np.searchsorted(t, t[first] + _STILL))
        if stop < t.size and np.ptp(z[first:stop]) < small:
            end = stop
            break
    return t[:end], z[:end]
