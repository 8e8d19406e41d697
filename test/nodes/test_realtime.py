# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Steps of the ticker on a clock set by the test."""

import itertools
import time
from typing import Any

from bags import wait_until
import pytest
from ros_nodes import GivenClock, MILLISECOND
from soft_throw_ros.nodes.realtime import PRIORITY, set_priority, SystemClock, Ticker
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.session import TickSchedule


class Bench:
    """A ticker, its clock, and a session that only counts its steps."""

    def __init__(self, clock: Any, rate: float = 1000.0, stalls_after: int = 0) -> None:
        self.clock = clock
        self.rate = rate
        self.step = 0
        self.stalls_after = stalls_after  # number of steps
        self.schedulers: list[str] = []  # of the steps
        self.schedules: list[tuple[int, int, float, int]] = []
        self.done: list[tuple[int, int]] = []
        self.ticker = Ticker(self, self.on_tick, lambda: self.clock)

    def set_tick_schedule(self, schedule: TickSchedule) -> None:
        self.schedules.append((self.step, schedule.time_ns, schedule.rate, schedule.step))

    def on_tick(self, due: int) -> None:
        self.done.append((self.step, due))
        self.schedulers.append(self.ticker.scheduler)
        self.step += 1
        if self.step == self.stalls_after:
            time.sleep(0.09)

    def at(self, time: float) -> list[tuple[int, float]]:
        """Set the clock; return the steps that run and their due times [ms]."""
        self.clock.time = round(time * MILLISECOND)
        before = len(self.done)
        self.ticker.run_due()
        return [(step, due / MILLISECOND) for step, due in self.done[before:]]


def test_steps_are_done_at_their_deadlines_or_counted_and_the_session_knows_all_changes():
    bench = Bench(GivenClock(now=0, max_catch_up=SECOND // 10))
    bench.at(100)
    assert bench.at(100.999) == []
    assert bench.at(103.7) == [(1, 101), (2, 102), (3, 103)]
    assert bench.at(104) == [(4, 104)]  # a late tick does not delay others
    counts = bench.ticker.counts
    assert (counts['ticks'], counts['ticks_late'], counts['ticks_skipped']) == (5, 3, 0)
    lateness, _ = zip(*bench.ticker.take_times(), strict=True)
    assert lateness == (0, 2_700_000, 1_700_000, 700_000, 0)
    assert bench.ticker.take_times() == []
    burst = bench.at(6000)  # a stall is caught up for 0.1 s, without a gap in the steps
    assert [step for step, _ in burst] == list(range(5, 106))
    assert burst[-1][1] == 6000
    assert counts['ticks_skipped'] == 5795
    assert bench.at(6001) == [(106, 6001)]
    bench.rate = 300.0
    _, dues = zip(*bench.at(6070), strict=True)
    assert [later - due for due, later in itertools.pairwise(dues)] == [pytest.approx(10 / 3)] * 20
    bench.clock.epoch += 1
    bench.at(90)
    for step, due in bench.done:
        since, time_ns, rate, first = [item for item in bench.schedules if item[0] <= step][-1]
        assert due == time_ns + round((step - first) * SECOND / rate), since
    assert len(bench.schedules) == 4


def test_thread_that_cannot_keep_up_loses_its_priority_for_a_while():
    best = set_priority(PRIORITY)
    set_priority(0)
    if best != 'fifo':
        pytest.skip('threads of this user may not have real-time priority')
    bench = Bench(SystemClock(), 100.0, stalls_after=3)

    def changes() -> list[str]:
        return [name for name, _ in itertools.groupby(list(bench.schedulers))]

    bench.ticker.start()
    wait_until(lambda: len(changes()) >= 3)
    bench.ticker.stop(10.0)
    assert changes()[:3] == ['fifo', 'other', 'fifo']


def test_system_clock_detects_changes(monkeypatch):
    clock = SystemClock()
    clock.adjust()
    assert clock.epoch == 0
    real = time.time_ns
    monkeypatch.setattr(time, 'time_ns', lambda: real() - 3600 * SECOND)
    before = clock.now()
    clock.adjust()
    assert clock.epoch == 1
    assert clock.now() < before
