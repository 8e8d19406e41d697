# SPDX-License-Identifier: Apache-2.0
"""
What a rig measures, taken from its topic by the thread that ticks, before every step.

There are thousands of messages in a second, which an executor would take one callback each for;
drained, they cost a tenth of that.
"""

from __future__ import annotations

from collections import Counter
import math

from rclpy.node import Node
from soft_throw_ros.configuration.interface import JOINTS, TWIN_TOPICS
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.recording.cdr import JointStateReader, JointValues, MessageError
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.session import Session

_PLATE, _PROJECTILE = JOINTS


class Measurement:
    """
    Gives a session what the rig has measured.

    Messages that are damaged, or lack the plate, are refused like samples: as 'unreadable', and
    for their 'names'.

    Attributes
    ----------
    leads : list of int
        How far ahead the projectile was known, at every step of a throw. [ns]

    """

    def __init__(self, node: Node, session: Session) -> None:
        self.leads: list[int] = []
        self._session = session
        self._subscription = RawSubscription.of(node, TWIN_TOPICS.measured_joint_states)
        self._read = JointStateReader().read

    def take(self) -> None:
        """Hand on all that has been measured until now."""
        if self._session.is_measured:
            messages = self._subscription.drain()
            if messages:
                self._session.measure(self._samples([message.data for message in messages]))

    def count(self) -> Counter[str]:
        """Count messages and samples, so far, by what became of them."""
        self._subscription.look_for_losses()
        counts = self._session.sample_counts
        refused = dict(counts.refused)  # a copy, for the other thread adds to it
        found = Counter({f'refused.{why}': count for why, count in refused.items()})
        found['samples'] = counts.taken
        found['samples_out_of_order'] = counts.out_of_order
        found['samples_refused'] = sum(refused.values())
        found['messages'] = self._subscription.received
        found['messages_lost'] = self._subscription.lost
        return found

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
