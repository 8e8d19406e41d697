# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Local fits of cubics to noisy samples."""

import math

import numpy as np
import pytest
from reference.smoothing import smooth
from scipy.signal import savgol_coeffs
from soft_throw_ros.core.smoothing import AHEAD, BEHIND

NOISE = 5e-6


def test_even_samples_give_the_filter_of_savitzky_and_golay():
    spacing, count, at = 1e-4, 13, 9
    positions = np.random.default_rng(1).standard_normal(count)
    times = spacing * np.arange(count)
    window = 1.0001 * spacing * (count - 1)
    fit = smooth([times[at]], times, positions, window=window, position_noise=NOISE)
    for order in range(3):
        weights = savgol_coeffs(count, 3, deriv=order, delta=spacing, pos=at, use='dot')
        assert fit.states[0, order] == pytest.approx(weights @ positions, rel=1e-9)
        if order == 1:
            assert fit.errors[0] == pytest.approx(NOISE * np.linalg.norm(weights), rel=1e-9)


def test_uneven_samples_agree_with_least_squares():
    random = np.random.default_rng(2)
    times = np.sort(random.uniform(0.0, 1.0, 15))
    positions = random.standard_normal(15)
    fit = smooth([BEHIND], times, positions, window=1.0, position_noise=0.1)
    powers = np.vander(times - BEHIND, 4, increasing=True)
    solution = np.linalg.lstsq(powers, positions, rcond=None)[0]
    assert fit.states[0] == pytest.approx(solution[:3] * [1.0, 1.0, 2.0], rel=1e-8)
    covariance = np.linalg.inv(powers.T @ powers)
    assert fit.errors[0] == pytest.approx(0.1 * math.sqrt(covariance[1, 1]), rel=1e-8)


def test_error_of_the_velocity_is_of_third_order_in_the_window():
    omega, errors = 2.0 * math.pi * 63.2, []
    windows = (1e-3, 2e-3, 4e-3)
    times = np.arange(0.0, 0.02, 2e-5)
    for window in windows:
        fit = smooth([0.01], times, np.cos(omega * times), window=window, position_noise=1.0)
        errors.append(abs(fit.states[0, 1] + omega * math.sin(omega * 0.01)))
    assert np.polyfit(np.log(windows), np.log(errors), 1)[0] == pytest.approx(3.0, abs=0.3)


def test_too_few_or_one_sided_samples_give_unknown():
    times = np.array([0.0, 0.1, 0.2, 0.9, 1.0])
    fit = smooth([0.4, 0.7, 1.7], times, np.zeros(5), window=1.0, position_noise=1.0)
    assert np.isnan(fit.states[0]).all()  # three
    assert fit.states[1].tolist() == [0.0] * 3
    assert np.isnan(fit.errors[2])  # before it only
    assert BEHIND + AHEAD == 1.0
