# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Frequency, damping, amplitude and start of the plate from its track (App. D.2 of the paper).

Notes
-----
The model is Eq. (D2) from a start :math:`t_0` on, above a height :math:`z_0` at rest. For given
frequency and damping the amplitude and :math:`z_0` enter linearly, and a shift in time is a
correlation. So the sum of squares is computed for a table of frequencies and dampings and, by
FFT, for every sample as the start; least squares refine the best entry. So the fit needs no
initial guess.

"""

from __future__ import annotations

from dataclasses import replace
import math
from operator import itemgetter

import numpy as np
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.identification.fit_description import ENGINE, PLATE_ZERO, START
from soft_throw_ros.identification.least_squares import Fit, fit_tracks, FitError
from soft_throw_ros.identification.tracks import Floats, Track

NAMES = (*ENGINE, START, PLATE_ZERO)
"""Parameters of the fit, by their names in a fit of a whole rig."""

MAX_DAMPING_RATIO = 0.99

_DAMPING_RATIOS = (0.0, 0.03, 0.1, 0.25, 0.5, 0.8)  # damping ratios of the table
_MAX_SAMPLES = 4096  # largest number of samples in the computation of the table
_SAMPLES_PER_PERIOD = 5.0  # samples per period of the highest frequency of the table
_PERIODS_SEEN = 0.25  # periods of the lowest frequency of the table in the record
_MAX_MISMATCH = 0.08  # largest residual of a plate, over the amplitude (rms)
_USUAL_SHARE = 0.99  # of the residuals; outliers side by side are no spikes
_BLOCK = 2**18  # numbers per block of the table, to limit memory


def fit_plate(track: Track) -> Fit:
    """
    Fit the plate's motion, `NAMES`, to a track with its rest, its rise, and some of the settling.

    Raise FitError if the track does not look like such a motion; the message has the difference.
    """
    usual = track.without_spikes()
    start = _start(usual)
    origin = np.array([0.0, 0.0, 0.0, start[3], start[4]])  # then all values are of order 1

    def position(values: Floats, time: Floats) -> Floats:
        frequency, damping_ratio, amplitude, start_time, offset = (values + origin).tolist()
        amplitude = max(amplitude, 1e-15)  # may touch 0 during the search
        motion = Underdamped(frequency=frequency, damping_ratio=damping_ratio, amplitude=amplitude)
        return np.asarray(offset + motion.position(time - start_time))

    earliest, latest = track.time[0] - track.duration - start[3], track.time[-1] - start[3]
    low = np.array([1e-6, 0.0, 0.0, earliest, -np.inf])
    high = np.array([np.inf, MAX_DAMPING_RATIO, np.inf, latest, np.inf])
    best = fit_tracks(
        lambda values: position(values, track.time), start - origin, [('plate', track)],
        names=NAMES, bounds=(low, high),
    )
    amplitude = best['engine.amplitude']
    if amplitude.value < 3.0 * amplitude.error or amplitude.value <= 0.0:
        raise FitError(
            f'the plate does not move up: its height goes from {track.position.min():g} m to '
            f'{track.position.max():g} m, with a noise of {track.noise:.2g} m'
        )
    residuals = np.abs(usual.position - position(best.values, usual.time))
    is_usual = residuals <= np.quantile(residuals, _USUAL_SHARE)
    residual = float(np.sqrt(np.mean(residuals[is_usual] ** 2)))
    if residual > max(_MAX_MISMATCH * amplitude.value, 5.0 * track.noise):
        raise FitError(
            f'the plate does not move as a damped step: the best of {amplitude.value:.2g} m '
            f'leaves {residual:.2g} m; its track must begin before it moves'
        )
    return replace(best, values=best.values + origin)


def _start(track: Track) -> Floats:
    """Return the best entry of the table of frequencies and dampings."""
    count = min(_MAX_SAMPLES, max(32, math.ceil(track.duration / track.interval) + 1))
    time = np.linspace(track.time[0], track.time[-1], count)
    height = np.interp(time, track.time, track.position)
    table = [
        _best_of(_frequencies(time, damping), damping, time, height) for damping in _DAMPING_RATIOS
    ]
    _, best = max(table, key=itemgetter(0))
    if best[2] < 0.0:
        raise FitError(
            f'the plate goes down by about {-best[2]:.1g} m; heights must count upwards, '
            'and its track must begin before it moves'
        )
    return best


def _frequencies(time: Floats, damping: float) -> Floats:
    """Return frequencies as dense as the damping and the length of the track require."""
    duration = float(time[-1] - time[0])
    highest = 1.0 / (_SAMPLES_PER_PERIOD * (time[1] - time[0]))
    chosen = [_PERIODS_SEEN / duration]
    while chosen[-1] < highest:
        chosen.append(chosen[-1] + max(0.25 / duration, 0.3 * damping * chosen[-1]))
    return np.array(chosen)


def _best_of(
    frequencies: Floats, damping: float, time: Floats, height: Floats
) -> tuple[float, Floats]:
    """Return the largest decrease of the sum of squares for one damping, and its `NAMES`."""
    count = time.size
    size = 2 ** math.ceil(math.log2(2 * count))
    mean = float(height.mean())
    transform = np.fft.rfft(height - mean, size)
    best: tuple[float, Floats] = (-1.0, np.zeros(len(NAMES)))
    latest = count - 4  # a later start leaves too few samples
    unit = Underdamped(frequency=1.0, damping_ratio=damping, amplitude=1.0)
    for some in np.array_split(frequencies, -(-frequencies.size * size // _BLOCK)):
        shapes = unit.position(np.outer(some, time - time[0]))
        spectra = transform * np.conj(np.fft.rfft(shapes, size))
        products = np.fft.irfft(spectra, size)[:, :latest]
        sums = np.cumsum(shapes, axis=1)[:, ::-1][:, :latest]
        squares = np.cumsum(shapes**2, axis=1)[:, ::-1][:, :latest] - sums**2 / count
        gains = products**2 / np.maximum(squares, 1e-300)
        row, shift = np.unravel_index(np.argmax(gains), gains.shape)
        if gains[row, shift] > best[0]:
            amplitude = float(products[row, shift] / squares[row, shift])
            offset = mean - amplitude * float(sums[row, shift]) / count
            values = (some[row], damping, amplitude, time[shift], offset)
            best = (float(gains[row, shift]), np.array(values))
    return best
