# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Faults of the sensors of a measured plate."""

import math

import numpy as np
import pytest
from soft_throw_ros.twin.plate_estimator import PlateEstimator, SampleCounts, SampledSpan
from soft_throw_ros.twin.sample_buffer import Sample, Samples
from soft_throw_ros.twin.sensor_checks import (
    HighNoise,
    LowRate,
    SensorChecks,
)
from soft_throw_ros.twin.tick_schedule import SECOND
from twin_runs import MEASUREMENT


def estimate(*, rate: float = 5000.0, noise: float = 1e-6) -> PlateEstimator:
    """Return an estimator of a plate at rest."""
    random = np.random.default_rng(3)
    samples = [
        Sample(round(index * SECOND / rate), noise * random.standard_normal())
        for index in range(100)
    ]
    return PlateEstimator(MEASUREMENT, SampleCounts(), samples=Samples.of(samples))


def test_good_sensor_is_not_reported() -> None:
    checks = SensorChecks()
    assert checks.diagnose(estimate(), 2e-3, is_armed=False) == ()
    assert checks.diagnose(estimate(), 2e-3, is_armed=True) == ()


def test_noise_and_rate_are_reported_once_per_throw() -> None:
    checks, noisy = SensorChecks(), estimate(rate=500.0, noise=4.0 * MEASUREMENT.position_noise)
    rate, noise = checks.diagnose(noisy, 2e-3, is_armed=False)
    assert isinstance(rate, LowRate)
    assert rate.rate == pytest.approx(500.0)
    assert isinstance(noise, HighNoise)
    assert noise.noise == pytest.approx(4.0 * noise.expected, rel=0.3)
    assert noise.expected == MEASUREMENT.position_noise
    assert checks.diagnose(noisy, 2e-3, is_armed=False) == ()
    checks.begin()
    again = estimate(rate=499.0, noise=4.0 * MEASUREMENT.position_noise)
    assert len(checks.diagnose(again, 2e-3, is_armed=False)) == 2


def test_rate_must_suffice_for_the_layer_once_the_plate_is_at_rest() -> None:
    checks = SensorChecks()
    assert checks.has_rate(estimate(), math.inf)
    assert checks.has_rate(estimate(rate=1980.0), math.inf)  # 2 kHz, with stamps that jitter
    assert not checks.has_rate(estimate(), 1e-4)
    (fault,) = checks.diagnose(estimate(), 1e-4, is_armed=True)
    assert isinstance(fault, LowRate)
    assert fault.least_rate == pytest.approx(30_000.0)
    assert fault.span is SampledSpan.CROSSING
