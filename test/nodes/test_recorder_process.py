# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process: what is left when it, or the disk, comes to a sudden end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
import random
import re
import resource
import shutil
import signal
import sys
import threading
import time
from typing import Any

import pytest
from rclpy.node import Node
from rosbags.rosbag2 import Reader
from soft_throw_ros.commands import recover
from soft_throw_ros.nodes import topics
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.cdr import JointStateEncoder
from soft_throw_ros.twin.results import State

TWIN = [sys.executable, '-m', 'soft_throw_ros', 'twin', '--ros-args', '-p', 'throw.period:=0.3']
RECORDER = [sys.executable, '-m', 'soft_throw_ros', 'recorder', '--ros-args']


@pytest.fixture
def record(start: Any, tmp_path: Path) -> Callable[..., Any]:
    """Start recorders into a temporary folder."""

    def record(name: str, *rules: str, **kwargs: Any) -> Any:
        words = [f'folder:={tmp_path}', f'name:={name}', *rules]
        return start(*RECORDER, *[word for rule in words for word in ('-p', rule)], **kwargs)

    return record


@pytest.fixture
def talk(ros: Any) -> Iterator[None]:
    """Publish 1000 states a second, and a latched journal, as a twin does, from this process."""
    node = ros.node(Node, 'talker')
    states = node.create_publisher(
        topics.JOINT_STATES.type, '/twin/joint_states', topics.JOINT_STATES.qos
    )
    journal = node.create_publisher(topics.JOURNAL.type, '/twin/journal', topics.JOURNAL.qos)
    journal.publish(topics.JOURNAL.type(data='{"kind":"none","step":0}'))
    encode = JointStateEncoder('rig', ('plate', 'projectile')).encode
    is_over = threading.Event()

    def publish() -> None:
        while not is_over.wait(0.01):
            for _ in range(10):
                states.publish(encode(time.time_ns(), State(*[0.0] * 6)))

    thread = threading.Thread(target=publish, daemon=True)
    thread.start()
    yield
    is_over.set()
    thread.join(20.0)


def wait_for_states(ros: Any, path: Path, count: int) -> None:
    """Wait until so many states, and the journal, are in a bag to stay."""

    def has_enough() -> bool:
        if not (path / 'metadata.yaml').is_file():
            return False
        with BagReader(path) as bag:
            found = Counter(message.channel.topic for message in bag.messages())
        return found['/twin/joint_states'] >= count and found['/twin/journal'] > 0

    ros.spin_until(has_enough, f'{count} states in {path}')


def test_recorder_and_twin_in_two_processes(start, record, ros, tmp_path) -> None:
    recorder = record('bag')
    recorder.wait_for('ready')
    twin = start(*TWIN)
    wait_for_states(ros, tmp_path / 'bag', 500)
    assert recorder.end(signal.SIGINT) == 0
    assert twin.end(signal.SIGINT) == 0
    assert not any('Traceback' in line for line in recorder.lines), recorder.lines
    assert ' 0 lost, in ' in recorder.lines[-1]
    with Reader(tmp_path / 'bag') as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
    assert counts['/twin/joint_states'] >= 500
    assert {f'/twin/{name}' for name in ('journal', 'phase', 'recommendation')} <= counts.keys()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_recorder_ends_well_by_a_signal(record, ros, talk, tmp_path, number) -> None:
    recorder = record('bag')
    wait_for_states(ros, tmp_path / 'bag', 100)
    assert recorder.end(number) == 0
    assert not any('Traceback' in line for line in recorder.lines), recorder.lines
    assert ' 0 lost, in ' in recorder.lines[-1]


def test_recorder_that_is_killed_loses_at_most_the_last_second(
    record, ros, talk, tmp_path
) -> None:
    chance = random.Random(1)
    for number in range(3):
        path = tmp_path / f'bag{number}'
        recorder = record(path.name)
        wait_for_states(ros, path, 100)
        time.sleep(chance.uniform(0.0, 1.0))
        killed = time.time_ns()
        assert recorder.end(signal.SIGKILL) == -signal.SIGKILL
        recovered = tmp_path / f'recovered{number}'
        recover.main([str(path), '--to', str(recovered)])
        with Reader(recovered) as bag:
            stamps = [stamp for _, stamp, _ in bag.messages()]
            topics_ = {connection.topic for connection in bag.connections}
        assert '/twin/joint_states' in topics_
        assert '/twin/journal' in topics_
        assert killed - stamps[-1] < 10**9
        states = [stamp for stamp in stamps if stamp < stamps[-1]]
        assert len(states) > 100


