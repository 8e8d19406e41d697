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
"""Twin, recorder and subscriber in processes of their own, to be hurt; and what they leave."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import signal
import sys
import time
from typing import Any, NamedTuple

from bench import processes
import numpy as np

ROOT = Path(__file__).parents[1]
SOFT_THROW = (sys.executable, '-m', 'soft_throw_ros')
TIMEOUT = 90.0  # for states to be taken [s]
SETTLING = 2.5  # time for two reports of a node [s]
MILLISECOND = 1_000_000  # [ns]


class Outcome(NamedTuple):
    """
    What is left of a system.

    Attributes
    ----------
    bags : list of RecordedStates
        States in each bag, by somebody else's reader.
    missing : int
        How many states are not in the last bag, by what its recorder says in the end.
    heard : ndarray
        Stamps of states that the last subscriber wrote down. [ns]
    told : int
        When the twin last reported. [ns]
    ticks_skipped : int
        How many ticks it had skipped then.
    viewers : int
        How often a recorder has started what shows its messages.

    """

    bags: list[processes.RecordedStates]
    missing: int
    heard: np.ndarray
    told: int
    ticks_skipped: int
    viewers: int

    @property
    def published(self) -> np.ndarray:
        """Stamps of all states that anybody has got [ns]."""
        return np.union1d(self.bags[-1].stamps, self.heard)

    @property
    def ticks_missing(self) -> int:
        """How many ticks nobody has got, before the last report of the twin."""
        steps = np.diff(self.published[self.published < self.told]) / MILLISECOND
        return int((np.round(steps) - 1).sum())


class System:
    """
    Twin, recorder with a sink for viewers, and subscriber.

    Parameters
    ----------
    start : callable
        Starts a process by its command: the fixture of that name, or one that does so on another
        host; called with the name of what is started first.
    folder : Path
        Where bags are put.

    """

    def __init__(self, start: Callable[..., Any], folder: Path, *, sink: str = 'file') -> None:
        self.bags: list[Path] = []
        self.running: dict[str, Any] = {}
        self._start = start
        self._folder = folder
        self._sink = sink
        self._heard = folder / 'heard'  # what the subscriber writes: the stamps that it hears
        for name in ('recorder', 'subscriber', 'twin'):
            self.start(name)
        self.wait_for_states()

    def start(self, name: str) -> None:
        """Start one of them, or start it again."""
        if name == 'recorder':
            self.bags.append(self._folder / f'bag{len(self.bags)}')
            rules = (f'folder:={self._folder}', f'name:={self.bags[-1].name}')
            words = [word for rule in rules for word in ('-p', rule)]
            words += ['-p', f'rerun.sink:={self._sink}']
            process = self._start(name, *SOFT_THROW, name, '--ros-args', *words)
        elif name == 'subscriber':
            self._heard = self._folder / f'heard{len(list(self._folder.glob("heard*")))}'
            command = (sys.executable, '-m', 'bench.soak', '--subscribe', str(self._heard))
            process = self._start(name, *command, cwd=ROOT)
        else:
            process = self._start(name, *SOFT_THROW, name)
        if name != 'subscriber':
            process.wait_for('ready')
        self.running[name] = process

    def pids(self, name: str) -> list[int]:
        """Return the process that is meant, or all of them."""
        shown = processes.children_of(self.running['recorder'].process.pid)
        if name == 'viewer':
            return shown
        everybody = [process.process.pid for process in self.running.values()]
        return everybody + shown if name == 'all' else [self.running[name].process.pid]

    def wait_for_states(self) -> None:
        """Wait until recorder and subscriber have taken states for a second or so."""
        deadline = time.monotonic() + TIMEOUT
        before = [_size(self._heard), _size(self.bags[-1])]
        while _size(self._heard) < before[0] + 10_000 or _size(self.bags[-1]) < before[1] + 20_000:
            assert time.monotonic() < deadline, 'no states are taken'
            time.sleep(0.1)

    def wait_for_states_of(self, moment: int) -> None:
        """Wait until the subscriber hears states that were published after a moment [ns]."""
        deadline = time.monotonic() + TIMEOUT
        while int(np.fromfile(self._heard, dtype='<i8')[-1]) < moment:
            assert time.monotonic() < deadline, 'only old states are heard'
            time.sleep(0.1)

    def end(self) -> Outcome:
        """End all, the twin first, and gather what they left."""
        time.sleep(SETTLING)
        for name in ('twin', 'subscriber', 'recorder'):
            process = self.running[name]
            assert process.end(signal.SIGINT) == 0, process.lines
            assert not any('Traceback' in line for line in process.lines), process.lines
        last = self.running['recorder'].lines[-1]
        assert ' lost' in last
        # What was lost, and what was published before the recorder joined, if it joined late.
        missing = sum(map(int, re.findall(r'(\d+) of /twin/joint_states', last)))
        reports = processes.recorded_statuses(self.bags[-1])
        told, timing = [item[::2] for item in reports if item[1] == '/twin: timing'][-1]
        viewers = [int(values['starts']) for _, name, values in reports if 'viewer' in name]
        return Outcome(
            [processes.recorded_states(bag) for bag in self.bags],
            missing,
            np.fromfile(self._heard, dtype='<i8'),
            told,
            int(timing['ticks_skipped']),
            max(viewers, default=0),
        )


def missing(states: processes.RecordedStates, twins: int = 1) -> int:
    """Count what is missing of numbers that begin at 1, and begin anew after the longest pause."""
    pauses = np.argsort(np.diff(states.stamps))[::-1][: twins - 1]
    parts = np.split(states.numbers, np.sort(pauses) + 1)
    assert all((np.diff(part) > 0).all() for part in parts)
    return sum(int(part[-1]) for part in parts) - states.numbers.size


def _size(path: Path) -> int:
    if path.is_dir():
        return sum(file.stat().st_size for file in path.glob('*.mcap'))
    return path.stat().st_size if path.exists() else 0
