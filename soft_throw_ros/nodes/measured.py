# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of a rig, read from their topic by the tick thread before every step.

There are thousands of messages per second; draining the queue costs a tenth of an executor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from soft_throw_ros.configuration.interface import Topic, TWIN_TOPICS
from soft_throw_ros.nodes.conversions import status_to_msg
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.storage.cdr import JointStateReader, JointStates, MessageError
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.sample_buffer import FARTHEST, Samples
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
        self.subscription = RawSubscription.of(node, topic)
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
        self._begin_ns: int | None = None  # start of the observation [ns]
        self._watching_ns = _FIRST
        self._count = 0
        self._whole = 0  # stamps of whole seconds
        self._least_ns = 0

    def observe(self, stamps: Sequence[int], now_ns: int) -> bool:
        """Observe stamps that have just arrived; return whether `problem` has changed."""
        self._count += len(stamps)
        self._whole += sum(stamp_ns % SECOND == 0 for stamp_ns in stamps)
        newest_ns = max(stamps)
        delay_ns = now_ns - newest_ns
        if self._begin_ns is None:
            self._begin_ns, self._least_ns = now_ns, delay_ns
        self._least_ns = min(self._least_ns, delay_ns)
        if self._count < _FEWEST or now_ns - self._begin_ns < self._watching_ns:
            return False
        problem = self.problem
        self._estimate(newest_ns)
        self._begin_ns, self._count, self._whole, self._watching_ns = None, 0, 0, _LATER
        return self.problem != problem

    def _estimate(self, newest_ns: int) -> None:
        """Use the smallest delay as offset, if it exceeds the transport time."""
        least_ns = self._least_ns
        if self._whole == self._count:
            self.offset_ns = 0
            stamp = 'of whole seconds' if newest_ns else '0'
            self.problem = f'header.stamp of the samples is {stamp}: it must be their time'
            return
        if abs(least_ns - self.offset_ns) <= TOLERATED:
            return
        if abs(least_ns) <= TOLERATED:
            self.offset_ns, self.problem = 0, ''
        else:
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
        self,
        node: RunnableNode,
        session: Session,
        joints: tuple[str, str],
        *,
        now: Callable[[], int],
    ) -> None:
        self.age_ns = 0  # from the stamp of the newest sample to its arrival
        self.clock = SensorClock()
        self._arrival_ns = 0  # latest time of the clock at which samples arrived [ns]
        self._arrived: list[int] = []  # their stamps [ns]
        self._session = session
        self._now = now
        self._logger = node.get_logger()
        self._counts: Counter[str] = Counter()  # at the last status
        self._status = partial(status_to_msg, node.get_fully_qualified_name(), 'measurement')
        topic, refused = TWIN_TOPICS.measured_joint_states, session.sample_counts.refused
        self._reader = HeightReader(node, topic, joints, refused)

    def read_messages(self) -> None:
        """Pass the samples that have arrived to a measured session, at most those of a tick."""
        for samples in self._reader.read(MAX_DATA_RATE / self._session.rate):
            if self._session.is_measured:
                self._correct_stamps(samples)
                self._session.measure(samples, clock_offset_ns=self.clock.offset_ns)

    def count(self) -> Counter[str]:
        """Return the numbers of messages and samples so far, by their treatment."""
        subscription, counts = self._reader.subscription, self._session.sample_counts
        subscription.poll_losses()
        refused = dict(counts.refused)  # a copy, because the tick thread modifies the counter
        if refused.get('out of range'):
            self._logger.warning(
                f'heights of the samples are beyond {FARTHEST:g} m: if they are in millimetres, '
                'divide them by 1000',
                once=True,
            )
        return Counter({
            'samples': counts.taken,
            'samples_out_of_order': counts.out_of_order,
            'samples_jumped': counts.outliers,
            'messages': subscription.received,
            'messages_lost': subscription.lost,
            'samples_refused': sum(refused.values()),
            **{f'refused.{why}': count for why, count in refused.items()},
        })

    def status(self) -> DiagnosticStatus:
        """Return the status of the samples received since the last call."""
        counts = self.count()
        new = {name: count - self._counts[name] for name, count in counts.items()}
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
        return self._status(text, values, warn=bool(is_lossy or self.clock.problem))

    def _correct_stamps(self, samples: Samples) -> None:
        """Correct the stamps of samples by the offset of the sensor's clock."""
        now = self._now()
        if now != self._arrival_ns:
            self._observe(now)
            self._arrival_ns, self._arrived = now, []
        self._arrived += samples.stamps.tolist()
        samples.stamps += self.clock.offset_ns

    def _observe(self, now: int) -> None:
        """Compare the stamps of one step of the clock, which may be long, with its end."""
        if not self._arrived or now < self._arrival_ns:  # a bag that is played again
            return
        arrival = min(max(*self._arrived, self._arrival_ns), now)
        self.age_ns = arrival - max(self._arrived) - self.clock.offset_ns
        if self.clock.observe(self._arrived, arrival):
            self._logger.warning(self.clock.problem or 'stamps of the samples are right again')


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
