# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Measured positions of plate and projectile, kept for some seconds and cut into throws."""

from __future__ import annotations

from collections import deque
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.identification.tracks import ThrowTracks, Track, TrackError
from soft_throw_ros.nodes.measured import MAX_DATA_RATE, MAX_MESSAGE_SIZE
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.storage.cdr import JointStateReader, MessageError
from soft_throw_ros.storage.message import SECOND

Floats = NDArray[np.float64]

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
        self._joints = joints
        self._log = node.get_logger()
        topic = TWIN_TOPICS.measured_joint_states.at(twin)
        self._subscription = RawSubscription.of(node, topic)
        node.add_cleanup(self._subscription.close)
        self._read = JointStateReader().read_all
        self.clock_offset_ns = 0
        self._batches: deque[tuple[NDArray[np.int64], Floats]] = deque(maxlen=_KEPT_READS)

    @property
    def newest_ns(self) -> float:
        """Time of the newest measurement, minus infinity without one [ns]."""
        return self._batches[-1][0][-1] + self.clock_offset_ns if self._batches else -math.inf

    def read_messages(self) -> None:
        """Read the messages that have arrived; call this every `READ_PERIOD`."""
        messages = self._subscription.drain(READ_PERIOD * MAX_DATA_RATE)
        datas = [item.data for item in messages if len(item.data) <= MAX_MESSAGE_SIZE]
        if not datas:
            return
        try:
            states = self._read(datas)
            columns = [states.names.index(joint) for joint in self._joints]
        except (MessageError, ValueError) as error:
            self._log.warning(
                f'{len(datas)} messages have no positions of joint_names.*, which are '
                f'{self._joints}: {error}',
                throttle_duration_sec=1.0,
            )
            return
        if self._batches and states.stamps[-1] < self._batches[-1][0][-1] - _SET_BACK:
            self._batches.clear()
        self._batches.append((states.stamps, states.position[:, columns]))

    def between(self, start_ns: int, end_ns: int, name: str = '') -> ThrowTracks:
        """Return the tracks of a throw, over the time since `start_ns`, or raise TrackError."""
        start_ns, end_ns = start_ns - self.clock_offset_ns, end_ns - self.clock_offset_ns
        if not self._batches or self._batches[0][0][0] > start_ns:
            raise TrackError('measurements of its start were not received')
        stamps, positions = map(np.concatenate, zip(*self._batches, strict=True))
        stamps, order = np.unique(stamps, return_index=True)
        inside = (stamps >= start_ns) & (stamps <= end_ns)
        time = 1e-9 * (stamps[inside] - start_ns)
        plate, projectile = (
            Track(time=time, position=column) for column in positions[order][inside].T
        )
        return ThrowTracks(name=name, plate=plate, projectile=projectile)
