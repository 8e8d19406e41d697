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
Take messages from topics as the bytes that came, and know how many did not come.

Subscriptions are not served by an executor, which costs more than all the rest: they are drained
every few milliseconds.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from statistics import fmean, median
import time
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import ROSClock
from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from soft_throw_ros.configuration.interface import find_topic, Topic
from soft_throw_ros.nodes.conversions import profile_to_dict
from soft_throw_ros.nodes.topics import EventHandle, load_type, qos_profile
from soft_throw_ros.recording.bag_metadata import dump_yaml
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes, SchemaError

DEPTH = 10_000
"""How many messages of a topic may wait to be drained: a second of the fastest sensor."""

_RATE_MESSAGES = 100  # by which we tell how often a publisher publishes
_SILENCE = 1_000_000_000  # during which one publisher may go and another one come [ns]

_UNKNOWN = 2**64 - 1
"""What stands for a number that the middleware does not know."""


class _NotExecuted(ReentrantCallbackGroup):
    """Keeps subscriptions away from executors."""

    def can_execute(self, _entity: object) -> bool:
        """Nothing of it."""
        return False


class _Run:
    """
    Messages of one publisher, as far as its numbers go up.

    Parameters
    ----------
    number, when : int
        Of its first message. [ns] for the time
    began : int, optional
        Since when all its messages were wanted; otherwise since the first one. [ns]
    after : int, optional
        The number before, if it is not certain that this is another publisher.

    """

    def __init__(
        self, number: int, when: int, began: int | None, *, after: int | None = None
    ) -> None:
        self.gaps = 0
        self.after = after
        self.earlier = number - 1
        self.last, self.last_when = number, when
        self._waited = 0 if began is None else when - began
        self._periods: list[float] = []  # at first

    def add(self, number: int, when: int) -> None:
        """Count another message, and those that are missing before it."""
        if len(self._periods) < _RATE_MESSAGES:
            self._periods.append((when - self.last_when) / (number - self.last))
        self.gaps += number - self.last - 1
        self.last, self.last_when = number, when

    @property
    def is_late(self) -> bool:
        """Whether the publisher began before we did, by how often it publishes."""
        return not self._periods or self.earlier * self._period > self._waited

    def is_left_at(self, number: int, when: int) -> bool:
        """Whether the publisher would have come further than to a number, had it gone on."""
        silence, step = when - self.last_when, number - self.last
        if step == 1 or silence < _SILENCE or not self._periods:
            return False
        return 2 * step * self._period < silence

    @property
    def _period(self) -> float:
        # One burst among them shortens the mean, and messages that always come in bursts have
        # a median of nearly nothing.
        return max(fmean(self._periods), median(self._periods))


