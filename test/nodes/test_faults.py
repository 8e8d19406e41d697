# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Effects of a killed or stopped process, or of a full disk: the rows of docs/testing.md.

In every case the recorder counts the messages that are missing from its bag by their sequence
numbers, and the twin at least as many skipped ticks as are missing by their stamps.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
import re
import resource
import signal
import sys
import time
from typing import Any

from bags import saved, wait_until
from bench import processes, soak
import numpy as np
import pytest
from rclpy.node import Node
from rosbags.rosbag2 import Reader
import soft_throw_ros
from soft_throw_ros.commands import recover
from soft_throw_ros.configuration.interface import RIG_TOPICS, Topic, TWIN_TOPICS
from soft_throw_ros.nodes.topics import Publishers
from soft_throw_ros.storage.message import SECOND

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

TIMEOUT = 90.0  # longest wait for an event [s]
NAMES = ('recorder', 'subscriber', 'twin')  # in the order of their start
A_SECOND = 5000  # number of messages per second at the highest rate of a twin


class System:
    """A twin, a recorder and a subscriber."""

    def __init__(self, start: Any, start_node: Any, record: Any, folder: Path) -> None:
        self.bags: list[Path] = []
        self.running: dict[str, Any] = {}
        self._folder = folder
        self.heard = folder / 'heard'  # stamps written by the subscriber
        self._start, self._start_node, self._record = start, start_node, record
        for name in NAMES:
            self.start(name)
        self.wait_for_states()

    def start(self, name: str) -> None:
        """Start or restart a process."""
        if name == 'subscriber':
            self.heard.write_bytes(b'')
            command = (sys.executable, '-m', 'bench.soak', '--subscribe', str(self.heard))
            self.running[name] = self._start(*command, cwd=processes.ROOT)
        elif name == 'recorder':
            self.bags.append(self._folder / f'bag{len(self.bags)}')
            self.running[name] = self._record(self.bags[-1].name)
        else:
            self.running[name] = self._start_node(name)
            self.running[name].wait_for('ready')

    def wait_for_heard(self, count: int) -> None:
        """Wait until the subscriber has received a number of additional states."""
        end = self.heard.stat().st_size + 8 * count
        wait_until(lambda: self.heard.stat().st_size >= end, TIMEOUT)

    def wait_for_states(self) -> None:
        """Wait until recorder and subscriber receive states published after the call."""
        start = time.time_ns()
        self.wait_for_heard(1250)
        is_new = lambda row: row[0] == processes.STATES and row[3] > start  # noqa: E731
        wait_until(lambda: any(map(is_new, saved(self.bags[-1]))), TIMEOUT)


@pytest.fixture
def udp(tmp_path, monkeypatch):
    """Use UDP: Fast DDS may lose the queue in shared memory of a process that is stopped."""
    # rclpy adds shared memory to the range LOCALHOST; the addresses of the profile are local
    text = Path(soft_throw_ros.__path__[0], 'config/fastdds_loopback.xml').read_text('utf-8')
    shared = '<transport_id>soft_throw_shared_memory</transport_id>\n          '
    assert shared in text
    profile = tmp_path / 'udp.xml'
    profile.write_text(text.replace(shared, ''), 'utf-8')
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    monkeypatch.setenv('ROS_STATIC_PEERS', '127.0.0.1')


@pytest.mark.once
def test_killed_and_stopped_processes_go_on_with_correct_counts(
    udp, start, start_node, record, stop, tmp_path
):
    system = System(start, start_node, record, tmp_path)
    killed_ns = {}
    for name in ('twin', 'subscriber', 'recorder'):
        system.wait_for_states()
        stop(system.running[name].process.pid)  # while it holds no lock of the middleware
        killed_ns[name] = time.time_ns()
        assert system.running[name].end(signal.SIGKILL) == -signal.SIGKILL
        system.start(name)
    system.wait_for_states()
    for names, seconds in (
        *(((name,), 2.0) for name in NAMES),
        (NAMES, 3.0),  # like a suspended machine
        (('recorder',), 8.0),  # longer than the history of the twin's publisher
    ):
        begin, stopped = time.time_ns(), [system.running[name].process for name in names]
        for process in stopped:
            stop(process.pid)
        if seconds == 8.0:
            system.wait_for_heard(round(processes.RATE * seconds))
        else:
            time.sleep(seconds)
        for process in stopped:
            process.send_signal(signal.SIGCONT)
        system.wait_for_states()
    time.sleep(2.5)  # two reports of every node
    for name in reversed(NAMES):
        system.running[name].end_well()

    # The killed recorder has lost nothing of either twin
    recover.main([str(system.bags[0]), '--to', str(tmp_path / 'recovered')])
    both = processes.recorded_states(tmp_path / 'recovered')
    for part in (both.stamps < killed_ns['twin'], both.stamps >= killed_ns['twin']):
        assert processes.RecordedStates(*(column[part] for column in both)).lost == 0
    # The other one has counted what it lost in the longest stop
    states = processes.recorded_states(system.bags[1])
    steps = np.diff(states.numbers)
    assert (steps > 0).all()
    assert states.published[1:][steps > 1].min() > begin
    line = system.running['recorder'].lines[-1]
    counted = sum(map(int, re.findall(r'(\d+) of /twin/joint_states', line)))
    assert states.lost == counted > 1000
    # The subscriber has received all, and the twin has counted all ticks that it skipped
    heard = np.fromfile(system.heard, dtype='<i8')
    published = states.stamps[(states.stamps >= heard[0]) & (states.stamps <= heard[-1])]
    assert np.isin(published, heard).all()
    statuses = processes.recorded_statuses(system.bags[1])
    *_, (reported, _, timing) = (row for row in statuses if row[1] == '/twin: timing')
    stamps = np.union1d(states.stamps, heard)
    ticks = np.round(np.diff(stamps[stamps < reported]) * processes.RATE / SECOND)
    assert int((ticks - 1).sum()) <= int(timing['ticks_skipped'])
    assert int(timing['ticks_skipped']) > 4000


