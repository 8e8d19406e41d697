# SPDX-License-Identifier: Apache-2.0
"""Raw messages from real publishers, and the count of those that did not come."""

from __future__ import annotations

import sys
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.nodes import taps
from soft_throw_ros.nodes.conversions import time_to_msg
from soft_throw_ros.nodes.taps import fitting_profile, is_wanted, message_type, Tap, Taps
from soft_throw_ros.nodes.topics import qos_profile
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


def take(ros: Any, tapped: Taps, node: Node, count: int) -> list[Message]:
    """Find topics and drain them until so many messages have come."""
    taken: list[Message] = []

    def is_enough() -> bool:
        tapped.discover()
        taken.extend(tapped.drain(node.get_clock()))
        return len(taken) >= count

    ros.spin_until(is_enough, f'{count} messages')
    return taken


def test_messages_are_the_bytes_that_were_published(ros, talker, listener) -> None:
    publisher = talker.create_publisher(String, '/talk', LATCHED)
    for number in range(5):
        publisher.publish(String(data=f'number {number}'))
    tapped = Taps(listener, ['/talk'])
    messages = take(ros, tapped, listener, 5)
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
    assert [(qos.reliability, qos.durability) for qos in channel.qos] == [
        ('reliable', 'transient_local')
    ]
    tapped.close()


def test_topics_of_the_twin_are_known_in_full(ros, talker, listener) -> None:
    publisher = talker.create_publisher(
        String, '/rig1/twin/journal', qos_profile(TWIN_TOPICS.journal)
    )
    publisher.publish(String())
    tapped = Taps(listener, ['/rig1'])
    (message,) = take(ros, tapped, listener, 1)
    assert message.channel.qos[0].history == 'keep_last'
    assert message.channel.qos[0].depth == 1000
    tapped.close()


def test_topics_are_found_when_they_appear(ros, talker, listener) -> None:
    tapped = Taps(listener, ['/talk'])
    assert tapped.discover() == []
    talker.create_publisher(String, '/talk/one', LATCHED).publish(String(data='1'))
    assert [item.channel.topic for item in take(ros, tapped, listener, 1)] == ['/talk/one']
    talker.create_publisher(String, '/talk/two', LATCHED).publish(String(data='2'))
    talker.create_publisher(String, '/talker', LATCHED).publish(String(data='3'))
    assert [item.channel.topic for item in take(ros, tapped, listener, 1)] == ['/talk/two']
    tapped.close()


def test_messages_come_in_the_order_of_their_reception(ros, talker, listener) -> None:
    publishers = [talker.create_publisher(String, f'/talk/{name}', LATCHED) for name in 'abc']
    tapped = Taps(listener, ['/talk'])
    ros.spin_until(lambda: not tapped.discover() and len(list(tapped)) == 3, 'three topics')
    ros.spin_until(lambda: all(p.get_subscription_count() for p in publishers), 'subscriptions')
    for number in range(30):
        publishers[number % 3].publish(String(data=str(number)))
    messages = take(ros, tapped, listener, 30)
    times = [item.log_time for item in messages]
    assert times == sorted(times)
    tapped.close()


def test_loss_is_counted_by_the_numbers_of_the_publisher(
    ros, talker, listener, monkeypatch
) -> None:
    monkeypatch.setattr(taps, 'DEPTH', 5)
    publisher = talker.create_publisher(String, '/talk', 100)
    tapped = Taps(listener, ['/talk'])
    ros.spin_until(lambda: not tapped.discover() and bool(list(tapped)), 'the topic')
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    publisher.publish(String(data='first'))
    taken = take(ros, tapped, listener, 1)
    for number in range(100):  # and nobody takes them
        publisher.publish(String(data=str(number)))
    last = None
    while last != 101:
        taken += take(ros, tapped, listener, 1)
        last = taken[-1].sequence
    (tap,) = tapped
    assert tap.received == len(taken)
    assert tap.lost == 101 - len(taken) > 0
    tapped.close()


def test_publisher_that_begins_anew_has_lost_nothing(ros, talker, listener) -> None:
    tapped = Taps(listener, ['/talk'])
    for _ in range(2):
        publisher = talker.create_publisher(String, '/talk', LATCHED)
        for number in range(3):
            publisher.publish(String(data=str(number)))
        assert len(take(ros, tapped, listener, 3)) == 3
        talker.destroy_publisher(publisher)
    (tap,) = tapped
    assert tap.lost == 0
    tapped.close()


def test_numbers_of_several_publishers_are_not_taken_for_losses(ros, talker, listener) -> None:
    first = talker.create_publisher(String, '/talk', LATCHED)
    for _ in range(8):
        first.publish(String())
    second = talker.create_publisher(String, '/talk', LATCHED)
    tapped = Taps(listener, ['/talk'])
    ros.spin_until(lambda: len(listener.get_publishers_info_by_topic('/talk')) == 2, 'both')
    take(ros, tapped, listener, 8)
    for _ in range(3):
        second.publish(String())
        first.publish(String())
    take(ros, tapped, listener, 6)
    (tap,) = tapped
    assert tap.is_shared
    assert tap.lost == 0
    tapped.close()


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


def test_topic_of_two_types_is_refused_and_told_once(ros, start, talker, listener) -> None:
    talker.create_publisher(String, '/talk', 1)
    start(sys.executable, '-c', OTHER_TYPE)
    ros.spin_until(lambda: dict(listener.get_topic_names_and_types()).get('/talk', [''])[1:], 'it')
    tapped = Taps(listener, ['/talk'])
    assert tapped.discover() == ['/talk']
    assert 'several types' in tapped.refused['/talk']
    assert tapped.discover() == []


def test_messages_that_are_not_installed_are_refused(listener) -> None:
    with pytest.raises(ImportError, match='no_such_msgs/msg/Thing are not installed'):
        message_type('no_such_msgs/msg/Thing')
    with pytest.raises(ImportError, match='std_msgs/msg/Thing'):
        Tap(listener, Channel(topic='/a', type='std_msgs/msg/Thing', schema=''), LATCHED)


@pytest.mark.parametrize(
    ('topic', 'wanted', 'answer'),
    [
        ('/twin/phase', ['/twin'], True),
        ('/twin/phase', ['/twin/'], True),
        ('/twin/phase', ['/twin/phase'], True),
        ('/twins/phase', ['/twin'], False),
        ('/rig1/twin/phase', ['/twin'], False),
        ('/rosout', ['/'], True),
        ('/_hidden', ['/'], False),
        ('/twin/_hidden/topic', ['/twin'], False),
        ('/_hidden', ['/_hidden'], True),
        ('/rosout', [], False),
    ],
)
def test_namespaces_stand_for_what_is_in_them(topic, wanted, answer) -> None:
    assert is_wanted(topic, wanted) is answer


def test_nothing_is_taken_before_the_clock_goes(ros, talker) -> None:
    listener = ros.node(Node, 'follower', ros_args=('-p', 'use_sim_time:=true'))
    publisher = talker.create_publisher(String, '/talk', LATCHED)
    publisher.publish(String())
    tapped = Taps(listener, ['/talk'])
    ros.spin_until(lambda: not tapped.discover() and bool(list(tapped)), 'the topic')
    assert tapped.drain(listener.get_clock()) == []
    clock = talker.create_publisher(Clock, '/clock', 10)
    ros.spin_until(lambda: clock.get_subscription_count() > 0, 'the follower')
    clock.publish(Clock(clock=time_to_msg(5 * 10**9)))
    (message,) = take(ros, tapped, listener, 1)
    assert (message.log_time, message.publish_time) == (5 * 10**9, 5 * 10**9)
    tapped.close()
