# SPDX-License-Identifier: Apache-2.0
"""
Nodes in this process, without launch: `ros` makes them, and they do nothing unless it spins.

Every test has a context of its own, every test process a domain of its own, and nothing leaves
the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import fcntl
import os
from pathlib import Path
import subprocess
import tempfile
import threading
import time
from typing import Any, TypeVar
import warnings

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

with warnings.catch_warnings():
    warnings.simplefilter('ignore', DeprecationWarning)
    import lark  # noqa: F401  rclpy imports it with the first node, and it imports what is obsolete

TIMEOUT = 20.0
"""Longest wait for anything; reached only when something is wrong. [s]"""

PATIENCE = 60.0
"""Longest wait for another process, compilation included. [s]"""

AnyNode = TypeVar('AnyNode', bound=Node)


class Ros:
    """
    A context, an executor that moves when told to, and the nodes made with them.

    Attributes
    ----------
    domain_id : int
        Of the context, and of child processes, which find it in their environment.
    context : Context
        Private to the test.

    """

    def __init__(self, domain_id: int) -> None:
        self.domain_id = domain_id
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain_id)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._nodes: list[Node] = []

    def node(
        self,
        make: Callable[..., AnyNode],
        *args: Any,
        ros_args: tuple[str, ...] = (),
        **kwargs: Any,
    ) -> AnyNode:
        """Make a node with `make(*args, context=..., ...)`; `ros_args` follow `--ros-args`."""
        kwargs.setdefault('cli_args', ['--ros-args', *ros_args])
        node = make(*args, context=self.context, use_global_arguments=False, **kwargs)
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def spin_until(self, done: Callable[[], bool], what: str = 'the condition') -> None:
        """Move until `done()`, or fail after `TIMEOUT`."""
        deadline = time.monotonic() + TIMEOUT
        while not done():
            if time.monotonic() > deadline:
                pytest.fail(f'{what} did not come within {TIMEOUT:g} s')
            self._executor.spin_once(timeout_sec=0.05)

    def result(self, future: Future) -> Any:
        """Move until `future` is done, and return its result."""
        self.spin_until(future.done, 'the answer')
        return future.result()

    def call(self, client: Any, request: Any) -> Any:
        """Call a service through `client` once it is there, and return the response."""
        self.spin_until(client.service_is_ready, client.srv_name)
        return self.result(client.call_async(request))

    def parameters(self, node: Node) -> Parameters:
        """Make a client for the parameter services of `node`."""
        return Parameters(self, node)

    def close(self) -> None:
        """Destroy the nodes, last made first, and the context."""
        for node in reversed(self._nodes):
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown(timeout_sec=TIMEOUT)
        rclpy.try_shutdown(context=self.context)


class Parameters:
    """The parameters of a node, set and read through its services from another node."""

    def __init__(self, ros: Ros, node: Node) -> None:
        self._ros = ros
        asking = ros.node(Node, 'asking')
        self._client = AsyncParameterClient(asking, node.get_fully_qualified_name())
        ros.spin_until(self._client.services_are_ready, 'parameter services')

    def get(self, name: str) -> Any:
        """Return the value of one parameter."""
        (value,) = self._ros.result(self._client.get_parameters([name])).values
        return rclpy.parameter.parameter_value_to_python(value)

    def describe(self, name: str) -> Any:
        """Return the descriptor of one parameter."""
        (descriptor,) = self._ros.result(self._client.describe_parameters([name])).descriptors
        return descriptor

    def set(self, **values: Any) -> list[str]:
        """Set one by one (`a__b` is a.b); return the reasons, empty where accepted."""
        response = self._ros.result(self._client.set_parameters(_parameters(values)))
        return [_reason(result) for result in response.results]

    def set_atomically(self, **values: Any) -> str:
        """Set all at once; return the reason, empty if accepted."""
        future = self._client.set_parameters_atomically(_parameters(values))
        return _reason(self._ros.result(future).result)


def _parameters(values: dict[str, Any]) -> list[Parameter]:
    return [Parameter(name.replace('__', '.'), value=value) for name, value in values.items()]


def _reason(result: Any) -> str:
    assert result.successful == (not result.reason)
    return str(result.reason)


@pytest.fixture(scope='session')
def domain_id() -> Iterator[int]:
    """Hold a ROS domain that no other test process holds, and give it to child processes too."""
    folder = Path(tempfile.gettempdir()) / f'soft_throw_ros_domains_{os.getuid()}'
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for domain in range(1, 102):  # beyond, ports may be in use for outgoing connections
            with (folder / str(domain)).open('w') as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                patch.setenv('ROS_DOMAIN_ID', str(domain))
                patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
                yield domain
                return
    raise RuntimeError('all 101 ROS domains are held by other test processes')


@pytest.fixture
def ros(domain_id: int) -> Iterator[Ros]:
    """Give a test its nodes, and take them away again."""
    ros = Ros(domain_id)
    yield ros
    ros.close()


class Process:
    """A process, and what it has written."""

    def __init__(self, command: list[str], **kwargs: Any) -> None:
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **kwargs
        )
        self.lines: list[str] = []
        self._said = threading.Condition()
        self._is_over = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def wait_for(self, text: str) -> None:
        """Wait until it has written a line with `text`."""
        with self._said:
            self._said.wait_for(lambda: self._is_over or self._has(text), PATIENCE)
        assert self._has(text), '\n'.join(self.lines)

    def end(self, number: int) -> int:
        """Send a signal, and return the exit code."""
        self.process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        """Wait for its end, and return the exit code."""
        code = self.process.wait(PATIENCE)
        self._thread.join(PATIENCE)
        return code

    def close(self) -> None:
        self.process.kill()
        self.process.wait(PATIENCE)
        self._thread.join(PATIENCE)
        assert self.process.stdout is not None
        self.process.stdout.close()

    def _has(self, text: str) -> bool:
        return any(text in line for line in self.lines)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._said:
                self.lines.append(line.rstrip())
                self._said.notify_all()
        with self._said:
            self._is_over = True
            self._said.notify_all()


@pytest.fixture
def start(domain_id: int) -> Iterator[Callable[..., Process]]:
    """Start processes, and end them in any case."""
    started: list[Process] = []

    def start(*command: str, **kwargs: Any) -> Process:
        started.append(Process(list(command), **kwargs))
        return started[-1]

    yield start
    for process in started:
        process.close()
