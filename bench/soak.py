# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Run twin, recorder and subscribers together for a long time, and check the promises.

The system is a twin at 1 kHz, a recorder, a viewer, four subscribers in separate processes, and a
client that sets a parameter every ten seconds. The check compares the publication times in the
bag, read by the mcap library, with the stamps that the subscribers received and with the twin's
reports. The exit code is 1 if a promise was broken.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
from pathlib import Path
import re
import signal
import sys
import tempfile
import time

from bench import processes
from bench.processes import RATE, SOFT_THROW, STATES, Subscriber
from bench.tables import head
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.recording.child_process import bound_to_parent
from soft_throw_ros.storage.cdr import stamp_of
from soft_throw_ros.storage.message import SECOND

SUBSCRIBERS = 4  # number of subscribers
CHANGE_PERIOD = 10.0  # time between changes of the parameter [s]
SAMPLE_PERIOD = 1.0  # time between samples of memory and open files [s]

MAX_UNREPORTED_LATENESS = 10_000_000  # of a tick that the twin need not report [ns]
MIN_REPORTED_LATENESS = 0.009  # of other ticks: it is measured shortly before publishing [s]
WARM_UP = 60.0  # time in which buffers fill, at most a quarter of the run [s]
MAX_GROWTH = 4e6  # of a process after warm-up, in runs of at least twice the warm-up [bytes]
INDEX_GROWTH = 2500.0  # additional, by the recorder's index of two chunks per second [bytes/s]
DRAIN_PERIOD = 0.01  # time between two reads of a subscriber [s]
QUIET_PERIOD = 0.3  # a subscriber that ends stops when it receives nothing for this time [s]
TOPICS = (STATES, '/twin/layer/joint_states')  # topics whose losses are counted
THICKNESSES = (0.0150, 0.0168)  # alternating values of the parameter `layer.thickness` [m]

# Numbers of a process
COLUMNS = ('of one core [%]', 'memory [MB]', 'growth [MB]', 'handles', 'growth of handles')


def main(args: list[str] | None = None) -> int:
    """Run the system, print the results, and return 1 if a promise was broken."""
    parser = argparse.ArgumentParser(prog='python -m bench.soak', description=__doc__)
    parser.add_argument('--minutes', type=float, default=30.0, help='duration (default 30)')
    parser.add_argument('--subscribe', type=Path, metavar='FILE', help=argparse.SUPPRESS)
    arguments = parser.parse_args(args)
    if arguments.subscribe is not None:
        _subscribe(arguments.subscribe)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        soak = _Soak(Path(folder))
        soak.run(60.0 * arguments.minutes)
        promises = list(soak.judge())
    print(*head(f'{arguments.minutes:g} min at 1 kHz', *COLUMNS), sep='\n')
    for name, numbers in soak.usages.items():
        print(f'| {name} | {" | ".join(f"{number:.4g}" for number in _summary(numbers))} |')
    print('', *head('promise', 'result', 'kept'), sep='\n')
    for promise, result, is_kept in promises:
        print(f'| {promise} | {result} | {"yes" if is_kept else "NO"} |')
    return 0 if all(is_kept for _, _, is_kept in promises) else 1


