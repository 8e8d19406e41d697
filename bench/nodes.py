# SPDX-License-Identifier: Apache-2.0
"""
Twin and recorder against plain nodes that do what anybody would, and how soon the twin is there.

All run as a user runs them, in processes of their own, and are seen from outside: by their topics,
by what the twin says of itself in `/diagnostics`, by bags, and by the kernel's accounts. Twin and
timer run in turns; the recorders record the same messages at the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import contextlib
import importlib
import os
from pathlib import Path
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

import numpy as np

from bench.race import head

STATES = '/twin/joint_states'
RATE = 1000  # of ticks [Hz]
ROUNDS = 3
SECONDS = 7.0  # of a round
SETTLING = 2.0  # [s]
TIMEOUT = 300.0  # for the first message, since kernels may have to be compiled [s]
SECOND = 1_000_000_000  # [ns]
SOFT_THROW = (sys.executable, '-m', 'soft_throw_ros')
ROOT = Path(__file__).parents[1]


class Measured(NamedTuple):
    """How a publisher did: lateness of ticks [s], what was lost, and the part of one core."""

    p50: float
    p99: float
    largest: float
    lost: float
    processor: float


def twin_rows() -> list[str]:
    """Compare the ticks of the twin with those of a plain timer."""
    timer = (sys.executable, __file__, 'timer')
    found: dict[str, list[Measured]] = {'twin': [], 'timer': []}
    for _ in range(ROUNDS):
        for name, command in (('twin', (*SOFT_THROW, 'twin')), ('timer', timer)):
            found[name].append(_measure(command))
    twin, plain = (
        Measured(*(statistics.median(values) for values in zip(*rounds, strict=True)))
        for rounds in found.values()
    )
    lines = head('at 1 kHz, one subscriber', 'twin', 'rclpy timer', 'timer / twin', 'goal')
    for title, place, scale, goal in (
        ('lateness p50 [us]', 0, 1e6, '-'),
        ('lateness p99 [us]', 1, 1e6, '100'),
        ('lateness max [us]', 2, 1e6, '-'),
        ('messages lost [%]', 3, 100.0, '0'),
        ('of one core [%]', 4, 100.0, '12'),
    ):
        ours, theirs = scale * twin[place], scale * plain[place]
        ratio = f'{theirs / ours:.3g}' if ours else '-'
        lines.append(f'| {title} | {ours:.4g} | {theirs:.4g} | {ratio} | {goal} |')
    return lines


def _measure(command: tuple[str, ...]) -> Measured:
    """Run a publisher, and see what comes and what it says of its lateness."""
    with _subscriber() as (wait, stamps, lateness), _children(command) as (child,):
        wait(TIMEOUT, lambda: bool(stamps))
        wait(SETTLING)
        stamps.clear()
        lateness.clear()
        before, begin = _processor_time(child), time.monotonic()
        wait(SECONDS)
        used, passed = _processor_time(child) - before, time.monotonic() - begin
    expected = round((max(stamps) - min(stamps)) * RATE / SECOND) + 1
    lost = 1.0 - len(set(stamps)) / expected
    p50, p99, largest = np.array(lateness).T
    return Measured(
        float(np.median(p50)), float(np.median(p99)), float(largest.max()), lost, used / passed
    )


def start_rows() -> list[str]:
    """Measure how long it takes until the twin's first state, kernels compiled or not."""
    lines = head('first start of the twin', 's', 'goal')
    with tempfile.TemporaryDirectory() as folder:
        for title, goal in (('no kernel compiled', 15.0), ('the next', 1.5)):
            with _subscriber() as (wait, stamps, _):
                begin = time.monotonic()
                with _children((*SOFT_THROW, 'twin'), NUMBA_CACHE_DIR=folder):
                    wait(TIMEOUT, lambda stamps=stamps: bool(stamps))
                    lines.append(f'| {title} | {time.monotonic() - begin:.2f} | {goal:g} |')
    return lines


def recorder_rows() -> list[str]:
    """Compare the recorder with a plain one that writes in its callbacks."""
    lines = head('rate [Hz]', 'recorder', 'lost [%]', 'of one core [%]', 'plain / recorder')
    for rate in (1000, 5000):
        (ours_lost, ours), (plain_lost, plain) = _record(rate)
        for name, lost, cost in (('ours', ours_lost, ours), ('plain', plain_lost, plain)):
            ratio = f'{plain / ours:.2g}' if name == 'plain' else '-'
            lines.append(f'| {rate} | {name} | {100 * lost:.3g} | {100 * cost:.3g} | {ratio} |')
    return lines


def _record(rate: int) -> list[tuple[float, float]]:
    """Return the part of the states lost, and the part of one core used, of both recorders."""
    with tempfile.TemporaryDirectory() as folder:
        bags = [Path(folder) / name for name in ('ours', 'plain')]
        ours = ('recorder', '--ros-args', '-p', f'folder:={folder}', '-p', 'name:=ours')
        commands = (
            (*SOFT_THROW, *ours),
            (sys.executable, __file__, 'plain', str(bags[1])),
            (*SOFT_THROW, 'twin', '--ros-args', '-p', f'rate.state:={rate}.0'),
        )
        with _subscriber() as (wait, stamps, _), _children(*commands) as children:
            wait(TIMEOUT, lambda: bool(stamps))
            wait(SETTLING)
            before = [_processor_time(child) for child in children[:2]]
            begin = time.monotonic()
            wait(SECONDS)
            used = [_processor_time(child) for child in children[:2]]
            passed = time.monotonic() - begin
        recorded = [_stamps(bag) for bag in bags]
    first, last = max(map(np.min, recorded)), min(map(np.max, recorded))
    published = np.union1d(*recorded)
    published = published[(published >= first) & (published <= last)]
    return [
        (1.0 - float(np.isin(published, got).mean()), (after - earlier) / passed)
        for got, earlier, after in zip(recorded, before, used, strict=True)
    ]


