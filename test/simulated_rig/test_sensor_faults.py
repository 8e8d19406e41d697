# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Faults of sensors, one by one."""

import numpy as np
import pytest
from soft_throw_ros.simulated_rig.sensor_faults import (
    chances_one_by_one,
    draw_chances,
    SensorFaults,
)

TIME = np.arange(0.0, 4.0, 1e-3)


def plate(time):
    return 2e-3 + 1e-3 * time


def projectile(time):
    return 1e-2 + 0.1 * time


def measure(seed=0, **faults):
    chances = draw_chances(np.random.default_rng(seed), TIME.size)
    return SensorFaults(**faults).measure(TIME, plate, projectile, chances)


def test_sensors_without_faults_are_exact():
    sample = measure()
    assert (sample.stamp == TIME).all()
    assert (sample.plate == plate(TIME)).all()
    assert (sample.projectile == projectile(TIME)).all()
    assert sample.is_received.all()


def test_each_fault_has_its_specified_size():
    assert np.std(measure(noise=1e-4).plate - plate(TIME)) == pytest.approx(1e-4, rel=0.05)
    off = np.abs(measure(outlier_rate=0.1, outlier_size=3e-3).projectile - projectile(TIME))
    assert (off > 0.0).mean() == pytest.approx(0.1, abs=0.02)
    assert off[off > 1e-12].min() >= 3e-4
    assert off.max() == pytest.approx(3e-3, rel=0.02)
    assert measure(missing_rate=0.2).is_received.mean() == pytest.approx(0.8, abs=0.03)
    assert measure(projectile_scale=1.01).projectile == pytest.approx(1.01 * projectile(TIME))
    assert measure(projectile_delay=0.01).projectile == pytest.approx(projectile(TIME - 0.01))
    rounded = measure(rounding=2e-5).plate
    assert rounded / 2e-5 == pytest.approx(np.rint(rounded / 2e-5), abs=1e-6)
    assert np.abs(rounded - plate(TIME)).max() <= 1.001e-5


def test_drift_reverses_and_is_equal_for_both_sensors():
    sample = measure(drift=1e-3)
    drift = sample.plate - plate(TIME)
    assert sample.projectile - projectile(TIME) == pytest.approx(drift, abs=1e-15)
    assert drift[[0, 500, 1000, 1500, 2000]] == pytest.approx([0.0, 5e-4, 1e-3, 5e-4, 0.0])


def test_jitter_changes_stamps_and_not_heights():
    jittered, wrong = measure(jitter=1e-4), measure(stamp_error=1e-4)
    assert jittered.plate == pytest.approx(plate(jittered.stamp), abs=1e-15)
    assert (wrong.plate == plate(TIME)).all()
    for sample in (jittered, wrong):
        assert np.abs(sample.stamp - TIME).max() == pytest.approx(1e-4, rel=0.02)


def test_single_samples_agree_with_a_block():
    faults = SensorFaults(
        noise=1e-5, jitter=1e-5, stamp_error=1e-5, outlier_rate=0.3, outlier_size=1e-3,
        drift=1e-3, projectile_delay=1e-4, projectile_scale=1.1, missing_rate=0.3, rounding=1e-5,
    )
    time = np.linspace(0.0, 4.0, 4096)
    block = faults.measure(time, plate, projectile, draw_chances(np.random.default_rng(1), 4096))
    singles = chances_one_by_one(np.random.default_rng(1))
    for moment, *measured in zip(time.tolist(), *block, strict=True):
        single = faults.measure(moment, plate, projectile, next(singles))
        assert single == pytest.approx(tuple(measured))
