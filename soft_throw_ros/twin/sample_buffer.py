# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Samples of a rig in the order of their stamps."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.twin.tick_schedule import SECOND

Rows: TypeAlias = NDArray[np.void]
"""Samples as a structured array, see `SAMPLE`."""

_CAPACITY = 256
"""Capacity of a new buffer in samples; a full buffer doubles its capacity. [-]"""

_FARTHEST_NS = 2**62
"""Stamp beyond all stamps. [ns]"""


class Sample(NamedTuple):
    """Heights measured at one time."""

    stamp_ns: int  # time of the measurement [ns]
    plate: float  # height [m]
    projectile: float = math.nan  # height, NaN if not measured [m]


SAMPLE = np.dtype([('stamp_ns', 'i8'), *((name, 'f8') for name in Sample._fields[1:])])
"""Record of a `Sample` in arrays."""


class SampleBuffer:
    """
    A queue of samples sorted by stamp, in one structured array.

    Appending, dropping the oldest and reading a span cost the same however many samples there
    are. Inserting between others moves the later ones.
    """

    def __init__(self, samples: Sequence[Sample] = ()) -> None:
        self._memory = np.zeros(max(_CAPACITY, 2 * len(samples)), SAMPLE)
        self._begin, self._end = 0, len(samples)
        self._memory[: self._end] = np.array(list(samples), SAMPLE)

    def __len__(self) -> int:
        """Return the number of samples."""
        return self._end - self._begin

    @property
    def rows(self) -> Rows:
        """All samples, valid until the next change."""
        return self._memory[self._begin: self._end]

    def index(self, stamp_ns: float) -> int:
        """Return the index of the first sample that is not older than a stamp."""
        stamp = math.ceil(max(min(stamp_ns, _FARTHEST_NS), -_FARTHEST_NS))
        return int(self.rows['stamp_ns'].searchsorted(stamp))

    def between(self, begin_ns: float, end_ns: float = math.inf) -> Rows:
        """Return the samples from one time to before another, valid until the next change."""
        return self.rows[self.index(begin_ns): self.index(end_ns)]

    def insert(self, sample: Sample) -> None:
        """Insert a sample in its place."""
        if self._end == len(self._memory):
            self._make_room()
        index = self.index(sample.stamp_ns)
        rows = self._memory[self._begin: self._end + 1]
        if index < len(self):
            rows[index + 1:] = rows[index:-1].copy()
        rows[index] = sample
        self._end += 1

    def remove(self, first: int, is_removed: NDArray[np.bool_]) -> None:
        """Remove the marked ones of the samples from an index on."""
        last = first + len(is_removed)
        kept = np.concatenate((self.rows[first:last][~is_removed], self.rows[last:]))
        self._end = self._begin + first + len(kept)
        self._memory[self._begin + first: self._end] = kept

    def drop_before(self, stamp_ns: float) -> None:
        """Drop the samples that are older than a stamp."""
        self._begin += self.index(stamp_ns)

    def _make_room(self) -> None:
        """Move the samples to the start of the memory, or of a larger one if it is half full."""
        rows = self.rows.copy()
        if 2 * len(rows) > len(self._memory):
            self._memory = np.zeros(2 * len(self._memory), SAMPLE)
        self._begin, self._end = 0, len(rows)
        self._memory[: self._end] = rows


def to_samples(rows: Rows) -> list[Sample]:
    """Return rows of a buffer one by one."""
    return [Sample(*row) for row in rows.tolist()]


def seconds_since(origin_ns: int, rows: Rows) -> NDArray[np.float64]:
    """Return the times of samples since a time [s]."""
    since: NDArray[np.float64] = (rows['stamp_ns'] - origin_ns) / SECOND
    return since
