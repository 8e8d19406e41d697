# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Outliers among the measured positions of a body, judged as samples arrive."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import kernel, Record, subroutine

Floats = NDArray[np.float64]

MEDIAN_DEVIATION = 0.6745
"""Median of the magnitude of standard normal numbers. [-]"""

OUTLIER_SIGMAS = 6.0
"""Standard errors beyond which a sample is an outlier; noise is so far off once in 5e8. [-]"""

MAX_OUTLIERS_IN_A_ROW = 3
"""Outliers in a row that show that the expectation is wrong, and not the samples. [-]"""

_LIKELY_ACCELERATION = 1.5
"""Largest acceleration between three valid samples, over the engine's acceleration. [-]"""

_POSSIBLE_ACCELERATION = 3.0
"""Largest acceleration if the next sample confirms it, over the engine's acceleration. [-]"""

_TRACKING = 1.05
"""Correction factor of the running median of the deviations, per sample. [-]"""

_MEMORY = np.dtype(
    [
        ('acceleration', 'f8'),  # of the engine [m/s2]
        ('noise', 'f8'),  # standard deviation of positions [m]
        ('stamp_error', 'f8'),  # standard deviation of stamps [s]
        ('median_deviation', 'f8'),  # running median of deviations over standard errors [-]
        ('count', 'i8'),  # accepted positions, up to two
        ('before', 'f8', (2,)),  # time [s] and position [m] accepted before the last
        ('last', 'f8', (2,)),  # time [s] and position [m] accepted last
        ('outlier', 'f8', (2,)),  # time [s] and position [m] of the last outlier
        ('in_a_row', 'i8'),  # outliers since the last accepted position
    ],
    align=True,
)


class OutlierFilter:
    """
    A filter that finds outliers among the positions of plate and projectile.

    A position is accepted if it is near the line through the last two accepted ones. The largest
    deviation is the path by 1.5 times the engine's `acceleration` [m/s2] plus `OUTLIER_SIGMAS`
    standard errors, from the `noise` [m] or from the recent deviations. Other positions are
    outliers unless the next position confirms them: then a position is accepted if it is near the
    line from the last accepted position to the next, with an acceleration a few times as large.
    The last of `MAX_OUTLIERS_IN_A_ROW` outliers is accepted, because the zero of the sensor has
    moved. A wrong stamp displaces a body by its speed times the error, which counts as noise; the
    `stamp_error` is the standard deviation of stamps [s].
    """

    def __init__(self, acceleration: float, noise: float, stamp_error: float) -> None:
        self._memory = np.zeros(2, _MEMORY)
        self._memory['acceleration'] = acceleration
        self._memory['noise'] = noise
        self._memory['stamp_error'] = stamp_error
        self._memory['median_deviation'] = MEDIAN_DEVIATION

    def find(self, times: Floats, positions: Floats) -> NDArray[np.bool_]:
        """
        Return which of the following positions are outliers, shape (n, 2).

        Positions that were not measured are NaN. The result lacks the last row if the last
        position of a body can only be judged together with the next one.
        """
        is_outlier = np.zeros(positions.shape, dtype=np.bool_)
        return is_outlier[: _find(self._memory, times, positions, is_outlier)]


@kernel
def _find(
    memory: NDArray[np.void], times: Floats, positions: Floats, is_outlier: NDArray[np.bool_]
) -> int:
    """Test positions in order; return the number of times at which all bodies are judged."""
    last = times.size - 1
    for n in range(times.size):
        for body in range(memory.size):
            if n == last and _is_far(memory[body], times[n], positions[n, body]):
                return n
        for body in range(memory.size):
            next_time = times[n + 1] if n < last else math.nan
            next_position = positions[n + 1, body] if n < last else math.nan
            is_outlier[n, body] = not _accept(
                memory[body], times[n], positions[n, body], next_time, next_position
            )
    return times.size


@subroutine
def _is_far(s: Record, time: float, position: float) -> bool:
    """Return whether a position is off the line through the last two."""
    return s.count == 2 and _deviation(  # type: ignore[no-any-return]
        s, time, position, s.before, s.last[0], s.last[1], _LIKELY_ACCELERATION
    ) > _limit(s)


@subroutine
def _accept(
    s: Record, time: float, position: float, next_time: float, next_position: float
) -> bool:
    """Accept a position, or return False because it is an outlier."""
    if math.isnan(position):
        return True
    if s.count < 2:
        s.count += 1
    else:
        deviation = _deviation(
            s, time, position, s.before, s.last[0], s.last[1], _LIKELY_ACCELERATION
        )
        is_outlier = deviation > _limit(s)
        if is_outlier and not math.isnan(next_position):
            is_outlier = _deviation(
                s, time, position, s.last, next_time, next_position, _POSSIBLE_ACCELERATION
            ) > _limit(s)
        s.median_deviation *= _TRACKING if deviation > s.median_deviation else 1.0 / _TRACKING
        s.median_deviation = max(s.median_deviation, MEDIAN_DEVIATION)
        if is_outlier:
            s.in_a_row += 1
            if s.in_a_row < MAX_OUTLIERS_IN_A_ROW:
                s.outlier[0], s.outlier[1] = time, position
                return False
            s.last[0], s.last[1] = s.outlier[0], s.outlier[1]
    s.in_a_row = 0
    s.before[0], s.before[1] = s.last[0], s.last[1]
    s.last[0], s.last[1] = time, position
    return True


@subroutine
def _limit(s: Record) -> float:
    """Return the largest deviation of a position that is no outlier, in standard errors [-]."""
    return OUTLIER_SIGMAS / MEDIAN_DEVIATION * s.median_deviation  # type: ignore[no-any-return]


@subroutine
def _deviation(
    s: Record,
    time: float,
    position: float,
    start: Floats,
    end_time: float,
    end_position: float,
    strength: float,
) -> float:
    """Return the distance from a line beyond the possible bending, in standard errors [-]."""
    speed = (end_position - start[1]) / (end_time - start[0])
    weight = (time - start[0]) / (end_time - start[0])
    distance = abs(position - start[1] - weight * (end_position - start[1]))
    bend = 0.5 * abs((time - start[0]) * (time - end_time)) * strength * s.acceleration
    noise = math.sqrt(s.noise**2 + (speed * s.stamp_error) ** 2)
    error = noise * math.sqrt(1.0 + weight**2 + (1.0 - weight) ** 2)
    return (distance - bend) / error  # type: ignore[no-any-return]


def warm_up() -> None:
    """Compile the kernels, or load them from the cache on disk."""
    OutlierFilter(1.0, 1.0, 0.0).find(np.arange(4.0), np.zeros((4, 2)))
