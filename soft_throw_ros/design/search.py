# SPDX-License-Identifier: Apache-2.0
r"""
Find the layer from which the projectile leaves fastest, within limits.

Notes
-----
A layer is a point :math:`(x, y)`, the logarithms of its thickness and wave speed over those of a
given layer: :math:`\mu = \mu_0 e^{-x}`, :math:`\kappa = \kappa_0 e^{y - x}`.

The ejection speed is a landscape with cliffs, wherever the release jumps across 3, 5, 7 ...
crossings, and with several summits. So nothing here takes it for smooth. A line is scanned at
fixed distances, and its highest points are closed in on from both sides: golden section, whose
middle is always the best point seen, so that at a cliff it closes in on the edge from above. A
rectangle is scanned in columns of constant thickness; then the same is done with the highest
point of a column as a function of the thickness.

Gravity can keep a projectile from leaving, and it takes milliseconds to be sure of that. So what
is scanned first is the landscape without it; where that is close to its highest, and whenever
something is closed in on, gravity counts. This presumes that it makes little difference, as it
does while :math:`g < 0.2\, A \omega^2` and the layer throws well. What gravity holds back until
the plate swings up once more is not looked for.

Left out are teeth narrower than the scan: 1 % on a line, 8 % in a rectangle. They have been seen
in landscapes that nowhere reach :math:`\alpha = 0.02`: heavy projectiles on slow layers.

"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.travelling_wave import first_release_kernel, MAX_INTERVALS

_LINE_STEP = 0.01  # of the scan of a line, in logarithms
_ROW_STEP = 0.08  # within a column of a rectangle
_COLUMN_STEP = 0.12  # from column to column, ...
_COLUMN_PARTS = 4  # and what that is divided into where ...
_HIGH = 0.97  # both columns come so close to the highest
_MAX_POINTS = 512
_SUMMITS = 4  # that are closed in on ...
_CLOSE = 0.9  # if they come so close to the highest
_EQUAL = 1.0 - 1e-9  # summits so close are the same; the first one, a thinner layer, is kept
_ROUNDING = 1.0 - 1e-14  # and so close are two points of a plateau
_COARSE = 2e-3  # how closely columns are told apart at first, ...
_RIVAL = 0.999  # and how near they then must come to be the highest after all
_FIRST_POINTS = 5  # of what is closed in on
_GOLDEN = 0.5 * (3.0 - math.sqrt(5.0))
_HOPELESS = 3.0 * MAX_INTERVALS  # crossings until the release, by a rough guess
_LATE = 1.5  # in plate periods after the wave's arrival: milliseconds to compute, as is none
_MAX_LOST = 120  # after so many of these it is given up, ...
_MAX_LOST_IN_SCAN = 60  # and after so many the rest of a scan goes without gravity

Floats = NDArray[np.float64]
_Ratios = tuple[float, float, float, float]  # as for find_summit
_Line = tuple[float, float, float, float]  # (x, y) at 0, and its change
_Limits = tuple[float, float, float, float]  # of x, and of y
_Case = tuple[float, float, float, float, Floats, NDArray[np.int64]]  # ratios, memory, lost
_Cases = tuple[_Case, _Case]  # without and with gravity
_Place = tuple[float, float, float]  # x, y, speed

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


class Summit(NamedTuple):
    r"""
    The best layer.

    Attributes
    ----------
    thickness_factor, wave_speed_factor : float
        Over those of the given layer. [-]
    speed : float
        :math:`V_e / (A \omega)`; NaN if no throw is resolved. [-]

    """

    thickness_factor: float
    wave_speed_factor: float
    speed: float


def find_summit(
    *,
    mass_ratio: float,
    speed_ratio: float,
    damping_ratio: float,
    gravity_ratio: float,
    thickness_factors: tuple[float, float] = (1.0, 1.0),
    wave_speed_factors: tuple[float, float] = (1.0, 1.0),
    tolerance: float = 1e-5,
) -> Summit:
    r"""
    Find the layer from which the projectile leaves fastest, among all within limits.

    Parameters
    ----------
    mass_ratio, speed_ratio : float
        :math:`\mu` and :math:`\kappa` of a given layer. [-]
    damping_ratio : float
        Of the plate, :math:`\zeta`. [-]
    gravity_ratio : float
        :math:`g / (A \omega^2)`. [-]
    thickness_factors, wave_speed_factors : tuple of float
        Smallest and largest, over those of the given layer; what may not vary is (1, 1). They
        are taken as they are. [-]
    tolerance : float
        How closely the place is found, relative. [-]

    Returns
    -------
    Summit
        Where speeds are equal to 1e-9, the thinner layer.

    """
    x_low, x_high = map(math.log, thickness_factors)
    y_low, y_high = map(math.log, wave_speed_factors)
    x, y, speed = _find(
        (mass_ratio, speed_ratio, damping_ratio, gravity_ratio),
        (x_low, x_high, y_low, y_high),
        tolerance,
    )
    return Summit(
        min(max(math.exp(x), thickness_factors[0]), thickness_factors[1]),
        min(max(math.exp(y), wave_speed_factors[0]), wave_speed_factors[1]),
        speed if speed > 0.0 else math.nan,
    )


@_jit
def _find(ratios: _Ratios, limits: _Limits, tolerance: float) -> _Place:
    """Search a point, a line or a rectangle: (x, y, speed), speed negative if there is none."""
    mu, kappa, zeta, gravity = ratios
    work, lost = np.empty((2, MAX_INTERVALS)), np.zeros(1, np.int64)
    cases = ((mu, kappa, zeta, 0.0, work, lost), (mu, kappa, zeta, gravity, work, lost))
    x_low, x_high, y_low, y_high = limits
    if x_low < x_high and y_low < y_high:
        return _search_rectangle(limits, tolerance, cases)
    if x_low < x_high:
        x, speed = _search_line((0.0, y_low, 1.0, 0.0), x_low, x_high, tolerance, cases)
        return x, y_low, speed
    if y_low < y_high:
        y, speed = _search_line((x_low, 0.0, 0.0, 1.0), y_low, y_high, tolerance, cases)
        return x_low, y, speed
    return x_low, y_low, _speed(x_low, y_low, cases[1])


@_jit
def _speed(x: float, y: float, case: _Case) -> float:
    """Compute V_e / (A w), or -1 if no release is resolved."""
    mu0, kappa0, zeta, gravity, work, lost = case
    mu = mu0 * math.exp(-x)
    kappa = kappa0 * math.exp(y - x)
    if kappa > _HOPELESS * (1.0 + kappa / (2.0 * math.pi * math.sqrt(mu))):
        return -1.0
    if gravity > 0.0 and lost[0] >= _MAX_LOST:
        return -1.0
    phase, speed, status = first_release_kernel(mu, kappa, zeta, gravity, work)
    if gravity > 0.0 and (status != 0 or phase > _LATE + 1.0 / kappa):
        lost[0] += 1
    return speed if status == 0 else -1.0


@_jit
def _points(length: float, step: float) -> int:
    """Choose the size of a scan."""
    return min(max(math.ceil(length / step) + 1, 9), _MAX_POINTS)


@_jit
def _scan(line: _Line, low: float, high: float, values: Floats, least: float, case: _Case) -> None:
    """Compute speeds at even distances, both ends included, where they were not too low."""
    x, y, dx, dy = line
    last = values.size - 1
    for i in range(last + 1):
        if case[3] > 0.0 and case[5][0] >= _MAX_LOST_IN_SCAN:
            break
        if values[i] >= least:
            s = low + i * (high - low) / last if i < last else high
            values[i] = _speed(x + s * dx, y + s * dy, case)


@_jit
def _close_in(
    line: _Line, low: float, high: float, tolerance: float, case: _Case
) -> tuple[float, float]:
    """Find the best of a short line: (s, speed)."""
    x, y, dx, dy = line
    size = _FIRST_POINTS
    step = (high - low) / (size - 1)
    left, middle, right = low, low, high
    speed = -1.0
    count = 0
    while count < size or right - left > tolerance:
        if count < size:
            s = low + count * step if count + 1 < size else high
        else:
            s = _probe(left, middle, right)
        value = _speed(x + s * dx, y + s * dy, case)
        is_better = speed < _ROUNDING * value
        if count >= size:
            left, middle, right = _narrow(left, middle, right, s, is_better)
        elif is_better:
            middle = s
        if is_better:
            speed = value
        count += 1
        if count == size:
            left, right = max(low, middle - step), min(high, middle + step)
    return middle, speed


@_jit
def _probe(left: float, middle: float, right: float) -> float:
    """Choose where to look next, by golden section of the longer part."""
    if right - middle > middle - left:
        return middle + _GOLDEN * (right - middle)
    return middle - _GOLDEN * (middle - left)


@_jit
def _narrow(
    left: float, middle: float, right: float, s: float, is_better: bool
) -> tuple[float, float, float]:
    """Return the shorter (left, middle, right) with the better one of s and middle within."""
    if is_better:
        return (middle, s, right) if s > middle else (left, s, middle)
    return (left, middle, s) if s > middle else (s, middle, right)


@_jit
def _summits(values: Floats) -> NDArray[np.int64]:
    """List the highest local maxima, at most _SUMMITS, in the order of the scan."""
    least = max(0.0, _CLOSE * values.max())
    found = np.empty(_SUMMITS, np.int64)
    count = 0
    for i in range(values.size):
        before = values[i - 1] if i > 0 else -1.0
        after = values[i + 1] if i + 1 < values.size else -1.0
        if values[i] <= 0.0 or values[i] < max(least, _EQUAL * after):
            continue
        if before >= _EQUAL * values[i]:  # the first of a plateau was found already
            continue
        if count == _SUMMITS:
            lowest = 0
            for j in range(1, _SUMMITS):
                if values[found[j]] < values[found[lowest]]:
                    lowest = j
            if values[i] <= values[found[lowest]]:
                continue
            for j in range(lowest, _SUMMITS - 1):
                found[j] = found[j + 1]
            count -= 1
        found[count] = i
        count += 1
    return found[:count]


@_jit
def _search_line(
    line: _Line, low: float, high: float, tolerance: float, cases: _Cases
) -> tuple[float, float]:
    """Find the best of a line: (s, speed)."""
    values = np.zeros(_points(high - low, _LINE_STEP))
    step = (high - low) / (values.size - 1)
    for case in cases:
        least = max(0.0, _CLOSE * values.max())
        _scan(line, low, high, values, least, case)
    best, speed = low, -1.0
    for i in _summits(values):
        left, right = max(low, low + (i - 1) * step), min(high, low + (i + 1) * step)
        s, value = _close_in(line, left, right, tolerance, cases[1])
        if speed < _EQUAL * value:
            best, speed = s, value
    return best, speed


@_jit
def _search_rectangle(limits: _Limits, tolerance: float, cases: _Cases) -> _Place:
    """Find the best of a rectangle: (x, y, speed)."""
    x_low, x_high, y_low, _ = limits
    ridge, heights, y_step = _find_ridge(limits, cases)
    x_step = (x_high - x_low) / (heights.size - 1)
    xs, ys, speeds = np.zeros(_SUMMITS), np.zeros(_SUMMITS), np.full(_SUMMITS, -1.0)
    count = 0
    for i in _summits(heights):
        band = _band(ridge, max(i - 1, 0), min(i + 2, ridge.size), 1, y_step)
        x = x_low + i * x_step
        xs[count], ys[count], speeds[count] = _close_in_twice(
            x, x_step, band, _COARSE, tolerance, limits, cases[1]
        )
        count += 1
    best_x, best_y, speed = x_low, y_low, -1.0
    rival = _RIVAL * speeds.max()
    for i in range(count):
        if speeds[i] >= rival:
            ratio = ys[i] - xs[i]
            band = (ratio - 4.0 * _COARSE, ratio + 4.0 * _COARSE)
            x, y, value = _close_in_twice(
                xs[i], 2.0 * _COARSE, band, tolerance, tolerance, limits, cases[1]
            )
            if speed < _EQUAL * value:
                best_x, best_y, speed = x, y, value
    return best_x, best_y, speed


@_jit
def _band(ridge: Floats, start: int, stop: int, step: int, margin: float) -> tuple[float, float]:
    """Return the lowest and highest point of a part of the ridge, with a margin."""
    low = high = ridge[start]
    for i in range(start, stop, step):
        low, high = min(low, ridge[i]), max(high, ridge[i])
    return low - margin, high + margin


@_jit
def _find_ridge(limits: _Limits, cases: _Cases) -> tuple[Floats, Floats, float]:
    """
    Find the best of every column, more closely where it is high.

    Return its y - x, which is ln kappa / kappa_0 and changes less than y, its speed (-1 if gravity
    lets no throw in the column come close to the highest), and the distance of rows.
    """
    x_low, x_high, y_low, y_high = limits
    columns = _points(x_high - x_low, _COLUMN_STEP)
    table = np.zeros((columns, _points(y_high - y_low, _ROW_STEP)))
    x_step = (x_high - x_low) / (columns - 1)
    y_step = (y_high - y_low) / (table.shape[1] - 1)
    for case in cases:
        least = max(0.0, _CLOSE * table.max())
        for i in range(columns):
            line = (x_low + i * x_step, 0.0, 0.0, 1.0)
            _scan(line, y_low, y_high, table[i], least, case)
    parts = _COLUMN_PARTS
    ridge = np.zeros(parts * (columns - 1) + 1)
    heights = np.full(ridge.size, -1.0)
    for i in range(columns):
        x = x_low + i * x_step
        for j in _summits(table[i]):
            if table[i, j] >= least:
                y = y_low + j * y_step - x
                band = (y - y_step, y + y_step)
                y, value = _best_of_column(x, band, _COARSE, limits, cases[0])
                if value > heights[parts * i]:
                    ridge[parts * i], heights[parts * i] = y - x, value
    least = max(0.0, _HIGH * heights.max())
    for i in range(0, ridge.size - 1, parts):
        if min(heights[i], heights[i + parts]) >= least:
            band = _band(ridge, i, i + parts + 1, parts, y_step)
            for j in range(i + 1, i + parts):
                x = x_low + j * x_step / parts
                y, heights[j] = _best_of_column(x, band, _COARSE, limits, cases[0])
                ridge[j] = y - x
    return ridge, heights, y_step


@_jit
def _best_of_column(
    x: float, band: tuple[float, float], tolerance: float, limits: _Limits, case: _Case
) -> tuple[float, float]:
    """Find the best of a column within a band of y - x: (y, speed)."""
    low = min(max(band[0] + x, limits[2]), limits[3])
    high = min(max(band[1] + x, limits[2]), limits[3])
    return _close_in((x, 0.0, 0.0, 1.0), low, high, tolerance, case)


@_jit
def _close_in_twice(
    x: float,
    reach: float,
    band: tuple[float, float],
    x_tolerance: float,
    y_tolerance: float,
    limits: _Limits,
    case: _Case,
) -> _Place:
    """Find the best of the columns near one, within a band of y - x: (x, y, speed)."""
    low, high = max(limits[0], x - reach), min(limits[1], x + reach)
    size = _FIRST_POINTS
    step = (high - low) / (size - 1)
    left, middle, right = low, low, high
    best_y, speed = 0.0, -1.0
    count = 0
    while count < size or right - left > x_tolerance:
        if count < size:
            x = low + count * step if count + 1 < size else high
        else:
            x = _probe(left, middle, right)
        y, value = _best_of_column(x, band, y_tolerance, limits, case)
        is_better = speed < _ROUNDING * value
        if count >= size:
            left, middle, right = _narrow(left, middle, right, x, is_better)
        elif is_better:
            middle = x
        if is_better:
            best_y, speed = y, value
        count += 1
        if count == size:
            left, right = max(low, middle - step), min(high, middle + step)
    return middle, best_y, speed
