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
Nodes in this process, without launch: `ros` makes them, and they do nothing unless it spins.

Every test has a context of its own, every test process a domain of its own, and nothing leaves
the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import fcntl
import os
from pathlib import Path
import re
import subprocess
import tempfile
import threading
import time
import traceback
from typing import Any, TypeVar
import warnings

import pytest
from rcl_interfaces.msg import Log
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.task import Future
from soft_throw_ros.configuration.interface import resolve, Service, Topic
from soft_throw_ros.nodes.realtime import SystemClock
from soft_throw_ros.nodes.topics import create_subscription
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.twin.kernels import load_kernels
from soft_throw_ros.twin.results import Outputs, ThrowResult
from std_srvs.srv import Trigger

with warnings.catch_warnings():
    warnings.simplefilter('ignore', DeprecationWarning)
    import lark  # noqa: F401  rclpy imports it with the first node, and it what is obsolete

TIMEOUT = 20.0
"""Longest wait for anything; reached only when something is wrong. [s]"""

PROCESS_TIMEOUT = 60.0
"""Longest wait for another process, compilation included. [s]"""

OF_FAST_DDS = re.compile(r'[0-9-]+ [0-9:.]+ \[[A-Z_]+ (Error|Warning)\]')
"""
What Fast DDS writes on its own, whatever the log level of ROS.

It does so when two processes make their transports at the same moment: one cannot lock a port of
shared memory ("open_and_lock_file failed"), and takes the next.
"""

COLOURS = re.compile(r'\x1b\[[0-9;]*m')

SECOND = 1_000_000_000
MILLISECOND = SECOND // 1000

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
        self.nodes: list[Node] = []

    def node(
        self,
        make: Callable[..., AnyNode],
        *args: Any,
        ros_args: tuple[str, ...] = (),
        **kwargs: Any,
    ) -> AnyNode:
        """Make a node with `make(*args, context=..., ...)`; `ros_args` follow `--ros-args`."""
        kwargs.setdefault('cli_args', ['--ros-args', *ros_args])
        try:
            node = make(*args, context=self.context, use_global_arguments=False, **kwargs)
        except Exception as error:
            _destroy_unfinished(error)
            raise
        self.nodes.append(node)
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

    def remove(self, node: Node) -> None:
        """Destroy a node."""
        self.nodes.remove(node)
        self._executor.remove_node(node)
        node.destroy_node()

    def close(self) -> None:
        """Destroy the nodes, last made first, and the context."""
        for node in reversed(self.nodes):
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown(timeout_sec=TIMEOUT)
        rclpy.try_shutdown(context=self.context)


def _destroy_unfinished(error: BaseException) -> None:
    """
    Destroy a node whose making has failed.

    Else that happens when it is collected as garbage, at any time, and two participants of one
    process that are destroyed and discovered at the same time can block each other for ever.
    """
    for frame, _ in traceback.walk_tb(error.__traceback__):
        node = frame.f_locals.get('self')
        if isinstance(node, Node):
            try:
                node.destroy_node()
            except AttributeError:  # rclpy's own part is not finished either
                handle = getattr(node, '_Node__node', None)
                if handle is not None:
                    handle.destroy_when_not_in_use()
            return


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

    def set(self, **values: Any) -> list[str]:  # noqa: A003
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


class GivenClock(SystemClock):
    """A clock that shows what it is told to."""

    def __init__(self, now: int = SECOND, max_catch_up: int = 1000 * SECOND) -> None:
        self.epoch = 0
        self.time = now
        self.max_catch_up = max_catch_up

    def adjust(self) -> None:
        """Nothing is done to the time of day."""

    def now(self) -> int:
        return self.time

    def wait_until(self, deadline: int) -> None:
        self.time = max(self.time, deadline)


class DrivenTwin(Twin):
    """A twin that goes where the test sends it, and remembers what came out."""

    def __init__(self, **kwargs: Any) -> None:
        self.clock = GivenClock()
        self.outputs: list[Outputs] = []
        self.lines: list[str] = []
        super().__init__(system_clock=self.clock, **kwargs)
        self.ticker.run_due()  # the first step

    def on_step(self, outputs: Outputs, due: int) -> None:
        self.outputs.append(outputs)
        super().on_step(outputs, due)

    def on_entry(self, line: str) -> None:
        self.lines.append(line)
        super().on_entry(line)

    def go(self, milliseconds: int) -> None:
        """Let so much time pass, in moments of 10 ms."""
        end = self.clock.time + milliseconds * MILLISECOND
        while self.clock.time < end:
            self.clock.time = min(end, self.clock.time + 10 * MILLISECOND)
            self.ticker.run_due()

    @property
    def results(self) -> list[ThrowResult]:
        return [result for outputs in self.outputs for result in outputs.results]


