# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
ROS parameter files, read without ROS.

A node gets its values from ROS, and finds here the source of each, a file or an argument, for
error messages and for the order of requests.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import pairwise
import math
from pathlib import Path
import re
import textwrap
from typing import Any, NamedTuple

import numpy as np
from soft_throw_ros.configuration.table import ParameterError, quote, Settings, Table, Value
from soft_throw_ros.configuration.twin import TWIN
from soft_throw_ros.configuration.yaml_file import read_yaml
import yaml

_KEY = 'ros__parameters'
_NOTE = '    # '
_FOREIGN = re.compile(r'use_sim_time|start_type_description_service|qos_overrides\..*')


class Source(NamedTuple):
    """The source of a value: a file, or an argument."""

    node: str  # pattern of node names
    name: str
    where: str  # `FILE` or `-p NAME:=VALUE`
    order: int = 0  # of the file or of the row of arguments; later ones win
    value: Any = None  # in a file; None for an argument, which ROS parses
    in_file: bool = True


def read(
    path: str | Path, *, node: str = '/twin', table: Table = TWIN, is_required: bool = True
) -> dict[str, Value]:
    """
    Read complete settings for a node from a ROS parameter file, which may lack parameters.

    Results and parameters of rclpy, as in a file of `ros2 param dump`, are ignored, and so are
    parameters of other nodes in a section for several nodes.
    """
    everything = read_file(path)
    sources = select(everything, node)
    if is_required and not sources:
        nodes = ', '.join(sorted({item.node for item in everything})) or 'no parameters'
        raise ParameterError(f'{path}: nothing for node {node}; it has {nodes}')
    values = {name: item.value for name, item in sources.items() if not is_foreign(name)}
    return start(values, sources, table)


def start(values: Settings, sources: dict[str, Source], table: Table = TWIN) -> dict[str, Value]:
    """
    Return the settings at the start from the values of files and arguments.

    Each file is one request, and so is each row of `-p`, which may replace a layer of a file. A
    value of a file that is present already is no change, so that one line of it can be edited.
    """
    settings = table.defaults()
    sources = {name: sources.get(name, Source('', name, '')) for name in values}
    try:
        for order in sorted({source.order for source in sources.values()}):
            request: dict[str, Value] = {}
            for name, (node, _, _, turn, _, in_file) in sources.items():
                entry = table.by_name.get(name)
                # of another node, or a result in a file of `ros2 param dump`
                is_ignored = node.endswith('*') if entry is None else entry.is_result
                if turn == order and not (in_file and is_ignored):
                    value = table.check_value(name, values[name])
                    if not in_file or value != settings[name]:
                        request[name] = value
            settings.update(table.change(settings, request))
    except ParameterError as error:
        where = next((sources[name].where for name in error.names if name in sources), '')
        raise ParameterError(where + ': ' * bool(where) + str(error), *error.names) from None
    return settings


def is_foreign(name: str) -> bool:
    """Return whether a parameter is one that rclpy declares on every node."""
    return _FOREIGN.fullmatch(name) is not None


def read_arguments(arguments: Sequence[str]) -> list[Source]:
    """Return the sources in ROS arguments (`--ros-args -p NAME:=VALUE --params-file FILE`)."""
    sources: list[Source] = []
    order, in_file, inside = 0, True, False
    for flag, argument in pairwise(arguments):
        inside = (inside or flag == '--ros-args') and flag != '--'
        if not inside or flag not in ('-p', '--param', '--params-file'):
            continue
        order += in_file or flag == '--params-file'
        in_file = flag == '--params-file'
        if in_file:
            sources += read_file(argument, order)
        else:
            node, _, name = argument.partition(':=')[0].rpartition(':')
            sources.append(Source(node or '/**', name, f'-p {argument}', order, in_file=False))
    return sources


def select(sources: Iterable[Source], node: str) -> dict[str, Source]:
    """Return the sources for one node by parameter name; the last one wins."""
    return {item.name: item for item in sources if _matches(item.node, node)}


def _matches(pattern: str, node: str) -> bool:
    """Return whether a pattern of ROS matches the full name of a node."""
    regex = re.escape('/' + pattern.lstrip('/'))
    regex = regex.replace(r'/\*\*', r'(/\w+)*').replace(r'/\*', r'/\w+')
    return re.fullmatch(regex, node) is not None


def render(
    settings: Settings, *, table: Table = TWIN, title: str = '', assumed: Collection[str] = ()
) -> str:
    """
    Return the text of a ROS parameter file with comments from the table.

    Assumed parameters are comments as well, so that no reader takes their values as stated.
    """
    lines = [f'# {line}'.rstrip() for line in title.splitlines()]
    lines += [f'/**/{table.node}:', f'  {_KEY}:']
    for entry in table.entries:
        if entry.name in settings:
            comment = f'{entry.meaning.replace("`", "")}. Must be {entry.rule}.'
            lines += textwrap.wrap(comment, 99, initial_indent=_NOTE, subsequent_indent=_NOTE)
            text = f'{entry.name}: {_text(settings[entry.name])}'
            lines.append(f'{_NOTE}{text}  # assumed' if entry.name in assumed else f'    {text}')
    return '\n'.join(lines) + '\n'


def _text(value: Value) -> str:
    """Return a value as a line of YAML; texts are quoted, so that none is read as a number."""
    items, style = np.ravel(value).tolist(), None  # without the types of numpy
    if isinstance(items[0], str):  # only double quotes can hold a line end or a control character
        style = "'" if all(str(item).isprintable() for item in items) else '"'
    text = yaml.safe_dump(
        items, default_flow_style=True, default_style=style, width=math.inf, allow_unicode=True
    ).strip()
    return text if isinstance(value, tuple) else text[1:-1]


def read_file(path: str | Path, order: int = 0) -> list[Source]:
    """Return the values of a file in their order; errors are those of `read_yaml`."""
    sources = []
    for keys, value in _leaves(read_yaml(path)):
        if _KEY in keys[:-1]:
            cut = keys.index(_KEY)
            node, name = '/'.join(keys[:cut]), '.'.join(keys[cut + 1:])
            sources.append(Source(node, name, str(path), order, value))
        elif value is not None:
            place = f'{quote(value)} as {quote(keys[-1])}'
            raise ParameterError(f'{path}: must be NODE: {_KEY}: NAME: VALUE, got {place}')
    return sources


def _leaves(tree: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the keys of each value, from the outermost on, and the value."""
    if not isinstance(tree, dict):
        yield keys, tree
        return
    for key, value in tree.items():
        yield from _leaves(value, (*keys, str(key)))
