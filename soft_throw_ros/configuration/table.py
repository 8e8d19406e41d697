# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Tables of parameters: names, defaults, ranges and meanings, for nodes, files and the docs.

Settings are a value for every parameter of a table, results left out. Any single change within
its range is accepted, since ROS sets a list one by one; a request is a row of single changes in
the order of the table, so that the later of two values that contradict each other wins.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
import math
import re
import reprlib
from typing import Any, TypeAlias

Scalar: TypeAlias = bool | float | int | str
Value: TypeAlias = Scalar | tuple[str, ...] | tuple[float, ...]
Settings: TypeAlias = Mapping[str, Any]

NAME = r'/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*'  # of nodes, topics and namespaces in ROS

_MAX_TEXT = 16_384  # length of a text; a path has at most 4096 characters, a stack fewer than this
_QUOTED = reprlib.Repr()
_QUOTED.maxstring = _QUOTED.maxother = 80  # a line of a terminal [characters]


class ParameterError(ValueError):
    """A refused parameter, with the value and the rule; the first of `names` is to blame."""

    def __init__(self, message: str, *names: str) -> None:
        super().__init__(' '.join(message.splitlines()))  # names of files may have line ends
        self.names = names


@dataclass(frozen=True)
class Entry:
    """One row of the table."""

    name: str  # full; the part before the first dot is its group
    default: Value  # it, or its first item, determines the type
    meaning: str  # one sentence, without full stop
    unit: str = ''  # SI unit, empty for a number without unit
    low: float = -math.inf
    high: float = math.inf
    or_zero: bool = False  # whether 0 is allowed besides the numbers from `low` to `high`
    choices: tuple[str, ...] = ()  # the allowed texts; if empty, those that match `pattern`
    pattern: str = '.*'
    kind: str = 'a text'  # description of a valid text, in words
    max_length: int = 1000  # largest number of items of a list
    is_fixed: bool = False  # whether the node reads the parameter at its start only
    examples: tuple[str, ...] = ()  # some of the allowed texts, for the description

    @property
    def group(self) -> str:
        """Return the part of the name before the first dot."""
        return self.name.partition('.')[0]

    @property
    def is_result(self) -> bool:
        """Whether only the twin sets the parameter."""
        return self.group == 'recommended'

    @property
    def is_of_rig(self) -> bool:
        """Whether a change waits for the next throw, because it ends the wave in the layer."""
        return self.group in ('engine', 'layer', 'projectile', 'gravity')

    @property
    def rule(self) -> str:
        """Return the rule for values, to stand after 'must be'."""
        is_list = isinstance(self.default, tuple)
        item = self.default[0] if is_list else self.default  # type: ignore[index]
        if self.is_result:
            return 'set by the twin'
        if self.choices:
            return f'{"one of " * (len(self.choices) > 1)}{", ".join(map(repr, self.choices))}'
        if isinstance(item, bool):
            return 'true or false'
        if isinstance(item, str):
            return f'a list, each {self.kind}' if is_list else self.kind
        one = 'a whole number' if isinstance(item, int) else 'a number'
        kind = f'a list of at most {self.max_length} numbers' if is_list else one
        unit, zero = f' {self.unit}' * bool(self.unit), ', or 0' * self.or_zero
        return f'{kind} from {self.low:g} to {self.high:g}{unit}{zero}'

    def convert(self, value: object) -> Value | None:
        """
        Return `value` in the parameter's own type, or None if the rule does not allow it.

        A text becomes a number, because tools that read YAML 1.1 parse `5e-06` as a text.
        """
        if not isinstance(self.default, tuple):
            return self._convert_item(value, self.default)
        if not isinstance(value, (array, list, tuple)) or not 0 < len(value) <= self.max_length:
            return None
        items = [self._convert_item(item, self.default[0]) for item in value]
        return None if None in items else tuple(items)  # type: ignore[return-value]

    def _convert_item(self, value: object, default: float | str) -> float | str | None:
        """Convert a value, or one of a list, to the type of `default`."""
        if isinstance(default, bool) or isinstance(value, bool):
            return value if isinstance(value, bool) and isinstance(default, bool) else None
        if isinstance(value, str) and (len(value) > _MAX_TEXT or '\0' in value):
            return None
        if isinstance(default, str):
            if not isinstance(value, str) or not re.fullmatch(self.pattern, value, re.DOTALL):
                return None
            return value if not self.choices or value in self.choices else None
        if isinstance(value, str):
            value = number_of(value)
        if not isinstance(value, int if isinstance(default, int) else (int, float)):
            return None
        is_allowed = self.low <= value <= self.high or (self.or_zero and value == 0)
        return type(default)(value) if is_allowed else None

    def check(self, value: object) -> Value:
        """Return `value` as `convert` does; raise ParameterError if the rule does not allow it."""
        converted = None if self.is_result else self.convert(value)
        if converted is None:
            raise ParameterError(f'{self.name} must be {self.rule}, got {quote(value)}', self.name)
        return converted


row = Entry  # a table reads in columns


@dataclass(frozen=True, kw_only=True)
class Table:
    """The parameters of a node."""

    node: str
    entries: tuple[Entry, ...]  # in the order of the documentation
    # Returns the changes of complete settings that a new value of a name implies, or refuses it
    imply: Callable[[Settings, str, Any], Settings] = lambda _settings, _name, _value: {}

    @cached_property
    def by_name(self) -> Mapping[str, Entry]:
        """Return the entries by their names."""
        return {entry.name: entry for entry in self.entries}

    def names_in(self, group: str) -> list[str]:
        """Return the names of the parameters in a group."""
        return [entry.name for entry in self.entries if entry.group == group]

    def defaults(self) -> dict[str, Value]:
        """Return the settings to begin with."""
        return {entry.name: entry.default for entry in self.entries if not entry.is_result}

    def check_value(self, name: str, value: object) -> Value:
        """Return `value` in the parameter's own type, or raise ParameterError."""
        if name in self.by_name:
            return self.by_name[name].check(value)
        raise ParameterError(f'no parameter of the {self.node} is named {quote(name)}', name)

    def change(self, settings: Settings, request: Settings) -> dict[str, Value]:
        """
        Return the new values of a request to complete settings, including implied values.

        The values are set in the order of the table. ParameterError is raised if one is refused.
        """
        checked = {name: self.check_value(name, value) for name, value in request.items()}
        changes: dict[str, Value] = {}
        for name in filter(checked.__contains__, self.by_name):
            implied = self.imply({**settings, **changes}, name, checked[name])
            changes[name] = checked[name]
            changes |= {key: value for key, value in implied.items() if key in self.by_name}
        return changes


def float_of(text: str) -> float | None:
    """Parse a number; return None if the text is none, or has `_` or digits of other scripts."""
    try:
        return float(text) if text.isascii() and '_' not in text else None
    except ValueError:
        return None


def number_of(text: str) -> float | None:
    """Parse a number as `float_of` does; return whole numbers as `int`."""
    number = float_of(text)
    try:
        return None if number is None else int(text)
    except ValueError:
        return number


def value_text(value: Value) -> str:
    """Return a value in short form for help texts and pages."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f'{value:g}'
    return ' '.join(map(value_text, value)) if isinstance(value, tuple) else str(value)


def quote(value: object) -> str:
    """Quote a value in a refusal, shortened to some 80 characters or six items."""
    return _QUOTED.repr(list(value) if isinstance(value, (array, tuple)) else value)