@pytest.mark.parametrize('has_room_again', [False, True])
def test_full_disk_is_told_every_second_and_recording_goes_on_when_there_is_room(
    record, ros, talk, tmp_path, has_room_again
) -> None:
    limit = 150_000
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def let_files_be_small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limits[1]))

    recorder = record('bag', 'compression:=none', preexec_fn=let_files_be_small)
    recorder.wait_for('File too large')
    ros.spin_until(
        lambda: sum('messages wait' in line for line in recorder.lines) >= 2, 'it again'
    )
    if has_room_again:
        resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, limits)
        wait_for_states(ros, tmp_path / 'bag', 3000)
    assert recorder.end(signal.SIGINT) == 0
    assert not any('Traceback' in line for line in recorder.lines), recorder.lines
    assert (' 0 lost' in recorder.lines[-1]) == has_room_again
    with BagReader(tmp_path / 'bag') as bag:
        states = [message.sequence for message in bag.messages('/twin/joint_states')]
        assert bool(bag.damage) != has_room_again
    assert states == list(range(states[0], states[0] + len(states)))
    assert len(states) > (3000 if has_room_again else 100)


def test_folder_that_is_deleted_is_told_and_nothing_of_it_is_counted_as_recorded(
    record, ros, talk, tmp_path
) -> None:
    recorder = record('bag')
    wait_for_states(ros, tmp_path / 'bag', 100)
    shutil.rmtree(tmp_path / 'bag')
    recorder.wait_for('deleted')
    assert recorder.end(signal.SIGINT) == 1
    received, lost = re.search(r'(\d+) messages in .* s, (\d+) lost', recorder.lines[-1]).groups()
    assert received == lost


@pytest.mark.parametrize('name', ['../bag', '/tmp/bag', 'a/b', '..'])
def test_name_that_leads_out_of_the_folder_is_refused(record, tmp_path, name) -> None:
    recorder = record(name)
    assert recorder.wait() == 2
    assert repr(name) in recorder.lines[-1]
    assert list(tmp_path.iterdir()) == []


def test_place_that_cannot_be_written_is_told_until_it_can(record, ros, talk, tmp_path) -> None:
    place = tmp_path / 'place'
    place.write_text('in the way')
    recorder = record('bag', f'folder:={place}')
    recorder.wait_for('messages wait')
    assert any(f'{place / "bag"}: Not a directory' in line for line in recorder.lines)
    place.unlink()
    wait_for_states(ros, place / 'bag', 100)
    assert recorder.end(signal.SIGINT) == 0
    assert ' 0 lost, in ' in recorder.lines[-1]
    with Reader(place / 'bag') as bag:
        assert bag.message_count > 100


@pytest.mark.parametrize('hangs', [True, False])
def test_viewer_that_hangs_or_fails_costs_no_message(record, ros, talk, tmp_path, hangs) -> None:
    program = tmp_path / 'program'
    sleep = f'exec {sys.executable} -c "import time; time.sleep(60)"'
    program.write_text(f'#!/bin/sh\n{sleep if hangs else "exit 1"}\n')
    program.chmod(0o755)
    heard: list[Any] = []
    listener = ros.node(Node, 'listener')
    listener.create_subscription(
        topics.DIAGNOSTICS.type, '/diagnostics', heard.append, topics.DIAGNOSTICS.qos
    )
    recorder = record('bag', 'rerun.sink:=viewer', f'rerun.python:={program}')

    def is_told() -> bool:
        statuses = [status for message in heard for status in message.status]
        viewer = [status for status in statuses if status.name.endswith('recorder: viewer')]
        return bool(viewer) and msg_to_values(viewer[-1])['starts'] >= (1 if hangs else 2)

    ros.spin_until(is_told, 'the viewer')
    wait_for_states(ros, tmp_path / 'bag', 100)
    begin = time.monotonic()
    assert recorder.end(signal.SIGINT) == 0
    assert time.monotonic() - begin < 20.0  # not as long as that sleeps
    assert ' 0 lost' in recorder.lines[-1]
