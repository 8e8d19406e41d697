# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Effects of a killed or stopped process, or of a full disk: the rows of docs/testing.md.

Two counts are correct in every case. The recorder reports as lost the messages that are missing
from its bag by their sequence numbers. The twin reports at least as many skipped ticks as are
missing by their stamps. A short run of `make soak` follows.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import re
import resource
import signal
import sys
import time
from typing import Any

from bags import read, saved, wait_until
from bench import processes, soak
import numpy as np
import pytest
from rclpy.node import Node
from rosbags.rosbag2 import Reader
import soft_throw_ros
from soft_throw_ros.commands import recover
from soft_throw_ros.configuration.interface import RIG_TOPICS, TWIN_TOPICS
from soft_throw_ros.nodes.topics import Publishers

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

ROOT = Path(__file__).parents[2]
TIMEOUT = 90.0  # longest wait for an event [s]
SETTLING = 2.5  # time for two reports of every node [s]
NAMES = ('viewer', 'recorder', 'subscriber', 'twin')  # in the order of their start
MILLISECOND = 1_000_000  # the period of ticks [ns]
A_SECOND = 5000  # number of messages per second at the highest rate of a twin


class System:
    """A twin, a recorder, a viewer that draws into a file, and a subscriber."""

    def __init__(self, start: Any, start_node: Any, record: Any, folder: Path) -> None:
        self.bags: list[Path] = []
        self.running: dict[str, Any] = {}
        self._folder = folder
        self._heard = folder / 'heard'  # stamps written by the subscriber
        self._start, self._start_node, self._record = start, start_node, record
        for name in NAMES:
            self.start(name)
        self.wait_for_states()

    def start(self, name: str) -> None:
        """Start or restart a process."""
        if name == 'subscriber':
            self._heard.unlink(missing_ok=True)
            command = (sys.executable, '-m', 'bench.soak', '--subscribe', str(self._heard))
            self.running[name] = self._start(*command, cwd=ROOT)
        elif name == 'recorder':
            self.bags.append(self._folder / f'bag{len(self.bags)}')
            self.running[name] = self._record(self.bags[-1].name)
        else:
            rules = ['sink:=file', f'file:={self._folder}/live.rrd'] if name == 'viewer' else []
            self.running[name] = self._start_node(name, *rules)
            self.running[name].wait_for('ready')

    def pids(self, name: str) -> list[int]:
        """Return the process numbers of a node, or of all."""
        names = NAMES if name == 'all' else (name,)
        return [self.running[name].process.pid for name in names]

    def wait_for_states(self) -> None:
        """Wait until recorder and subscriber receive states published after the call."""
        start = time.time_ns()
        self.wait_for_heard(1250)
        wait_until(
            lambda: any(
                topic == processes.STATES and published > start
                for topic, _, _, published, _ in saved(self.bags[-1])
            ),
            TIMEOUT,
        )

    def wait_for_heard(self, count: int) -> None:
        """Wait until the subscriber has received a number of additional states."""

        def size() -> int:
            return self._heard.stat().st_size if self._heard.exists() else 0

        end = size() + 8 * count
        wait_until(lambda: size() >= end, TIMEOUT)

    def end(self) -> tuple[list[processes.RecordedStates], Any, int, int]:
        """
        End all processes, the twin first, and check the counts of missing messages and ticks.

        Return the states in the bags, the stamps of the states that the last subscriber received
        [ns], the skipped ticks, and how many ticks neither it nor the last recorder received.
        """
        time.sleep(SETTLING)
        for name in reversed(NAMES):
            self.running[name].end_well()
        line = self.running['recorder'].lines[-1]
        assert ' lost' in line
        states = [processes.recorded_states(bag) for bag in self.bags]
        steps = np.diff(states[-1].numbers)
        assert (steps > 0).all()
        counted = sum(map(int, re.findall(r'(\d+) of /twin/joint_states', line)))
        assert int((steps - 1).sum()) == counted
        heard = np.fromfile(self._heard, dtype='<i8')
        *_, (reported, _, timing) = (
            row for row in processes.recorded_statuses(self.bags[-1]) if row[1] == '/twin: timing'
        )
        published = np.union1d(states[-1].stamps, heard)
        ticks = np.round(np.diff(published[published < reported]) / MILLISECOND)
        skipped = int(timing['ticks_skipped'])
        assert int((ticks - 1).sum()) <= skipped
        return states, heard, skipped, counted


