# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Samples of a rig in the order of their stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.twin.tick_schedule import SECOND

Floats = NDArray[np.float64]

LONG_AGO = -(2**62)
"""Stamp before all stamps. [ns]"""

_CAPACITY = 256
"""Least capacity of a buffer in samples. [-]"""


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
        """Return the number of samples."""
        return len(self.stamps)

    def __getitem__(self, chosen: slice | NDArray[np.bool_]) -> Samples:
        """Return some of the samples."""
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


class SampleBuffer:
    """
    A queue of samples sorted by stamp.

    Appending, dropping the oldest and reading a span cost the same however many samples there
    are. Inserting between others sorts all.
    """

    def __init__(self, samples: Samples) -> None:
        self._memory = _allocate(2 * len(samples))
        self._begin, self._end = 0, 0
        self.add(samples)

    def __len__(self) -> int:
        """Return the number of samples."""
        return self._end - self._begin

    @property
    def samples(self) -> Samples:
        """All samples, valid until the next change."""
        return self._memory[self._begin:self._end]

    def index(self, stamp_ns: int) -> int:
        """Return the index of the first sample that is not older than a stamp."""
        return int(self._memory.stamps[self._begin:self._end].searchsorted(stamp_ns))

    def between(self, begin_ns: int, end_ns: int | None = None) -> Samples:
        """Return the samples from one time to before another, valid until the next change."""
        end = None if end_ns is None else self.index(end_ns)
        return self.samples[self.index(begin_ns):end]

    def add(self, samples: Samples) -> None:
        """Add samples in their places."""
        if self._end + len(samples) > len(self._memory):
            kept, self._memory = self.samples, _allocate(2 * (len(self) + len(samples)))
            self._begin = self._end = 0
            self.add(kept)
        stamps, heights = self._memory.stamps, self._memory.heights
        first, self._end = self._end, self._end + len(samples)
        stamps[first:self._end], heights[first:self._end] = samples.stamps, samples.heights
        new = stamps[max(first - 1, self._begin):self._end]
        if (new[1:] < new[:-1]).any():
            held = slice(self._begin, self._end)
            order = stamps[held].argsort(kind='stable')
            stamps[held], heights[held] = stamps[held][order], heights[held][order]

    def remove(self, first: int, is_removed: NDArray[np.bool_]) -> None:
        """Remove the marked ones of the samples from an index on."""
        is_kept = np.ones(len(self), np.bool_)
        is_kept[first:first + len(is_removed)] = ~is_removed
        kept, self._end = self.samples[is_kept], self._begin
        self.add(kept)

    def drop_before(self, stamp_ns: int) -> None:
        """Drop the samples that are older than a stamp."""
        self._begin += self.index(stamp_ns)


def _allocate(count: int) -> Samples:
    count = max(count, _CAPACITY)
    return Samples(np.zeros(count, np.int64), np.zeros((count, 2)))
