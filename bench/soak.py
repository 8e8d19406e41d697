# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Run twin, recorder and subscribers together for a long time, and check the promises.

The system is a twin at 1 kHz, a recorder with a sink for viewers, four subscribers in separate
processes, and a client that sets a parameter every ten seconds. The check is independent of the
nodes: publication times come from the bag, read by the mcap library, and are compared with the
stamps that the subscribers received and with the twin's reports; processor time, memory and open
files come from the kernel. The output is Markdown; the exit code is 1 if a promise was broken.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import json
from pathlib import Path
import re
import signal
import sys
import tempfile
import time
from typing import NamedTuple

from bench import processes
from bench.processes import RATE, SECOND, SOFT_THROW, stamp_of, STATES, Usage
from bench.race import head
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.recording.child_process import bound_to_parent

SUBSCRIBERS = 4
"""Number of subscribers."""

CHANGE_PERIOD = 10.0
"""Time between changes of the parameter. [s]"""

SAMPLE_PERIOD = 1.0
"""Time between samples of memory and open files. [s]"""

MAX_UNREPORTED_LATENESS = 10_000_000
"""A tick that is published later than this must be in the twin's report. [ns]"""

MIN_REPORTED_LATENESS = 0.009
"""Reported lateness of such a tick: lateness is measured shortly before publishing. [s]"""

WARM_UP = 60.0
"""Time in which buffers fill, at most a quarter of the run. [s]"""

MAX_GROWTH = 4e6
"""Largest growth of a process after warm-up, in runs of at least twice the warm-up. [bytes]"""

INDEX_GROWTH = 2500.0
"""Additional growth of the recorder: the index of two chunks per second, 14 topics. [bytes/s]"""

DRAIN_PERIOD = 0.01
"""Time between two reads of a subscriber. [s]"""

QUIET_PERIOD = 0.3
"""A subscriber that ends stops when it receives nothing for this time. [s]"""

TOPICS = (STATES, '/twin/layer/joint_states')
"""Topics whose losses are counted."""

THICKNESSES = (0.0150, 0.0168)
"""Alternating values of the parameter `layer.thickness`. [m]"""

MB = 1e6
"""One megabyte. [bytes]"""


class Promise(NamedTuple):
    """A promise, the measured result, and whether the promise is kept."""

    promise: str
    result: str
    is_kept: bool


