# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Receive messages as bytes, and count the lost ones.

Subscriptions are not served by an executor, which takes one message each time it wakes: that would
cost more than all the rest. They are drained every few milliseconds, by private parts of rclpy.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
import math

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import ROSClock
from rclpy.event_handler import QoSSubscriptionEventType, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, qos_check_compatible, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from soft_throw_ros.configuration.interface import find_topic, Topic
from soft_throw_ros.nodes.conversions import profile_to_dict
from soft_throw_ros.nodes.topics import load_type, make_profile, qos_profile
from soft_throw_ros.recording.loss_counter import LossCounter
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes, SchemaError
from soft_throw_ros.storage.bag_folder import dump_yaml
from soft_throw_ros.storage.message import Channel, Message

_DEPTH = 10_000  # most waiting messages of a topic: a second of the fastest sensor [-]
_UNKNOWN = 2**64 - 1  # sequence number of messages whose number the middleware does not know


class _NotExecuted(ReentrantCallbackGroup):
    """A callback group that keeps subscriptions away from executors."""

    def can_execute(self, _entity: object) -> bool:
        """Return False for every entity."""
        return False


class RawSubscription:
    """
    A subscription to the topic of a channel that receives bytes; ImportError without its type.

    `received` is the number of received messages. `lost`, the number of lost ones, and
    `publishers`, the identifiers of the publishers, are those of the last `poll_losses`.
    """

    def __init__(self, node: Node, channel: Channel, profile: QoSProfile) -> None:
        self.channel = channel
        self.profile = profile
        self.received = self.lost = 0
        self.publishers: set[bytes] = set()
        self._node = node
        self._counter = LossCounter()
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
        self._handle = self._subscription.handle
        kind = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
        with self._handle:  # an executor that waits for events wakes for every message as well
            self._loss_event = rclpy_implementation.EventHandle(self._handle, kind)
        self._reported = 0  # losses, according to the middleware

    def drain(self, max_size: float = math.inf) -> list[Message]:
        """Return the next messages: at most `_DEPTH`, and none beyond a total size [bytes]."""
        messages: list[Message] = []
        size = received = 0
        with self._handle:
            while len(messages) < _DEPTH and size < max_size:  # a publisher may be faster
                if (taken := self._handle.take_message(self._type, True)) is None:
                    break
                data, info = taken
                number = info['publication_sequence_number']
                number = None if number == _UNKNOWN else number
                gid = info.get('publisher_gid')  # None before Kilted
                if gid is not None:
                    gid = bytes(gid['data'] if isinstance(gid, dict) else gid)
                self._counter.add(number, gid)
                # messages stay in order; the time of one that was sent again may be later
                received = max(received, info['received_timestamp'])
                sent = info['source_timestamp']
                messages.append(Message(self.channel, data, received, sent, number or 0))
                size += len(data)
        self.received += len(messages)
        return messages

    def poll_losses(self) -> str:
        """
        Ask the middleware for the publishers of the topic and for reported losses.

        Return the reason if nothing comes from a new publisher, empty otherwise.
        """
        infos = self._node.get_publishers_info_by_topic(self.channel.topic)
        new = [item for item in infos if bytes(item.endpoint_gid) not in self.publishers]
        self.publishers = {bytes(item.endpoint_gid) for item in infos}
        with self._loss_event:
            status = self._loss_event.take_event()
        if status is not None:
            self._reported = status.total_count
        self._counter.update(self.publishers, self._reported)
        self.lost = self._counter.lost
        for item in new:
            _, text = qos_check_compatible(item.qos_profile, self.profile)
            if item.topic_type != self.channel.type:
                return f'its messages are {item.topic_type}'
            if 'ERROR: ' in text:
                return f"{text.replace('ERROR: ', ' ').strip()} start again to receive all"
        return ''

    def close(self) -> None:
        """Unsubscribe."""
        self.poll_losses()
        self._loss_event.destroy_when_not_in_use()  # it would keep its subscription
        self._node.destroy_subscription(self._subscription)


