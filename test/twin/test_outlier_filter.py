# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Outliers among the measured heights of a body."""

from __future__ import annotations

import math

import numpy as np
import pytest
from soft_throw_ros.twin.sample_buffer import OutlierFilter
from twin_runs import PLATE

NOISE = 5e-6  # [m]
INTERVAL = 200_000  # of samples [ns]


def find(heights, *, noise=NOISE, stamp_error=0.0) -> list[int]:
    """Return the indices of the outliers of the plate."""
    stamps = INTERVAL * np.arange(len(heights))
    both = np.stack([heights, np.full(len(heights), math.nan)], axis=1)
    is_outlier = OutlierFilter(PLATE, noise, stamp_error).find(stamps, both)
    assert not is_outlier[:, 1].any()
    return np.flatnonzero(is_outlier[:, 0]).tolist()


@pytest.mark.parametrize('sign', [-1.0, 1.0])
def test_noise_of_a_throw_is_no_outlier_and_a_large_deviation_is(sign) -> None:
    random = np.random.default_rng(1)
    heights = PLATE.position(1e-9 * INTERVAL * np.arange(-50, 200))
    heights += NOISE * random.standard_normal(250)
    assert find(heights) == []
    for index in range(3, 250, 7):
        changed = heights.copy()
        changed[index] += sign * 60.0 * NOISE
        assert find(changed) == [index]


def test_stamp_error_counts_as_noise_of_a_moving_body() -> None:
    moving = 0.7e-9 * INTERVAL * np.arange(60.0)
    moving[40] += 0.7 * 1e-4  # of a stamp
    assert find(moving) == [40]
    assert find(moving, stamp_error=3e-5) == []


def test_moved_zero_is_accepted_from_the_third_outlier_on() -> None:
    assert find([0.0] * 5 + [1e-3] * 9) == [5, 6]


def test_missing_height_is_no_outlier_and_hides_none() -> None:
    assert find([0.0, 0.0, 0.0, math.nan, 1e-3, 0.0, 0.0]) == [4]


def test_recent_deviations_widen_the_limit_until_the_noise_is_over() -> None:
    noisy = 10.0 * NOISE * np.random.default_rng(1).standard_normal(2000)
    spike = [0.0] * 4 + [40.0 * NOISE] + [0.0] * 4
    assert find(spike) == [4]
    assert max(find([*noisy, *spike])) < 100  # the filter has to learn the noise
    assert find([*noisy, *[0.0] * 200, *spike])[-1] == 2204
