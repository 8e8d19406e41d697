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


def smooth(
    at, times, positions, velocities=None, *, window, position_noise, velocity_noise=1.0
):
    """Fit a cubic around each time, with standard deviations of positions and velocities."""
    series = [at, times, positions, np.full(len(times), np.nan)]
    if velocities is not None:
        series[3] = velocities
    series = [np.ascontiguousarray(values, dtype=np.float64) for values in series]
    count = series[0].size
    states, errors, misfits = np.empty((count, 3)), np.empty(count), np.empty((count, 2))
    ratio = position_noise / velocity_noise
    fit_cubics(*series, 0.5 * window, ratio, states, errors, misfits)
    return Smoothed(states, position_noise * errors)
