# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Receive messages as bytes, and count the lost ones.

Subscriptions are not served by an executor, which costs more than all the rest: they are drained
every few milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from itertools import islice
import math
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import ROSClock
from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, qos_check_compatible, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from soft_throw_ros.configuration.interface import find_topic, Topic
from soft_throw_ros.nodes.conversions import profile_to_dict
from soft_throw_ros.nodes.rclpy_internals import (
    close_event,
    open_event,
    take_event,
    take_messages,
)
from soft_throw_ros.nodes.topics import load_type, qos_profile
from soft_throw_ros.recording.loss_counter import LossCounter
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes, SchemaError
from soft_throw_ros.storage.bag_metadata import dump_yaml
from soft_throw_ros.storage.message import Channel, Message

DEPTH = 10_000
"""Largest number of waiting messages of a topic: one second of the fastest sensor."""

_UNKNOWN = 2**64 - 1
"""Sequence number of messages for which the middleware knows no number."""


class _NotExecuted(ReentrantCallbackGroup):
    """A callback group that keeps subscriptions away from executors."""

    def can_execute(self, _entity: object) -> bool:
        """Return False for every entity."""
        return False


class RawSubscription:
    """
    A subscription to the topic of a channel that receives bytes.

    Parameters
    ----------
    node : Node
        The subscribing node.
    channel : Channel
        The channel of the topic.
    profile : QoSProfile
        The requested quality of service.

    Attributes
    ----------
    received : int
        Number of received messages.
    is_latched : bool
        Whether it is transient local, as of topics that may be published only once.
    publishers : set of bytes
        Identifiers of the publishers of the topic, as of the last call of `poll_losses`.

    Raises
    ------
    ImportError
        If messages of this type are not installed.

    """

    def __init__(self, node: Node, channel: Channel, profile: QoSProfile) -> None:
        self.channel = channel
        self.received = 0
        self.is_latched = profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
        self.publishers: set[bytes] = set()
        self._node = node
        self._profile = profile
        self._counter = LossCounter()
        self._reported = 0  # losses that the middleware has reported
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
        self._loss_event = open_event(
            self._subscription.handle, QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
        )

    @classmethod
    def of(cls, node: Node, topic: Topic) -> RawSubscription:
        """Subscribe a node to a topic of this package; the channel has no schema."""
        name = node.resolve_topic_name(topic.name)
        return cls(node, Channel(topic=name, type=topic.type, schema=''), qos_profile(topic))

    @property
    def lost(self) -> int:
        """Number of lost messages, as of the last call of `poll_losses`."""
        return self._counter.lost

    def drain(self, max_size: float = math.inf) -> list[Message]:
        """Return the next messages: at most `DEPTH`, and none beyond a total size [bytes]."""
        messages: list[Message] = []
        size = 0
        waiting = take_messages(self._subscription, self._type)
        for data, info in islice(waiting, DEPTH):  # a publisher may be faster than the loop
            number = info['publication_sequence_number']
            number = None if number == _UNKNOWN else number
            self._counter.add(number, _identifier(info.get('publisher_gid')))
            times = info['received_timestamp'], info['source_timestamp']
            messages.append(Message(self.channel, data, *times, number or 0))
            size += len(data)
            if size >= max_size:
                break
        self.received += len(messages)
        return messages

    def poll_losses(self) -> str:
        """
        Ask the middleware for the publishers of the topic and for reported losses.

        Return the reason if nothing comes from a new publisher, empty otherwise.
        """
        event = take_event(self._loss_event)
        if event is not None:
            self._reported = event.total_count
        publishers = self._node.get_publishers_info_by_topic(self.channel.topic)
        found = {bytes(item.endpoint_gid): item for item in publishers}
        self._counter.update(found, self._reported)
        reason = ''
        for item in (found[gid] for gid in found.keys() - self.publishers):
            _, text = qos_check_compatible(item.qos_profile, self._profile)
            if item.topic_type != self.channel.type:
                reason = f'its messages are {item.topic_type}'
            elif 'ERROR: ' in text:
                reason = text.replace('ERROR: ', ' ').strip() + ' start again to receive all'
        self.publishers = set(found)
        return reason

    def close(self) -> None:
        """Unsubscribe."""
        self.poll_losses()
        close_event(self._loss_event)
        self._node.destroy_subscription(self._subscription)


class RawSubscriptions:
    """
    Subscriptions of a node to all requested topics and namespaces, made as topics appear.

    Parameters
    ----------
    node : Node
        The subscribing node.
    wanted : collection of str
        Full names of topics and namespaces.
    is_accepted : callable, optional
        Returns for the name and type of a requested topic whether to subscribe.

    Attributes
    ----------
    refused : dict of str to str
        Topics, and publishers of topics, that are not received, with the reasons.

    """

    def __init__(
        self,
        node: Node,
        wanted: Collection[str],
        *,
        is_accepted: Callable[[str, str], bool] = lambda _topic, _type: True,
    ) -> None:
        self.refused: dict[str, str] = {}
        self._is_accepted = is_accepted
        self._node = node
        self._wanted = wanted
        self._subscriptions: dict[str, RawSubscription] = {}

    def __iter__(self) -> Iterator[RawSubscription]:
        return iter(list(self._subscriptions.values()))

    def discover(self) -> dict[str, str]:
        """Subscribe to all requested topics that exist; return what is newly `refused`."""
        refused = {}
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self.refused or not is_wanted(topic, self._wanted):
                continue
            if not any(self._is_accepted(topic, type_name) for type_name in types):
                continue
            if topic in self._subscriptions:
                if reason := self._subscriptions[topic].poll_losses():
                    refused[f'{topic} of a later publisher'] = reason
            elif publishers := self._node.get_publishers_info_by_topic(topic):
                try:
                    self._subscriptions[topic] = self._subscribe(topic, types, publishers)
                except (ImportError, SchemaError, ValueError) as error:
                    refused[topic] = str(error)
        refused = {name: why for name, why in refused.items() if name not in self.refused}
        self.refused |= refused
        return refused

    def drain(self) -> list[Message]:
        """
        Return the messages since the last call, in the order of their arrival.

        If the node uses simulated time, messages wait until `/clock` runs, and their time of
        receiving is simulated time.

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
        """Unsubscribe from everything; the counts remain."""
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
        return RawSubscription(self._node, channel, profile)


def _identifier(gid: Any) -> bytes | None:
    """Return the identifier of a publisher; None if the middleware does not give one."""
    if gid is None:
        return None
    return bytes(gid['data'] if isinstance(gid, dict) else gid)


def is_wanted(topic: str, wanted: Collection[str]) -> bool:
    """
    Return whether a topic, or its namespace, is among the requested names.

    Hidden topics, with an underscore at the beginning of a part, must be requested by name.

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
    """Return the strictest request that is compatible with the offers of all publishers."""
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(item.reliability is ReliabilityPolicy.RELIABLE for item in profiles)
    latched = all(item.durability is DurabilityPolicy.TRANSIENT_LOCAL for item in profiles)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _offered(topic: str, kind: str, publisher: TopicEndpointInfo) -> dict[str, object]:
    """Return the profile of a publisher; an unknown history is taken from our own topics."""
    profile = profile_to_dict(publisher.qos_profile)
    known = find_topic(topic, kind)
    if profile['history'] == 'unknown' and known is not None:
        profile.update(history='keep_last', depth=known.topic.depth)
    return profile
