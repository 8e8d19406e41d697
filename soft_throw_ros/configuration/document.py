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
"""What is written from the tables: files of defaults in `config/`, and two pages in `docs/`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from soft_throw_ros.configuration import interface
from soft_throw_ros.configuration.files import render
from soft_throw_ros.configuration.recorder import RECORDER
from soft_throw_ros.configuration.rig import CALIBRATOR, RIG
from soft_throw_ros.configuration.table import Entry, Table, Value
from soft_throw_ros.configuration.twin import TWIN

_COMMAND = 'python -m soft_throw_ros.configuration'

_TABLES = (TWIN, RECORDER, CALIBRATOR, RIG)


def documents() -> dict[str, str]:
    """Return the text of every file that is written from the tables, by its path."""
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
        'A number may also be given as text, since tools that read YAML 1.1 take `5e-06` for one. '
        'A\nparameter that is a result keeps its value whatever it is set to, so that '
        '`ros2 param load` takes\nwhat `ros2 param dump` has written. What is set in one request '
        'must not contradict itself;\nevery single change within its range is accepted.\n'
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
        'result' if entry.is_result else _text(entry.default),
        entry.rule.replace("'", '`'),
        entry.meaning + unit,
    )


def _topics_page() -> Iterator[str]:
    yield '# Topics and services\n'
    yield (
        'SI units; z points up from the rest position of the plate, in the frame `rig`.\n'
        '`~` stands for the full name of the node, as `/twin` or `/rig1/twin`;\n'
        'a name without leading slash is relative to its namespace.\n'
        f'Written from the tables by `{_COMMAND}`.\n'
    )
    for node, (topics, services) in interface.INTERFACES.items():
        yield f'## {node}\n'
        yield from _markdown(
            ('topic', 'type', 'content', 'joints or axes', 'QoS'), map(_topic_row, topics)
        )
        if services:
            rows = ((f'`{item.name}`', _short(item.type), item.meaning) for item in services)
            yield from _markdown(('service', 'type', 'what it does'), rows)


def _topic_row(topic: interface.Topic) -> tuple[str, ...]:
    joints = topic.joints or topic.axes
    shown = joints if len(joints) < 4 else (joints[0], '...', joints[-1])
    parts = ', '.join(name if name == '...' else f'`{name}`' for name in shown)
    if topic.joints:
        parts += f': {", ".join(topic.quantities)}'
    qos = [
        'reliable' if topic.is_reliable else 'best effort',
        *(['transient local'] if topic.is_latched else []),
        f'keep last {topic.depth}',
    ]
    direction = ' (subscribed)' if topic.is_input else ''
    name = f'`{topic.name}`{direction}'
    return name, _short(topic.type), topic.meaning, parts or '-', ', '.join(qos)


def _markdown(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    """Write a table, and an empty line after it."""
    for row in (head, ('---',) * len(head), *rows):
        yield f'| {" | ".join(row)} |'
    yield ''


def _short(type_name: str) -> str:
    """Name a type as people do."""
    return type_name.replace('/msg/', '/').replace('/srv/', '/')


def _text(value: Value) -> str:
    """Write a default as a cell of a table."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f'{value:g}'
    return ' '.join(map(_text, value)) if isinstance(value, tuple) else str(value)
