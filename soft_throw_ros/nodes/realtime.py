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
"""Keep time: which step is due when, waiting for it, and how well that went."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
import ctypes
import math
import os
import threading
import time
from typing import TypeAlias

from rclpy.clock import ClockChange, JumpThreshold, ROSClock, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule

SPIN = 60_000
"""How long before a deadline sleep ends and polling begins; about what a wake-up takes [ns]."""

POLL = 0.1
"""Longest wait, after which a thread looks whether it is to stop [s]."""

PRIORITY = 10
"""Of the thread that ticks, among those that go before all others."""

CALM = 1.0
"""So long after a stall the thread goes before all others again [s]."""


class SystemClock:
    """
    The time of day, which goes on steadily between calls of `adjust`.

    Like every clock that steps are due by, it changes its `epoch` when times before and after
    have nothing to do with each other; after a stall as much as `max_catch_up` is caught up and
    the rest skipped; and what is later than `tolerance` is late. [ns]
    """

    max_catch_up = SECOND // 10
    tolerance = SECOND // 5000

    def __init__(self) -> None:
        self.epoch = 0
        self._offset = time.time_ns() - time.monotonic_ns()

    def adjust(self) -> None:
        """Follow what was done to the time of day since the last call."""
        offset = time.time_ns() - time.monotonic_ns()
        if abs(offset - self._offset) > self.max_catch_up:  # somebody has set it
            self.epoch += 1
        self._offset = offset

    def now(self) -> int:
        """Return nanoseconds since 1970."""
        return time.monotonic_ns() + self._offset

    def wait_until(self, deadline: int) -> None:
        """
        Return at a time, or before: the caller looks at the clock and waits again.

        It sleeps, and polls for the last microseconds, since a sleep ends late.
        """
        target = deadline - self._offset
        pause = target - SPIN - time.monotonic_ns()
        if pause > 0:
            time.sleep(min(pause / SECOND, POLL))
        while 0 < target - time.monotonic_ns() <= SPIN:
            pass


class NodeClock:
    """The clock of a node that follows `/clock`: it moves when a message moves it."""

    max_catch_up = 10 * SECOND
    tolerance = 10 * SECOND

    def __init__(self, node: Node) -> None:
        self.epoch = 0
        self._clock = node.get_clock()
        assert isinstance(self._clock, ROSClock)
        self.is_active = bool(self._clock.ros_time_is_active)
        self._moved = threading.Event()
        self._watch = self._clock.create_jump_callback(
            JumpThreshold(
                min_forward=Duration(nanoseconds=1),
                min_backward=Duration(nanoseconds=-1),
                on_clock_change=True,
            ),
            post_callback=self._on_jump,
        )

    def now(self) -> int:
        """Return the time that `/clock` has told last, 0 before the first message [ns]."""
        return int(self._clock.now().nanoseconds)

    def wait_until(self, deadline: int) -> None:
        """Wait until the clock moves."""
        if self.now() < deadline:
            self._moved.wait(POLL)
        self._moved.clear()

    def close(self) -> None:
        """Let the node's clock go."""
        self._watch.unregister()

    def _on_jump(self, jump: TimeJump) -> None:
        if jump.clock_change in (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED):
            self.is_active = jump.clock_change == ClockChange.ROS_TIME_ACTIVATED
            self.epoch += 1
        elif jump.delta.nanoseconds < 0:
            self.epoch += 1
        self._moved.set()


Clock: TypeAlias = SystemClock | NodeClock

MOST_TIMES = 50_000
"""Of so many ticks is it known what they took: ten seconds of the fastest session."""

_STALL = 0.5  # of what is caught up: so late are ticks only if something is wrong
_COUNTED = ('ticks', 'ticks_late', 'ticks_skipped', 'ticks_caught_up', 'clock_jumps')


