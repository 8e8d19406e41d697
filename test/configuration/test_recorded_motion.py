# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of the plate from records of its height."""

import numpy as np
import pytest
from soft_throw_ros.configuration.recorded_motion import motion_from_record
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.throws import throw_many

PLATE = Underdamped(frequency=63.2, amplitude=2e-3, damping_ratio=0.064)
TIMES = np.linspace(0.0, 0.05, 251)


@pytest.mark.parametrize('start', [0.0, 0.02, 0.02003, 0.0201, 0.02017])
def test_record_agrees_with_the_motion_that_it_samples(start):
    """At 5 kHz, wherever between two samples it starts; the height at rest does not matter."""
    times = np.arange(0.0, 0.12, 2e-4)
    motion = motion_from_record(times, PLATE.position(times - start) + 3e-3)
    assert motion.start_time == 0.0
    inside = np.linspace(0.0, 0.095, 4001)
    misfit = motion.velocity(inside) - PLATE.velocity(inside)
    assert np.abs(misfit).max() < 1e-3 * PLATE.peak_velocity
    assert np.sqrt(np.mean(misfit**2)) < 1e-4 * PLATE.peak_velocity
    np.testing.assert_allclose(motion.position(inside), PLATE.position(inside), atol=1e-6)


def test_record_converges_with_the_promised_order():
    errors, counts = [], (97, 145, 193)
    inside = np.linspace(0.0, 0.03, 2001)
    for count in counts:
        times = np.linspace(0.0, 0.05, count)
        motion = motion_from_record(times, PLATE.position(times))
        errors.append(np.sqrt(np.mean((motion.position(inside) - PLATE.position(inside)) ** 2)))
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > 3.65


@pytest.mark.parametrize(('noise', 'error'), [(1e-6, 0.01), (5e-6, 0.02), (2e-5, 0.05)])
@pytest.mark.parametrize('seed', range(2))
def test_noise_of_a_record_is_smoothed(noise, error, seed):
    times = np.arange(0.0, 0.15, 2e-4)
    heights = PLATE.position(times - 0.02007)
    heights += noise * np.random.default_rng(seed).standard_normal(times.size)
    motion = motion_from_record(times, heights)
    inside = np.linspace(0.0, 0.02, 501)
    misfit = motion.velocity(inside) - PLATE.velocity(inside)
    assert np.sqrt(np.mean(misfit**2)) < error * PLATE.peak_velocity


@pytest.mark.parametrize(
    ('rate', 'noise', 'error'),
    [
        (5e3, 1e-8, 1e-3), (5e3, 1e-7, 1e-3), (2e3, 5e-6, 0.02), (1e3, 5e-6, 0.02),
        (5e3, 5e-5, 0.05),
    ],
)
def test_record_throws_as_the_plate_that_it_samples(rate, noise, error):
    """A wrong acceleration at the start would throw the projectile off at once."""
    random = np.random.default_rng(6)
    expected = throw_many(Rig()).ejection_speed
    times = np.arange(0.0, 0.15, 1.0 / rate)
    speeds = []
    for _ in range(12):
        heights = PLATE.position(times - 0.02 - random.uniform(0.0, 1.0 / rate))
        heights += noise * random.standard_normal(times.size)
        motion = motion_from_record(times, heights)
        speeds.append(throw_many(Rig(engine=Engine(motion=motion))).ejection_speed)
    assert speeds == pytest.approx(np.full(12, expected), rel=error)


def test_record_takes_times_that_are_not_even():
    random = np.random.default_rng(3)
    times = np.arange(0.0, 0.12, 2e-4) + 5e-5 * random.uniform(size=600)
    motion = motion_from_record(times, PLATE.position(times - 0.03))
    inside = np.linspace(0.0, 0.08, 2001)
    np.testing.assert_allclose(motion.velocity(inside), PLATE.velocity(inside), atol=1e-3)


@pytest.mark.parametrize(
    ('heights', 'message'),
    [
        (np.zeros(20), 'from 0 to 0 m'),
        (np.arange(20.0) ** 2, r'got \d.* m/s at the last sample'),
        (PLATE.position(TIMES[:7]), 'at least 8, got 7'),
        (np.where(np.arange(20) > 15, 1.0, 0.0), 'after the start must be at least 8, got'),
    ],
)
def test_record_of_no_motion_is_refused(heights, message):
    with pytest.raises(ValueError, match=message):
        motion_from_record(5e-3 * np.arange(heights.size), heights)
