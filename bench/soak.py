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
"""
Run everything together for long, and see whether what is promised is kept.

A twin at 1 kHz, a recorder with a sink for viewers, four subscribers in processes of their own,
and somebody who sets a parameter every ten seconds. Nobody's own word is taken for it: what was
published and when is read from the bag by another reader, and compared with what the subscribers
got and with what the twin said of itself; processor time, memory and handles come from the kernel.
It prints Markdown, and ends with 1 if a promise was broken.
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

SUBSCRIBERS = 4
CHANGE_PERIOD = 10.0  # [s]
SAMPLE_PERIOD = 1.0  # of memory and handles [s]
LATE = 10_000_000  # what is later than this must have been reported [ns]
REPORTED_LATE = 0.009  # by this: publishing takes a moment after lateness is taken [s]
WARM_UP = 60.0  # at most a quarter of the time is left to fill buffers [s]
GROWTH = 4e6
"""
What the memory of a process may grow by after warm-up: histories of topics fill. [bytes]

Less than twice the time to warm up says nothing about memory.
"""

INDEX_GROWTH = 2500.0
"""
What the recorder's may, beside that: MCAP has the index of a file at its end. [bytes/s]

Two chunks in a second, each with the places of 14 topics.
"""

DRAIN_PERIOD = 0.01  # [s]
QUIET = 0.3  # when nothing came for so long, there is no more [s]

FIELD = '/twin/layer/joint_states'
TOPICS = (STATES, FIELD)
THICKNESSES = (0.0150, 0.0168)  # that are set in turns [m]
MB = 1e6


class Promise(NamedTuple):
    """What was promised, what was found, and whether that is kept."""

    promise: str
    found: str
    is_kept: bool


class Course(NamedTuple):
    """What a process used, from sample to sample."""

    times: list[float]
    usages: list[Usage]

    def after_warm_up(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times [s] and usages (columns) after warm-up."""
        times, used = np.array(self.times), np.array(self.usages, dtype=float)
        is_warm = times >= times[0] + min(WARM_UP, 0.25 * (times[-1] - times[0]))
        return times[is_warm], used[is_warm]

    def summary(self) -> dict[str, float]:
        """Sum up: part of one core, memory and handles at the end, and their growth."""
        times, used = self.after_warm_up()
        part = max(
            len(times) // 5, 1
        )  # the medians of a fifth: what is freed later does not count
        first, last = np.median(used[:part], axis=0), np.median(used[-part:], axis=0)
        share = (used[-1, 0] - used[0, 0]) / max(times[-1] - times[0], 1e-9)
        return {
            'of one core [%]': round(100.0 * share, 2),
            'memory [MB]': round(last[1] / MB, 1),
            'growth [MB]': round((last[1] - first[1]) / MB, 2),
            'handles': int(last[2]),
            'growth of handles': int(last[2] - first[2]),
        }


def main(args: list[str] | None = None) -> int:
    """Soak, print what was found, and return 1 if a promise was broken."""
    parser = argparse.ArgumentParser(prog='python -m bench.soak', description=__doc__)
    parser.add_argument('--minutes', type=float, default=30.0, help='how long (default 30)')
    sinks = ('viewer', 'serve', 'file', 'none')
    usual = 'where it is shown (default serve, which needs no screen)'
    parser.add_argument('--sink', default='serve', choices=sinks, help=usual)
    parser.add_argument('--json', type=Path, metavar='FILE', help='and write it there as JSON')
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
    print(f'\nOf all processors other machines took {100.0 * stolen / passed:.1f} %.\n')
    print(*head('promise', 'found', 'kept'), sep='\n')
    for row in promises:
        print(f'| {row.promise} | {row.found} | {"yes" if row.is_kept else "NO"} |')
    if arguments.json is not None:
        kept = [row._replace(is_kept=bool(row.is_kept))._asdict() for row in promises]
        found = {'minutes': arguments.minutes, 'processes': used, 'promises': kept}
        arguments.json.write_text(json.dumps(found, indent=2) + '\n', 'utf-8')
    return 0 if all(row.is_kept for row in promises) else 1


