# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of the plate from records of its height, which may be noisy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.plate import require_samples, SampledMotion

Floats = NDArray[np.float64]

MIN_SAMPLES = 8
"""Fewest heights of a record, and fewest after the start. [-]"""

MAX_END_SPEED = 0.25
"""Largest speed of a plate at the end of a record, over its peak speed. [-]"""

_MOTION_SIGMAS = 6.0
"""Standard deviations of the noise, from which on a plate moves. [-]"""

_MAX_RISE = 2.0
"""Largest time from the start to half of the largest height; a plate has at least 1 Hz. [s]"""

_CERTAIN_MOTION = 0.3
"""Height over the largest one, at which a plate has certainly started. [-]"""


def motion_from_record(times: ArrayLike, heights: ArrayLike) -> SampledMotion:
    """
    Fit a motion to a record of a plate that starts from rest, at time 0, and comes to rest.

    Parameters
    ----------
    times, heights : array_like, shape (n,)
        Times increase; before the start the plate may rest for any time. [s], [m]

    Notes
    -----
    Fits SciPy's smoothing spline, whose smoothness is chosen by generalised cross-validation [1]_
    and needs to know neither the noise nor the motion. It would also round off the start, where
    the acceleration jumps; so it is fitted to the samples since the start and to their mirror
    image before it, which together are smooth, and begins at rest by symmetry.

    References
    ----------
    .. [1] P. Craven, G. Wahba, "Smoothing noisy data with spline functions", Numer. Math. 31
       (1979).

    Examples
    --------
    >>> from soft_throw_ros.core.plate import Underdamped
    >>> plate = Underdamped(frequency=63.2, amplitude=2e-3, damping_ratio=0.064)
    >>> times = np.arange(0.0, 0.1, 2e-4)
    >>> motion = motion_from_record(times, plate.position(times - 0.02003))
    >>> round(motion.peak_velocity, 4)
    0.721

    """
    times, heights = require_samples(times, heights, 'heights')
    if times.size < MIN_SAMPLES:
        raise ValueError(f'heights must be at least {MIN_SAMPLES}, got {times.size}')
    from scipy.interpolate import make_smoothing_spline

    start, rest_height = _find_start(times, heights)
    distance = np.abs(heights - rest_height)
    risen = float(times[np.argmax(distance >= 0.5 * distance.max())]) - start
    if risen > _MAX_RISE:
        raise ValueError(
            f'the plate must rise within {_MAX_RISE:g} s, got {risen:.3g} s; name a time in '
            'another unit by a first line, as in t [ms],z [m]'
        )
    since = times - start
    moving = since > 1e-3 * float(np.median(np.diff(times)))
    if (after := int(moving.sum())) < MIN_SAMPLES:
        raise ValueError(f'heights after the start must be at least {MIN_SAMPLES}, got {after}')
    since, rise = since[moving], heights[moving] - rest_height
    unit = float(np.median(np.diff(since)))  # the spline takes neither small nor large numbers
    both = np.concatenate([-since[::-1], [0.0], since]) / unit
    spline = make_smoothing_spline(both, np.concatenate([rise[::-1], [0.0], rise]))
    knots = np.append(0.0, since)
    states = np.stack([spline(knots / unit, nu=n) / unit**n for n in range(3)], axis=1)
    states[:, 0] -= states[0, 0]
    states[0, 1] = 0.0
    last = abs(float(states[-1, 1]))
    if last > MAX_END_SPEED * np.abs(states[:, 1]).max():
        raise ValueError(
            f'the plate must come to rest, got {last:g} m/s at the last sample; record longer'
        )
    return SampledMotion(knots, states)


def _find_start(times: Floats, heights: Floats) -> tuple[float, float]:
    """Return the time at which a recorded plate starts to move, and its height before that."""
    noise = _noise(heights)
    moved = np.abs(heights - np.median(heights[:3]))
    threshold = max(_MOTION_SIGMAS * noise, 1e-6 * np.ptp(heights))
    if not moved.max() > 2.0 * threshold:
        raise ValueError(
            f'the plate must move, got heights from {heights.min():g} to {heights.max():g} m '
            f'with a noise of {noise:g} m'
        )
    # The last time that it was seen at rest before it was first far away
    far = int((moved > max(_CERTAIN_MOTION * moved.max(), threshold)).argmax())
    at_rest = np.flatnonzero(moved[:far] <= threshold)
    first = int(at_rest[-1]) + 1 if at_rest.size else 0
    if first < 2:
        return float(times[0]), float(heights[0])
    rest_height = float(np.median(heights[: first - 1])) if first > 3 else float(heights[0])
    t, z = times[: far + 1], heights[: far + 1] - rest_height

    def criterion(start: float, terms: int) -> float:
        """Weigh the misfit of a polynomial from rest against its terms, twice as much as BIC."""
        s = np.maximum(t - start, 0.0) / (t[-1] - t[0])
        basis = s[:, None] ** np.arange(2.0, 2.0 + terms)
        coefficients = np.linalg.lstsq(basis, z, rcond=None)[0]
        if coefficients[0] * z[-1] <= 0.0:  # a start the other way explains nothing
            coefficients[:] = 0.0
        misfit = np.sum((z - basis @ coefficients) ** 2) + (1e-12 * z[-1]) ** 2
        return float(t.size * np.log(misfit) + 2.0 * terms * np.log(t.size))

    earliest = float(times[max(2 * first - far - 2, 0)])
    starts = [
        (terms, _lowest(partial(criterion, terms=terms), earliest, float(times[first])))
        for terms in (2, 3, 4)
    ]
    return min(starts, key=lambda item: criterion(item[1], item[0]))[1], rest_height


def _lowest(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the time of the minimum of a function, by a grid and then by Brent's method."""
    from scipy.optimize import minimize_scalar

    trials = np.linspace(low, high, 41)
    best = int(np.argmin([function(trial) for trial in trials]))
    bounds = (trials[max(best - 1, 0)], trials[min(best + 1, 40)])
    options = {'xatol': 1e-6 * (high - low)}
    return float(minimize_scalar(function, bounds=bounds, method='bounded', options=options).x)


def _noise(heights: Floats) -> float:
    """Estimate the standard deviation of white noise from sixth differences."""
    return float(np.median(np.abs(np.diff(heights, 6)))) / (0.6745 * math.sqrt(924.0))
