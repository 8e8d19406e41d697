# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Samples of a rig as they arrive, in the order of their stamps.

Samples older than the newest stamp by more than `measured.latency` (the watermark) are complete.
Then outliers among them are removed, see `OutlierFilter`. Samples that arrive for a complete time
are late, and are refused.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.kernels import kernel
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.storage.message import SECOND

Floats = NDArray[np.float64]

LONG_AGO = np.iinfo(np.int64).min // 2
"""Stamp before all stamps, whose differences from them have 8 bytes, too. [ns]"""

FUTURE = SECOND // 10
"""Largest accepted lead of a stamp over the clock. [ns]"""

PAST = SECOND
"""Largest accepted age of a stamp by the clock. [ns]"""

FARTHEST = 100.0
"""Largest accepted magnitude of a height; every real rig stays below. [m]"""

FEWEST = 4
"""Fewest samples that give a rate, a rest or a start. [-]"""

REST_WINDOWS = 8
"""Shortest rest of the plate before a throw, in smoothing windows. [-]"""

_MEDIAN = NormalDist().inv_cdf(0.75)
"""Median of the magnitude of standard normal numbers. [-]"""

OUTLIER_SIGMAS = 6.0
"""Standard errors beyond which a sample is an outlier; noise is so far off once in 5e8. [-]"""

MAX_OUTLIERS_IN_A_ROW = 3
"""Outliers in a row that show that the expectation is wrong, and not the samples. [-]"""

_TRACKING = 1.05
"""Correction factor of the running median of the deviations, per sample. [-]"""

_BODY = np.dtype(
    [
        ('stamp', 'i8'),  # of the last height [ns]
        ('state', 'f8', (2,)),  # height [m] and velocity [m/s] then
        ('covariance', 'f8', (2, 2)),
        ('median', 'f8'),  # running median of deviations over standard errors [-]
        ('in_a_row', 'i8'),  # outliers since the last accepted height
    ],
    align=True,
)

_UNKNOWN = np.zeros(2, _BODY)  # plate and projectile, whose first heights are accepted
_UNKNOWN['state'][:, 0], _UNKNOWN['median'] = np.inf, _MEDIAN
_UNKNOWN['in_a_row'] = MAX_OUTLIERS_IN_A_ROW


@dataclass(slots=True)
class Samples:
    """Heights measured at the times of their stamps."""

    stamps: NDArray[np.int64]  # shape (n,) [ns]
    heights: Floats  # of plate and projectile, NaN if not measured, shape (n, 2) [m]

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, chosen: slice | NDArray[np.bool_ | np.int64]) -> Samples:
        return Samples(self.stamps[chosen], self.heights[chosen])

    @property
    def plate(self) -> Floats:
        """Heights of the plate [m]."""
        return self.heights[:, 0]

    @property
    def projectile(self) -> Floats:
        """Heights of the projectile [m]."""
        return self.heights[:, 1]

    def seconds_since(self, origin_ns: int) -> Floats:
        """Return the times since another time [s]."""
        since: Floats = (self.stamps - origin_ns) / SECOND
        return since


class RestBaseline(NamedTuple):
    """Heights of plate and projectile at rest before a throw."""

    plate: float  # mean heights; that of the projectile is NaN if it was not measured [m]
    projectile: float
    noise: float  # standard deviation of the plate's samples [m]
    error: float  # standard error of its mean [m]


@dataclass(frozen=True, kw_only=True)
class Onset:
    """The start of the plate's motion, and so of a throw."""

    onset_ns: int  # time of the start [ns]
    rest: RestBaseline
    samples: Samples  # sorted, from a window before the start on
    clock_offset_ns: int = 0  # what was added to the stamps of the samples [ns]


@dataclass
class SampleCounts:
    """Numbers of accepted samples, late and outlying ones included, and refusals by reason."""

    taken: int = 0
    out_of_order: int = 0
    outliers: int = 0
    refused: Counter[str] = field(default_factory=Counter)  # by reason


