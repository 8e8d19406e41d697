# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Requests to services of other nodes, from a thread beside the executor."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from typing import Any

from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from soft_throw_ros.configuration import Settings
from soft_throw_ros.twin.session import RequestRejected

_ANSWER_TIMEOUT = 10.0  # longest wait for a service of another node [s]


class RemoteParameters:
    """The parameters of another node; RequestRejected is raised for each request that fails."""

    def __init__(self, node: Node, name: str) -> None:
        self._get = node.create_client(GetParameters, f'{name}/get_parameters')
        set_ = f'{name}/set_parameters_atomically'
        self._set = node.create_client(SetParametersAtomically, set_)

    def get(self, names: Sequence[str]) -> Settings:
        """Return parameters by their names."""
        values = call(self._get, GetParameters.Request(names=names)).values
        return dict(zip(names, map(parameter_value_to_python, values), strict=True))

    def set(self, values: Settings) -> None:  # noqa: A003
        """Set parameters together."""
        items = (Parameter(name, value=value) for name, value in values.items())
        parameters = [item.to_parameter_msg() for item in items]
        result = call(self._set, SetParametersAtomically.Request(parameters=parameters)).result
        if not result.successful:
            raise RequestRejected(f'{self._set.srv_name} rejects {values}: {result.reason}')


def call(client: Client, request: object) -> Any:
    """Call a service and wait for the answer; raise RequestRejected if it does not come."""
    response: Any = None
    if client.wait_for_service(_ANSWER_TIMEOUT):
        with contextlib.suppress(TimeoutError):  # of later versions than Jazzy
            response = client.call(request, _ANSWER_TIMEOUT)
    if response is None:
        raise RequestRejected(f'{client.srv_name} does not answer')
    return response