def subscribe(node: Node, topic: Topic) -> RawSubscription:
    """Subscribe to a topic of this package; the channel has no schema, since none is recorded."""
    name = node.resolve_topic_name(topic.name)
    channel = Channel(topic=name, type=topic.type, schema='')
    return RawSubscription(node, channel, qos_profile(topic))


class RawSubscriptions:
    """
    Subscriptions of a node to all topics whose name and type `accepts`, made as topics appear.

    `refused` has the topics and publishers that are not received, with the reasons, which are also
    logged.
    """

    def __init__(self, node: Node, accepts: Callable[[str, str], bool]) -> None:
        self.refused: dict[str, str] = {}
        self._accepts = accepts
        self._node = node
        self._subscriptions: dict[str, RawSubscription] = {}

    def __iter__(self) -> Iterator[RawSubscription]:
        return iter(list(self._subscriptions.values()))

    @property
    def received(self) -> int:
        """Number of received messages."""
        return sum(item.received for item in self)

    @property
    def lost(self) -> int:
        """Number of lost messages, as of the last discovery."""
        return sum(item.lost for item in self)

    def discover(self) -> None:
        """Subscribe to all wanted topics that exist, and ask for losses of the present ones."""
        for topic, types in self._node.get_topic_names_and_types():
            if topic in self.refused or not any(self._accepts(topic, name) for name in types):
                continue
            if topic in self._subscriptions:
                if reason := self._subscriptions[topic].poll_losses():
                    self._refuse(f'{topic} of a later publisher', reason)
            elif publishers := self._node.get_publishers_info_by_topic(topic):
                try:
                    self._subscriptions[topic] = self._subscribe(topic, types, publishers)
                except (ImportError, SchemaError, ValueError) as error:
                    self._refuse(topic, str(error))

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

    def _refuse(self, name: str, reason: str) -> None:
        if name not in self.refused:
            self.refused[name] = reason
            self._node.get_logger().warning(f'{name} is not received: {reason}')

    def _subscribe(
        self, topic: str, types: list[str], publishers: list[TopicEndpointInfo]
    ) -> RawSubscription:
        if len(types) > 1:
            raise ValueError(f'it has messages of several types, {", ".join(types)}')
        schema, type_hash = find_schema(types[0], installed_prefixes())
        profiles = [publisher.qos_profile for publisher in publishers]
        qos = dump_yaml([_offered(topic, types[0], profile) for profile in profiles])
        channel = Channel(
            topic=topic, type=types[0], schema=schema, type_hash=type_hash, qos=qos
        )
        fitting = make_profile(  # the strictest request that is compatible with all offers
            _DEPTH,
            is_reliable=all(p.reliability is ReliabilityPolicy.RELIABLE for p in profiles),
            is_latched=all(p.durability is DurabilityPolicy.TRANSIENT_LOCAL for p in profiles),
        )
        return RawSubscription(self._node, channel, fitting)


def is_wanted(topic: str, wanted: Collection[str]) -> bool:
    """
    Return whether a topic, or its namespace, is among the requested names.

    Hidden topics, with an underscore at the beginning of a part, must be requested by name.

    Examples
    --------
    >>> [is_wanted(topic, ['/twin']) for topic in ('/twin/phase', '/twins', '/twin/_hidden')]
    [True, False, False]
    >>> is_wanted('/rosout', ['/']), is_wanted('/_hidden', ['/_hidden'])
    (True, True)

    """
    is_inside = any(topic.startswith(f'{name.rstrip("/")}/') for name in wanted)
    return topic in wanted or (is_inside and '/_' not in topic)


def _offered(topic: str, kind: str, offer: QoSProfile) -> dict[str, object]:
    """Return the profile of a publisher; an unknown history is taken from our own topics."""
    profile = profile_to_dict(offer)
    known = find_topic(topic, kind)
    if profile['history'] == 'unknown' and known is not None:
        profile.update(history='keep_last', depth=known[1].depth)
    return profile
