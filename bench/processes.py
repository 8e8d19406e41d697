# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes in separate processes, their resource usage, and readers of their messages and bags."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
import os
from pathlib import Path
import signal
import struct
import subprocess
import sys
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

STATES = '/twin/joint_states'
"""Topic of the twin's states."""

RATE = 1000
"""Default rate of the twin's ticks. [Hz]"""

SECOND = 1_000_000_000
"""One second. [ns]"""

TIMEOUT = 300.0
"""Longest wait for the first message, since kernels may have to be compiled. [s]"""

EXIT_TIMEOUT = 120.0
"""Longest wait for the end of a process after SIGINT: on a busy machine a bag takes long. [s]"""

SOFT_THROW = (sys.executable, '-m', 'soft_throw_ros')
ROOT = Path(__file__).parents[1]

Process = subprocess.Popen[bytes]


class Usage(NamedTuple):
    """Resources of a process: processor time [s], resident memory [bytes], open files."""

    processor: float
    memory: int
    handles: int


class Heard(NamedTuple):
    """The messages that a subscriber has received."""

    node: Any
    wait: Callable[..., None]
    """Receives messages for some seconds, or until a condition holds."""
    stamps: list[int]
    """Stamps of the received states. [ns]"""
    statuses: list[dict[str, str]]
    """Values of every received status in `/diagnostics`."""

    def clear(self) -> None:
        """Discard the received messages."""
        self.stamps.clear()
        self.statuses.clear()

    def values(self, *names: str) -> NDArray[np.float64]:
        """Return the named numbers, one row for every status that has all of them."""
        complete = [values for values in self.statuses if values.keys() >= set(names)]
        return np.array([[float(values[name]) for name in names] for values in complete])


def usage(pid: int) -> Usage:
    """Read the resources of a process from /proc."""
    folder = Path(f'/proc/{pid}')
    fields = (folder / 'stat').read_text('utf-8').rpartition(')')[2].split()
    processor = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    memory = int(fields[21]) * os.sysconf('SC_PAGE_SIZE')
    return Usage(processor, memory, sum(1 for _ in (folder / 'fd').iterdir()))


def stamp_of(data: bytes) -> int:
    """Read the stamp of a serialized message that starts with a header [ns]."""
    seconds, nanoseconds = struct.unpack_from('<iI', data, 4)
    return int(seconds * SECOND + nanoseconds)


def start(command: Sequence[str], *, output: Any = subprocess.DEVNULL) -> Process:
    """Start a process that imports this package and communicates on this machine only."""
    path = f'{ROOT}:{os.environ.get("PYTHONPATH", "")}'
    variables = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'PYTHONPATH': path}
    return subprocess.Popen(command, env=os.environ | variables, stdout=output, stderr=output)


def end(process: Process) -> int:
    """Interrupt a process as Ctrl-C does, and return its exit code; exit if it does not end."""
    process.send_signal(signal.SIGINT)
    try:
        return process.wait(EXIT_TIMEOUT)
    except subprocess.TimeoutExpired as error:
        sys.exit(f'{error.cmd} has not ended {EXIT_TIMEOUT:g} s after SIGINT')


@contextlib.contextmanager
def running(*commands: tuple[str, ...]) -> Iterator[list[Process]]:
    """Run processes, and interrupt them in reverse order at the end."""
    processes = [start(command) for command in commands]
    try:
        yield processes
        for process in reversed(processes):
            end(process)
    finally:
        for process in processes:
            process.kill()
            process.wait()


@contextlib.contextmanager
def subscriber(states: str = STATES) -> Iterator[Heard]:
    """Subscribe to states and diagnostics in this process."""
    from diagnostic_msgs.msg import DiagnosticArray
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import JointState

    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node('bench', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def wait(seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not done():
            executor.spin_once(timeout_sec=0.1)
        if seconds >= TIMEOUT and not done():
            sys.exit(f'no message on {states} within {seconds:g} s')

    heard = Heard(node, wait, [], [])

    def on_diagnostics(message: DiagnosticArray) -> None:
        heard.statuses.extend({p.key: p.value for p in item.values} for item in message.status)

    def on_states(data: bytes) -> None:
        heard.stamps.append(stamp_of(data))

    node.create_subscription(JointState, states, on_states, QoSProfile(depth=5000), raw=True)
    node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 100)
    try:
        yield heard
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


class RecordedStates(NamedTuple):
    """Stamps, publication times [ns] and sequence numbers of the messages of a recorded topic."""

    stamps: NDArray[np.int64]
    published: NDArray[np.int64]
    numbers: NDArray[np.int64]

    @property
    def lost(self) -> int:
        """Number of messages missing in the sequence numbers, which a new publisher restarts."""
        steps = np.diff(self.numbers)
        return int((steps[steps > 0] - 1).sum())


def _readers(bag: Path, **options: Any) -> Iterator[Any]:
    """Open the files of a bag one after the other with the reader of the mcap library."""
    from mcap.reader import make_reader

    for path in sorted(bag.glob('*.mcap')):
        with path.open('rb') as stream:
            yield make_reader(stream, **options)


def recorded_states(bag: Path, topic: str = STATES) -> RecordedStates:
    """Read a topic of stamped messages."""
    rows = [
        (stamp_of(message.data), message.publish_time, message.sequence)
        for reader in _readers(bag)
        for _, _, message in reader.iter_messages(topics=[topic])
    ]
    return RecordedStates(*np.array(rows, dtype=np.int64).reshape(-1, 3).T)


def recorded_statuses(bag: Path) -> list[tuple[int, str, dict[str, str]]]:
    """Return publication time [ns], name and values of every status in `/diagnostics`."""
    from mcap_ros2.decoder import DecoderFactory

    return [
        (decoded.message.publish_time, status.name, {p.key: p.value for p in status.values})
        for reader in _readers(bag, decoder_factories=[DecoderFactory()])
        for decoded in reader.iter_decoded_messages(topics=['/diagnostics'])
        for status in decoded.decoded_message.status
    ]
