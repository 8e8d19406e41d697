# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks as lines of text: a time and heights in each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from soft_throw_ros.configuration.csv_rows import Column, parse_label, read_columns, read_rows
from soft_throw_ros.configuration.table import float_of
from soft_throw_ros.identification.tracks import FEWEST, MAX_HEIGHT, MAX_TIME, Track, TrackError

UNITS = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6}
"""Units of height. [m]"""

TIME_UNITS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6}
"""Units of time. [s]"""

COLUMN_NAMES = {
    'plate': ('plate', 'z_plate', 'zp', 'z_p'),
    'projectile': ('projectile', 'z_projectile', 'zm', 'z_m'),
    'bottom': ('bottom', 'z_bottom', 'lower', 'z_lower'),
    'top': ('top', 'z_top', 'upper', 'z_upper'),
}
"""Accepted names of columns, by body."""


def read_csv(
    lines: Iterable[str], name: str, bodies: Sequence[str], *, unit: str = 'm',
    time_unit: str = 's',
) -> dict[str, Track]:
    """
    Read tracks of bodies, of which the first must be there, from the lines of a named text.

    Lines have a time and heights, see `read_columns`. The labels are `t` or `time`, and
    `COLUMN_NAMES`, with units in brackets, by default `unit` of `UNITS` and `time_unit` of
    `TIME_UNITS`. A height that is empty or nan is missing. Raise TrackError with the number of the
    line, if something is wrong.
    """
    columns = {'time': Column(('t', 'time'), TIME_UNITS, time_unit, MAX_TIME)} | {
        body: Column(COLUMN_NAMES[body], UNITS, unit, MAX_HEIGHT, may_have_gaps=True)
        for body in bodies
    }
    try:
        heights = read_columns(lines, name, columns)
    except ValueError as error:
        raise TrackError(str(error)) from None
    time = heights.pop('time')
    tracks = {}
    for body, series in heights.items():
        seen = np.isfinite(series)
        if seen.sum() >= FEWEST:
            tracks[body] = Track(time=time[seen], position=series[seen])
        elif body == bodies[0] or seen.any():
            raise TrackError(
                f'{name}: {seen.sum()} heights of the {body}, where at least {FEWEST} are needed'
            )
    return tracks


def unused_columns(lines: Iterable[str], bodies: Sequence[str]) -> list[str]:
    """Return the labels of columns that are neither the time nor the height of a body."""
    names = {'t', 'time', *(name for body in bodies for name in COLUMN_NAMES[body])}
    _, head = next(read_rows(lines))
    return [cell for cell in head if float_of(cell) is None and parse_label(cell)[0] not in names]


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