class RawSubscription:
    """
    A subscription to the topic of a channel, for the bytes that come.

    Parameters
    ----------
    node : Node
        Which subscribes.
    channel : Channel
        Of the topic.
    profile : QoSProfile
        What is asked for.
    began_ns : int, optional
        Since when all messages are wanted, by the clock of the system; otherwise since the first
        that comes. [ns]

    Attributes
    ----------
    received : int
        How many messages came.
    is_shared : bool
        Whether the topic has several publishers.

    Raises
    ------
    ImportError
        If messages of this type are not installed.

    Notes
    -----
    A publisher numbers its messages from 1 on, so a gap is a loss. What it published before
    the first one that came was before we began, if that is more than it would publish in the
    time that we waited, as often as at first; otherwise it is lost, too. If the middleware
    does not tell the publishers of a topic apart (before ROS 2 Kilted), a number that is not
    above the last one is that of another publisher, and so is one after a silence in which the
    publisher would have come further, if there has been another one. That may be one which
    came after the former, and then each has numbers of its own. Otherwise, and on topics of
    which it is usual that several nodes publish at once, the numbers say nothing; then there is
    what the middleware says of losses, which knows of less.

    """

    def __init__(
        self, node: Node, channel: Channel, profile: QoSProfile, *, began_ns: int | None = None
    ) -> None:
        self.channel = channel
        self.received = 0
        self.is_shared = False
        self._node = node
        self._began = began_ns
        self._lost_by_event = 0
        self._publishers: set[bytes] = set()  # of which the middleware has told
        self._runs: dict[bytes | None, list[_Run]] = {}  # by publisher, None if that is not told
        known = find_topic(channel.topic, channel.type)
        self._is_of_one = known is not None and known.topic.name.startswith('~/')
        self._type = load_type(channel.type)
        self._subscription = node.create_subscription(
            self._type,
            channel.topic,
            lambda _message: None,
            profile,
            callback_group=_NotExecuted(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )
        # An executor that waits for this event wakes for every message as well
        handle = self._subscription.handle
        with handle:
            self._loss_event = EventHandle(
                handle, QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
            )

    @classmethod
    def of(cls, node: Node, topic: Topic) -> RawSubscription:
        """Subscribe a node to one of our topics, whose bytes are not to be kept."""
        name = node.resolve_topic_name(topic.name)
        return cls(node, Channel(topic=name, type=topic.type, schema=''), qos_profile(topic))

    @property
    def lost(self) -> int:
        """How many messages did not come, though they were published."""
        if not self._has_numbers:
            return self._lost_by_event
        return sum(run.gaps + self._before(run)[0] for run in self._all_runs)

    @property
    def earlier(self) -> int:
        """How many messages were published before we joined late."""
        if not self._has_numbers:
            return 0
        return sum(self._before(run)[1] for run in self._all_runs)

    def drain(self) -> list[Message]:
        """Return what has come since the last call."""
        messages = []
        handle, kind = self._subscription.handle, self._type
        with handle:
            while (taken := handle.take_message(kind, True)) is not None:
                data, info = taken
                sequence = info['publication_sequence_number']
                if sequence is None or sequence == _UNKNOWN:
                    sequence = 0
                else:
                    self._count(sequence, info['source_timestamp'], info.get('publisher_gid'))
                times = info['received_timestamp'], info['source_timestamp']
                messages.append(Message(self.channel, data, *times, sequence))
        self.received += len(messages)
        return messages

    def look_for_losses(self) -> None:
        """Hear from the middleware who publishes, and what it has lost."""
        publishers = self._node.get_publishers_info_by_topic(self.channel.topic)
        self.is_shared |= len(publishers) > 1
        self._publishers |= {bytes(publisher.endpoint_gid) for publisher in publishers}
        with self._loss_event:
            event = self._loss_event.take_event()
        if event is not None:
            self._lost_by_event = event.total_count

    def close(self) -> None:
        """Unsubscribe."""
        self.look_for_losses()
        self._loss_event.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscription)

    @property
    def _has_numbers(self) -> bool:
        """Whether the numbers of messages are those of one publisher each."""
        if None not in self._runs or not self.is_shared:
            return True
        certain = sum(run.after is None for run in self._runs[None])
        return self._is_of_one and certain <= len(self._publishers)

    @property
    def _all_runs(self) -> list[_Run]:
        return [run for runs in self._runs.values() for run in runs]

    def _before(self, run: _Run) -> tuple[int, int]:
        """Return how many messages before those of a run are lost, and how many too early."""
        if run.after is not None and len(self._runs[None]) > len(self._publishers):
            return run.earlier - run.after, 0  # there is nobody else: it went on
        return (0, run.earlier) if run.is_late else (run.earlier, 0)

    def _count(self, number: int, when: int, publisher: Any) -> None:
        if publisher is not None:
            publisher = bytes(publisher['data'] if isinstance(publisher, dict) else publisher)
        runs = self._runs.setdefault(publisher, [])
        if runs and number > runs[-1].last:
            if publisher is None and runs[-1].is_left_at(number, when):
                runs.append(_Run(number, when, self._began, after=runs[-1].last))
            else:
                runs[-1].add(number, when)
        elif not runs or when > runs[-1].last_when:  # otherwise it comes once more
            runs.append(_Run(number, when, self._began))


