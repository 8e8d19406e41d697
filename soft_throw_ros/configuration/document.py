# SPDX-License-Identifier: Apache-2.0
"""What is written from the tables: the files in `config/`, and the parameters in the README."""

from __future__ import annotations

from soft_throw_ros.configuration.files import render
from soft_throw_ros.configuration.recorder import RECORDER
from soft_throw_ros.configuration.rig import CALIBRATOR, RIG
from soft_throw_ros.configuration.table import Table, Value
from soft_throw_ros.configuration.twin import TWIN

TABLES = {table.node: table for table in (TWIN, RECORDER, CALIBRATOR, RIG)}
"""The tables that are shown, by their nodes."""


def parameter_file(table: Table) -> str:
    """Write the default parameter file of a node."""
    name = f'config/{table.node}.yaml'
    return render(
        table.defaults(),
        table=table,
        title=f'The parameters of the {table.node}, here the defaults. SI units.\n'
        f'Made from the table by python -m soft_throw_ros.configuration {name}',
    )


def markdown(table: Table) -> str:
    """Write a table of parameters in Markdown."""
    rows = ['| parameter | default | must be | meaning |', '|---|---|---|---|']
    for entry in table.entries:
        unit = f' [{entry.unit}]' if entry.unit and entry.is_result else ''
        cells = (
            f'`{entry.name}`',
            'result' if entry.is_result else _text(entry.default),
            entry.rule.replace("'", '`'),
            entry.meaning + unit,
        )
        rows.append('| ' + ' | '.join(map(str, cells)) + ' |')
    return '\n'.join(rows) + '\n'


def insert_markdown(text: str) -> str:
    """
    Return `text` with the tables, and nothing else, between their marks.

    Raises
    ------
    ValueError
        If the marks of a table are not there, once each and in their order.

    """
    for node, table in TABLES.items():
        first, last = f'<!-- {node} parameters -->', f'<!-- /{node} parameters -->'
        before, begin, rest = text.partition(first)
        _, end, after = rest.partition(last)
        if not (begin and end) or first in rest or last in after:
            raise ValueError(f'expected {first} and then {last}, once each, got {text[:60]!r}...')
        text = f'{before}{first}\n{markdown(table)}{last}{after}'
    return text


def _text(value: Value) -> str:
    """Write a default as a cell of a table."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f'{value:g}'
    return ' '.join(map(_text, value)) if isinstance(value, tuple) else str(value)
