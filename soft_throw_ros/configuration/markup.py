# SPDX-License-Identifier: Apache-2.0
"""YAML whose values know their lines, and are typed as ROS types them."""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any

from soft_throw_ros.configuration.table import ParameterError
import yaml

_TRUE = ('y', 'Y', 'yes', 'Yes', 'YES', 'true', 'True', 'TRUE', 'on', 'On', 'ON')
_FALSE = ('n', 'N', 'no', 'No', 'NO', 'false', 'False', 'FALSE', 'off', 'Off', 'OFF')


def read(path: Path) -> yaml.Node | None:
    """
    Read a file into nodes; None if there is nothing in it.

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
    return compose(text, str(path))


def compose(text: str, where: str) -> yaml.Node | None:
    """Parse YAML into nodes, which know their lines; ROS has no aliases, so no node recurs."""
    try:
        for token in yaml.scan(text, Loader=yaml.SafeLoader):
            if isinstance(token, yaml.AliasToken):
                problem = f'ROS takes no alias, got *{token.value}'
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=token.start_mark)
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, 'problem_mark', None)
        line = f':{mark.line + 1}' if mark and not where.startswith('-p') else ''
        problem = getattr(error, 'problem', None) or str(error).splitlines()[0]
        raise ParameterError(f'{where}{line}: {problem}') from None


def place(path: Path, node: yaml.Node) -> str:
    """Say where a node stands."""
    return f'{path}:{node.start_mark.line + 1}'


def value_of(node: yaml.Node | None) -> Any:
    """Type a value as ROS does, which takes 2e-3 for a number and 1_000 for a text."""
    if isinstance(node, yaml.SequenceNode):
        return [value_of(item) for item in node.value]
    text = str(node.value) if node is not None else ''
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
