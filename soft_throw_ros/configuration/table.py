# SPDX-License-Identifier: Apache-2.0
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
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
import difflib
from functools import cached_property
import math
from typing import Any, TypeAlias

Value: TypeAlias = bool | float | int | str | tuple[str, ...] | tuple[float, ...]

Settings: TypeAlias = Mapping[str, Any]


class ParameterError(ValueError):
    """
    A parameter was refused.

    Parameters
    ----------
    message : str
        What was given and what would be right, in one line.
    *names : str
        The parameters concerned, the one to blame first.

    """

    def __init__(self, message: str, *names: str) -> None:
        super().__init__(message)
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
    meaning : str
        One sentence, without full stop.
    unit : str
        SI, empty if there is none.
    low, high : float
        Smallest and largest number allowed.
    or_zero : bool
        Whether 0 is allowed besides.
    choices : tuple of str
        The texts allowed; without, any text is.
    kind : str
        What a text is that is checked elsewhere, in words.
    pattern : str
        What the texts of a list begin with.
    hint : str
        What to add when a value is refused.

    """

    name: str
    default: Value
    meaning: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    or_zero: bool = False
    choices: tuple[str, ...] = ()
    kind: str = ''
    pattern: str = ''
    hint: str = ''

    @property
    def group(self) -> str:
        """What comes before the first dot."""
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
        """What is allowed, to stand after 'must be'."""
        if self.is_result:
            return 'set by the twin'
        if self.choices:
            return f'{"one of " * (len(self.choices) > 1)}{", ".join(map(repr, self.choices))}'
        if isinstance(self.default, bool):
            return 'true or false'
        if isinstance(self.default, str):
            return self.kind or 'a text'
        if isinstance(self.default, tuple) and not self._is_of_numbers:
            return f'a list of texts, each beginning with {self.pattern}'
        if self.low == self.high:
            return f'{self.low:g}'
        kind = 'a whole number' if isinstance(self.default, int) else 'a number'
        if isinstance(self.default, tuple):
            kind = 'a list of numbers'
        unit = f' {self.unit}' if self.unit else ''
        zero = ', or 0' if self.or_zero else ''
        return f'{kind} from {self.low:g} to {self.high:g}{unit}{zero}'

    def allows(self, value: Any) -> bool:
        """Tell whether `value` obeys the rule; a whole number is taken for a float."""
        if self.choices:
            return isinstance(value, str) and value in self.choices
        if isinstance(self.default, tuple):
            allows = self._allows_number if self._is_of_numbers else self._allows_text
            return (
                isinstance(value, (array, list, tuple))
                and len(value) > 0
                and all(map(allows, value))
            )
        if isinstance(self.default, (bool, str)):
            return type(value) is type(self.default)
        return self._allows_number(value)

    @property
    def _is_of_numbers(self) -> bool:
        return isinstance(self.default, tuple) and isinstance(self.default[0], float)

    def _allows_text(self, value: Any) -> bool:
        return isinstance(value, str) and value.startswith(self.pattern)

    def _allows_number(self, value: Any) -> bool:
        numbers = int if isinstance(self.default, int) else (int, float)
        if isinstance(value, bool) or not isinstance(value, numbers):
            return False
        return self.low <= value <= self.high or (self.or_zero and value == 0)

    def converted(self, value: Any) -> Value:
        """Return a value that is allowed in the parameter's own type."""
        if self._is_of_numbers:
            return tuple(map(float, value))
        return type(self.default)(value)


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
    check_together : callable
        Refuses contradictions among values that were set at once: given the complete settings
        after the change, and the names of what was set.

    """

    node: str
    entries: tuple[Entry, ...]
    hints: Mapping[str, str] = field(default_factory=dict)
    imply: Callable[[Settings, Settings], Settings] = lambda _settings, changes: changes
    check_together: Callable[[Settings, Collection[str]], None] = lambda _settings, _names: None

    @cached_property
    def by_name(self) -> Mapping[str, Entry]:
        """Return the entries by their names."""
        return {entry.name: entry for entry in self.entries}

    def defaults(self) -> dict[str, Value]:
        """Return the settings to begin with."""
        return {entry.name: entry.default for entry in self.entries if not entry.is_result}

    def check_value(self, name: str, value: Any) -> Value:
        """
        Return `value` in the parameter's own type.

        Parameters
        ----------
        name : str
            Full name of a parameter.
        value : bool, float, int, str or sequence of str or of numbers
            A whole number is taken for a float, nothing else is converted.

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
        if not entry.allows(value):
            hint = f'; {entry.hint}' if entry.hint else ''
            raise ParameterError(f'{name} must be {entry.rule}, got {value!r}{hint}', name)
        return entry.converted(value)

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
        self.check_together({**settings, **changes}, checked.keys())
        return changes


def row(name: str, default: Value, meaning: str, **rest: Any) -> Entry:
    """Make an entry, so that a table can be read in columns."""
    return Entry(name=name, default=default, meaning=meaning, **rest)
