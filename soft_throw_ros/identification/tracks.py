# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Tracks: heights of bodies over time, how noisy they are, and records cut into throws."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
from dataclasses import dataclass, field, replace
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import spectrogram
from soft_throw_ros.core import checks

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Places = NDArray[np.intp]

FEWEST = 12
"""Samples of a track at least."""

MAX_TIME, MAX_HEIGHT = 1e12, 1e6
"""What is beyond these was not meant as seconds or metres. [s], [m]"""

MIN_STEP = 1e-12
"""By how much time increases at least. [s]"""

_STRAY_LIMIT = 5.0  # median deviations from the cubic beyond which it is a kink, not noise
_ROUNDING_TOLERANCE = 0.1  # of a step, that heights may be off from multiples of it
_MAX_ROUNDING_STEPS = 1e5  # that heights extend over; who rounds more finely adds no noise
_SPIKE_LIMIT = 8.0  # times what is usual that a sample is away from the cubic through neighbours
_SPIKE_SIDES = np.array([np.arange(-8, -2), np.arange(3, 9)])  # samples that say what is usual
_SPIKE_SHARE = 1e-4  # of the whole way is usual at least: motions without noise have kinks
_SPIKE_ROUNDS = 4  # of leaving them out, since there may be some in a row
_MAX_SPIKE_SHARE = 0.1  # of the samples; where there are more it is the motion

_LONGEST_BREAK = 1.0  # within a throw [s], and ...
_LONGEST_BREAK_SAMPLES = 100.0  # in intervals between samples

# In plate periods:
_KEPT_BEFORE = 0.25  # of a throw among others, and ...
_KEPT_AFTER = 6.0  # of its start
_SEEN_AFTER = 2.0  # the start of the last one of several throws that must be seen
_REST = 0.5  # that the plate rests between two throws at least
_SMOOTHING = 0.125  # that are averaged over to see where it rests

