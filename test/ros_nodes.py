# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes without launch: `ros` makes them, each test in a context, each process in a domain."""

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
from typing import Any
import warnings

from bags import channel, wait_until
import pytest
from rcl_interfaces.msg import Log
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from soft_throw_ros.commands.warm_up import load_kernels
from soft_throw_ros.configuration.interface import JOINTS, resolve, Service, Topic, TWIN_TOPICS
from soft_throw_ros.nodes.process import use_transport_profile
from soft_throw_ros.nodes.realtime import SystemClock
from soft_throw_ros.nodes.recommendations import RecommendationState
from soft_throw_ros.nodes.topics import create_subscription
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

TIMEOUT = 60.0  # longest wait for anything, which a busy machine must not reach [s]
PROCESS_TIMEOUT = 110.0  # longest wait for another process, including compilation [s]
_KEPT = 100  # messages that a listener keeps at least, since it does not spin while a twin runs
# Prefix of messages such as of a port in use, which Fast DDS prints at every log level
_OF_FAST_DDS = re.compile(r'[0-9-]+ [0-9:.]+ \[[A-Z_]+ (Error|Warning)\]')
_FUTEX = '202'  # number of the system call on x86-64
_WAITING = {0, 9}  # its operations that wait, FUTEX_WAIT and FUTEX_WAIT_BITSET
MILLISECOND = SECOND // 1000


class Ros:
    """A private context, an executor that runs only on request, and their nodes."""

    def __init__(self, domain_id: int) -> None:
        self.domain_id = domain_id  # of child processes, too, by an environment variable
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain_id)
        self._executor = SingleThreadedExecutor(context=self.context)
        self.nodes: list[Node] = []

    def node(
        self, make: Callable[..., Any], *args: Any, ros_args: Iterable[str] = (), **kwargs: Any
    ) -> Any:
        """Make a node with `make(*args, context=..., ...)`; `ros_args` follow `--ros-args`."""
        kwargs.setdefault('cli_args', ['--ros-args', *ros_args])
        try:
            node = make(*args, context=self.context, use_global_arguments=False, **kwargs)
        except Exception as error:
            frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
            selves = (frame.f_locals.get('self') for frame in frames)
            # the garbage collector might do so during a discovery, which can block for ever
            next(item for item in selves if isinstance(item, Node)).destroy_node()
            raise
        self.nodes.append(node)
        self._executor.add_node(node)
        return node

    def spin_until(self, done: Callable[[], bool], event: str) -> None:
        """Run the executor until `done()`; after `TIMEOUT` fail, and name the awaited event."""
        deadline = time.monotonic() + TIMEOUT
        while not done():
            if time.monotonic() > deadline:
                pytest.fail(f'timeout after {TIMEOUT:g} s, waiting for {event}')
            self._executor.spin_once(timeout_sec=0.05)

    def result(self, future: Any) -> Any:
        self.spin_until(future.done, 'the response')
        return future.result()

    def call(self, client: Any, request: Any) -> Any:
        self.spin_until(client.service_is_ready, client.srv_name)
        return self.result(client.call_async(request))

    def start_twin(self, *ros_args: str, **values: Any) -> DrivenTwin:
        return self.node(DrivenTwin, ros_args=(*ros_args, *rules(**values)))

    def sensors_of(self, twin: DrivenTwin | None = None) -> Sensors:
        return self.node(Sensors, self, twin)

    def listen_to(self, node: Node | str) -> Listener:
        name = node if isinstance(node, str) else node.get_fully_qualified_name()
        return self.node(Listener, self, name)

    def close(self) -> None:
        for node in reversed(self.nodes):
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown(timeout_sec=TIMEOUT)
        rclpy.try_shutdown(context=self.context)


def rules(**values: Any) -> list[str]:
    """Return ROS arguments that set parameters, `a__b` for a.b."""
    each = (f'{name.replace("__", ".")}:={value}' for name, value in values.items())
    return [word for rule in each for word in ('-p', rule)]


class GivenClock(SystemClock):
    """A clock whose time the test sets."""

    def __init__(self, now: int = SECOND, max_catch_up: int = 1000 * SECOND) -> None:
        self.epoch, self.time, self.max_catch_up = 0, now, max_catch_up

    def adjust(self) -> None:
        pass

    def now(self) -> int:
        return self.time


