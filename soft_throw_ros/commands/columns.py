# SPDX-License-Identifier: Apache-2.0
"""Numbers in columns, for people to read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
import itertools
from typing import NamedTuple

_WIDTH = 12


class Row(NamedTuple):
    """A line of a table: which of the numbers, how it is called, and in which unit."""

    key: str
    title: str
    unit: str = ''
    scale: float = 1.0


def write_columns(
    rows: Iterable[Row], columns: Mapping[str, Mapping[str, float] | None]
) -> Iterator[str]:
    """
    Write a table, line by line.

    Parameters
    ----------
    rows : iterable of Row
        One without any number is left out.
    columns : mapping of str to mapping or None
        The numbers by their keys, under heads whose words, joined by `_`, stand one below the
        other.

    Yields
    ------
    str
        The heads, then the rows.

    """
    words = [head.split('_') for head in columns]
    for heads in itertools.zip_longest(*words, fillvalue=''):
        yield _line('', '', heads)
    for row in rows:
        cells = [_cell((numbers or {}).get(row.key), row.scale) for numbers in columns.values()]
        if any(cell != '-' for cell in cells):
            yield _line(row.title, row.unit, cells)


def _line(title: str, unit: str, cells: Iterable[str]) -> str:
    line = f'{title:22}{unit:>6}' + ''.join(f'{cell:>{_WIDTH}}' for cell in cells)
    return line.rstrip()


def _cell(value: float | None, scale: float) -> str:
    if value is None:
        return '-'
    return str(value) if isinstance(value, int) else f'{scale * value:#.6g}'