class Listener(Node):
    """Somebody who listens to a twin, and asks it for something."""

    def __init__(self, ros: Ros, name: str, **kwargs: Any) -> None:
        super().__init__('listener', **kwargs)
        self._ros = ros
        self._name = name
        self.heard: dict[str, list[Any]] = {}

    def listen(self, *listed: Topic) -> None:
        """Take topics, and wait until they are connected."""
        for topic in listed:
            named = topic.at(self._name)
            create_subscription(self, named, self.heard.setdefault(topic.name, []).append)
            self._ros.spin_until(lambda name=named.name: self.count_publishers(name) > 0, 'it')
            self._ros.spin_until(self._is_matched(named.name), named.name)

    def hear(self, topic: Topic, count: int = 1) -> list[Any]:
        """Wait for so many messages in all."""
        heard = self.heard[topic.name]
        self._ros.spin_until(lambda: len(heard) >= count, f'{count} messages on {topic.name}')
        return heard

    def status(self, topic: Topic, task: str, done: Any = lambda _status: True) -> Any:
        """Wait for a status of a task that is as wanted, and return the last such."""
        found: list[Any] = []

        def is_there() -> bool:
            statuses = [item for message in self.heard[topic.name] for item in message.status]
            found[:] = [s for s in statuses if s.name == f'{self._name}: {task}' and done(s)]
            return bool(found)

        self._ros.spin_until(is_there, task)
        return found[-1]

    def trigger(self, service: Service) -> Trigger.Response:
        """Call a service of the twin."""
        client = self.create_client(Trigger, resolve(service.name, self._name))
        return self._ros.call(client, Trigger.Request())

    def log(self) -> list[str]:
        """Listen to the log from now on."""
        lines: list[str] = []
        qos = QoSProfile(depth=1000)
        self.create_subscription(Log, '/rosout', lambda message: lines.append(message.msg), qos)
        self._ros.spin_until(lambda: self.count_publishers('/rosout') > 1, '/rosout')
        return lines

    def _is_matched(self, topic: str) -> Callable[[], bool]:
        """Return what tells whether every publisher in this process knows of a subscription."""
        publishers = [
            publisher
            for node in self._ros.nodes
            for publisher in node.publishers
            if publisher.topic_name == topic
        ]
        return lambda: all(publisher.get_subscription_count() > 0 for publisher in publishers)


@pytest.fixture(scope='session', autouse=True)
def _kernels() -> None:
    """Compile all kernels before, so that no node has to, nor has it done beside it."""
    load_kernels()


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


@pytest.fixture
def given_clock() -> type[GivenClock]:
    """Give the class of clocks that show what they are told to."""
    return GivenClock


@pytest.fixture
def start_twin(ros: Ros) -> Callable[..., DrivenTwin]:
    """Start twins with ROS arguments."""
    return lambda *ros_args: ros.node(DrivenTwin, ros_args=ros_args)


@pytest.fixture
def twin(start_twin: Any) -> DrivenTwin:
    """Start a twin that throws only when asked."""
    twin: DrivenTwin = start_twin('-p', 'throw.period:=0.0')
    return twin


@pytest.fixture
def listen_to(ros: Ros) -> Callable[[Node], Listener]:
    """Make a listener of a twin, which may be in another process."""
    return lambda twin=None: ros.node(
        Listener, ros, twin.get_fully_qualified_name() if twin is not None else '/twin'
    )


@pytest.fixture
def listener(listen_to: Any, twin: DrivenTwin) -> Listener:
    return listen_to(twin)  # type: ignore[no-any-return]


class Process:
    """A process, and what it has written; what Fast DDS wrote is left out."""

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
        self.wait_until(lambda lines: any(text in line for line in lines))

    def wait_until(self, is_enough: Callable[[list[str]], bool]) -> None:
        """Wait until the lines that it has written are enough."""
        with self._said:
            self._said.wait_for(lambda: self._is_over or is_enough(self.lines), PROCESS_TIMEOUT)
        assert is_enough(self.lines), '\n'.join(self.lines)

    def end(self, number: int) -> int:
        """Send a signal, and return the exit code."""
        self.process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        """Wait for its end, and return the exit code."""
        code = self.process.wait(PROCESS_TIMEOUT)
        self._thread.join(PROCESS_TIMEOUT)
        return code

    def close(self) -> None:
        self.process.kill()
        self.process.wait(PROCESS_TIMEOUT)
        self._thread.join(PROCESS_TIMEOUT)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if OF_FAST_DDS.match(COLOURS.sub('', line)):
                continue
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
