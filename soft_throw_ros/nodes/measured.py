# SPDX-License-Identifier: Apache-2.0
"""
What a rig measures, taken from its topic by the thread that ticks, before every step.

There are thousands of messages in a second, which an executor would take one callback each for;
drained, they cost a tenth of that.
"""

from __future__ import annotations

from collections import Counter
import math
from typing import NamedTuple

from rclpy.node import Node
from soft_throw_ros.configuration.interface import JOINTS, TWIN_TOPICS
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.nodes.topics import qos_profile
from soft_throw_ros.recording.cdr import JointStateReader, JointValues, MessageError
from soft_throw_ros.recording.message import Channel
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import TickSchedule


class MeasurementStatistics(NamedTuple):
    """
    How the measurement went, since the statistics were last taken.

    Attributes
    ----------
    received, taken, disordered, lost : int
        Messages that came, samples taken of them, of these after later ones, and messages that
        did not come.
    refused : Counter of str
        Samples that were refused, by reason.
    leads : list of int
        How far ahead the projectile was known, at every step of a throw. [ns]

    """

    received: int
    taken: int
    disordered: int
    lost: int
    refused: Counter[str]
    leads: list[int]


class MeasuredSteps:
    """
    Steps of a session, which is given beforehand what the rig has measured.

    Parameters
    ----------
    node : Node
        Which subscribes.
    session : Session
        Is asked for the steps.

    Notes
    -----
    Messages that are damaged, or lack the plate, are refused like samples: as 'unreadable', and
    for their 'names'.

    """

    def __init__(self, node: Node, session: Session) -> None:
        self._node = node
        self._session = session
        topic = TWIN_TOPICS.measured_joint_states
        name = node.resolve_topic_name(topic.name)
        channel = Channel(topic=name, type=topic.type, schema='')
        self._subscription = RawSubscription(node, channel, qos_profile(topic))
        self._read = JointStateReader().read
        self._leads: list[int] = []
        self._counts = (0, 0, 0, 0)
        self._refused: Counter[str] = Counter()

    @property
    def step(self) -> int:
        """Number of the next step."""
        return self._session.step

    @property
    def rate(self) -> float:
        """Steps per second, now. [Hz]"""
        return self._session.rate

    def set_tick_schedule(self, schedule: TickSchedule) -> None:
        """Take note of when steps are due from the next one on."""
        self._session.set_tick_schedule(schedule)

    def take(self) -> None:
        """Hand on all that has been measured until now."""
        if self._session.is_measured:
            messages = self._subscription.drain()
            if messages:
                self._session.measure(self._samples([message.data for message in messages]))

    def advance(self) -> Outputs:
        """Go one step on, with all that has been measured until now."""
        self.take()
        outputs = self._session.advance()
        if outputs.prediction is not None:
            self._leads.append(outputs.prediction.lead_ns)
        return outputs

    def take_statistics(self) -> MeasurementStatistics:
        """Sum up since the last call; it may come from another thread."""
        publishers = self._node.get_publishers_info_by_topic(self._subscription.channel.topic)
        self._subscription.is_shared = len(publishers) > 1
        self._subscription.read_loss_event()
        leads, self._leads = self._leads, []
        counts, subscription = self._session.sample_counts, self._subscription
        now = (subscription.received, counts.taken, counts.out_of_order, subscription.lost)
        before, self._counts = self._counts, now
        refused = Counter(counts.refused)
        news, self._refused = refused - self._refused, refused
        received, taken, disordered, lost = (
            later - earlier for earlier, later in zip(before, now, strict=True)
        )
        return MeasurementStatistics(received, taken, disordered, lost, news, leads)

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()

    def _samples(self, datas: list[bytes]) -> list[Sample]:
        """Read messages, and refuse and count what cannot be read."""
        samples, refused = [], self._session.sample_counts.refused
        for data in datas:
            try:
                sample = _to_sample(self._read(data))
            except MessageError:
                refused['unreadable'] += 1
                continue
            if sample is None:
                refused['names'] += 1
            else:
                samples.append(sample)
        return samples


def _to_sample(values: JointValues) -> Sample | None:
    """Return what a message tells, None if it does not tell of the plate."""
    stamp_ns, names, position, velocity, _ = values
    count = len(names)
    if _PLATE not in names or len(position) != count or len(velocity) not in (0, count):
        return None
    plate = names.index(_PLATE)
    return Sample(
        stamp_ns,
        position[plate],
        velocity[plate] if velocity else math.nan,
        position[names.index(_PROJECTILE)] if _PROJECTILE in names else math.nan,
    )


_PLATE, _PROJECTILE = JOINTS
