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
"""Raw messages from real publishers, and the count of those that did not come."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import sys
import time
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.nodes.conversions import text_to_profiles, time_to_msg
from soft_throw_ros.nodes.raw_subscriptions import (
    fitting_profile,
    RawSubscription,
    RawSubscriptions,
)
from soft_throw_ros.nodes.topics import load_type, qos_profile
from soft_throw_ros.recording.message import Channel, Message
from std_msgs.msg import String

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def talker(ros: Any) -> Node:
    return ros.node(Node, 'talker')


@pytest.fixture
def listener(ros: Any) -> Node:
    return ros.node(Node, 'listener')


@pytest.fixture
def subscribe(listener: Node) -> Iterator[Callable[..., RawSubscriptions]]:
    """Give a function that subscribes to topics, until the test is over."""
    made: list[RawSubscriptions] = []

    def subscribe(*wanted: str, node: Node = listener) -> RawSubscriptions:
        made.append(RawSubscriptions(node, wanted))
        return made[-1]

    yield subscribe
    for item in made:
        item.close()


def take(ros: Any, subscriptions: RawSubscriptions, count: int) -> list[Message]:
    """Find topics and drain them until so many messages have come."""
    taken: list[Message] = []

    def is_enough() -> bool:
        subscriptions.discover()
        taken.extend(subscriptions.drain())
        return len(taken) >= count

    ros.spin_until(is_enough, f'{count} messages')
    return taken


def test_messages_are_the_bytes_that_were_published(ros, talker, listener, subscribe) -> None:
    publisher = talker.create_publisher(String, '/talk', LATCHED)
    for number in range(5):
        publisher.publish(String(data=f'number {number}'))
    subscriptions = subscribe('/talk')
    messages = take(ros, subscriptions, 5)
    assert [deserialize_message(item.data, String).data for item in messages] == [
        f'number {number}' for number in range(5)
    ]
    assert [item.sequence for item in messages] == [1, 2, 3, 4, 5]
    now = listener.get_clock().now().nanoseconds
    for item in messages:
        assert now - 60 * 10**9 < item.publish_time <= item.log_time <= now
    channel = messages[0].channel
    assert (channel.topic, channel.type) == ('/talk', 'std_msgs/msg/String')
    assert 'string data' in channel.schema
    assert channel.type_hash.startswith('RIHS01_')
    (profile,) = text_to_profiles(channel.qos)
    assert profile.reliability is ReliabilityPolicy.RELIABLE
    assert profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
    assert channel.is_latched


def test_history_of_our_own_topics_is_known(ros, talker, subscribe) -> None:
    journal = TWIN_TOPICS.journal
    talker.create_publisher(String, '/rig1/twin/journal', qos_profile(journal)).publish(String())
    (message,) = take(ros, subscribe('/rig1'), 1)
    (profile,) = text_to_profiles(message.channel.qos)
    assert (profile.history, profile.depth) == (HistoryPolicy.KEEP_LAST, journal.depth)


@pytest.mark.parametrize('joins_late', [True, False])
def test_loss_and_joining_late_are_counted_by_the_numbers_of_the_publisher(
    ros, talker, listener, joins_late
) -> None:
    began = time.time_ns()
    publisher = talker.create_publisher(String, '/talk', 100)
    for _ in range(7):
        publisher.publish(String(data='too early'))
    channel = Channel(topic='/talk', type='std_msgs/msg/String', schema='string data')
    subscription = RawSubscription(
        listener, channel, QoSProfile(depth=5), began_ns=None if joins_late else began
    )
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    taken: list[Message] = []
    while not taken:
        publisher.publish(String(data='first'))
        taken += subscription.drain()
    for number in range(100):  # and nobody takes them
        publisher.publish(String(data=str(number)))
    last = taken[-1].sequence + 100

    def is_over() -> bool:
        publisher.publish(String(data='last'))
        taken.extend(subscription.drain())
        return taken[-1].sequence > last

    ros.spin_until(is_over, 'the last one')
    assert subscription.received == len(taken)
    before = taken[0].sequence - 1
    assert before >= 7
    assert subscription.earlier == before * joins_late
    since = taken[-1].sequence - before * joins_late
    assert subscription.lost == since - len(taken) > 0
    subscription.close()


def test_publisher_that_begins_anew_has_lost_nothing(ros, talker, listener, subscribe) -> None:
    subscriptions = subscribe('/talk')
    for _ in range(2):
        publisher = talker.create_publisher(String, '/talk', LATCHED)
        for number in range(3):
            publisher.publish(String(data=str(number)))
        assert len(take(ros, subscriptions, 3)) == 3
        talker.destroy_publisher(publisher)
    (subscription,) = subscriptions
    assert subscription.lost == 0


def test_numbers_of_several_publishers_are_not_taken_for_losses(
    ros, talker, listener, subscribe
) -> None:
    first = talker.create_publisher(String, '/talk', LATCHED)
    for _ in range(8):
        first.publish(String())
    second = talker.create_publisher(String, '/talk', LATCHED)
    subscriptions = subscribe('/talk')
    ros.spin_until(lambda: len(listener.get_publishers_info_by_topic('/talk')) == 2, 'both')
    take(ros, subscriptions, 8)
    for _ in range(3):
        second.publish(String())
        first.publish(String())
    take(ros, subscriptions, 6)
    (subscription,) = subscriptions
    assert subscription.lost == 0


@pytest.mark.parametrize(
    ('topic', 'first', 'pause', 'lost'),
    [
        ('/twin/phase', 9, 0.0, 7),
        ('/twin/phase', 3, 1.2, 7),  # the other one begins above its last number
        ('/talk', 9, 0.0, 0),  # where many may publish at a time
    ],
)
def test_publisher_that_comes_after_another_one_is_counted_by_itself(
    ros, talker, listener, topic, first, pause, lost
) -> None:
    # both are there all the time, as one that was killed is for a while
    publishers = [talker.create_publisher(String, topic, 100) for _ in range(2)]
    began = time.time_ns()
    for _ in range(7):
        publishers[1].publish(String())
    channel = Channel(topic=topic, type='std_msgs/msg/String', schema='string data')
    subscription = RawSubscription(listener, channel, QoSProfile(depth=100), began_ns=began)
    ros.spin_until(lambda: all(p.get_subscription_count() > 0 for p in publishers), 'it')
    taken: list[Message] = []
    for publisher, number in zip(publishers, (first, 9), strict=True):
        for _ in range(number):
            publisher.publish(String())
        count = len(taken) + number
        ros.spin_until(
            lambda count=count: taken.extend(subscription.drain()) or len(taken) == count
        )
        time.sleep(pause)
    subscription.look_for_losses()
    is_told = None not in subscription._runs  # by publisher, from Kilted on
    assert subscription.lost == (7 if is_told else lost)
    assert subscription.earlier == 0
    subscription.close()


def test_loss_before_and_after_a_pause_is_that_of_one_publisher(ros, talker, listener) -> None:
    publisher = talker.create_publisher(String, '/twin/phase', 100)
    channel = Channel(topic='/twin/phase', type='std_msgs/msg/String', schema='string data')
    began = time.time_ns()
    subscription = RawSubscription(listener, channel, QoSProfile(depth=3), began_ns=began)
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    taken: list[Message] = []
    for pause in (1.2, 0.0):
        for _ in range(10):  # of which the last three are kept
            publisher.publish(String())
        count = len(taken) + 3
        ros.spin_until(
            lambda count=count: taken.extend(subscription.drain()) or len(taken) == count
        )
        time.sleep(pause)
    subscription.look_for_losses()
    assert subscription.lost + subscription.earlier == 14
    subscription.close()


def test_no_more_is_asked_for_than_every_publisher_offers(ros, talker, listener) -> None:
    for profile in (LATCHED, BEST_EFFORT):
        talker.create_publisher(String, '/talk', profile)
    ros.spin_until(lambda: len(listener.get_publishers_info_by_topic('/talk')) == 2, 'both')
    publishers = listener.get_publishers_info_by_topic('/talk')
    both = fitting_profile(publishers)
    assert both.reliability is ReliabilityPolicy.BEST_EFFORT
    assert both.durability is DurabilityPolicy.VOLATILE
    (latched,) = [
        item
        for item in publishers
        if item.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
    ]
    alone = fitting_profile([latched])
    assert alone.reliability is ReliabilityPolicy.RELIABLE
    assert alone.durability is DurabilityPolicy.TRANSIENT_LOCAL


OTHER_TYPE = """
import rclpy
from std_msgs.msg import Float64MultiArray
rclpy.init()
node = rclpy.create_node('other')
node.create_publisher(Float64MultiArray, '/talk', 1)
rclpy.spin(node)
"""


def test_topic_of_two_types_is_refused_and_told_once(
    ros, start, talker, listener, subscribe
) -> None:
    talker.create_publisher(String, '/talk', 1)
    start(sys.executable, '-c', OTHER_TYPE)
    ros.spin_until(lambda: dict(listener.get_topic_names_and_types()).get('/talk', [''])[1:], 'it')
    subscriptions = subscribe('/talk')
    assert subscriptions.discover() == ['/talk']
    assert 'several types' in subscriptions.refused['/talk']
    assert subscriptions.discover() == []


def test_messages_that_are_not_installed_are_refused() -> None:
    for name in (
        'no_such_msgs/msg/Thing',
        'std_msgs/msg/Thing',
        'no_such_msgs/action/Go',
        'Thing',
    ):
        with pytest.raises(ImportError, match=name):
            load_type(name)


def test_nothing_is_taken_before_the_clock_goes(ros, talker, subscribe) -> None:
    listener = ros.node(Node, 'follower', ros_args=('-p', 'use_sim_time:=true'))
    publisher = talker.create_publisher(String, '/talk', LATCHED)
    publisher.publish(String())
    subscriptions = subscribe('/talk', node=listener)
    ros.spin_until(lambda: not subscriptions.discover() and bool(list(subscriptions)), 'the topic')
    assert subscriptions.drain() == []
    clock = talker.create_publisher(Clock, '/clock', 10)
    ros.spin_until(lambda: clock.get_subscription_count() > 0, 'the follower')
    clock.publish(Clock(clock=time_to_msg(5 * 10**9)))
    (message,) = take(ros, subscriptions, 1)
    assert (message.log_time, message.publish_time) == (5 * 10**9, 5 * 10**9)
