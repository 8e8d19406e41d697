# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of a rig, read from their topic by the tick thread before every step.

There are thousands of messages per second; draining the queue costs a tenth of an executor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import math

from rclpy.node import Node
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.nodes.sensor_clock import SensorClock
from soft_throw_ros.storage.cdr import JointStateReader, JointValues, MessageError
from soft_throw_ros.twin.plate_estimator import FARTHEST
from soft_throw_ros.twin.sample_buffer import Sample
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
        self, node: Node, session: Session, joints: tuple[str, str], *, now: Callable[[], int]
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
        self._read = JointStateReader().read

    def read_messages(self) -> None:
        """
        Pass the samples that have arrived to the session, within the budget of a tick.

        If the session is not measured, drop the messages.
        """
        messages = self._subscription.drain(MAX_DATA_RATE / self._session.rate)
        if self._session.is_measured:
            samples = self._samples([message.data for message in messages])
            if samples:
                samples = self._by_our_clock(samples)
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

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()

    def _by_our_clock(self, samples: list[Sample]) -> list[Sample]:
        """Correct the stamps of samples by the offset of the sensor's clock."""
        clock, now = self.clock, self._now()
        if now != self._arrival_ns:
            self._observe(now)
            self._arrival_ns, self._arrived = now, []
        self._arrived += [sample.stamp_ns for sample in samples]
        if not clock.offset_ns:
            return samples
        return [sample._replace(stamp_ns=sample.stamp_ns + clock.offset_ns) for sample in samples]

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

    def _samples(self, datas: list[bytes]) -> list[Sample]:
        """Decode messages; refuse and count those that are not valid."""
        samples, refused = [], self._session.sample_counts.refused
        for data in datas:
            if len(data) > MAX_MESSAGE_SIZE:
                refused['too large'] += 1
                continue
            try:
                values = self._read(data)
            except MessageError:
                refused['unreadable'] += 1
                continue
            sample = _to_sample(values, self._joints)
            if sample is not None:
                samples.append(sample)
                continue
            refused['names'] += 1
            if values.names != self._names:  # log the joints of refused messages once
                self._names = values.names
                self._logger.warning(
                    f'measured messages have the joints {list(values.names)!r:.200}, and the '
                    f'heights of joint_names.plate {self._joints[0]!r} are missing'
                )
        return samples


def _to_sample(values: JointValues, joints: tuple[str, str]) -> Sample | None:
    """Return the sample in a message; None without the plate, the first of the joints."""
    stamp_ns, names, position, *_ = values
    plate, projectile = joints
    if plate not in names or len(position) != len(names):
        return None
    return Sample(
        stamp_ns,
        position[names.index(plate)],
        position[names.index(projectile)] if projectile in names else math.nan,
    )
