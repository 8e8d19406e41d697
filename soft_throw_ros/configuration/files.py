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
"""
ROS parameter files and arguments, read without ROS.

Offline commands need the values. The node, which gets its values from ROS, needs to know where
each came from: to name file and line of a bad one, and to let what is given later win.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import resources
from itertools import pairwise
from pathlib import Path
import re
import textwrap
from typing import Any, NamedTuple

from soft_throw_ros.configuration import located_yaml
from soft_throw_ros.configuration.located_yaml import Located
from soft_throw_ros.configuration.table import ParameterError, Settings, Table, Value
from soft_throw_ros.configuration.twin import TWIN

_KEY = 'ros__parameters'


class Given(NamedTuple):
    """A value somebody gave."""

    value: Any
    where: str
    """`FILE:LINE` or `-p NAME:=VALUE`."""
    order: int = 0
    """Of the file, or row of arguments, among all; later ones win."""
    in_file: bool = True


Sections = dict[str, dict[str, Given]]
"""What is given to whom, by the pattern of the node's name."""


def default_file(table: Table = TWIN) -> Path:
    """Return the path of the file with a table's defaults, installed with the package."""
    return Path(str(resources.files('soft_throw_ros') / 'config' / f'{table.node}.yaml'))


def read(path: str | Path, *, node: str = '/twin', table: Table = TWIN) -> dict[str, Value]:
    """
    Read complete settings for a node from a ROS parameter file.

    What the file does not mention keeps its default. Results are left out, so that what
    `ros2 param dump` writes can be read again; so are parameters that every node has.

    Parameters
    ----------
    path : path_like
        A YAML file.
    node : str
        Full name of the node; the file's wildcards are matched as ROS does.
    table : Table
        Of the node's parameters.

    Raises
    ------
    ParameterError
        Naming file and line, if the file cannot be read, has nothing for the node, or has a
        value that is refused.

    """
    sections: Sections = {}
    _add_file(sections, Path(path), order=0)
    given = select(sections, node)
    if not given:
        raise ParameterError(
            f'{path}: nothing for node {node}; it has {", ".join(sections) or "no parameters"}'
        )
    values = {name: item.value for name, item in given.items() if not is_foreign(name)}
    return start(values, given, table)


def start(values: Settings, given: dict[str, Given], table: Table = TWIN) -> dict[str, Value]:
    """
    Make the settings to start with from what files and arguments give.

    Each file is one request, and so is each row of `-p`; they are taken one after another. So
    `-p layer.thickness:=...` turns a layer that a file names into a custom one, and contradicts
    nothing.

    Parameters
    ----------
    values : mapping of str to value
        What is given, over the defaults.
    given : dict of str to Given
        Where it was given; not all need be known.
    table : Table
        Of the node's parameters.

    Raises
    ------
    ParameterError
        Saying where, if a value is refused, or two contradict each other.

    """
    requests: dict[int, dict[str, Value]] = {}
    for name, value in values.items():
        place = given.get(name, Given(value, ''))
        entry = table.by_name.get(name)
        if not (place.in_file and entry is not None and entry.is_result):
            requests.setdefault(place.order, {})[name] = value
    settings = table.defaults()
    try:
        for _, request in sorted(requests.items()):
            settings.update(table.change(settings, request))
    except ParameterError as error:
        where = next((f'{given[name].where}: ' for name in error.names if name in given), '')
        raise ParameterError(f'{where}{error}', *error.names) from None
    return settings


def is_foreign(name: str) -> bool:
    """Tell whether a parameter is one that rclpy gives to every node."""
    return name in ('use_sim_time', 'start_type_description_service') or name.startswith(
        'qos_overrides.'
    )


