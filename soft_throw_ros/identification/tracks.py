# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks: heights of bodies over time, how noisy they are, and records cut into throws."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d, uniform_filter1d
from scipy.signal import spectrogram
from soft_throw_ros.configuration.csv_rows import Floats, MIN_STEP

Flags = NDArray[np.bool_]

FEWEST = 12
"""Smallest number of samples of a track."""

MAX_TIME, MAX_HEIGHT = 1e12, 1e6
"""Largest time and height; larger numbers have a wrong unit. [s], [m]"""

_NOISE_SIGMAS = 5.0  # deviation from the cubic that is a kink and not noise [median deviations]
_MIN_STEP = 1e-5  # smallest step of rounded heights that matters, over their range
_SPEED_SAMPLES = 5  # samples in a mean height from which the speed is computed

_SPIKE_LIMIT = 8.0  # deviation of a spike from the cubic through neighbours [noise]
_SPIKE_SHARE = 1e-4  # smallest deviation of a spike, as a share of the range of heights
_USUAL = 17  # number of samples whose median deviation is usual
_MAX_SPIKE_SHARE = 0.1  # share of spikes above which they are part of the motion

_MIN_STILL = 3  # smallest number of equal heights that may stand still
_MAX_STILL_SIDE = 8  # largest number of samples before, which show the motion
_STILL_STEPS = 10.0  # motion before [smallest step or noise]; 9 where a parabola turns

_MAX_BREAK = 1.0  # longest gap within a throw [s]
_MAX_BREAK_SAMPLES = 100.0  # longest gap within a throw [intervals between samples]

_KEPT_BEFORE = 0.25  # time kept before a throw among others [plate periods]
_KEPT_AFTER = 6.0  # time kept after the start of a throw [plate periods]
_SEEN_AFTER = 2.0  # shortest record after the start of the last throw [plate periods]
_REST = 0.5  # shortest rest of the plate between two throws [plate periods]
_SMOOTHING = 0.125  # window of the mean that shows rest [plate periods]

_FLIGHT_NOISE = 3.0  # residual of a parabola beyond which a flight is not free [noise]

_MIN_SIGNAL_TO_NOISE = 25.0  # smallest power of an oscillation over the noise at its frequency
_SEGMENT = 2**15  # samples of one spectrum
_MAX_EVEN_SAMPLES = 2**24  # largest number of evenly resampled heights for the period


