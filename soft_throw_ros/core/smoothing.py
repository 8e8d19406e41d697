# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Position, velocity and acceleration from noisy samples, a little behind the last one.

The filter of Savitzky and Golay [1]_, for samples at any times: a cubic is fitted to the samples
in a window by least squares, and evaluated at three quarters of the window. There the noise of the
velocity is as small as in the middle, because a cubic is not noisier than a parabola at this
point, and the delay is a quarter instead of half a window.

References
----------
.. [1] A. Savitzky and M. J. E. Golay, "Smoothing and differentiation of data by simplified least
   squares procedures", Anal. Chem. 36 (1964) 1627.

"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import kernel, subroutine

Floats = NDArray[np.float64]

BEHIND, AHEAD = 0.75, 0.25
"""Parts of the window before and after the time at which it is evaluated. [-]"""

FEWEST = 4
"""Samples that a window must have."""


@subroutine
def _solve(rows: Floats) -> bool:
    """Solve a positive definite system beside its right sides; False if it is singular."""
    size = rows.shape[0]
    for i in range(size):
        largest = rows[i, i]
        for k in range(i):
            for j in range(rows.shape[1] - 1, k, -1):
                rows[i, j] -= rows[i, k] * rows[k, j]
        if not rows[i, i] > 1e-12 * largest:
            return False
        for j in range(rows.shape[1] - 1, i - 1, -1):
            rows[i, j] /= rows[i, i]
    for i in range(size - 2, -1, -1):
        for j in range(size, rows.shape[1]):
            for k in range(i + 1, size):
                rows[i, j] -= rows[i, k] * rows[k, j]
    return True


@kernel
def fit_cubics(
    at: Floats, times: Floats, positions: Floats, half: float, states: Floats, errors: Floats,
) -> None:
    """
    Fit a cubic around each of some times [s]; the error of the velocity is of third order.

    All times increase; `half` is half the length of the window [s]. A row of the results `states`
    is position [m], velocity [m/s] and acceleration [m/s2]; `errors` are those of the velocity for
    unit noise of the position [1/s]. NaN where samples are too few, or on one side only.
    """
    first = 0
    behind, ahead = 2.0 * BEHIND, 2.0 * AHEAD
    row, system = np.empty(4), np.empty((4, 6))  # normal equations, and their two right sides
    for n in range(at.size):
        while first < times.size and (times[first] - at[n]) / half < -behind:
            first += 1
        system[:] = 0.0
        system[1, 5] = 1.0
        count, before = 0, 0
        k = first
        while k < times.size and (times[k] - at[n]) / half <= ahead:
            u = (times[k] - at[n]) / half
            row[0], row[1], row[2], row[3] = 1.0, u, u * u, u * u * u
            value = positions[k] - positions[first]
            for i in range(4):
                system[i, 4] += row[i] * value
                for j in range(4):
                    system[i, j] += row[i] * row[j]
            count += 1
            before += u <= 0.0
            k += 1
        if count < FEWEST or before in (0, count) or not _solve(system):
            states[n] = np.nan
            errors[n] = np.nan
            continue
        states[n, 0] = system[0, 4] + positions[first]
        states[n, 1] = system[1, 4] / half
        states[n, 2] = 2.0 * system[2, 4] / (half * half)
        errors[n] = np.sqrt(system[1, 5]) / half


def warm_up() -> None:
    """Compile or load all kernels."""
    times, zeros = np.array([0.0, 0.25, 0.5, 1.0]), np.zeros(4)
    results = np.empty((1, 3)), np.empty(1)
    fit_cubics(np.array([0.5]), times, zeros, 0.5, *results)
