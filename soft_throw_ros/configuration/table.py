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
What a table of parameters is: names, defaults, ranges and meanings, and nothing else.

Whatever knows a node's parameters takes them from its table: the node's descriptors and checks,
parameter files, those in `config/` and the README's tables.

Settings are a value for every parameter of a table, results left out. A request is a handful of
parameters to be set at once. Any single change within its range is accepted, since ROS sets a
list one by one; refused are values out of range and contradictions inside one request.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
import difflib
from functools import cached_property
import math
import re
from typing import Any, TypeAlias

Scalar: TypeAlias = bool | float | int | str
Value: TypeAlias = Scalar | tuple[str, ...] | tuple[float, ...]

NAME = r'/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*'
"""Names of nodes, topics and namespaces in ROS."""

Settings: TypeAlias = Mapping[str, Any]


class ParameterError(ValueError):
    """
    A parameter was refused.

    Parameters
    ----------
    message : str
        What was given and what would be right; the names of files in it may have several lines,
        an error has one.
    *names : str
        The parameters concerned, the one to blame first.

    """

    def __init__(self, message: str, *names: str) -> None:
        super().__init__(' '.join(message.splitlines()))
        self.names = names


@dataclass(frozen=True, kw_only=True)
class Entry:
    """
    One row of the table.

    Parameters
    ----------
    name : str
        Full name; the part before the first dot is its group.
    default : bool, float, int, str, or tuple of str or of float
        Its type is the parameter's type; that of a tuple is that of its first value.
    meaning, unit : str
        One sentence, without full stop; SI, empty if there is none.
    low, high, or_zero : float, float, bool
        Smallest and largest number allowed, and whether 0 is besides.
    choices : tuple of str
        The texts allowed; without, any text is that matches the expression `pattern`.
    kind : str
        What a text is, in words.
    max_length : int
        Of a list.
    examples : tuple of str
        Some of the texts allowed, for those who ask what a parameter is.

    """

    name: str
    default: Value
    meaning: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    or_zero: bool = False
    choices: tuple[str, ...] = ()
    pattern: str = '.*'
    kind: str = 'a text'
    max_length: int = 1000
    examples: tuple[str, ...] = ()

    @property
    def group(self) -> str:
        """Return what comes before the first dot."""
        return self.name.partition('.')[0]

    @property
    def is_result(self) -> bool:
        """Whether the twin sets it, and nobody else may."""
        return self.group == 'recommended'

    @property
    def is_of_rig(self) -> bool:
        """Whether a change waits for the next throw: a wave fits no other layer."""
        return self.group in ('engine', 'layer', 'projectile', 'gravity', 'model')

    @property
    def rule(self) -> str:
        """Return what is allowed, to stand after 'must be'."""
        if self.is_result:
            return 'set by the twin'
        if self.choices:
            return f'{"one of " * (len(self.choices) > 1)}{", ".join(map(repr, self.choices))}'
        if isinstance(self.default, bool):
            return 'true or false'
        if isinstance(self.default, str):
            return self.kind
        if isinstance(self.default, tuple) and isinstance(self.default[0], str):
            return f'a list, each {self.kind}'
        if self.low == self.high:
            return f'{self.low:g}'
        kind = 'a whole number' if isinstance(self.default, int) else 'a number'
        if isinstance(self.default, tuple):
            kind = f'a list of at most {self.max_length} numbers'
        unit = f' {self.unit}' if self.unit else ''
        zero = ', or 0' if self.or_zero else ''
        return f'{kind} from {self.low:g} to {self.high:g}{unit}{zero}'

    def convert(self, value: object) -> Value | None:
        """
        Return `value` in the parameter's own type, or None if the rule does not allow it.

        A whole number is taken for a float, and a text that is a number for that number: tools
        that read YAML 1.1 take `5e-06` for a text.

        """
        if isinstance(self.default, tuple):
            if not isinstance(value, (array, list, tuple)):
                return None
            if not 0 < len(value) <= self.max_length:
                return None
            items = [self._convert_item(item, self.default[0]) for item in value]
            return None if None in items else tuple(items)  # type: ignore[return-value]
        return self._convert_item(value, self.default)

    def allows(self, value: object) -> bool:
        """Tell whether `value` obeys the rule."""
        return self.convert(value) is not None

    def _convert_item(self, value: object, default: float | str) -> float | str | None:
        """Convert a value, or one of a list, to the type of `default`."""
        if isinstance(default, bool):
            return value if isinstance(value, bool) else None
        if isinstance(default, str):
            if not isinstance(value, str) or not re.fullmatch(self.pattern, value, re.DOTALL):
                return None
            return value if not self.choices or value in self.choices else None
        if isinstance(value, str):
            value = number_of(value)
        numbers = int if isinstance(default, int) else (int, float)
        if isinstance(value, bool) or not isinstance(value, numbers):
            return None
        if self.low <= value <= self.high or (self.or_zero and value == 0):
            return type(default)(value)
        return None


