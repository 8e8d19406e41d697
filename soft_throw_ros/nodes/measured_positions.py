# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Measured positions of plate and projectile, kept for some seconds and cut into throws."""

from __future__ import annotations

from collections import Counter, deque
import math

import numpy as np
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.identification.tracks import ThrowTracks, Track, TrackError
from soft_throw_ros.nodes.measured import HeightReader, MAX_DATA_RATE
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.sample_buffer import Samples

READ_PERIOD = 0.02
"""Time between two reads. [s]"""

_KEPT_READS = 500  # number of reads whose measurements are kept, ten seconds
_SET_BACK = SECOND  # smallest step backwards of the stamps when their clock is set [ns]


class MeasuredPositions:
    """
    The measured positions of plate and projectile in the last seconds, by the clock of a twin.

    `joints` are their names. The attribute `clock_offset_ns` is added to the stamps [ns].
    """

    def __init__(self, node: RunnableNode, twin: str, joints: tuple[str, str]) -> None:
        topic = TWIN_TOPICS.measured_joint_states.at(twin)
        self._reader = HeightReader(node, topic, joints, Counter())
        self.clock_offset_ns = 0
        self._batches: deque[Samples] = deque(maxlen=_KEPT_READS)

    @property
    def newest_ns(self) -> float:
        """Time of the newest measurement, minus infinity without one [ns]."""
        return self._batches[-1].stamps[-1] + self.clock_offset_ns if self._batches else -math.inf

    def read_messages(self) -> None:
        """Read the messages that have arrived; call this every `READ_PERIOD`."""
        for samples in self._reader.read(READ_PERIOD * MAX_DATA_RATE):
            if self._batches and samples.stamps[-1] < self._batches[-1].stamps[-1] - _SET_BACK:
                self._batches.clear()
            self._batches.append(samples)

    def between(
        self, start_ns: int, end_ns: int, name: str = '', *, max_gap: float = math.inf
    ) -> ThrowTracks:
        """
        Return the tracks of a throw, over the time since `start_ns`.

        Raise TrackError if they are too short, or have no samples for longer than `max_gap` [s].
        """
        start_ns, end_ns = start_ns - self.clock_offset_ns, end_ns - self.clock_offset_ns
        if not self._batches or self._batches[0].stamps[0] > start_ns:
            raise TrackError('measurements of its start were not received')
        stamps, order = np.unique(
            np.concatenate([samples.stamps for samples in self._batches]), return_index=True
        )
        inside = (stamps >= start_ns) & (stamps <= end_ns)
        time = 1e-9 * (stamps[inside] - start_ns)
        gap = np.diff(time, prepend=0.0, append=1e-9 * (end_ns - start_ns)).max()
        if gap > max_gap:
            raise TrackError(f'no samples for {1e3 * gap:.3g} ms')
        heights = np.concatenate([samples.heights for samples in self._batches])[order][inside]
        plate, projectile = (
            Track(time=time[is_measured], position=column[is_measured])
            for column, is_measured in zip(heights.T, np.isfinite(heights).T, strict=True)
        )
        return ThrowTracks(name=name, plate=plate, projectile=projectile)
