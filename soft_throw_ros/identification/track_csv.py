# SPDX-License-Identifier: Apache-2.0
"""Tracks as lines of text: a time and heights in each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import math
import re

import numpy as np
from soft_throw_ros.identification.tracks import FEWEST, Track, TrackError

UNITS = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6}
"""Units of height. [m]"""

COLUMN_NAMES = {
    'plate': ('plate', 'z_plate', 'zp', 'z_p'),
    'projectile': ('projectile', 'z_projectile', 'zm', 'z_m'),
    'bottom': ('bottom', 'z_bottom', 'lower', 'z_lower'),
    'top': ('top', 'z_top', 'upper', 'z_upper'),
}
"""Bodies, and what their columns may be called."""

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
        A time [s] and the heights of bodies in each, separated by commas, semicolons, tabs or
        blanks. A first line may name the columns (`t` or `time`, and `COLUMN_NAMES`, a unit in
        brackets may follow); others are then passed over. Without one they are time and `bodies`
        in this order. Lines that begin with # are comments; a height that is empty or nan was
        not seen. Unless commas separate, one may also be the decimal sign.
    name : str
        What to call the text if something is wrong.
    bodies : sequence of str
        Bodies to read. The first must be there, the others may be missing altogether.
    unit : str
        Of the heights, one of `UNITS`.

    Returns
    -------
    dict of str to Track

    Raises
    ------
    TrackError
        With the number of the line, if something is wrong.

    Examples
    --------
    >>> lines = ['t [s]; plate [mm]'] + [f'{t}; {t * t}' for t in range(20)]
    >>> track = read_csv(lines, 'example', ('plate',), unit='mm')['plate']
    >>> round(float(track.position[3]), 6)
    0.009

    """
    scale = UNITS[unit]
    columns: dict[str, int] = {}
    values: dict[str, list[float]] = {}
    times: list[float] = []
    width = 0
    for number, cells in _rows(lines):
        where = f'{name}:{number}'
        if not columns:
            is_header = not any(map(_is_number, cells))
            columns = (
                _named_columns(cells, bodies, unit, where)
                if is_header
                else _unnamed_columns(cells, bodies)
            )
            values = {body: [] for body in columns if body != 'time'}
            width = len(cells)
            if not values:
                raise TrackError(
                    f'{where}: must have a time and the height of the {bodies[0]}, '
                    f'got {cells[0]!r} alone'
                )
            if is_header:
                continue
        if len(cells) != width:
            raise TrackError(f'{where}: must have {width} values as above, got {len(cells)}')
        time = _read_number(cells[columns['time']], 'time', where)
        if math.isnan(time):
            raise TrackError(f'{where}: time must be a finite number, got {"nan"!r}')
        if times and time <= times[-1]:
            raise TrackError(f'{where}: time must increase, got {time:g} after {times[-1]:g}')
        times.append(time)
        for body, series in values.items():
            series.append(scale * _read_number(cells[columns[body]], body, where))
    if not columns:
        raise TrackError(f'{name}: is empty; a time and the height of the {bodies[0]} are needed')
    return dict(_tracks(times, values, bodies[0], name))


def csv_lines(tracks: Mapping[str, Track]) -> Iterator[str]:
    """
    Write tracks as lines of text that `read_csv` reads.

    Examples
    --------
    >>> track = Track(time=0.5 * np.arange(20.0), position=1e-3 * np.arange(20.0))
    >>> list(csv_lines({'plate': track}))[:3]
    ['t [s],plate [m]', '0,0', '0.5,0.001']

    """
    yield ','.join(['t [s]', *(f'{body} [m]' for body in tracks)])
    heights = [
        dict(zip(track.time.tolist(), track.position.tolist(), strict=True))
        for track in tracks.values()
    ]
    for time in sorted(set().union(*heights)):
        cells = [f'{each[time]:.9g}' if time in each else '' for each in heights]
        yield ','.join([f'{time:.9g}', *cells])


def _rows(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of lines that are no comments, with the lines' numbers."""
    separator: str | None = ''
    for number, line in enumerate(lines, 1):
        text = line.strip(' \r\n\ufeff')
        if not text.strip() or text.startswith('#'):
            continue
        if separator == '':
            separator = next((each for each in (';', '\t', ',') if each in text), None)
        cells = text.split(separator)
        if separator != ',':
            cells = [re.sub(r'(?<=\d),(?=\d)', '.', cell) for cell in cells]
        yield number, [cell.strip().strip('"\'') for cell in cells]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_number(text: str, what: str, where: str) -> float:
    if text.lower() in _MISSING:
        return math.nan
    if not _is_number(text) or math.isinf(float(text)):
        raise TrackError(f'{where}: {what} must be a finite number, got {text!r}')
    return float(text)


def _unnamed_columns(cells: Sequence[str], bodies: Sequence[str]) -> dict[str, int]:
    """Take columns without names as they come."""
    return {body: place for place, body in enumerate(('time', *bodies)) if place < len(cells)}


def _named_columns(
    cells: Sequence[str], bodies: Sequence[str], unit: str, where: str
) -> dict[str, int]:
    """Find columns by their names."""
    known = {'time': (_TIME_NAMES, 's'), **{body: (COLUMN_NAMES[body], unit) for body in bodies}}
    columns: dict[str, int] = {}
    for place, cell in enumerate(cells):
        label, _, bracket = re.sub(r'[\[(]', '\n', cell, count=1).partition('\n')
        for body, (names, expected) in known.items():
            if label.strip().lower() in names:
                given = bracket.rstrip(' )]').replace('\N{MICRO SIGN}', 'u')
                if bracket and given != expected:
                    hint = '' if body == 'time' or given not in UNITS else f'; see --unit {given}'
                    raise TrackError(f'{where}: {body} is read in {expected}, got {cell!r}{hint}')
                if body in columns:
                    raise TrackError(f'{where}: {body} must be there once, got {cell!r} too')
                columns[body] = place
    for body in ('time', bodies[0]):
        if body not in columns:
            raise TrackError(
                f'{where}: no column is named {known[body][0][0]!r}, got {", ".join(cells)}'
            )
    return columns


def _tracks(
    times: list[float], values: dict[str, list[float]], first: str, name: str
) -> Iterator[tuple[str, Track]]:
    """Leave out what was not seen."""
    time = np.array(times)
    for body, series in values.items():
        position = np.array(series)
        seen = np.isfinite(position)
        if seen.sum() >= FEWEST:
            yield body, Track(time=time[seen], position=position[seen])
        elif body == first or seen.any():
            raise TrackError(
                f'{name}: {seen.sum()} heights of the {body}, where at least {FEWEST} are needed'
            )