@pytest.mark.once
def test_promises_are_kept_for_half_a_minute(domain_id, capsys):
    pytest.importorskip('rerun')
    code = soak.main(['--minutes', '0.5'])
    output = capsys.readouterr().out
    assert code == 0, output
    assert output.count(' | yes |') == 6


class Publisher:
    """A publisher of joint states in this process."""

    def __init__(self, ros: Any, row: Topic) -> None:
        node = ros.node(Node, 'twin')
        self.count = 0  # number of published messages
        self._send = partial(Publishers(node, [row]).send, row)
        self._values = (0.0,) * len(row.joints) * len(row.quantities)
        self._publisher = next(p for p in node.publishers if 'joint_states' in p.topic_name)
        self.topic = self._publisher.topic_name

    def publish(self, count: int, done: Callable[[], bool] = lambda: True) -> None:
        """Publish a number of messages 100 times a second until a condition holds."""

        def is_done() -> bool:
            for _ in range(count):
                self._send(time.time_ns(), self._values)
            self.count += count
            return done()

        wait_until(self._publisher.get_subscription_count, TIMEOUT)
        wait_until(is_done, TIMEOUT)


def end(recorder: Any, path: Path, code: int = 0) -> tuple[int, list[int]]:
    """End a recorder, and check its bag; return how many are lost, and the numbers of states."""
    recorder.end_well(code=code)
    counts = re.search(r'(\d+) messages in .* s, (\d+) lost', recorder.lines[-1])
    received, lost = map(int, counts.groups())
    if code:
        assert f'`soft-throw recover {path}`' in recorder.lines[-1]
        recover.main([str(path), '--to', str(path := path.with_name('whole'))])
    with Reader(path) as bag:  # of rosbags
        assert len(list(bag.messages())) == bag.message_count == received - lost
    return lost, [row[-1] for row in saved(path) if row[0].endswith('joint_states')]


@pytest.mark.once
def test_full_disk_is_reported_every_second_and_the_bag_is_completed_later(ros, record, tmp_path):
    full, limits = resource.RLIMIT_FSIZE, resource.getrlimit(resource.RLIMIT_FSIZE)
    publisher, path = Publisher(ros, TWIN_TOPICS.joint_states), tmp_path / 'bag'
    recorder = record(
        'bag', 'compression:=none',
        preexec_fn=lambda: resource.setrlimit(full, (150_000, limits[1])),
    )
    publisher.publish(10, lambda: sum('too large' in x for x in recorder.lines) >= 2)
    assert any(re.search(r'too large; [1-9]\d* messages wait, 0 are', x) for x in recorder.lines)
    resource.prlimit(recorder.process.pid, full, limits)
    before = publisher.count
    publisher.publish(1, lambda: len(saved(path)) >= before)
    resource.prlimit(recorder.process.pid, full, (0, limits[1]))  # for ever
    publisher.publish(10)
    _, states = end(recorder, path, code=1)
    assert len(states) > 0.9 * before
    assert states == list(range(states[0], states[-1] + 1))


@pytest.mark.parametrize('row', [TWIN_TOPICS.joint_states, RIG_TOPICS.measured_joint_states])
def test_a_second_of_messages_at_5_khz_waits_for_a_recorder_that_is_stopped(
    ros, stop, record, tmp_path, row
):
    publisher, path = Publisher(ros, row), tmp_path / 'bag'
    recorder = record('bag', f'topics:=[{publisher.topic}]')
    publisher.publish(1, lambda: len(saved(path)) >= 10)
    stop(recorder.process.pid)
    publisher.publish(A_SECOND)
    recorder.process.send_signal(signal.SIGCONT)
    publisher.publish(1, lambda: len(saved(path)) > A_SECOND)
    # The publisher may know the recorder before the recorder knows it: these messages are late.
    late = saved(path)[0][-1] - 1
    wait_until(lambda: len(saved(path)) >= publisher.count - late)
    assert end(recorder, path) == (0, list(range(late + 1, publisher.count + 1)))
