# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Outliers among the measured heights of plate and projectile, judged as samples arrive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import kernel
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.twin.tick_schedule import SECOND

Floats = NDArray[np.float64]

MEDIAN_DEVIATION = 0.6745
"""Median of the magnitude of standard normal numbers. [-]"""

OUTLIER_SIGMAS = 6.0
"""Standard errors beyond which a sample is an outlier; noise is so far off once in 5e8. [-]"""

MAX_OUTLIERS_IN_A_ROW = 3
"""Outliers in a row that show that the expectation is wrong, and not the samples. [-]"""

_TRACKING = 1.05
"""Correction factor of the running median of the deviations, per sample. [-]"""

_BODY = np.dtype(
    [
        ('stamp', 'i8'),  # of the last height [ns]
        ('state', 'f8', (2,)),  # height [m] and velocity [m/s] then
        ('covariance', 'f8', (2, 2)),
        ('median', 'f8'),  # running median of deviations over standard errors [-]
        ('in_a_row', 'i8'),  # outliers since the last accepted height
    ],
    align=True,
)


class OutlierFilter:
    """
    A filter that finds outliers among the heights of plate and projectile.

    Each body is followed by a Kalman filter of its height and velocity. Between two samples it has
    an unknown constant acceleration, whose standard deviation is half of the engine's. A height
    that is `OUTLIER_SIGMAS` standard errors off is an outlier; the last of `MAX_OUTLIERS_IN_A_ROW`
    is accepted, because the body moves in another way or the zero of the sensor has moved.
    Standard errors are from the `noise` [m] and the `stamp_error` [s], which displaces a moving
    body, or from recent deviations if these are larger.
    """

    def __init__(self, plate: Underdamped, noise: float, stamp_error: float) -> None:
        acceleration = 0.5 * plate.amplitude * plate.angular_frequency**2
        self._parameters = acceleration, plate.peak_velocity, noise, stamp_error
        self._bodies = np.zeros(2, _BODY)
        self._bodies['in_a_row'] = MAX_OUTLIERS_IN_A_ROW  # so that the first height is accepted
        self._bodies['state'][:, 0] = np.inf
        self._bodies['median'] = MEDIAN_DEVIATION

    def find(self, stamps: NDArray[np.int64], heights: Floats) -> NDArray[np.bool_]:
        """Return which of the following heights are outliers, shape (n, 2); NaN is none."""
        is_outlier = np.zeros(heights.shape, dtype=np.bool_)
        _find(self._bodies, stamps, heights, *self._parameters, is_outlier)
        return is_outlier


@kernel
def _find(
    bodies: NDArray[np.void],
    stamps: NDArray[np.int64],
    heights: Floats,
    acceleration: float,
    speed: float,
    noise: float,
    stamp_error: float,
    is_outlier: NDArray[np.bool_],
) -> None:
    """Test heights in order."""
    for body in range(bodies.size):
        s = bodies[body]
        x, p = s.state, s.covariance
        for n in range(stamps.size):
            height, h = heights[n, body], (stamps[n] - s.stamp) / SECOND
            if np.isnan(height):
                continue
            s.stamp = stamps[n]
            x[0] += h * x[1]
            p[0, 0] += h * (2.0 * p[0, 1] + h * p[1, 1]) + (0.5 * acceleration * h * h) ** 2
            p[0, 1] += h * p[1, 1] + 0.5 * (acceleration * h) ** 2 * h
            p[1, 1] += (acceleration * h) ** 2
            variance = noise**2 + (x[1] * stamp_error) ** 2
            error = height - x[0]
            deviation = abs(error) / np.sqrt(p[0, 0] + variance)
            is_far = deviation > OUTLIER_SIGMAS / MEDIAN_DEVIATION * s.median
            s.median *= _TRACKING if deviation > s.median else 1.0 / _TRACKING
            s.median = max(s.median, MEDIAN_DEVIATION)
            s.in_a_row = s.in_a_row + 1 if is_far else 0
            if 0 < s.in_a_row < MAX_OUTLIERS_IN_A_ROW:
                is_outlier[n, body] = True
                continue
            if s.in_a_row:  # begin again
                s.in_a_row = 0
                x[0], x[1] = height, 0.0
                p[0, 0], p[0, 1], p[1, 1] = variance, 0.0, speed**2
                continue
            total = p[0, 0] + variance
            gain0, gain1 = p[0, 0] / total, p[0, 1] / total
            x[0] += gain0 * error
            x[1] += gain1 * error
            p[1, 1] -= gain1 * p[0, 1]
            p[0, 1] -= gain0 * p[0, 1]
            p[0, 0] -= gain0 * p[0, 0]


def warm_up() -> None:
    """Compile the kernel, or load it from the cache on disk."""
    plate = Underdamped(amplitude=1.0, frequency=1.0, damping_ratio=0.1)
    OutlierFilter(plate, 1.0, 0.0).find(np.arange(4), np.zeros((4, 2)))
