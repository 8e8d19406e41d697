# SPDX-License-Identifier: Apache-2.0
"""Steps by the clock; the clock is the test's."""

from __future__ import annotations

import copy
import threading
import time

import pytest
from soft_throw_ros.nodes.realtime import percentiles, SystemClock, Ticker
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule

MILLISECOND = SECOND // 1000


class GivenClock:
    """A clock that shows what it is told to."""

    def __init__(self, now: int = 0, max_catch_up: int = SECOND // 10) -> None:
        self.epoch = 0
        self.max_catch_up = max_catch_up
        self.tolerance = SECOND // 5000
        self.time = now

    def now(self) -> int:
        return self.time

    def wait_until(self, deadline: int) -> None:
        self.time = max(self.time, deadline)


class CountingSession:
    """A session that has nothing but steps."""

    def __init__(self, rate: float = 1000.0, step: int = 0) -> None:
        self.step = step
        self.rate = rate
        self.paces: list[tuple[int, TickSchedule]] = []

    def advance(self) -> int:
        self.step += 1
        return self.step - 1

    def set_tick_schedule(self, pace: TickSchedule) -> None:
        self.paces.append((self.step, copy.copy(pace)))


class Rig:
    """A ticker, its clock, and what it has done."""

    def __init__(self, rate: float = 1000.0, **clock) -> None:
        self.clock = GivenClock(**clock)
        self.session = CountingSession(rate)
        self.done: list[tuple[int, int]] = []
        self.ticker = Ticker(
            self.session, lambda step, due: self.done.append((step, due)), lambda: self.clock
        )

    def at(self, time: float) -> list[tuple[int, int]]:
        """Show a time, and return what is done. [ms]"""
        self.clock.time = round(time * MILLISECOND)
        before = len(self.done)
        self.ticker.run_due()
        return self.done[before:]


def test_ticks_are_those_of_the_clock() -> None:
    rig = Rig()
    for tenth in range(100, 10_000, 3):
        rig.at(0.1 * tenth)
    assert rig.done == [(step, (10 + step) * MILLISECOND) for step in range(990)]
    assert rig.ticker.account.ticks == 990
    assert rig.ticker.account.skipped == 0


def test_tick_that_is_late_makes_no_other_late() -> None:
    rig = Rig()
    rig.at(100)
    assert rig.at(100.999) == []
    assert rig.at(103.7) == [  # all three
        (1, 101 * MILLISECOND),
        (2, 102 * MILLISECOND),
        (3, 103 * MILLISECOND),
    ]
    assert rig.at(104) == [(4, 104 * MILLISECOND)]
    account = rig.ticker.account
    assert (account.late, account.caught_up, account.skipped) == (3, 2, 0)
    assert account.take()[0] == [0, 2_700_000, 1_700_000, 700_000, 0]
    assert account.take() == ([], [])


def test_stall_is_caught_up_within_bounds_and_the_rest_is_counted() -> None:
    rig = Rig()
    rig.at(1000)
    burst = rig.at(6000)
    assert [step for step, _ in burst] == list(range(1, 102))  # consecutive, for 0.1 s
    assert burst[-1][1] == 6000 * MILLISECOND
    assert rig.ticker.account.skipped == 4899
    assert rig.at(6001) == [(102, 6001 * MILLISECOND)]


def test_rate_changes_from_the_step_that_changes_it() -> None:
    rig = Rig()
    rig.at(1000)
    rig.session.rate = 500.0
    assert [due for _, due in rig.at(1010)] == [
        time * MILLISECOND for time in (1001, 1003, 1005, 1007, 1009)
    ]


def test_clock_that_does_not_go_gives_no_step() -> None:
    rig = Rig()
    assert rig.at(0) == []
    assert rig.at(5000) == [(0, 5000 * MILLISECOND)]
    assert rig.ticker.account.skipped == 0


def test_clock_that_was_set_starts_anew() -> None:
    rig = Rig()
    rig.at(5000)
    rig.clock.epoch += 1
    assert rig.at(100) == [(1, 100 * MILLISECOND)]
    assert rig.at(102)[-1] == (3, 102 * MILLISECOND)
    rig.clock.epoch += 1
    assert rig.at(10**9) == [(4, 10**9 * MILLISECOND)]
    assert rig.ticker.account.jumps == 2
    assert rig.ticker.account.skipped == 0


def test_thread_ticks_and_stops() -> None:
    clock = GivenClock(now=SECOND)
    session = CountingSession()
    enough = threading.Event()
    ticker = Ticker(session, lambda step, due: step >= 500 and enough.set(), lambda: clock)
    ticker.start()
    assert enough.wait(20.0)
    ticker.stop(20.0)
    assert not ticker.is_alive
    done = session.step
    assert ticker.account.ticks == done


def test_steps_are_told_by_their_stamps() -> None:
    rig = Rig(rate=999.0)
    rig.at(100)
    rig.at(150)
    rig.at(5000)  # a stall
    rig.session.rate = 300.0
    rig.at(5070)
    rig.clock.epoch += 1
    rig.at(90)
    rig.at(123)
    paces = rig.session.paces
    assert len(paces) == 4
    for step, due in rig.done:
        pace = [pace for since, pace in paces if since <= step][-1]
        assert pace.deadline(step) == due


def test_system_clock_shows_the_time_of_day_and_waits() -> None:
    clock = SystemClock()
    assert abs(clock.now() - time.time_ns()) < 60 * SECOND
    deadline = clock.now() + 2 * MILLISECOND
    while clock.now() < deadline:
        clock.wait_until(deadline)
    past = clock.now()
    clock.wait_until(past - SECOND)  # comes back


def test_system_clock_knows_when_it_was_set(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SystemClock()
    clock.adjust()
    assert clock.epoch == 0
    real = time.time_ns
    monkeypatch.setattr(time, 'time_ns', lambda: real() - 3600 * SECOND)
    before = clock.now()
    clock.adjust()
    assert clock.epoch == 1
    assert clock.now() < before


def test_percentiles_are_in_seconds() -> None:
    assert percentiles([]) == (0.0, 0.0, 0.0)
    assert percentiles(list(range(1001))) == pytest.approx((500e-9, 990e-9, 1000e-9))
