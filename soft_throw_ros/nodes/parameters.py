# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The table of parameters as parameters of a node."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter
from soft_throw_ros.configuration import files, ParameterError, Settings, Table, Value
from soft_throw_ros.configuration.table import Entry, quote
from soft_throw_ros.nodes.process import RunnableNode


class NodeParameters:
    """
    The parameters of a table, declared on a node, and the checks of their changes.

    `settings` are all present values; they are replaced at every change, so that any thread may
    read them, and `on_changed` is then called with the changes. `check` is called with complete
    settings before they are accepted, and with its result for the present ones, `checked`, None at
    first; it refuses by ValueError. `arguments` name the files in a ParameterError at the start.

    rclpy checks names, types and ranges before it calls the on-set callbacks, and its reasons lack
    names and values. So the pre-set callback checks requests, in the executor's thread.
    """

    def __init__(
        self,
        node: RunnableNode,
        table: Table,
        on_changed: Callable[[Settings], None] = lambda _changes: None,
        *,
        check: Callable[[Settings, Any], Any] = lambda _settings, _checked: None,
        arguments: Sequence[str] = (),
    ) -> None:
        self._node = node
        self._table = table
        self._on_changed = on_changed
        self._check = check
        self._results: Settings = {}  # the present ones
        # a private part of rclpy, which ignores undeclared ones: they are misspelled names
        overrides = node._parameter_overrides.values()
        values = {item.name: item.value for item in overrides if not self._is_foreign(item.name)}
        sources = files.select(files.read_arguments(arguments), node.get_fully_qualified_name())
        self.settings: Settings = files.start(values, sources, table)
        self.checked: Any = None
        self.checked = self._candidate = self._check_complete(self.settings)
        for entry in table.entries:
            value = self.settings.get(entry.name, entry.default)
            node.declare_parameter(entry.name, value, _descriptor(entry), ignore_override=True)
        node.add_pre_set_parameters_callback(self._on_pre_set)
        node.add_post_set_parameters_callback(self._on_post_set)

    def apply(self, changes: Settings) -> None:
        """Change several settings as a request would; raise ParameterError if refused."""
        parameters = [Parameter(name, value=value) for name, value in changes.items()]
        result = self._node.set_parameters_atomically(parameters)
        if not result.successful:
            raise ParameterError(result.reason)

    def set_results(self, results: Mapping[str, float | str]) -> None:
        """Set all parameters `recommended.*`."""
        self._results = results
        self.apply(results)

    def _is_foreign(self, name: str) -> bool:
        """Return whether other code has declared a parameter."""
        declared = name not in self._table.by_name and self._node.has_parameter(name)
        return declared or files.is_foreign(name)

    def _check_complete(self, settings: Settings) -> Any:
        try:
            return self._check(settings, self.checked)
        except ValueError as error:
            raise ParameterError(str(error)) from error

    def _on_pre_set(self, parameters: list[Parameter]) -> list[Parameter]:
        """Return the parameters with which rclpy continues, or raise ParameterError."""
        passed: list[Parameter] = []
        request: dict[str, Value] = {}
        for parameter in parameters:
            name, value = parameter.name, parameter.value
            entry = self._table.by_name.get(name)
            if self._is_foreign(name):
                passed.append(parameter)
            elif entry is not None and (entry.is_result or entry.is_fixed):
                present = {**self.settings, **self._results}.get(name, entry.default)
                if str(value) != str(present):  # which may be set, so that a dump loads
                    setter = 'set by the twin' if entry.is_result else 'set at the start'
                    raise ParameterError(f'{name} is read-only, {setter}; got {quote(value)}')
                passed.append(Parameter(name, value=present))
            else:
                request[name] = value
        changes = self._table.change(self.settings, request)
        if changes:
            self._candidate = self._check_complete({**self.settings, **changes})
        return passed + [Parameter(name, value=value) for name, value in changes.items()]

    def _on_post_set(self, parameters: list[Parameter]) -> None:
        changes = {
            parameter.name: parameter.value
            for parameter in parameters
            if parameter.name in self.settings and parameter.value != self.settings[parameter.name]
        }
        if changes:
            self.settings = {**self.settings, **changes}
            self.checked = self._candidate
            self._on_changed(changes)
            for name, value in changes.items():
                self._node.get_logger().info(f'{name} is now {shown(value)}')


def shown(value: object) -> str:
    """Format the value of a parameter, with at most 9 digits."""
    return str(float(f'{value:.9g}') if isinstance(value, float) else value) or "''"


def _descriptor(entry: Entry) -> ParameterDescriptor:
    unit = f' [{entry.unit}]' if entry.unit else ''
    constraints = ': '.join(filter(None, (entry.rule, ', '.join(entry.examples))))
    descriptor = ParameterDescriptor(
        description=f'{entry.meaning}{unit}', additional_constraints=constraints
    )
    low = 0 if entry.or_zero else entry.low
    if not math.isfinite(low) or isinstance(entry.default, tuple):
        return descriptor  # ROS has no ranges for lists
    if isinstance(entry.default, int):
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(entry.high))]
    else:
        limits = FloatingPointRange(from_value=float(low), to_value=float(entry.high))
        descriptor.floating_point_range = [limits]
    return descriptor
