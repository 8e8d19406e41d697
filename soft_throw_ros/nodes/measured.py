# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""
What a rig measures, taken from its topic by the thread that ticks, before every step.

There are thousands of messages in a second, which an executor would take one callback each for;
drained, they cost a tenth of that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import math

from rclpy.node import Node
from soft_throw_ros.configuration.interface import JOINTS, TWIN_TOPICS
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.recording.cdr import JointStateReader, JointValues, MessageError
from soft_throw_ros.twin.plate_estimator import FARTHEST, Sample
from soft_throw_ros.twin.sensor_clock import SensorClock
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import SECOND

_PLATE, _PROJECTILE = JOINTS


class Measurement:
    """
    Gives a session what the rig has measured.

    Messages that are damaged, or lack the plate, are refused like samples: as 'unreadable', and
    for their 'names'. What their clock is off is taken off, see `SensorClock`, and logged.

    Parameters
    ----------
    node : Node
        That subscribes.
    session : Session
        That is given samples.
    now : callable
        Gives the time by the clock of the ticks. [ns]
    clock_limit : callable
        Gives how far clocks may be apart. [s]

    Attributes
    ----------
    clock : SensorClock
        That stamps the samples.
    leads : list of int
        How far ahead the projectile was known, at every step of a throw. [ns]

    """

    def __init__(
        self,
        node: Node,
        session: Session,
        *,
        now: Callable[[], int],
        clock_limit: Callable[[], float],
    ) -> None:
        self.leads: list[int] = []
        self.clock = SensorClock()
        self._session = session
        self._now = now
        self._clock_limit = clock_limit
        self._logger = node.get_logger()
        self._is_warned = False
        self._subscription = RawSubscription.of(node, TWIN_TOPICS.measured_joint_states)
        self._read = JointStateReader().read

    def take(self) -> None:
        """Hand on all that has been measured until now."""
        if self._session.is_measured:
            messages = self._subscription.drain()
            samples = self._samples([message.data for message in messages])
            if samples:
                self._session.measure(self._by_our_clock(samples))
                self._warn_of_units()

    def count(self) -> Counter[str]:
        """Count messages and samples, so far, by what became of them."""
        self._subscription.look_for_losses()
        counts = self._session.sample_counts
        refused = dict(counts.refused)  # a copy, for the other thread adds to it
        found = Counter({f'refused.{why}': count for why, count in refused.items()})
        found['samples'] = counts.taken
        found['samples_out_of_order'] = counts.out_of_order
        found['samples_jumped'] = counts.jumped
        found['samples_refused'] = sum(refused.values())
        found['messages'] = self._subscription.received
        found['messages_lost'] = self._subscription.lost
        return found

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()

    def _warn_of_units(self) -> None:
        """Say once what heights that are out of range may be."""
        if not self._is_warned and self._session.sample_counts.refused['out of range']:
            self._is_warned = True
            self._logger.warning(
                f'heights of the samples are beyond {FARTHEST:g} m: if they are in millimetres, '
                'divide them by 1000'
            )

    def _by_our_clock(self, samples: list[Sample]) -> list[Sample]:
        """Take off what the clock of the samples is off."""
        clock = self.clock
        limit_ns = round(self._clock_limit() * SECOND)
        stamps = (sample.stamp_ns for sample in samples)
        if clock.observe(stamps, self._now(), limit_ns=limit_ns):
            self._logger.warning(clock.problem or 'stamps of the samples are right again')
        if not clock.offset_ns:
            return samples
        return [sample._replace(stamp_ns=sample.stamp_ns + clock.offset_ns) for sample in samples]

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