class _Soak:
    """The processes, what each used, and what became of them."""

    def __init__(self, folder: Path, sink: str) -> None:
        self.courses: dict[str, Course] = {}
        self._folder = folder
        self._is_long = False
        self._changes: list[str] = []  # reasons for refusal, empty if accepted
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
        """Run all for so long after the first state, and end them in order."""
        self._is_long = seconds >= 2.0 * WARM_UP
        with contextlib.ExitStack() as stack:
            running = {}
            for name, command in self._commands.items():
                log = stack.enter_context((self._folder / f'{name}.log').open('wb'))
                running[name] = processes.start(command, output=log)
                stack.callback(running[name].kill)
            heard = stack.enter_context(processes.subscriber('/nothing'))
            heard.wait(processes.TIMEOUT, lambda: bool(heard.values('lateness_max').size))
            self._watch({name: child.pid for name, child in running.items()}, heard, seconds)
            # The twin first, so that nobody misses a state for having left before it.
            for name in reversed(running):
                self._codes[name] = processes.end(running[name])

    def _watch(self, pids: dict[str, int], heard: processes.Heard, seconds: float) -> None:
        """Take samples of all processes, and change a parameter now and then."""
        from rclpy.parameter import Parameter
        from rclpy.parameter_client import AsyncParameterClient

        client = AsyncParameterClient(heard.node, '/twin')
        begin = time.monotonic()
        next_change = begin
        while (now := time.monotonic()) < begin + seconds:
            shown = processes.children_of(pids['recorder'])
            for name, pid in [*pids.items(), *((f'viewer sink {pid}', pid) for pid in shown)]:
                with contextlib.suppress(OSError):  # it ends with an exit code that is judged
                    course = self.courses.setdefault(name, Course([], []))
                    course.usages.append(processes.usage(pid))
                    course.times.append(now)
            if now >= next_change:
                thickness = THICKNESSES[len(self._changes) % 2]
                asked = client.set_parameters([Parameter('layer.thickness', value=thickness)])
                heard.wait(processes.EXIT_TIMEOUT, asked.done)
                reasons = [result.reason for result in asked.result().results]
                self._changes.append(' '.join(reasons) if asked.done() else 'no answer')
                next_change += CHANGE_PERIOD
            heard.wait(SAMPLE_PERIOD)
            heard.clear()

    def judge(self) -> Iterator[Promise]:
        """Compare what was published with what came, and the first samples with the last."""
        states, layers = (processes.recorded_states(self._folder / 'bag', t) for t in TOPICS)
        count = states.stamps.size
        text = f'{states.lost} of {count + states.lost}'
        yield Promise('the recorder loses no states', text, states.lost == 0 < count)
        said = (self._folder / 'recorder.log').read_text('utf-8').strip().splitlines()[-1]
        counted = [sum(map(int, re.findall(rf'(\d+) of {topic}', said))) for topic in TOPICS]
        missing = [found.lost + int(found.numbers[0]) - 1 for found in (states, layers)]
        text = said.partition(']: ')[2].rpartition(', in ')[0]
        yield Promise('it counts what it has not got', text, counted == missing)
        for number in range(1, SUBSCRIBERS + 1):
            heard = np.fromfile(self._folder / str(number), dtype='<i8')
            published = states.stamps[states.stamps >= heard[0]]
            lost = int((~np.isin(published, heard)).sum())
            is_kept = lost == 0 and bool(heard.size > 0.9 * count)
            yield Promise(
                f'subscriber {number} loses none', f'{lost} of {published.size}', is_kept
            )
        refused = [reason for reason in self._changes if reason]
        text = f'{len(self._changes) - len(refused)} of {len(self._changes)}'
        yield Promise('changes of a parameter are taken', ' '.join([text, *refused]), not refused)
        bad = {name: code for name, code in self._codes.items() if code != 0}
        yield Promise('all end in order', str(bad or 'all by 0'), not bad)
        for name, course in self.courses.items():
            if name.startswith('viewer sink'):
                continue  # it keeps what a late viewer may ask for, up to a limit of its own
            found = course.summary()
            memory, handles = found['growth [MB]'], found['growth of handles']
            text = f'{memory:g} MB, {handles:+g} handles'
            seconds = course.times[-1] - course.times[0]
            most = GROWTH + INDEX_GROWTH * seconds * (name == 'recorder')
            is_flat = (memory * MB < most or not self._is_long) and handles <= 0
            yield Promise(f'{name} takes no more memory and handles', text, is_flat)

    def judge_ticks(self) -> Iterator[Promise]:
        """Compare when states were published with what the twin said of its ticks."""
        states = processes.recorded_states(self._folder / 'bag', STATES)
        said = _reports(self._folder / 'bag')
        # What comes after the last report is reported by nobody.
        is_reported = states.published < said[-1, 0]
        late = states.published - states.stamps
        times = states.published[is_reported & (late > LATE)]
        # The first report after a tick is about it, unless both came at the same moment.
        first = np.searchsorted(said[:, 0], times)
        told = np.maximum(said[first, 1], said[np.minimum(first + 1, len(said) - 1), 1])
        unreported = int((told < REPORTED_LATE).sum())
        text = f'{times.size} of {states.stamps.size} later, {unreported} of them not reported'
        yield Promise('no tick later than 10 ms without a report', text, unreported == 0)
        stamps = states.stamps[states.stamps < said[-1, 0]]
        skipped = int((np.round(np.diff(stamps) * RATE / SECOND) - 1).sum())
        text = f'{skipped} skipped, {said[-1, 2]:.0f} reported'
        yield Promise('no tick is skipped without a report', text, bool(skipped <= said[-1, 2]))


def _reports(bag: Path) -> NDArray[np.float64]:
    """Read when the twin reported [ns], lateness and computing at their most [s], and skips."""
    rows: dict[int, dict[str, str]] = {}
    for when, name, values in processes.recorded_statuses(bag):
        if name in ('/twin: timing', '/twin: load'):
            rows[when] = rows.get(when, {}) | values
    found = [
        (when, float(row['lateness_max']) + float(row['compute_max']), float(row['ticks_skipped']))
        for when, row in rows.items()
    ]
    return np.array(found)


def _subscribe(path: Path) -> None:
    """Write down the stamps of states, and take layers, up to Ctrl-C or the last there is."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from soft_throw_ros.configuration.interface import TWIN_TOPICS
    from soft_throw_ros.nodes.raw_subscriptions import RawSubscription

    asked: list[int] = []  # when it was asked to end [ns]
    signal.signal(signal.SIGINT, lambda _number, _frame: asked.append(time.time_ns()))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(f'subscriber_{path.name}')
    states, layers = (
        RawSubscription.of(node, topic.at('/twin'))
        for topic in (TWIN_TOPICS.joint_states, TWIN_TOPICS.layer_joint_states)
    )
    is_done = False
    with path.open('wb', buffering=0) as stream:
        while not is_done:
            time.sleep(QUIET if asked else DRAIN_PERIOD)
            stamps = [stamp_of(message.data) for message in states.drain()]
            layers.drain()
            stream.write(np.array(stamps, dtype='<i8').tobytes())
            is_done = bool(asked) and (not stamps or stamps[-1] > asked[0])


if __name__ == '__main__':
    sys.exit(main())
