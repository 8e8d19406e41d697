# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The observer of a measured plate, against a joint normal distribution of all its states."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from scipy.linalg import expm
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.plate_observer import (
    AMPLITUDE_ERROR,
    PlateObserver,
    pulse_of,
    ReleaseResponse,
    UNMODELLED,
)
from soft_throw_ros.twin.sample_buffer import Onset, RestBaseline
from twin_runs import BEGIN, MEASUREMENT, PLATE, Sample, samples_of

NOISE = 5e-6
REST = RestBaseline(plate=0.3, projectile=math.nan, noise=NOISE, error=1e-6)
ONSET = Onset(onset_ns=BEGIN, rest=REST, samples=samples_of([]))
CONFIG = replace(
    MEASUREMENT, stamp_error=0.0, frequency_error=0.0, damping_error=0.0,
    smoothing_window_ns=SECOND // 50,  # so long that nothing is settled
)
OMEGA = PLATE.angular_frequency
STEP = 1e-4
NO_RESPONSE = ReleaseResponse(np.zeros(1), np.zeros((3, 1)), 0.0)


def observe(
    heights: np.ndarray, response: ReleaseResponse = NO_RESPONSE, **changes
) -> PlateObserver:
    """Observe heights above the rest, with a sample in each step after the start."""
    observer = PlateObserver(replace(CONFIG, **changes), ONSET, response)
    samples = [
        Sample(BEGIN + (n + 1) * round(STEP * SECOND), 0.3 + height)
        for n, height in enumerate(heights.tolist())
    ]
    observer.add(samples_of(samples))
    return observer


def joint_distribution(count: int) -> np.ndarray:
    """Return the covariance of difference, rate and amplitude at the start and in each step."""
    matrix = np.zeros((3, 3))
    matrix[0, 1], matrix[1] = 1.0, [-OMEGA**2, -2.0 * PLATE.damping_ratio * OMEGA, OMEGA**2]
    jump, fine = expm(STEP * matrix), 200
    density = (UNMODELLED * PLATE.peak_velocity) ** 2 * OMEGA
    answers = [expm(STEP * (k + 0.5) / fine * matrix)[:, 1] for k in range(fine)]
    noise = density * STEP / fine * sum(np.outer(answer, answer) for answer in answers)
    speed = UNMODELLED * PLATE.amplitude * OMEGA
    start = np.diag(np.square([REST.error, speed, AMPLITUDE_ERROR * PLATE.amplitude]))
    size = 3 * (count + 1)
    map_, sources = np.eye(size), np.zeros((size, size))
    sources[:3, :3] = start
    for n in range(1, count + 1):
        map_[3 * n:3 * n + 3] += jump @ map_[3 * n - 3:3 * n]
        sources[3 * n:3 * n + 3, 3 * n:3 * n + 3] = noise
    return map_ @ sources @ map_.T


def test_smoothed_states_and_errors_are_those_of_the_joint_distribution() -> None:
    count, used = 60, 40
    covariance = joint_distribution(count)
    random = np.random.default_rng(2)
    times = STEP * np.arange(1, used + 1)
    differences = NOISE * random.standard_normal(used) + 2e-5 * np.sin(500.0 * times)
    # the release has the velocity of the plate at the last step
    axis = STEP * np.arange(count + 1)
    velocities = pulse_of(PLATE, axis[-1] - axis)[:, 1]
    response = ReleaseResponse(axis, np.array([velocities] * 3), axis[-1])
    observer = observe(PLATE.position(times) + differences, response)
    measured = 3 * np.arange(1, used + 1)
    gain = covariance[:, measured] @ np.linalg.inv(
        covariance[np.ix_(measured, measured)] + NOISE**2 * np.eye(used)
    )
    mean = (gain @ differences).reshape(-1, 3)
    found, states, _ = observer.motion(STEP * count)
    index = np.rint(found / STEP).astype(int)
    on_grid = np.abs(found / STEP - index) < 1e-6
    expected = PLATE.states_at(found)[:, :2] + mean[index, :2]
    assert on_grid.sum() >= 3
    # the filter leaves out that unknown accelerations decay within a step
    np.testing.assert_allclose(states[on_grid, 0], expected[on_grid, 0], atol=1e-7)
    np.testing.assert_allclose(states[on_grid, 1], expected[on_grid, 1], atol=1e-4)
    left = covariance - gain @ covariance[measured]
    error = math.sqrt(left[3 * count + 1, 3 * count + 1])
    assert observer.errors() == pytest.approx([error] * 3, rel=0.05)


def test_plate_that_moves_in_another_way_is_followed() -> None:
    times = STEP * np.arange(1, 101)
    jump = 1e-3 * (times > 5e-3)
    observer = observe(PLATE.position(times) + jump)
    found, states, _ = observer.motion(0.0)
    late = found > 7e-3
    np.testing.assert_allclose(states[late, 0], PLATE.position(found[late]) + 1e-3, atol=5e-6)


def test_settled_states_do_not_change_any_more() -> None:
    times = STEP * np.arange(1, 61)
    observer = observe(PLATE.position(times[:30]), smoothing_window_ns=2_000_000)
    times, states, settled = observer.motion(5e-3)
    first = times[:settled]
    assert first[0] == 0.0
    assert first[-1] == pytest.approx(2e-3, abs=2.6e-4)
    assert times[-1] == pytest.approx(5e-3)
    np.testing.assert_allclose(states[:settled, 0], PLATE.position(first), atol=1e-6)
    later, others, settled = observer.motion(5e-3)
    assert settled == 0
    assert later[0] > first[-1]
    np.testing.assert_allclose(others[:, 0], PLATE.position(later), atol=1e-5)


def test_too_early_onset_does_not_pull_the_layer_down() -> None:
    times = STEP * np.arange(1, 31)
    _, states, _ = observe(PLATE.position(times - 5e-5)).motion(0.0)
    assert states[0, 1] == 0.0
