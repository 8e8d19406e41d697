# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Base class of the nodes `twin` and `rig`: a thread advances a session by the clock.

The tick thread waits for each deadline, advances the session, and counts late ticks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import ctypes
import gc
import math
import os
import sys
import threading
import time
from typing import Any, TypeAlias

from rclpy.clock import ROSClock
from rclpy.node import Node
from soft_throw_ros.commands.warm_up import are_compiled, load_kernels
from soft_throw_ros.configuration import Settings
from soft_throw_ros.nodes.process import POLL, RunnableNode, start_child, STOP_TIMEOUT
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.prepared_rig import prepare, PreparedRig
from soft_throw_ros.twin.session import Session, TickSchedule

PRIORITY = 10  # real-time priority (SCHED_FIFO) of the tick thread [-]
_SPIN = 60_000  # polling before a deadline, about as long as a sleep overruns [ns]
_CLOCK_POLL = 1e-3  # time between two looks at `/clock`, which has fewer messages [s]
_FIFO_RETRY_DELAY = 1.0  # time after a stall until real-time priority returns [s]
_SWITCH_INTERVAL = 3e-5  # shortest wait of a due tick for another Python thread [s]
_SWITCH_FRACTION = 0.03  # the same over the tick period, to save processor time [-]
_STALL = 0.5  # lateness that counts as a stall, as a fraction of `max_catch_up`


class SystemClock:
    """The time of day; it advances steadily between calls of `adjust`."""

    max_catch_up = SECOND // 10  # of a stall; the steps before are skipped [ns]
    tolerance = SECOND // 5000  # of ticks that do not count as late [ns]

    def __init__(self) -> None:
        self.epoch = 0  # times before and after its change cannot be compared
        self._offset = time.time_ns() - time.monotonic_ns()

    def adjust(self) -> None:
        """Follow adjustments of the system clock since the last call."""
        offset = time.time_ns() - time.monotonic_ns()
        if abs(offset - self._offset) > self.max_catch_up:  # the clock was set
            self.epoch += 1
        self._offset = offset

    def now(self) -> int:
        """Return the time since 1970 [ns]."""
        return time.monotonic_ns() + self._offset

    def wait_until(self, deadline: int) -> None:
        """Sleep until a deadline or earlier; poll at the end, because a sleep ends late."""
        target = deadline - self._offset
        pause = target - _SPIN - time.monotonic_ns()
        if pause > 0:
            time.sleep(min(pause / SECOND, POLL))
        while 0 < target - time.monotonic_ns() <= _SPIN:
            pass


class NodeClock:
    """The clock of a node that follows `/clock`: it advances with each message."""

    max_catch_up = 10 * SECOND
    tolerance = 10 * SECOND

    def __init__(self, node: Node) -> None:
        self.epoch = 0
        self._latest = 0  # time at the last look [ns]
        self._clock = node.get_clock()

    @property
    def is_active(self) -> bool:
        """Whether the node follows `/clock`."""
        return isinstance(self._clock, ROSClock) and bool(self._clock.ros_time_is_active)

    def now(self) -> int:
        """Return the last time on `/clock`, 0 before the first message [ns]."""
        return int(self._clock.now().nanoseconds)

    def wait_until(self, _deadline: int) -> None:
        """Wait for a moment, and look whether the clock was set back."""
        time.sleep(_CLOCK_POLL)
        before, self._latest = self._latest, self.now()
        self.epoch += self._latest < before


Clock: TypeAlias = SystemClock | NodeClock


