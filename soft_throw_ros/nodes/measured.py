# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of a rig, read from their topic by the tick thread before every step.

There are thousands of messages per second; draining the queue costs a tenth of an executor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from soft_throw_ros.configuration.interface import Topic, TWIN_TOPICS
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.raw_subscriptions import subscribe
from soft_throw_ros.storage.cdr import JointStateReader, JointStates, MessageError
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.sample_buffer import Samples
from soft_throw_ros.twin.session import Session

MAX_MESSAGE_SIZE = 2**14  # that is decoded, 500 joints: larger ones hold up a tick [bytes]
MAX_DATA_RATE = 16e6  # about 100,000 samples per second, which bounds a tick [bytes/s]
TOLERATED = SECOND // 200  # transport time and difference of synchronized clocks, at most [ns]
_FIRST = SECOND // 5  # duration of the first observation of stamps [ns]
_LATER = 2 * SECOND  # duration of later observations of stamps [ns]
_FEWEST = 50  # samples that an observation needs [-]


class HeightReader:
    """
    A subscription to joint states, which reads the heights of plate and projectile, its `joints`.

    A message that is damaged, lacks the plate, or is larger than `MAX_MESSAGE_SIZE` is counted in
    `refused` as 'unreadable', 'names' or 'too large'.
    """

    def __init__(
        self, node: RunnableNode, topic: Topic, joints: tuple[str, str], refused: Counter[str]
    ) -> None:
        self.subscription = subscribe(node, topic)
        node.add_cleanup(self.subscription.close)
        self._joints = joints
        self._refused = refused
        self._logger = node.get_logger()
        self._reader = JointStateReader()

    def read(self, max_size: float) -> list[Samples]:
        """Return the heights in the messages that have arrived, up to a total size [bytes]."""
        datas = [message.data for message in self.subscription.drain(max_size)]
        small = [data for data in datas if len(data) <= MAX_MESSAGE_SIZE]
        if len(small) < len(datas):
            self._refused['too large'] += len(datas) - len(small)
        return self._decode(small) if small else []

    def _decode(self, datas: list[bytes]) -> list[Samples]:
        """Decode messages, all alike at once; refuse and count those that are not valid."""
        try:
            values = self._reader.read_all(datas)
        except MessageError:
            if len(datas) > 1:
                return [samples for data in datas for samples in self._decode([data])]
            self._refused['unreadable'] += 1
            return []
        samples = to_samples(values, self._joints)
        if samples is not None:
            return [samples]
        self._refused['names'] += len(datas)
        self._logger.warning(
            f'measured messages have the joints {list(values.names)!r:.200}, and the heights of '
            f'joint_names.plate {self._joints[0]!r} are missing',
            once=True,
        )
        return []


class SensorClock:
    """
    An estimator of a constant offset of stamps.

    The offset is the smallest delay of a message, because the transport time of the fastest
    message cannot be distinguished from an offset. Offsets up to `TOLERATED` are not corrected.
    """

    def __init__(self) -> None:
        self.offset_ns = 0  # correction to be added to stamps [ns]
        self.problem = ''  # a sentence on the fault of the stamps and its correction, if any
        self._stamps: list[int] = []  # of this observation [ns]
        self._begin_ns = self._least_ns = 0  # start of the observation, and smallest delay [ns]
        self._watching_ns = _FIRST

    def observe(self, stamps: Sequence[int], now_ns: int) -> bool:
        """Observe stamps that have just arrived; return whether `problem` has changed."""
        delay_ns = now_ns - max(stamps)
        if not self._stamps:
            self._begin_ns, self._least_ns = now_ns, delay_ns
        self._least_ns = min(self._least_ns, delay_ns)
        self._stamps += stamps
        if len(self._stamps) < _FEWEST or now_ns - self._begin_ns < self._watching_ns:
            return False
        before = self.problem
        self._estimate()
        self._stamps, self._watching_ns = [], _LATER
        return self.problem != before

    def _estimate(self) -> None:
        """Use the smallest delay as offset, if it exceeds the transport time."""
        least_ns = self._least_ns
        if not any(stamp_ns % SECOND for stamp_ns in self._stamps):
            stamp = 'of whole seconds' if any(self._stamps) else '0'
            self.offset_ns = 0
            self.problem = f'header.stamp of the samples is {stamp}: it must be their time'
        elif not self.offset_ns or abs(least_ns - self.offset_ns) > TOLERATED:
            self.offset_ns, self.problem = 0, ''
            if abs(least_ns) > TOLERATED:
                size, side = abs(least_ns) / SECOND, 'behind' if least_ns > 0 else 'ahead of'
                self.offset_ns = least_ns
                self.problem = (
                    f'stamps of the samples are {1e3 * size:.1f} ms {side} the clock of the twin, '
                    'which corrects them'
                )


