# SPDX-License-Identifier: Apache-2.0
"""
How well the twin keeps time, against a plain rclpy timer that publishes the same message.

Both run in turns, each in a process of its own, with one subscriber each in a third process, so
that what else the machine does strikes both alike. Lateness is that of the moment at which the
callback of the tick begins. Run by itself: ``python -m bench.twin_node [SECONDS]``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import json
import os
from pathlib import Path
import struct
import subprocess
import sys
import time
from typing import Any

import numpy as np

TOPIC = '/twin/joint_states'
RATE = 1000.0  # [Hz]
ROUNDS = 3
SETTLING = 1.5  # [s]
PATIENCE = 60.0  # for the first message, since kernels may have to be compiled [s]
SECOND = 1_000_000_000  # [ns]


@dataclass(frozen=True, kw_only=True)
class Measured:
    """
    How a publisher at 1 kHz did.

    Parameters
    ----------
    p50, p99, largest : float
        Lateness of ticks. [s]
    lost : float
        Part of the ticks that never came, or came twice. [-]
    processor : float
        Part of one core. [-]
    scheduler : str
        What the kernel schedules the thread of the ticks by.
    received : float
        Part of the messages that the subscriber got. [-]

    """

    p50: float
    p99: float
    largest: float
    lost: float
    processor: float
    scheduler: str
    received: float


def measure(*, seconds: float = 20.0) -> dict[str, Measured]:
    """
    Measure twin and timer in turns.

    Parameters
    ----------
    seconds : float
        For each of the two in all. [s]

    """
    reports: dict[str, list[dict[str, Any]]] = {'twin': [], 'timer': []}
    for _ in range(ROUNDS):
        for name, collected in reports.items():
            collected.append(_run(name, seconds / ROUNDS))
    return {name: _sum_up(collected) for name, collected in reports.items()}


def rows(*, seconds: float = 20.0) -> list[str]:
    """Return the rows of a Markdown table, the head first."""
    measured = measure(seconds=seconds)
    twin, timer = measured['twin'], measured['timer']
    lines = [
        '| at 1 kHz, one subscriber | twin | rclpy timer | timer / twin |',
        '|---|---|---|---|',
    ]
    for title, name, scale in (
        ('lateness p50 [us]', 'p50', 1e6),
        ('lateness p99 [us]', 'p99', 1e6),
        ('lateness max [us]', 'largest', 1e6),
        ('ticks lost or doubled [%]', 'lost', 100.0),
        ('of one core [%]', 'processor', 100.0),
        ('received [%]', 'received', 100.0),
    ):
        ours, theirs = scale * getattr(twin, name), scale * getattr(timer, name)
        ratio = f'{theirs / ours:.3g}' if ours else '-'
        lines.append(f'| {title} | {ours:.4g} | {theirs:.4g} | {ratio} |')
    lines.append(f'| scheduled by | {twin.scheduler} | {timer.scheduler} | - |')
    return lines


def _sum_up(reports: list[dict[str, Any]]) -> Measured:
    lateness, lost, received, ticks = [], 0, 0, 0
    for report in reports:
        due, begun, stamps = np.array(report['ticks']).T
        ticks += due.size
        received += np.isin(stamps, report['received']).sum()
        steps = np.rint(np.diff(due) * RATE / SECOND).astype(int)
        lost += np.abs(steps - 1).sum()
        # a tick that was left out is as late as the next one that came
        number = np.concatenate(([0], np.cumsum(steps)))
        following = np.searchsorted(number, np.arange(number[-1] + 1))
        missed = (number[following] - np.arange(number[-1] + 1)) * SECOND / RATE
        lateness.append((begun - due)[following] + missed)
    p50, p99, largest = np.percentile(np.concatenate(lateness), (50, 99, 100)) / SECOND
    return Measured(
        p50=float(p50),
        p99=float(p99),
        largest=float(largest),
        lost=float(lost / ticks),
        processor=float(np.mean([report['processor'] for report in reports])),
        scheduler=reports[0]['scheduler'],
        received=float(received / ticks),
    )


def _run(name: str, seconds: float) -> dict[str, Any]:
    """Run a publisher and a subscriber in processes of their own, and return their reports."""
    root = Path(__file__).parents[1]
    environment = {
        **os.environ,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'PYTHONPATH': f'{root}:{os.environ.get("PYTHONPATH", "")}',
    }
    children = [
        subprocess.Popen(
            [sys.executable, __file__, role, str(seconds)],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        for role in ('subscriber', name)
    ]
    report: dict[str, Any] = {}
    try:
        for child in reversed(children):
            output, _ = child.communicate(timeout=120.0 + seconds)
            report.update(json.loads(output.splitlines()[-1]))
    finally:
        for child in children:
            child.kill()
            child.wait()
    return report


# In the children. A tick is noted as when it was due, when it began, and its stamp [ns].


def _publish_by_twin(seconds: float) -> dict[str, Any]:
    """Run the twin, and note when its ticks begin."""
    import rclpy
    from soft_throw_ros.nodes import twin

    begun: list[int] = []
    due: list[int] = []

    class Noting(twin.Twin):
        """A twin that notes for when its ticks were due."""

        def on_step(self, outputs: Any, due_ns: int) -> None:
            super().on_step(outputs, due_ns)
            due.append(due_ns)

    def advance() -> Any:
        begun.append(time.time_ns())
        return original()

    rclpy.init(args=[])
    node = Noting()
    node.prepare()
    original, node.session.advance = node.session.advance, advance  # type: ignore[method-assign]
    node.ticker.start()
    first, last, processor = _watch(node, lambda: len(due), seconds)
    ticks = list(zip(due, begun, due, strict=False))[first:last]
    return {'ticks': ticks, 'processor': processor, 'scheduler': node.ticker.scheduler}


def _publish_by_timer(seconds: float) -> dict[str, Any]:
    """Do what anybody would: a timer that fills in a message and publishes it."""
    import rclpy
    from rclpy.node import Node
    from rclpy.time import Time
    from sensor_msgs.msg import JointState
    from soft_throw_ros.configuration.interface import FRAME, JOINTS, TWIN_TOPICS
    from soft_throw_ros.nodes.topics import qos_profile

    ticks: list[tuple[int, int, int]] = []

    class Plain(Node):
        """A plain node."""

        def __init__(self) -> None:
            super().__init__('twin')
            self._joint_states = self.create_publisher(
                JointState, TOPIC, qos_profile(TWIN_TOPICS.joint_states)
            )
            self._msg = JointState(name=list(JOINTS))
            self._msg.header.frame_id = FRAME
            self._timer = self.create_timer(1.0 / RATE, self._on_timer)

        def _on_timer(self) -> None:
            late = self._timer.timer_period_ns - self._timer.time_until_next_call()
            now = time.time_ns()
            ticks.append((now - late, now, now))
            self._msg.header.stamp = Time(nanoseconds=now).to_msg()
            self._msg.position = [0.0, 0.0168]
            self._msg.velocity = [0.0, 0.0]
            self._msg.effort = [0.0, 0.0]
            self._joint_states.publish(self._msg)

    rclpy.init(args=[])
    first, last, processor = _watch(Plain(), lambda: len(ticks), seconds)
    return {'ticks': ticks[first:last], 'processor': processor, 'scheduler': 'other'}


def _watch(node: Any, count: Callable[[], int], seconds: float) -> tuple[int, int, float]:
    """Spin, and return the first and last tick once settled, and the part of one core used."""
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin(duration: float, done: Callable[[], bool] = lambda: False) -> None:
        end = time.monotonic() + duration
        while time.monotonic() < end and not done():
            executor.spin_once(timeout_sec=0.1)

    spin(PATIENCE, lambda: node.count_subscribers(TOPIC) > 0)
    spin(SETTLING)
    first, begin, used = count(), time.monotonic(), time.process_time()
    spin(seconds)
    used, passed = time.process_time() - used, time.monotonic() - begin
    return first, count(), used / passed


def _subscribe(_: float) -> dict[str, Any]:
    """Note the stamps of what comes, as bytes, as a recorder would, until nothing comes."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from soft_throw_ros.configuration.interface import TWIN_TOPICS
    from soft_throw_ros.nodes.topics import qos_profile

    rclpy.init(args=[])
    node = Node('subscriber')
    stamps: list[int] = []

    def on_message(data: bytes) -> None:
        stamp, nanoseconds = struct.unpack_from('<iI', data, 4)
        stamps.append(stamp * SECOND + nanoseconds)

    qos = qos_profile(TWIN_TOPICS.joint_states)
    node.create_subscription(JointState, TOPIC, on_message, qos, raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end = time.monotonic() + PATIENCE
    count = 0
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.2)
        if len(stamps) > count:
            count, end = len(stamps), time.monotonic() + 1.0
    return {'received': stamps}


CHILDREN = {'twin': _publish_by_twin, 'timer': _publish_by_timer, 'subscriber': _subscribe}


if __name__ == '__main__':
    if len(sys.argv) == 3:
        print(json.dumps(CHILDREN[sys.argv[1]](float(sys.argv[2]))), flush=True)
        os._exit(0)  # without waiting for the middleware
    print('\n'.join(rows(seconds=float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)))