class TrackError(ValueError):
    """A track is invalid; the message contains the position of the error."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """
    Measured heights of one body.

    Raise TrackError if the series do not fit, are shorter than `FEWEST`, are not finite, beyond
    `MAX_TIME` or `MAX_HEIGHT`, or do not increase.
    """

    time: Floats  # increasing times, shape (n,) [s]
    position: Floats  # heights, upwards from any zero, shape (n,) [m]
    known_noise: float | None = None  # standard deviation of the positions, estimated if None [m]
    stamp_error: float = 0.0  # standard deviation of the times [s]

    def __post_init__(self) -> None:
        time, position = (np.asarray(item, np.float64) for item in (self.time, self.position))
        if time.ndim != 1 or time.shape != position.shape or time.size < FEWEST:
            raise TrackError(
                f'a track is two series of the same length, at least {FEWEST}, '
                f'got shapes {time.shape} and {position.shape}'
            )
        for name, values, most in (('time', time, MAX_TIME), ('position', position, MAX_HEIGHT)):
            is_far = ~(np.abs(values) <= most)  # or not a number
            if is_far.any():
                raise TrackError(f'{name} must be within +- {most:g}, got {values[is_far][0]:g}')
        is_bad = np.diff(time) < MIN_STEP
        if is_bad.any():
            index = int(np.flatnonzero(is_bad)[0])
            raise TrackError(f'time must increase, got {time[index + 1]} after {time[index]}')
        object.__setattr__(self, 'time', time)
        object.__setattr__(self, 'position', position)

    @cached_property
    def noise(self) -> float:
        r"""
        Standard deviation of the positions, known or estimated [m].

        The estimate is that of the deviations from cubics through neighbours, to which a motion of
        n samples per period adds its amplitude times :math:`(2 \pi / n)^4 / \sqrt{70}`; without
        those at kinks and jumps, and without the half of the samples with the larger errors of
        times. It is at least the error of rounded heights, and never 0.
        """
        if self.known_noise:
            return self.known_noise
        deviation, spread = _beside_neighbours(self.time, self.position)
        stamp_noise = self._stamp_noise[2:-2]
        scatter = (deviation / spread)[2:-2][stamp_noise <= np.median(stamp_noise)]
        usual = 1.4826 * float(np.median(np.abs(scatter)))
        rms = float(np.sqrt(np.mean(scatter[np.abs(scatter) <= _NOISE_SIGMAS * usual] ** 2)))
        rounding = _smallest_step(self.position) / math.sqrt(12.0)
        return max(rms, rounding, 1e-9 * float(np.ptp(self.position)), 1e-15)

    @cached_property
    def deviations(self) -> Floats:
        """Standard deviation of each sample: its noise, and the error of its time [m]."""
        return np.asarray(np.hypot(self.noise, self._stamp_noise))

    @property
    def _stamp_noise(self) -> Floats:
        """Error of the times, times the speed of the smoothed track [m]."""
        smooth = uniform_filter1d(self.position, _SPEED_SAMPLES)
        return np.asarray(self.stamp_error * np.abs(np.gradient(smooth, self.time)))

    @property
    def interval(self) -> float:
        """Usual time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def is_stuck(self) -> Flags:
        """
        Return which samples repeat a height, not that at rest, while the body must move.

        As many samples before, it is farther away than where a motion turns.
        """
        height = self.position
        far = _STILL_STEPS * max(_smallest_step(height) or float(np.ptp(height)), self.noise)
        rest = float(np.median(height[:_MIN_STILL]))
        edges = np.flatnonzero(np.diff(height)) + 1
        flags = np.zeros(height.size, dtype=bool)
        for begin, end in pairwise([0, *edges.tolist(), height.size]):
            if end - begin >= _MIN_STILL and abs(height[begin] - rest) > far:
                side = min(end - begin, begin, _MAX_STILL_SIDE)
                flags[begin:end] = np.ptp(height[begin - side:begin + 1]) > far
        return flags

    def where(self, kept: Flags) -> Track:
        """Return some of the samples."""
        return replace(self, time=self.time[kept], position=self.position[kept])

    def between(self, start: float, end: float) -> Track:
        """Return the part from `start` to `end` [s], both included; refuse too few samples."""
        inside = (self.time >= start) & (self.time <= end)
        if inside.sum() < FEWEST:
            first, last = self.time[[0, -1]]
            raise TrackError(
                f'only {inside.sum()} samples from {start:g} s to {end:g} s, where at least '
                f'{FEWEST} are needed; the track goes from {first:g} s to {last:g} s'
            )
        return self.where(inside)

    def without_spikes(self) -> Track:
        """
        Remove single samples that jump, without a model of the motion.

        A spike deviates from the cubic through the two samples on either side by much more than
        the noise, and than the samples around. So motions with many such deviations remain.
        """
        deviation = np.abs(_beside_neighbours(self.time, self.position)[0])
        usual = np.maximum(self.noise, median_filter(deviation, _USUAL, mode='nearest'))
        usual = np.maximum(usual, _SPIKE_SHARE * float(np.ptp(self.position)))
        is_spike = (deviation > _SPIKE_LIMIT * usual) & (
            deviation >= maximum_filter1d(deviation, _SPEED_SAMPLES)
        )
        if self.time.size - is_spike.sum() < max(FEWEST, self.time.size * (1 - _MAX_SPIKE_SHARE)):
            return self
        return self.where(~is_spike) if is_spike.any() else self


@dataclass(frozen=True, kw_only=True)
class ThrowTracks:
    """Tracks of one throw; the name is for messages."""

    name: str
    plate: Track
    projectile: Track | None = None

    def between(self, start: float, end: float) -> ThrowTracks:
        """Return the part from `start` to `end` [s], in which the projectile may be missing."""
        projectile = None
        if self.projectile is not None:
            with contextlib.suppress(TrackError):
                projectile = self.projectile.between(start, end)
        return replace(self, plate=self.plate.between(start, end), projectile=projectile)

    def split(self, spans: Sequence[tuple[float, float]], word: str) -> list[ThrowTracks]:
        """Cut the record into spans [s], several ones with a number; whole without any."""
        parts = [self.between(*span) for span in spans] or [self]
        return parts if len(parts) == 1 else [
            replace(part, name=f'{part.name}, {word} {number}')
            for number, part in enumerate(parts, 1)
        ]

    def apply(self, change: Callable[[Track], Track]) -> ThrowTracks:
        """Change both tracks alike."""
        return replace(
            self, plate=change(self.plate), projectile=self.projectile and change(self.projectile)
        )


def _smallest_step(position: Floats) -> float:
    """Return the smallest step of rounded heights, 0 for a single height [m]."""
    steps = np.diff(np.unique(position))
    return float(min(steps[steps > _MIN_STEP * np.ptp(position)], default=0.0))


