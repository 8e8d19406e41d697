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
"""Rows and column labels of CSV files, as spreadsheets and measuring programs write them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
import re
from typing import NamedTuple

from soft_throw_ros.configuration.table import float_of

_SEPARATORS = (';', '\t', ',')


class Label(NamedTuple):
    """The name of a column in small letters, and its unit, empty if none is given."""

    name: str
    unit: str


def read_rows(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """
    Yield the number and the cells of each line with data.

    Parameters
    ----------
    lines : iterable of str
        Cells separated by semicolons, tabs or commas, whichever the first line with data has, or
        else by blanks. Empty lines, comments after `#`, and the line `sep=;` of spreadsheets are
        skipped. Unless commas separate cells, one may be the decimal sign.

    Examples
    --------
    >>> list(read_rows(['# a track', 't [s]; z [m]', '0,5; 1e-3']))
    [(2, ['t [s]', 'z [m]']), (3, ['0.5', '1e-3'])]

    """
    separator: str | None = ''
    for number, line in enumerate(lines, 1):
        text = line.strip(' \r\n\ufeff')
        if not text.strip() or text.startswith('#') or re.fullmatch('sep=.', text):
            continue
        if separator == '':
            separator = next((sign for sign in _SEPARATORS if sign in text), None)
        cells = text.split(separator)
        if separator != ',':
            cells = [re.sub(r'(?<=\d),(?=\d)', '.', cell) for cell in cells]
        yield number, [cell.strip().strip('"\'') for cell in cells]


def is_header(cells: Sequence[str]) -> bool:
    """Return whether a row contains the labels of columns: no cell is a number."""
    return all(float_of(cell) is None for cell in cells)


def parse_label(cell: str) -> Label:
    """
    Return the label of a column from a cell of the header.

    Examples
    --------
    >>> parse_label('Height [\N{MICRO SIGN}m]')
    Label(name='height', unit='um')

    """
    name, _, unit = re.sub(r'[\[(]', '\n', cell, count=1).partition('\n')
    return Label(name.strip().lower(), unit.rstrip(' )]').replace('\N{MICRO SIGN}', 'u'))
