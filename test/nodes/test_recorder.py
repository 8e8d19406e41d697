# SPDX-License-Identifier: Apache-2.0
"""The recorder in this process; what it writes is read by somebody else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.configuration import ParameterError
from soft_throw_ros.nodes import raw_subscriptions, topics
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.nodes.recorder import Recorder
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.message import Message
from std_msgs.msg import String
from std_srvs.srv import Trigger

TYPES = get_typestore(Stores.ROS2_JAZZY)


class Recorded:
    """A bag, as another program reads it."""

    def __init__(self, path: Path) -> None:
        self.messages: dict[str, list[Any]] = {}
        self.bytes: dict[str, list[bytes]] = {}
        with Reader(path) as reader:
            self.distribution = reader.ros_distro
            for connection, _time, data in reader.messages():
                decoded = TYPES.deserialize_cdr(data, connection.msgtype)
                self.messages.setdefault(connection.topic, []).append(decoded)
                self.bytes.setdefault(connection.topic, []).append(bytes(data))


@pytest.fixture
def recorder(ros: Any, tmp_path: Path) -> Callable[..., Recorder]:
    """Start a recorder of `/talk` and what is in it."""

    def start(**parameters: Any) -> Recorder:
        given = {'folder': tmp_path, 'topics': ['/talk'], **parameters}
        rules = [f'{name.replace("__", ".")}:={value}' for name, value in given.items()]
        ros_args = tuple(word for rule in rules for word in ('-p', rule))
        node = ros.node(Recorder, ros_args=ros_args, arguments=('--ros-args', *ros_args))
        node.start()
        return node

    return start


@pytest.fixture
def talker(ros: Any) -> Node:
    return ros.node(Node, 'talker')


def ask(ros: Any, node: Node, recorder: Node, service: str) -> Trigger.Response:
    """Call a service of the recorder."""
    name = service.replace('~', recorder.get_fully_qualified_name())
    return ros.call(node.create_client(Trigger, name), Trigger.Request())


def say(ros: Any, recorder: Recorder, publisher: Any, texts: list[str]) -> None:
    """Publish texts, and wait until the recorder has them."""
    recording = recorder.recording
    assert recording is not None
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    before = recording.received
    for text in texts:
        publisher.publish(String(data=text))
    ros.spin_until(lambda: recording.received >= before + len(texts), 'the messages')


def test_what_is_published_is_in_the_bag(ros, recorder, talker, tmp_path) -> None:
    node = recorder(name='bag')
    publisher = talker.create_publisher(String, '/talk', 100)
    texts = [f'number {number}' for number in range(50)]
    say(ros, node, publisher, texts)
    node.close()
    recorded = Recorded(tmp_path / 'bag')
    assert [message.data for message in recorded.messages['/talk']] == texts
    assert recorded.distribution in ('jazzy', 'kilted')


def test_bag_is_named_by_the_time_and_never_overwritten(ros, recorder, talker, tmp_path) -> None:
    node = recorder()
    publisher = talker.create_publisher(String, '/talk', 100)
    for number in range(3):
        say(ros, node, publisher, [str(number)])
        assert ask(ros, talker, node, topics.STOP).success
        assert ask(ros, talker, node, topics.START).success
    node.close()
    bags = sorted(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    assert len(bags) == 4
    assert all(path.name.startswith('soft_throw_20') for path in bags)
    said = [Recorded(path).messages.get('/talk', []) for path in bags]
    assert [[message.data for message in messages] for messages in said] == [
        ['0'], ['1'], ['2'], [],
    ]  # fmt: skip


def test_recorder_waits_to_be_started(ros, recorder, talker, tmp_path) -> None:
    node = recorder(start='false', name='bag')
    assert node.recording is None
    assert not list(tmp_path.iterdir())
    refused = ask(ros, talker, node, topics.STOP)
    assert not refused.success
    assert refused.message == 'nothing is being recorded; nothing has been recorded yet'
    started = ask(ros, talker, node, topics.START)
    assert (started.success, started.message) == (True, f'recording into {tmp_path / "bag"}')
    again = ask(ros, talker, node, topics.START)
    assert not again.success
    assert 'already recording' in again.message
    stopped = ask(ros, talker, node, topics.STOP)
    assert stopped.success
    assert '0 messages' in stopped.message
    assert '0 lost' in stopped.message
    third = ask(ros, talker, node, topics.START)
    assert not third.success
    assert 'exists, and a bag is never overwritten' in third.message


def test_status_reaches_who_comes_late(ros, recorder, tmp_path) -> None:
    node = recorder(name='bag')
    late = ros.node(Node, 'late')
    heard: list[Any] = []
    late.create_subscription(
        topics.STATUS.type, '/recorder/status', heard.append, topics.STATUS.qos
    )
    ros.spin_until(lambda: bool(heard), 'the status')
    (status,) = heard[0].status
    assert status.message == f'recording into {tmp_path / "bag"}'
    assert msg_to_values(status)['is_recording'] is True
    node.end()
    ros.spin_until(lambda: len(heard) > 1, 'the next status')
    assert msg_to_values(heard[1].status[0])['is_recording'] is False


def test_diagnostics_tell_what_was_lost(ros, recorder, talker) -> None:
    node = recorder(name='bag')
    publisher = talker.create_publisher(String, '/talk', 100)
    say(ros, node, publisher, ['a', 'b', 'c'])
    bag, losses = node._statuses()
    assert (bag.level, losses.level) == (DiagnosticStatus.OK, DiagnosticStatus.OK)
    assert msg_to_values(bag)['messages'] == 3
    assert msg_to_values(losses) == {'lost': 0}
    (subscription,) = node.recording.subscriptions
    subscription._gaps = 2  # as if two had not come
    losses = node._statuses()[1]
    assert losses.level == DiagnosticStatus.WARN
    assert msg_to_values(losses) == {'lost': 2, '/talk': 2}
    path = node.recording.bag
    node.close()
    with BagReader(path) as bag:
        notes = {item.name: item.metadata for item in bag.metadata}
    assert notes['losses'] == {'total': '2', '/talk': '2'}


def test_parameters_of_the_next_recording_may_be_changed(ros, recorder, talker, tmp_path) -> None:
    node = recorder(name='first')
    client = ros.parameters(node)
    assert client.set(name='second', compression='none', topics=['/other']) == [''] * 3
    assert node.recording.bag == tmp_path / 'first'
    node.end()
    node.begin()
    assert node.recording.bag == tmp_path / 'second'
    publisher = talker.create_publisher(String, '/other', 100)
    say(ros, node, publisher, ['a'])
    node.close()
    assert list(Recorded(tmp_path / 'second').messages) == ['/other']


def test_recorder_with_nothing_to_do_is_refused(recorder) -> None:
    with pytest.raises(ParameterError, match=r"storage and rerun\.sink are both 'none'"):
        recorder(storage='none')


def test_bag_that_exists_is_refused_at_the_start(recorder, tmp_path) -> None:
    (tmp_path / 'bag').mkdir()
    with pytest.raises(ParameterError, match='never overwritten'):
        recorder(name='bag')


def test_topic_that_cannot_be_recorded_is_told(ros, recorder, talker, monkeypatch, capfd) -> None:
    monkeypatch.setattr(raw_subscriptions, 'prefixes', list)
    node = recorder(name='bag')
    talker.create_publisher(String, '/talk', 1)
    ros.spin_until(lambda: '/talk' in node.recording.subscriptions.refused, 'the refusal')
    assert '/talk is not recorded: no definition of std_msgs/msg/String' in capfd.readouterr().err


def test_file_is_split_by_time(ros, recorder, talker, tmp_path) -> None:
    node = recorder(name='bag', split__duration=1.0)
    publisher = talker.create_publisher(String, '/talk', 100)
    said: list[str] = []

    def is_split() -> bool:
        said.append(str(len(said)))
        publisher.publish(String(data=said[-1]))
        return len(list((tmp_path / 'bag').glob('*.mcap'))) >= 3

    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    ros.spin_until(is_split, 'three files')
    ros.spin_until(lambda: node.recording.received == len(said), 'the messages')
    node.close()
    assert [item.data for item in Recorded(tmp_path / 'bag').messages['/talk']] == said


def test_twin_and_recorder_share_a_process(ros, recorder, tmp_path) -> None:
    node = recorder(name='bag', topics=['/twin', '/rosout'])
    twin = ros.node(Twin, ros_args=('-p', 'throw.period:=0.2'))
    publisher = twin._joint_states
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    twin.ticker.start()
    ros.spin_until(lambda: twin.session.throws >= 3, 'three throws')
    twin.ticker.stop(5.0)
    count = twin.session.step
    ros.spin_until(
        lambda: any(
            tap.channel.topic == '/twin/joint_states' and tap.received == count
            for tap in node.recording.subscriptions
        ),
        'all joint states',
    )
    ros.spin_until(lambda: not twin._jobs, 'the queue')
    node.close()
    recorded = Recorded(tmp_path / 'bag')
    stamps = [
        message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        for message in recorded.messages['/twin/joint_states']
    ]
    assert len(stamps) == count
    assert stamps == sorted(stamps)
    assert len(recorded.messages['/twin/throw_result']) >= 3
    with BagReader(tmp_path / 'bag') as bag:
        notes = {item.name: item.metadata for item in bag.metadata}
        files = {item.name: item.data.decode() for item in bag.attachments()}
    assert notes['parameters of /twin']['throw.period'] == '0.2'
    assert notes['versions of /twin']['python'] == sys.version.split()[0]
    assert 'period: 0.2' in files['twin.yaml']
    assert 'name: bag' in files['recorder.yaml']


@pytest.mark.parametrize(
    'line',
    ['', '[]', '{"kind":"throw","step":1,"settings":5,"versions":[]}', '{"kind":1,"step":null}'],
)
def test_journal_of_somebody_else_does_no_harm(ros, recorder, talker, tmp_path, line) -> None:
    node = recorder(name='bag')
    publisher = talker.create_publisher(String, '/talk/journal', 100)
    say(ros, node, publisher, [line, 'after'])
    assert node.exit_code is None
    node.close()
    said = [message.data for message in Recorded(tmp_path / 'bag').messages['/talk/journal']]
    assert said == [line, 'after']


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_recorder_that_stops_by_itself_has_an_exit_code(ros, recorder, monkeypatch) -> None:
    node = recorder(name='bag')

    def fail(*_: object) -> None:
        raise RuntimeError('a defect')

    assert node.exit_code is None
    monkeypatch.setattr(node.recording.subscriptions, 'drain', fail)
    ros.spin_until(lambda: node.exit_code == 1, 'the exit code')


def test_stream_is_shown_without_writing(ros, recorder, talker, tmp_path) -> None:
    shown = tmp_path / 'shown'
    viewer = tmp_path / 'viewer'
    viewer.write_text(f'#!/bin/sh\nexec cat > {shown}\n')
    viewer.chmod(0o755)
    node = recorder(storage='none', rerun__sink='viewer', rerun__python=viewer)
    publisher = talker.create_publisher(String, '/talk', 100)
    say(ros, node, publisher, ['a', 'b', 'c'])
    assert node._message() == 'showing only'
    node.close()
    with shown.open('rb') as stream:
        messages = [item for item in read_stream(stream) if isinstance(item, Message)]
    assert [deserialize_message(item.data, String).data for item in messages] == ['a', 'b', 'c']
    assert sorted(tmp_path.iterdir()) == [shown, viewer]
