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
"""YAML whose values know their lines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from soft_throw_ros.configuration.table import number_of, ParameterError
import yaml


@dataclass(frozen=True)
class Located:
    """A value, and where it stands: `FILE:LINE`, or the argument it is from."""

    where: str
    value: Any = None
    """A bool, number or text, or a list of such; None of a mapping."""
    items: tuple[tuple[str, Located], ...] | None = None
    """Of a mapping, in their order; a key may come twice."""


def read(path: Path) -> Located | None:
    """
    Read a file; None if there is nothing in it.

    Raises
    ------
    ParameterError
        Naming file and line, if it cannot be read or is no YAML.

    """
    try:
        text = path.read_text(encoding='utf-8')
    except OSError as error:
        raise ParameterError(f'{path}: {error.strerror}') from None
    except UnicodeDecodeError:
        raise ParameterError(f'{path}: is no UTF-8 text') from None
    except ValueError as error:
        raise ParameterError(f'{path}: {error}') from None  # no name that a file can have
    return _parse(text, str(path), has_lines=True)


def parse(text: str, where: str) -> Any:
    """Read the value of an argument, or raise ParameterError saying where it is."""
    root = _parse(text, where, has_lines=False)
    return '' if root is None else root.value


class _Loader(yaml.SafeLoader):
    """Composes nodes, which know their lines; ROS has no aliases, so no node recurs."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            problem = f'ROS takes no alias, got *{event.anchor}'
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return super().compose_node(parent, index)


def _parse(text: str, name: str, *, has_lines: bool) -> Located | None:
    def place(mark: yaml.Mark) -> str:
        return f'{name}:{mark.line + 1}' if has_lines else name

    def locate(node: yaml.Node) -> Located:
        where = place(node.start_mark)
        if not isinstance(node, yaml.MappingNode):
            return Located(where, _value(node))
        items = ((str(key.value), locate(value)) for key, value in node.value)
        return Located(where, items=tuple(items))

    try:
        root = yaml.compose(text, Loader=_Loader)
        return None if root is None else locate(root)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, 'problem_mark', None)
        problem = getattr(error, 'problem', None) or str(error).splitlines()[0]
        raise ParameterError(f'{place(mark) if mark else name}: {problem}') from None


def _value(node: yaml.Node) -> Any:
    """Return what a node stands for; unlike YAML 1.1, ROS takes 2e-3 for a number."""
    if isinstance(node, yaml.SequenceNode):
        return [_value(item) for item in node.value]
    text = str(node.value)
    if not isinstance(node, yaml.ScalarNode) or node.style:
        return text
    if node.tag == 'tag:yaml.org,2002:bool':
        return yaml.SafeLoader.bool_values[text.lower()]
    number = number_of(text)
    return text if number is None else number
