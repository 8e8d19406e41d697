# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Playback of bags to nodes in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from functools import partial
from pathlib import Path
import sys
from typing import Any

import bags
from bags import BEGIN, channel, text
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import REPLAY_SERVICES, resolve
from soft_throw_ros.nodes.conversions import msg_to_time
from soft_throw_ros.nodes.player import Player
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import Channel, Message, SECOND
from std_msgs.msg import String
from std_srvs.srv import Trigger

write = partial(bags.write, compression='none')
EVERYTHING = QoSProfile(depth=5000)

FAST = channel('/fast', depth=5000)
SLOW = channel('/slow', durability='transient_local', depth=3)
LOSSY = channel('/lossy', reliability='best_effort', depth=7)


def messages(count: int = 1000) -> list[Message]:
    """Make a message every millisecond, and others every tenth of a second."""
    made = []
    for number in range(count):
        time = BEGIN + number * 1_000_000
        made.append(Message(FAST, text(f'fast {number}'), time, time))
        if number % 100 == 0:
            made.append(Message(SLOW, text(f'slow {number}'), time, time))
            made.append(Message(LOSSY, text(f'lossy {number}'), time, time))
    return made


def datas(made: list[Message], topic: str) -> list[bytes]:
    return [message.data for message in made if message.channel.topic == topic]


@pytest.fixture
def listener(ros: Any) -> Node:
    return ros.node(Node, 'listener')


def listen(listener: Node, topic: str, qos: QoSProfile = EVERYTHING) -> list[bytes]:
    """Subscribe to a topic and return the list that will receive its messages as bytes."""
    heard: list[bytes] = []
    listener.create_subscription(String, topic, heard.append, qos, raw=True)
    return heard


@pytest.fixture
def play(ros: Any) -> Iterator[Callable[..., Player]]:
    """Return a function that plays a bag to a number of subscribers."""
    readers = contextlib.ExitStack()

    def play(path: Path, listeners: int = 0, **options: Any) -> Player:
        reader = readers.enter_context(BagReader(path))
        player = ros.node(Player, reader, **options)
        publishers = list(player.publishers)
        ros.spin_until(
            lambda: sum(item.get_subscription_count() for item in publishers) >= listeners,
            'the listeners',
        )
        player.start()
        return player

    yield play
    readers.close()


def finish(ros: Any, player: Player) -> int:
    ros.spin_until(lambda: player.exit_code is not None, 'the end of the bag')
    assert player.exit_code is not None
    return player.exit_code


def test_bag_is_played_byte_by_byte_with_its_qualities_of_service(
    ros, listener, play, tmp_path, capfd
) -> None:
    unknown = channel('/unknown', durability='transient_local', history='unknown', depth=0)
    made = messages()
    made += [message._replace(channel=unknown) for message in made[:50]]
    made.sort(key=lambda message: message.log_time)
    heard = {topic: listen(listener, topic) for topic in ('/fast', '/slow')}
    player = play(write(tmp_path / 'bag', made), 2, rate=10.0)
    assert finish(ros, player) == 0
    for topic, received in heard.items():
        sent = datas(made, topic)
        ros.spin_until(lambda r=received, s=sent: len(r) == len(s), topic)
        assert received == sent
    for topic, is_latched, is_reliable in (
        ('/fast', False, True), ('/slow', True, True), ('/lossy', False, False)
    ):
        (information,) = listener.get_publishers_info_by_topic(topic)
        offer = information.qos_profile
        assert (offer.durability is DurabilityPolicy.TRANSIENT_LOCAL) == is_latched
        assert (offer.reliability is ReliabilityPolicy.RELIABLE) == is_reliable
    # Late subscribers get the publisher's history, or all messages if the bag has no history depth
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    slow, kept = listen(listener, '/slow', latched), listen(listener, '/unknown', latched)
    ros.spin_until(lambda: len(slow) == 3 and len(kept) == 50, 'receipt of latched messages')
    assert slow == datas(made, '/slow')[-3:]
    player.close()
    assert f'{len(made)} messages of 4 topics played' in capfd.readouterr().err


