# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Samples of a rig as they arrive, in the order of their stamps.

Samples older than the newest stamp by more than `measured.latency` (the watermark) are complete.
Then outliers among them are removed, see `outlier_filter`. Samples that arrive for a complete time
are late, and are refused.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.kernels import kernel
from soft_throw_ros.twin.outlier_filter import OutlierFilter
from soft_throw_ros.twin.tick_schedule import SECOND

Floats = NDArray[np.float64]

LONG_AGO = -(2**62)
"""Stamp before all stamps. [ns]"""

REASONS = ('not finite', 'out of range', 'future', 'past', 'doubled', 'late')
"""Why a sample is refused."""

FUTURE = SECOND // 10
"""Largest accepted lead of a stamp over the clock. [ns]"""

PAST = SECOND
"""Largest accepted age of a stamp by the clock. [ns]"""

FARTHEST = 100.0
"""Largest accepted magnitude of a height; every real rig stays below. [m]"""

FEWEST = 4
"""Fewest samples that give a rate, a rest or a start. [-]"""

_KEPT_WINDOWS = 16
"""Length of the stored record in smoothing windows: the rest, the start and a reserve. [-]"""


class Sample(NamedTuple):
    """Heights measured at one time."""

    stamp_ns: int  # time of the measurement [ns]
    plate: float  # height [m]
    projectile: float = math.nan  # height, NaN if not measured [m]


@dataclass(slots=True)
class Samples:
    """Many samples in arrays."""

    stamps: NDArray[np.int64]  # shape (n,) [ns]
    heights: Floats  # of plate and projectile, shape (n, 2) [m]

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> Samples:
        """Put samples into arrays."""
        stamps = np.array([sample.stamp_ns for sample in samples], np.int64)
        heights = np.array([sample[1:] for sample in samples], np.float64)
        return cls(stamps, heights.reshape(-1, 2))

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
        """Heights of the projectile, NaN where it was not measured [m]."""
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
    refused: Counter[str] = field(default_factory=Counter)  # by `REASONS` and those of messages


class SampleBuffer:
    """
    The accepted samples of the recent past, sorted by stamp.

    The buffer updates the `counts`. It may begin with sorted `samples` that have been accepted.
    """

    def __init__(
        self, config: MeasurementConfig, counts: SampleCounts, samples: Samples | None = None
    ) -> None:
        self.config = config
        self.counts = counts
        self.samples = samples or Samples.of([])  # all of them; a change makes other arrays
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
        return SECOND / float(np.median(np.diff(self.samples.stamps)))

    def missing_since(self, begin_ns: int) -> int:
        """Count the samples that are missing since a time, compared with an even rate."""
        intervals = np.diff(self.between(begin_ns).stamps)
        if len(intervals) < FEWEST:
            return 0
        return int((np.rint(intervals / np.median(intervals)) - 1.0).clip(0.0).sum())

    def add(self, samples: Samples, now_ns: int) -> Samples:
        """Add samples in their order of arrival, count refused ones, and return the added ones."""
        counts, stored, refusals = self.counts, self.samples, np.zeros(len(samples), np.int64)
        late, self.newest_ns = _check(
            samples.stamps, samples.heights, stored.stamps, now_ns, self.newest_ns,
            self.complete_ns, refusals,
        )
        counts.out_of_order += late
        if refusals.any():
            counts.refused.update(REASONS[number - 1] for number in refusals[refusals > 0])
            samples = samples[refusals == 0]
        counts.taken += len(samples)
        self.samples = Samples(
            np.concatenate((stored.stamps, samples.stamps)),
            np.concatenate((stored.heights, samples.heights)),
        )
        if late:
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
        if is_outlier.any():
            outliers = int(is_outlier.any(axis=1).sum())
            self.outliers += outliers
            self.counts.outliers += outliers
            new.projectile[is_outlier[:, 1]] = math.nan
            is_kept = np.ones(len(self.samples), np.bool_)
            is_kept[first:last] = ~is_outlier[:, 0]
            self.samples, new = self.samples[is_kept], new[is_kept[first:last]]
        stamps = self.samples.stamps[max(first - 1, 0):first + len(new)]
        self.gap = float((stamps[1:] - stamps[:-1]).max(initial=0)) / SECOND
        kept_ns = _KEPT_WINDOWS * self.config.smoothing_window_ns
        self.samples = self.between(self.complete_ns - kept_ns)
        return new


@kernel
def _check(
    stamps: NDArray[np.int64],
    heights: Floats,
    known: NDArray[np.int64],
    now_ns: int,
    newest_ns: int,
    complete_ns: int,
    refusals: NDArray[np.int64],
) -> tuple[int, int]:
    """
    Write the numbers of the `REASONS` of refused samples, from 1.

    Return the number of others that are out of order, and the newest stamp.
    """
    late = 0
    for n in range(stamps.size):
        stamp, plate, projectile = stamps[n], heights[n, 0], heights[n, 1]
        index = np.searchsorted(known, stamp)
        is_doubled = index < known.size and known[index] == stamp
        for m in range(n):
            is_doubled |= refusals[m] == 0 and stamps[m] == stamp
        if not math.isfinite(plate) or math.isinf(projectile):
            refusals[n] = 1
        elif abs(plate) > FARTHEST or abs(projectile) > FARTHEST:
            refusals[n] = 2
        elif stamp > now_ns + FUTURE:
            refusals[n] = 3
        elif stamp < now_ns - PAST:
            refusals[n] = 4
        elif is_doubled:
            refusals[n] = 5
        elif stamp <= complete_ns:
            refusals[n] = 6
        else:
            late += stamp < newest_ns
            newest_ns = max(stamp, newest_ns)
    return late, newest_ns


def warm_up() -> None:
    """Compile or load the kernels."""
    samples = Samples.of([])
    _check(samples.stamps, samples.heights, samples.stamps, 0, 0, 0, samples.stamps)
