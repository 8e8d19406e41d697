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
"""Tracks as lines of text: a time and heights in each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import math

import numpy as np
from soft_throw_ros.configuration.csv_rows import is_header, parse_label, read_rows
from soft_throw_ros.configuration.table import float_of
from soft_throw_ros.identification.tracks import (
    FEWEST,
    MAX_HEIGHT,
    MAX_TIME,
    MIN_STEP,
    Track,
    TrackError,
)

UNITS = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6}
"""Units of height. [m]"""

COLUMN_NAMES = {
    'plate': ('plate', 'z_plate', 'zp', 'z_p'),
    'projectile': ('projectile', 'z_projectile', 'zm', 'z_m'),
    'bottom': ('bottom', 'z_bottom', 'lower', 'z_lower'),
    'top': ('top', 'z_top', 'upper', 'z_upper'),
}
"""Accepted names of columns, by body."""

_TIME_NAMES = ('t', 'time')
_MISSING = ('', 'nan')


def read_csv(
    lines: Iterable[str], name: str, bodies: Sequence[str], *, unit: str = 'm'
) -> dict[str, Track]:
    """
    Read tracks from lines of text.

    Parameters
    ----------
    lines : iterable of str
        Lines with a time [s] and the heights of bodies, see `csv_rows`. A first line may name the
        columns (`t` or `time`, and `COLUMN_NAMES`, with an optional unit in brackets); other
        columns are skipped then. Without it, the columns are time and `bodies` in this order. A
        height that is empty or nan is missing.
    name : str
        Name of the text in errors.
    bodies : sequence of str
        Bodies to read. The first must be there, the others may be missing altogether.
    unit : str
        Unit of the heights, one of `UNITS`.

    Raises
    ------
    TrackError
        With the number of the line, if something is wrong.

    """
    rows = list(read_rows(lines))
    if not rows:
        raise TrackError(f'{name}: is empty; a time and the height of the {bodies[0]} are needed')
    number, first = rows[0]
    number_of_first = number
    columns = dict(zip(('time', *bodies), range(len(first)), strict=False))
    if is_header(first):
        columns = _named_columns(rows.pop(0)[1], bodies, unit, f'{name}:{number}')
    if not rows:
        raise TrackError(f'{name}:{number}: names columns, but no line with numbers follows')
    if len(columns) < 2:
        raise TrackError(
            f'{name}:{number}: must have a time and the height of the {bodies[0]}, '
            f'got {first[0]!r} alone'
        )
    clock = list(columns).index('time')
    most = dict.fromkeys(bodies, MAX_HEIGHT / UNITS[unit]) | {'time': MAX_TIME}
    values = np.empty((len(rows), len(columns)))
    for row, (number, cells) in enumerate(rows):
        where = f'{name}:{number}'
        if len(cells) == len(first) + 1 and not cells[-1]:
            del cells[-1]  # the line ends with a separator
        if len(cells) != len(first):
            hint = '; the same sign must separate the values of all lines' * (len(cells) == 1)
            raise TrackError(
                f'{where}: must have {len(first)} values as line {number_of_first} has, '
                f'got {len(cells)}{hint}'
            )
        for column, (body, cell) in enumerate(columns.items()):
            values[row, column] = _read_number(cells[cell], body, where, most[body])
        time, before = values[row, clock], values[row - 1, clock] if row else -math.inf
        if time - before < MIN_STEP:
            raise TrackError(f'{where}: time must increase, got {time:g} after {before:g}')
    heights = dict(zip(columns, values.T, strict=True))
    time = heights.pop('time')
    tracks = {}
    for body, series in heights.items():
        seen = np.isfinite(series)
        if seen.sum() >= FEWEST:
            tracks[body] = Track(time=time[seen], position=UNITS[unit] * series[seen])
        elif body == bodies[0] or seen.any():
            raise TrackError(
                f'{name}: {seen.sum()} heights of the {body}, where at least {FEWEST} are needed'
            )
    return tracks


def csv_lines(tracks: Mapping[str, Track]) -> Iterator[str]:
    """Write tracks as lines of text that `read_csv` reads."""
    yield ','.join(['t [s]', *(f'{body} [m]' for body in tracks)])
    heights = [
        dict(zip(track.time.tolist(), track.position.tolist(), strict=True))
        for track in tracks.values()
    ]
    for time in sorted(set().union(*heights)):
        cells = [f'{item[time]:.9g}' if time in item else '' for item in heights]
        yield ','.join([f'{time:.9g}', *cells])


def _read_number(text: str, what: str, where: str, most: float) -> float:
    """Read a number that is not above `most`, or below as much; heights may be missing."""
    if text.lower() in _MISSING and what != 'time':
        return math.nan
    value = float_of(text)
    if value is None or not math.isfinite(value):
        raise TrackError(f'{where}: {what} must be a finite number, got {text!r}')
    if abs(value) > most:
        raise TrackError(f'{where}: {what} must be within +- {most:g}, got {text!r}')
    return value


def _named_columns(
    cells: Sequence[str], bodies: Sequence[str], unit: str, where: str
) -> dict[str, int]:
    """Find columns by their names."""
    known = {'time': (_TIME_NAMES, 's'), **{body: (COLUMN_NAMES[body], unit) for body in bodies}}
    columns: dict[str, int] = {}
    for index, cell in enumerate(cells):
        label = parse_label(cell)
        for body, (names, expected) in known.items():
            if label.name in names:
                if label.unit not in ('', expected):
                    is_height = body != 'time' and label.unit in UNITS
                    hint = f'; see --unit {label.unit}' if is_height else ''
                    raise TrackError(f'{where}: {body} is read in {expected}, got {cell!r}{hint}')
                if body in columns:
                    raise TrackError(f'{where}: {body} must be there once, got {cell!r} too')
                columns[body] = index
    for body in ('time', bodies[0]):
        if body not in columns:
            raise TrackError(
                f'{where}: no column is named {known[body][0][0]!r}, got {", ".join(cells)}; '
                'lines above the names must begin with #'
            )
    return columns