def _stamps(bag: Path) -> np.ndarray:
    """Read the stamps of the states in a bag. [ns]"""
    from mcap.reader import make_reader

    found = []
    for path in bag.glob('*.mcap'):
        with path.open('rb') as stream:
            messages = make_reader(stream).iter_messages(topics=[STATES])
            found += [_stamp(message.data) for _, _, message in messages]
    return np.array(found, dtype=np.int64)


def _stamp(data: bytes) -> int:
    """Read the stamp of a message that begins with a header. [ns]"""
    seconds, nanoseconds = struct.unpack_from('<iI', data, 4)
    return int(seconds * SECOND + nanoseconds)


def _processor_time(process: subprocess.Popen[bytes]) -> float:
    """Return what a process has used so far. [s]"""
    fields = Path(f'/proc/{process.pid}/stat').read_text('utf-8').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


@contextlib.contextmanager
def _children(
    *commands: tuple[str, ...], **environment: str
) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Run processes, and end them as Ctrl-C does, the last one first."""
    variables = {
        **os.environ,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'PYTHONPATH': f'{ROOT}:{os.environ.get("PYTHONPATH", "")}',
        **environment,
    }
    children = [
        subprocess.Popen(
            command, env=variables, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for command in commands
    ]
    try:
        yield children
        for child in reversed(children):
            child.send_signal(signal.SIGINT)
            child.wait(20.0)
    finally:
        for child in children:
            child.kill()
            child.wait()


@contextlib.contextmanager
def _subscriber() -> Iterator[tuple[Callable[..., None], list[int], list[tuple[float, ...]]]]:
    """
    Subscribe as a recorder would.

    Yields
    ------
    wait : callable
        Takes messages for some seconds, or until a condition holds.
    stamps : list of int
        Of the states that came. [ns]
    lateness : list of tuple
        Median, 99 % and largest lateness of ticks, as their publisher says every second. [s]

    """
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
    stamps: list[int] = []
    lateness: list[tuple[float, ...]] = []

    def on_states(data: bytes) -> None:
        stamps.append(_stamp(data))

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if 'lateness_p50' in values:
                names = ('lateness_p50', 'lateness_p99', 'lateness_max')
                lateness.append(tuple(float(values[name]) for name in names))

    def wait(seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end and not done():
            executor.spin_once(timeout_sec=0.1)
        if seconds >= TIMEOUT and not done():
            raise TimeoutError(f'nothing on {STATES} after {seconds:g} s')

    node.create_subscription(JointState, STATES, on_states, QoSProfile(depth=1000), raw=True)
    node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
    try:
        yield wait, stamps, lateness
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


# What anybody would write; each runs in a process of its own until Ctrl-C.


def _publish_by_timer() -> None:
    """Fill in a message and publish it in a timer, and say how late it was as the twin does."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    import rclpy
    from rclpy.qos import QoSProfile
    from rclpy.time import Time
    from sensor_msgs.msg import JointState

    rclpy.init(args=[])
    node = rclpy.create_node('twin')
    states = node.create_publisher(JointState, STATES, QoSProfile(depth=1000))
    diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    message = JointState(name=['plate', 'projectile'])
    message.header.frame_id = 'rig'
    late: list[int] = []

    def on_timer() -> None:
        late.append(timer.timer_period_ns - timer.time_until_next_call())
        message.header.stamp = Time(nanoseconds=time.time_ns() - late[-1]).to_msg()
        message.position = [0.0, 0.0168]
        message.velocity = [0.0, 0.0]
        message.effort = [0.0, 0.0]
        states.publish(message)

    def on_second() -> None:
        values = zip(('p50', 'p99', 'max'), np.percentile(late, (50, 99, 100)), strict=True)
        pairs = [KeyValue(key=f'lateness_{name}', value=str(v / SECOND)) for name, v in values]
        diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(values=pairs)]))
        late.clear()

    timer = node.create_timer(1.0 / RATE, on_timer)
    node.create_timer(1.0, on_second)
    rclpy.spin(node)


def _record_plainly(folder: str) -> None:
    """Write every message of the twin where it is received."""
    from mcap.writer import Writer
    import rclpy
    from soft_throw_ros.configuration.interface import TWIN_TOPICS

    rclpy.init(args=[])
    node = rclpy.create_node('plain')
    Path(folder).mkdir()
    with (Path(folder) / 'plain_0.mcap').open('wb') as stream:
        writer = Writer(stream, chunk_size=256 * 1024)
        writer.start('ros2', 'plain')

        def record(topic: Any) -> None:
            schema = writer.register_schema(topic.type, 'ros2msg', b'')
            channel = writer.register_channel(topic.name, 'cdr', schema)

            def on_message(data: bytes) -> None:
                now = time.time_ns()
                writer.add_message(channel, now, data, now)

            package, _, name = topic.type.split('/')
            kind = getattr(importlib.import_module(f'{package}.msg'), name)
            node.create_subscription(kind, topic.name, on_message, topic.depth, raw=True)

        for topic in TWIN_TOPICS:
            if not topic.is_input:
                record(topic.at('/twin'))
        try:
            rclpy.spin(node)
        finally:
            writer.finish()


PARTS: Mapping[str, Callable[[], list[str]]] = {
    'twin': twin_rows,
    'recorder': recorder_rows,
    'start': start_rows,
}
"""Tables by their names."""


if __name__ == '__main__':
    with contextlib.suppress(KeyboardInterrupt, Exception):
        {'timer': _publish_by_timer, 'plain': _record_plainly}[sys.argv[1]](*sys.argv[2:])
    os._exit(0)  # without waiting for the middleware