def _beside_neighbours(time: Floats, position: Floats) -> tuple[Floats, Floats]:
    """
    Subtract the cubic through two samples on either side from each; 0 at the ends.

    The second series is how noisy that is, over the noise of a single sample.
    """
    inner = np.arange(2, time.size - 2)
    difference, variance = position[inner], np.ones(inner.size)
    beside = [inner + offset for offset in (-2, -1, 1, 2)]
    for item in beside:  # Lagrange's polynomials
        shares = [(time[inner] - time[other]) / (time[item] - time[other])
                  for other in beside if other is not item]
        weight = np.prod(shares, axis=0)
        difference = difference - weight * position[item]
        variance = variance + weight**2
    return np.pad(difference, 2), np.pad(np.sqrt(variance), 2, constant_values=1.0)


def split_at_breaks(record: ThrowTracks) -> list[ThrowTracks]:
    """Cut a record where the plate was not seen for long, without pieces of too few samples."""
    time = record.plate.time
    longest = max(_MAX_BREAK, _MAX_BREAK_SAMPLES * record.plate.interval)
    pieces = np.split(time, np.flatnonzero(np.diff(time) > longest) + 1)
    spans = [(float(piece[0]), float(piece[-1])) for piece in pieces if piece.size >= FEWEST]
    return record.split(spans if len(pieces) > 1 else [], 'part')


def find_throws(plate: Track) -> list[tuple[float, float]]:
    """
    Find begin and end [s] of the throws in a record; none if the record is a single throw.

    A throw begins where the plate leaves its lowest position of rest. If the plate comes back to
    rest, a throw lasts from a quarter of a plate period before its start to at most six periods
    after, so the plate must not be put back earlier. Of several throws, the last one is dropped if
    the record ends within two periods after its start.
    """
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
    rest = float(np.min(0.5 * (low + high)[quiet], initial=math.inf))
    at_rest = quiet & (np.abs(position - rest) < tolerance)
    edges = np.diff(at_rest.astype(np.int8))
    returns = time[1:][edges == 1]
    lift = rest + 0.3 * (float(position.max()) - rest)
    starts = []
    for end in np.minimum(np.flatnonzero(edges == -1) + size // 2, time.size - 1).tolist():
        soon = (time >= time[end - size // 2]) & (time <= time[end] + period)
        if (position[soon] > lift).any():
            starts.append(float(time[end]))
    if len(starts) < 2 and not (starts and (returns > starts[0]).any()):
        return []
    if len(starts) > 1 and time[-1] < starts[-1] + _SEEN_AFTER * period:
        starts.pop()
    before, after = _KEPT_BEFORE * period, _KEPT_AFTER * period
    return [
        (start - before, min(start + after, limit - before))
        for start, limit in zip(starts, [*starts[1:], math.inf], strict=True)
    ]


def dominant_period(plate: Track) -> float:
    """Find the period of the strongest oscillation of the plate's velocity."""
    count = min(max(16, round(plate.duration / plate.interval) + 1), _MAX_EVEN_SAMPLES)
    even, step = np.linspace(plate.time[0], plate.time[-1], count, retstep=True)
    velocity = np.diff(np.interp(even, plate.time, plate.position)) / step
    frequency, _, powers = spectrogram(velocity, 1.0 / step, nperseg=min(velocity.size, _SEGMENT))
    noise = 8.0 / step * (plate.noise * np.sin(np.pi * step * frequency)) ** 2
    strength = powers.max(axis=1) - _MIN_SIGNAL_TO_NOISE * noise
    return 1.0 / float(frequency[max(1, int(np.argmax(strength)))])


def fall_acceleration(plate: Track, projectile: Track) -> float | None:
    """
    Return the acceleration of a freely falling projectile [m/s2], None if no flight is seen.

    It is positive downwards, and that of a parabola through the heights while they are farther
    from the plate than half of their largest distance.
    """
    rest = np.interp(projectile.time, plate.time, plate.position - plate.position[0])
    distance = projectile.position - projectile.position[0] - rest
    highest = int(np.argmax(distance))
    near = np.flatnonzero(distance < 0.5 * distance[highest])
    flight = slice(
        max(near[near < highest] + 1, default=0), min(near[near > highest], default=distance.size)
    )
    time, height = projectile.time[flight], projectile.position[flight]
    if time.size < FEWEST or distance[highest] < 2.0 * float(np.ptp(plate.position)):
        return None
    parabola = np.polynomial.Polynomial.fit(time, height, 2)
    is_free = np.std(height - parabola(time)) <= _FLIGHT_NOISE * projectile.noise
    return -float(parabola.deriv(2)(time[0])) if is_free else None
