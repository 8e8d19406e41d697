# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process: stopped, killed, started late, or without room on the disk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import resource
import signal
import time
from typing import Any

from bags import saved, wait_until
import pytest
from rclpy.node import Node
from rosbags.rosbag2 import Reader
from soft_throw_ros.commands import recover
from soft_throw_ros.configuration.interface import RIG_TOPICS, TWIN_TOPICS
from soft_throw_ros.nodes.topics import Publishers
from soft_throw_ros.storage.bag_reader import BagReader

A_SECOND = 5000
"""Number of messages per second at the highest rate of a twin."""

TIMEOUT = 60.0
"""Longest wait for an effect of another process. [s]"""


class Publisher:
    """A publisher of joint states in this process, 'reliable' or 'best effort'."""

    def __init__(self, ros: Any, kind: str) -> None:
        is_reliable = kind == 'reliable'
        self.topic = f'/twin/{"" if is_reliable else "measured_"}joint_states'
        self.count = 0  # number of published messages
        node = ros.node(Node, 'twin')
        self._row = TWIN_TOPICS.joint_states if is_reliable else RIG_TOPICS.measured_joint_states
        self._publishers = Publishers(node, [self._row])
        self._values = (0.0,) * (6 if is_reliable else 2)
        self._publisher = next(p for p in node.publishers if p.topic_name == self.topic)

    def publish(self, count: int = 1) -> None:
        """Publish messages, as soon as there is a subscriber."""
        deadline = time.monotonic() + TIMEOUT
        while not self._publisher.get_subscription_count():
            assert time.monotonic() < deadline, 'no subscriber'
            time.sleep(0.01)
        for _ in range(count):
            self._publishers.send(self._row, time.time_ns(), self._values)
        self.count += count

    def publish_until(self, done: Callable[[], bool], period: float = 0.001) -> None:
        """Publish periodically until a condition holds."""
        deadline = time.monotonic() + TIMEOUT
        while not done():
            assert time.monotonic() < deadline
            self.publish()
            time.sleep(period)


def stamps_in(path: Path) -> list[int]:
    """Return the times of the messages of a closed bag, by the reader of rosbags [ns]."""
    with Reader(path) as bag:
        stamps = [stamp for _, stamp, _ in bag.messages()]
        assert len(stamps) == bag.message_count
    return stamps


def end_recorder(recorder: Any, code: int = 0) -> tuple[int, int]:
    """End a recorder; return its numbers of recorded and lost messages from its log."""
    recorder.end_well(code=code)
    line = recorder.lines[-1]
    counts = re.search(r'(\d+) messages in .* s, (\d+) lost', line)
    assert counts is not None, line
    return int(counts[1]), int(counts[2])


@pytest.mark.once
@pytest.mark.slow
@pytest.mark.parametrize('is_for_ever', [True, False])
def test_full_disk_is_reported_every_second_and_the_bag_is_completed_later(
    ros, record, tmp_path, is_for_ever
) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def let_files_be_small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, limits[1]))

    publisher, path = Publisher(ros, 'reliable'), tmp_path / 'bag'
    recorder = record('bag', 'compression:=none', preexec_fn=let_files_be_small)
    publisher.publish_until(lambda: sum('too large' in line for line in recorder.lines) >= 2)
    assert any(re.search(r'too large; [1-9]\d* messages wait, 0 are', x) for x in recorder.lines)
    if not is_for_ever:
        resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, limits)
        before = publisher.count
        publisher.publish_until(lambda: len(saved(path)) >= before, 0.01)
    received, lost = end_recorder(recorder, code=int(is_for_ever))
    if is_for_ever:
        assert f'`soft-throw recover {path}`' in recorder.lines[-1]
        recover.main([str(path), '--to', str(tmp_path / 'whole')])
        path = tmp_path / 'whole'
    else:
        assert lost == 0
    assert len(stamps_in(path)) == received - lost > 100
    with BagReader(path) as own:
        states = [message.sequence for message in own.messages(['/twin/joint_states'])]
    assert states == list(range(states[0], states[0] + len(states)))


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['reliable', 'best effort'])
def test_a_second_of_messages_at_5_khz_waits_for_a_recorder_that_is_stopped(
    ros, stop, record, tmp_path, kind
) -> None:
    publisher, path = Publisher(ros, kind), tmp_path / 'bag'
    recorder = record('bag', f'topics:=[{publisher.topic}]')
    # The publisher may know the recorder before the recorder knows it: these messages are late.
    publisher.publish_until(lambda: len(saved(path)) >= 10, 0.005)
    stop(recorder.process.pid)
    publisher.publish(A_SECOND)
    recorder.process.send_signal(signal.SIGCONT)
    for _ in range(10):
        publisher.publish()
        time.sleep(0.1)
    late = saved(path)[0][-1] - 1
    wait_until(lambda: len(saved(path)) >= publisher.count - late)
    assert end_recorder(recorder) == (publisher.count - late, 0)
    assert len(stamps_in(path)) == publisher.count - late