def read_arguments(arguments: Sequence[str]) -> Sections:
    """
    Collect what ROS arguments (`--ros-args -p NAME:=VALUE --params-file FILE`) give to any node.

    Raises
    ------
    ParameterError
        Naming file and line, if a file cannot be read.

    """
    sections: Sections = {}
    order, in_file = 0, True
    for flag, argument in _ros_flags(arguments):
        order += in_file or flag == '--params-file'
        in_file = flag == '--params-file'
        if in_file:
            _add_file(sections, Path(argument), order=order)
            continue
        target, separator, text = argument.partition(':=')
        node, _, name = target.rpartition(':')
        if separator and text:  # what is no rule is refused by ROS
            where = f'-p {argument}'
            given = Given(located_yaml.parse(text, where), where, order, in_file=False)
            sections.setdefault(_pattern(node or '/**'), {})[name] = given
    return sections


def select(sections: Sections, node: str) -> dict[str, Given]:
    """
    Pick what is given to one node, by parameter name.

    Notes
    -----
    As in ROS, a pattern keeps the place where it first appeared, and the last match wins. So
    `-p` (whose pattern is `/**`) does not override a file that has `/**` and then `/twin`.

    """
    chosen: dict[str, Given] = {}
    tokens = {'': '', '*': r'/\w+', '**': r'(/\w+)*'}
    for pattern, given in sections.items():
        regex = ''.join(tokens.get(token, f'/{re.escape(token)}') for token in pattern.split('/'))
        if re.fullmatch(regex, node):
            chosen.update(given)
    return chosen


def render(settings: Settings, *, table: Table = TWIN, title: str = '') -> str:
    """Write settings as the text of a ROS parameter file, commented from the table."""
    lines = [f'# {line}'.rstrip() for line in title.splitlines()]
    lines += [f'/**/{table.node}:', f'  {_KEY}:']
    group = ''
    for entry in table.entries:
        if entry.name in settings:
            head, _, tail = entry.name.rpartition('.')
            if head and head != group:
                lines.append(f'    {head}:')
            group = head
            indent = ' ' * (6 if head else 4)
            comment = f'# {entry.meaning.replace("`", "")}. Must be {entry.rule}.'
            lines += textwrap.wrap(
                comment, 99, initial_indent=indent, subsequent_indent=f'{indent}# '
            )
            lines.append(f'{indent}{tail}: {_text(settings[entry.name])}')
    return '\n'.join(lines) + '\n'


def write(path: str | Path, settings: Settings, *, title: str = '') -> None:
    """Write settings (all, or some) into a ROS parameter file that `read` and ROS read."""
    Path(path).write_text(render(settings, title=title), encoding='utf-8')


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f'[{", ".join(map(str, value))}]'
    text = str(value) or "''"
    # YAML 1.1 takes 1e-05 for a text; with a point everybody takes it for a number
    return text.replace('e', '.0e') if re.fullmatch(r'-?\de[-+]\d+', text) else text


def _ros_flags(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the parameter flags among ROS arguments, each with what follows it."""
    inside = False
    for flag, argument in pairwise(arguments):
        inside = (inside or flag == '--ros-args') and flag != '--'
        if inside and flag in ('-p', '--param', '--params-file'):
            yield flag, argument


def _add_file(sections: Sections, path: Path, *, order: int) -> None:
    root = located_yaml.read(path)
    if root is not None:
        for pattern, parameters in _nodes(root):
            section = sections.setdefault(_pattern(pattern), {})
            for name, found in _parameters(parameters):
                section[name] = Given(found.value, found.where, order)


def _nodes(tree: Located, parent: str = '') -> Iterator[tuple[str, Located]]:
    """Yield every `ros__parameters` with the pattern above it."""
    if tree.items is None:
        raise ParameterError(
            f'{tree.where}: expected NODE: {_KEY}: NAME: VALUE, got {tree.value!r} before any '
            f'{_KEY}'
        )
    for key, value in tree.items:
        if key == _KEY:
            yield parent, value
        else:
            yield from _nodes(value, f'{parent}/{key}')


def _parameters(tree: Located, parent: str = '') -> Iterator[tuple[str, Located]]:
    """Yield every parameter with its full name."""
    if tree.items is not None:
        for key, value in tree.items:
            yield from _parameters(value, f'{parent}.{key}' if parent else key)
    elif parent:
        yield parent, tree


def _pattern(name: str) -> str:
    return '/' + '/'.join(part for part in name.split('/') if part)