_ABOVE_NOISE = 25.0  # how often as strong as noise, at its frequency, an oscillation is at least
_SEGMENT = 2**15  # samples of one spectrum
_MAX_EVEN_SAMPLES = 2**24  # of a record, made even to look for its period


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

    Raises
    ------
    TrackError
        If the series do not fit, are shorter than `FEWEST`, are not finite, beyond `MAX_TIME` or
        `MAX_HEIGHT`, or do not increase.
    ValueError
        If the noise is not finite and positive.

    """

    time: Floats
    position: Floats
    known_noise: float | None = None
    least_noise: float = 0.0
    noise: float = field(init=False)
    """Standard deviation of the positions, known or estimated. [m]"""

    def __post_init__(self) -> None:
        time = np.asarray(self.time, dtype=np.float64)
        position = np.asarray(self.position, dtype=np.float64)
        if time.ndim != 1 or time.shape != position.shape or time.size < FEWEST:
            raise TrackError(
                f'a track is two series of the same length, at least {FEWEST}, '
                f'got shapes {time.shape} and {position.shape}'
            )
        for name, values, most in (('time', time, MAX_TIME), ('position', position, MAX_HEIGHT)):
            if not np.isfinite(values).all():
                raise TrackError(f'{name} must be finite, got {values[~np.isfinite(values)][0]}')
            if np.abs(values).max() > most:
                far = values[np.abs(values).argmax()]
                raise TrackError(f'{name} must be within +- {most:g}, got {far:g}')
        is_bad = np.diff(time) < MIN_STEP
        if is_bad.any():
            place = int(np.flatnonzero(is_bad)[0])
            raise TrackError(f'time must increase, got {time[place + 1]} after {time[place]}')
        object.__setattr__(self, 'time', time)
        object.__setattr__(self, 'position', position)
        if self.known_noise is None:
            noise = max(noise_of(time, position), self.least_noise)
        else:
            noise = checks.require_positive('known_noise', self.known_noise)
        object.__setattr__(self, 'noise', noise)

    @property
    def interval(self) -> float:
        """Usual time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    def where(self, kept: Flags | Places) -> Track:
        """Return some of the samples, by flags or places, as noisy as all of them."""
        return replace(
            self, time=self.time[kept], position=self.position[kept], least_noise=self.noise
        )

    def between(self, start: float, end: float) -> Track:
        """Return the part from `start` to `end` [s], both included; too short a one is refused."""
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
        Leave out single samples that jump, to start from where no model of the motion is at hand.

        A spike is away from the cubic through the two samples on either side much farther than is
        usual before it, after it, and than the noise. So neither kinks of the motion nor what
        moves like that all the time are left out.
        """
        least = max(self.noise, _SPIKE_SHARE * float(np.ptp(self.position)))
        kept = np.arange(self.time.size)
        for _ in range(_SPIKE_ROUNDS):
            apart = np.abs(_beside_neighbours(self.time[kept], self.position[kept])[0])
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
    """What was seen of one throw; the name is for messages."""

    name: str
    plate: Track
    projectile: Track | None = None

    def between(self, start: float, end: float) -> ThrowTracks:
        """Return the part from `start` to `end` [s]; of the projectile there may be none."""
        projectile = None
        if self.projectile is not None:
            with contextlib.suppress(TrackError):
                projectile = self.projectile.between(start, end)
        return replace(self, plate=self.plate.between(start, end), projectile=projectile)

    def apply(self, change: Callable[[Track], Track]) -> ThrowTracks:
        """Change both tracks alike."""
        projectile = self.projectile and change(self.projectile)
        return replace(self, plate=change(self.plate), projectile=projectile)


def noise_of(time: Floats, position: Floats) -> float:
    r"""
    Estimate the standard deviation of white noise on a smooth motion [m].

    Parameters
    ----------
    time : ndarray, shape (n,)
        Of the samples, which may be uneven, as where some were lost. [s]
    position : ndarray, shape (n,)
        [m]

    Notes
    -----
    From how far each sample is from the cubic through the two on either side, over what that is
    if they are equally noisy. A motion of n even samples per period is passed on by
    :math:`(2 \pi / n)^4 / \sqrt{70}`. What is beyond five median deviations, at kinks and jumps,
    is left out. Heights that are rounded err by :math:`1 / \sqrt{12}` of a step; while nothing
    moves they do so all alike, so that only samples that move by a step tell the noise. Never 0,
    so that one can divide by it.

    """
    apart, spread = _beside_neighbours(time, position)
    steps = (apart / spread)[2:-2]
    noise = _rms_without_strays(steps)
    step = _rounding_step(position)
    if step > 0.0:
        moving = np.abs(position[4:] - position[:-4]) >= 4.0 * step
        if moving.sum() >= FEWEST:
            noise = max(noise, _rms_without_strays(steps[moving]))
    return max(noise, step / math.sqrt(12.0), 1e-9 * float(np.ptp(position)), 1e-15)


def _rms_without_strays(values: Floats) -> float:
    """Root mean square of what is not far beyond the usual."""
    usual = 1.4826 * float(np.median(np.abs(values)))
    kept = values[np.abs(values) <= _STRAY_LIMIT * usual]
    return float(np.sqrt(np.mean(kept**2))) if usual > 0.0 else 0.0


def _rounding_step(position: Floats) -> float:
    """Find the step that all heights are multiples of, from one of them; 0 if there is none."""
    levels = np.unique(position)
    steps = np.diff(levels)
    steps = steps[steps > np.ptp(position) / _MAX_ROUNDING_STEPS]
    if not steps.size:
        return 0.0
    # The mean over many steps of one size is far more precise than any of them
    step = float(np.mean(steps[steps < 1.5 * steps.min()]))
    multiples = (levels - levels[0]) / step
    is_rounded = np.abs(multiples - np.round(multiples)).max() < _ROUNDING_TOLERANCE
    return step if is_rounded else 0.0


def _beside_neighbours(time: Floats, position: Floats) -> tuple[Floats, Floats]:
    """
    Subtract the cubic through two samples on either side from each; 0 at the ends.

    The second series is how noisy that is, over the noise of a single sample.
    """
    apart, variance = np.zeros_like(position), np.ones_like(position)
    inner = np.arange(2, time.size - 2)
    apart[inner] = position[inner]
    beside = [inner + offset for offset in (-2, -1, 1, 2)]
    for each in beside:  # Lagrange's polynomials
        weight = np.ones(inner.size)
        for other in beside:
            if other is not each:
                weight *= (time[inner] - time[other]) / (time[each] - time[other])
        apart[inner] -= weight * position[each]
        variance[inner] += weight**2
    return apart, np.sqrt(variance)


def split_at_breaks(record: ThrowTracks) -> list[ThrowTracks]:
    """
    Cut a record where the plate was not seen for long, as between sessions or clocks.

    Pieces of less than `FEWEST` samples are left out, unless there is nothing else.
    """
    time = record.plate.time
    longest = max(_LONGEST_BREAK, _LONGEST_BREAK_SAMPLES * record.plate.interval)
    breaks = np.flatnonzero(np.diff(time) > longest) + 1
    pieces = [each for each in np.split(time, breaks) if each.size >= FEWEST]
    if not breaks.size or not pieces:
        return [record]
    parts = [record.between(float(piece[0]), float(piece[-1])) for piece in pieces]
    if len(parts) == 1:
        return parts
    return [
        replace(part, name=f'{record.name}, part {number}') for number, part in enumerate(parts, 1)
    ]


def split_into_throws(record: ThrowTracks) -> list[ThrowTracks]:
    """
    Cut a long record into its throws.

    Notes
    -----
    A throw begins where the plate leaves its lowest place of rest. If it comes back there, what
    is kept is a quarter of a plate period before and at most six periods after that, so that the
    plate must not be put back earlier. If there are several, the last one is left out if the
    record ends two periods after its start or sooner. A record in which the plate rests there
    only once, or never, is one throw and stays whole.

    """
    parts = [record.between(*span) for span in find_throws(record.plate)]
    if len(parts) < 2:
        return parts or [record]
    return [
        replace(part, name=f'{record.name}, throw {number}')
        for number, part in enumerate(parts, 1)
    ]


def find_throws(plate: Track) -> list[tuple[float, float]]:
    """Find begin and end [s] of the throws in a record to which the plate comes back to rest."""
    plate = plate.without_spikes()
    time = plate.time
    period = dominant_period(plate)
    size = max(3, round(_REST * period / plate.interval))
    if size >= time.size:
        return []
    width = max(1, round(_SMOOTHING * period / plate.interval))
    position = uniform_filter1d(plate.position, width)
    low = minimum_filter1d(position, size)
    high = maximum_filter1d(position, size)
    tolerance = 6.0 * plate.noise / math.sqrt(width) + 0.005 * float(np.ptp(position))
    quiet = high - low < 2.0 * tolerance
    if not quiet.any():
        return []
    rest = float(np.min(0.5 * (low + high)[quiet]))
    at_rest = quiet & (np.abs(position - rest) < tolerance)
    edges = np.diff(at_rest.astype(np.int8))
    begins = np.flatnonzero(edges == 1) + 1
    ends = np.minimum(np.flatnonzero(edges == -1) + size // 2, time.size - 1)
    lift = rest + 0.3 * (float(position.max()) - rest)
    starts = []
    for end in ends.tolist():
        soon = (time >= time[end - size // 2]) & (time <= time[end] + period)
        if (position[soon] > lift).any():
            starts.append(float(time[end]))
    returns = [float(time[begin]) for begin in begins]
    if len(starts) < 2 and not any(back > start for start in starts for back in returns):
        return []
    if len(starts) > 1 and time[-1] < starts[-1] + _SEEN_AFTER * period:
        starts.pop()
    limits = [*starts[1:], math.inf]
    before, after = _KEPT_BEFORE * period, _KEPT_AFTER * period
    return [
        (start - before, min(start + after, limit - before))
        for start, limit in zip(starts, limits, strict=True)
    ]


def dominant_period(plate: Track) -> float:
    """Find the period of the strongest oscillation of the plate's velocity."""
    count = min(max(16, round(plate.duration / plate.interval) + 1), _MAX_EVEN_SAMPLES)
    even, step = np.linspace(plate.time[0], plate.time[-1], count, retstep=True)
    velocity = np.diff(np.interp(even, plate.time, plate.position)) / step
    frequency, _, powers = spectrogram(velocity, 1.0 / step, nperseg=min(velocity.size, _SEGMENT))
    noise = 8.0 / step * (plate.noise * np.sin(np.pi * step * frequency)) ** 2
    strength = powers.max(axis=1) - _ABOVE_NOISE * noise
    return 1.0 / float(frequency[max(1, int(np.argmax(strength)))])
