# SPDX-License-Identifier: Apache-2.0
r"""
Find the layer that does best in one throw, or in the worst of several, within limits.

Notes
-----
A layer is a point :math:`(x, y)`, the logarithms of its thickness and wave speed over those of a
given layer: :math:`\mu = \mu_0 e^{-x}`, :math:`\kappa = \kappa_0 e^{y - x}`.

The ejection speed is a landscape with cliffs, wherever the release jumps across 3, 5, 7 ...
crossings or to another swing of the plate, and with several summits. So nothing here takes it for
smooth. A line is scanned at fixed distances, and its highest points are closed in on from both
sides: golden section, whose middle is always the best point seen, so that at a cliff it closes in
on the edge from above. A rectangle is scanned in columns of constant thickness; then the same is
done with the highest point of a column as a function of the thickness. What exceeds a limit
counts as no throw, which makes the limit one more cliff.

A throw is computed by what is fastest for it: in closed form, in steps if there is gravity, by
modes if there is loss. What gravity holds back may leave with a later swing of the plate; it is
waited for `LATEST` periods.

Left out are teeth narrower than the scan: 1 % on a line, 8 % in a rectangle. They have been seen
in landscapes that nowhere reach :math:`\alpha = 0.02`: heavy projectiles on slow layers.

"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import normal_modes, peak, plate, swings, travelling_wave

LATEST = 6.0
"""Plate periods, from the wave's arrival at the projectile on, within which it has to leave."""

_LINE_STEP = 0.01  # of the scan of a line, in logarithms
_ROW_STEP = 0.08  # within a column of a rectangle
_COLUMN_STEP = 0.12  # from column to column, ...
_COLUMN_PARTS = 4  # and what that is divided into where ...
_HIGH = 0.97  # both columns come so close to the highest
_LARGE_GRAVITY = 0.2  # from here on later swings of the plate count, and ...
_FINER = 0.4  # steps are so much smaller
_MAX_POINTS = 512
_SUMMITS = 4  # that are closed in on ...
_CLOSE = 0.9  # if they come so close to the highest
_EQUAL = 1.0 - 1e-9  # summits so close are the same; the first one, a thinner layer, is kept
_ROUNDING = 1.0 - 1e-14  # and so close are two points of a plateau
_COARSE = 2e-3  # how closely columns are told apart at first, ...
_RIVAL = 0.999  # and how near they then must come to be the highest after all
_FIRST_POINTS = 5  # of what is closed in on
_GOLDEN = 0.5 * (3.0 - math.sqrt(5.0))
_HOPELESS = 3.0 * travelling_wave.MAX_INTERVALS  # crossings until the release, by a rough guess
_HELD = 4.0  # gravity ratio that holds a projectile ...
_STIFF = 4.0 * math.pi  # if the layer's lowest mode is twice as fast as the plate; 3.1 is enough

Floats = NDArray[np.float64]
_Line = tuple[float, float, float, float]  # (x, y) at 0, and its change
_Limits = tuple[float, float, float, float]  # of x, and of y
_Span = tuple[float, float]  # from, to
_Place = tuple[float, float, float]  # x, y, score

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')
_closed_form = travelling_wave.first_release_kernel
_in_steps = swings.first_release_kernel
_by_modes = normal_modes.first_release_kernel
_lossless_peaks = peak.first_peaks_kernel
_lossy_loads = normal_modes.first_loads_kernel
_peak_velocity_ratio = _jit(plate.peak_velocity_ratio)


class Problem(NamedTuple):
    r"""
    What is asked of a layer, without units.

    Attributes
    ----------
    mass_ratio, speed_ratio : float
        :math:`\mu` and :math:`\kappa` of a given layer. [-]
    gravity_ratio : float
        :math:`g / (A \omega^2)`. [-]
    loss_tangent : float
        Of the layer, at any frequency. [-]
    throws : ndarray, shape (n, 5)
        The throws in which it has to do well, a row each: mass of the projectile and frequency
        of the plate over the given ones, damping ratio of the plate, and what is added to
        thickness and wave speed of the layer, over those of the given one. [-]
    quantile : float
        Of the throws' scores, what counts: 0 is the worst. [-]
    checked : int
        For how many throws, from the first, the limits hold.
    strain : float
        Limit for the largest strain, in :math:`A \omega / c_s` of the given layer. [-]
    acceleration : float
        Limit for the projectile's largest acceleration, in :math:`A \omega^2`. [-]
    target : float
        If above 0, the amplitude is not given: it is what makes the projectile leave at this
        speed, in :math:`A \omega`, and the limits hold for that. [-]
    cap : float
        If above 0, the amplitude is the largest that the limits allow, up to this multiple of the
        given one, and the score of a layer grows with it. For one throw. [-]

    """

    mass_ratio: float
    speed_ratio: float
    gravity_ratio: float
    loss_tangent: float
    throws: Floats
    quantile: float = 0.0
    checked: int = 0
    strain: float = math.inf
    acceleration: float = math.inf
    target: float = 0.0
    cap: float = 0.0


