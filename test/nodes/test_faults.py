# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Effects of a killed or stopped process on the others: the rows of docs/testing.md.

Two counts are correct in every case. The recorder reports as lost the messages that are missing
from its bag by their sequence numbers. The twin reports at least as many skipped ticks as are
missing by their stamps. A short run of `make soak` follows.
"""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import os
from pathlib import Path
import re
import signal
import sys
import time
from typing import Any, NamedTuple

from bench import processes, soak
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
import numpy as np
import pytest
import soft_throw_ros
from soft_throw_ros.commands import recover

pytestmark = [pytest.mark.slow, pytest.mark.once, pytest.mark.timeout(180)]

ROOT = Path(__file__).parents[2]
SOFT_THROW = (sys.executable, '-m', 'soft_throw_ros')
TIMEOUT = 90.0
"""Longest wait for an event. [s]"""

SETTLING = 2.5
"""Time for two reports of every node. [s]"""

NAMES = ('viewer', 'recorder', 'subscriber', 'twin')
"""Processes in the order of their start."""

MILLISECOND = 1_000_000
"""One millisecond, the period of ticks. [ns]"""


class Outcome(NamedTuple):
    """Bags and counts after the end of a system."""

    bags: list[processes.RecordedStates]  # read by the mcap library
    missing: int  # states that the last bag lacks, as logged by its recorder
    heard: np.ndarray  # stamps of the states that the last subscriber received [ns]
    reported: int  # time of the last report of the twin [ns]
    ticks_skipped: int  # in that report

    @property
    def published(self) -> np.ndarray:
        """Stamps of all states received by the last recorder or subscriber [ns]."""
        return np.union1d(self.bags[-1].stamps, self.heard)

    @property
    def ticks_missing(self) -> int:
        """Number of ticks before the last report that neither received."""
        steps = np.diff(self.published[self.published < self.reported]) / MILLISECOND
        return int((np.round(steps) - 1).sum())


class System:
    """A twin, a recorder, a viewer that draws into a file, and a subscriber."""

    def __init__(self, start: Callable[..., Any], folder: Path) -> None:
        self.bags: list[Path] = []
        self.running: dict[str, Any] = {}
        self._start = start
        self._folder = folder
        self._heard = folder / 'heard'  # stamps written by the subscriber
        for name in NAMES:
            self.start(name)
        self.wait_for_states()

    def start(self, name: str) -> None:
        """Start or restart a process."""
        if name == 'recorder':
            self.bags.append(self._folder / f'bag{len(self.bags)}')
            rules = (f'folder:={self._folder}', f'name:={self.bags[-1].name}')
            words = [word for rule in rules for word in ('-p', rule)]
            process = self._start(*SOFT_THROW, name, '--ros-args', *words)
        elif name == 'subscriber':
            self._heard = self._folder / f'heard{len(list(self._folder.glob("heard*")))}'
            command = (sys.executable, '-m', 'bench.soak', '--subscribe', str(self._heard))
            process = self._start(*command, cwd=ROOT)
        elif name == 'viewer':
            words = ['-p', 'sink:=file', '-p', f'file:={self._folder}/live.rrd']
            process = self._start(*SOFT_THROW, name, '--ros-args', *words)
        else:
            process = self._start(*SOFT_THROW, name)
        if name != 'subscriber':
            process.wait_for('ready')
        self.running[name] = process

    def pids(self, name: str) -> list[int]:
        """Return the process numbers of a node, or of all."""
        names = NAMES if name == 'all' else (name,)
        return [self.running[name].process.pid for name in names]

    def wait_for_states(self) -> None:
        """Wait until recorder and subscriber receive states published after the call."""
        start = time.time_ns()
        self.wait_for_heard(1250)
        bag = self.bags[-1]
        self._wait(lambda: _last_recorded_stamp(bag) >= start, 'no new states are recorded')

    def wait_for_heard(self, count: int) -> None:
        """Wait until the subscriber has received a number of additional states."""
        size = _size(self._heard) + 8 * count
        self._wait(lambda: _size(self._heard) >= size, 'no states are received')

    def _wait(self, is_reached: Callable[[], bool], failure: str) -> None:
        """Wait, or fail with the last lines of all processes."""
        deadline = time.monotonic() + TIMEOUT
        while not is_reached():
            if time.monotonic() > deadline:
                last = {name: process.lines[-5:] for name, process in self.running.items()}
                pytest.fail(f'{failure}: {_size(self._heard)} bytes heard, {last}')
            time.sleep(0.1)

    def end(self) -> Outcome:
        """End all processes, the twin first, and return the outcome."""
        time.sleep(SETTLING)
        for name in reversed(NAMES):
            self.running[name].end_well()
        last = self.running['recorder'].lines[-1]
        assert ' lost' in last
        missing = sum(map(int, re.findall(r'(\d+) of /twin/joint_states', last)))
        reports = processes.recorded_statuses(self.bags[-1])
        reported, timing = [item[::2] for item in reports if item[1] == '/twin: timing'][-1]
        return Outcome(
            [processes.recorded_states(bag) for bag in self.bags],
            missing,
            np.fromfile(self._heard, dtype='<i8'),
            reported,
            int(timing['ticks_skipped']),
        )


def missing(states: processes.RecordedStates) -> int:
    """Count missing sequence numbers of a twin from the first recorded one on."""
    assert (np.diff(states.numbers) > 0).all()
    return int(states.numbers[-1] - states.numbers[0]) + 1 - states.numbers.size


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _last_recorded_stamp(bag: Path) -> int:
    """Return the stamp of the last state in an unfinished bag, or 0 [ns]."""
    stamp = 0
    for path in sorted(bag.glob('*.mcap')):
        with path.open('rb') as stream, contextlib.suppress(McapError):
            reader = NonSeekingReader(stream)
            for _, _, message in reader.iter_messages([processes.STATES], log_time_order=False):
                stamp = processes.stamp_of(message.data)
    return stamp


@pytest.fixture
def system(request, start, tmp_path, monkeypatch):
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
    return System(start, tmp_path)


@pytest.fixture
def kill(stop: Any) -> Callable[[Any, str], None]:
    """Return a function that kills a process and starts it again."""

    def kill(system: Any, name: str) -> None:
        (pid,) = system.pids(name)
        stop(pid)  # at a time at which it holds no lock of the middleware
        os.kill(pid, signal.SIGKILL)
        assert system.running[name].wait() == -signal.SIGKILL
        system.start(name)

    return kill


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
    outcome = system.end()
    (states,) = outcome.bags
    assert missing(states) == outcome.missing
    assert (states.lost > 1000) if is_lossy else (states.lost == 0)
    assert outcome.ticks_missing <= outcome.ticks_skipped
    assert outcome.ticks_skipped > 1000 * (late - 0.2 * len(stops)) or not late
    first, *_, last = outcome.heard.tolist()
    between = (outcome.published >= first) & (outcome.published <= last)
    assert np.isin(outcome.published[between], outcome.heard).all()


def test_killed_processes_are_started_again_and_nothing_else_is_lost(system, kill, tmp_path):
    for name in ('viewer', 'twin', 'subscriber', 'recorder'):
        if name == 'twin':
            killed_ns = time.time_ns()
        kill(system, name)
        if name != 'recorder':
            system.wait_for_states()
    killed, system.bags[0] = system.bags[0], tmp_path / 'recovered'
    recover.main([str(killed), '--to', str(system.bags[0])])
    system.wait_for_states()
    outcome = system.end()
    assert missing(outcome.bags[-1]) == outcome.missing
    assert outcome.bags[-1].lost == 0
    both = outcome.bags[0]  # has the states of two twins
    for part in (both.stamps < killed_ns, both.stamps >= killed_ns):
        assert processes.RecordedStates(*(column[part] for column in both)).lost == 0
    assert outcome.ticks_missing <= outcome.ticks_skipped


@pytest.mark.timeout(300)
def test_promises_are_kept_for_half_a_minute(domain_id, capsys):
    pytest.importorskip('rerun')
    code = soak.main(['--minutes', '0.5', '--sink', 'file'])
    output = capsys.readouterr().out
    assert code == 0, output
    assert output.count(' | yes |') == 6
