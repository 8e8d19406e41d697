# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Write the generated files of `config/` and `docs/` from the tables; run above both folders.

The files are the defaults of two nodes, docs/parameters.md and docs/topics.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from soft_throw_ros.configuration import interface
from soft_throw_ros.configuration.files import render
from soft_throw_ros.configuration.recorder import RECORDER, VIEWER
from soft_throw_ros.configuration.result_keys import RESULT_KEYS
from soft_throw_ros.configuration.rig import CALIBRATOR, RIG
from soft_throw_ros.configuration.table import Entry, Table, value_text
from soft_throw_ros.configuration.twin import TWIN

_COMMAND = 'python -m soft_throw_ros.configuration'

_TABLES = (TWIN, RECORDER, VIEWER, CALIBRATOR, RIG)


def documents() -> dict[str, str]:
    """Return the text of every generated file by its path."""
    return {
        **{f'config/{table.node}.yaml': _parameter_file(table) for table in (TWIN, RECORDER)},
        'docs/parameters.md': '\n'.join(_parameters_page()),
        'docs/topics.md': '\n'.join(_topics_page()),
    }


def _parameter_file(table: Table) -> str:
    return render(
        table.defaults(),
        table=table,
        title=f'The parameters of the {table.node}, here the defaults. SI units.\n'
        f'Written from the table by {_COMMAND}.',
    )


def _parameters_page() -> Iterator[str]:
    yield '# Parameters\n'
    yield f'SI units. Written from the tables by `{_COMMAND}`.\n'
    yield (
        'A number may also be given as text, because tools that read YAML 1.1 treat `5e-06` as '
        'text. A request\nto change a read-only parameter is refused; `ros2 param load` of an '
        'older `ros2 param dump`\nthen reports the results of that time, and sets all other '
        'parameters. The values of a request\nare set one by one in the order of these tables, so '
        'that the later of two values that contradict\neach other wins; values of a file that are '
        'present already do not count. Every change within its\nrange is accepted, if the rig can '
        'be computed in time and a controller can play a commanded\nmotion.\n'
    )
    for table in _TABLES:
        yield f'## {table.node}\n'
        yield from _markdown(
            ('parameter', 'default', 'must be', 'meaning'), map(_row, table.entries)
        )


def _row(entry: Entry) -> tuple[str, ...]:
    unit = f' [{entry.unit}]' if entry.unit and entry.is_result else ''
    return (
        f'`{entry.name}`',
        'result' if entry.is_result else value_text(entry.default),
        entry.rule.replace("'", '`'),
        entry.meaning + unit,
    )


def _topics_page() -> Iterator[str]:
    yield '# Topics and services\n'
    yield (
        'SI units; z points up from the rest position of the plate, in the frame `rig`.\n'
        '`~` stands for the full name of the node, such as `/twin` or `/rig1/twin`;\n'
        'a name without leading slash is relative to its namespace.\n'
        f'Written from the tables by `{_COMMAND}`.\n'
    )
    for node, (topics, services) in interface.INTERFACES.items():
        yield f'## {node}\n'
        yield from _markdown(
            ('topic', 'type', 'content', 'joints or axes', 'QoS'),
            map(_topic_row, topics),
        )
        if node == 'twin':
            yield from _keys()
        if services:
            rows = ((f'`{item.name}`', _short(item.type), item.meaning) for item in services)
            yield from _markdown(('service', 'type', 'effect'), rows)


def _keys() -> Iterator[str]:
    """Yield the table of the keys of results."""
    yield (
        'Keys of `~/throw_result`. A throw gives a message at its first release and one at its\n'
        'end; a value that is unknown or was not measured has no key. The rig follows by the\n'
        'names of its parameters.\n'
    )
    yield from _markdown(
        ('key', 'meaning'),
        (
            (f'`{name}`', meaning + f' [{unit}]' * bool(unit))
            for name, meaning, unit in RESULT_KEYS
        ),
    )


def _topic_row(topic: interface.Topic) -> tuple[str, ...]:
    joints = topic.joints or topic.axes
    shown = joints if len(joints) < 4 else (joints[0], '...', joints[-1])
    content = ', '.join(name if name == '...' else f'`{name}`' for name in shown)
    if topic.joints:
        content += f': {", ".join(topic.quantities)}'
    qos = [
        'reliable' if topic.is_reliable else 'best effort',
        *(['transient local'] if topic.is_latched else []),
        f'keep last {topic.depth}',
    ]
    direction = ' (subscribed)' if topic.is_input else ''
    name = f'`{topic.name}`{direction}'
    return name, _short(topic.type), topic.meaning, content or '-', ', '.join(qos)


def _markdown(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    """Yield the lines of a table, and an empty line."""
    for row in (head, ('---',) * len(head), *rows):
        yield f'| {" | ".join(row)} |'
    yield ''


def _short(type_name: str) -> str:
    """Return the short form of a type name."""
    return type_name.replace('/msg/', '/').replace('/srv/', '/')


if __name__ == '__main__':
    for path, text in documents().items():
        Path(path).write_text(text, 'utf-8')
