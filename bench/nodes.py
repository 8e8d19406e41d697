# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Cost and lateness of twin and recorder beside plain rclpy nodes, and of many twins at once.

All nodes run in their own processes. The measurements use only topics, the twin's statistics in
`/diagnostics`, bags, and the process accounting of the kernel. Twin and timer run in turns; both
recorders record the same messages at the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import contextlib
import importlib
import os
from pathlib import Path
import statistics
import sys
import tempfile
import time
from typing import Any, NamedTuple

from bench.processes import (
    Process,
    RATE,
    recorded_states,
    running,
    SECOND,
    SOFT_THROW,
    STATES,
    subscriber,
    TIMEOUT,
    usage,
)
from bench.race import Result
import numpy as np

ROUNDS = 3
"""Number of turns of twin and timer."""

SECONDS = 7.0
"""Duration of a measurement. [s]"""

SETTLING = 2.0
"""Time between the first message and the measurement. [s]"""

TWINS = 16
"""Number of twins that run at once."""

STORM_RATE = 50
"""Number of parameter changes per second."""

STORM_THICKNESS = 0.012
"""Layer thickness around which the parameter changes. [m]"""

LATENESS = ('lateness_p50', 'lateness_p99', 'lateness_max')
"""Keys of the lateness of ticks in `/diagnostics`."""


class Measured(NamedTuple):
    """Lateness of ticks [s], fraction of lost messages, and fraction of one core."""

    p50: float
    p99: float
    largest: float
    lost: float
    processor: float


def twin() -> Result:
    """Compare the ticks of the twin with those of a plain timer."""
    commands = {'twin': (*SOFT_THROW, 'twin'), 'timer': (sys.executable, __file__, 'timer')}
    measured: dict[str, list[Measured]] = {name: [] for name in commands}
    for _ in range(ROUNDS):
        for name, command in commands.items():
            measured[name].append(_measure(command))
    ours, plain = (
        Measured(*(statistics.median(values) for values in zip(*rounds, strict=True)))
        for rounds in measured.values()
    )
    result = Result.under(
        'at 1 kHz, one subscriber', 'twin', 'rclpy timer', 'timer / twin', 'goal'
    )
    rows = (
        ('lateness p50 [us]', 1e6, None),
        ('lateness p99 [us]', 1e6, 100.0),
        ('lateness max [us]', 1e6, None),
        ('messages lost [%]', 100.0, 0.0),
        ('of one core [%]', 100.0, 12.0),
    )
    for (title, scale, goal), value, reference in zip(rows, ours, plain, strict=True):
        ratio = reference / value if value else None
        result.rows.append([title, scale * value, scale * reference, ratio, goal])
    result.ratios['of one core'] = plain.processor / ours.processor
    return result


def _measure(command: tuple[str, ...]) -> Measured:
    """Run a publisher; measure its messages, its reported lateness and its processor time."""
    with subscriber() as heard, running(command) as (child,):
        heard.wait(TIMEOUT, lambda: bool(heard.stamps))
        heard.wait(SETTLING)
        heard.clear()
        (share,) = _shares([child], lambda: heard.wait(SECONDS))
    stamps = heard.stamps
    expected = round((max(stamps) - min(stamps)) * RATE / SECOND) + 1
    p50, p99, largest = heard.values(*LATENESS).T
    lost = 1.0 - len(set(stamps)) / expected
    return Measured(
        float(np.median(p50)), float(np.median(p99)), float(largest.max()), lost, share
    )


def _shares(processes: list[Process], wait: Callable[[], None]) -> list[float]:
    """Return the fraction of one core that each process uses during a wait."""
    before = [usage(process.pid).processor for process in processes]
    begin = time.monotonic()
    wait()
    duration = time.monotonic() - begin
    return [
        (usage(process.pid).processor - used) / duration
        for process, used in zip(processes, before, strict=True)
    ]


def storm() -> Result:
    """Compare the ticks of a twin with and without frequent changes of a parameter."""
    from rclpy.parameter import Parameter
    from rclpy.parameter_client import AsyncParameterClient

    title = f'ticks of the twin at 1 kHz, {STORM_RATE} changes of a parameter a second'
    result = Result.under(title, 'ticks', 'later than 0.2 ms [%]', 'skipped', 'lateness p99 [us]')
    with subscriber() as heard, running((*SOFT_THROW, 'twin')):
        heard.wait(TIMEOUT, lambda: bool(heard.stamps))
        heard.wait(SETTLING)
        client = AsyncParameterClient(heard.node, '/twin')
        for name, rate in (('without changes', 0), ('with changes', STORM_RATE)):
            heard.clear()
            begin, count = time.monotonic(), 0
            while time.monotonic() < begin + 2.0 * SECONDS:
                heard.wait(1.0 / STORM_RATE)
                while rate and count < rate * (time.monotonic() - begin):
                    thickness = STORM_THICKNESS * (1.0 + 1e-4 * (count % 500))
                    future = client.set_parameters([Parameter('layer.thickness', value=thickness)])
                    heard.wait(TIMEOUT, future.done)
                    count += 1
            numbers = heard.values('ticks', 'ticks_late', 'ticks_skipped')
            ticks, late, skipped = (numbers[-1] - numbers[0]).tolist()
            p99 = 1e6 * float(np.median(heard.values('lateness_p99')))
            result.rows.append([name, ticks, 100.0 * late / ticks, skipped, p99])
    return result