@pytest.fixture
def system(request, start, start_node, record, tmp_path, monkeypatch):
    """Use UDP for stops: Fast DDS may lose the queue in shared memory of a stopped process."""
    pytest.importorskip('rerun')
    if 'stops' in request.fixturenames:
        # rclpy adds shared memory to the range LOCALHOST; the addresses of the profile are local
        loopback = Path(soft_throw_ros.__path__[0]) / 'config' / 'fastdds_loopback.xml'
        shared = '<transport_id>soft_throw_shared_memory</transport_id>\n          '
        assert shared in loopback.read_text('utf-8')
        profile = tmp_path / 'udp.xml'
        profile.write_text(loopback.read_text('utf-8').replace(shared, ''), 'utf-8')
        monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
        monkeypatch.setenv('ROS_STATIC_PEERS', '127.0.0.1')
    return System(start, start_node, record, tmp_path)


@pytest.mark.once
@pytest.mark.parametrize(
    ('stops', 'late', 'is_lossy'),
    [
        # the last one is like a suspended machine
        ({'subscriber': 2.0, 'viewer': 2.0, 'recorder': 2.0, 'twin': 2.0, 'all': 3.0}, 5.0, False),
        ({'recorder': 8.0}, 0.0, True),  # longer than the history of the twin's publisher
    ],
    ids=['each and all', 'recorder for long'],
)
def test_stopped_processes_resume_with_correct_counts(system, stop, stops, late, is_lossy):
    for name, seconds in stops.items():
        stopped = system.pids(name)
        for pid in stopped:
            stop(pid)
        if is_lossy:
            system.wait_for_heard(round(1000 * seconds))
        else:
            time.sleep(seconds)
        for pid in stopped:
            os.kill(pid, signal.SIGCONT)
        system.wait_for_states()
    (states,), heard, skipped, lost = system.end()
    assert (lost > 1000) if is_lossy else (lost == 0)
    assert skipped > 1000 * (late - 0.2 * len(stops)) or not late
    published = states.stamps[(states.stamps >= heard[0]) & (states.stamps <= heard[-1])]
    assert np.isin(published, heard).all()


@pytest.mark.once
def test_killed_processes_are_started_again_and_nothing_else_is_lost(system, stop, tmp_path):
    killed_ns = {}
    for name in ('viewer', 'twin', 'subscriber', 'recorder'):
        (pid,) = system.pids(name)
        stop(pid)  # at a time at which it holds no lock of the middleware
        killed_ns[name] = time.time_ns()
        os.kill(pid, signal.SIGKILL)
        assert system.running[name].wait() == -signal.SIGKILL
        system.start(name)
        if name != 'recorder':
            system.wait_for_states()
    killed, system.bags[0] = system.bags[0], tmp_path / 'recovered'
    recover.main([str(killed), '--to', str(system.bags[0])])
    system.wait_for_states()
    (both, last), *_, lost = system.end()
    assert lost == last.lost == 0
    for part in (both.stamps < killed_ns['twin'], both.stamps >= killed_ns['twin']):  # two twins
        assert processes.RecordedStates(*(column[part] for column in both)).lost == 0


@pytest.mark.once
def test_promises_are_kept_for_half_a_minute(domain_id, capsys):
    pytest.importorskip('rerun')
    code = soak.main(['--minutes', '0.5'])
    output = capsys.readouterr().out
    assert code == 0, output
    assert output.count(' | yes |') == 6


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


def count_in(path: Path) -> int:
    """Return the number of messages of a closed bag, by the reader of rosbags."""
    with Reader(path) as bag:
        count = len(list(bag.messages()))
        assert count == bag.message_count
    return count


def end_recorder(recorder: Any, code: int = 0) -> tuple[int, int]:
    """End a recorder; return its numbers of recorded and lost messages from its log."""
    recorder.end_well(code=code)
    line = recorder.lines[-1]
    counts = re.search(r'(\d+) messages in .* s, (\d+) lost', line)
    assert counts is not None, line
    return int(counts[1]), int(counts[2])


@pytest.mark.once
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
    assert count_in(path) == received - lost > 100
    states = [number for *_, number in read(path, publisher.topic)]
    assert states == list(range(states[0], states[0] + len(states)))


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
    assert count_in(path) == publisher.count - late
