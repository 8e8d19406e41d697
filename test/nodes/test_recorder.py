# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The recorder in this process; an independent reader reads its bags."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
import shutil
import threading
from typing import Any

from bags import notes, saved
from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_nodes import rules
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.configuration.interface import RECORDER_SERVICES, RECORDER_TOPICS
from soft_throw_ros.nodes import recorder as recorder_module
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.nodes.recorder import Recorder
from soft_throw_ros.storage.message import Message
from std_msgs.msg import String

TYPES = get_typestore(Stores.ROS2_JAZZY)
BEST_EFFORT = QoSProfile(depth=9, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=9, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATER = '/talk of a later publisher'


def texts(path: Path) -> list[str]:
    """Return the texts of the messages of a bag, read by an independent program."""
    with Reader(path) as reader:
        assert reader.ros_distro in ('jazzy', 'kilted')
        return [
            TYPES.deserialize_cdr(data, connection.msgtype).data
            for connection, _time, data in reader.messages()
        ]


@pytest.fixture
def recorder(ros: Any, tmp_path: Path) -> Callable[..., Recorder]:
    """Return a function that starts a recorder of `/talk` and the topics below it."""

    def start(*words: str, **parameters: Any) -> Recorder:
        values = {'folder': tmp_path, 'topics': ['/talk'], **parameters}
        node = ros.node(Recorder, ros_args=(*words, *rules(**values)))
        node.start()
        return node

    return start


def say(ros: Any, recorder: Recorder, publisher: Any, contents: list[str]) -> None:
    """Publish texts, and wait until the recorder has them."""
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    subscriptions = recorder.recording.subscriptions
    before = subscriptions.received
    for text in contents:
        publisher.publish(String(data=text))
    ros.spin_until(lambda: subscriptions.received >= before + len(contents), 'the messages')


def test_services_start_and_stop_bags_of_the_present_parameters_and_overwrite_none(
    ros, recorder, talker, tmp_path
) -> None:
    node = recorder('-r', '__ns:=/rig1', start='false', name='first', topics=['twin'])
    listener = ros.listen_to(node)
    listener.listen(RECORDER_TOPICS.status)  # latched
    assert not list(tmp_path.iterdir())
    publisher = talker.create_publisher(String, '/rig1/twin/phase', 100)
    talker.create_publisher(String, '/rig2/twin/phase', 100).publish(String())
    start, stop = RECORDER_SERVICES.start, RECORDER_SERVICES.stop
    for service, is_accepted, words, name in (
        (stop, False, 'nothing has been recorded', 'first'),
        (start, True, str(tmp_path / 'first'), 'second'),
        (start, False, 'already', 'second'),
        (stop, True, '1 messages', 'second'),
        (start, True, str(tmp_path / 'second'), ''),
        (stop, True, '1 messages', ''),
        (start, True, str(tmp_path / 'soft_throw_20'), 'first'),
        (stop, True, '1 messages', 'first'),
        (start, False, 'never overwritten', 'first'),
    ):
        response = listener.trigger(service)
        assert (response.success, words in response.message) == (is_accepted, True), response
        node.parameters.apply({'name': name})
        if service is start and is_accepted:
            say(ros, node, publisher, [words])
    assert [texts(path) for path in sorted(tmp_path.iterdir())] == [
        [str(tmp_path / name)] for name in ('first', 'second', 'soft_throw_20')
    ]
    statuses = [message.status[0] for message in listener.hear(RECORDER_TOPICS.status, 7)]
    assert [msg_to_values(status)['is_recording'] for status in statuses] == [
        False, True, False, True, False, True, False
    ]


def test_losses_are_in_diagnostics_and_bag(
    ros, recorder, talker, monkeypatch
) -> None:
    node = recorder(name='bag')
    listener = ros.listen_to(node)
    listener.listen(RECORDER_TOPICS.diagnostics)

    def has(task: str, level: bytes, **values: int) -> None:
        listener.status(
            RECORDER_TOPICS.diagnostics,
            task,
            lambda s: s.level == level and values.items() <= msg_to_values(s).items(),
        )

    say(ros, node, talker.create_publisher(String, '/talk', 100), ['a', 'b', 'c'])
    has('losses', DiagnosticStatus.OK, lost=0)
    has('bag', DiagnosticStatus.OK, messages=3, topics=1)
    monkeypatch.setattr(node.recording, 'losses', lambda: Counter({'/talk': 2}))
    has('losses', DiagnosticStatus.WARN, **{'lost': 2, '/talk': 2})
    path = node.recording.bag
    node.close()
    assert notes(path)['losses'] == {'total': '2', '/talk': '2'}


def test_process_that_is_present_and_sends_nothing_is_reported_once(
    ros, recorder, monkeypatch
) -> None:
    monkeypatch.setattr(recorder_module, 'SILENCE_LIMIT', 1)
    monkeypatch.setattr(recorder_module, 'PUBLISHER_TIMEOUT', 0.0)
    node = recorder(name='bag', topics=['/talk', '/silence'])
    listener = ros.listen_to(node)
    log = listener.log()
    listener.listen(RECORDER_TOPICS.diagnostics)
    others = type(ros)(ros.domain_id)  # a participant of its own
    talker = others.node(Node, 'quiet')
    say(ros, node, talker.create_publisher(String, '/talk/quiet', 1), ['a'])
    talker.create_publisher(String, '/talk/once', LATCHED)
    warning = listener.status(
        RECORDER_TOPICS.diagnostics, 'losses', lambda item: item.level == DiagnosticStatus.WARN
    )
    assert warning.message.endswith(' /talk/quiet')
    listener.hear(RECORDER_TOPICS.diagnostics, len(listener.heard['/diagnostics']) + 2)
    assert sum('/talk/quiet' in line for line in log) == 1
    assert sum('nothing is published yet on /silence' in line for line in log) == 1
    others.close()
    ros.spin_until(lambda: not node.recording.silent_topics, 'the end of the participant')


def test_deleted_bag_is_a_failure(ros, recorder, talker, tmp_path) -> None:
    node = recorder(name='bag')
    listener = ros.listen_to(node)
    say(ros, node, talker.create_publisher(String, '/talk', 100), ['a'])
    ros.spin_until(lambda: len(saved(tmp_path / 'bag')) == 1, 'the message in the bag')
    shutil.rmtree(tmp_path / 'bag')
    response = listener.trigger(RECORDER_SERVICES.stop)
    assert not response.success
    assert 'No such file' in response.message
    assert node.exit_code is None  # it can record again
    assert listener.trigger(RECORDER_SERVICES.start).success
    assert listener.trigger(RECORDER_SERVICES.stop).success
    node.close()
    assert node.exit_code == 1


@pytest.mark.filterwarnings('ignore:Deprecated in favor of:DeprecationWarning')  # rclpy's own
@pytest.mark.parametrize(('first', 'second'), [(LATCHED, 9), (9, BEST_EFFORT)])
def test_later_publisher_of_another_quality_of_service_is_reported_as_missing(
    ros, recorder, talker, first, second
) -> None:
    node = recorder()
    listener = ros.listen_to(node)
    log = listener.log()
    publisher = talker.create_publisher(String, '/talk', first)
    say(ros, node, publisher, ['a'])
    bag = node.recording.bag
    later = talker.create_publisher(String, '/talk', second)
    ros.spin_until(lambda: any(LATER in line for line in log), 'the warning')
    later.publish(String(data='b'))
    say(ros, node, publisher, ['c'])
    response = listener.trigger(RECORDER_SERVICES.stop)
    assert response.success
    assert LATER in response.message
    assert texts(bag) == ['a', 'c']
    assert LATER in notes(bag)['not recorded']
    assert listener.trigger(RECORDER_SERVICES.start).success
    bag = node.recording.bag
    for one in (publisher, later):
        say(ros, node, one, ['d'])
    node.close()
    assert texts(bag)[-2:] == ['d', 'd']
    assert sum(LATER in line for line in log) == 2  # the warning and the count


def test_end_saves_all_messages_before_anything_that_takes_time(
    ros, recorder, talker, tmp_path, monkeypatch
) -> None:
    node = recorder(name='bag')
    publisher = talker.create_publisher(String, '/talk', 100)
    say(ros, node, publisher, ['a'])
    subscriptions, drained = node.recording.subscriptions, threading.Event()
    drain, close = subscriptions.drain, subscriptions.close

    def drain_and_pause() -> list[Message]:
        messages = drain()
        monkeypatch.setattr(recorder_module, '_DRAIN_TIME', 60.0)
        drained.set()
        return messages

    def close_late() -> None:
        ros.spin_until(lambda: len(saved(tmp_path / 'bag')) == 2, 'the messages in the bag')
        close()

    monkeypatch.setattr(subscriptions, 'drain', drain_and_pause)
    monkeypatch.setattr(subscriptions, 'close', close_late)
    assert drained.wait(60.0)
    publisher.publish(String(data='b'))
    assert publisher.wait_for_all_acked(Duration(seconds=60.0))
    node.close()
    assert texts(tmp_path / 'bag') == ['a', 'b']