def one_throw(damping_ratio: float) -> Floats:
    """Return `Problem.throws` for the given throw alone."""
    return np.array([[1.0, 1.0, damping_ratio, 0.0, 0.0]])


class Summit(NamedTuple):
    r"""
    The best layer.

    Attributes
    ----------
    thickness_factor, wave_speed_factor : float
        Over those of the given layer. [-]
    score : float
        :math:`V_e / V_p^*` in the throw that counts; NaN if there is no throw within the
        limits. [-]

    """

    thickness_factor: float
    wave_speed_factor: float
    score: float


def find_summit(
    problem: Problem,
    *,
    thickness_factors: tuple[float, float] = (1.0, 1.0),
    wave_speed_factors: tuple[float, float] = (1.0, 1.0),
    tolerance: float = 1e-5,
) -> Summit:
    r"""
    Find the layer with the highest score among all within limits.

    Parameters
    ----------
    problem : Problem
        What is asked; taken as it is.
    thickness_factors, wave_speed_factors : tuple of float
        Smallest and largest, over those of the given layer; what may not vary is twice the
        same. They are taken as they are. [-]
    tolerance : float
        How closely the place is found, relative. [-]

    Returns
    -------
    Summit
        Where scores are equal to 1e-9, the thinner layer.

    """
    x_low, x_high = map(math.log, thickness_factors)
    y_low, y_high = map(math.log, wave_speed_factors)
    x, y, score = _find(problem, (x_low, x_high, y_low, y_high), tolerance)
    return Summit(
        min(max(math.exp(x), thickness_factors[0]), thickness_factors[1]),
        min(max(math.exp(y), wave_speed_factors[0]), wave_speed_factors[1]),
        score if score > 0.0 else math.nan,
    )


def score(problem: Problem) -> float:
    """
    Compute the score of the given layer, within limits or not.

    Parameters
    ----------
    problem : Problem
        What is asked; taken as it is.

    Returns
    -------
    float
        :math:`V_e / V_p^*` in the throw that counts, -1 if there is no throw. [-]

    """
    return float(np.quantile(releases(problem)[2], problem.quantile))


def releases(problem: Problem) -> tuple[Floats, Floats, Floats]:
    r"""
    Compute the release of every throw from the given layer.

    Parameters
    ----------
    problem : Problem
        What is asked; taken as it is.

    Returns
    -------
    ndarray, ndarray, ndarray
        Ejection phase, in the given plate's periods, and ejection speed, in the given
        :math:`A \omega`, NaN where there is no release; and :math:`V_e / V_p^*`, there -1. [-]

    """
    phases, speeds = np.empty((2, len(problem.throws)))
    _search(
        (0.0, 0.0, 0.0, 0.0), 0.0, 0.0, math.inf, -math.inf, problem, np.empty(1), phases, speeds
    )
    frequencies, damping_ratios = problem.throws[:, 1], problem.throws[:, 2]
    ratios = [plate.peak_velocity_ratio(zeta) for zeta in damping_ratios.tolist()]
    relative = np.where(speeds > 0.0, speeds / ratios, -1.0)
    return phases / frequencies, speeds * frequencies, relative


def _find(problem: Problem, limits: _Limits, tolerance: float) -> _Place:
    """Search a point, a line or a rectangle: (x, y, score), score negative if there is none."""
    x_low, x_high, y_low, y_high = limits
    if x_low < x_high and y_low < y_high:
        return _search_rectangle(limits, tolerance, problem)
    if x_low < x_high:
        x, best = _search_line((0.0, y_low, 1.0, 0.0), x_low, x_high, tolerance, problem)
        return x, y_low, best
    if y_low < y_high:
        y, best = _search_line((x_low, 0.0, 0.0, 1.0), y_low, y_high, tolerance, problem)
        return x_low, y, best
    return x_low, y_low, _close_in((x_low, y_low, 0.0, 0.0), 0.0, 0.0, tolerance, problem)[1]


