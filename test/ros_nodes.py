# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Nodes in this process, without launch: `ros` creates them, and runs their callbacks on request.

Every test has its own context, every test process its own domain, and no message leaves the
machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import contextlib
from dataclasses import replace
import fcntl
import itertools
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from typing import Any, TypeVar
import warnings

from bags import channel, wait_until
import pytest
from rcl_interfaces.msg import Log
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rclpy.task import Future
from sensor_msgs.msg import JointState
from soft_throw_ros.commands.warm_up import load_kernels
from soft_throw_ros.configuration.interface import (
    FRAME,
    JOINTS,
    resolve,
    Service,
    Topic,
    TWIN_TOPICS,
)
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.nodes.realtime import SystemClock
from soft_throw_ros.nodes.recommendations import RecommendationState
from soft_throw_ros.nodes.topics import create_subscription
from soft_throw_ros.nodes.transport import use_transport_profile
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.recording.child_process import bound_to_parent
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Message, SECOND
from soft_throw_ros.twin.results import Outputs, ThrowResult
from std_srvs.srv import Trigger
from twin_runs import Sample

with warnings.catch_warnings():
    warnings.simplefilter('ignore', DeprecationWarning)
    import lark  # noqa: F401  rclpy imports lark with the first node, and lark obsolete modules

_KEPT = 100  # messages that a listener keeps at least, since it does not spin while a twin runs

TIMEOUT = 60.0
"""Longest wait for anything; a busy machine must not reach it. [s]"""

PROCESS_TIMEOUT = 110.0
"""Longest wait for another process, including compilation. [s]"""

# Prefix of messages such as of a port in use, which Fast DDS prints at every log level
_OF_FAST_DDS = re.compile(r'[0-9-]+ [0-9:.]+ \[[A-Z_]+ (Error|Warning)\]')

_FUTEX = '202'  # number of the system call on x86-64
_WAITING = {0, 9}  # its operations that wait, FUTEX_WAIT and FUTEX_WAIT_BITSET

MILLISECOND = SECOND // 1000

AnyNode = TypeVar('AnyNode', bound=Node)


