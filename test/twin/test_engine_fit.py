# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The engine's motion fitted to the samples of a throw."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.twin.engine_fit import AMPLITUDE, EngineEstimate, EngineFit, START
from soft_throw_ros.twin.plate_estimator import Onset, RestBaseline
from soft_throw_ros.twin.sample_buffer import Rows, Sample, SampleBuffer
from soft_throw_ros.twin.tick_schedule import SECOND
from twin_runs import BEGIN, MEASUREMENT

START_TIME = 2.3e-4  # start of the plate's motion, relative to the origin of the fit [s]
NOISE = 5e-6  # [m]


def measure(plate: Underdamped, count: int, *, rate: float, seed: int) -> Rows:
    """Measure a plate from 2 ms before its start."""
    random = np.random.default_rng(seed)
    times = -2e-3 + np.arange(count) / rate
    heights = 0.3 + plate.position(times - START_TIME) + NOISE * random.standard_normal(count)
    stamps = BEGIN + np.rint(times * SECOND)
    return SampleBuffer(
        [Sample(int(stamp), height) for stamp, height in zip(stamps, heights, strict=True)]
    ).rows


def start_fit(plate: Underdamped) -> EngineFit:
    return EngineFit(
        replace(MEASUREMENT, plate=plate),
        Onset(
            onset_ns=BEGIN,
            rest=RestBaseline(plate=0.3, projectile=math.nan, noise=NOISE, error=1e-6),
            samples=(),
        ),
    )


def deviations(estimate: EngineEstimate, amplitude: float) -> np.ndarray:
    """Return the deviations of amplitude and start in standard errors."""
    known = [AMPLITUDE, START]
    errors = np.sqrt(estimate.covariance.diagonal()[known])
    return (estimate.unknowns[known] - [amplitude, START_TIME]) / errors


@pytest.mark.parametrize('frequency', [5.0, 63.2])
def test_older_samples_stay_in_the_fit_of_a_long_throw(frequency) -> None:
    plate = Underdamped(frequency=frequency, amplitude=2e-3, damping_ratio=0.064)
    off = []
    for seed in range(8):
        rows = measure(replace(plate, amplitude=1.9e-3), 4000, rate=4000.0 * frequency, seed=seed)
        fit, errors = start_fit(plate), []
        for first in range(0, len(rows), 37):
            estimate = fit.update(rows[first: first + 37])
            if estimate is not None:
                errors.append(np.sqrt(estimate.covariance[START, START]))
        assert not fit.has_failed
        assert fit.outliers == 0
        # more samples than are kept make it better still
        assert errors[-1] < 0.7 * errors[len(errors) // 4]
        off.append(deviations(estimate, -0.05))
    assert np.abs(off).max() < 4.0
    assert np.square(off).mean() < 2.0


def test_motion_of_another_engine_fails() -> None:
    fit = start_fit(MEASUREMENT.plate)
    other = replace(MEASUREMENT.plate, frequency=58.0)
    assert fit.update(measure(other, 60, rate=5000.0, seed=3)) is None
    assert fit.has_failed
