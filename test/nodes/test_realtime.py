# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Steps of the ticker on a clock set by the test."""

from __future__ import annotations

import itertools
import queue
import time
from typing import Any

import pytest
from ros_nodes import GivenClock
from soft_throw_ros.nodes.realtime import PRIORITY, set_priority, SystemClock, Ticker
from soft_throw_ros.nodes.recommendations import LatestOnlyWorker
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.tick_schedule import TickSchedule

MILLISECOND = SECOND // 1000


class Bench:
    """A ticker, its clock, and a session that only counts its steps."""

    def __init__(self, clock: Any, rate: float = 1000.0) -> None:
        self.clock = clock
        self.rate = rate
        self.step = 0
        self.schedules: list[tuple[int, int, float, int]] = []
        self.done: list[tuple[int, int]] = []
        self.ticker = Ticker(self, self.on_tick, lambda: self.clock)

    def set_tick_schedule(self, schedule: TickSchedule) -> None:
        self.schedules.append((self.step, schedule.time_ns, schedule.rate, schedule.step))

    def on_tick(self, due: int) -> None:
        self.done.append((self.step, due))
        self.step += 1

    def at(self, time: float) -> list[tuple[int, float]]:
        """Set the clock; return the steps that run and their due times [ms]."""
        self.clock.time = round(time * MILLISECOND)
        before = len(self.done)
        self.ticker.run_due()
        return [(step, due / MILLISECOND) for step, due in self.done[before:]]


@pytest.fixture
def bench() -> Bench:
    return Bench(GivenClock(now=0, max_catch_up=SECOND // 10))


def test_late_tick_does_not_delay_others(bench) -> None:
    bench.at(100)
    assert bench.at(100.999) == []
    assert bench.at(103.7) == [(1, 101), (2, 102), (3, 103)]
    assert bench.at(104) == [(4, 104)]
    counts = bench.ticker.counts
    assert (counts['ticks'], counts['ticks_late'], counts['ticks_skipped']) == (5, 3, 0)
    lateness = [late for late, _ in bench.ticker.take_times()]
    assert lateness == [0, 2_700_000, 1_700_000, 700_000, 0]
    assert bench.ticker.take_times() == []


def test_stall_is_caught_up_within_bounds_and_other_ticks_are_counted(bench) -> None:
    bench.at(1000)
    burst = bench.at(6000)
    assert [step for step, _ in burst] == list(range(1, 102))  # consecutive, for 0.1 s
    assert burst[-1][1] == 6000
    assert bench.ticker.counts['ticks_skipped'] == 4899
    assert bench.at(6001) == [(102, 6001)]


def test_session_receives_every_change_of_the_deadlines(bench) -> None:
    bench.at(100)
    bench.at(150)
    bench.at(5000)  # a stall
    bench.rate = 300.0
    bench.at(5070)
    bench.clock.epoch += 1
    bench.at(90)
    for step, due in bench.done:
        past = [item for item in bench.schedules if item[0] <= step]
        since, time_ns, rate, first = past[-1]
        assert due == time_ns + round((step - first) * SECOND / rate), since
    assert len(bench.schedules) == 4


def test_thread_that_cannot_keep_up_loses_its_priority_for_a_while() -> None:
    best = set_priority(PRIORITY)
    set_priority(0)
    if best != 'fifo':
        pytest.skip('threads of this user may not have real-time priority')
    seen: list[str] = []

    class Stalling(Bench):

        def on_tick(self, due: int) -> None:
            super().on_tick(due)
            seen.append(self.ticker.scheduler)
            if self.step == 3:
                time.sleep(0.09)

    ticker = Stalling(SystemClock(), 100.0).ticker
    ticker.start()
    deadline = time.monotonic() + 60.0
    changes: list[str] = []
    while len(changes) < 3 and time.monotonic() < deadline:
        time.sleep(0.01)
        changes = [name for name, _ in itertools.groupby(list(seen))]
    ticker.stop(10.0)
    assert changes[:3] == ['fifo', 'other', 'fifo'], changes


def test_system_clock_detects_changes(monkeypatch) -> None:
    clock = SystemClock()
    clock.adjust()
    assert clock.epoch == 0
    real = time.time_ns
    monkeypatch.setattr(time, 'time_ns', lambda: real() - 3600 * SECOND)
    before = clock.now()
    clock.adjust()
    assert clock.epoch == 1
    assert clock.now() < before


def test_worker_cancels_outdated_requests_and_serves_the_latest() -> None:
    begun: list[int] = []
    results: queue.Queue[int] = queue.Queue()

    def serve(request: int, cancelled: Any) -> None:
        begun.append(request)
        while request < 99 and not cancelled():  # for ever, unless it is cancelled
            time.sleep(1e-3)
        if not cancelled():
            results.put(request)

    worker = LatestOnlyWorker(serve, interval=0.2)
    for request in range(100):
        worker.submit(request)
    assert results.get(timeout=60.0) == 99
    worker.close(60.0)
    assert len(begun) < 10
    assert results.empty()
