# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Wave speed of layers from how they ring when nothing holds them (App. B of the paper).

Notes
-----
A free layer rings with the period :math:`T_0 = 2 L_s / c_s`, and at odd multiples :math:`n` of
this frequency. With the loss tangent :math:`d` of Kelvin and Voigt, a mode :math:`\omega = 2 \pi
n / T_0` decays as :math:`e^{-h \omega t}`, :math:`h = n d / 2`, and is slowed down to
:math:`\omega \sqrt{1 - h^2}`. The fit has two modes, whose linear amplitudes are eliminated.

"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from scipy import optimize, stats
from soft_throw_ros.identification.least_squares import Estimate, FitError
from soft_throw_ros.identification.tracks import FEWEST, Floats, Track

_MODES = (1.0, 3.0)  # frequencies of the modes, over the first one
_LOSSES = (0.01, 0.1, 0.4)  # initial loss tangents
_MAX_LOSS = 1.9  # largest loss tangent; beyond 2 no layer oscillates
_MIN_CYCLES = 1.5  # smallest number of periods in the record
_MIN_SAMPLES = 2.5  # smallest number of samples per period
_ONSET = 0.7  # share of the largest change of length, below which the layer counts as free
_MIN_SIGNAL = 50.0  # smallest decrease of chi squared by the oscillation; noise reaches about 20


def fit_period(bottom: Track, top: Track) -> Estimate:
    """Find the period of a free layer [s] from its ends; raise FitError if it does not ring."""
    time, lower, upper = np.intersect1d(bottom.time, top.time, return_indices=True)
    length = Track(time=time, position=top.position[upper] - bottom.position[lower])
    length = length.without_spikes()
    change = np.abs(length.position - np.median(length.position[length.position.size // 2:]))
    large = change >= _ONSET * change.max()
    first = int(np.argmax(large))
    onset = first + int(np.argmin(np.append(large[first:], False)))  # end of the squeeze
    if length.time.size - onset < FEWEST:
        raise FitError(f'the layer is seen ringing in {length.time.size - onset} samples only')
    since = length.time[onset:] - length.time[onset]
    return _fit_modes(since, length.position[onset:], length.noise)


def _fit_modes(time: Floats, length: Floats, noise: float) -> Estimate:
    """Fit period and loss; residuals beyond the noise increase the error."""
    interval = float(np.median(np.diff(time)))
    usual = _strongest_period(time, length, interval)
    modes = [mode for mode in _MODES if mode * _MIN_SAMPLES * interval <= usual] or [1.0]

    def residuals(values: Floats) -> Floats:
        ratio, loss = values
        columns = [np.ones_like(time)]
        for mode in modes:
            half = 0.5 * mode * loss
            rate = 2.0 * math.pi * mode / (ratio * usual) * (np.sqrt(half**2 - 1.0 + 0j) - half)
            wave = np.exp(rate * time)
            columns += [wave.real, wave.imag]
        basis = np.stack(columns, axis=1)
        return np.asarray(length - basis @ np.linalg.lstsq(basis, length, rcond=None)[0]) / noise

    bounds = ([0.5, 0.0], [2.0, _MAX_LOSS])
    fits = [optimize.least_squares(residuals, [1.0, loss], bounds=bounds) for loss in _LOSSES]
    best = min(fits, key=lambda fit: float(fit.cost))
    chi2 = 2.0 * float(best.cost)
    scatter = max(1.0, chi2 / max(1, time.size - 3 - 2 * len(modes)))
    if time.size * float(np.var(length)) / noise**2 - chi2 < _MIN_SIGNAL * scatter:
        raise FitError(
            f'the layer does not ring: its length goes from {length.min():.4g} m to '
            f'{length.max():.4g} m, with a noise of {noise:.2g} m'
        )
    variance = scatter * float(np.linalg.inv(best.jac.T @ best.jac)[0, 0])
    return Estimate(usual * float(best.x[0]), usual * math.sqrt(variance))


def _strongest_period(time: Floats, length: Floats, interval: float) -> float:
    """Return the period of the highest peak of the spectrum."""
    even = np.interp(np.arange(0.0, time[-1], interval), time, length)
    frequency = np.fft.rfftfreq(8 * even.size, interval)
    power = np.abs(np.fft.rfft(even - even.mean(), 8 * even.size))
    power *= (frequency > _MIN_CYCLES / time[-1]) & (_MIN_SAMPLES * interval * frequency < 1.0)
    if not power.any():
        raise FitError(f'the layer is seen for {time[-1]:.3g} s only, every {interval:.3g} s')
    return 1.0 / float(frequency[int(np.argmax(power))])


def fit_wave_speed(
    thicknesses: Sequence[float], periods: Sequence[Estimate], *, thickness_error: float
) -> tuple[Estimate, float]:
    """
    Fit a line through the origin to thicknesses [m] and periods [s]; scatter adds errors.

    Return the wave speed [m/s], and the probability that one material scatters so.
    """
    thickness, (period, error) = np.array(thicknesses), np.transpose(periods)
    slope = float(period.sum() / thickness.sum())
    for _ in range(4):  # the weights hardly depend on the slope
        weights = np.hypot(error, slope * thickness_error) ** -2.0
        information = float(np.sum(weights * thickness**2))
        slope = float(np.sum(weights * period * thickness)) / information
    chi2, dof = float(np.sum(weights * (period - slope * thickness) ** 2)), period.size - 1
    scatter = max(1.0, chi2 / dof) if dof else 1.0
    speed_error = 2.0 / slope**2 * math.sqrt(scatter / information)
    probability = float(stats.chi2.sf(chi2, dof)) if dof else 1.0
    return Estimate(2.0 / slope, speed_error), probability
