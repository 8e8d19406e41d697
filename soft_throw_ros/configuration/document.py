# SPDX-License-Identifier: Apache-2.0
"""What is written from the table: `config/twin.yaml`, and the parameters in the README."""

from __future__ import annotations

from soft_throw_ros.configuration.files import render
from soft_throw_ros.configuration.settings import defaults
from soft_throw_ros.configuration.table import TABLE

BEGIN, END = '<!-- parameters -->', '<!-- /parameters -->'
"""Between these lines of the README stands the table."""


def twin_yaml() -> str:
    """Write the default parameter file."""
    return render(
        defaults(),
        title='The parameters of the twin, here those of the rig in the paper. SI units.\n'
        'Made from the table by python -m soft_throw_ros.configuration config/twin.yaml',
    )


def markdown() -> str:
    """Write the table of parameters in Markdown."""
    rows = ['| parameter | default | must be | meaning |', '|---|---|---|---|']
    for entry in TABLE:
        default = f'{entry.default:g}' if isinstance(entry.default, float) else entry.default
        unit = f' [{entry.unit}]' if entry.unit and entry.is_result else ''
        cells = (
            f'`{entry.name}`',
            'result' if entry.is_result else default,
            entry.rule.replace("'", '`'),
            entry.meaning + unit,
        )
        rows.append('| ' + ' | '.join(map(str, cells)) + ' |')
    return '\n'.join(rows) + '\n'


def insert_markdown(text: str) -> str:
    """
    Return `text` with the table, and nothing else, between the two marks.

    Raises
    ------
    ValueError
        If the marks are not there, once each and in this order.

    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end) or BEGIN in rest or END in after:
        raise ValueError(f'expected {BEGIN} and then {END}, once each, got {text[:60]!r}...')
    return f'{before}{BEGIN}\n{markdown()}{END}{after}'