@dataclass(frozen=True, kw_only=True)
class Table:
    """
    The parameters of a node.

    Parameters
    ----------
    node : str
        Its name.
    entries : tuple of Entry
        In the order in which they are shown.
    hints : mapping of str to str
        What to say of names that are no parameters but might be expected.
    imply : callable
        Adds to the changes of settings (its arguments are both) what they imply. What was asked
        for is never replaced.
    contradictions : callable
        Finds values in complete settings that contradict each other, as errors with the names of
        the values; they are refused if they were all set at once.

    """

    node: str
    entries: tuple[Entry, ...]
    hints: Mapping[str, str] = field(default_factory=dict)
    imply: Callable[[Settings, Settings], Settings] = lambda _settings, changes: changes
    contradictions: Callable[[Settings], Iterable[ParameterError]] = lambda _settings: ()

    @cached_property
    def by_name(self) -> Mapping[str, Entry]:
        """Return the entries by their names."""
        return {entry.name: entry for entry in self.entries}

    def defaults(self) -> dict[str, Value]:
        """Return the settings to begin with."""
        return {entry.name: entry.default for entry in self.entries if not entry.is_result}

    def check_value(self, name: str, value: object) -> Value:
        """
        Return `value` in the parameter's own type, see `Entry.convert`.

        Raises
        ------
        ParameterError
            If there is no such parameter, it is a result, or the value is of another type, not
            finite, out of range or not among the choices.

        """
        entry = self.by_name.get(name)
        if entry is None:
            close = difflib.get_close_matches(name, self.by_name, n=1)
            advice = self.hints.get(name) or (f'did you mean {close[0]}?' if close else '')
            raise ParameterError(
                f'no parameter is named {name!r}' + (advice and f'; {advice}'), name
            )
        if entry.is_result:
            source = name.replace('recommended.', 'layer.')
            setting = f'set {source} or ' if source in self.by_name else ''
            raise ParameterError(
                f'{name} is a result; {setting}call ~/apply_recommendation (got {value!r})', name
            )
        converted = entry.convert(value)
        if converted is None:
            raise ParameterError(f'{name} must be {entry.rule}, got {_shown(value)}', name)
        return converted

    def change(self, settings: Settings, request: Settings) -> dict[str, Value]:
        """
        Return what `request` makes of `settings`: the new values, those it implies included.

        Parameters
        ----------
        settings : mapping of str to value
            The complete settings before; not modified.
        request : mapping of str to value
            What is to be set at once.

        Raises
        ------
        ParameterError
            If a value is refused by `check_value`, or two contradict each other.

        """
        checked = {name: self.check_value(name, value) for name, value in request.items()}
        changes = dict(self.imply(settings, checked))
        for error in self.contradictions({**settings, **changes}):
            if set(error.names) <= checked.keys():
                raise error
        return changes


def row(name: str, default: Value, meaning: str, **rest: Any) -> Entry:
    """Make an entry, so that a table can be read in columns."""
    return Entry(name=name, default=default, meaning=meaning, **rest)


def number_of(text: str) -> float | None:
    """Return the number that a text is, None if it is none."""
    for kind in (int, float):
        try:
            return None if '_' in text else kind(text)
        except ValueError:
            pass
    return None


def _shown(value: object) -> str:
    """Quote a value; of a very long one the beginning."""
    text = repr(value)
    return text if len(text) <= 200 else f'{text[:200]}... ({len(text)} characters)'
