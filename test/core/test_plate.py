# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of the plate."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core.plate import SampledMotion, Underdamped

PLATE = Underdamped(frequency=63.2, amplitude=2e-3, damping_ratio=0.064)
TIMES = np.linspace(0.0, 0.05, 251)


def test_harmonic_motion_is_equation_1():
    omega = 2.0 * math.pi * 63.2
    plate, position = Underdamped(frequency=63.2, amplitude=2e-3), 1.0 - np.cos(omega * TIMES)
    assert plate.position(TIMES) == pytest.approx(2e-3 * position, rel=1e-7, abs=1e-17)
    speed = 2e-3 * omega * np.sin(omega * TIMES)
    assert plate.velocity(TIMES) == pytest.approx(speed, rel=1e-7, abs=1e-14)


@given(st.floats(0.0, 0.95))
def test_velocity_is_the_slope_of_the_position_and_peaks_at_its_time(damping_ratio):
    plate = Underdamped(frequency=63.2, amplitude=2e-3, damping_ratio=damping_ratio)
    slope = (plate.position(TIMES + 1e-6) - plate.position(TIMES - 1e-6)) / 2e-6
    assert slope[1:] == pytest.approx(plate.velocity(TIMES)[1:], rel=1e-7, abs=1e-6)
    assert plate.velocity(plate.peak_velocity_time) == pytest.approx(plate.peak_velocity)
    assert plate.velocity(TIMES).max() <= plate.peak_velocity * (1.0 + 1e-12)


def test_motion_rests_before_its_start_and_a_sampled_one_after_its_end():
    sampled = SampledMotion.from_positions(TIMES, PLATE.position(TIMES))
    for plate in (PLATE, sampled):
        assert not plate.states_at(np.array([-1.0, -1e-9])).any()
    end = PLATE.position(0.05)
    assert sampled.states_at(np.array(0.06)) == pytest.approx([float(end), 0.0, 0.0])


def test_sampled_positions_converge_with_the_promised_order():
    fine, counts, errors = np.linspace(0.0, 0.05, 4001), (65, 129, 257, 513), []
    for count in counts:
        times = np.linspace(0.0, 0.05, count)
        sampled = SampledMotion.from_positions(times, PLATE.position(times))
        errors.append(np.sqrt(np.mean((sampled.position(fine) - PLATE.position(fine)) ** 2)))
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > 3.65
    assert sampled.peak_velocity == pytest.approx(PLATE.peak_velocity, rel=1e-5)


@pytest.mark.parametrize(
    ('times', 'values', 'message'),
    [
        ([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], r'at least 4, got shapes \(3,\)'),
        ([0.0, 1.0, 1.0, 2.0], [0.0] * 4, r'times must increase, got 1\.0 after 1\.0 at index 2'),
        ([0.0, 1.0, 2.0, 3.0], [0.0, math.nan, 0.0, 0.0], r'must be finite, got nan at index 1'),
        ([0.0, math.inf, 2.0, 3.0], [0.0] * 4, r'times must be finite, got inf at index 1'),
    ],
)
def test_invalid_samples_of_a_motion_are_refused_with_the_value(times, values, message):
    with pytest.raises(ValueError, match=message):
        SampledMotion.from_positions(times, values)


def test_scaled_motion_is_the_same_in_other_units():
    motion = SampledMotion.from_positions(TIMES, PLATE.position(TIMES))
    scaled = motion.scaled(time=2.0, height=3.0)
    np.testing.assert_allclose(scaled.position(2.0 * TIMES), 3.0 * motion.position(TIMES))
    assert scaled.peak_velocity == pytest.approx(1.5 * motion.peak_velocity)