class Ticker:
    """
    Have every step of a session done that is due.

    Parameters
    ----------
    session : Session
        Its steps are due at its rate, the next one at the first look at the clock.
    on_tick : callable
        Goes a step on; called with when it was due. [ns]
    clock : callable
        Returns the clock to go by, before every look at it.

    Attributes
    ----------
    counts : Counter of str
        Ticks since the start, and what was wrong with them, by the names that are published.
    scheduler : str
        What the operating system schedules the thread by, 'fifo' or 'other'.

    Notes
    -----
    If the clock is set, or changed for another one, the next step is due at once.

    The thread goes before all others as long as that keeps it on time. While it waits for Python's
    lock it asks for it again and again, and whoever has that lock may be waiting for a processor:
    many nodes on few cores would do nothing but ask. So after a stall it is one among others for
    a while.

    """

    def __init__(
        self, session: Session, on_tick: Callable[[int], None], clock: Callable[[], Clock]
    ) -> None:
        self.counts = Counter(dict.fromkeys(_COUNTED, 0))
        self._times: deque[tuple[int, int]] = deque(maxlen=MOST_TIMES)  # nobody may ask for them
        self.scheduler = ''
        self._session = session
        self._on_tick = on_tick
        self._clock = clock
        self._followed: tuple[Clock, int] | None = None
        self._schedule: TickSchedule | None = None
        self._stalled = -math.inf  # when ticks were that late though they went first [s]
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(name='ticker', target=self._run, daemon=True)

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @property
    def has_ended(self) -> bool:
        """Whether the thread ran, and does not any more."""
        return self._thread.ident is not None and not self._thread.is_alive()

    def take_times(self) -> list[tuple[int, int]]:
        """Return how late ticks were since the last call, and what they took [ns]."""
        times, self._times = self._times, deque(maxlen=MOST_TIMES)
        return list(times)

    def describe_standstill(self) -> str:
        """Say why there are no ticks."""
        if isinstance(self._clock(), NodeClock):
            return 'the twin follows /clock (use_sim_time), which stands still'
        return 'the thread that ticks gets no time'

    def start(self) -> None:
        """Tick in a thread of its own."""
        self._thread.start()

    def stop(self, timeout: float) -> None:
        """Ask the thread to end, and wait for it at most `timeout` [s]."""
        self._is_stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def run_due(self) -> int:
        """Do every step that is due now; return when the next one is, by the same clock [ns]."""
        clock = self._clock()
        now = clock.now()
        schedule = self._schedule_of(clock, now)
        if schedule is None:
            return now + 1
        session, counts = self._session, self.counts
        skipped = schedule.skip(step=session.step, now=now, max_catch_up=clock.max_catch_up)
        if skipped:
            counts['ticks_skipped'] += skipped
            session.set_tick_schedule(schedule)
        due = schedule.deadline(session.step)
        if self.scheduler == 'fifo' and now - due > _STALL * clock.max_catch_up:
            self._stalled = time.monotonic()
        done = 0
        while due <= now:
            begin = time.perf_counter_ns()
            self._on_tick(due)
            self._times.append((now - due, time.perf_counter_ns() - begin))
            counts['ticks_late'] += now - due > clock.tolerance
            done += 1
            if session.rate != schedule.rate:
                schedule.change_rate(step=session.step - 1, rate=session.rate)
                session.set_tick_schedule(schedule)
            due = schedule.deadline(session.step)
        counts['ticks'] += done
        counts['ticks_caught_up'] += max(done - 1, 0)
        return due

    def _schedule_of(self, clock: Clock, now: int) -> TickSchedule | None:
        """Return when steps are due by a clock, or None if it does not go yet."""
        if self._followed != (clock, clock.epoch):
            self.counts['clock_jumps'] += self._schedule is not None
            self._followed = (clock, clock.epoch)
            self._schedule = None
        if self._schedule is None and now > 0:
            session = self._session
            self._schedule = TickSchedule(step=session.step, time_ns=now, rate=session.rate)
            session.set_tick_schedule(self._schedule)
        return self._schedule

    def _run(self) -> None:
        wake_on_time()
        self.scheduler = best = set_priority(PRIORITY)
        while not self._is_stopping.is_set():
            due = self.run_due()
            if best == 'fifo':
                is_calm = time.monotonic() > self._stalled + CALM
                if is_calm != (self.scheduler == 'fifo'):
                    self.scheduler = set_priority(PRIORITY if is_calm else 0)
            self._clock().wait_until(due)


def wake_on_time() -> None:
    """Have sleeps of this thread end when they should, instead of up to 50 us later."""
    prctl = getattr(ctypes.CDLL(None), 'prctl', None)
    if prctl is not None:  # elsewhere than on Linux sleeps are as they are
        pr_set_timerslack = 29
        prctl(pr_set_timerslack, ctypes.c_ulong(1), 0, 0, 0)


def set_priority(priority: int) -> str:
    """
    Have this thread go before whatever else the machine does, or, with 0, like all others.

    Returns by what it is scheduled then, 'fifo' or 'other': the former is for root, and for users
    with an `rtprio` in limits.conf.
    """
    try:
        policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except (AttributeError, OSError):
        return 'other'
    return 'fifo' if priority else 'other'