@_jit
def _ratios(
    i: int, thickness: float, wave_speed: float, problem: Problem
) -> tuple[float, float, float, float]:
    """Compute mu, kappa, zeta and the gravity ratio of a throw."""
    frequency = problem.throws[i, 1]
    thickness += problem.throws[i, 3]
    return (
        problem.mass_ratio * problem.throws[i, 0] / thickness,
        problem.speed_ratio * (wave_speed + problem.throws[i, 4]) / (thickness * frequency),
        problem.throws[i, 2],
        problem.gravity_ratio / (frequency * frequency),
    )


@_jit
def _throw(
    i: int, thickness: float, wave_speed: float, problem: Problem, work: Floats
) -> tuple[float, float]:
    """Compute the phase and the speed, in its own units, of a throw; NaN if there is none."""
    mu, kappa, zeta, gravity = _ratios(i, thickness, wave_speed, problem)
    if min(mu, kappa) <= 0.0:  # off by more than there is
        return math.nan, math.nan
    if gravity > _HELD and kappa > _STIFF * math.sqrt(mu + 4.0 / (math.pi * math.pi)):
        return math.nan, math.nan
    if problem.loss_tangent > 0.0:
        phase, speed, status = _by_modes(mu, kappa, zeta, gravity, problem.loss_tangent, LATEST)
    elif gravity > 0.0:
        phase, speed, status = _in_steps(mu, kappa, zeta, gravity, LATEST)
    elif kappa > _HOPELESS * (1.0 + kappa / (2.0 * math.pi * math.sqrt(mu))):
        return math.nan, math.nan
    else:
        phase, speed, status = _closed_form(mu, kappa, zeta, 0.0, work)
    return (phase, speed) if status == 0 else (math.nan, math.nan)


@_jit
def _quantile(values: Floats, part: float) -> float:
    """Interpolate between the values in their order; their places change."""
    place = part * (values.size - 1)
    low = int(place)
    for i in range(min(low + 2, values.size)):  # so many are sorted, and few are asked for
        least = i
        for j in range(i + 1, values.size):
            if values[j] < values[least]:
                least = j
        values[i], values[least] = values[least], values[i]
    after = values[min(low + 1, values.size - 1)]
    return float(values[low] + (place - low) * (after - values[low]))


@_jit
def _score(
    x: float, y: float, least: float, problem: Problem, phases: Floats, speeds: Floats
) -> float:
    """
    Compute the score, or -1 if it is below `least` or a limit is exceeded.

    `phases` and `speeds` of the throws are filled in, and no more of them once too many are below
    `least`.
    """
    size = problem.throws.shape[0]
    values = np.full(size, -1.0)
    work = np.empty((2, travelling_wave.MAX_INTERVALS))
    thickness, wave_speed = math.exp(x), math.exp(y)
    spare = math.ceil(problem.quantile * (size - 1))
    for i in range(size):
        phases[i], speeds[i] = _throw(i, thickness, wave_speed, problem, work)
        if speeds[i] > 0.0:
            values[i] = speeds[i] / _peak_velocity_ratio(problem.throws[i, 2])
        if values[i] < least:
            spare -= 1
            if spare < 0:
                return -1.0
    best = _quantile(values, problem.quantile)
    if best <= 0.0 or best < least:
        return -1.0
    if min(problem.strain, problem.acceleration) < math.inf:
        for i in range(problem.checked):
            allowed, needed = _amplitudes(i, x, y, problem)
            if problem.cap > 0.0:
                best *= min(allowed / problem.cap, 1.0)
            elif not needed <= allowed:
                return -1.0
    return best if best >= least else -1.0


