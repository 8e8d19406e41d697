# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Measured samples with impossible values and stamps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from fuzzing import bounded, fuzzed
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from soft_throw_ros.nodes.sensor_clock import SensorClock
from soft_throw_ros.twin.sample_buffer import Sample
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule
from twin_runs import BEGIN, complete_settings

HEIGHTS = st.floats(-0.01, 0.01) | st.sampled_from(
    [math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 99.9, 100.1, 16.8]
)
OFFSETS = st.sampled_from(
    [0, 1, -1, 10**8, -(10**8), SECOND, -SECOND, -BEGIN, 2**62, -(2**31) * SECOND - BEGIN]
)


DAMAGES = st.lists(
    st.tuples(
        st.integers(0, 600),
        st.sampled_from(['plate', 'plate_velocity', 'projectile', 'stamp_ns', 'swap']),
        HEIGHTS,
        OFFSETS,
    ),
    max_size=12,
)


def measure(rate: int, amplitude: float, damages: list[Any]) -> list[Sample]:
    """Measure a plate that shakes, and damage a few of the samples."""
    times = np.arange(rate // 8) / rate
    swing = amplitude * (1.0 - np.cos(400.0 * np.maximum(times - 0.05, 0.0)))
    samples = [
        Sample(BEGIN + round(time * SECOND), height, math.nan, height + 0.01)
        for time, height in zip(times.tolist(), swing.tolist(), strict=True)
    ]
    for number, what, height, offset in damages:
        index = number % len(samples)
        old = samples[index]
        if what == 'stamp_ns':
            samples[index] = old._replace(stamp_ns=old.stamp_ns + offset)
        elif what == 'swap':
            samples[index], samples[index - 1] = samples[index - 1], old
        else:
            samples[index] = old._replace(**{what: height})
    return samples


@fuzzed(0.03)
@given(
    rate=st.sampled_from([500, 2000, 5000]),
    size=st.sampled_from([1, 10, 100]),
    amplitude=st.sampled_from([0.0, 2e-3, 1.0]),
    damages=DAMAGES,
    has_projectile=st.booleans(),
)
def test_twin_of_a_measured_plate_has_finite_outputs(
    tmp_path: Path, rate: int, size: int, amplitude: float, damages: Any, has_projectile: bool
) -> None:
    samples = measure(rate, amplitude, damages)
    batches = [samples[first:first + size] for first in range(0, len(samples), size)]
    clock = SensorClock()
    with bounded(tmp_path):
        session = Session(complete_settings(engine__motion='measured'))
        session.set_tick_schedule(TickSchedule(step=0, time_ns=BEGIN, rate=session.rate))
        for step in range(200):
            now = BEGIN + step * SECOND // 1000
            while batches and batches[0][0].stamp_ns <= now + SECOND // 10:
                batch = batches.pop(0)
                if not has_projectile:
                    batch = [sample._replace(projectile=math.nan) for sample in batch]
                clock.observe((sample.stamp_ns for sample in batch), now, limit_ns=SECOND)
                session.measure([s._replace(stamp_ns=s.stamp_ns + clock.offset_ns) for s in batch])
            outputs = session.advance()
            assert all(map(math.isfinite, outputs.state)), outputs
            for release in [item.first for item in outputs.results if item.first is not None]:
                assert math.isfinite(release.ejection_time + release.ejection_speed), release
