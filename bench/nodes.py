# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Cost and lateness of the twin beside an rclpy timer, and of the recorder beside rclpy and mcap.

All nodes run in their own processes: twin and timer in turns, both recorders at the same time.
"""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import os
from pathlib import Path
import signal
import sys
import tempfile
import time
from typing import Any

from bench import processes
from bench.processes import Process, RATE, running, SOFT_THROW, Subscriber, TIMEOUT
from bench.tables import Result
import numpy as np
from soft_throw_ros.storage.message import SECOND

ROUNDS = 3  # number of turns of twin and timer
SECONDS = 7.0  # duration of a measurement [s]
SETTLING = 2.0  # time between the first message and the measurement [s]

LATENESS = ('lateness_p50', 'lateness_p99', 'lateness_max')  # keys in `/diagnostics`
# Numbers of a publisher, and the largest ones of the twin
GOALS = {
    'lateness p50 [us]': None, 'lateness p99 [us]': 100.0, 'lateness max [us]': None,
    'lost [%]': 0.0, 'of one core [%]': 12.0,
}


def twin() -> Result:
    """Compare the ticks of the twin with those of a plain timer."""
    commands = ((*SOFT_THROW, 'twin'), (sys.executable, __file__, 'timer'))
    rounds = [[_measure(command) for command in commands] for _ in range(ROUNDS)]
    heads = ['at 1 kHz, one subscriber', 'twin', 'rclpy timer', 'timer / twin', 'goal']
    result = Result(heads, [], {})
    numbers = np.median(rounds, axis=0).T.tolist()
    for (title, goal), (ours, plain) in zip(GOALS.items(), numbers, strict=True):
        result.rows.append([title, ours, plain, plain / ours if ours else None, goal])
    result.ratios['of one core'] = plain / ours
    return result


def _measure(command: tuple[str, ...]) -> tuple[float, ...]:
    """Run a publisher, and return the numbers of `GOALS`."""
    with contextlib.closing(Subscriber()) as heard, running(command) as (child,):
        heard.wait(TIMEOUT, lambda: bool(heard.stamps))
        heard.wait(SETTLING)
        heard.clear()
        (share,) = _shares([child], lambda: heard.wait(SECONDS))
    stamps = heard.stamps
    expected = round((max(stamps) - min(stamps)) * RATE / SECOND) + 1
    p50, p99, largest = 1e6 * heard.values(*LATENESS).T
    lost = 100.0 * (1.0 - len(set(stamps)) / expected)
    return float(np.median(p50)), float(np.median(p99)), float(largest.max()), lost, 100.0 * share


def _shares(children: list[Process], wait: Callable[[], None]) -> list[float]:
    """Return the fraction of one core that each process uses during a wait."""
    before = [processes.usage(child.pid)[0] for child in children]
    begin = time.monotonic()
    wait()
    duration = time.monotonic() - begin
    return [
        (processes.usage(child.pid)[0] - used) / duration
        for child, used in zip(children, before, strict=True)
    ]


def recorder() -> Result:
    """Compare the recorder with rclpy and mcap, whose callbacks write the messages."""
    heads = ['recorder', 'rate [Hz]', 'lost [%]', 'of one core [%]', 'cost over ours']
    result = Result(heads, [], {})
    for rate in (1000, 5000):
        (ours_lost, ours), (plain_lost, plain) = _record(rate)
        result.rows.append(['ours', rate, 100.0 * ours_lost, 100.0 * ours, None])
        cost = plain / ours
        result.rows.append(['rclpy and mcap', rate, 100.0 * plain_lost, 100.0 * plain, cost])
        result.ratios[f'of one core at {rate} Hz'] = cost
    return result


def _record(rate: int) -> list[tuple[float, float]]:
    """Return the fractions of lost states and of one core for both recorders."""
    with tempfile.TemporaryDirectory() as folder:
        bags = [Path(folder) / name for name in ('ours', 'plain')]
        commands = (
            (*SOFT_THROW, 'recorder', '--ros-args', '-p', f'folder:={folder}', '-p', 'name:=ours'),
            (sys.executable, __file__, 'plain', str(bags[1])),
            (*SOFT_THROW, 'twin', '--ros-args', '-p', f'rate.state:={rate}.0'),
        )
        with contextlib.closing(Subscriber()) as heard, running(*commands) as children:
            heard.wait(TIMEOUT, lambda: bool(heard.stamps))
            heard.wait(SETTLING)
            shares = _shares(children[:2], lambda: heard.wait(SECONDS))
        recorded = [processes.recorded_states(bag).stamps for bag in bags]
    first, last = max(map(np.min, recorded)), min(map(np.max, recorded))
    published = np.union1d(*recorded)
    published = published[(published >= first) & (published <= last)]
    return [
        (1.0 - float(np.isin(published, stamps).mean()), share)
        for stamps, share in zip(recorded, shares, strict=True)
    ]


def _publish_by_timer() -> None:
    """Publish states from an rclpy timer, and report lateness as the twin does, until Ctrl-C."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    import rclpy
    from rclpy.qos import QoSProfile
    from rclpy.time import Time
    from sensor_msgs.msg import JointState

    rclpy.init(args=[])
    node = rclpy.create_node('twin')
    states = node.create_publisher(JointState, processes.STATES, QoSProfile(depth=1000))
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
        values = np.percentile(late, (50, 99, 100)) / SECOND
        pairs = [KeyValue(key=k, value=str(v)) for k, v in zip(LATENESS, values, strict=True)]
        diagnostics.publish(DiagnosticArray(status=[DiagnosticStatus(values=pairs)]))
        late.clear()

    timer = node.create_timer(1.0 / RATE, on_timer)
    node.create_timer(1.0, on_second)
    rclpy.spin(node)


def _record_plainly(folder: str) -> None:
    """Write every message of the twin in the callback that receives it, until Ctrl-C."""
    from mcap.writer import Writer
    import rclpy
    from soft_throw_ros.configuration.interface import TWIN_TOPICS
    from soft_throw_ros.nodes.topics import load_type

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # rclpy ends the spinning between two callbacks
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

            kind = load_type(topic.type)
            node.create_subscription(kind, topic.name, on_message, topic.depth, raw=True)

        for topic in TWIN_TOPICS:
            record(topic.at('/twin'))
        try:
            rclpy.spin(node)
        finally:
            writer.finish()


if __name__ == '__main__':
    with contextlib.suppress(KeyboardInterrupt, Exception):
        {'timer': _publish_by_timer, 'plain': _record_plainly}[sys.argv[1]](*sys.argv[2:])
    os._exit(0)  # without waiting for the middleware
