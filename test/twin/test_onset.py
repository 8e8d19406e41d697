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
"""Detection of the start of a measured throw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.twin.onset import (
    find_start,
    first_states,
    Onset,
    peak_speed,
    time_since_start,
)
from soft_throw_ros.twin.plate_estimator import SampleCounts
from soft_throw_ros.twin.plate_monitor import PlateMonitor
from soft_throw_ros.twin.sample_buffer import Rows, Sample, SampleBuffer
from soft_throw_ros.twin.sensor_checks import SensorChecks
from soft_throw_ros.twin.tick_schedule import SECOND
from twin_runs import BEGIN, INTERVAL, make_samples, MEASUREMENT, PLATE


def noisy(samples: list[Sample], seed: int) -> list[Sample]:
    """Return samples with a noise of 5 um of the plate."""
    noise = 5e-6 * np.random.default_rng(seed).standard_normal(len(samples))
    return [
        sample._replace(plate=sample.plate + error)
        for sample, error in zip(samples, noise.tolist(), strict=True)
    ]


def rows_of(samples: Sequence[Sample]) -> Rows:
    return SampleBuffer(samples).rows


def detect(samples: list[Sample], *, engine_is_nominal: bool = False) -> tuple[Onset | None, int]:
    """Return the first onset and the number of samples needed."""
    monitor = PlateMonitor(MEASUREMENT, SampleCounts(), SensorChecks())
    monitor.engine_is_nominal = engine_is_nominal
    for count, sample in enumerate(samples, 1):
        monitor.estimator.add_samples([sample], sample.stamp_ns)
        _, onset = monitor.advance(sample.stamp_ns)
        if onset is not None:
            return onset, count
    return None, len(samples)


@pytest.mark.parametrize('start', [0.02, 0.0301234])
def test_start_is_found_within_a_short_delay(start) -> None:
    onset, count = detect(make_samples(400, onset=start))
    assert onset is not None
    assert (onset.onset_ns - BEGIN) / SECOND == pytest.approx(start, abs=5e-6)
    assert (onset.rest.plate, onset.rest.projectile) == pytest.approx((0.3, 0.5), abs=2e-6)
    assert count * INTERVAL / SECOND < start + 3.5e-3


def test_start_with_a_trusted_engine_is_found_after_a_millisecond() -> None:
    for seed in range(5):
        samples = noisy(make_samples(400, onset=0.03), seed)
        onset, count = detect(samples, engine_is_nominal=True)
        assert onset is not None
        assert count * INTERVAL / SECOND < 0.03 + 1.4e-3
        assert (onset.onset_ns - BEGIN) / SECOND == pytest.approx(0.03, abs=3e-4)


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


@given(
    zeta=st.floats(0.0, 0.99),
    share=st.floats(0.01, 0.8),
    amplitude=st.floats(1e-4, 1e-2),
)
def test_time_since_the_start_does_not_depend_on_the_amplitude(zeta, share, amplitude) -> None:
    plate = Underdamped(frequency=63.2, amplitude=amplitude, damping_ratio=zeta)
    since = share * plate.peak_velocity_time
    reference = replace(plate, amplitude=1.0)
    found = time_since_start(plate.position(since), plate.velocity(since), reference)
    assert found == pytest.approx(since, rel=1e-6)


def test_start_is_found_as_well_as_the_noise_allows() -> None:
    found = []
    for seed in range(100):
        onset, _ = detect(noisy(make_samples(400, onset=0.025), seed))
        assert onset is not None
        found.append((onset.onset_ns - BEGIN) / SECOND - 0.025)
    since = np.arange(0.0, 2.6e-3, 2e-4)
    sensitivity = np.column_stack((PLATE.velocity(since), PLATE.position(since)))
    bound = 5e-6 * math.sqrt(np.linalg.inv(sensitivity.T @ sensitivity)[0, 0])
    assert np.mean(found) == pytest.approx(0.0, abs=4e-6)
    assert np.std(found) < 1.5 * bound


def test_start_is_found_near_its_estimate_without_later_samples() -> None:
    samples = make_samples(20)
    onset_ns = samples[-1].stamp_ns + SECOND // 100
    start_ns = find_start(rows_of(samples), onset_ns, 0.3, MEASUREMENT)
    assert abs(start_ns - onset_ns) <= 0.25 * MEASUREMENT.smoothing_window_ns
    _, states = first_states(rows_of(samples), start_ns, 0.3, MEASUREMENT)
    assert np.isfinite(states).all()


def test_first_states_start_from_rest_with_a_jump_of_the_acceleration() -> None:
    onset, _ = detect(make_samples(400, onset=0.02))
    assert onset is not None
    onset = replace(onset, onset_ns=BEGIN + SECOND // 50)
    rows = rows_of(onset.samples)
    times, states = first_states(rows, onset.onset_ns, onset.rest.plate, MEASUREMENT)
    assert times == pytest.approx(0.25e-3 * np.arange(6))
    assert states[:, 0] == pytest.approx(PLATE.position(times), abs=1e-12)
    assert states[:, 1] == pytest.approx(PLATE.velocity(times), abs=1e-8)
    start = PLATE.amplitude * (2.0 * math.pi * PLATE.frequency) ** 2
    assert states[0] == pytest.approx([0.0, 0.0, start])


@pytest.mark.parametrize('count', [0, 1])
def test_first_states_follow_the_engine_where_samples_are_uninformative(count) -> None:
    samples = [Sample(BEGIN + 500_000, float(PLATE.position(5e-4)))][:count]
    times, states = first_states(rows_of(samples), BEGIN, 0.0, MEASUREMENT)
    assert states[:, 0] == pytest.approx(PLATE.position(times), rel=1e-12)
    assert states[:, 1] == pytest.approx(PLATE.velocity(times), rel=1e-12)


def test_peak_speed_agrees_with_the_speed_without_noise() -> None:
    times = 2.5e-4 * np.arange(60)
    exact = PLATE.velocity(times)
    assert peak_speed(times[:10], exact[:10], PLATE) == exact[9]  # while it still grows
    for factor in (0.8, 1.25):  # where it was not expected
        other = replace(PLATE, frequency=factor * PLATE.frequency)
        found_there = peak_speed(times, other.velocity(times), PLATE)
        assert found_there == pytest.approx(other.peak_velocity, rel=2e-3)
    assert peak_speed(times, exact, PLATE) == pytest.approx(PLATE.peak_velocity, rel=1e-3)
    random = np.random.default_rng(5)
    found, largest = [], []
    for _ in range(200):
        noisy = exact + 7e-3 * random.standard_normal(times.size)
        found.append(peak_speed(times, noisy, PLATE))
        largest.append(noisy.max())
    assert np.mean(found) == pytest.approx(PLATE.peak_velocity, rel=3e-3)
    assert np.mean(largest) > 1.005 * PLATE.peak_velocity