@_jit
def _amplitudes(i: int, x: float, y: float, problem: Problem) -> tuple[float, float]:
    """Compute which amplitude the limits allow in a throw, and which one is needed."""
    mu, kappa, zeta, gravity = _ratios(i, math.exp(x), math.exp(y), problem)
    if problem.loss_tangent > 0.0:
        loads = _lossy_loads(mu, kappa, zeta, gravity, problem.loss_tangent, LATEST)
        speed, status, strain, acceleration = loads
    else:
        peaks = _lossless_peaks(mu, kappa, zeta, gravity)
        _, speed, status, strain, _, _, _, acceleration, _, _ = peaks
    if status != 0:
        return 0.0, math.inf
    frequency, wave_speed = problem.throws[i, 1], math.exp(y) + problem.throws[i, 4]
    allowed = min(
        problem.strain * wave_speed / (frequency * strain),
        problem.acceleration / (frequency * frequency * acceleration),
    )
    return allowed, problem.target / (speed * frequency) if problem.target > 0.0 else 1.0


@_jit
def _is_heavy(problem: Problem) -> bool:
    """Tell whether gravity is so large that later swings of the plate count."""
    slowest = 1.0
    for i in range(problem.throws.shape[0]):
        slowest = min(slowest, problem.throws[i, 1])
    return problem.gravity_ratio > _LARGE_GRAVITY * slowest * slowest


def _points(length: float, step: float) -> int:
    """Choose the size of a scan."""
    return min(max(math.ceil(length / step) + 1, 9), _MAX_POINTS)


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
def _search(
    line: _Line,
    low: float,
    high: float,
    tolerance: float,
    best: float,
    problem: Problem,
    values: Floats,
    phases: Floats,
    speeds: Floats,
) -> tuple[float, float]:
    """
    Compute scores at even distances, both ends included, and close in on the best: (s, score).

    Scores far below `best` are not worth the time. Filled in are the `values` at even distances,
    and of the last point `phases` and `speeds` of the throws.

    Throws are computed from here only: whatever else did so would be compiled with all that a
    throw needs once more.
    """
    x, y, dx, dy = line
    size = values.size
    step = (high - low) / (size - 1)
    left, middle, right = low, low, high
    count = 0
    while count < size or right - left > tolerance:
        if count < size:
            s = low + count * step if count + 1 < size else high
            least = _CLOSE * best
        else:
            s = _probe(left, middle, right)
            least = best
        value = _score(x + s * dx, y + s * dy, least, problem, phases, speeds)
        is_better = best < _ROUNDING * value
        if count < size:
            values[count] = value
            if is_better:
                middle = s
        else:
            left, middle, right = _narrow(left, middle, right, s, is_better)
        if is_better:
            best = value
        count += 1
        if count == size:
            left, right = max(low, middle - step), min(high, middle + step)
    return middle, best


def _scan(
    line: _Line, low: float, high: float, values: Floats, best: float, problem: Problem
) -> float:
    """Compute scores at even distances, both ends included; return the best so far."""
    phases, speeds = np.empty((2, len(problem.throws)))
    return _search(line, low, high, math.inf, best, problem, values, phases, speeds)[1]


def _close_in(
    line: _Line, low: float, high: float, tolerance: float, problem: Problem
) -> tuple[float, float]:
    """Find the best of a short line: (s, score)."""
    values = np.empty(_FIRST_POINTS)
    phases, speeds = np.empty((2, len(problem.throws)))
    s, best = _search(line, low, high, tolerance, 0.0, problem, values, phases, speeds)
    return s, best if best > 0.0 else -1.0


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


def _search_line(
    line: _Line, low: float, high: float, tolerance: float, problem: Problem
) -> tuple[float, float]:
    """Find the best of a line: (s, score)."""
    values = np.zeros(_points(high - low, _LINE_STEP))
    step = (high - low) / (values.size - 1)
    _scan(line, low, high, values, 0.0, problem)
    best, best_value = low, -1.0
    for i in _summits(values):
        left, right = max(low, low + (i - 1) * step), min(high, low + (i + 1) * step)
        s, value = _close_in(line, left, right, tolerance, problem)
        if best_value < _EQUAL * value:
            best, best_value = s, value
    return best, best_value


def _search_rectangle(limits: _Limits, tolerance: float, problem: Problem) -> _Place:
    """Find the best of a rectangle: (x, y, score)."""
    x_low, x_high, y_low, _ = limits
    ridge, heights, margin = _find_ridge(limits, problem)
    x_step = (x_high - x_low) / (heights.size - 1)
    found: list[_Place] = []
    for i in _summits(heights):
        band = _band(ridge[max(i - 1, 0) : i + 2], margin)
        x = x_low + i * x_step
        found.append(_close_in_twice(x, x_step, band, _COARSE, tolerance, limits, problem))
    best_x, best_y, best = x_low, y_low, -1.0
    rival = _RIVAL * max((value for _, _, value in found), default=0.0)
    for x, y, value in found:
        if value >= rival:
            band = _band(np.array([y - x]), 4.0 * _COARSE)
            near = _close_in_twice(x, 2.0 * _COARSE, band, tolerance, tolerance, limits, problem)
            if best < _EQUAL * near[2]:
                best_x, best_y, best = near
    return best_x, best_y, best


