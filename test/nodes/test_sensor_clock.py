# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sensor clocks with an offset."""

import numpy as np
import pytest
from soft_throw_ros.nodes.sensor_clock import SensorClock, TOLERATED
from soft_throw_ros.twin.tick_schedule import SECOND

NOW = 1_700_000_000 * SECOND
MILLISECOND = SECOND // 1000


def observe(clock: SensorClock, offset_ns: int, *, begin_ns: int = NOW, ticks: int = 3000) -> int:
    """Feed stamps with an offset to a clock and count its warnings."""
    random = np.random.default_rng(0)
    warnings = 0
    for tick in range(ticks):
        now_ns = begin_ns + tick * MILLISECOND
        delays = random.exponential(3e-4 * SECOND, 5).astype(int) + MILLISECOND // 10
        stamps = [now_ns - offset_ns - delay for delay in delays.tolist()]
        warnings += clock.observe(stamps, now_ns)
    return warnings


@pytest.mark.parametrize(
    'offset_ns',
    [20 * MILLISECOND, -300 * MILLISECOND, 5 * SECOND, NOW - 3600 * SECOND],
    ids=['behind', 'ahead', 'far behind', 'since boot'],
)
def test_constant_offset_is_found_and_reported_once(offset_ns) -> None:
    clock = SensorClock()
    assert observe(clock, offset_ns) == 1
    fastest = offset_ns + MILLISECOND // 10
    assert clock.offset_ns == pytest.approx(fastest, abs=MILLISECOND // 50)
    assert f'{abs(clock.offset_ns) / MILLISECOND:.1f} ms' in clock.problem


def test_transport_delay_is_no_offset() -> None:
    clock = SensorClock()
    assert observe(clock, TOLERATED - MILLISECOND) == 0
    assert (clock.offset_ns, clock.problem) == (0, '')


def test_corrected_clock_is_trusted_again() -> None:
    clock = SensorClock()
    observe(clock, 50 * MILLISECOND)
    assert observe(clock, 0, begin_ns=NOW + 3 * SECOND, ticks=5000) == 1
    assert (clock.offset_ns, clock.problem) == (0, '')


@pytest.mark.parametrize(('step', 'words'), [(0, 'is 0'), (SECOND, 'is of whole seconds')])
def test_stamps_without_the_time_of_the_sample_are_named(step, words) -> None:
    clock = SensorClock()
    for tick in range(1000):
        now_ns = NOW + tick * MILLISECOND
        clock.observe([now_ns // step * step if step else 0], now_ns)
    assert f'header.stamp of the samples {words}' in clock.problem
    assert clock.offset_ns == 0
