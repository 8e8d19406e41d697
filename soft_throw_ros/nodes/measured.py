# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of a rig, read from their topic by the tick thread before every step.

There are thousands of messages per second; draining the queue costs a tenth of an executor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.nodes.sensor_clock import SensorClock
from soft_throw_ros.storage.cdr import JointStateReader, JointStates, MessageError
from soft_throw_ros.twin.sample_buffer import FARTHEST, Samples
from soft_throw_ros.twin.session import Session

MAX_MESSAGE_SIZE = 2**14
"""Size of the largest message that is decoded, 500 joints [bytes]: larger ones hold up a tick."""

MAX_DATA_RATE = 16e6
"""Largest data rate, about 100,000 samples per second, which bounds a tick [bytes/s]."""


class Measurement:
    """
    Subscription of a node to the measurements of a rig, which passes them to a session.

    A message that is damaged, lacks the plate, or is larger than `MAX_MESSAGE_SIZE` is refused and
    counted as 'unreadable', 'names' or 'too large'. A constant error of the sensor's `clock` is
    removed and logged. `joints` are the names of plate and projectile, `now` returns the time on
    the clock of the ticks [ns]. `age_ns` is the time from the stamp of the newest sample to its
    arrival, `leads` are the prediction leads of the steps of a throw [ns].
    """

    def __init__(
        self,
        node: RunnableNode,
        session: Session,
        joints: tuple[str, str],
        *,
        now: Callable[[], int],
    ) -> None:
        self.leads: list[int] = []
        self.age_ns = 0
        self.clock = SensorClock()
        self._arrival_ns = 0  # latest time of the clock at which samples arrived [ns]
        self._arrived: list[int] = []  # their stamps [ns]
        self._session = session
        self._joints = joints
        self._now = now
        self._logger = node.get_logger()
        self._is_warned = False
        self._names: tuple[str, ...] = ()  # of a message without the plate
        self._subscription = RawSubscription.of(node, TWIN_TOPICS.measured_joint_states)
        node.add_cleanup(self._subscription.close)
        self._reader = JointStateReader()

    def read_messages(self) -> None:
        """
        Pass the samples that have arrived to the session, within the budget of a tick.

        If the session is not measured, drop the messages.
        """
        messages = self._subscription.drain(MAX_DATA_RATE / self._session.rate)
        if self._session.is_measured:
            for samples in self._samples([message.data for message in messages]):
                self._correct_stamps(samples)
                self._session.measure(samples, clock_offset_ns=self.clock.offset_ns)
            if not self._is_warned and self._session.sample_counts.refused['out of range']:
                self._is_warned = True
                self._logger.warning(
                    f'heights of the samples are beyond {FARTHEST:g} m: if they are in '
                    'millimetres, divide them by 1000'
                )

    def count(self) -> Counter[str]:
        """Return the numbers of messages and samples so far, by their treatment."""
        self._subscription.poll_losses()
        counts = self._session.sample_counts
        refused = dict(counts.refused)  # a copy, because the tick thread modifies the counter
        return Counter({
            'samples': counts.taken,
            'samples_out_of_order': counts.out_of_order,
            'samples_jumped': counts.outliers,
            'messages': self._subscription.received,
            'messages_lost': self._subscription.lost,
            'samples_refused': sum(refused.values()),
            **{f'refused.{why}': count for why, count in refused.items()},
        })

    def _correct_stamps(self, samples: Samples) -> None:
        """Correct the stamps of samples by the offset of the sensor's clock."""
        now = self._now()
        if now != self._arrival_ns:
            self._observe(now)
            self._arrival_ns, self._arrived = now, []
        self._arrived += samples.stamps.tolist()
        samples.stamps += self.clock.offset_ns

    def _observe(self, now: int) -> None:
        """
        Compare the stamps that arrived before the clock moved with the clock.

        `/clock` moves in steps of many milliseconds; stamps within a step are right.
        """
        if not self._arrived or now < self._arrival_ns:  # a bag that is played again
            return
        arrival = min(max(*self._arrived, self._arrival_ns), now)
        self.age_ns = arrival - max(self._arrived) - self.clock.offset_ns
        if self.clock.observe(self._arrived, arrival):
            self._logger.warning(self.clock.problem or 'stamps of the samples are right again')

    def _samples(self, datas: list[bytes]) -> Iterator[Samples]:
        """Decode messages, all alike at once; refuse and count those that are not valid."""
        refused = self._session.sample_counts.refused
        small = [data for data in datas if len(data) <= MAX_MESSAGE_SIZE]
        if len(small) < len(datas):
            refused['too large'] += len(datas) - len(small)
        try:
            batches = [self._reader.read_all(small)] if small else []
        except MessageError:
            batches = []
            for data in small:
                try:
                    batches.append(self._reader.read_all([data]))
                except MessageError:
                    refused['unreadable'] += 1
        for values in batches:
            samples = _to_samples(values, self._joints)
            if samples is None:
                refused['names'] += len(values.stamps)
                if values.names != self._names:  # log the joints of refused messages once
                    self._names = values.names
                    self._logger.warning(
                        f'measured messages have the joints {list(values.names)!r:.200}, and the '
                        f'heights of joint_names.plate {self._joints[0]!r} are missing'
                    )
            else:
                yield samples


def _to_samples(values: JointStates, joints: tuple[str, str]) -> Samples | None:
    """Return the samples in messages; None without the plate, the first of the joints."""
    names, position = values.names, values.position
    if joints[0] not in names or position.shape[1] != len(names):
        return None
    heights = np.full((len(position), 2), np.nan)
    for column, joint in enumerate(joints):
        if joint in names:
            heights[:, column] = position[:, names.index(joint)]
    return Samples(values.stamps, heights)