class Course(NamedTuple):
    """Resource usage of a process over time."""

    times: list[float]
    usages: list[Usage]

    def after_warm_up(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times [s] and usages (one row per time) after warm-up."""
        times, used = np.array(self.times), np.array(self.usages, dtype=float)
        is_warm = times >= times[0] + min(WARM_UP, 0.25 * (times[-1] - times[0]))
        return times[is_warm], used[is_warm]

    def summary(self) -> dict[str, float]:
        """Return the fraction of one core, final memory and open files, and their growth."""
        times, used = self.after_warm_up()
        fifth = max(len(times) // 5, 1)  # medians ignore memory that is soon freed again
        first, last = np.median(used[:fifth], axis=0), np.median(used[-fifth:], axis=0)
        share = (used[-1, 0] - used[0, 0]) / max(times[-1] - times[0], 1e-9)
        return {
            'of one core [%]': round(100.0 * share, 2),
            'memory [MB]': round(last[1] / MB, 1),
            'growth [MB]': round((last[1] - first[1]) / MB, 2),
            'handles': int(last[2]),
            'growth of handles': int(last[2] - first[2]),
        }


def main(args: list[str] | None = None) -> int:
    """Run the system, print the results, and return 1 if a promise was broken."""
    parser = argparse.ArgumentParser(prog='python -m bench.soak', description=__doc__)
    parser.add_argument('--minutes', type=float, default=30.0, help='duration (default 30)')
    sinks = ('viewer', 'serve', 'file', 'none')
    parser.add_argument('--sink', default='serve', choices=sinks,
                        help='sink of the recorder (default serve, which needs no screen)')
    parser.add_argument('--json', type=Path, metavar='FILE', help='also write the results as JSON')
    parser.add_argument('--subscribe', type=Path, metavar='FILE', help=argparse.SUPPRESS)
    arguments = parser.parse_args(args)
    if arguments.subscribe is not None:
        _subscribe(arguments.subscribe)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        soak = _Soak(Path(folder), arguments.sink)
        before = processes.steal()
        soak.run(60.0 * arguments.minutes)
        stolen, passed = np.subtract(processes.steal(), before)
        promises = [*soak.judge(), *soak.judge_ticks()]
    used = {name: course.summary() for name, course in soak.courses.items()}
    columns = list(used['twin'])
    print(*head(f'{arguments.minutes:g} min at 1 kHz', *columns), sep='\n')
    for name, values in used.items():
        print(f'| {name} |', ' | '.join(f'{values[column]:g}' for column in columns), '|')
    print(f'\nOther virtual machines took {100.0 * stolen / passed:.1f} % of the processors.\n')
    print(*head('promise', 'result', 'kept'), sep='\n')
    for row in promises:
        print(f'| {row.promise} | {row.result} | {"yes" if row.is_kept else "NO"} |')
    if arguments.json is not None:
        rows = [row._replace(is_kept=bool(row.is_kept))._asdict() for row in promises]
        report = {'minutes': arguments.minutes, 'processes': used, 'promises': rows}
        arguments.json.write_text(json.dumps(report, indent=2) + '\n', 'utf-8')
    return 0 if all(row.is_kept for row in promises) else 1


class _Soak:
    """The processes of a run, their resource usage and exit codes."""

    def __init__(self, folder: Path, sink: str) -> None:
        self.courses: dict[str, Course] = {}
        self._folder = folder
        self._is_long = False
        self._changes: list[str] = []  # reason of each rejected change, empty if accepted
        self._codes: dict[str, int] = {}
        recorder = ('-p', f'folder:={folder}', '-p', 'name:=bag', '-p', f'rerun.sink:={sink}')
        self._commands = {
            'recorder': (*SOFT_THROW, 'recorder', '--ros-args', *recorder),
            **{
                f'subscriber {number}':
                (sys.executable, '-m', 'bench.soak', '--subscribe', str(folder / str(number)))
                for number in range(1, SUBSCRIBERS + 1)
            },
            'twin': (*SOFT_THROW, 'twin'),
        }

    def run(self, seconds: float) -> None:
        """Run all processes for a time after the first report, and end them in order."""
        self._is_long = seconds >= 2.0 * WARM_UP
        with contextlib.ExitStack() as stack:
            running = {}
            for name, command in self._commands.items():
                log = stack.enter_context((self._folder / f'{name}.log').open('wb'))
                running[name] = processes.start(bound_to_parent(command), output=log)
                stack.callback(running[name].kill)
            heard = stack.enter_context(processes.subscriber('/nothing'))
            heard.wait(processes.TIMEOUT, lambda: bool(heard.values('lateness_max').size))
            self._watch({name: child.pid for name, child in running.items()}, heard, seconds)
            # The twin ends first, so that all others receive its last states.
            for name in reversed(running):
                self._codes[name] = processes.end(running[name])

    def _watch(self, pids: dict[str, int], heard: processes.Heard, seconds: float) -> None:
        """Sample the usage of all processes, and change a parameter periodically."""
        from rclpy.parameter import Parameter
        from rclpy.parameter_client import AsyncParameterClient

        client = AsyncParameterClient(heard.node, '/twin')
        begin = time.monotonic()
        next_change = begin
        while (now := time.monotonic()) < begin + seconds:
            sinks = processes.children_of(pids['recorder'])
            for name, pid in [*pids.items(), *((f'viewer sink {pid}', pid) for pid in sinks)]:
                with contextlib.suppress(OSError):  # has ended; judge() checks its exit code
                    course = self.courses.setdefault(name, Course([], []))
                    course.usages.append(processes.usage(pid))
                    course.times.append(now)
            if now >= next_change:
                thickness = THICKNESSES[len(self._changes) % 2]
                future = client.set_parameters([Parameter('layer.thickness', value=thickness)])
                heard.wait(processes.EXIT_TIMEOUT, future.done)
                results = future.result().results if future.done() else []
                reasons = [result.reason for result in results]
                self._changes.append(' '.join(reasons) if results else 'no answer')
                next_change += CHANGE_PERIOD
            heard.wait(SAMPLE_PERIOD)
            heard.clear()

    def judge(self) -> Iterator[Promise]:
        """Yield the promises on losses, parameter changes, exit codes and resources."""
        states, layers = (processes.recorded_states(self._folder / 'bag', t) for t in TOPICS)
        count = states.stamps.size
        text = f'{states.lost} of {count + states.lost}'
        yield Promise('the recorder loses no states', text, states.lost == 0 < count)
        line = (self._folder / 'recorder.log').read_text('utf-8').strip().splitlines()[-1]
        counted = [sum(map(int, re.findall(rf'(\d+) of {topic}', line))) for topic in TOPICS]
        missing = [topic.lost + int(topic.numbers[0]) - 1 for topic in (states, layers)]
        text = line.partition(']: ')[2].rpartition(', in ')[0]
        yield Promise('the recorder counts missing messages', text, counted == missing)
        for number in range(1, SUBSCRIBERS + 1):
            heard = np.fromfile(self._folder / str(number), dtype='<i8')
            published = states.stamps[states.stamps >= heard[0]]
            lost = int((~np.isin(published, heard)).sum())
            is_kept = lost == 0 and bool(heard.size > 0.9 * count)
            text = f'{lost} of {published.size}'
            yield Promise(f'subscriber {number} loses no states', text, is_kept)
        refused = [reason for reason in self._changes if reason]
        accepted = f'{len(self._changes) - len(refused)} of {len(self._changes)}'
        text = ' '.join([accepted, *refused])
        yield Promise('changes of a parameter are accepted', text, not refused)
        bad = {name: code for name, code in self._codes.items() if code != 0}
        yield Promise('all processes end with 0', str(bad or 'yes'), not bad)
        for name, course in self.courses.items():
            if name.startswith('viewer sink'):
                continue  # buffers messages for viewers that connect later, up to its own limit
            used = course.summary()
            memory, handles = used['growth [MB]'], used['growth of handles']
            text = f'{memory:g} MB, {handles:+g} handles'
            seconds = course.times[-1] - course.times[0]
            limit = MAX_GROWTH + INDEX_GROWTH * seconds * (name == 'recorder')
            is_flat = (memory * MB < limit or not self._is_long) and handles <= 0
            yield Promise(f'memory and handles of {name} do not grow', text, is_flat)

    def judge_ticks(self) -> Iterator[Promise]:
        """Yield the promises on late and skipped ticks, from publication times and reports."""
        states = processes.recorded_states(self._folder / 'bag', STATES)
        reports = _reports(self._folder / 'bag')
        end = reports[-1, 0]  # no report covers later states
        late = states.published - states.stamps
        is_late = (states.published < end) & (late > MAX_UNREPORTED_LATENESS)
        times = states.published[is_late]
        # A tick is in the first report after it, or in the next if both were published at once.
        first = np.searchsorted(reports[:, 0], times)
        reported = np.maximum(
            reports[first, 1], reports[np.minimum(first + 1, len(reports) - 1), 1]
        )
        unreported = int((reported < MIN_REPORTED_LATENESS).sum())
        text = f'{times.size} of {states.stamps.size} later, {unreported} unreported'
        yield Promise('every tick later than 10 ms is reported', text, unreported == 0)
        stamps = states.stamps[states.stamps < end]
        skipped = int((np.round(np.diff(stamps) * RATE / SECOND) - 1).sum())
        text = f'{skipped} skipped, {reports[-1, 2]:.0f} reported'
        yield Promise('every skipped tick is reported', text, bool(skipped <= reports[-1, 2]))


def _reports(bag: Path) -> NDArray[np.float64]:
    """Return the twin's reports: time [ns], largest lateness and computing time [s], skips."""
    rows: dict[int, dict[str, str]] = {}
    for published, name, values in processes.recorded_statuses(bag):
        if name in ('/twin: timing', '/twin: load'):
            rows[published] = rows.get(published, {}) | values
    return np.array([
        (time, float(row['lateness_max']) + float(row['compute_max']), float(row['ticks_skipped']))
        for time, row in rows.items()
    ])


def _subscribe(path: Path) -> None:
    """Write the stamps of states to a file until Ctrl-C, and then up to the last state."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from soft_throw_ros.configuration.interface import TWIN_TOPICS
    from soft_throw_ros.nodes.raw_subscriptions import RawSubscription

    interrupts: list[int] = []  # times of SIGINT [ns]
    signal.signal(signal.SIGINT, lambda *_: interrupts.append(time.time_ns()))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(f'subscriber_{path.name}')
    states, layers = (
        RawSubscription.of(node, topic.at('/twin'))
        for topic in (TWIN_TOPICS.joint_states, TWIN_TOPICS.layer_joint_states)
    )
    is_done = False
    with path.open('wb', buffering=0) as stream:
        while not is_done:
            time.sleep(QUIET_PERIOD if interrupts else DRAIN_PERIOD)
            stamps = [stamp_of(message.data) for message in states.drain()]
            layers.drain()
            stream.write(np.array(stamps, dtype='<i8').tobytes())
            is_done = bool(interrupts) and (not stamps or stamps[-1] > interrupts[0])


if __name__ == '__main__':
    sys.exit(main())
