# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Wave speed and loss of layers from how they ring when nothing holds them (App. B of the paper).

The wave speed that throws show comes from `soft_throw_ros.identification.rig_fit`.

Notes
-----
A free layer oscillates after a squeeze, with the period :math:`T_0 = 2 L_s / c_s`, and at odd
multiples of this frequency. With the loss of Kelvin and Voigt, :math:`\sigma = E_s
(\epsilon + \theta \dot\epsilon)`, each mode :math:`\omega_n = (2 n - 1) 2 \pi / T_0` decays as
:math:`e^{-\theta \omega_n^2 t / 2}` and is slowed down to :math:`\omega_n \sqrt{1 - (\theta
\omega_n / 2)^2}`. The fit has two modes, so that the residuals are noise; :math:`T_0` is the
period without loss.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from soft_throw_ros.core import checks
from soft_throw_ros.identification.least_squares import (
    Estimate,
    Fit,
    fit_best,
    FitError,
    FitModel,
)
from soft_throw_ros.identification.tracks import FEWEST, Track, TrackError

Floats = NDArray[np.float64]

_MODES = (1.0, 3.0)  # frequencies of the modes, over the first one
_LOSSES = (0.01, 0.1, 0.4)  # initial loss tangents
_MAX_LOSS = 1.9  # largest loss tangent; beyond 2 no layer oscillates
_MAX_SAMPLES = 1024  # largest number of samples in the scan of frequencies
_MIN_CYCLES = 1.5  # smallest number of periods in the record
_ONSET = 0.7  # share of the largest change of length, below which the layer counts as free
_STEP = 1e-5  # relative step of derivatives
_REFINED = 3  # number of refined frequencies


@dataclass(frozen=True, kw_only=True)
class Ringing:
    r"""
    Oscillation of a free layer.

    The fit is of `period` :math:`T_0` [s], `loss_tangent` at that period [-], `length` at rest
    [m], and of the modes, from `start_time` [s] on.

    """

    fit: Fit
    start_time: float

    @property
    def period(self) -> Estimate:
        """Eigenperiod :math:`T_0` [s]."""
        return self.fit['period']

    @property
    def loss_tangent(self) -> Estimate:
        """Loss tangent at the eigenperiod; with this kind of loss it grows with frequency [-]."""
        return self.fit['loss_tangent']

    def loss_tangent_at(self, frequency: float) -> Estimate:
        """Loss tangent at another frequency [-]."""
        factor = frequency * self.period.value
        return Estimate(factor * self.loss_tangent.value, factor * self.loss_tangent.error)


@dataclass(frozen=True)
class CommonValue:
    """Common value of layers of one material, with chi squared and degrees of freedom."""

    value: Estimate
    chi2: float
    dof: int

    @property
    def agreement(self) -> float:
        """Probability that layers of one material scatter as much; 1 for a single one [-]."""
        return float(stats.chi2.sf(self.chi2, self.dof)) if self.dof else 1.0


def change_of_length(bottom: Track, top: Track) -> Track:
    """Return the length of a layer at the common times of the tracks of its two ends."""
    time, lower, upper = np.intersect1d(bottom.time, top.time, return_indices=True)
    if time.size < FEWEST:
        raise TrackError(
            f'both ends of the layer are seen at {time.size} moments, where at least {FEWEST} '
            'are needed'
        )
    known = None
    if bottom.known_noise and top.known_noise:
        known = math.hypot(bottom.known_noise, top.known_noise)
    return Track(
        time=time, position=top.position[upper] - bottom.position[lower], known_noise=known
    )


