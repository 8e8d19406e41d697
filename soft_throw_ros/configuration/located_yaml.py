# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""YAML values with the lines where they stand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from soft_throw_ros.configuration.table import number_of, ParameterError
from soft_throw_ros.storage.regular_file import read_regular_file
import yaml

_MAX_BYTES = 1 << 18
"""Largest size of a YAML file, 30 times the installed ones; PyYAML reads it in seconds. [byte]"""


@dataclass(frozen=True)
class Located:
    """A value and its source, `FILE:LINE`."""

    where: str
    value: Any = None
    """A bool, number or text, or a list of scalars; None for a mapping."""
    items: tuple[tuple[str, Located], ...] | None = None
    """Items of a mapping in their order; a key may occur twice."""


def read(path: Path) -> Located | None:
    """
    Read a file; return None if it is empty.

    Raises
    ------
    ParameterError
        If the file cannot be read or is no YAML; the message has file and line.

    """
    try:
        text = read_regular_file(path, max_bytes=_MAX_BYTES).decode()
    except OSError as error:
        raise ParameterError(f'{path}: {error.strerror}') from None
    except UnicodeDecodeError:
        raise ParameterError(f'{path}: is no UTF-8 text') from None
    except ValueError as error:
        raise ParameterError(f'{path}: {error}') from None  # no name that a file can have
    try:
        root = yaml.compose(text, Loader=_Loader)
        return None if root is None else _locate(root, path)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, 'problem_mark', None)
        problem = getattr(error, 'problem', None) or str(error).splitlines()[0]
        where = f'{path}:{mark.line + 1}' if mark else path
        raise ParameterError(f'{where}: {problem}') from None


class _Loader(yaml.SafeLoader):
    """A loader that refuses aliases, as ROS does, so that no node occurs twice."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            problem = f'ROS takes no alias, got *{event.anchor}'
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return super().compose_node(parent, index)


def _locate(node: yaml.Node, path: Path) -> Located:
    where = f'{path}:{node.start_mark.line + 1}'
    if not isinstance(node, yaml.MappingNode):
        return Located(where, _value(node))
    items = ((str(key.value), _locate(value, path)) for key, value in node.value)
    return Located(where, items=tuple(items))


def _value(node: yaml.Node) -> Any:
    """Return the value of a node; ROS takes 2e-3 for a number, and YAML 1.1 does not."""
    if isinstance(node, yaml.SequenceNode):
        return [_value(item) for item in node.value]
    text = str(node.value)
    if not isinstance(node, yaml.ScalarNode) or node.style:
        return text
    if node.tag == 'tag:yaml.org,2002:bool':
        return yaml.SafeLoader.bool_values[text.lower()]
    number = number_of(text)
    return text if number is None else number
