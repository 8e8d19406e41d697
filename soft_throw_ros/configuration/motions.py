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
Motions of a plate from files: times and heights as CSV, or a bag that holds them.

A file is read once in a process, so that one name means one motion. A journal carries the motions
of its files along, and whoever repeats it takes them from there, see `remember`.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from functools import lru_cache
import math
from pathlib import Path
import re
from typing import NamedTuple
import zlib

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.table import ParameterError, Settings
from soft_throw_ros.core.plate import FASTEST_END, SampledMotion

Floats = NDArray[np.float64]

PARAMETER = 'engine.motion_file'

_COLUMNS = {
    'time': (('t', 'time'), {'s': 1.0, 'ms': 1e-3}),
    'height': (
        ('z', 'height', 'position', 'plate', 'z_plate', 'zp', 'z_p'),
        {'m': 1.0, 'mm': 1e-3, 'um': 1e-6, '\N{MICRO SIGN}m': 1e-6},
    ),
    'velocity': (('velocity',), {'m/s': 1.0}),
    'acceleration': (('acceleration',), {'m/s2': 1.0}),
}
"""What columns may be called, and their units, of which the first is meant if none is given."""

_JOINT = 'plate'
_BAGS = ('.mcap', '.zstd')
_STILL = 0.05  # for which a plate has to be still in a bag for its throw to be over [s]
_AT_REST = 0.02  # part of its whole range by which it may move meanwhile [-]
_BYTES = 1 << 26  # of a motion in a journal

_remembered: dict[str, SampledMotion] = {}


def read(path: str | Path) -> SampledMotion:
    """
    Read the motion of a plate from a file, see `SampledMotion.from_record`.

    Parameters
    ----------
    path : path_like
        CSV: a time [s] and a height [m] in each line, separated by commas, semicolons, tabs or
        blanks; `#` begins comments. A first line may name the columns, then others may be between
        them: `t` or `time`, and `z`, `height`, `position` or `plate`, each perhaps with a unit in
        brackets; `velocity` and `acceleration` besides make heights exact. Or a bag, a folder or
        an `.mcap` file: the joint `plate` of its messages JointState, measured ones rather than
        others, in its first throw.

    Raises
    ------
    ParameterError
        Naming file and line, if it cannot be read or is no such motion.

    """
    name = str(path)
    if name in _remembered:
        return _remembered[name]
    try:
        return _read(name)
    except OSError as error:
        raise ParameterError(f'{name}: {error.strerror}', PARAMETER) from None


def of_settings(settings: Settings) -> SampledMotion | None:
    """Return the motion that settings ask for; None if it is no file's, or ParameterError."""
    if settings['engine.motion'] != 'file':
        return None
    if not settings[PARAMETER]:
        raise ParameterError(
            f"engine.motion 'file' needs {PARAMETER} (--motion-file), got ''", PARAMETER
        )
    return read(settings[PARAMETER])


def encode(settings: Settings) -> dict[str, str]:
    """Write the motion of a file that settings name, by its path, as text for a journal."""
    path = settings.get(PARAMETER)
    if not path:
        return {}
    motion = read(path)
    rows = np.column_stack([motion.times, motion.states]).astype('<f8')
    return {path: base64.b64encode(zlib.compress(rows.tobytes(), 1)).decode()}


def remember(motions: dict[str, str]) -> None:
    """Take motions by their paths from what `encode` wrote, whatever is in the files by now."""
    for path, text in motions.items():
        try:
            data = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), _BYTES)
            rows = np.frombuffer(data, '<f8').reshape(-1, 4)
            motion = SampledMotion(rows[:, 0].copy(), rows[:, 1:].copy())
        except (TypeError, ValueError, zlib.error) as error:
            raise ValueError(f'no motion of {path} can be read, {error}') from error
        known = _remembered.get(path)
        if known is None or not np.array_equal(known.states, motion.states):
            _remembered[path] = motion


def csv_lines(motion: SampledMotion) -> Iterator[str]:
    """Write a motion as lines of CSV that `read` reads."""
    yield 't [s],z [m],velocity [m/s],acceleration [m/s2]'
    for time, state in zip(motion.times.tolist(), motion.states.tolist(), strict=True):
        yield ','.join(map(repr, (time, *state)))


@lru_cache(maxsize=64)
def _read(name: str) -> SampledMotion:
    path = Path(name)
    if path.is_dir() or path.suffix in _BAGS:
        times, heights = _first_throw(*_read_bag(path))
        return _motion(name, times, heights[:, None])
    try:
        lines = path.read_text(encoding='utf-8-sig').splitlines()
    except UnicodeDecodeError:
        raise ParameterError(f'{name}: is no UTF-8 text', PARAMETER) from None
    return _motion(name, *_read_csv(lines, name))


