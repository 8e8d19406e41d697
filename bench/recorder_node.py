# SPDX-License-Identifier: Apache-2.0
"""
How much the recorder loses and costs, against a plain one that writes in its callbacks.

Both record the same messages of the same twin at the same time, each in a process of its own.
Run by itself: ``python -m bench.recorder_node [SECONDS]``.
"""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np
from soft_throw_ros.recording.bag import BagReader
from soft_throw_ros.recording.cdr import decode_joint_states

STATES = '/twin/joint_states'
RATES = (1000, 5000)  # of states; fields come at 50 Hz [Hz]
PATIENCE = 60.0  # for the first message, since kernels may have to be compiled [s]
SOFT_THROW = [sys.executable, '-m', 'soft_throw_ros']


def rows(*, seconds: float = 10.0) -> list[str]:
    """Return the rows of a Markdown table, the head first."""
    lines = [
        '| rate [Hz] | recorder | lost [%] | of one core [%] | plain / recorder |',
        '|---|---|---|---|---|',
    ]
    for rate in RATES:
        (ours_lost, ours), (plain_lost, plain) = _record(rate, seconds)
        for name, lost, cost in (('ours', ours_lost, ours), ('plain', plain_lost, plain)):
            ratio = f'{plain / ours:.2g}' if name == 'plain' else '-'
            lines.append(f'| {rate} | {name} | {100 * lost:.3g} | {100 * cost:.3g} | {ratio} |')
    return lines


def _record(rate: int, seconds: float) -> list[tuple[float, float]]:
    """Return the part of the states lost, and the part of one core used, of both recorders."""
    with tempfile.TemporaryDirectory() as folder:
        bags = [Path(folder) / name for name in ('ours', 'plain')]
        commands = [
            [*SOFT_THROW, 'recorder', '--ros-args', '-p', f'folder:={folder}', '-p', 'name:=ours'],
            [sys.executable, __file__, 'plain', str(bags[1])],
            [*SOFT_THROW, 'twin', '--ros-args', '-p', f'rate.state:={rate}.0'],
        ]
        environment = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        children = [
            subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
            for command in commands
        ]
        try:
            _wait_for_states(bags[0])
            before = [_processor_time(child) for child in children[:2]]
            begin = time.monotonic()
            time.sleep(seconds)
            used = [_processor_time(child) for child in children[:2]]
            passed = time.monotonic() - begin
            for child in reversed(children):  # the twin first, so that nothing is cut off
                child.send_signal(signal.SIGINT)
                time.sleep(1.0)
                child.wait(20.0)
        finally:
            for child in children:
                child.kill()
                child.wait()
        stamps = [_stamps(bag) for bag in bags]
    first, last = max(map(np.min, stamps)), min(map(np.max, stamps))
    published = np.union1d(*stamps)
    published = published[(published >= first) & (published <= last)]
    return [
        (1.0 - float(np.isin(published, got).mean()), (after - earlier) / passed)
        for got, earlier, after in zip(stamps, before, used, strict=True)
    ]


def _wait_for_states(bag: Path) -> None:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if (bag / 'metadata.yaml').is_file() and _stamps(bag).size:
            return
        time.sleep(0.5)
    raise TimeoutError(f'no states in {bag} after {PATIENCE:g} s')


def _stamps(bag: Path) -> np.ndarray:
    with BagReader(bag) as reader:
        data = [message.data for message in reader.messages([STATES])]
    return decode_joint_states(data).stamps if data else np.empty(0, np.int64)


def _processor_time(process: subprocess.Popen[bytes]) -> float:
    """Return what a process has used so far. [s]"""
    fields = Path(f'/proc/{process.pid}/stat').read_text('utf-8').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def _record_plainly(folder: str) -> None:
    """Do what anybody would: write every message where it is received."""
    from mcap.writer import Writer
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.node import Node
    from soft_throw_ros.configuration.interface import Topic, TWIN_TOPICS
    from soft_throw_ros.nodes.topics import load_type, qos_profile

    rclpy.init(args=[])
    node = Node('plain')
    Path(folder).mkdir()
    with (Path(folder) / 'plain_0.mcap').open('wb') as stream:
        writer = Writer(stream, chunk_size=256 * 1024)
        writer.start('ros2', 'plain')

        def record(topic: Topic) -> None:
            name = topic.at('/twin').name
            schema = writer.register_schema(topic.type, 'ros2msg', b'')
            channel = writer.register_channel(name, 'cdr', schema)

            def on_message(data: bytes) -> None:
                now = time.time_ns()
                writer.add_message(channel, now, data, now)

            node.create_subscription(
                load_type(topic.type), name, on_message, qos_profile(topic), raw=True
            )

        for topic in TWIN_TOPICS:
            record(topic)
        try:
            rclpy.spin(node)
        except (KeyboardInterrupt, ExternalShutdownException):
            writer.finish()


if __name__ == '__main__':
    if sys.argv[1:2] == ['plain']:
        _record_plainly(sys.argv[2])
        os._exit(0)  # without waiting for the middleware
    print('\n'.join(rows(seconds=float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)))
