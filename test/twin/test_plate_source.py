# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Start, first states and peak speed of a measured plate."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from soft_throw_ros.twin.plate_source import find_start, first_states, peak_speed
from soft_throw_ros.twin.sample_buffer import Sample, SampleBuffer
from soft_throw_ros.twin.tick_schedule import SECOND
from twin_runs import BEGIN, make_samples, MEASUREMENT, PLATE


def test_start_is_found_near_its_estimate_without_later_samples() -> None:
    rows = SampleBuffer(make_samples(20)).rows
    onset_ns = int(rows['stamp_ns'][-1]) + SECOND // 100
    start_ns = find_start(rows, onset_ns, 0.3, MEASUREMENT)
    assert abs(start_ns - onset_ns) <= 0.25 * MEASUREMENT.smoothing_window_ns
    _, states = first_states(rows, start_ns, 0.3, MEASUREMENT)
    assert np.isfinite(states).all()


def test_first_states_start_from_rest_with_a_jump_of_the_acceleration() -> None:
    rows = SampleBuffer(make_samples(120, onset=0.02)).rows
    times, states = first_states(rows, BEGIN + SECOND // 50, 0.3, MEASUREMENT)
    assert times == pytest.approx(0.25e-3 * np.arange(6))
    assert states[:, 0] == pytest.approx(PLATE.position(times), abs=1e-12)
    assert states[:, 1] == pytest.approx(PLATE.velocity(times), abs=1e-8)
    start = PLATE.amplitude * (2.0 * math.pi * PLATE.frequency) ** 2
    assert states[0] == pytest.approx([0.0, 0.0, start])


@pytest.mark.parametrize('count', [0, 1])
def test_first_states_follow_the_engine_where_samples_are_uninformative(count) -> None:
    rows = SampleBuffer([Sample(BEGIN + 500_000, float(PLATE.position(5e-4)))][:count]).rows
    times, states = first_states(rows, BEGIN, 0.0, MEASUREMENT)
    assert states[:, 0] == pytest.approx(PLATE.position(times), rel=1e-12)
    assert states[:, 1] == pytest.approx(PLATE.velocity(times), rel=1e-12)


def test_peak_speed_agrees_with_the_speed_without_noise() -> None:
    times = 2.5e-4 * np.arange(60)
    exact = PLATE.velocity(times)
    assert peak_speed(times[:10], exact[:10], PLATE) == exact[9]  # while it still grows
    for factor in (0.8, 1.25):  # where it was not expected
        other = replace(PLATE, frequency=factor * PLATE.frequency)
        speed = peak_speed(times, other.velocity(times), PLATE)
        assert speed == pytest.approx(other.peak_velocity, rel=2e-3)
    assert peak_speed(times, exact, PLATE) == pytest.approx(PLATE.peak_velocity, rel=1e-3)
    random = np.random.default_rng(5)
    parabolic, largest = [], []
    for _ in range(200):
        noisy = exact + 7e-3 * random.standard_normal(times.size)
        parabolic.append(peak_speed(times, noisy, PLATE))
        largest.append(noisy.max())
    assert np.mean(parabolic) == pytest.approx(PLATE.peak_velocity, rel=3e-3)
    assert np.mean(largest) > 1.005 * PLATE.peak_velocity
