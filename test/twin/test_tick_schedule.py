# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Due times of steps."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule


@given(rate=st.floats(10.0, 5000.0), start=st.integers(1, 2**61), steps=st.integers(0, 10**10))
def test_deadlines_never_drift(rate, start, steps) -> None:
    schedule = TickSchedule(step=7, time_ns=start, rate=rate)
    exact = start + steps * SECOND / rate
    assert abs(schedule.deadline(7 + steps) - exact) <= 1 + 4e-16 * exact


@given(rate=st.floats(10.0, 5000.0), stall=st.integers(0, 10**13))
def test_skipping_leaves_the_allowed_catch_up(rate, stall) -> None:
    schedule = TickSchedule(step=0, time_ns=SECOND, rate=rate)
    now = SECOND + stall
    allowed = SECOND // 10
    ticks = schedule.skip(step=0, now=now, max_catch_up=allowed)
    late = now - schedule.deadline(0)
    period = SECOND / rate
    assert (ticks == 0) == (stall < allowed + period)
    assert late == stall if not ticks else allowed - 2 <= late <= allowed + period + 2
