# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Local fits of cubics to samples, given as lists or arrays."""

from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.smoothing import fit_cubics


class Smoothed(NamedTuple):
    """States by rows, and standard errors of the velocity [m/s]."""

    states: np.ndarray
    errors: np.ndarray


def smooth(at, times, positions, *, window, position_noise):
    """Fit a cubic around each time, with the standard deviation of positions."""
    series = [
        np.ascontiguousarray(values, dtype=np.float64) for values in (at, times, positions)
    ]
    count = series[0].size
    states, errors = np.empty((count, 3)), np.empty(count)
    fit_cubics(*series, 0.5 * window, states, errors)
    return Smoothed(states, position_noise * errors)