def fit_ringing(length: Track) -> Ringing:
    """
    Find period and loss of a free layer from its length over time.

    Parameters
    ----------
    length : Track
        Track from `change_of_length`. Samples before the end of the first large change are
        ignored.

    Raises
    ------
    FitError
        If the layer does not ring.

    """
    smooth = length.without_spikes()
    late = smooth.position[smooth.position.size // 2:]
    change = np.abs(smooth.position - np.median(late))
    large = change >= _ONSET * change.max()
    first = int(np.argmax(large))
    large_samples = int(np.argmin(np.append(large[first:], False)))  # end of the squeeze
    onset = float(smooth.time[min(first + large_samples, smooth.time.size - 1)])
    try:
        free = length.between(onset, math.inf)
    except TrackError as error:
        raise FitError(f'the layer is not seen ringing: {error}') from None
    starts = _starts(free.without_spikes())
    best = _fit_modes(free, starts)
    size = math.hypot(*best.values[3:5])
    if size < 5.0 * math.hypot(*best.errors[3:5]):
        raise FitError(
            f'the layer does not ring: its length goes from {length.position.min():.4g} m to '
            f'{length.position.max():.4g} m, with a noise of {length.noise:.2g} m'
        )
    return Ringing(fit=best, start_time=onset)


def fit_wave_speed(
    thicknesses: Sequence[float],
    periods: Sequence[Estimate],
    *,
    thickness_error: float,
) -> CommonValue:
    r"""
    Fit the common wave speed of layers to their periods and thicknesses.

    Parameters
    ----------
    thicknesses : sequence of float
        [m]
    periods : sequence of Estimate
        Eigenperiods :math:`T_0` of the free layers. [s]
    thickness_error : float
        Standard error of each thickness. [m]

    Raises
    ------
    ValueError
        If the series do not fit, or a number is not positive (the error: not negative).

    Notes
    -----
    Least squares of :math:`T_0 - 2 L_s / c_s` over its error, with contributions of period and
    thickness. Excess scatter of the layers increases the error of the result by the same factor.

    """
    if not thicknesses or len(thicknesses) != len(periods):
        raise ValueError(
            f'there must be a period for each thickness, got {len(periods)} for {len(thicknesses)}'
        )
    thickness = checks.require_all('thicknesses', list(thicknesses), 'positive')
    period = checks.require_all('periods', [item.value for item in periods], 'positive')
    error = checks.require_all('periods', [item.error for item in periods], 'not_negative')
    spread = checks.require_not_negative('thickness_error', thickness_error)
    result = _common_value(period, thickness, np.ones_like(period))  # T_0 / L_s = 2 / c_s
    for _ in range(20):
        result = _common_value(period, thickness, np.hypot(error, result.value.value * spread))
    slowness = result.value
    speed = 2.0 / slowness.value
    return replace(result, value=Estimate(speed, speed * slowness.error / slowness.value))


def fit_loss_tangent(ringings: Sequence[Ringing], *, frequency: float) -> CommonValue:
    """
    Return the weighted mean of the loss tangents of free layers.

    Parameters
    ----------
    ringings : sequence of Ringing
        Fits of free layers, at least one.
    frequency : float
        Frequency of the resulting loss tangent. [Hz]

    Raises
    ------
    ValueError
        If there is no layer.

    """
    if not ringings:
        raise ValueError('there must be at least one layer that rings, got none')
    values, errors = np.transpose([ringing.loss_tangent_at(frequency) for ringing in ringings])
    return _common_value(values, np.ones_like(values), np.maximum(errors, 1e-12))


def _common_value(values: Floats, sizes: Floats, errors: Floats) -> CommonValue:
    """Fit the ratio of values to sizes; excess scatter increases the error."""
    weights = np.maximum(errors, 1e-150) ** -2.0
    information = float(np.sum(weights * sizes**2))
    mean = float(np.sum(weights * values * sizes)) / information
    chi2, dof = float(np.sum(weights * (values - mean * sizes) ** 2)), values.size - 1
    scatter = max(1.0, chi2 / dof) if dof else 1.0
    return CommonValue(Estimate(mean, math.sqrt(scatter / information)), chi2, dof)


def _fit_modes(length: Track, starts: Sequence[tuple[float, float]]) -> Fit:
    """Fit from periods and losses, at which the rest is linear."""
    time = length.time - length.time[0]
    usual, _ = starts[0]
    # A mode needs 2.5 samples per period
    count = sum(mode / usual <= 0.4 / length.interval for mode in _MODES) or 1
    names = ['period', 'loss_tangent', 'length']
    names += [f'{phase} {mode + 1}' for mode in range(count) for phase in ('cosine', 'sine')]
    values = []
    for period, loss_tangent in starts:
        columns = _modes(time, period, loss_tangent, count)
        linear, *_ = np.linalg.lstsq(columns, length.position, rcond=None)
        values.append(np.array([period, loss_tangent, *linear]))
    low, high = np.full((2, len(names)), np.array([[-np.inf], [np.inf]]))
    low[:2], high[:2] = (2.0 * length.interval, 0.0), (2.0 * length.duration, _MAX_LOSS)
    steps = np.full(len(names), _STEP * np.ptp(length.position))
    steps[:2] = _STEP * usual, _STEP
    model = FitModel.with_steps(
        names,
        lambda values: np.asarray(_modes(time, values[0], values[1], count) @ values[2:]),
        low, high, steps,
    )
    return fit_best(model, values, ('length', length), max_evaluations=100)


def _modes(time: Floats, period: float, loss_tangent: float, count: int) -> Floats:
    """Return the columns of the constant and of the modes."""
    columns = [np.ones_like(time)]
    for multiple in _MODES[:count]:
        omega = multiple * 2.0 * math.pi / period
        half = 0.5 * multiple * loss_tangent
        decay = np.exp(-min(half, 50.0) * omega * time)
        turn = omega * math.sqrt(abs(1.0 - half**2))
        if half < 1.0:
            columns += [decay * np.cos(turn * time), decay * np.sin(turn * time)]
        else:  # it creeps back without ringing
            slow = np.exp(-(half * omega - turn) * time)
            columns += [slow, np.exp(-(half * omega + turn) * time)]
    return np.stack(columns, axis=1)


def _starts(length: Track) -> list[tuple[float, float]]:
    """Return initial periods and losses from a scan."""
    every = -(-length.time.size // _MAX_SAMPLES)
    time = length.time[::every] - length.time[0]
    position = length.position[::every]
    minima = []
    for loss_tangent in _LOSSES:
        frequency = _MIN_CYCLES / length.duration
        while frequency < 0.4 / length.interval:
            columns = _modes(time, 1.0 / frequency, loss_tangent, 1)
            linear, *_ = np.linalg.lstsq(columns, position, rcond=None)
            mismatch = float(np.sum((position - columns @ linear) ** 2))
            minima.append((mismatch, 1.0 / frequency, loss_tangent))
            frequency += max(0.25 / length.duration, 0.1 * loss_tangent * frequency)
    if not minima:
        raise FitError(
            f'the layer is seen for {length.duration:.3g} s only, every {length.interval:.3g} s'
        )
    return [(period, loss) for _, period, loss in sorted(minima)[:_REFINED]]
