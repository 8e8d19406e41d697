# SPDX-License-Identifier: Apache-2.0
"""A long record cut into its throws."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import spectrogram
from soft_throw_ros.identification.tracks import ThrowTracks, Track

# In plate periods:
_KEPT_BEFORE = 0.25  # of a throw among others, and ...
_KEPT_AFTER = 6.0  # of its start
_SEEN_AFTER = 2.0  # the start of the last one of several throws that must be seen
_REST = 0.5  # that the plate rests between two throws at least
_SMOOTHING = 0.125  # that are averaged over to see where it rests

_ABOVE_NOISE = 25.0  # how often as strong as noise, at its frequency, an oscillation is at least
_SEGMENT = 2**15  # samples of one spectrum


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
    period = _dominant_period(plate)
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


def _dominant_period(plate: Track) -> float:
    """Find the period of the strongest oscillation of the plate's velocity."""
    count = max(16, round(plate.duration / plate.interval) + 1)
    even, step = np.linspace(plate.time[0], plate.time[-1], count, retstep=True)
    velocity = np.diff(np.interp(even, plate.time, plate.position)) / step
    frequency, _, powers = spectrogram(velocity, 1.0 / step, nperseg=min(velocity.size, _SEGMENT))
    noise = 8.0 / step * (plate.noise * np.sin(np.pi * step * frequency)) ** 2
    strength = powers.max(axis=1) - _ABOVE_NOISE * noise
    return 1.0 / float(frequency[max(1, int(np.argmax(strength)))])
