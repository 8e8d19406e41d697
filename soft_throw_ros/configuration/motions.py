# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Motions of a plate from CSV files of times and heights.

A file is read once in a process, so that one name means one motion. A journal contains the motions
of its files, see `encode`, and a repetition of the run takes them from there.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias
import zlib

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.csv_rows import Column, read_columns
from soft_throw_ros.configuration.recorded_motion import MAX_END_SPEED, motion_from_record
from soft_throw_ros.configuration.table import ParameterError, quote
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.storage.regular_file import read_regular_file

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

_BYTES = 1 << 26
"""Size of an unpacked motion of a journal, eight times the largest CSV file in numbers. [byte]"""

_MAX_BYTES = 1 << 24
"""Size of a CSV file [byte]: 100 s at 2.5 kHz."""

MotionSource: TypeAlias = Callable[[str], SampledMotion]
"""Returns the motion of a plate by the path of its file."""


def read(path: str | Path) -> SampledMotion:
    """
    Read the motion of a plate from a CSV of times and heights, see `_COLUMNS` for its labels.

    With the columns `velocity` and `acceleration` the motion is exact; otherwise
    `recorded_motion.motion_from_record` smooths the heights. ParameterError has file and line.

    """
    name = str(path)
    try:
        return _read(name, Path(name).stat().st_mtime_ns)
    except OSError as error:
        raise ParameterError(f'{name}: {error.strerror}', PARAMETER) from None


@lru_cache(maxsize=64)
def _read(name: str, _changed_ns: int) -> SampledMotion:
    """Read a file that has changed at a time [ns]."""
    try:
        text = read_regular_file(name, max_bytes=_MAX_BYTES).decode('utf-8-sig')
        columns = read_columns(text.splitlines(), name, _COLUMNS)
    except UnicodeDecodeError:
        raise ParameterError(f'{name}: is no UTF-8 text', PARAMETER) from None
    except ValueError as error:
        raise ParameterError(str(error), PARAMETER) from None
    times = columns['time']
    try:
        if not set(_STATES) <= set(columns):
            return motion_from_record(times, columns['height'])
        states = np.stack([columns[key] for key in _STATES], axis=1)
        _require_rest(states)
        states[:, 0] -= states[0, 0]
        return SampledMotion(times - times[0], states)
    except ValueError as error:
        raise ParameterError(f'{name}: {error}', PARAMETER) from None


def _require_rest(states: Floats) -> None:
    start, end = states[[0, -1], 1].tolist()
    if start != 0.0 or abs(end) > MAX_END_SPEED * np.abs(states[:, 1]).max():
        raise ValueError(f'the plate must start and end at rest, got {start:g} and {end:g} m/s')


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
