# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes in separate processes, their resource usage, and readers of their messages and bags."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
import io
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.storage.cdr import stamp_of

STATES = '/twin/joint_states'  # topic of the twin's states
RATE = 1000  # default rate of the twin's ticks [Hz]
TIMEOUT = 300.0  # longest wait for the first message, since kernels may have to be compiled [s]
EXIT_TIMEOUT = 120.0  # longest wait for a process after SIGINT: a bag may take long [s]

SOFT_THROW = (sys.executable, '-m', 'soft_throw_ros')
ROOT = Path(__file__).parents[1]

Process = subprocess.Popen[bytes]


def usage(pid: int) -> tuple[float, int, int]:
    """Read processor time [s], resident memory [bytes] and number of open files from /proc."""
    folder = Path(f'/proc/{pid}')
    fields = (folder / 'stat').read_text('utf-8').rpartition(')')[2].split()
    processor = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    memory = int(fields[21]) * os.sysconf('SC_PAGE_SIZE')
    return processor, memory, sum(1 for _ in (folder / 'fd').iterdir())


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


class Subscriber:
    """A node in this process that receives states and diagnostics, until `close`."""

    def __init__(self, states: str = STATES) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import JointState

        self.stamps: list[int] = []  # of the received states [ns]
        self.statuses: list[dict[str, str]] = []  # values of every status in `/diagnostics`
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context)
        self.node = rclpy.create_node(f'bench_{os.getpid()}', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

        def on_diagnostics(message: DiagnosticArray) -> None:
            self.statuses.extend({p.key: p.value for p in item.values} for item in message.status)

        subscribe = self.node.create_subscription
        subscribe(DiagnosticArray, '/diagnostics', on_diagnostics, 100)
        subscribe(
            JointState, states, lambda data: self.stamps.append(stamp_of(data)),
            QoSProfile(depth=5000), raw=True,
        )

    def wait(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Receive messages for some seconds, or until a condition holds."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not done():
            self._executor.spin_once(timeout_sec=0.1)
        if seconds >= TIMEOUT and not done():
            sys.exit(f'no message within {seconds:g} s')

    def clear(self) -> None:
        """Discard the received messages."""
        self.stamps.clear()
        self.statuses.clear()

    def values(self, *names: str) -> NDArray[np.float64]:
        """Return the named numbers, one row for every status that has all of them."""
        complete = [values for values in self.statuses if values.keys() >= set(names)]
        return np.array([[float(values[name]) for name in names] for values in complete])

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.shutdown()


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


def recorded_states(bag: Path, topic: str = STATES) -> RecordedStates:
    """Read a topic of stamped messages."""
    rows = [
        (stamp_of(message.data), message.publish_time, message.sequence)
        for _, _, message in _reader(bag).iter_messages(topics=[topic])
    ]
    return RecordedStates(*np.array(rows, dtype=np.int64).reshape(-1, 3).T)


def recorded_statuses(bag: Path) -> Iterator[tuple[int, str, dict[str, str]]]:
    """Yield publication time [ns], name and values of every status in `/diagnostics`."""
    for decoded in _reader(bag).iter_decoded_messages(topics=['/diagnostics']):
        for status in decoded.decoded_message.status:
            values = {p.key: p.value for p in status.values}
            yield decoded.message.publish_time, status.name, values


def _reader(bag: Path) -> Any:
    """Open the only file of a bag with the reader of the mcap library."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    (path,) = bag.glob('*.mcap')
    return make_reader(io.BytesIO(path.read_bytes()), decoder_factories=[DecoderFactory()])