class DrivenTwin(Twin):
    """A twin on a clock set by the test, and `messages` as a recorder would receive them."""

    def __init__(self, *, clock: GivenClock | None = None, **kwargs: Any) -> None:
        self.clock = clock or GivenClock()
        self.outputs: list[Outputs] = []
        self.messages: list[Message] = []
        super().__init__(system_clock=self.clock, **kwargs)
        self.ticker.run_due()  # the first step

    def create_publisher(self, kind: Any, topic: str, *args: Any, **kwargs: Any) -> Any:
        publisher = super().create_publisher(kind, topic, *args, **kwargs)
        return publisher if topic == '/parameter_events' else self.keep(publisher)

    def keep(self, publisher: Any) -> Any:
        """Keep the messages of a publisher, each a nanosecond later than the one before."""
        kind, publish, numbers = publisher.msg_type, publisher.publish, itertools.count(1)
        type_name = f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'
        kept = channel(publisher.topic_name, type_name)

        def keep_and_publish(message: Any) -> None:
            data = message if isinstance(message, bytes) else serialize_message(message)
            time = self.clock.time + len(self.messages)
            self.messages.append(Message(kept, data, time, time, next(numbers)))
            publish(message)

        publisher.publish = keep_and_publish
        return publisher

    def of(self, topic: Topic) -> list[Message]:
        name = topic.at(self.get_fully_qualified_name()).name
        return [message for message in self.messages if message.channel.topic == name]

    def on_step(self, outputs: Outputs, due: int) -> None:
        self.outputs.append(outputs)
        super().on_step(outputs, due)

    def advance(self, time_ns: int) -> None:
        self.clock.time += time_ns
        self.ticker.run_due()
        self._run_jobs()

    def go(self, milliseconds: int) -> DrivenTwin:
        for _ in range(milliseconds):
            self.advance(MILLISECOND)
        return self

    def change(self, **request: Any) -> None:
        """Change parameters together (`a__b` is a.b)."""
        self.parameters.apply({name.replace('__', '.'): value for name, value in request.items()})

    def settle(self) -> RecommendationState:
        """Wait until the recommendation is for the present settings, and return it."""

        def is_settled() -> bool:
            self._run_jobs()
            state = self.recommendation
            return state is not None and state.config is self.recommender.request

        wait_until(is_settled, TIMEOUT)
        return self.recommendation

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
        self._ros, self._name = ros, name
        self.heard: dict[str, list[Any]] = {}

    def listen(self, *listed: Topic) -> None:
        names = [topic.at(self._name).name for topic in listed]
        for name, topic in zip(names, listed, strict=True):
            kept = replace(topic, name=name, depth=max(topic.depth, _KEPT))
            create_subscription(self, kept, self.heard.setdefault(topic.name, []).append)
        self._ros.spin_until(lambda: all(map(self._is_matched, names)), f'matches of {names}')

    def hear(self, topic: Topic, count: int = 1) -> list[Any]:
        """Wait until `count` messages have been received in total, and return all."""
        heard = self.heard[topic.name]
        self._ros.spin_until(lambda: len(heard) >= count, f'{count} messages on {topic.name}')
        return heard

    def statuses(self, topic: Topic, task: str) -> list[Any]:
        statuses = [item for message in self.heard[topic.name] for item in message.status]
        return [status for status in statuses if status.name == f'{self._name}: {task}']

    def status(self, topic: Topic, task: str, done: Any = lambda _status: True) -> Any:
        """Wait for a status of a task that meets a condition, and return the latest."""
        self._ros.spin_until(lambda: any(map(done, self.statuses(topic, task))), task)
        return list(filter(done, self.statuses(topic, task)))[-1]

    def trigger(self, service: Service) -> Trigger.Response:
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
        self._ros, self._twin, self._sent = ros, twin, 0
        name = TWIN_TOPICS.measured_joint_states.at('/twin').name
        self.publisher = self.create_publisher(JointState, name, QoSProfile(depth=1000))
        if twin is not None:
            twin.keep(self.publisher)
        ros.spin_until(lambda: self.publisher.get_subscription_count() > 0, 'the twin')

    def send(self, sample: Sample, names: tuple[str, ...] = JOINTS) -> None:
        encoder = JointStateEncoder('rig', names, series=1)
        self.publish(encoder.encode(sample.stamp_ns, (sample.plate, sample.projectile)))

    def publish(self, message: JointState | bytes) -> None:
        self.publisher.publish(message)
        self._sent += 1

    def wait(self) -> None:
        twin = self._twin

        def is_taken() -> bool:
            twin.measurement.read_messages()
            counts = twin.session.sample_counts
            return counts.taken + sum(counts.refused.values()) >= self._sent

        self._ros.spin_until(is_taken, 'receipt of all samples')

    def throw(self, samples: list[Sample], behind_ns: int = 0, step_ns: int = 10_000_000) -> None:
        """Send samples as the clock advances in steps, stamped by a clock that is behind."""
        waiting, twin = list(samples), self._twin
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
    """Lock a ROS domain that no other test process uses; child processes inherit the domain."""
    load_kernels()  # before, so that no node compiles during a test
    folder = Path(tempfile.gettempdir()) / f'soft_throw_ros_domains_{os.getuid()}'
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for domain in range(1, 102):  # ports of higher domains may be used for other connections
            with (folder / str(domain)).open('w') as lock, contextlib.suppress(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                patch.setenv('ROS_DOMAIN_ID', str(domain))
                patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
                use_transport_profile()
                yield domain
                return
    raise RuntimeError('all 101 ROS domains are in use by other test processes')


def _make_ros(domain_id: int) -> Iterator[Ros]:
    with contextlib.closing(Ros(domain_id)) as ros:
        yield ros


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
    return ros.node(Node, 'talker')


class Process:
    """A process, which ends with the tests, and its output without that of Fast DDS."""

    def __init__(self, command: list[str], **kwargs: Any) -> None:
        kwargs |= {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT, 'text': True}
        self.process = subprocess.Popen(bound_to_parent(command), **kwargs)
        self.lines: list[str] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def wait_for(self, text: str, timeout: float = PROCESS_TIMEOUT) -> None:
        deadline = time.monotonic() + timeout
        while not any(text in line for line in list(self.lines)):
            is_late = time.monotonic() > deadline or not self._thread.is_alive()
            assert not is_late or text in ''.join(self.lines), '\n'.join(self.lines)
            time.sleep(0.02)

    def end(self, number: int) -> int:
        self.process.send_signal(number)
        return self.wait()

    def end_well(self, number: int = signal.SIGINT, code: int = 0) -> None:
        assert self.end(number) == code, self.lines
        assert not any('Traceback' in line for line in self.lines), self.lines

    def wait(self) -> int:
        code = self.process.wait(PROCESS_TIMEOUT)
        self._thread.join(PROCESS_TIMEOUT)
        return code

    def close(self) -> None:
        self.process.kill()
        self.wait()
        self.process.stdout.close()

    def _read(self) -> None:
        for line in self.process.stdout:
            if not _OF_FAST_DDS.match(re.sub(r'\x1b\[[0-9;]*m', '', line)):
                self.lines.append(line.rstrip())


@pytest.fixture
def start(domain_id: int) -> Iterator[Callable[..., Process]]:
    with contextlib.ExitStack() as started:
        yield lambda *command, **kwargs: started.enter_context(
            contextlib.closing(Process(list(command), **kwargs))
        )


@pytest.fixture
def start_node(start: Callable[..., Process]) -> Callable[..., Process]:
    def start_node(name: str, *rules: str, **kwargs: Any) -> Process:
        words = [word for rule in rules for word in ('-p', rule)]
        return start(sys.executable, '-m', 'soft_throw_ros', name, '--ros-args', *words, **kwargs)

    return start_node


@pytest.fixture
def record(start_node: Callable[..., Process], tmp_path: Path) -> Callable[..., Process]:
    def record(name: str, *rules: str, **kwargs: Any) -> Process:
        recorder = start_node('recorder', f'folder:={tmp_path}', f'name:={name}', *rules, **kwargs)
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
    """Return a function that stops a process while it holds no lock (docs/record.md)."""

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