def test_clock_topic_has_the_time_of_the_bag_instead_of_a_recorded_clock(
    ros, listener, play, tmp_path
) -> None:
    made = messages(500)
    recorded = channel('/clock', 'rosgraph_msgs/msg/Clock')
    made.insert(250, Message(recorded, b'\0\1\0\0' + bytes(8), BEGIN + SECOND // 4, BEGIN))
    stamps: list[int] = []
    listener.create_subscription(
        Clock, '/clock', lambda message: stamps.append(msg_to_time(message.clock)), EVERYTHING
    )
    player = play(write(tmp_path / 'bag', made), 1, clock=200.0, rate=0.5)
    assert finish(ros, player) == 0
    assert stamps == sorted(stamps)
    assert BEGIN <= stamps[0] < stamps[-1] <= BEGIN + SECOND // 2
    assert len(set(stamps)) > 10
    assert player.played == len(made) - 1


def test_paused_bag_is_resumed_and_only_requested_topics_are_played(
    ros, listener, play, tmp_path
) -> None:
    pause, resume = (
        partial(ros.call, listener.create_client(Trigger, resolve(service.name, '/replay')),
                Trigger.Request())
        for service in REPLAY_SERVICES
    )
    fast, slow = listen(listener, '/fast'), listen(listener, '/slow')
    path = write(tmp_path / 'bag', messages(300))
    player = play(path, 1, paused=True, topics=['/fast'], rate=0.5)
    assert '0.000 s of 0.299 s' in pause().message
    assert (player.played, player.exit_code) == (0, None)
    assert resume().success
    ros.spin_until(lambda: player.played > 10, 'start of playback')
    assert pause().success
    played = player.played
    assert pause().success  # no message arrived during the call
    assert player.played == played
    assert resume().success
    assert finish(ros, player) == 0
    ros.spin_until(lambda: len(fast) == 300, 'receipt of all messages')
    assert fast == [text(f'fast {number}') for number in range(300)]
    assert slow == []


def test_unplayable_topics_are_skipped_and_reported(ros, play, tmp_path, capfd) -> None:
    made = messages(100)
    string = find_schema('std_msgs/msg/String', installed_prefixes())
    strange = [
        Channel(topic='/strange', type='no_such_msgs/msg/Thing', schema='int32 x'),
        Channel(topic='/action', type='no_such_msgs/action/Go_FeedbackMessage', schema=''),
        Channel(topic='/odd', type='Thing', schema=''),
        Channel(topic='/code', type='this/msg/Thing', schema=''),
        Channel(topic='bad name', type='std_msgs/msg/String', schema=string.text),
        Channel(topic='/otherwise', type='std_msgs/msg/String', schema='', type_hash='RIHS01_ab'),
        channel('/deep', depth=2**40),
        channel('/by_node', liveliness='manual_by_node'),
        channel('/late', deadline=-5),
    ]
    for item in strange:
        made += [Message(item, text('?'), BEGIN, BEGIN)] * 2
    player = play(write(tmp_path / 'bag', sorted(made, key=lambda message: message.log_time)))
    assert finish(ros, player) == 0
    reasons = {item.topic: reason for item, reason in player.skipped.items()}
    assert 'this' not in sys.modules  # a bag imports nothing
    for topic in ('/strange', '/action', '/odd', '/code'):
        (kind,) = (item.type for item in strange if item.topic == topic)
        assert reasons[topic] == f'{kind} is not installed here'
    assert {'bad name', '/deep'} <= set(reasons)
    printed = capfd.readouterr().err
    for topic, reason in reasons.items():
        assert f'{topic} is skipped: {reason}' in printed
    assert player.played == len(made) - 2 * len(reasons)
    nothing = [Message(strange[0], b'', BEGIN, BEGIN)]
    assert finish(ros, play(write(tmp_path / 'nothing', nothing))) == 1


def test_damaged_bag_is_played_up_to_the_damage(
    ros, listener, play, tmp_path, capfd
) -> None:
    made = messages(5000)
    (file,) = write(tmp_path / 'bag', made).glob('*.mcap')
    file.write_bytes(file.read_bytes().replace(b'fast 2500', b'fast 25oo'))
    heard = listen(listener, '/fast')
    player = play(tmp_path / 'bag', 1, rate=20.0)
    assert finish(ros, player) == 1
    assert str(file) in capfd.readouterr().err
    assert player.played == 2000
    kept = datas(made[:2000], '/fast')
    ros.spin_until(lambda: len(heard) == len(kept), 'receipt of all undamaged messages')
    assert heard == kept