def _motion(name: str, times: Floats, states: Floats) -> SampledMotion:
    """Make a motion of heights, or of heights with velocities and accelerations."""
    try:
        if states.shape[1] == 1:
            return SampledMotion.from_record(times, states[:, 0])
        _require_rest(states)
        states[:, 0] -= states[0, 0]
        return SampledMotion(times - times[0], states)
    except ValueError as error:
        raise ParameterError(f'{name}: {error}', PARAMETER) from None


def _require_rest(states: Floats) -> None:
    start, end = states[[0, -1], 1].tolist()
    if start != 0.0 or abs(end) > FASTEST_END * np.abs(states[:, 1]).max():
        raise ValueError(f'the plate must start and end at rest, got {start:g} and {end:g} m/s')


def _read_csv(lines: Iterable[str], name: str) -> tuple[Floats, Floats]:
    """Return times, and heights with all that there is of their derivatives."""
    rows: list[list[float]] = []
    columns: list[_Column] = []
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text or text.startswith('#'):
            continue
        where = f'{name}:{number}'
        cells = [cell.strip().strip('"') for cell in re.split(r'[,;\t]|\s+(?=[-+.\d])', text)]
        if not columns:
            if not re.match(r'[-+.\d]|nan|inf', cells[0]):
                columns = list(_named_columns(cells, where))
                continue
            columns = [_Column('time', 0), _Column('height', 1)]
        row = []
        for column in columns:
            cell = cells[column.place] if column.place < len(cells) else ''
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise ParameterError(
                    f'{where}: {column.name} must be a finite number, got {cell!r}', PARAMETER
                )
            row.append(value * column.unit)
        if rows and row[0] <= rows[-1][0]:
            raise ParameterError(
                f'{where}: time must increase, got {row[0]:g} after {rows[-1][0]:g}', PARAMETER
            )
        rows.append(row)
    table = np.array(rows).reshape(len(rows), max(len(columns), 2))
    return table[:, 0], table[:, 1:]


class _Column(NamedTuple):
    """What stands at which place of a line, and its unit in SI."""

    name: str
    place: int
    unit: float = 1.0


def _named_columns(cells: list[str], where: str) -> Iterator[_Column]:
    """Find columns by their names; both derivatives, or none, are taken besides."""
    found = [re.match(r'([^[(]*?)\s*(?:[\[(]([^])]*).*)?$', cell.lower()) for cell in cells]
    labels = [match.group(1) if match else '' for match in found]
    are_there = all(name in labels for name in ('velocity', 'acceleration'))
    for name, (labels_of, units) in _COLUMNS.items():
        if name in ('velocity', 'acceleration') and not are_there:
            continue
        place = next((labels.index(label) for label in labels_of if label in labels), None)
        if place is None:
            raise ParameterError(
                f'{where}: no column is named {" or ".join(labels_of)}, got {", ".join(cells)}',
                PARAMETER,
            )
        match = found[place]
        unit = (match.group(2) if match else None) or next(iter(units))
        if unit not in units:
            raise ParameterError(
                f'{where}: {name} must be in {" or ".join(units)}, got {cells[place]!r}', PARAMETER
            )
        yield _Column(name, place, units[unit])


def _read_bag(path: Path) -> tuple[Floats, Floats]:
    """Return times and heights of the plate from the best topic of a bag."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    files = sorted(path.glob('*.mcap')) if path.is_dir() else [path]
    series: dict[str, tuple[list[float], list[float]]] = {}
    try:
        for file in files:
            with file.open('rb') as stream:
                reader = make_reader(stream, decoder_factories=[DecoderFactory()])
                for schema, channel, _, message in reader.iter_decoded_messages():
                    is_state = schema is not None and schema.name == 'sensor_msgs/msg/JointState'
                    if is_state and _JOINT in message.name:
                        times, heights = series.setdefault(channel.topic, ([], []))
                        time = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
                        if not times or time > times[-1]:
                            times.append(time)
                            heights.append(message.position[list(message.name).index(_JOINT)])
    except (McapError, ValueError) as error:
        raise ParameterError(f'{path}: is no bag that can be read, {error}', PARAMETER) from None
    if not series:
        raise ParameterError(f'{path}: no JointState has a joint {_JOINT!r}', PARAMETER)
    best = max(series, key=lambda topic: ('measured' in topic, len(series[topic][0])))
    return np.array(series[best][0]), np.array(series[best][1])


def _first_throw(t: Floats, z: Floats) -> tuple[Floats, Floats]:
    """Cut a record off where its plate has come to rest after the first throw."""
    small = _AT_REST * np.ptp(z)
    started = int((np.abs(z - np.median(z[:8])) > 10.0 * small).argmax())
    end = t.size
    for first in range(started, t.size):
        stop = int(np.searchsorted(t, t[first] + _STILL))
        if stop < t.size and np.ptp(z[first:stop]) < small:
            end = stop
            break
    return t[:end], z[:end]
