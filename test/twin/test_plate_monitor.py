# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Detection of the start of a measured throw, and of faults of the sensor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.plate_monitor import PlateMonitor
from soft_throw_ros.twin.sample_buffer import Onset, SampleCounts, Samples
from twin_runs import (
    BEGIN,
    INTERVAL,
    make_samples,
    MEASUREMENT,
    PLATE,
    Sample,
    samples_of,
)

CROSSING = 2e-3  # [s]


def detect(samples: list[Sample]) -> tuple[Onset | None, int]:
    """Return the first onset and the number of samples needed."""
    monitor = PlateMonitor(MEASUREMENT, CROSSING, SampleCounts())
    for count, sample in enumerate(samples, 1):
        monitor.buffer.add(samples_of([sample]), sample.stamp_ns)
        onset = monitor.advance(sample.stamp_ns)
        if onset is not None:
            return onset, count
    return None, len(samples)


@pytest.mark.parametrize('start', [0.02, 0.0301234])
def test_start_is_found_within_a_short_delay(start) -> None:
    onset, count = detect(make_samples(400, onset=start))
    assert onset is not None
    assert (onset.onset_ns - BEGIN) / SECOND == pytest.approx(start, abs=2e-5)
    assert (onset.rest.plate, onset.rest.projectile) == pytest.approx((0.3, 0.5), abs=2e-6)
    assert count * INTERVAL / SECOND < start + 1.6e-3


def test_slow_motion_and_downward_jumps_start_nothing() -> None:
    samples = make_samples(1000)
    time = np.array([(sample.stamp_ns - BEGIN) / SECOND for sample in samples])
    creeping = 0.3 + 0.06 * np.maximum(time - 0.05, 0.0)
    falling = 0.3 - PLATE.position(time - 0.05) * (time < 0.05 + 0.9 * 0.5 / PLATE.frequency)
    for heights in (creeping, falling):
        moved = [
            sample._replace(plate=height)
            for sample, height in zip(samples, heights.tolist(), strict=True)
        ]
        assert detect(moved)[0] is None


def test_start_after_a_gap_needs_another_rest() -> None:
    samples = make_samples(400, onset=0.04)
    assert detect(samples[175:])[0] is None  # as does one soon after the first
    assert detect(samples)[0] is not None
    del samples[120:150]  # up to 10 ms before it
    assert detect(samples)[0] is None


def test_start_is_found_as_well_as_the_noise_allows() -> None:
    errors, rest_errors = [], []
    for seed in range(100):
        onset, _ = detect(make_samples(400, onset=0.025, noise=5e-6, seed=seed))
        assert onset is not None
        errors.append((onset.onset_ns - BEGIN) / SECOND - 0.025)
        rest_errors.append((onset.rest.plate - 0.3) / onset.rest.error)
    since = np.arange(0.0, 2.6e-3, 2e-4)
    sensitivity = np.column_stack((PLATE.velocity(since), PLATE.position(since)))
    bound = 5e-6 * math.sqrt(np.linalg.inv(sensitivity.T @ sensitivity)[0, 0])
    assert np.mean(errors) == pytest.approx(0.0, abs=4e-6)
    assert np.std(errors) < 1.5 * bound
    assert np.std(rest_errors) == pytest.approx(1.0, abs=0.25)


def watch(*, rate: float = 5000.0, crossing: float = CROSSING, count: int = 100) -> PlateMonitor:
    """Return a monitor of a plate at rest, after a number of samples."""
    monitor = PlateMonitor(MEASUREMENT, crossing, SampleCounts())
    stamps = BEGIN + np.rint(np.arange(count) * SECOND / rate).astype(np.int64)
    monitor.buffer.add(Samples(stamps, np.zeros((count, 2))), int(stamps[-1]))
    monitor.advance(int(stamps[-1]))
    return monitor


def test_sensor_without_faults_is_not_reported() -> None:
    assert watch(rate=2100.0, count=20).rate_fault() == ''
    monitor = watch(rate=1980.0)  # 2 kHz, with stamps that jitter
    assert monitor.is_armed
    assert monitor.rate_fault() == ''


@pytest.mark.parametrize(
    ('request_', 'least'), [({'crossing': 1e-4}, '30000 Hz'), ({'rate': 1500.0}, '2000 Hz')]
)
def test_rate_that_is_too_low_is_reported_with_the_least_one(request_, least) -> None:
    assert least in watch(**request_).rate_fault()
