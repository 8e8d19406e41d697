# SPDX-License-Identifier: Apache-2.0
r"""
Frequency, damping, amplitude and start of the plate from its track (App. D.2 of the paper).

Notes
-----
The model is Eq. (D2) from a start :math:`t_0` on, above a height :math:`z_0` at rest. For given
frequency and damping the amplitude and :math:`z_0` enter linearly, and a shift in time is a
correlation. So the sum of squares is computed for a table of frequencies and dampings and, by
FFT, for every sample as the start; the best of these are refined by least squares. No guess is
needed from anybody.

"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.identification.least_squares import (
    central_difference,
    Estimate,
    Fit,
    fit_tracks,
    FitError,
    FitModel,
)
from soft_throw_ros.identification.tracks import Track

Floats = NDArray[np.float64]

NAMES = ('frequency', 'damping_ratio', 'amplitude', 'start_time', 'offset')
"""Parameters of the fit; the last is the height of the plate at rest."""

MAX_DAMPING_RATIO = 0.99
"""Largest damping ratio."""

_DAMPING_RATIOS = (0.0, 0.03, 0.1, 0.25, 0.5, 0.8)  # of the table
_MAX_SAMPLES = 4096  # for which the table is made
_SAMPLES_PER_PERIOD = 5.0  # at least, of the highest frequency
_PERIODS_SEEN = 0.25  # at least, of the lowest one
_MAX_MISMATCH = 0.08  # of the amplitude that may be left
_BLOCK = 2**18  # numbers at once
_REFINED = 3  # of the table's best
_STEPS = (1e-5, 1e-6, 1e-5)  # for derivatives: relative in frequency and amplitude, not damping


@dataclass(frozen=True, kw_only=True)
class PlateFit:
    """
    How the plate moves, from its track.

    Parameters
    ----------
    fit : Fit
        Of `NAMES`, or of all but the last.
    offset : float
        Height of the plate at rest. [m]

    """

    fit: Fit
    offset: float

    @property
    def motion(self) -> Underdamped:
        """The motion, from its start on."""
        frequency, damping_ratio, amplitude = (float(value) for value in self.fit.values[:3])
        return Underdamped(frequency=frequency, damping_ratio=damping_ratio, amplitude=amplitude)

    @property
    def start_time(self) -> float:
        """When it begins, on the clock of the track. [s]"""
        return self.fit['start_time'].value

    @property
    def peak_velocity(self) -> Estimate:
        """:math:`V_p^*` (D4), with its standard error. [m/s]"""
        gradient = np.zeros(len(self.fit.names))
        gradient[:3] = _peak_velocity_slopes(self.fit.values[:3])
        error = math.sqrt(float(gradient @ self.fit.covariance @ gradient))
        return Estimate(self.motion.peak_velocity, error)


def fit_plate(track: Track, *, offset: float | None = None) -> PlateFit:
    """
    Fit the plate's motion to its track.

    Parameters
    ----------
    track : Track
        Of a plate that rests, jumps up once, and settles. It need not be seen to the end, but
        its rise must be.
    offset : float, optional
        Height of the plate at rest; fitted if not given. [m]

    Raises
    ------
    FitError
        If the track does not look like such a motion, saying what it looks like.

    Examples
    --------
    >>> time = np.linspace(0.0, 0.1, 201)
    >>> plate = Underdamped(frequency=63.2, amplitude=2e-3, damping_ratio=0.064)
    >>> found = fit_plate(Track(time=time, position=plate.position(time - 0.02)))
    >>> round(found.motion.frequency, 6), round(found.start_time, 6)
    (63.2, 0.02)

    """
    free = len(NAMES) if offset is None else len(NAMES) - 1
    fixed = () if offset is None else (offset,)
    model = FitModel(
        names=NAMES[:free],
        predict=lambda values: _position(np.append(values, fixed), track.time),
        jacobian=lambda values: _slopes(np.append(values, fixed), track.time)[:, :free],
        low=np.array([1e-6, 0.0, 0.0, track.time[0] - track.duration, -np.inf])[:free],
        high=np.array([np.inf, MAX_DAMPING_RATIO, np.inf, track.time[-1], np.inf])[:free],
    )
    tried = [
        fit_tracks(model, start[:free], [('plate', track)], max_evaluations=200)
        for start in _starts(track.without_spikes())
    ]
    best = min(tried, key=lambda found: found.chi2)
    if best.values[2] < 3.0 * best.errors[2] or best.values[2] <= 0.0:
        raise FitError(
            f'the plate does not move up: its height goes from {track.position.min():g} m to '
            f'{track.position.max():g} m, with a noise of {track.noise:.2g} m'
        )
    left = best.residuals[0].rms
    if left > max(_MAX_MISMATCH * best.values[2], 5.0 * track.noise):
        raise FitError(
            f'the plate does not move as a damped step: the best of {best.values[2]:.2g} m leaves '
            f'{left:.2g} m; its track must begin before it moves'
        )
    return PlateFit(fit=best, offset=best['offset'].value if offset is None else offset)


def _motion(values: Floats) -> Underdamped:
    """Make the motion; while it is searched for the amplitude may touch 0."""
    return Underdamped(
        frequency=float(values[0]),
        damping_ratio=float(values[1]),
        amplitude=max(float(values[2]), 1e-15),
    )


def _position(values: Floats, time: Floats) -> Floats:
    """Compute heights for values of `NAMES`."""
    return np.asarray(values[4] + _motion(values).position(time - values[3]))


def _slopes(values: Floats, time: Floats) -> Floats:
    """Differentiate the height by all of `NAMES`."""
    velocity = _motion(values).velocity(time - values[3])
    shape = _differentiate(lambda changed: _position(changed, time), values)
    return np.stack([*shape, -velocity, np.ones_like(time)], axis=1)


def _peak_velocity_slopes(values: Floats) -> list[Floats]:
    """Differentiate the largest velocity by frequency, damping ratio and amplitude."""
    return _differentiate(lambda changed: np.array(_motion(changed).peak_velocity), values)


def _differentiate(function: Callable[[Floats], Floats], values: Floats) -> list[Floats]:
    """Differentiate a property of the motion by frequency, damping ratio and amplitude."""
    slopes = []
    for place, step in enumerate(_STEPS):
        size = 1.0 if place == 1 else max(abs(float(values[place])), 1e-9)
        high = MAX_DAMPING_RATIO if place == 1 else math.inf
        change, width = central_difference(
            function, values, [place], step=step * size, low=0.0, high=high
        )
        slopes.append(change / width[0])
    return slopes


def _starts(track: Track) -> list[Floats]:
    """Find where to start from."""
    count = min(_MAX_SAMPLES, max(32, math.ceil(track.duration / track.interval) + 1))
    time = np.linspace(track.time[0], track.time[-1], count)
    height = np.interp(time, track.time, track.position)
    table = [
        _best_of(_frequencies(time, damping), damping, time, height) for damping in _DAMPING_RATIOS
    ]
    table.sort(key=lambda entry: entry[0], reverse=True)
    if table[0][1][2] < 0.0:
        raise FitError(
            f'the plate goes down by about {-table[0][1][2]:.1g} m; heights must count upwards, '
            'and its track must begin before it moves'
        )
    return [start for _, start in table[:_REFINED]]


def _frequencies(time: Floats, damping: float) -> Floats:
    """Choose frequencies as dense as an oscillation of that damping and so long a track need."""
    duration = float(time[-1] - time[0])
    lowest = _PERIODS_SEEN / duration
    highest = 1.0 / (_SAMPLES_PER_PERIOD * (time[1] - time[0]))
    chosen = [lowest]
    while chosen[-1] < highest:
        chosen.append(chosen[-1] + max(0.25 / duration, 0.3 * damping * chosen[-1]))
    return np.array(chosen)


def _best_of(
    frequencies: Floats, damping: float, time: Floats, height: Floats
) -> tuple[float, Floats]:
    """
    Find which frequency and which start leave least, for one damping.

    Returns by how much the sum of squares falls, and the values of `NAMES`; the amplitude is
    negative if the plate goes down.
    """
    count = time.size
    size = 2 ** math.ceil(math.log2(2 * count))
    mean = float(height.mean())
    transform = np.fft.rfft(height - mean, size)
    best: tuple[float, Floats] = (-1.0, np.zeros(len(NAMES)))
    latest = count - 4  # what begins later is seen too little of
    since = time - time[0]
    unit = Underdamped(frequency=1.0, damping_ratio=damping, amplitude=1.0)
    for some in np.array_split(frequencies, -(-frequencies.size * size // _BLOCK)):
        shapes = unit.position(np.outer(some, since))
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