def _band(ridge: Floats, margin: float) -> _Span:
    """Return the lowest and highest point of a part of the ridge, with a margin."""
    return float(np.nanmin(ridge)) - margin, float(np.nanmax(ridge)) + margin


def _find_ridge(limits: _Limits, problem: Problem) -> tuple[Floats, Floats, float]:
    """
    Find the best of every column, more closely where it is high.

    Return its y - x, which is ln kappa / kappa_0 and changes less than y, NaN if there is none;
    its score, -1 if there is none; and how far the ridge may go up or down between columns.
    """
    x_low, x_high, y_low, y_high = limits
    size = _FINER if _is_heavy(problem) else 1.0
    columns = _points(x_high - x_low, size * _COLUMN_STEP)
    table = np.zeros((columns, _points(y_high - y_low, size * _ROW_STEP)))
    x_step = (x_high - x_low) / (columns - 1)
    y_step = (y_high - y_low) / (table.shape[1] - 1)
    best = 0.0
    for i in range(columns):
        line = (x_low + i * x_step, 0.0, 0.0, 1.0)
        best = _scan(line, y_low, y_high, table[i], best, problem)
    parts = _COLUMN_PARTS
    ridge = np.full(parts * (columns - 1) + 1, np.nan)
    heights = np.full(ridge.size, -1.0)
    for i in range(columns):
        x = x_low + i * x_step
        for j in _summits(table[i]):
            if table[i, j] >= _CLOSE * best:
                y = y_low + j * y_step - x
                band = (y - y_step, y + y_step)
                y, value = _best_of_column(x, band, _COARSE, limits, problem)
                if value > heights[parts * i]:
                    ridge[parts * i], heights[parts * i] = y - x, value
    margin = y_step
    least = max(0.0, _HIGH * heights.max())
    for i in range(0, ridge.size - 1, parts):
        ends = heights[i : i + parts + 1 : parts]
        if ends.max() >= least:
            # beside a column where nothing is allowed, the ridge may run along the limit
            reach = margin if ends.min() > 0.0 else margin + x_step
            band = _band(ridge[i : i + parts + 1 : parts], reach)
            for j in range(i + 1, i + parts):
                x = x_low + j * x_step / parts
                y, heights[j] = _best_of_column(x, band, _COARSE, limits, problem)
                ridge[j] = y - x if heights[j] > 0.0 else math.nan
    return ridge, heights, margin


def _best_of_column(
    x: float, band: _Span, tolerance: float, limits: _Limits, problem: Problem
) -> tuple[float, float]:
    """Find the best of a column within a band of y - x: (y, score)."""
    low = min(max(band[0] + x, limits[2]), limits[3])
    high = min(max(band[1] + x, limits[2]), limits[3])
    return _close_in((x, 0.0, 0.0, 1.0), low, high, tolerance, problem)


def _close_in_twice(
    x: float,
    reach: float,
    band: _Span,
    x_tolerance: float,
    y_tolerance: float,
    limits: _Limits,
    problem: Problem,
) -> _Place:
    """Find the best of the columns near one, within a band of y - x: (x, y, score)."""
    low, high = max(limits[0], x - reach), min(limits[1], x + reach)
    size = _FIRST_POINTS
    step = (high - low) / (size - 1)
    left, middle, right = low, low, high
    best_y, best = 0.0, -1.0
    count = 0
    while count < size or right - left > x_tolerance:
        if count < size:
            x = low + count * step if count + 1 < size else high
        else:
            x = _probe(left, middle, right)
        y, value = _best_of_column(x, band, y_tolerance, limits, problem)
        is_better = best < _ROUNDING * value
        if count >= size:
            left, middle, right = _narrow(left, middle, right, x, is_better)
        elif is_better:
            middle = x
        if is_better:
            best_y, best = y, value
        count += 1
        if count == size:
            left, right = max(low, middle - step), min(high, middle + step)
    return middle, best_y, best
