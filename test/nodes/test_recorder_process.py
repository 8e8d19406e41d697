# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process: stopped, killed, started late, or without room on the disk."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
import random
import re
import resource
import signal
import subprocess
import sys
import time
from typing import Any

from bags import saved
import pytest
from rosbags.rosbag2 import Reader
from soft_throw_ros.commands import recover
from soft_throw_ros.storage.bag_reader import BagReader

PUBLISHER = """
import select, sys, time
import rclpy
from soft_throw_ros.configuration.interface import RIG_TOPICS, TWIN_TOPICS
from soft_throw_ros.nodes.topics import Publishers
from soft_throw_ros.nodes.transport import use_transport_profile

use_transport_profile()
rclpy.init()
node = rclpy.create_node('twin')
reliable = sys.argv[1] == 'reliable'
topic = TWIN_TOPICS.joint_states if reliable else RIG_TOPICS.measured_joint_states
publishers = Publishers(node, [topic])
(publisher,) = (item for item in node.publishers if 'joint_states' in item.topic_name)
values = (0.0,) * (6 if reliable else 2)
while line := sys.stdin.readline():
    count, period = line.split()
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    for number in range(int(count)):
        publishers.send(topic, time.time_ns(), values)
        if select.select([sys.stdin], [], [], float(period))[0]:  # the next request
            count = number + 1
            break
    print(f'published {count}', flush=True)
"""

A_SECOND = 5000
"""Number of messages per second at the highest rate of a twin."""


class Publisher:
    """A process that publishes on request to subscribers, 'reliable' or 'best effort'."""

    def __init__(self, start: Any, kind: str) -> None:
        self.topic = f'/twin/{"" if kind == "reliable" else "measured_"}joint_states'
        command = (sys.executable, '-c', PUBLISHER, kind)
        self.process = start(*command, stdin=subprocess.PIPE)

    @property
    def count(self) -> int:
        """Number of published messages."""
        return sum(int(line.split()[-1]) for line in self.process.lines if 'published' in line)

    def publish(self, count: int, *, period: float = 0.0) -> None:
        """Publish `count` messages."""
        before = len(self.process.lines)
        self._request(f'{count} {period}')
        self.process.wait_until(lambda lines: f'published {count}' in lines[before:])

    def begin(self, *, period: float) -> None:
        """Publish messages until the next request."""
        self._request(f'1000000 {period}')

    def _request(self, line: str) -> None:
        stdin = self.process.process.stdin
        stdin.write(f'{line}\n')
        stdin.flush()


def numbers(path: Path) -> list[int]:
    """Read the publisher's sequence numbers from a bag, which may still be open for writing."""
    return [number for *_, number in saved(path)]


def wait_for(recorder: Any, path: Path, count: int) -> None:
    """Wait until a bag has `count` messages; DDS needs time to resend reliable messages."""
    deadline = time.monotonic() + 20.0
    while len(present := numbers(path)) < count:
        assert recorder.process.poll() is None
        if time.monotonic() > deadline:
            gaps = [(a, b) for a, b in pairwise(present) if b != a + 1]
            limits = f'from {present[:1]} to {present[-1:]}'
            pytest.fail(f'{len(present)} of {count} messages, {limits}; {gaps=}')
        time.sleep(0.05)


def count(path: Path) -> int:
    """Count the messages of a closed bag with the reader of rosbags."""
    with Reader(path) as bag:
        assert sum(1 for _ in bag.messages()) == bag.message_count
        return int(bag.message_count)


def end_recorder(recorder: Any, code: int = 0) -> tuple[int, int]:
    """End a recorder; return its numbers of recorded and lost messages from its log."""
    recorder.end_well(code=code)
    line = recorder.lines[-1]
    counts = re.search(r'(\d+) messages in .* s, (\d+) lost', line)
    assert counts is not None, line
    return int(counts[1]), int(counts[2])


@pytest.mark.slow
def test_recorder_that_is_killed_loses_at_most_the_last_second(start, record, tmp_path) -> None:
    publisher, path = Publisher(start, 'reliable'), tmp_path / 'bag'
    recorder = record('bag')
    publisher.begin(period=0.001)
    wait_for(recorder, path, 100)
    time.sleep(random.uniform(0.0, 1.0))  # to any time between two flushes
    killed = time.time_ns()
    assert recorder.end(signal.SIGKILL) == -signal.SIGKILL
    recover.main([str(path), '--to', str(tmp_path / 'recovered')])
    with Reader(tmp_path / 'recovered') as bag:
        stamps = [stamp for _, stamp, _ in bag.messages()]
    assert killed - stamps[-1] < 10**9
    assert len(stamps) > 100


@pytest.mark.once
@pytest.mark.parametrize('is_for_ever', [pytest.param(True, marks=pytest.mark.slow), False])
def test_full_disk_is_reported_every_second_and_the_bag_is_completed_later(
    start, record, tmp_path, is_for_ever
) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def let_files_be_small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, limits[1]))

    publisher, path = Publisher(start, 'reliable'), tmp_path / 'bag'
    recorder = record('bag', 'compression:=none', preexec_fn=let_files_be_small)
    publisher.begin(period=0.001)
    recorder.wait_until(lambda lines: sum('too large' in line for line in lines) >= 2)
    assert any(re.search(r'too large; [1-9]\d* messages wait, 0 are', x) for x in recorder.lines)
    if not is_for_ever:
        resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, limits)
        wait_for(recorder, path, 3000)
    received, lost = end_recorder(recorder, code=int(is_for_ever))
    if is_for_ever:
        assert f'`soft-throw recover {path}`' in recorder.lines[-1]
        recover.main([str(path), '--to', str(tmp_path / 'whole')])
        path = tmp_path / 'whole'
    else:
        assert lost == 0
    with Reader(path) as bag:
        assert bag.message_count == received - lost > 100
        assert sum(1 for _ in bag.messages()) == bag.message_count
    with BagReader(path) as own:
        states = [message.sequence for message in own.messages(['/twin/joint_states'])]
    assert states == list(range(states[0], states[0] + len(states)))


@pytest.mark.parametrize(
    'kind', ['reliable', pytest.param('best effort', marks=pytest.mark.slow)]
)
def test_a_second_of_messages_at_5_khz_waits_for_a_recorder_that_is_stopped(
    start, stop, record, tmp_path, kind
) -> None:
    publisher, path = Publisher(start, kind), tmp_path / 'bag'
    recorder = record('bag', f'topics:=[{publisher.topic}]')
    # The publisher may know the recorder before the recorder knows it: these messages are late.
    publisher.begin(period=0.005)
    wait_for(recorder, path, 10)
    publisher.publish(0)  # pause the publisher
    stop(recorder.process.pid)
    publisher.publish(A_SECOND)
    recorder.process.send_signal(signal.SIGCONT)
    publisher.publish(10, period=0.1)
    late = numbers(path)[0] - 1
    wait_for(recorder, path, publisher.count - late)
    assert end_recorder(recorder) == (publisher.count - late, 0)
    assert count(path) == publisher.count - late