def start() -> Result:
    """Measure the time to the twin's first state, with and without compiled kernels."""
    result = Result.under('first start of the twin', 's', 'goal')
    with tempfile.TemporaryDirectory() as folder:
        for title, goal in (('no kernel compiled', 15.0), ('all kernels compiled', 1.5)):
            with subscriber() as heard:
                begin = time.monotonic()
                with running((*SOFT_THROW, 'twin'), NUMBA_CACHE_DIR=folder):
                    heard.wait(TIMEOUT, lambda heard=heard: bool(heard.stamps))
                    result.rows.append([title, time.monotonic() - begin, goal])
    return result


def recorder() -> Result:
    """Compare the recorder with a plain one that writes in its callbacks."""
    result = Result.under('recorder', 'rate [Hz]', 'lost [%]', 'of one core [%]', 'cost over ours')
    for rate in (1000, 5000):
        (ours_lost, ours), (plain_lost, plain) = _record(rate)
        result.rows.append(['ours', rate, 100.0 * ours_lost, 100.0 * ours, None])
        result.rows.append(['plain', rate, 100.0 * plain_lost, 100.0 * plain, plain / ours])
        result.ratios[f'of one core at {rate} Hz'] = plain / ours
    return result


def _record(rate: int) -> list[tuple[float, float]]:
    """Return the fractions of lost states and of one core for both recorders."""
    with tempfile.TemporaryDirectory() as folder:
        bags = [Path(folder) / name for name in ('ours', 'plain')]
        commands = (
            (*SOFT_THROW, *_recorder_into(folder, 'ours')),
            (sys.executable, __file__, 'plain', str(bags[1])),
            (*SOFT_THROW, 'twin', '--ros-args', '-p', f'rate.state:={rate}.0'),
        )
        with subscriber() as heard, running(*commands) as processes:
            heard.wait(TIMEOUT, lambda: bool(heard.stamps))
            heard.wait(SETTLING)
            shares = _shares(processes[:2], lambda: heard.wait(SECONDS))
        recorded = [recorded_states(bag).stamps for bag in bags]
    first, last = max(map(np.min, recorded)), min(map(np.max, recorded))
    published = np.union1d(*recorded)
    published = published[(published >= first) & (published <= last)]
    return [
        (1.0 - float(np.isin(published, stamps).mean()), share)
        for stamps, share in zip(recorded, shares, strict=True)
    ]


def _recorder_into(folder: str, name: str, *rules: str) -> tuple[str, ...]:
    words = (f'folder:={folder}', f'name:={name}', *rules)
    return 'recorder', '--ros-args', *(word for rule in words for word in ('-p', rule))


def sixteen_twins() -> Result:
    """Run many twins at 100 Hz each, and one recorder of all their topics."""
    names = [f'/rig{number}/twin' for number in range(1, TWINS + 1)]
    twins = [
        (*SOFT_THROW, 'twin', '--ros-args', '-r', f'__ns:={name.removesuffix("/twin")}',
         '-p', 'rate.state:=100.0')
        for name in names
    ]
    with tempfile.TemporaryDirectory() as folder:
        command = (*SOFT_THROW, *_recorder_into(folder, 'bag', "topics:=['/']"))
        with subscriber() as heard, running(command, *twins) as processes:
            reporting: set[str] = set()

            def all_report() -> bool:
                reporting.update(name for name, values in heard.statuses if LATENESS[0] in values)
                return len(reporting) == TWINS

            heard.wait(TIMEOUT, all_report)
            heard.clear()
            shares = _shares(processes, lambda: heard.wait(SECONDS))
        p99 = heard.values(*LATENESS)[:, 1]
        recorded = [
            recorded_states(Path(folder) / 'bag', f'{name}/joint_states') for name in names
        ]
    result = Result.under(f'{TWINS} twins at 100 Hz, one recorder', 'measured', 'goal')
    result.rows.extend([
        ['states recorded', sum(states.stamps.size for states in recorded), None],
        ['states lost', sum(states.lost for states in recorded), 0.0],
        ['of one core, a twin, median [%]', 100.0 * statistics.median(shares[1:]), None],
        ['of one core, all twins [%]', 100.0 * sum(shares[1:]), None],
        ['of one core, the recorder [%]', 100.0 * shares[0], None],
        ['lateness p99, median [us]', 1e6 * float(np.median(p99)), None],
    ])
    return result


def _publish_by_timer() -> None:
    """Publish states from an rclpy timer, and report lateness as the twin does, until Ctrl-C."""
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
    from soft_throw_ros.configuration.interface import ALL_TWIN_TOPICS

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

        for topic in ALL_TWIN_TOPICS:
            if not topic.is_input:
                record(topic.at('/twin'))
        try:
            rclpy.spin(node)
        finally:
            writer.finish()


PARTS: Mapping[str, Callable[[], Result]] = {
    function.__name__: function for function in (twin, storm, recorder, start, sixteen_twins)
}
"""Functions that measure the tables, by their names."""


if __name__ == '__main__':
    with contextlib.suppress(KeyboardInterrupt, Exception):
        {'timer': _publish_by_timer, 'plain': _record_plainly}[sys.argv[1]](*sys.argv[2:])
    os._exit(0)  # without waiting for the middleware
