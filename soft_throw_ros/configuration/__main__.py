# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Write the generated files of `config/` and `docs/` from the tables; run above both folders.

The files are the defaults of two nodes, docs/parameters.md and docs/topics.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from soft_throw_ros.configuration.files import render
from soft_throw_ros.configuration.interface import INTERFACES, Topic, TWIN_TOPICS
from soft_throw_ros.configuration.node_tables import CALIBRATOR, RECORDER, RIG, VIEWER
from soft_throw_ros.configuration.table import Entry, value_text
from soft_throw_ros.configuration.twin import TWIN

_COMMAND = 'python -m soft_throw_ros.configuration'

_PARAMETERS = f"""\
# Parameters

SI units. Written from the tables by `{_COMMAND}`.

A number may also be text, as which YAML 1.1 reads `5e-06`. A request to change a read-only
parameter is refused; `ros2 param load` of a dump reports this, and sets all others. The values
of a request are set in the order of these tables, so that the later of two values that contradict
each other wins; values of a file that are present already do not count. Every change within its
range is accepted, if the rig can be computed in time and a controller can play a commanded
motion.
"""

_TOPICS = f"""\
# Topics and services

SI units; z points up from the rest position of the plate, in the frame `rig`.
`~` stands for the full name of the node, such as `/twin` or `/rig1/twin`;
a name without leading slash is relative to its namespace. The queue is the number of
messages kept (keep last); topics are reliable unless it says otherwise, and a latched
topic (transient local) sends its queue to late subscribers.
Joints or axes follow the content. [results.md](results.md) has the keys of `~/throw_result`.
Written from the tables by `{_COMMAND}`.
"""


def documents() -> dict[str, str]:
    """Return the text of every generated file by its path."""
    title = f'The parameters of the {{}}, here the defaults. SI units.\nWritten by {_COMMAND}.'
    files = {
        f'config/{table.node}.yaml':
            render(table.defaults(), table=table, title=title.format(table.node))
        for table in (TWIN, RECORDER)
    }
    pages = {'parameters': _parameters_page(), 'topics': _topics_page()}
    return {**files, **{f'docs/{name}.md': '\n'.join(page) for name, page in pages.items()}}


def _parameters_page() -> Iterator[str]:
    yield _PARAMETERS
    for table in (TWIN, RECORDER, VIEWER, CALIBRATOR, RIG):
        known = () if table is TWIN else TWIN.entries
        shared = [f'`{entry.name}`' for entry in table.entries if entry in known]
        rows = [_parameter_row(entry) for entry in table.entries if entry not in known]
        head = ('parameter', 'default (values)', 'meaning')
        yield from _section(table.node, shared, (head, rows))


def _parameter_row(entry: Entry) -> tuple[str, ...]:
    unit = f' [{entry.unit}]' if entry.unit and entry.is_result else ''
    rule = entry.rule.replace("'", '`').removeprefix('a number from ').removeprefix('one of ')
    rule = rule.replace('a whole number from', 'whole,').removesuffix(', or empty')
    return (
        f'`{entry.name}`',
        'read-only' if entry.is_result else f'{value_text(entry.default) or "empty"} ({rule})',
        entry.meaning + unit,
    )


def _topics_page() -> Iterator[str]:
    yield _TOPICS
    for node, (topics, services) in INTERFACES.items():
        known = () if node == 'twin' else {topic.meaning for topic in TWIN_TOPICS}
        shared = [_name_of(topic) for topic in topics if topic.meaning in known]
        rows = [_topic_row(topic) for topic in topics if topic.meaning not in known]
        effects = [(f'`{item.name}`', 'std_srvs/Trigger', item.meaning) for item in services]
        content = ('topic', 'type', 'content', 'queue'), rows
        yield from _section(node, shared, content, (('service', 'type', 'effect'), effects))


def _name_of(topic: Topic) -> str:
    return f'`{topic.name}`{" (subscribed)" * topic.is_input}'


def _topic_row(topic: Topic) -> tuple[str, ...]:
    names = [f'`{name}`' for name in topic.joints or topic.axes]
    shown = names if len(names) < 4 else (names[0], '...', names[-1])
    quantities = f': {", ".join(topic.quantities)}' * bool(topic.joints)
    content = topic.meaning + f'; {", ".join(shown)}{quantities}' * bool(names)
    queue = f'{topic.depth}{", latched" * topic.is_latched}'
    queue += ', best effort' * (not topic.is_reliable)
    return _name_of(topic), topic.type.replace('/msg/', '/'), content, queue


def _section(
    node: str, shared: list[str], *tables: tuple[tuple[str, ...], Sequence[tuple[str, ...]]]
) -> Iterator[str]:
    """Yield the head of a node, what it shares with the twin, and its tables that have rows."""
    yield f'## {node}\n'
    if shared:
        yield f'As of the twin: {", ".join(shared)}.\n'
    for head, rows in tables:
        if rows:
            for row in (head, ('---',) * len(head), *rows):
                yield f'| {" | ".join(row)} |'
            yield ''


if __name__ == '__main__':
    for path, text in documents().items():
        Path(path).write_text(text, 'utf-8')
