# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The recorder in this process; an independent reader reads its bags."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import shutil
import subprocess
import sys
from typing import Any

from bags import saved
from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.configuration.interface import RECORDER_SERVICES, RECORDER_TOPICS
from soft_throw_ros.nodes import recording
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.nodes.recorder import Recorder
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.recording import writer_thread
from soft_throw_ros.storage.bag_reader import BagReader
from std_msgs.msg import String

TYPES = get_typestore(Stores.ROS2_JAZZY)


def read(path: Path) -> dict[str, list[Any]]:
    """Return the messages of a bag by topic, read by an independent program."""
    messages: dict[str, list[Any]] = {}
    with Reader(path) as reader:
        for connection, _time, data in reader.messages():
            decoded = TYPES.deserialize_cdr(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append(decoded)
    return messages


def texts(path: Path, topic: str = '/talk') -> list[str]:
    return [message.data for message in read(path).get(topic, [])]


@pytest.fixture
def recorder(ros: Any, tmp_path: Path) -> Callable[..., Recorder]:
    """Return a function that starts a recorder of `/talk` and the topics below it."""

    def start(*words: str, **parameters: Any) -> Recorder:
        values = {'folder': tmp_path, 'topics': ['/talk'], **parameters}
        rules = [f'{name.replace("__", ".")}:={value}' for name, value in values.items()]
        ros_args = (*words, *(word for rule in rules for word in ('-p', rule)))
        node = ros.node(Recorder, ros_args=ros_args, arguments=('--ros-args', *ros_args))
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


def test_bag_is_named_by_the_time_and_never_overwritten(
    ros, recorder, talker, tmp_path
) -> None:
    node = recorder()
    listener = ros.listen_to(node)
    publisher = talker.create_publisher(String, '/talk', 100)
    for number in range(3):
        say(ros, node, publisher, [str(number)])
        assert listener.trigger(RECORDER_SERVICES.stop).success
        assert listener.trigger(RECORDER_SERVICES.start).success
    node.close()
    bags = sorted(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    assert all(path.name.startswith('soft_throw_20') for path in bags)
    assert [texts(path) for path in bags] == [['0'], ['1'], ['2'], []]


def test_recorder_waits_for_its_start_and_reports_it(ros, recorder, tmp_path) -> None:
    node = recorder(start='false', name='bag')
    listener = ros.listen_to(node)
    listener.listen(RECORDER_TOPICS.status)  # latched
    assert node.recording is None
    assert not list(tmp_path.iterdir())
    start, stop = RECORDER_SERVICES.start, RECORDER_SERVICES.stop
    for service, is_accepted, words in (
        (stop, False, 'nothing has been recorded'),
        (start, True, str(tmp_path / 'bag')),
        (start, False, 'already'),
        (stop, True, '0 messages'),
        (start, False, 'never overwritten'),
    ):
        response = listener.trigger(service)
        assert (response.success, words in response.message) == (is_accepted, True), response
    statuses = [message.status[0] for message in listener.hear(RECORDER_TOPICS.status, 3)]
    assert [msg_to_values(status)['is_recording'] for status in statuses] == [False, True, False]


def test_losses_are_in_diagnostics_and_bag(
    ros, recorder, talker, monkeypatch
) -> None:
    node = recorder(name='bag')
    listener = ros.listen_to(node)
    listener.listen(RECORDER_TOPICS.diagnostics)

    def status(task: str, done: Callable[[Any], bool]) -> Any:
        return listener.status(
            RECORDER_TOPICS.diagnostics, task, lambda item: done(msg_to_values(item))
        )

    say(ros, node, talker.create_publisher(String, '/talk', 100), ['a', 'b', 'c'])
    assert status('losses', lambda values: values['lost'] == 0).level == DiagnosticStatus.OK
    assert msg_to_values(status('bag', lambda values: values['messages'] == 3))['topics'] == 1
    monkeypatch.setattr(node.recording, 'losses', lambda: {'/talk': 2})
    lost = status('losses', lambda values: values == {'lost': 2, '/talk': 2})
    assert lost.level == DiagnosticStatus.WARN
    path = node.recording.bag
    node.close()
    with BagReader(path) as bag:
        notes = {item.name: item.metadata for item in bag.metadata}
    assert notes['losses'] == {'total': '2', '/talk': '2'}


QUIET = """
import sys
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node('quiet')
publisher = node.create_publisher(String, '/talk/quiet', 1)
once = node.create_publisher(String, '/talk/once', rclpy.qos.QoSProfile(depth=1, durability=1))
while not publisher.get_subscription_count():
    pass
for _ in range(int(sys.argv[1])):
    publisher.publish(String())
sys.stdin.read()
"""


def test_process_that_is_present_and_sends_nothing_is_reported_once(
    ros, recorder, start, monkeypatch
) -> None:
    monkeypatch.setattr(recording, 'SILENCE_LIMIT', 1)
    monkeypatch.setattr(recording, 'PUBLISHER_TIMEOUT', 0.0)
    node = recorder(name='bag', topics=['/talk', '/silence'])
    listener = ros.listen_to(node)
    log = listener.log()
    listener.listen(RECORDER_TOPICS.diagnostics)
    process = start(sys.executable, '-c', QUIET, '1', stdin=subprocess.PIPE)
    warning = listener.status(
        RECORDER_TOPICS.diagnostics, 'losses', lambda item: item.level == DiagnosticStatus.WARN
    )
    assert warning.message.endswith(' /talk/quiet')
    listener.hear(RECORDER_TOPICS.diagnostics, len(listener.heard['/diagnostics']) + 2)
    assert sum('/talk/quiet' in line for line in log) == 1
    assert sum('nothing is published yet on /silence' in line for line in log) == 1
    process.close()
    ros.spin_until(lambda: not node.recording.silent_topics, 'the end of the process')
    node.close()


def test_parameters_of_the_next_recording_may_be_changed(ros, recorder, talker, tmp_path) -> None:
    node = recorder(name='first')
    client = ros.parameters(node)
    assert client.set(name='second', compression='none', topics=['/other']) == [''] * 3
    assert node.recording.bag == tmp_path / 'first'
    node.end()
    node.begin()
    say(ros, node, talker.create_publisher(String, '/other', 100), ['a'])
    node.close()
    assert list(read(tmp_path / 'second')) == ['/other']


def test_recorder_records_the_twin_in_its_own_namespace(ros, recorder, tmp_path) -> None:
    namespace, words = '/rig1', ('-r', '__ns:=/rig1')
    node = recorder(*words, name='bag', topics='[twin, /rosout]')
    twin = ros.node(Twin, ros_args=(*words, '-p', 'throw.period:=0.2'))
    other = ros.node(Twin, ros_args=('-r', '__ns:=/rig2'))
    name = f'{namespace}/twin'
    states = next(item for item in twin.publishers if item.topic_name == f'{name}/joint_states')
    ros.spin_until(lambda: states.get_subscription_count() > 0, 'the subscription')
    twin.ticker.start()
    ros.spin_until(lambda: twin.session.throws >= 3, 'three throws')
    twin.ticker.stop(5.0)
    received = {}

    def has_all() -> bool:
        received.update({tap.channel.topic: tap.received for tap in node.recording.subscriptions})
        states, results = (
            received.get(f'{name}/{one}') for one in ('joint_states', 'throw_result')
        )
        return states == twin.session.step and results >= 2

    ros.spin_until(has_all, 'all joint states and two results')
    node.close()
    recorded = read(tmp_path / 'bag')
    assert not any(topic.startswith(other.get_namespace()) for topic in recorded)
    stamps = [
        message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        for message in recorded[f'{name}/joint_states']
    ]
    assert len(stamps) == twin.session.step
    assert stamps == sorted(stamps)
    assert len(recorded[f'{name}/layer/joint_states'][0].name) == 64
    with Reader(tmp_path / 'bag') as bag:
        assert bag.ros_distro in ('jazzy', 'kilted')


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


BEST_EFFORT = QoSProfile(depth=9, reliability=ReliabilityPolicy.BEST_EFFORT)
LATER = '/talk of a later publisher'
LATCHED = QoSProfile(depth=9, durability=DurabilityPolicy.TRANSIENT_LOCAL)


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
    with BagReader(bag) as reader:
        notes = {item.name: item.metadata for item in reader.metadata}
    assert LATER in notes['not recorded']
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
    monkeypatch.setattr(writer_thread, 'FLUSH_PERIOD', 1e6)
    node = recorder(name='bag')
    say(ros, node, talker.create_publisher(String, '/talk', 100), ['a', 'b', 'c'])
    subscriptions = node.recording.subscriptions
    close = subscriptions.close

    def is_saved() -> bool:
        return len(saved(tmp_path / 'bag')) == 3

    def close_late() -> None:
        ros.spin_until(is_saved, 'the messages in the bag')
        close()

    monkeypatch.setattr(subscriptions, 'close', close_late)
    node.close()
    assert texts(tmp_path / 'bag') == ['a', 'b', 'c']
