# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Write the generated files of `config/` and `docs/` from the tables; run above both folders.

The files are the defaults of two nodes, docs/parameters.md and docs/topics.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
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
        'A number may also be text, as which YAML 1.1 reads `5e-06`. A request to change a '
        'read-only\nparameter is refused; `ros2 param load` of a dump reports this, and sets all '
        'others. The values\nof a request are set in the order of these tables, so that the later '
        'of two values that contradict\neach other wins; values of a file that are present '
        'already do not count. Every change within its\nrange is accepted, if the rig can be '
        'computed in time and a controller can play a commanded\nmotion.\n'
    )
    for table in _TABLES:
        shared = [entry for entry in table.entries if _is_of_twin(table, entry)]
        yield f'## {table.node}\n'
        if shared:
            names = ', '.join(f'`{entry.name}`' for entry in shared)
            yield f'As of the twin: {names}. Besides:\n'
        own = (entry for entry in table.entries if entry not in shared)
        yield from _markdown(('parameter', 'default (values)', 'meaning'), map(_row, own))


def _is_of_twin(table: Table, entry: Entry) -> bool:
    """Return whether a parameter of another node is one of the twin's."""
    return table is not TWIN and TWIN.by_name.get(entry.name) == entry


def _row(entry: Entry) -> tuple[str, ...]:
    unit = f' [{entry.unit}]' if entry.unit and entry.is_result else ''
    rule = entry.rule.replace("'", '`').removeprefix('a number from ').removeprefix('one of ')
    rule = rule.replace('a whole number from', 'whole,').removesuffix(', or empty')
    return (
        f'`{entry.name}`',
        'read-only' if entry.is_result else f'{value_text(entry.default) or "empty"} ({rule})',
        entry.meaning + unit,
    )


def _topics_page() -> Iterator[str]:
    yield '# Topics and services\n'
    yield (
        'SI units; z points up from the rest position of the plate, in the frame `rig`.\n'
        '`~` stands for the full name of the node, such as `/twin` or `/rig1/twin`;\n'
        'a name without leading slash is relative to its namespace. The queue is the number of\n'
        'messages kept (keep last); topics are reliable unless it says otherwise, and a latched\n'
        'topic (transient local) sends its queue to late subscribers.\n'
        'Joints or axes follow the content. '
        f'Written from the tables by `{_COMMAND}`.\n'
    )
    heads = 'type', 'content', 'queue'
    topics, services = interface.INTERFACES['twin']
    yield '## twin\n'
    yield from _markdown(('topic', *heads), map(_topic_row, topics))
    yield from _keys()
    yield from _markdown(('service', 'type', 'effect'), map(_service_row, services))
    meanings = {topic.meaning for topic in topics}
    others = {name: item for name, item in interface.INTERFACES.items() if name != 'twin'}
    yield '## Other nodes\n'
    for node, (topics, _) in others.items():
        names = ', '.join(_name_of(topic) for topic in topics if topic.meaning in meanings)
        if names:
            yield f'`{node}` shares these topics with the twin: {names}.\n'
    rows = (
        (f'`{node}`', *_topic_row(topic))
        for node, (topics, _) in others.items() for topic in topics
        if topic.meaning not in meanings
    )
    yield from _markdown(('node', 'topic', *heads), rows)
    rows = (
        (f'`{node}`', *_service_row(service))
        for node, (_, services) in others.items() for service in services
    )
    yield from _markdown(('node', 'service', 'type', 'effect'), rows)


def _keys() -> Iterator[str]:
    """Yield the table of the keys of results; neighbours with one meaning share a row."""
    yield (
        'Keys of `~/throw_result`. A throw gives a message at its first release and one at its\n'
        'end; a value that is unknown or was not measured has no key. The rig follows by the\n'
        'names of its parameters.\n'
    )
    rows = groupby(RESULT_KEYS, lambda key: key.meaning + f' [{key.unit}]' * bool(key.unit))
    yield from _markdown(
        ('key', 'meaning'),
        ((', '.join(f'`{key.name}`' for key in keys), meaning) for meaning, keys in rows),
    )


def _name_of(topic: interface.Topic) -> str:
    return f'`{topic.name}`{" (subscribed)" if topic.is_input else ""}'


def _service_row(service: interface.Service) -> tuple[str, ...]:
    return f'`{service.name}`', _short(service.type), service.meaning


def _topic_row(topic: interface.Topic) -> tuple[str, ...]:
    joints = topic.joints or topic.axes
    shown = joints if len(joints) < 4 else (joints[0], '...', joints[-1])
    names = ', '.join(name if name == '...' else f'`{name}`' for name in shown)
    quantities = f': {", ".join(topic.quantities)}' * bool(topic.joints)
    content = topic.meaning + f'; {names}{quantities}' * bool(names)
    queue = [
        str(topic.depth),
        *(['latched'] if topic.is_latched else []),
        *([] if topic.is_reliable else ['best effort']),
    ]
    return _name_of(topic), _short(topic.type), content, ', '.join(queue)


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
