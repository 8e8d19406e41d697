# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Raw messages from real publishers, and the counts of lost messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.nodes.conversions import text_to_profiles, time_to_msg
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription, RawSubscriptions
from soft_throw_ros.nodes.topics import qos_profile
from soft_throw_ros.storage.message import Channel, Message, SECOND
from std_msgs.msg import String

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def subscribe(ros: Any) -> Iterator[Callable[..., RawSubscriptions]]:
    """Yield a function that subscribes a node to topics until the end of the test."""
    with contextlib.ExitStack() as made:

        def subscribe(*wanted: str, **options: Any) -> RawSubscriptions:
            subscriptions = RawSubscriptions(ros.node(Node, 'listener', **options), wanted)
            return made.enter_context(contextlib.closing(subscriptions))

        yield subscribe


def take(ros: Any, subscriptions: RawSubscriptions, count: int) -> list[Message]:
    """Discover topics and drain them until `count` messages have arrived."""
    taken: list[Message] = []

    def is_enough() -> bool:
        subscriptions.discover()
        taken.extend(subscriptions.drain())
        return len(taken) >= count

    ros.spin_until(is_enough, f'{count} messages')
    return taken


def test_messages_are_the_bytes_that_were_published(ros, talker, subscribe) -> None:
    publisher = talker.create_publisher(String, '/talk', LATCHED)
    for number in range(5):
        publisher.publish(String(data=f'number {number}'))
    messages = take(ros, subscribe('/talk'), 5)
    assert [deserialize_message(item.data, String).data for item in messages] == [
        f'number {number}' for number in range(5)
    ]
    assert [item.sequence for item in messages] == [1, 2, 3, 4, 5]
    now = talker.get_clock().now().nanoseconds
    for item in messages:
        assert now - 60 * SECOND < item.publish_time <= item.log_time <= now
    channel = messages[0].channel
    assert (channel.topic, channel.type) == ('/talk', 'std_msgs/msg/String')
    assert 'string data' in channel.schema
    assert channel.type_hash.startswith('RIHS01_')
    (profile,) = text_to_profiles(channel.qos)
    assert profile.reliability is ReliabilityPolicy.RELIABLE
    assert profile.durability is DurabilityPolicy.TRANSIENT_LOCAL


def test_history_depth_of_our_topics_is_known(ros, talker, subscribe) -> None:
    journal = TWIN_TOPICS.journal
    talker.create_publisher(String, '/rig1/twin/journal', qos_profile(journal)).publish(String())
    (message,) = take(ros, subscribe('/rig1'), 1)
    (profile,) = text_to_profiles(message.channel.qos)
    assert (profile.history, profile.depth) == (HistoryPolicy.KEEP_LAST, journal.depth)


def test_gaps_are_lost_and_messages_before_the_first_one_are_not(ros, talker) -> None:
    channel = Channel(topic='/talk', type='std_msgs/msg/String', schema='string data')
    publisher = talker.create_publisher(String, '/talk', 100)
    for _ in range(7):
        publisher.publish(String(data='too early'))
    subscription = RawSubscription(ros.node(Node, 'listener'), channel, QoSProfile(depth=3))
    taken: list[Message] = []

    def is_received() -> bool:  # the publisher may be matched before the subscription is
        publisher.publish(String(data='first'))
        taken.extend(subscription.drain())
        return bool(taken)

    ros.spin_until(is_received, 'the first message')
    for number in range(100):  # the subscription keeps the last three
        publisher.publish(String(data=str(number)))
    ros.spin_until(
        lambda: taken.extend(subscription.drain())
        or taken[-1].sequence >= taken[0].sequence + 100,
        'the last message',
    )
    subscription.poll_losses()
    assert subscription.received == len(taken)
    assert taken[0].sequence > 7
    missing = taken[-1].sequence - taken[0].sequence + 1 - len(taken)
    assert subscription.lost == missing > 0
    subscription.close()


def test_topic_of_two_types_is_refused_and_reported_once(ros, talker, subscribe) -> None:
    talker.create_publisher(String, '/talk', 1)
    early, late = subscribe('/talk'), subscribe('/talk')
    ros.spin_until(lambda: early.discover() or bool(list(early)), 'the first type')
    others = type(ros)(ros.domain_id)  # one participant publishes one type
    others.node(Node, 'other').create_publisher(Clock, '/talk', 1)
    ros.spin_until(
        lambda: dict(talker.get_topic_names_and_types()).get('/talk', [''])[1:],
        'discovery of the second type',
    )
    for subscriptions, words in ((late, 'several types'), (early, 'rosgraph_msgs/msg/Clock')):
        ros.spin_until(lambda s=subscriptions: s.discover() or s.refused, words)
        assert [words in reason for reason in subscriptions.refused.values()] == [True]
    others.close()


def test_no_message_is_read_before_the_clock_starts(ros, talker, subscribe) -> None:
    publisher = talker.create_publisher(String, '/talk', LATCHED)
    publisher.publish(String())
    subscriptions = subscribe('/talk', ros_args=('-p', 'use_sim_time:=true'))
    ros.spin_until(lambda: subscriptions.discover() or bool(list(subscriptions)), 'the topic')
    assert subscriptions.drain() == []
    clock = talker.create_publisher(Clock, '/clock', 10)
    ros.spin_until(lambda: clock.get_subscription_count() > 0, 'the follower')
    clock.publish(Clock(clock=time_to_msg(5 * SECOND)))
    (message,) = take(ros, subscriptions, 1)
    assert (message.log_time, message.publish_time) == (5 * SECOND, 5 * SECOND)
