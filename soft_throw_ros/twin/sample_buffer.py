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

    def __getitem__(self, chosen: slice | NDArray[np.bool_ | np.int64]) -> Samples:
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
    """A queue of samples sorted by stamp."""

    def __init__(self, samples: Samples) -> None:
        self.samples = Samples.of([])  # all samples; a change makes other arrays
        self.add(samples)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    def index(self, stamp_ns: int) -> int:
        """Return the index of the first sample that is not older than a stamp."""
        return int(self.samples.stamps.searchsorted(stamp_ns))

    def between(self, begin_ns: int, end_ns: int | None = None) -> Samples:
        """Return the samples from one time to before another."""
        end = None if end_ns is None else self.index(end_ns)
        return self.samples[self.index(begin_ns):end]

    def add(self, samples: Samples) -> None:
        """Add samples in their places."""
        first, stored = len(self) - 1, self.samples
        stamps = np.concatenate((stored.stamps, samples.stamps))
        self.samples = Samples(stamps, np.concatenate((stored.heights, samples.heights)))
        new = stamps[max(first, 0):]
        if (new[1:] < new[:-1]).any():
            self.samples = self.samples[stamps.argsort(kind='stable')]

    def remove(self, first: int, is_removed: NDArray[np.bool_]) -> None:
        """Remove the marked ones of the samples from an index on."""
        is_kept = np.ones(len(self), np.bool_)
        is_kept[first:first + len(is_removed)] = ~is_removed
        self.samples = self.samples[is_kept]

    def drop_before(self, stamp_ns: int) -> None:
        """Drop the samples that are older than a stamp."""
        self.samples = self.samples[self.index(stamp_ns):]