class _Soak:
    """The processes of a run, their resource usage and exit codes."""

    def __init__(self, folder: Path) -> None:
        # time [s], processor time [s], memory [bytes] and handles of each process
        self.usages: dict[str, list[tuple[float, ...]]] = {}
        self._folder = folder
        self._seconds = 0.0
        self._changes: list[str] = []  # reason of each rejected change, empty if accepted
        self._codes: dict[str, int] = {}
        recorder = ('-p', f'folder:={folder}', '-p', 'name:=bag')
        subscriber = (sys.executable, '-m', 'bench.soak', '--subscribe')
        self._commands = {
            'viewer': (*SOFT_THROW, 'viewer', '--ros-args', '-p', 'sink:=serve'),
            'recorder': (*SOFT_THROW, 'recorder', '--ros-args', *recorder),
            **{
                f'subscriber {number}': (*subscriber, str(folder / str(number)))
                for number in range(1, SUBSCRIBERS + 1)
            },
            'twin': (*SOFT_THROW, 'twin'),
        }

    def run(self, seconds: float) -> None:
        """Run all processes for a time after the first report, and end them in order."""
        self._seconds = seconds
        with contextlib.ExitStack() as stack:
            running = {}
            for name, command in self._commands.items():
                log = stack.enter_context((self._folder / f'{name}.log').open('wb'))
                running[name] = processes.start(bound_to_parent(command), output=log)
                stack.callback(running[name].kill)
            heard = stack.enter_context(contextlib.closing(Subscriber('/nothing')))
            heard.wait(processes.TIMEOUT, lambda: bool(heard.values('lateness_max').size))
            self._watch({name: child.pid for name, child in running.items()}, heard, seconds)
            # The twin ends first, so that all others receive its last states.
            for name in reversed(running):
                self._codes[name] = processes.end(running[name])

    def _watch(self, pids: dict[str, int], heard: Subscriber, seconds: float) -> None:
        """Sample the usage of all processes, and change a parameter periodically."""
        from rclpy.parameter import Parameter
        from rclpy.parameter_client import AsyncParameterClient

        client = AsyncParameterClient(heard.node, '/twin')
        begin = time.monotonic()
        while (now := time.monotonic()) < begin + seconds:
            for name, pid in pids.items():
                with contextlib.suppress(OSError):  # has ended; judge() checks its exit code
                    self.usages.setdefault(name, []).append((now, *processes.usage(pid)))
            if now >= begin + CHANGE_PERIOD * len(self._changes):
                thickness = THICKNESSES[len(self._changes) % 2]
                future = client.set_parameters([Parameter('layer.thickness', value=thickness)])
                heard.wait(processes.EXIT_TIMEOUT, future.done)
                results = future.result().results if future.done() else []
                reasons = ' '.join(result.reason for result in results)
                self._changes.append(reasons if results else 'no answer')
            heard.wait(SAMPLE_PERIOD)
            heard.clear()

    def judge(self) -> Iterator[tuple[str, str, bool]]:
        """Yield the six promises with the measured result, and whether each is kept."""
        states, layers = (processes.recorded_states(self._folder / 'bag', t) for t in TOPICS)
        count, lost = states.stamps.size, [states.lost]
        for number in range(1, SUBSCRIBERS + 1):
            heard = np.fromfile(self._folder / str(number), dtype='<i8')
            published = states.stamps[states.stamps >= heard[0]]
            missing = int((~np.isin(published, heard)).sum())
            lost.append(missing if published.size > 0.9 * count else count)
        text = f'{", ".join(map(str, lost))} of {count + states.lost}'
        yield 'recorder and subscribers lose no states', text, not any(lost)
        line = (self._folder / 'recorder.log').read_text('utf-8').strip().splitlines()[-1]
        counted = [sum(map(int, re.findall(rf'(\d+) of {topic}', line))) for topic in TOPICS]
        gaps = [topic.lost for topic in (states, layers)]
        yield 'the recorder counts all losses', f'{sum(counted)} of {sum(gaps)}', counted == gaps
        late, unreported, skipped, reported = _late_ticks(self._folder / 'bag', states)
        text = f'{late} late, {unreported} not reported; {skipped} skipped, {reported} reported'
        is_kept = not unreported and skipped <= reported
        yield 'the twin reports late and skipped ticks', text, is_kept
        texts, is_flat = [], True
        for name, usages in self.usages.items():
            if name != 'viewer':  # keeps messages for a Rerun that connects later
                _, _, memory, _, handles = _summary(usages)
                texts.append(f'{memory:+.1f} MB {handles:+g}')
                limit = MAX_GROWTH + INDEX_GROWTH * self._seconds * (name == 'recorder')
                is_flat &= 1e6 * memory < limit or self._seconds < 2.0 * WARM_UP
                is_flat &= handles <= 0
        yield 'memory and handles do not grow', ', '.join(texts), is_flat
        refused = [reason for reason in self._changes if reason]
        text = ' '.join([f'{len(refused)} of {len(self._changes)} refused', *refused])
        yield 'changes of a parameter are accepted', text, not refused
        bad = {name: code for name, code in self._codes.items() if code != 0}
        yield 'all processes end with 0', str(bad or 'yes'), not bad


def _summary(usages: list[tuple[float, ...]]) -> tuple[float, ...]:
    """Return the numbers of `COLUMNS` after the warm-up of a process."""
    used = np.array(usages)
    used = used[used[:, 0] >= used[0, 0] + min(WARM_UP, 0.25 * np.ptp(used[:, 0]))]
    fifth = max(len(used) // 5, 1)  # medians ignore memory that is soon freed again
    first, last = np.median(used[:fifth], axis=0), np.median(used[-fifth:], axis=0)
    seconds, processor = (used[-1] - used[0])[:2]
    growth = last - first
    share = 100.0 * processor / max(seconds, 1e-9)
    return share, last[2] / 1e6, growth[2] / 1e6, last[3], growth[3]


def _late_ticks(bag: Path, states: processes.RecordedStates) -> tuple[int, int, int, int]:
    """Return the numbers of late and of unreported ticks, and of skipped ones twice."""
    reports: NDArray[np.float64] = np.array([
        (time, float(row['lateness_max']) + float(row['compute_max']), float(row['ticks_skipped']))
        for time, name, row in processes.recorded_statuses(bag)
        if name == '/twin: timing'
    ])
    end = reports[-1, 0]  # no report covers later states
    late = states.published - states.stamps > MAX_UNREPORTED_LATENESS
    times = states.published[late & (states.published < end)]
    # A tick is in the first report after it, or in the next if both were published at once.
    first = np.searchsorted(reports[:, 0], times)
    following = np.minimum(first + 1, len(reports) - 1)
    largest = np.maximum(reports[first, 1], reports[following, 1])
    # A report is published some time after its counts were read.
    stamps = states.stamps[states.published < reports[-2, 0]]
    skipped = np.round(np.diff(stamps) * RATE / SECOND) - 1
    unreported = int((largest < MIN_REPORTED_LATENESS).sum())
    return times.size, unreported, int(skipped.sum()), int(reports[-1, 2])


def _subscribe(path: Path) -> None:
    """Write the stamps of states to a file until Ctrl-C, and then up to the last state."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from soft_throw_ros.configuration.interface import TWIN_TOPICS
    from soft_throw_ros.nodes.raw_subscriptions import subscribe

    interrupts: list[int] = []  # signals
    signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(f'subscriber_{path.name}')
    states = subscribe(node, TWIN_TOPICS.joint_states.at('/twin'))
    is_done = False
    with path.open('wb', buffering=0) as stream:
        while not is_done:
            time.sleep(QUIET_PERIOD if interrupts else DRAIN_PERIOD)
            stamps = [stamp_of(message.data) for message in states.drain()]
            stream.write(np.array(stamps, dtype='<i8').tobytes())
            is_done = bool(interrupts) and not stamps


if __name__ == '__main__':
    sys.exit(main())