class Ros:
    """A private context, an executor that runs only on request, and their nodes."""

    def __init__(self, domain_id: int) -> None:
        self.domain_id = domain_id  # of child processes, too, by an environment variable
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain_id)
        self._executor = SingleThreadedExecutor(context=self.context)
        self.nodes: list[Node] = []

    def node(
        self,
        make: Callable[..., AnyNode],
        *args: Any,
        ros_args: Iterable[str] = (),
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

    def spin_until(self, done: Callable[[], bool], event: str = 'the condition') -> None:
        """Run the executor until `done()`; after `TIMEOUT` fail, and name the awaited event."""
        deadline = time.monotonic() + TIMEOUT
        while not done():
            if time.monotonic() > deadline:
                pytest.fail(f'timeout after {TIMEOUT:g} s, waiting for {event}')
            self._executor.spin_once(timeout_sec=0.05)

    def result(self, future: Future) -> Any:
        """Run the executor until `future` is done, and return its result."""
        self.spin_until(future.done, 'the response')
        return future.result()

    def call(self, client: Any, request: Any) -> Any:
        """Wait until the service of `client` is ready, call it, and return the response."""
        self.spin_until(client.service_is_ready, client.srv_name)
        return self.result(client.call_async(request))

    def start_twin(self, *ros_args: str, **values: Any) -> DrivenTwin:
        """Start a twin on a clock set by the test with parameters, `a__b` for a.b."""
        return self.node(DrivenTwin, ros_args=(*ros_args, *rules(**values)))

    def sensors_of(self, twin: DrivenTwin | None = None) -> Sensors:
        """Make the sensors of a twin, or of none that takes the samples."""
        return self.node(Sensors, self, twin)

    def listen_to(self, node: Node | str) -> Listener:
        """Make a listener of a node, which is named if it is in another process."""
        name = node if isinstance(node, str) else node.get_fully_qualified_name()
        return self.node(Listener, self, name)

    def close(self) -> None:
        """Destroy the nodes in reverse order of their creation, and the context."""
        for node in reversed(self.nodes):
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown(timeout_sec=TIMEOUT)
        rclpy.try_shutdown(context=self.context)


def rules(**values: Any) -> list[str]:
    """Return ROS arguments that set parameters, `a__b` for a.b."""
    each = (f'{name.replace("__", ".")}:={value}' for name, value in values.items())
    return [word for rule in each for word in ('-p', rule)]


def _destroy_unfinished(error: BaseException) -> None:
    """
    Destroy a node whose construction has failed.

    Otherwise the garbage collector destroys the node at an arbitrary time. Destroying and
    discovering two participants of one process at the same time can block both for ever.
    """
    for frame, _ in traceback.walk_tb(error.__traceback__):
        node = frame.f_locals.get('self')
        if isinstance(node, Node):
            try:
                node.destroy_node()
            except AttributeError:  # rclpy's constructor has failed, too
                handle = getattr(node, '_Node__node', None)
                if handle is not None:
                    handle.destroy_when_not_in_use()
            return


class GivenClock(SystemClock):
    """A clock whose time the test sets."""

    def __init__(self, now: int = SECOND, max_catch_up: int = 1000 * SECOND) -> None:
        self.epoch = 0
        self.time = now
        self.max_catch_up = max_catch_up

    def adjust(self) -> None:
        """Leave the time of day unadjusted."""

    def now(self) -> int:
        return self.time


class DrivenTwin(Twin):
    """
    A twin on a clock set by the test.

    `outputs` are those of all steps, and `messages` what a recorder would have received, each a
    nanosecond later than the one before.
    """

    def __init__(self, *, clock: GivenClock | None = None, **kwargs: Any) -> None:
        self.clock = clock or GivenClock()
        self.outputs: list[Outputs] = []
        self.messages: list[Message] = []
        self._advised: TwinConfig | None = None  # with its uncertainty
        super().__init__(system_clock=self.clock, **kwargs)
        self.ticker.run_due()  # the first step

    def create_publisher(self, kind: Any, topic: str, *args: Any, **kwargs: Any) -> Publisher:
        publisher = super().create_publisher(kind, topic, *args, **kwargs)
        return publisher if topic == '/parameter_events' else self.keep(publisher)

    def keep(self, publisher: Publisher) -> Publisher:
        """Keep all that a publisher of this or another node publishes."""
        kind, publish, numbers = publisher.msg_type, publisher.publish, itertools.count(1)
        kept = channel(
            publisher.topic_name, f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'
        )

        def keep_and_publish(message: Any) -> None:
            data = message if isinstance(message, bytes) else serialize_message(message)
            time = self.clock.time + len(self.messages)
            self.messages.append(Message(kept, data, time, time, next(numbers)))
            publish(message)

        publisher.publish = keep_and_publish
        return publisher

    def of(self, topic: Topic) -> list[Message]:
        """Return the messages of a topic."""
        name = topic.at(self.get_fully_qualified_name()).name
        return [message for message in self.messages if message.channel.topic == name]

    def on_step(self, outputs: Outputs, due: int) -> None:
        self.outputs.append(outputs)
        super().on_step(outputs, due)

    def advance(self, time_ns: int) -> None:
        """Advance the clock, and run the due ticks and the jobs of the executor."""
        self.clock.time += time_ns
        self.ticker.run_due()
        self._run_jobs()

    def go(self, milliseconds: int) -> DrivenTwin:
        """Advance in steps of a millisecond."""
        for _ in range(milliseconds):
            self.advance(MILLISECOND)
        return self

    def change(self, **request: Any) -> None:
        """Change parameters together (`a__b` is a.b)."""
        self.parameters.apply({name.replace('__', '.'): value for name, value in request.items()})

    def settle(self) -> RecommendationState:
        """Wait until the recommendation is for the present settings, and return it."""
        wait_until(self._is_settled, TIMEOUT)
        assert self.recommendation is not None
        return self.recommendation

    def _is_settled(self) -> bool:
        self._run_jobs()
        state = self.recommendation
        is_present = state is not None and state.is_for(self.parameters.settings)
        return is_present and state.config is self._advised

    def _recommend(self, config: TwinConfig, cancelled: Callable[[], bool]) -> None:
        super()._recommend(config, cancelled)
        self._advised = config

    def finish(self) -> None:
        """End the session, and publish the last lines of its journal."""
        self.session.close()
        self._run_jobs()

    @property
    def results(self) -> list[ThrowResult]:
        return [result for outputs in self.outputs for result in outputs.results]


class Listener(Node):
    """A node that subscribes to topics of a twin and calls its services."""

    def __init__(self, ros: Ros, name: str, **kwargs: Any) -> None:
        super().__init__('listener', **kwargs)
        self._ros = ros
        self._name = name
        self.heard: dict[str, list[Any]] = {}

    def listen(self, *listed: Topic) -> None:
        """Subscribe to topics and wait until they are connected."""
        for topic in listed:
            named = topic.at(self._name)
            kept = replace(named, depth=max(named.depth, _KEPT))
            create_subscription(self, kept, self.heard.setdefault(topic.name, []).append)
            self._ros.spin_until(
                lambda name=named.name: self._is_matched(name), f'connection to {named.name}'
            )

    def hear(self, topic: Topic, count: int = 1) -> list[Any]:
        """Wait until `count` messages have been received in total, and return all."""
        heard = self.heard[topic.name]
        self._ros.spin_until(lambda: len(heard) >= count, f'{count} messages on {topic.name}')
        return heard

    def statuses(self, topic: Topic, task: str) -> list[Any]:
        """Return the statuses of a task so far."""
        statuses = [item for message in self.heard[topic.name] for item in message.status]
        return [status for status in statuses if status.name == f'{self._name}: {task}']

    def status(self, topic: Topic, task: str, done: Any = lambda _status: True) -> Any:
        """Wait for a status of a task that meets a condition, and return the latest."""
        self._ros.spin_until(lambda: any(map(done, self.statuses(topic, task))), task)
        return list(filter(done, self.statuses(topic, task)))[-1]

    def trigger(self, service: Service) -> Trigger.Response:
        """Call a service of the twin."""
        client = self.create_client(Trigger, resolve(service.name, self._name))
        return self._ros.call(client, Trigger.Request())

    def log(self) -> list[str]:
        """Listen to the log; latched lines arrive although a publisher is discovered late."""
        lines: list[str] = []
        qos = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(Log, '/rosout', lambda message: lines.append(message.msg), qos)
        return lines

    def _is_matched(self, topic: str) -> bool:
        """Return whether all publishers in this process have matched the subscription."""
        return self.count_publishers(topic) > 0 and all(
            publisher.get_subscription_count() > 0
            for node in self._ros.nodes
            for publisher in node.publishers
            if publisher.topic_name == topic
        )


class Sensors(Node):
    """Sensors of a rig, which wait until a twin in this process has received their samples."""

    def __init__(self, ros: Ros, twin: DrivenTwin | None = None, **kwargs: Any) -> None:
        super().__init__('sensors', **kwargs)
        self._ros = ros
        self._twin = twin
        self._sent = 0
        name = TWIN_TOPICS.measured_joint_states.at('/twin').name
        self.publisher = self.create_publisher(JointState, name, QoSProfile(depth=1000))
        if twin is not None:
            twin.keep(self.publisher)
        ros.spin_until(lambda: self.publisher.get_subscription_count() > 0, 'the twin')

    def send(self, sample: Sample, names: tuple[str, ...] = JOINTS) -> None:
        """Publish a sample as the heights of two joints."""
        encoder = JointStateEncoder(FRAME, names, series=1)
        self.publish(encoder.encode(sample.stamp_ns, (sample.plate, sample.projectile)))

    def publish(self, message: JointState | bytes) -> None:
        """Publish a message."""
        self.publisher.publish(message)
        self._sent += 1

    def wait(self) -> None:
        """Wait until the twin has taken all that was sent."""
        twin = self._twin
        assert twin is not None

        def is_taken() -> bool:
            twin.measurement.read_messages()
            counts = twin.session.sample_counts
            return counts.taken + sum(counts.refused.values()) >= self._sent

        self._ros.spin_until(is_taken, 'receipt of all samples')

    def throw(
        self, samples: Iterable[Sample], *, behind_ns: int = 0, step_ns: int = 10 * MILLISECOND
    ) -> None:
        """Send samples as the clock advances in steps, stamped by a clock that is behind."""
        waiting, twin = list(samples), self._twin
        assert twin is not None
        while waiting:
            until = twin.clock.time + step_ns
            count = sum(sample.stamp_ns <= until for sample in waiting)
            for sample in waiting[:count]:
                self.send(sample._replace(stamp_ns=sample.stamp_ns - behind_ns))
            del waiting[:count]
            self.wait()
            twin.advance(step_ns)


@pytest.fixture(scope='session')
def domain_id() -> Iterator[int]:
    """
    Lock a ROS domain that no other test process uses; child processes inherit the domain.

    All kernels are compiled before, so that no node compiles during a test.
    """
    load_kernels()
    folder = Path(tempfile.gettempdir()) / f'soft_throw_ros_domains_{os.getuid()}'
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for domain in range(1, 102):  # ports of higher domains may be used for other connections
            with (folder / str(domain)).open('w') as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue
                patch.setenv('ROS_DOMAIN_ID', str(domain))
                patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
                use_transport_profile()
                yield domain
                return
    raise RuntimeError('all 101 ROS domains are in use by other test processes')


def _make_ros(domain_id: int) -> Iterator[Ros]:
    """Yield nodes and destroy them at the end."""
    ros = Ros(domain_id)
    yield ros
    ros.close()


ros = pytest.fixture(_make_ros, name='ros')
module_ros = pytest.fixture(_make_ros, name='module_ros', scope='module')


@pytest.fixture
def twin(ros: Ros) -> DrivenTwin:
    """Start a twin that throws only on request."""
    return ros.start_twin(throw__period=0.0)


@pytest.fixture
def listener(ros: Ros, twin: DrivenTwin) -> Listener:
    return ros.listen_to(twin)


@pytest.fixture
def talker(ros: Ros) -> Node:
    """Return a node for publishers of the test."""
    return ros.node(Node, 'talker')


class Process:
    """
    A process and its output, without the messages of Fast DDS.

    The process ends with the tests, also if they are killed.
    """

    def __init__(self, command: list[str], **kwargs: Any) -> None:
        self.process = subprocess.Popen(
            bound_to_parent(command),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            **kwargs,
        )
        self.lines: list[str] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def wait_for(self, text: str, timeout: float = PROCESS_TIMEOUT) -> None:
        """Wait until the process has written a line that contains `text`."""
        deadline = time.monotonic() + timeout
        while not any(text in line for line in list(self.lines)):
            is_late = time.monotonic() > deadline or not self._thread.is_alive()
            assert not is_late or text in ''.join(self.lines), '\n'.join(self.lines)
            time.sleep(0.02)

    def end(self, number: int) -> int:
        """Send a signal, and return the exit code."""
        self.process.send_signal(number)
        return self.wait()

    def end_well(self, number: int = signal.SIGINT, code: int = 0) -> None:
        """Send a signal, and check the exit code and that there is no traceback."""
        assert self.end(number) == code, self.lines
        assert not any('Traceback' in line for line in self.lines), self.lines

    def wait(self) -> int:
        """Wait for the end of the process, and return the exit code."""
        code = self.process.wait(PROCESS_TIMEOUT)
        self._thread.join(PROCESS_TIMEOUT)
        return code

    def close(self) -> None:
        self.process.kill()
        self.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if not _OF_FAST_DDS.match(re.sub(r'\x1b\[[0-9;]*m', '', line)):
                self.lines.append(line.rstrip())


@pytest.fixture
def start(domain_id: int) -> Iterator[Callable[..., Process]]:
    """Start processes, and kill them after the test."""
    with contextlib.ExitStack() as started:
        yield lambda *command, **kwargs: started.enter_context(
            contextlib.closing(Process(list(command), **kwargs))
        )


@pytest.fixture
def start_node(start: Callable[..., Process]) -> Callable[..., Process]:
    """Return a function that starts a node with rules for parameters as a process."""

    def start_node(name: str, *rules: str, **kwargs: Any) -> Process:
        words = [word for rule in rules for word in ('-p', rule)]
        return start(sys.executable, '-m', 'soft_throw_ros', name, '--ros-args', *words, **kwargs)

    return start_node


@pytest.fixture
def record(start_node: Callable[..., Process], tmp_path: Path) -> Callable[..., Process]:
    """Return a function that starts a recorder of a bag in the temporary folder of the test."""

    def record(name: str, *rules: str, **kwargs: Any) -> Process:
        rules = (f'folder:={tmp_path}', f'name:={name}', *rules)
        recorder = start_node('recorder', *rules, **kwargs)
        recorder.wait_for('ready')
        return recorder

    return record


def _is_stopped_waiting(task: Path) -> bool:
    """Wait until a thread is stopped, and return whether it was in a system call that waits."""
    while not (task / 'stat').read_text().rpartition(') ')[2].startswith('T'):
        time.sleep(1e-4)
    call, *arguments = (task / 'syscall').read_text().split()
    if call == _FUTEX:
        return int(arguments[1], 16) & 0x7F in _WAITING
    return call != '-1'


@pytest.fixture
def stop() -> Callable[[int], None]:
    """
    Return a function that stops a process while all of its threads wait in a system call.

    A process that is stopped or killed while it takes a message from shared memory keeps the lock
    of its queue: Fast DDS then blocks all senders for up to ten seconds, and drops their messages
    (docs/record.md). A test of anything else must not meet this case by chance.
    """

    def stop(pid: int) -> None:
        deadline = time.monotonic() + TIMEOUT
        tasks = Path(f'/proc/{pid}/task')
        os.kill(pid, signal.SIGSTOP)
        while not all(_is_stopped_waiting(task) for task in tasks.iterdir()):
            assert time.monotonic() < deadline, f'process {pid} never waits'
            os.kill(pid, signal.SIGCONT)
            time.sleep(1e-3)
            os.kill(pid, signal.SIGSTOP)

    return stop
