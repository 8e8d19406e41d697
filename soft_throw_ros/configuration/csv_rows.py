# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers in CSV files, as spreadsheets and measuring programs write them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import csv
import math
import re
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.table import float_of, quote

Floats = NDArray[np.float64]

MIN_STEP = 1e-12
"""Smallest increase of time between two rows. [s]"""

_MISSING = ('', 'nan', 'na', 'n/a')
_MICRO = str.maketrans({'\N{MICRO SIGN}': 'u', '\N{GREEK SMALL LETTER MU}': 'u'})


class Column(NamedTuple):
    """Labels, units and range of a column of numbers."""

    labels: tuple[str, ...]
    """Accepted labels, in small letters."""
    units: Mapping[str, float]
    """SI values of the accepted units."""
    default_unit: str
    """Unit of a column whose label has none."""
    largest: float = math.inf
    """Largest absolute value. [SI]"""
    may_have_gaps: bool = False
    """Whether a value may be missing: the cell is empty or nan, and the value NaN."""
    hints: Mapping[str, str] = MappingProxyType({})
    """Remedies for labels with other units, by unit."""
    needs_label: bool = False
    """Whether a file without labels never has this column."""


def read_rows(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """
    Yield the number and the cells of each line with data.

    Semicolons, tabs or commas separate cells, whichever the first line with data has, or else
    blanks. Lines without a value, comments after `#`, and the line `sep=;` of spreadsheets are
    skipped. A comma may be the decimal sign, in quotes if commas separate cells.

    Examples
    --------
    >>> list(read_rows(['# a track', 't [s]; z [m]', '0,5; 1e-3']))
    [(2, ['t [s]', 'z [m]']), (3, ['0.5', '1e-3'])]

    """
    separator = ''
    for number, line in enumerate(lines, 1):
        text = line.strip(' \r\n\ufeff')
        if not text.strip(' \t;,"\'') or text.startswith('#') or re.fullmatch('sep=.', text):
            continue
        separator = separator or next((sign for sign in ';\t,' if sign in text), ' ')
        if separator == ' ':
            cells = text.split()
        else:
            (cells,) = csv.reader([text], delimiter=separator, skipinitialspace=True)
        cells = [re.sub(r'(?<=\d),(?=\d)', '.', cell) for cell in cells]
        if any(cells := [cell.strip().strip('"\'') for cell in cells]):
            yield number, cells


def parse_label(cell: str) -> tuple[str, str]:
    """
    Return the label of a column in small letters, and its unit, which may be empty.

    Examples
    --------
    >>> parse_label('Height [\N{MICRO SIGN}m]')
    ('height', 'um')

    """
    name, _, unit = re.sub(r'[\[(]', '\n', cell, count=1).partition('\n')
    return name.strip().lower(), unit.rstrip(' )]').translate(_MICRO)


def read_columns(
    lines: Iterable[str], name: str, columns: Mapping[str, Column]
) -> dict[str, Floats]:
    """
    Read columns of numbers in SI units; raise ValueError with the number of the line.

    Parameters
    ----------
    lines : iterable of str
        Lines of text, see `read_rows`. A first line may label the columns, with an optional unit
        in brackets; other columns are skipped then. Without labels, the columns are in the order
        of `columns`.
    name : str
        Name of the text in errors.
    columns : mapping of str to Column
        The first one is the time, which increases. The first two are required.

    """
    try:
        rows = list(read_rows(lines))
    except csv.Error as error:
        raise ValueError(f'{name}: {error}') from None
    time, second, *_ = columns
    if not rows:
        raise ValueError(f'{name}: is empty; columns {time} and {second} are needed')
    first, head = rows[0]
    if float_of(head[0]) is None:
        del rows[0]
        sources = _find_columns(head, columns, f'{name}:{first}')
    else:
        bare = [item for item in columns.items() if not item[1].needs_label]
        sources = {
            key: (n, column.units[column.default_unit])
            for n, (key, column) in enumerate(bare[: len(head)])
        }
    if not rows:
        raise ValueError(f'{name}:{first}: names columns, but no line with numbers follows')
    if second not in sources:
        raise ValueError(
            f'{name}:{first}: must have columns {time} and {second}, got {quote(head[0])} alone'
        )
    table = []
    for number, cells in rows:
        where = f'{name}:{number}'
        if len(cells) == len(head) + 1 and not cells[-1]:
            del cells[-1]  # the line ends with a separator
        if len(cells) != len(head):
            hint = '; the same sign must separate the values of all lines' * (len(cells) == 1)
            raise ValueError(
                f'{where}: must have {len(head)} values as line {first} has, '
                f'got {len(cells)}{hint}'
            )
        table.append([
            _number(cells[index], unit, f'{where}: {key}', columns[key])
            for key, (index, unit) in sources.items()
        ])
    result = dict(zip(sources, np.array(table).T, strict=True))
    times = result[time]
    if (back := np.flatnonzero(np.diff(times) < MIN_STEP)).size:
        n = int(back[0]) + 1
        raise ValueError(
            f'{name}:{rows[n][0]}: {time} must increase, got {times[n]:g} after {times[n - 1]:g}'
        )
    return result


def _number(text: str, unit: float, subject: str, column: Column) -> float:
    """Return a value in SI units; raise ValueError about the subject."""
    if column.may_have_gaps and text.lower() in _MISSING:
        return math.nan
    value = float_of(text)
    if value is None or not math.isfinite(value):
        raise ValueError(f'{subject} must be a finite number, got {quote(text)}')
    if abs(unit * value) > column.largest:
        limit = column.largest / unit
        raise ValueError(f'{subject} must be within +- {limit:g}, got {quote(text)}')
    return unit * value


def _find_columns(
    cells: Sequence[str], columns: Mapping[str, Column], where: str
) -> dict[str, tuple[int, float]]:
    """Return index and SI value of the unit of each column that has a label."""
    sources: dict[str, tuple[int, float]] = {}
    for index, cell in enumerate(cells):
        label, unit_name = parse_label(cell)
        for key, column in columns.items():
            if label not in column.labels:
                continue
            unit = column.units.get(unit_name or column.default_unit)
            if unit is None:
                rule = 'must be in' if len(column.units) > 1 else 'is read in'
                raise ValueError(
                    f'{where}: {key} {rule} {" or ".join(column.units)}, got {quote(cell)}'
                    f'{column.hints.get(unit_name, "")}'
                )
            if key in sources:
                raise ValueError(f'{where}: {key} must be there once, got {quote(cell)} too')
            sources[key] = index, unit
    for key in list(columns)[:2]:
        if key not in sources:
            raise ValueError(
                f'{where}: no column is named {" or ".join(columns[key].labels)}, '
                f'got {quote(", ".join(cells))}; lines above the names must begin with #'
            )
    return sources