class SampleBuffer:
    """The accepted samples of the recent past, sorted by stamp; it updates the `counts`."""

    def __init__(
        self, config: MeasurementConfig, counts: SampleCounts, samples: Samples | None = None
    ) -> None:
        self.config = config
        self.counts = counts
        self.samples = samples or Samples(np.empty(0, np.int64), np.empty((0, 2)))
        self.newest_ns = int(samples.stamps[-1]) if samples else LONG_AGO  # newest stamp [ns]
        self.complete_ns = LONG_AGO  # time until which samples are complete [ns]
        self.gap = 0.0  # longest time between samples up to those that are complete last [s]
        self.outliers = 0  # accepted samples that were left out later
        self._outlier_filter = OutlierFilter(
            config.plate, config.position_noise, config.stamp_error
        )

    def _index(self, stamp_ns: int) -> int:
        """Return the index of the first sample that is not older than a stamp."""
        return int(self.samples.stamps.searchsorted(stamp_ns))

    def between(self, begin_ns: int, end_ns: int | None = None) -> Samples:
        """Return the samples from one time to before another."""
        end = None if end_ns is None else self._index(end_ns)
        return self.samples[self._index(begin_ns):end]

    def rate(self) -> float:
        """Return the rate of the samples, 0 if there are too few [Hz]."""
        if len(self.samples) < FEWEST:
            return 0.0
        intervals = self.samples.stamps[1:] - self.samples.stamps[:-1]
        intervals.sort()
        return SECOND / float(intervals[intervals.size // 2])

    def add(self, samples: Samples, now_ns: int) -> Samples:
        """Add samples in their order of arrival, count refused ones, and return the added ones."""
        counts, stored, added, in_order = self.counts, self.samples, dict[int, int](), True
        rows = zip(samples.stamps.tolist(), *samples.heights.T.tolist(), strict=True)
        for index, (stamp_ns, plate, projectile) in enumerate(rows):
            is_old = stamp_ns <= self.newest_ns
            if not math.isfinite(plate) or math.isinf(projectile):
                reason = 'not finite'
            elif abs(plate) > FARTHEST or abs(projectile) > FARTHEST:
                reason = 'out of range'
            elif stamp_ns > now_ns + FUTURE:
                reason = 'future'
            elif stamp_ns < now_ns - PAST:
                reason = 'past'
            elif is_old and (stamp_ns in added or stamp_ns in stored.stamps):
                reason = 'doubled'
            elif stamp_ns <= self.complete_ns:
                reason = 'late'
            else:
                added[stamp_ns] = index
                in_order &= not is_old
                counts.out_of_order += is_old
                self.newest_ns = max(stamp_ns, self.newest_ns)
                continue
            counts.refused[reason] += 1
        if len(added) < len(samples):
            samples = samples[np.array([*added.values()], np.int64)]
        counts.taken += len(samples)
        self.samples = Samples(
            np.concatenate((stored.stamps, samples.stamps)),
            np.concatenate((stored.heights, samples.heights)),
        )
        if not in_order:
            self.samples = self.samples[self.samples.stamps.argsort(kind='stable')]
        return samples

    def complete(self, now_ns: int) -> Samples:
        """Return the samples that are complete now, without outliers, and drop old samples."""
        until_ns = min(self.newest_ns, now_ns) - self.config.latency_ns
        first, last = self._index(self.complete_ns + 1), self._index(until_ns + 1)
        self.complete_ns = max(self.complete_ns, until_ns)
        self.gap = 0.0
        new = self.samples[first:last]
        if not new:
            return new
        is_outlier = self._outlier_filter.find(new.stamps, new.heights)
        if np.count_nonzero(is_outlier):
            outliers = int(is_outlier.any(axis=1).sum())
            self.outliers += outliers
            self.counts.outliers += outliers
            new.projectile[is_outlier[:, 1]] = math.nan
            is_kept = np.ones(len(self.samples), np.bool_)
            is_kept[first:last] = ~is_outlier[:, 0]
            self.samples, new = self.samples[is_kept], new[is_kept[first:last]]
        stamps = self.samples.stamps[max(first - 1, 0):first + len(new)]
        self.gap = float((stamps[1:] - stamps[:-1]).max(initial=0)) / SECOND
        kept_ns = 2 * REST_WINDOWS * self.config.smoothing_window_ns  # the rest and a start
        self.samples = self.between(self.complete_ns - kept_ns)
        return new


class OutlierFilter:
    """
    A Kalman filter of height and velocity of plate and projectile, which finds outliers.

    Between two samples a body has an unknown constant acceleration, whose standard deviation is
    half of the engine's. A height that is `OUTLIER_SIGMAS` standard errors off is an outlier; the
    last of `MAX_OUTLIERS_IN_A_ROW` is accepted, because the body or the zero of its sensor has
    moved. Standard errors are from the `noise` [m] and the `stamp_error` [s], which displaces a
    moving body, or from recent deviations if these are larger.
    """

    def __init__(self, plate: Underdamped, noise: float, stamp_error: float) -> None:
        acceleration = 0.5 * plate.amplitude * plate.angular_frequency**2
        self._parameters = acceleration, plate.peak_velocity, noise, stamp_error
        self._bodies = _UNKNOWN.copy()

    def find(self, stamps: NDArray[np.int64], heights: Floats) -> NDArray[np.bool_]:
        """Return which of the following heights are outliers, shape (n, 2); NaN is none."""
        is_outlier = np.zeros(heights.shape, dtype=np.bool_)
        _find(self._bodies, stamps, heights, *self._parameters, is_outlier)
        return is_outlier


@kernel
def _find(
    bodies: NDArray[np.void], stamps: NDArray[np.int64], heights: Floats, acceleration: float,
    speed: float, noise: float, stamp_error: float, is_outlier: NDArray[np.bool_],
) -> None:
    """Test heights in order."""
    for body in range(bodies.size):
        s = bodies[body]
        x, p = s.state, s.covariance
        for n in range(stamps.size):
            height, h = heights[n, body], (stamps[n] - s.stamp) / SECOND
            if np.isnan(height):
                continue
            s.stamp = stamps[n]
            x[0] += h * x[1]
            p[0, 0] += h * (2.0 * p[0, 1] + h * p[1, 1]) + (0.5 * acceleration * h * h) ** 2
            p[0, 1] += h * p[1, 1] + 0.5 * (acceleration * h) ** 2 * h
            p[1, 1] += (acceleration * h) ** 2
            variance = noise**2 + (x[1] * stamp_error) ** 2
            error = height - x[0]
            deviation = abs(error) / np.sqrt(p[0, 0] + variance)
            is_far = deviation > OUTLIER_SIGMAS / _MEDIAN * s.median
            s.median *= _TRACKING if deviation > s.median else 1.0 / _TRACKING
            s.median = max(s.median, _MEDIAN)
            s.in_a_row = s.in_a_row + 1 if is_far else 0
            if 0 < s.in_a_row < MAX_OUTLIERS_IN_A_ROW:
                is_outlier[n, body] = True
                continue
            if s.in_a_row:  # begin again
                s.in_a_row = 0
                x[0], x[1] = height, 0.0
                p[0, 0], p[0, 1], p[1, 1] = variance, 0.0, speed**2
                continue
            total = p[0, 0] + variance
            gain0, gain1 = p[0, 0] / total, p[0, 1] / total
            x[0] += gain0 * error
            x[1] += gain1 * error
            p[1, 1] -= gain1 * p[0, 1]
            p[0, 1] -= gain0 * p[0, 1]
            p[0, 0] -= gain0 * p[0, 0]


def warm_up() -> None:
    """Compile the kernel, or load it from the cache on disk."""
    plate = Underdamped(amplitude=1.0, frequency=1.0, damping_ratio=0.1)
    OutlierFilter(plate, 1.0, 0.0).find(np.arange(4), np.zeros((4, 2)))
