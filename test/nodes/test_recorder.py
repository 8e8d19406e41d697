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
from soft_throw_ros.configuration.interface import RECORDER_SERVICES, RECORDER_TOPICS
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.nodes.recorder import Recorder
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.message import Message
from std_msgs.msg import String

TYPES = get_typestore(Stores.ROS2_JAZZY)


def read(path: Path) -> dict[str, list[Any]]:
    """Return the messages of a bag by their topics, as another program reads them."""
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
    """Start a recorder of `/talk` and what is in it."""

    def start(*words: str, **parameters: Any) -> Recorder:
        given = {'folder': tmp_path, 'topics': ['/talk'], **parameters}
        rules = [f'{name.replace("__", ".")}:={value}' for name, value in given.items()]
        ros_args = (*words, *(word for rule in rules for word in ('-p', rule)))
        node = ros.node(Recorder, ros_args=ros_args, arguments=('--ros-args', *ros_args))
        node.start()
        return node

    return start


@pytest.fixture
def talker(ros: Any) -> Node:
    return ros.node(Node, 'talker')


def say(ros: Any, recorder: Recorder, publisher: Any, said: list[str]) -> None:
    """Publish texts, and wait until the recorder has them."""
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    before = recorder.recording.received
    for text in said:
        publisher.publish(String(data=text))
    ros.spin_until(lambda: recorder.recording.received >= before + len(said), 'the messages')


def test_bag_is_named_by_the_time_and_never_overwritten(
    ros, recorder, talker, listen_to, tmp_path
) -> None:
    node = recorder()
    listener = listen_to(node)
    publisher = talker.create_publisher(String, '/talk', 100)
    for number in range(3):
        say(ros, node, publisher, [str(number)])
        assert listener.trigger(RECORDER_SERVICES.stop).success
        assert listener.trigger(RECORDER_SERVICES.start).success
    node.close()
    bags = sorted(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    assert all(path.name.startswith('soft_throw_20') for path in bags)
    assert [texts(path) for path in bags] == [['0'], ['1'], ['2'], []]


def test_recorder_waits_to_be_started_and_tells_so(recorder, listen_to, tmp_path) -> None:
    node = recorder(start='false', name='bag')
    listener = listen_to(node)
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
        answer = listener.trigger(service)
        assert (answer.success, words in answer.message) == (is_accepted, True), answer
    told = [message.status[0] for message in listener.hear(RECORDER_TOPICS.status, 3)]
    assert [msg_to_values(status)['is_recording'] for status in told] == [False, True, False]


def test_what_was_lost_is_in_diagnostics_and_bag(
    ros, recorder, talker, listen_to, monkeypatch
) -> None:
    node = recorder(name='bag')
    listener = listen_to(node)
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


def test_recorder_that_could_not_record_is_refused(recorder, tmp_path) -> None:
    (tmp_path / 'there').mkdir()
    for parameters, words in (
        ({'storage': 'none'}, r"rerun\.sink .*'none'"),
        *(({'name': name}, f"'{name}'") for name in ('../bag', '/tmp/bag', 'a/b', '..')),
        ({'name': 'there'}, 'there exists'),
    ):
        with pytest.raises(ParameterError, match=words):
            recorder(**parameters)
    assert [path.name for path in tmp_path.iterdir()] == ['there']


def test_recorder_takes_the_twin_in_its_own_namespace(ros, recorder, tmp_path) -> None:
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
    with BagReader(tmp_path / 'bag') as bag:
        notes = {item.name: item.metadata for item in bag.metadata}
        files = {item.name: item.data.decode() for item in bag.attachments()}
    assert notes[f'parameters of {name}']['throw.period'] == '0.2'
    assert notes[f'versions of {name}']['python'] == sys.version.split()[0]
    assert 'period: 0.2' in files[f'{name[1:].replace("/", "_")}.yaml']
    assert 'name: bag' in files['recorder.yaml']


def test_topic_that_nobody_publishes_is_told(ros, recorder, talker, tmp_path, capfd) -> None:
    node = recorder(name='bag', topics=['/talk', '/silence'])
    say(ros, node, talker.create_publisher(String, '/talk', 100), ['a'])
    told: list[str] = []

    def is_told() -> bool:
        told.extend(line for line in capfd.readouterr().err.splitlines() if 'nothing is' in line)
        return bool(told)

    ros.spin_until(is_told, 'the warning')
    assert '/silence' in told[0]
    assert '/talk' not in told[0]


def test_journal_of_somebody_else_does_no_harm(ros, recorder, talker, tmp_path) -> None:
    node = recorder(name='bag')
    publisher = talker.create_publisher(String, '/talk/journal', 100)
    throw = '{"kind":"throw","step":1,"settings":5,"versions":[]}'
    said = ['', '[]', throw, '{"kind":1,"step":null}', 'after']
    say(ros, node, publisher, said)
    assert node.exit_code is None
    node.close()
    assert texts(tmp_path / 'bag', '/talk/journal') == said


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
    say(ros, node, talker.create_publisher(String, '/talk', 100), ['a', 'b', 'c'])
    node.close()
    with shown.open('rb') as stream:
        messages = [item for item in read_stream(stream) if isinstance(item, Message)]
    assert [deserialize_message(item.data, String).data for item in messages] == ['a', 'b', 'c']
    assert sorted(tmp_path.iterdir()) == [shown, viewer]
