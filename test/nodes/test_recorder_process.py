# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The recorder as a process that is stopped, killed or cannot write."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
import random
import re
import resource
import signal
from test.nodes.conftest import end_recorder
import threading
import time
from typing import Any

from bags import saved
from diagnostic_msgs.msg import DiagnosticArray
import pytest
from rclpy.node import Node
from rosbags.rosbag2 import Reader
from soft_throw_ros.commands import recover
from soft_throw_ros.configuration.interface import RECORDER_TOPICS, TWIN_TOPICS
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.topics import create_subscription, Publishers
from soft_throw_ros.recording.bag_reader import BagReader


@pytest.fixture
def talk(ros: Any) -> Iterator[None]:
    """Publish 1000 states a second, and a latched journal, as a twin does, from this process."""
    publishers = Publishers(
        ros.node(RunnableNode, 'twin'), [TWIN_TOPICS.joint_states, TWIN_TOPICS.journal]
    )
    publishers.send(TWIN_TOPICS.journal, '{"kind":"none","step":0}')
    is_over = threading.Event()

    def publish() -> None:
        while not is_over.wait(0.01):
            for _ in range(10):
                publishers.send(TWIN_TOPICS.joint_states, time.time_ns(), (0.0,) * 6)

    thread = threading.Thread(target=publish, daemon=True)
    thread.start()
    yield
    is_over.set()
    thread.join(20.0)


def wait_for_states(ros: Any, path: Path, count: int) -> None:
    """Wait until a number of states and the journal are flushed to a bag."""

    def has_enough() -> bool:
        if not (path / 'metadata.yaml').is_file():
            return False
        found = Counter(topic for topic, *_ in saved(path))
        return found['/twin/joint_states'] >= count and found['/twin/journal'] > 0

    ros.spin_until(has_enough, f'{count} states in {path}')


@pytest.mark.slow
def test_recorder_that_is_killed_loses_at_most_the_last_second(
    record, ros, talk, tmp_path
) -> None:
    path, recovered = tmp_path / 'bag', tmp_path / 'recovered'
    recorder = record('bag')
    wait_for_states(ros, path, 100)
    time.sleep(random.uniform(0.0, 1.0))  # to any time between two flushes
    killed = time.time_ns()
    assert recorder.end(signal.SIGKILL) == -signal.SIGKILL
    recover.main([str(path), '--to', str(recovered)])
    with Reader(recovered) as bag:
        stamps = [stamp for _, stamp, _ in bag.messages()]
        recorded = {connection.topic for connection in bag.connections}
    assert {'/twin/joint_states', '/twin/journal'} <= recorded
    assert killed - stamps[-1] < 10**9
    assert len(stamps) > 100


@pytest.mark.once
@pytest.mark.parametrize('is_for_ever', [True, False])
def test_full_disk_is_reported_every_second_and_the_bag_is_completed_later(
    record, ros, talk, tmp_path, is_for_ever
) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def let_files_be_small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, limits[1]))

    path = tmp_path / 'bag'
    recorder = record('bag', 'compression:=none', preexec_fn=let_files_be_small)
    recorder.wait_until(lambda lines: sum('too large' in line for line in lines) >= 2)
    assert any(re.search(r'too large; [1-9]\d* messages wait, 0 are', x) for x in recorder.lines)
    if not is_for_ever:
        resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, limits)
        wait_for_states(ros, path, 3000)
    received, lost, _ = end_recorder(recorder, code=int(is_for_ever))
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
        states = [message.sequence for message in own.messages('/twin/joint_states')]
        assert own.damage == ''
    assert states == list(range(states[0], states[0] + len(states)))


def test_recorder_loses_nothing_by_a_viewer_that_hangs(record, ros, talk, tmp_path) -> None:
    python = tmp_path / 'viewer'
    python.write_text('#!/bin/sh\nexec sleep 60\n')
    python.chmod(0o755)
    recorder = record('bag', 'rerun.sink:=viewer', f'rerun.python:={python}')
    heard: list[Any] = []

    def take(message: DiagnosticArray) -> None:
        heard.extend(item for item in message.status if item.name == '/recorder: viewer')

    create_subscription(ros.node(Node, 'listener'), RECORDER_TOPICS.diagnostics, take)
    wait_for_states(ros, tmp_path / 'bag', 100)
    ros.spin_until(lambda: heard and msg_to_values(heard[-1])['starts'] == 1, 'the viewer')
    begin = time.monotonic()
    _, lost, _ = end_recorder(recorder, signal.SIGHUP)
    assert time.monotonic() - begin < 20.0  # not as long as that sleeps
    assert lost == 0
