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
"""The table of parameters as parameters of a node."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import math

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.parameter import Parameter
from soft_throw_ros.configuration import Entry, files, ParameterError, Settings, Table, Value
from soft_throw_ros.nodes.process import RunnableNode

LOG_PERIOD = 0.5
"""How often changes are logged at most [s]."""


class _Refusal(Parameter):
    """A parameter at its present value, which carries through rclpy why a request is refused."""

    reason: str


class _Result(Parameter):
    """A result, which the node itself sets."""


class NodeParameters:
    """
    Declare every parameter of a table on a node, and watch over them.

    Parameters
    ----------
    node : RunnableNode
        Made without `automatically_declare_parameters_from_overrides`.
    table : Table
        What there is.
    on_changed : callable
        Called with what has really changed, by name, after `settings` has been replaced.
    describe : callable, optional
        Says of a changed parameter, by its name, when the change takes effect, for the log.
    check : callable, optional
        Called with complete settings before they are accepted; refuses them by ValueError.
    arguments : sequence of str
        The command line, to say in which file and line a bad value stands.

    Attributes
    ----------
    settings : mapping of str to value
        All present settings; replaced at every change, so that a thread may take it at any time.

    Raises
    ------
    ParameterError
        In one line, if a value is refused, or a name is no parameter.

    Notes
    -----
    rclpy looks at a request in this order: pre-set callbacks, names, types and ranges of the
    descriptors, on-set callbacks, post-set callbacks. Its own words for a wrong type name
    neither parameter nor value, and for an unknown name nothing at all. So requests are judged in
    the pre-set callback; what is refused is replaced there by a `_Refusal`, which rclpy lets
    pass, and refused with our words in the on-set callback. Nobody else's callback gets to see
    a part of a refused request, and the descriptors can still tell tools types and ranges.

    Requests arrive in the executor's thread. `apply` and `set_results` belong there too.

    """

    def __init__(
        self,
        node: RunnableNode,
        table: Table,
        on_changed: Callable[[Settings], None] = lambda _changes: None,
        *,
        describe: Callable[[str], str] = lambda _name: '',
        check: Callable[[Settings], None] = lambda _settings: None,
        arguments: Sequence[str] = (),
    ) -> None:
        self._node = node
        self._table = table
        self._on_changed = on_changed
        self._check = check
        self._log = _ChangeLog(node, describe)
        # rclpy has no public way to see values for names that are not declared: the typos
        overrides = node._parameter_overrides.values()
        values = {item.name: item.value for item in overrides if not self._is_foreign(item.name)}
        given = files.select(files.read_arguments(arguments), node.get_fully_qualified_name())
        self.settings: Settings = files.start(values, given, table)
        self._check_complete(self.settings)
        for entry in table.entries:
            value = self.settings.get(entry.name, entry.default)
            node.declare_parameter(entry.name, value, _descriptor(entry), ignore_override=True)
        node.add_pre_set_parameters_callback(self._on_pre_set)
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._on_post_set)

    def apply(self, changes: Settings) -> None:
        """Change several settings as a request would; ParameterError if they are refused."""
        self._set([Parameter(name, value=value) for name, value in changes.items()])

    def set_results(self, results: Mapping[str, float | str]) -> None:
        """
        Set parameters `recommended.*`, which are refused to everybody else.

        They are named without `recommended.`; those that are missing become nan, or empty.

        """
        values = {entry.name: entry.default for entry in self._table.entries if entry.is_result}
        for name, value in results.items():
            values[f'recommended.{name}'] = value if isinstance(value, str) else float(value)
        self._set([_Result(name, value=value) for name, value in values.items()])

    def _set(self, parameters: list[Parameter]) -> None:
        result = self._node.set_parameters_atomically(parameters)
        if not result.successful:
            raise ParameterError(result.reason)

    def _is_foreign(self, name: str) -> bool:
        """Tell whether somebody else answers for a parameter."""
        declared = name not in self._table.by_name and self._node.has_parameter(name)
        return declared or files.is_foreign(name)

    def _check_complete(self, settings: Settings) -> None:
        try:
            self._check(settings)
        except ValueError as error:
            raise ParameterError(str(error)) from error

    def _on_pre_set(self, parameters: list[Parameter]) -> list[Parameter]:
        try:
            return self._accepted(parameters)
        except ParameterError as error:
            name = self._table.entries[0].name
            refusal = _Refusal(name, value=self.settings[name])
            refusal.reason = str(error)
            return [refusal]

    def _accepted(self, parameters: list[Parameter]) -> list[Parameter]:
        """Return the parameters to be set instead, or raise ParameterError."""
        passed: list[Parameter] = []
        request: dict[str, Value] = {}
        for parameter in parameters:
            name, value = parameter.name, parameter.value
            entry = self._table.by_name.get(name)
            if isinstance(parameter, _Result) or self._is_foreign(name):
                passed.append(parameter)
            elif entry is not None and entry.is_result:
                passed.append(self._node.get_parameter(name))  # as it is, so that a dump loads
            elif name in request:
                raise ParameterError(f'{name} is given twice, {request[name]!r} and {value!r}')
            else:
                request[name] = value
        changes = self._table.change(self.settings, request)
        if changes:
            self._check_complete({**self.settings, **changes})
        return passed + [Parameter(name, value=value) for name, value in changes.items()]

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if isinstance(parameter, _Refusal):
                return SetParametersResult(successful=False, reason=parameter.reason)
        return SetParametersResult(successful=True)

    def _on_post_set(self, parameters: list[Parameter]) -> None:
        changes = {
            parameter.name: parameter.value
            for parameter in parameters
            if parameter.name in self.settings and parameter.value != self.settings[parameter.name]
        }
        if changes:
            self.settings = {**self.settings, **changes}
            self._on_changed(changes)
            self._log.add(changes)


def shown(value: object) -> str:
    """Write the value of a parameter for people, who need no 17 digits of 6.789000000000001."""
    return str(float(f'{value:.9g}') if isinstance(value, float) else value)


class _ChangeLog:
    """Says in the log what has changed, at once, but of a storm only every half a second."""

    def __init__(self, node: RunnableNode, describe: Callable[[str], str]) -> None:
        self._logger = node.get_logger()
        self._describe = describe
        self._waiting: dict[str, Value] = {}
        self._timer = node.call_every(LOG_PERIOD, self._flush)
        self._timer.cancel()

    def add(self, changes: Settings) -> None:
        """Take note of changes, later values in place of earlier ones."""
        self._waiting.update(changes)
        if self._timer.is_canceled():
            self._flush()
            self._timer.reset()

    def _flush(self) -> None:
        for name, value in self._waiting.items():
            self._logger.info(f'{name} is now {shown(value)}{self._describe(name)}')
        if not self._waiting:
            self._timer.cancel()
        self._waiting.clear()


def _descriptor(entry: Entry) -> ParameterDescriptor:
    unit = f' [{entry.unit}]' if entry.unit else ''
    constraints = ': '.join(filter(None, (entry.rule, ', '.join(entry.examples))))
    descriptor = ParameterDescriptor(
        description=f'{entry.meaning}{unit}', additional_constraints=constraints
    )
    low = 0 if entry.or_zero else entry.low
    if not math.isfinite(low) or isinstance(entry.default, tuple):
        return descriptor  # of a list ROS knows no range
    if isinstance(entry.default, int):
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(entry.high))]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(low), to_value=float(entry.high))
        ]
    return descriptor
