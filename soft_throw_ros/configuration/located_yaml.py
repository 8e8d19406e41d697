# SPDX-License-Identifier: Apache-2.0
"""YAML whose values know their lines, and are typed as ROS types them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import re
from typing import Any

from soft_throw_ros.configuration.table import ParameterError
import yaml

_TRUE = ('y', 'Y', 'yes', 'Yes', 'YES', 'true', 'True', 'TRUE', 'on', 'On', 'ON')
_FALSE = ('n', 'N', 'no', 'No', 'NO', 'false', 'False', 'FALSE', 'off', 'Off', 'OFF')


@dataclass(frozen=True)
class Located:
    """A value, and where it stands: `FILE:LINE`, or the argument it is from."""

    where: str
    value: Any = None
    """A bool, number or text as ROS types it, or a list of such; None of a mapping."""
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
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else 'is no UTF-8 text'
        raise ParameterError(f'{path}: {reason}') from None
    root = _compose(text, lambda line: f'{path}:{line + 1}', str(path))
    return None if root is None else _located(root, lambda line: f'{path}:{line + 1}')


def parse(text: str, where: str) -> Any:
    """Type the value of an argument as ROS does, or raise ParameterError saying where it is."""
    root = _compose(text, lambda _line: where, where)
    return '' if root is None else _located(root, lambda _line: where).value


def _compose(text: str, place: Callable[[int], str], name: str) -> yaml.Node | None:
    """Parse YAML into nodes, which know their lines; ROS has no aliases, so no node recurs."""
    try:
        for token in yaml.scan(text, Loader=yaml.SafeLoader):
            if isinstance(token, yaml.AliasToken):
                problem = f'ROS takes no alias, got *{token.value}'
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=token.start_mark)
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, 'problem_mark', None)
        problem = getattr(error, 'problem', None) or str(error).splitlines()[0]
        raise ParameterError(f'{place(mark.line) if mark else name}: {problem}') from None


def _located(node: yaml.Node, place: Callable[[int], str]) -> Located:
    where = place(node.start_mark.line)
    if not isinstance(node, yaml.MappingNode):
        return Located(where, _value(node))
    items = ((str(key.value), _located(value, place)) for key, value in node.value)
    return Located(where, items=tuple(items))


def _value(node: yaml.Node) -> Any:
    """Type a value as ROS does, which takes 2e-3 for a number and 1_000 for a text."""
    if isinstance(node, yaml.SequenceNode):
        return [_value(item) for item in node.value]
    text = str(node.value)
    plain = isinstance(node, yaml.ScalarNode) and not node.style
    if not plain or '_' in text:
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if re.fullmatch(r'[-+]?0[0-7]+', text):
        return int(text, 8)
    if re.fullmatch(r'[-+]?(0|[1-9]\d*|0[xX][0-9a-fA-F]+)', text):
        return int(text, 16 if 'x' in text.lower() else 10)
    if re.fullmatch(r'[-+]?\.(inf|nan)', text, re.IGNORECASE):
        return float(text.replace('.', ''))
    try:
        return float(text)
    except ValueError:
        return text
