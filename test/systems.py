# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A system of twin, recorder and subscriber in separate processes, for tests of faults."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
from pathlib import Path
import re
import sys
import time
from typing import Any, NamedTuple

from bench import processes
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
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
