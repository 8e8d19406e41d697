# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Outliers among the measured positions of a body."""

from __future__ import annotations

import math

import numpy as np
import pytest
from soft_throw_ros.twin.outlier_filter import OutlierFilter

NOISE = 5e-6  # [m]
INTERVAL = 2e-4  # of samples [s]


def find(positions, *, acceleration=0.0, noise=NOISE, stamp_error=0.0) -> list[int]:
    """Return the indices of the outliers of the plate, whose last position is judged."""
    outliers = OutlierFilter(acceleration, noise, stamp_error)
    times = INTERVAL * np.arange(len(positions))
    both = np.stack([positions, np.full(len(positions), math.nan)], axis=1)
    is_outlier = outliers.find(times, both)
    assert is_outlier.shape == both.shape
    assert not is_outlier[:, 1].any()
    return np.flatnonzero(is_outlier[:, 0]).tolist()


@pytest.mark.parametrize(
    ('acceleration', 'noise', 'stamp_error', 'speed'),
    [(0.0, NOISE, 0.0, 0.0), (300.0, NOISE, 0.0, 0.2), (300.0, 1e-9, 1e-5, 0.7)],
)
def test_largest_deviation_is_a_path_and_six_standard_errors(
    acceleration, noise, stamp_error, speed
) -> None:
    # the line through the last two positions has their weights -1 and 2
    error = math.sqrt(6.0) * math.hypot(noise, speed * stamp_error)
    limit = 1.5 * acceleration * INTERVAL**2 + 6.0 * error
    for factor in (-1.001, -0.999, 0.999, 1.001):
        positions = speed * INTERVAL * np.arange(6)
        positions[2] += factor * limit
        outliers = find(
            positions, acceleration=acceleration, noise=noise, stamp_error=stamp_error
        )
        assert (2 in outliers) is (abs(factor) > 1.0)


def test_deviation_that_the_next_position_confirms_is_no_outlier() -> None:
    kink = np.maximum(np.arange(-5.0, 6.0), 0.0) * 100.0 * NOISE
    assert find(kink) == []
    assert find([*kink[:8], 0.0, *kink[9:]]) == [8]


def test_moved_zero_is_accepted_from_the_third_outlier_on() -> None:
    assert find([0.0] * 5 + [1e-3] * 4) == [5, 6]


def test_missing_position_is_no_outlier_and_hides_none() -> None:
    assert find([0.0, 0.0, math.nan, 1e-3, 0.0, 0.0]) == [3]


def test_recent_deviations_widen_the_limit_until_the_noise_is_over() -> None:
    noisy = 10.0 * NOISE * np.random.default_rng(1).standard_normal(2000)
    spike = [0.0] * 4 + [40.0 * NOISE] + [0.0] * 4
    assert find(spike) == [4]
    assert max(find([*noisy, *spike])) < 100  # the filter has to learn the noise
    assert find([*noisy, *[0.0] * 200, *spike])[-1] == 2204


def test_last_row_waits_for_the_next_and_batches_find_the_same_outliers() -> None:
    random = np.random.default_rng(2)
    positions = NOISE * random.standard_normal((400, 2))
    positions[random.random((400, 2)) < 0.05] += 1e-3
    positions[random.random((400, 2)) < 0.05] = math.nan
    times = INTERVAL * np.arange(400.0)
    expected = OutlierFilter(0.0, NOISE, 0.0).find(times, positions)
    assert expected.any(axis=0).all()
    outliers, batches, first = OutlierFilter(0.0, NOISE, 0.0), [], 0
    for end in range(1, 401):
        batches.append(outliers.find(times[first:end], positions[first:end]))
        first += len(batches[-1])
        assert end - first in {0, 1}
    assert 20 < sum(len(batch) == 0 for batch in batches) < 200
    np.testing.assert_array_equal(np.concatenate(batches), expected[:first])
