# SPDX-License-Identifier: Apache-2.0
"""`replay` as a process: how it ends; and what twin, recorder and replay make of each other."""

from __future__ import annotations

from pathlib import Path
import signal
import struct
import sys
import threading
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from soft_throw_ros.nodes.raw_subscriptions import prefixes
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.qos import Qos
from soft_throw_ros.recording.schemas import find_schema
from std_msgs.msg import String
from std_srvs.srv import Trigger

BEGIN = 1_700_000_000_000_000_000

MAIN = 'import sys; from soft_throw_ros.nodes.replay import main; sys.exit(main())'

COMMAND = [sys.executable, '-c', MAIN]


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a bag of one second, with a message every millisecond."""
    schema = find_schema('std_msgs/msg/String', prefixes())
    channel = Channel(
        topic='/texts',
        type='std_msgs/msg/String',
        schema=schema.text,
        type_hash=schema.type_hash,
        qos=(Qos(depth=1000),),
    )
    path = tmp_path_factory.mktemp('texts') / 'bag'
    with BagWriter(path, distribution='jazzy') as writer:
        for number in range(1001):
            text = f'{number}'.encode() + b'\0'
            data = b'\0\1\0\0' + struct.pack('<I', len(text)) + text
            due = BEGIN + number * 1_000_000
            writer.write(Message(channel, data, due, due))
    return path


def listen(ros: Any, topic: str) -> list[str]:
    heard: list[str] = []
    listener = ros.node(Node, 'listener')
    listener.create_subscription(
        String, topic, lambda message: heard.append(message.data), QoSProfile(depth=2000)
    )
    return heard


def resume(ros: Any, replay: Any) -> None:
    """Have a paused player go on: it answers, or plays to its end when it has not found us yet."""
    client = ros.node(Node, 'asking').create_client(Trigger, '/replay/resume')
    ros.spin_until(client.service_is_ready, client.srv_name)
    answer = client.call_async(Trigger.Request())  # the middleware drops answers to the unknown
    ros.spin_until(lambda: answer.done() or replay.process.poll() is not None, 'the player')


def assert_is_calm(lines: list[str]) -> None:
    assert not any('Traceback' in line or 'rror' in line for line in lines), lines


def test_replay_ends_by_itself_after_the_last_message(start, ros, bag) -> None:
    heard = listen(ros, '/elsewhere')
    replay = start(*COMMAND, str(bag), '--paused', '--ros-args', '-r', '/texts:=/elsewhere')
    resume(ros, replay)
    ros.spin_until(lambda: '1000' in heard, 'the last message')
    assert replay.wait() == 0
    assert heard == [str(number) for number in range(1001)]
    assert replay.lines == ['replay: 1001 messages of 1 topics played']


@pytest.mark.parametrize(
    ('number', 'option'), [(signal.SIGINT, '--loop'), (signal.SIGTERM, '--paused')]
)
def test_replay_ends_well_by_a_signal(start, ros, bag, number, option) -> None:
    heard = listen(ros, '/texts')
    replay = start(*COMMAND, str(bag), option, '--clock')
    there = ros.node(Node, 'observer')
    ros.spin_until(lambda: there.count_publishers('/texts') > 0, 'the player')
    if option == '--loop':
        ros.spin_until(lambda: len(heard) > 10, 'messages')
    assert replay.end(number) == 0
    assert_is_calm(replay.lines)


SUBSCRIBER = """
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node('subscriber')
node.create_subscription(String, '/texts', lambda _: print('heard', flush=True), 10)
print('ready', flush=True)
rclpy.spin(node)
"""


@pytest.mark.parametrize('number', [None, signal.SIGINT])
def test_stopped_subscriber_does_not_hold_up_the_end(start, ros, bag, number) -> None:
    subscriber = start(sys.executable, '-c', SUBSCRIBER)
    subscriber.wait_for('ready')
    # in the other case slow enough for the subscriber to be found before the end
    replay = start(*COMMAND, str(bag), *(['--loop'] if number else ['--rate', '0.3']))
    subscriber.wait_for('heard')
    subscriber.process.send_signal(signal.SIGSTOP)
    try:
        if number is not None:
            assert not threading.Event().wait(0.3)  # while messages pile up
        assert (replay.wait() if number is None else replay.end(number)) == 0
    finally:
        subscriber.process.send_signal(signal.SIGCONT)
    assert_is_calm(replay.lines)


def test_recorded_twin_is_what_its_journal_gives_also_when_it_is_replayed(
    start, ros, tmp_path
) -> None:
    def run(name: str, *options: str) -> Any:
        command = [sys.executable, '-m', 'soft_throw_ros', name, '--ros-args']
        return start(*command, *[word for option in options for word in ('-p', option)])

    def record(name: str) -> Any:
        recorder = run('recorder', f'folder:={tmp_path}', f'name:={name}', 'topics:=[/twin]')
        recorder.wait_for('recording into')
        return recorder

    def check(name: str) -> list[str]:
        checking = start(*COMMAND, '--check', str(tmp_path / name))
        assert checking.wait() == 0, checking.lines
        return checking.lines

    twin = run('twin', 'throw.period:=0.3')
    twin.wait_for('ready')
    recorder = record('first')
    observer = ros.node(Node, 'observer')
    ros.spin_until(lambda: observer.count_subscribers('/twin/joint_states') > 0, 'the recorder')
    thrown = sum(': left' in line for line in twin.lines)
    twin.wait_for(f'throw {thrown + 5}: left')
    assert recorder.end(signal.SIGINT) == 0
    assert twin.end(signal.SIGINT) == 0
    first = check('first')
    assert not any(' 0 are the same' in line for line in first)

    recorder = record('second')
    replay = start(*COMMAND, str(tmp_path / 'first'), '--paused', '--rate', '3')
    for topic in ('/twin/joint_states', '/twin/journal'):
        ros.spin_until(lambda topic=topic: observer.count_subscribers(topic) > 0, topic)
    resume(ros, replay)
    assert replay.wait() == 0
    assert recorder.end(signal.SIGINT) == 0
    second = check('second')
    assert [' 0 are different' in line for line in second] == [
        ' 0 are different' in line for line in first
    ]
