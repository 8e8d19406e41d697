# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Write the generated files of `config/` and `docs/` from the tables; run above both folders.

The files are the defaults of two nodes, docs/parameters.md and docs/topics.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

from soft_throw_ros.configuration.files import render
from soft_throw_ros.configuration.interface import INTERFACES, Topic
from soft_throw_ros.configuration.node_tables import CALIBRATOR, RECORDER, RIG, VIEWER
from soft_throw_ros.configuration.table import Table, value_text
from soft_throw_ros.configuration.twin import TWIN

Row: TypeAlias = tuple[str, ...]
Sections: TypeAlias = list[tuple[str, dict[Row, list[Row]]]]  # nodes, and their tables by heads

_COMMAND = 'python -m soft_throw_ros.configuration'

_PARAMETERS = f"""\
# Parameters

SI units. Written from the tables by `{_COMMAND}`.

A number may also be text, as which YAML 1.1 reads `5e-06`. A request to change a read-only
parameter is refused; `ros2 param load` of a dump reports this, and sets all others. The values of
a request are set in the order of these tables, so that the later of two that contradict each other
wins; values of a file that are present already do not count. Every change within its range is
accepted, if the rig can be computed in time and a controller can play a commanded motion.
"""

_TOPICS = f"""\
# Topics and services

SI units; z points up from the rest position of the plate, in the frame `rig`. `~` stands for the
full name of the node, such as `/twin` or `/rig1/twin`; a name without leading slash is relative to
its namespace. The queue is the number of messages kept (keep last); topics are reliable unless it
says otherwise, and a latched topic (transient local) sends its queue to late subscribers. Joints
or axes follow the content. [results.md](results.md) has the keys of `~/throw_result`. Written from
the tables by `{_COMMAND}`.
"""


def documents() -> dict[str, str]:
    """Return the text of every generated file by its path."""
    title = f'The parameters of the {{}}, here the defaults. SI units.\nWritten by {_COMMAND}.'
    files = {
        f'config/{table.node}.yaml':
            render(table.defaults(), table=table, title=title.format(table.node))
        for table in (TWIN, RECORDER)
    }
    parameters: Sections = [
        (table.node, {('parameter', 'default (values)', 'meaning'): _parameter_rows(table)})
        for table in (TWIN, RECORDER, VIEWER, CALIBRATOR, RIG)
    ]
    topics: Sections = [
        (node, {
            ('topic', 'type', 'content', 'queue'): [*map(_topic_row, topics)],
            ('service', 'type', 'effect'):
                [(f'`{item.name}`', 'std_srvs/Trigger', item.meaning) for item in services],
        })
        for node, (topics, services) in INTERFACES.items()
    ]
    pages = {'parameters': _page(_PARAMETERS, parameters), 'topics': _page(_TOPICS, topics)}
    return {**files, **{f'docs/{name}.md': '\n'.join(page) for name, page in pages.items()}}


def _parameter_rows(table: Table) -> list[Row]:
    rows: list[Row] = []
    for entry in table.entries:
        unit = f' [{entry.unit}]' if entry.unit and entry.is_result else ''
        rule = entry.rule.replace("'", '`').removeprefix('a number from ').removeprefix('one of ')
        rule = rule.replace('a whole number from', 'whole,').removesuffix(', or empty')
        values = f'{value_text(entry.default) or "empty"} ({rule})'
        cells = 'read-only' if entry.is_result else values, entry.meaning + unit
        rows.append((f'`{entry.name}`', *cells))
    return rows


def _topic_row(topic: Topic) -> Row:
    names = [f'`{name}`' for name in topic.joints or topic.axes]
    shown = names if len(names) < 4 else (names[0], '...', names[-1])
    quantities = f': {", ".join(topic.quantities)}' * bool(topic.joints)
    content = topic.meaning + f'; {", ".join(shown)}{quantities}' * bool(names)
    queue = f'{topic.depth}{", latched" * topic.is_latched}'
    queue += ', best effort' * (not topic.is_reliable)
    name = f'`{topic.name}`{" (subscribed)" * topic.is_input}'
    return name, topic.type.replace('/msg/', '/'), content, queue


def _page(text: str, sections: Sections) -> Iterator[str]:
    """Yield the head of each node, what it shares with the twin, and its tables with rows."""
    yield text
    of_twin = {row[2] for rows in sections[0][1].values() for row in rows}
    for node, tables in sections:
        yield f'## {node}\n'
        known = set() if node == 'twin' else of_twin
        if shared := [row[0] for rows in tables.values() for row in rows if row[2] in known]:
            yield f'As of the twin: {", ".join(shared)}.\n'
        for head, rows in tables.items():
            if own := [row for row in rows if row[2] not in known]:
                for row in (head, ('---',) * len(head), *own):
                    yield f'| {" | ".join(row)} |'
                yield ''


if __name__ == '__main__':
    for path, text in documents().items():
        Path(path).write_text(text, 'utf-8')
