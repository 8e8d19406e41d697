# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Due times of playback on a clock set by the test."""

from __future__ import annotations

from itertools import islice
from typing import Any

from bags import plain
from hypothesis import given
from hypothesis import strategies as st
from soft_throw_ros.recording.playback import MAX_CATCH_UP, PlaybackSchedule, SHORTEST_LOOP

SECOND = 1_000_000_000
START = 17 * SECOND
"""When the caller begins, by its own clock."""

TIMES = st.lists(st.integers(0, 10_000), max_size=30).map(sorted)


def scheduled(times: Any, **kwargs: Any) -> PlaybackSchedule:
    """Schedule messages of a recording that begins with the first."""
    span = {'begin_ns': min(times, default=0), 'end_ns': max(times, default=0)}
    schedule = PlaybackSchedule(lambda: map(plain, times), **span, **kwargs)
    schedule.resume(START)
    return schedule


def play(schedule: PlaybackSchedule, late: int = 0, limit: int = 1000) -> list[tuple[int, int]]:
    """Poll at every deadline, or `late` after it; return messages' times with their deadlines."""
    came = []
    while (deadline := schedule.deadline()) is not None and len(came) < limit:
        assert schedule.next_due(deadline - 1) is None
        message = schedule.next_due(deadline + late)
        assert message is not None
        came.append((message.log_time, deadline))
    return came


def due_now(schedule: PlaybackSchedule, now: int) -> list[int]:
    return [message.log_time for message in iter(lambda: schedule.next_due(now), None)]


@given(TIMES, st.sampled_from([0, 1, MAX_CATCH_UP]), st.sampled_from([0.1, 3.0, 1e3]))
def test_items_are_due_at_their_time_over_the_rate_and_delays_do_not_add_up(
    times, late, rate
) -> None:
    came = play(scheduled(times, rate=rate), late)
    assert came == [(time, START + round((time - times[0]) / rate)) for time in times]


def test_stall_delays_the_remaining_items_which_are_read_one_ahead() -> None:
    times = iter(range(0, 100 * SECOND, SECOND))
    schedule = PlaybackSchedule(lambda: map(plain, times), begin_ns=0, end_ns=99 * SECOND)
    schedule.resume(START)
    stalled = START + 60 * SECOND
    assert due_now(schedule, stalled) == [0]  # and not sixty at once
    assert next(times) == 2 * SECOND
    remaining = [deadline for _, deadline in play(schedule)]
    assert remaining == [stalled - MAX_CATCH_UP + k * SECOND for k in (1, *range(3, 100))]


CALLS = st.tuples(st.sampled_from(['pause', 'resume', 'look']), st.integers(0, 5_000))


@given(TIMES, st.sampled_from([0.3, 1.0, 7.0]), st.lists(CALLS, max_size=30))
def test_any_requests_give_every_item_once_in_order_and_a_pause_stops_the_time(
    times, rate, calls
) -> None:
    schedule = scheduled(times, rate=rate)
    now, came, shown = START, [], [schedule.time(START)]
    for name, wait in calls:
        is_paused, now = schedule.is_paused, now + wait
        assert not is_paused or (schedule.deadline() is None and schedule.time(now) == shown[-1])
        if name != 'look':
            getattr(schedule, name)(now)
        came += due_now(schedule, now)
        shown.append(schedule.time(now))
    schedule.resume(now)
    while (deadline := schedule.deadline()) is not None:
        came += due_now(schedule, max(now, deadline))
    assert came == times
    assert shown == sorted(shown)


@given(times=TIMES)
def test_loop_repeats_the_recording(times) -> None:
    """Not all at once, even if it is of one moment."""
    loops = play(scheduled(times, is_looping=True), limit=3 * len(times))
    assert [item for item, _ in loops] == list(islice(times * 3, len(loops)))
    deadlines = [deadline for _, deadline in loops]
    assert deadlines == sorted(deadlines)
    assert not times or deadlines[-1] - deadlines[0] >= 2 * SHORTEST_LOOP
