# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of the plate from records of its height, which may be noisy."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.plate import require_samples, SampledMotion

if TYPE_CHECKING:  # SciPy takes half a second to import: that is done where a record is fitted
    from scipy.interpolate import BSpline

Floats = NDArray[np.float64]

MIN_SAMPLES = 8
"""Fewest heights of a record, and fewest after the start. [-]"""

MAX_END_SPEED = 0.25
"""Largest speed of a plate at the end of a record, over its peak speed. [-]"""

_CLEAN_NOISE = 1e-5
"""Noise over the range of heights, below which the spline goes through the samples. [-]"""

_MOTION_SIGMAS = 6.0
"""Standard deviations of the noise, from which on a plate moves. [-]"""

_CERTAIN_MOTION = 0.3
"""Height over the largest one, at which a plate has certainly started. [-]"""

_COEFFICIENT_WEIGHT = 1.4
"""Weight of a coefficient in the cross-validation, which smooths too little with 1. [-]"""

_KNOT_STRIDES = (2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Samples from knot to knot that are tried. [-]"""


def motion_from_record(times: ArrayLike, heights: ArrayLike) -> SampledMotion:
    """
    Fit a motion to a record of a plate that starts from rest, at time 0, and comes to rest.

    Parameters
    ----------
    times, heights : array_like, shape (n,)
        Times increase; before the start the plate may rest for any time. [s], [m]

    Raises
    ------
    ValueError
        If fewer than `MIN_SAMPLES` are given or left after the start, a value is not
        finite, times do not increase, or the plate does not move, or moves at the end.

    Notes
    -----
    A cubic spline goes through the samples if they are clean, to fourth order in the spacing:
    its second derivative, the acceleration, is continuous, as a real plate's is. Otherwise
    fewer knots are fitted by least squares; generalised cross-validation [1]_ chooses their
    number, and needs to know neither the noise nor the motion. A smoothing filter would also
    round off the start, where the acceleration jumps. So the spline begins at the start, which is
    fitted too, with height and velocity 0.

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
    start, rest_height = _find_start(times, heights)
    spline = _fit_record(times - start, heights - rest_height)
    knots = np.unique(spline.t)
    states = np.stack([spline(knots, nu=order) for order in range(3)], axis=1)
    motion = SampledMotion(knots, states)
    last = float(np.abs(np.diff(heights[-4:]) / np.diff(times[-4:])).min())
    if last > MAX_END_SPEED * np.abs(states[:, 1]).max():
        raise ValueError(
            f'the plate must come to rest, got {last:g} m/s at the last sample; record longer'
        )
    return motion


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

    def residual(start: float) -> float:
        s = np.maximum(t - start, 0.0) / (t[-1] - t[0])
        basis = np.stack([s**2, s**3, s**4, s**5], axis=1)
        return float(np.sum((z - basis @ np.linalg.lstsq(basis, z, rcond=None)[0]) ** 2))

    earliest = float(times[max(2 * first - far - 2, 0)])
    return _lowest(residual, earliest, float(times[first])), rest_height


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


class _Fit(NamedTuple):
    """A cubic spline from rest, its sum of squares, and samples less coefficients."""

    spline: BSpline
    misfit: float
    spare: float


def _fit_record(times: Floats, heights: Floats) -> BSpline:
    """Fit a spline to heights of a plate that starts near time 0, see `motion_from_record`."""

    def fit(stride: int, start: float = 0.0) -> _Fit:
        moving = times > start + 1e-3 * step
        return _fit_spline(times[moving] - start, heights[moving], stride)

    step = float(np.median(np.diff(times)))
    after = int((times > 0.0).sum())
    if after < MIN_SAMPLES:
        raise ValueError(f'heights after the start must be at least {MIN_SAMPLES}, got {after}')
    if _noise(heights[-after:]) < _CLEAN_NOISE * np.ptp(heights):
        return fit(1).spline
    strides = [stride for stride in _KNOT_STRIDES if stride <= after // 4]
    fits = {stride: fit(stride) for stride in strides}
    stride = min(fits, key=lambda stride: fits[stride].misfit / fits[stride].spare ** 2)
    best = fits[stride]
    if times[0] < 0.0:
        reach = 0.5 * stride * step

        def misfit(start: float) -> float:
            return fit(stride, start).misfit + float(np.sum(heights[times <= start] ** 2))

        best = fit(stride, _lowest(misfit, max(-reach, float(times[0])), reach))
    return best.spline


def _fit_spline(times: Floats, heights: Floats, stride: int) -> _Fit:
    """Fit by least squares from rest at time 0, with a knot at every so many samples, or all."""
    from scipy.interpolate import BSpline
    from scipy.sparse.linalg import spsolve

    inner = times[:-2] if stride == 1 else times[:-1][stride - 1:: stride]
    knots = np.concatenate([[0.0] * 4, inner, [times[-1]] * 4])
    basis = BSpline.design_matrix(times, knots, 3).tocsc()
    direction = heights[(np.abs(heights) > _CERTAIN_MOTION * np.abs(heights).max()).argmax()]
    # Height and velocity at the start are 0. Noise must not make it a jump the other way, which
    # would throw the projectile off at once.
    for zeros in (2, 3, 4):
        free = basis[:, zeros:]
        coefficients = np.append(np.zeros(zeros), spsolve(free.T @ free, free.T @ heights))
        if coefficients[zeros] * direction >= 0.0 or stride == 1:
            break
    spline = BSpline(knots, coefficients, 3)
    misfit = float(np.sum((spline(times) - heights) ** 2))
    return _Fit(spline, misfit, heights.size - _COEFFICIENT_WEIGHT * free.shape[1])
