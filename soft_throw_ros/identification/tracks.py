# SPDX-License-Identifier: Apache-2.0
"""Tracks: heights of bodies over time, how noisy they are, and which samples jump."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from soft_throw_ros.core import checks

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Places = NDArray[np.intp]

FEWEST = 12
"""Samples of a track at least."""

_DIFFERENCE_ORDER = 4  # of the differences that noise is taken from
_SPIKE_LIMIT = 8.0  # times what is usual that a sample is away from the cubic through neighbours
_SPIKE_SIDES = np.array([np.arange(-8, -2), np.arange(3, 9)])  # samples that say what is usual
_SPIKE_SHARE = 1e-4  # of the whole way is usual at least: motions without noise have kinks
_SPIKE_ROUNDS = 4  # of leaving them out, since there may be some in a row
_MAX_SPIKE_SHARE = 0.1  # of the samples; where there are more it is the motion


class TrackError(ValueError):
    """A track is not what it should be; the message says where."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """
    Heights of one body, where it was seen.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing. [s]
    position : ndarray, shape (n,)
        Upwards, from any zero. [m]
    known_noise : float, optional
        Standard deviation of the positions; estimated from them if not given. [m]
    least_noise : float
        What an estimate is at least. [m]

    Attributes
    ----------
    noise : float
        Standard deviation of the positions, known or estimated. [m]

    Raises
    ------
    TrackError
        If the series do not fit, are shorter than `FEWEST`, are not finite or do not increase.
    ValueError
        If the noise is not finite and positive.

    """

    time: Floats
    position: Floats
    known_noise: float | None = None
    least_noise: float = 0.0
    noise: float = field(init=False)

    def __post_init__(self) -> None:
        time = np.asarray(self.time, dtype=np.float64)
        position = np.asarray(self.position, dtype=np.float64)
        if time.ndim != 1 or time.shape != position.shape or time.size < FEWEST:
            raise TrackError(
                f'a track is two series of the same length, at least {FEWEST}, '
                f'got shapes {time.shape} and {position.shape}'
            )
        for name, values in (('time', time), ('position', position)):
            if not np.isfinite(values).all():
                raise TrackError(f'{name} must be finite, got {values[~np.isfinite(values)][0]}')
        if (np.diff(time) <= 0.0).any():
            place = int(np.flatnonzero(np.diff(time) <= 0.0)[0])
            raise TrackError(f'time must increase, got {time[place + 1]} after {time[place]}')
        object.__setattr__(self, 'time', time)
        object.__setattr__(self, 'position', position)
        if self.known_noise is None:
            noise = max(noise_of(position), self.least_noise)
        else:
            noise = checks.require_positive('known_noise', self.known_noise)
        object.__setattr__(self, 'noise', noise)

    @property
    def interval(self) -> float:
        """Usual time between samples. [s]"""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        """Time from the first sample to the last. [s]"""
        return float(self.time[-1] - self.time[0])

    def where(self, kept: Flags | Places) -> Track:
        """
        Return some of the samples, by flags or places, as noisy as all of them.

        Raises
        ------
        TrackError
            If they are too few.

        """
        return replace(
            self,
            time=self.time[kept],
            position=self.position[kept],
            least_noise=self.noise,
        )

    def between(self, start: float, end: float) -> Track:
        """
        Return the part from `start` to `end` [s], both included.

        Raises
        ------
        TrackError
            If it is too short.

        """
        inside = (self.time >= start) & (self.time <= end)
        if inside.sum() < FEWEST:
            raise TrackError(
                f'only {inside.sum()} samples from {start:g} s to {end:g} s, where at least '
                f'{FEWEST} are needed; the track goes from {self.time[0]:g} s '
                f'to {self.time[-1]:g} s'
            )
        return replace(self, time=self.time[inside], position=self.position[inside])

    def without_spikes(self) -> Track:
        """
        Leave out single samples that jump away from their neighbours.

        This is for where no model of the motion is at hand yet, to start from. A sample is a
        spike if it is away from the cubic through the two samples on either side much farther
        than is usual before it, after it, and than the noise. So neither kinks of the motion nor
        what moves like that all the time are left out.
        """
        least = max(self.noise, _SPIKE_SHARE * float(np.ptp(self.position)))
        kept = np.arange(self.time.size)
        for _ in range(_SPIKE_ROUNDS):
            apart = np.abs(_beside_neighbours(self.time[kept], self.position[kept]))
            largest = maximum_filter1d(apart, 5)
            places = np.flatnonzero((apart > _SPIKE_LIMIT * least) & (apart >= largest))
            sides = np.clip(places[:, None] + _SPIKE_SIDES[:, None, :], 0, kept.size - 1)
            usual = np.median(apart[sides], axis=-1).max(axis=0)
            spikes = places[apart[places] > _SPIKE_LIMIT * usual]
            if not spikes.size:
                break
            if spikes[0] == 2:  # which one of the first it is cannot be told
                spikes = np.append([0, 1], spikes)
            if spikes[-1] == kept.size - 3:
                spikes = np.append(spikes, [kept.size - 2, kept.size - 1])
            kept = np.delete(kept, spikes)
        if kept.size < max(FEWEST, (1.0 - _MAX_SPIKE_SHARE) * self.time.size):
            return self
        return self if kept.size == self.time.size else self.where(kept)


@dataclass(frozen=True, kw_only=True)
class ThrowTracks:
    """
    What was seen of one throw.

    Parameters
    ----------
    name : str
        Where it comes from, for messages.
    plate : Track
    projectile : Track, optional

    """

    name: str
    plate: Track
    projectile: Track | None = None

    def between(self, start: float, end: float) -> ThrowTracks:
        """
        Return the part from `start` to `end`. [s]

        Raises
        ------
        TrackError
            If there is too little of the plate; of the projectile there may be none.

        """
        projectile = None
        if self.projectile is not None:
            inside = (self.projectile.time >= start) & (self.projectile.time <= end)
            if inside.sum() >= FEWEST:
                projectile = self.projectile.between(start, end)
        return ThrowTracks(
            name=self.name, plate=self.plate.between(start, end), projectile=projectile
        )

    def without_spikes(self) -> ThrowTracks:
        """Leave out samples that jump, see `Track.without_spikes`."""
        return replace(
            self,
            plate=self.plate.without_spikes(),
            projectile=self.projectile and self.projectile.without_spikes(),
        )


def noise_of(position: Floats) -> float:
    r"""
    Estimate the standard deviation of white noise on a smooth motion. [m]

    Notes
    -----
    From differences of fourth order, which a motion of n samples per period passes on by
    :math:`(2 \pi / n)^4 / \sqrt{70}`; those beyond five median deviations, at kinks and jumps,
    are left out. Never 0, so that one can divide by it.

    """
    order = _DIFFERENCE_ORDER
    steps = np.diff(position, order) / math.sqrt(math.comb(2 * order, order))
    usual = 1.4826 * float(np.median(np.abs(steps)))
    kept = steps[np.abs(steps) <= 5.0 * usual]
    noise = float(np.sqrt(np.mean(kept**2))) if usual > 0.0 else 0.0
    return max(noise, 1e-9 * float(np.ptp(position)), 1e-15)


def _beside_neighbours(time: Floats, position: Floats) -> Floats:
    """Subtract the cubic through two samples on either side from each; 0 at the ends."""
    apart = np.zeros_like(position)
    inner = np.arange(2, time.size - 2)
    predicted = np.zeros(inner.size)
    offsets = (-2, -1, 1, 2)
    for offset in offsets:
        weight = np.ones(inner.size)
        for other in offsets:
            if other != offset:
                span = time[inner + offset] - time[inner + other]
                weight *= (time[inner] - time[inner + other]) / span
        predicted += weight * position[inner + offset]
    apart[inner] = position[inner] - predicted
    return apart