class Ticker(threading.Thread):
    """
    A thread that advances a session at absolute deadlines, at the rate of the session.

    `on_tick` advances the session by one step, and is called with the deadline [ns]. `clock`
    returns the clock to follow; if the clock is set or replaced, the next step is due at once.
    `counts` has the numbers of ticks by their published names.

    The thread uses real-time priority as long as this keeps it on time. While it waits for
    Python's global lock, it polls the lock, and may keep the thread that holds the lock from its
    processor. After a stall it therefore runs with normal priority for `_FIFO_RETRY_DELAY`.
    """

    def __init__(
        self, session: Session, on_tick: Callable[[int], None], clock: Callable[[], Clock]
    ) -> None:
        super().__init__(name='ticker', daemon=True)
        self.counts = Counter(ticks=0, ticks_late=0, ticks_skipped=0, clock_jumps=0)
        self._times: list[tuple[int, int]] = []
        self.scheduler = ''  # policy of the thread, 'fifo' or 'other'
        self._session = session
        self._on_tick = on_tick
        self._clock = clock
        self._followed: tuple[Clock, int] | None = None
        self._schedule: TickSchedule | None = None
        self._stalled = -math.inf  # time of the last stall under real-time priority [s]
        self._is_stopping = threading.Event()

    def take_times(self) -> list[tuple[int, int]]:
        """Return lateness and duration of the ticks since the last call [ns]."""
        times, self._times = self._times, []
        return times

    def stop(self, timeout: float) -> None:
        """Request the end of the thread, and wait at most `timeout` [s]."""
        self._is_stopping.set()
        if self.is_alive():
            self.join(timeout)

    def run_due(self) -> int:
        """Run all due steps; return the deadline of the next step on the same clock [ns]."""
        clock, session, counts = self._clock(), self._session, self.counts
        now = clock.now()
        schedule = self._schedule_of(clock, now)
        if schedule is None:
            return now + 1
        skipped = schedule.skip(step=session.step, now=now, max_catch_up=clock.max_catch_up)
        if skipped:
            counts['ticks_skipped'] += skipped
            session.set_tick_schedule(schedule)
        due = schedule.deadline(session.step)
        if self.scheduler == 'fifo' and now - due > _STALL * clock.max_catch_up:
            self._stalled = time.monotonic()
        while due <= now:
            begin = time.perf_counter_ns()
            self._on_tick(due)
            self._times.append((now - due, time.perf_counter_ns() - begin))
            counts['ticks'] += 1
            counts['ticks_late'] += now - due > clock.tolerance
            if session.rate != schedule.rate:
                schedule.change_rate(step=session.step - 1, rate=session.rate)
                session.set_tick_schedule(schedule)
            due = schedule.deadline(session.step)
        return due

    def _schedule_of(self, clock: Clock, now: int) -> TickSchedule | None:
        """Return the deadlines of steps on a clock, or None if the clock has no time yet."""
        if self._followed != (clock, clock.epoch):
            self.counts['clock_jumps'] += self._schedule is not None
            self._followed = (clock, clock.epoch)
            self._schedule = None
        if self._schedule is None and now > 0:
            session = self._session
            self._schedule = TickSchedule(step=session.step, time_ns=now, rate=session.rate)
            session.set_tick_schedule(self._schedule)
        return self._schedule

    def run(self) -> None:
        """Run the steps until `stop`; this is the function of the thread."""
        self.scheduler = best = set_priority(PRIORITY)
        while not self._is_stopping.is_set():
            due = self.run_due()
            if best == 'fifo':
                may_retry = time.monotonic() > self._stalled + _FIFO_RETRY_DELAY
                if may_retry != (self.scheduler == 'fifo'):
                    self.scheduler = set_priority(PRIORITY if may_retry else 0)
            self._clock().wait_until(due)


def set_priority(priority: int) -> str:
    """Set the real-time priority of this thread, 0 for none; return 'fifo' or 'other'."""
    pr_set_timerslack = 29  # from 50 us to 1 ns, so that sleeps end on time
    ctypes.CDLL(None).prctl(pr_set_timerslack, ctypes.c_ulong(1), 0, 0, 0)
    try:
        policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError:
        return 'other'
    return 'fifo' if priority else 'other'


class RealTimeNode(RunnableNode):
    """
    Abstract node that advances a session at the deadlines of its steps, in a thread of its own.

    A subclass declares its parameters with the check `prepare`, creates its publishers, and calls
    `attach_session` last. `system_clock` is the clock, unless the node follows `/clock`.
    """

    session: Session
    ticker: Ticker

    def __init__(
        self, name: str, *, system_clock: SystemClock | None = None, **kwargs: Any
    ) -> None:
        super().__init__(name, **kwargs)
        self._system_clock = system_clock or SystemClock()

    def prepare(self, settings: Settings, before: PreparedRig | None) -> PreparedRig:
        """Return the rig of complete settings of a twin, after kernels are compiled at first."""
        if before is None and not are_compiled():
            self.get_logger().info('compiling the kernels, once for this installation')
            # In a child process, because numba suppresses exceptions of signal handlers
            start_child('warm_up').wait()
        return prepare(settings, before)

    def attach_session(self, session: Session) -> None:
        """Make the ticker of a session, which advances after the start of the node."""
        self.session = session
        self._node_clock = NodeClock(self)
        self.ticker = Ticker(session, self.on_tick, self._current_clock)
        self.add_cleanup(session.close)
        self.add_cleanup(self.ticker.stop, STOP_TIMEOUT)
        self.create_steady_timer(1.0, self.on_second)

    def on_tick(self, due: int) -> None:
        """Advance by one step, in the tick thread, and publish; `due` is its deadline [ns]."""
        raise NotImplementedError

    def on_second(self) -> None:
        """Follow changes of the system clock and of the rate, in the executor's thread."""
        self._system_clock.adjust()
        interval = max(_SWITCH_INTERVAL, _SWITCH_FRACTION / self.session.rate)
        sys.setswitchinterval(interval)

    def start(self) -> None:
        """Load all kernels, freeze the garbage collector, and start the ticks."""
        load_kernels(say=self.get_logger().info)
        RealTimeNode.on_second(self)  # as it sets the switch interval
        gc.collect()  # now, since it would delay ticks
        gc.freeze()
        self.ticker.start()
        self.get_logger().info('ready')

    def _current_clock(self) -> Clock:
        return self._node_clock if self._node_clock.is_active else self._system_clock