class RawSubscriptions:
    """
    Subscriptions of a node to all topics and namespaces that are wanted, as they appear.

    Attributes
    ----------
    refused : dict of str to str
        Topics that cannot be had, and why.

    """

    def __init__(self, node: Node, wanted: Collection[str]) -> None:
        self.refused: dict[str, str] = {}
        self._node = node
        self._wanted = wanted
        self._began = time.time_ns()
        self._subscriptions: dict[str, RawSubscription] = {}

    def __iter__(self) -> Iterator[RawSubscription]:
        return iter(list(self._subscriptions.values()))

    def discover(self) -> list[str]:
        """Subscribe to what is there and wanted; return the topics that are newly refused."""
        refused = []
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self.refused or not is_wanted(topic, self._wanted):
                continue
            if topic in self._subscriptions:
                self._subscriptions[topic].look_for_losses()
            elif publishers := self._node.get_publishers_info_by_topic(topic):
                try:
                    self._subscriptions[topic] = self._subscribe(topic, types, publishers)
                except (ImportError, SchemaError, ValueError) as error:
                    self.refused[topic] = str(error)
                    refused.append(topic)
        return refused

    def drain(self) -> list[Message]:
        """
        Return what has come since the last call, in the order in which it was received.

        If the node follows `/clock`, that tells the time of receiving, and nothing is taken
        before it goes.

        """
        clock = self._node.get_clock()
        is_simulated = isinstance(clock, ROSClock) and clock.ros_time_is_active
        now = clock.now().nanoseconds
        if is_simulated and not now:
            return []
        messages = [message for subscription in self for message in subscription.drain()]
        if is_simulated:
            return [message._replace(log_time=now, publish_time=now) for message in messages]
        return sorted(messages, key=lambda message: message.log_time)

    def close(self) -> None:
        """Unsubscribe from everything; what was counted stays."""
        for subscription in self:
            subscription.close()

    def _subscribe(
        self, topic: str, types: list[str], publishers: list[TopicEndpointInfo]
    ) -> RawSubscription:
        if len(types) > 1:
            raise ValueError(f'it has messages of several types, {", ".join(types)}')
        schema = find_schema(types[0], installed_prefixes())
        channel = Channel(
            topic=topic,
            type=types[0],
            schema=schema.text,
            type_hash=schema.type_hash,
            qos=dump_yaml([_offered(topic, types[0], publisher) for publisher in publishers]),
        )
        profile = fitting_profile(publishers)
        return RawSubscription(self._node, channel, profile, began_ns=self._began)


def is_wanted(topic: str, wanted: Collection[str]) -> bool:
    """
    Tell whether a topic, or a namespace that it is in, is among those wanted.

    Hidden topics, which have a name with an underscore first, must be named themselves.

    Examples
    --------
    >>> is_wanted('/twin/layer/strain', ['/twin']), is_wanted('/twins', ['/twin'])
    (True, False)
    >>> is_wanted('/rosout', ['/']), is_wanted('/twin/_hidden', ['/'])
    (True, False)
    >>> is_wanted('/twin/phase', ['/twin/']), is_wanted('/_hidden', ['/_hidden'])
    (True, True)

    """
    if topic in wanted:
        return True
    is_hidden = '/_' in topic
    return not is_hidden and any(topic.startswith(f'{name.rstrip("/")}/') for name in wanted)


def fitting_profile(publishers: Iterable[TopicEndpointInfo]) -> QoSProfile:
    """Ask for no more than every one of the publishers offers."""
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(item.reliability is ReliabilityPolicy.RELIABLE for item in profiles)
    latched = all(item.durability is DurabilityPolicy.TRANSIENT_LOCAL for item in profiles)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _offered(topic: str, kind: str, publisher: TopicEndpointInfo) -> dict[str, object]:
    """Return what a publisher offers; its history is not told to others, but may be ours."""
    profile = profile_to_dict(publisher.qos_profile)
    known = find_topic(topic, kind)
    if profile['history'] == 'unknown' and known is not None:
        profile.update(history='keep_last', depth=known.topic.depth)
    return profile
