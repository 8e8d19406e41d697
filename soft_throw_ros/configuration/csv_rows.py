# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers in CSV files, as spreadsheets and measuring programs write them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import csv
import math
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.table import float_of, quote

Floats = NDArray[np.float64]

MIN_STEP = np.finfo(float).eps  # smallest increase of time, the rounding of a second [s]
_MISSING = ('', 'nan', 'na', 'n/a')
_MICRO = str.maketrans({'\N{MICRO SIGN}': 'u', '\N{GREEK SMALL LETTER MU}': 'u'})


class Column(NamedTuple):
    """Labels, units and range of a column of numbers."""

    labels: tuple[str, ...]  # accepted ones, in small letters
    units: Mapping[str, float]  # SI values of the accepted units
    default_unit: str  # of a column whose label has none
    largest: float = math.inf  # absolute value [SI]
    may_have_gaps: bool = False  # whether a cell may be empty or nan, and the value NaN
    needs_label: bool = False  # whether a file without labels never has this column


def read_rows(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """
    Yield the number and the cells of each line with data.

    Semicolons, tabs or commas separate cells, whichever the first line with data has, or else
    blanks. Lines without a value, comments after `#`, and the line `sep=;` of spreadsheets are
    skipped. A comma may be the decimal sign, in quotes if commas separate cells.
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
    """Return the label of a column in small letters, and its unit, as in `Height [um]`, or ''."""
    name, _, unit = re.sub(r'[\[(]', '\n', cell, count=1).partition('\n')
    return name.strip().lower(), unit.rstrip(' )]').translate(_MICRO)


def read_columns(
    lines: Iterable[str], name: str, columns: Mapping[str, Column]
) -> dict[str, Floats]:
    """
    Read columns of numbers in SI units from lines of text, see `read_rows`.

    A first line may label the columns, with an optional unit in brackets; others are skipped.
    Otherwise they are in the order of `columns`, of which the first one is the time, which
    increases, and the first two are required. ValueError has the `name` of the text and the line.
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
        bare = [key for key, column in columns.items() if not column.needs_label]
        units = [columns[key].units[columns[key].default_unit] for key in bare]
        sources = dict(zip(bare, zip(range(len(head)), units, strict=False), strict=False))
    if not rows:
        raise ValueError(f'{name}:{first}: names columns, but no line with numbers follows')
    if second not in sources:
        rule = f'must have columns {time} and {second}, got {quote(head[0])} alone'
        raise ValueError(f'{name}:{first}: {rule}')
    table = []
    for number, cells in rows:
        where = f'{name}:{number}'
        if len(cells) == len(head) + 1 and not cells[-1]:
            del cells[-1]  # the line ends with a separator
        if len(cells) != len(head):
            rule = f'must have {len(head)} values as line {first} has, got {len(cells)}'
            raise ValueError(f'{where}: {rule}')
        table.append([
            _number(cells[index], unit, f'{where}: {key}', columns[key])
            for key, (index, unit) in sources.items()
        ])
        if len(table) > 1 and not table[-1][0] - table[-2][0] >= MIN_STEP:
            before, now = table[-2][0], table[-1][0]
            raise ValueError(f'{where}: {time} must increase, got {now:g} after {before:g}')
    return dict(zip(sources, np.array(table).T, strict=True))


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
    """Return index and SI value of the unit of each column that has a label, the time first."""
    sources: dict[str, tuple[int, float]] = {}
    heads = [parse_label(cell) for cell in cells]
    for number, (key, column) in enumerate(columns.items()):
        found = [index for index, (label, _) in enumerate(heads) if label in column.labels]
        if not found and number < 2:
            raise ValueError(
                f'{where}: no column is named {" or ".join(column.labels)}, '
                f'got {quote(", ".join(cells))}; lines above the names must begin with #'
            )
        if len(found) > 1:
            rule = f'{key} must be there once, got {quote(cells[found[1]])} too'
            raise ValueError(f'{where}: {rule}')
        for index in found:
            unit = heads[index][1] or column.default_unit
            if unit not in column.units:
                rule = f'{key} must be in {" or ".join(column.units)}'
                raise ValueError(f'{where}: {rule}, got {quote(cells[index])}')
            sources[key] = index, column.units[unit]
    return sources