class Measurement:
    """
    The measurements of a rig, passed to a session that follows its plate.

    A constant error of the sensor's `clock` is removed and logged; `now` returns the time on the
    clock of the ticks [ns].
    """

    def __init__(
        self, node: RunnableNode, session: Session, joints: tuple[str, str], now: Callable[[], int]
    ) -> None:
        self.age_ns = 0  # from the stamp of the newest sample to its arrival
        self.clock = SensorClock()
        self._arrival_ns = 0  # latest time of the clock at which samples arrived [ns]
        self._arrived: list[int] = []  # their stamps [ns]
        self._session = session
        self._now = now
        self._logger = node.get_logger()
        self._counts: dict[str, int] = {}  # at the last status
        topic, refused = TWIN_TOPICS.measured_joint_states, session.sample_counts.refused
        self._reader = HeightReader(node, topic, joints, refused)

    def read_messages(self) -> None:
        """Pass the samples that have arrived to a measured session, at most those of a tick."""
        for samples in self._reader.read(MAX_DATA_RATE / self._session.rate):
            if self._session.is_measured:
                self._observe(samples.stamps.tolist())
                samples.stamps += self.clock.offset_ns
                self._session.measure(samples, clock_offset_ns=self.clock.offset_ns)

    def status(self) -> tuple[str, dict[str, float], bool]:
        """Return text, values and whether to warn of the samples since the last call."""
        subscription, so_far = self._reader.subscription, self._session.sample_counts
        subscription.poll_losses()
        refused = dict(so_far.refused)  # a copy, because the tick thread modifies the counter
        counts = {
            'samples': so_far.taken,
            'samples_out_of_order': so_far.out_of_order,
            'samples_jumped': so_far.outliers,
            'messages': subscription.received,
            'messages_lost': subscription.lost,
            'samples_refused': sum(refused.values()),
            **{f'refused.{why}': count for why, count in refused.items()},
        }
        new = {name: count - self._counts.get(name, 0) for name, count in counts.items()}
        self._counts = counts
        is_lossy = not new['samples'] or new['samples_refused'] or new['messages_lost']
        text = '{samples} samples, {messages_lost} lost, {samples_refused} refused'.format(**new)
        text += self.clock.problem and f'; {self.clock.problem}'
        values = {
            'at_rest': self._session.is_at_rest,
            **{name: count for name, count in new.items() if count or '.' not in name},
            'clock_offset': self.clock.offset_ns / SECOND,
            'age': self.age_ns / SECOND,
        }
        return text, values, bool(is_lossy or self.clock.problem)

    def _observe(self, stamps: list[int]) -> None:
        """Compare all stamps of a step of the clock, which may be long, with its end."""
        before, now = self._arrival_ns, self._now()
        if now != before:
            if self._arrived and now > before:  # no bag that is played again
                arrival = min(max(*self._arrived, before), now)
                self.age_ns = arrival - max(self._arrived) - self.clock.offset_ns
                if self.clock.observe(self._arrived, arrival):
                    text = self.clock.problem or 'stamps of the samples are right again'
                    self._logger.warning(text)
            self._arrival_ns, self._arrived = now, []
        self._arrived += stamps


def to_samples(values: JointStates, joints: tuple[str, str]) -> Samples | None:
    """Return the samples in messages; None without the plate, the first of the joints."""
    names, position = values.names, values.position
    if joints[0] not in names or position.shape[1] != len(names):
        return None
    heights = np.full((len(position), 2), np.nan)
    for column, joint in enumerate(joints):
        if joint in names:
            heights[:, column] = position[:, names.index(joint)]
    return Samples(values.stamps, heights)
