# SPDX-License-Identifier: Apache-2.0
"""The node as a process: how it starts, refuses and ends."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import sys
import threading
from typing import Any

import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState
from soft_throw_ros.nodes import topics
from soft_throw_ros.nodes.twin import main

COMMAND = [sys.executable, '-m', 'soft_throw_ros', 'twin']


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_twin_ends_well_by_a_signal(start: Any, number: int) -> None:
    twin = start(*COMMAND)
    twin.wait_for('ready')
    assert twin.end(number) == 0
    assert not any('Traceback' in line or 'rror' in line for line in twin.lines), twin.lines


def test_twin_ends_well_while_throwing_and_being_asked(start: Any, ros: Any) -> None:
    twin = start(*COMMAND, '--ros-args', '-p', 'throw.period:=0.05')
    heard: list[JointState] = []
    listener = ros.node(Node, 'listener')
    topic = topics.JOINT_STATES
    listener.create_subscription(topic.type, '/twin/joint_states', heard.append, topic.qos)
    twin.wait_for('throw 3: left')
    ros.spin_until(lambda: len(heard) > 100, 'joint states')
    assert twin.end(signal.SIGINT) == 0
    assert not any('Traceback' in line for line in twin.lines), twin.lines


SUBSCRIBER = """
import rclpy
from rclpy.node import Node
from soft_throw_ros.nodes import topics

rclpy.init()
node = Node('subscriber')
for topic in (topics.JOINT_STATES, topics.JOURNAL, topics.THROW_RESULT):
    name = topic.name.replace('~', '/twin')
    node.create_subscription(topic.type, name, lambda m: print('heard', flush=True), topic.qos)
rclpy.spin(node)
"""


@pytest.mark.parametrize('number', [signal.SIGSTOP, signal.SIGKILL])
def test_twin_outlives_a_subscriber_that_is_stopped_or_killed(
    start: Any, ros: Any, number: int
) -> None:
    twin = start(*COMMAND, '--ros-args', '-p', 'throw.period:=0.1')
    subscriber = start(sys.executable, '-c', SUBSCRIBER)
    subscriber.wait_for('heard')
    subscriber.process.send_signal(number)
    listener = ros.node(Node, 'listener')
    heard: list[Any] = []
    listener.create_subscription(
        topics.DIAGNOSTICS.type, '/diagnostics', heard.append, topics.DIAGNOSTICS.qos
    )
    ros.spin_until(lambda: len(heard) >= 3, 'diagnostics')  # it goes on for seconds
    assert twin.end(signal.SIGTERM) == 0
    assert not any('Traceback' in line for line in twin.lines), twin.lines


def test_stalled_twin_goes_on_and_counts(start: Any, ros: Any) -> None:
    twin = start(*COMMAND)
    twin.wait_for('ready')
    twin.process.send_signal(signal.SIGSTOP)
    stalled = threading.Event()
    assert not stalled.wait(0.5)
    twin.process.send_signal(signal.SIGCONT)
    listener = ros.node(Node, 'listener')
    heard: list[Any] = []
    listener.create_subscription(
        topics.DIAGNOSTICS.type, '/diagnostics', heard.append, topics.DIAGNOSTICS.qos
    )
    ros.spin_until(lambda: bool(heard), 'diagnostics')
    values = {item.key: item.value for item in heard[-1].status[0].values}
    assert int(values['ticks_skipped']) > 100
    assert int(values['ticks_caught_up']) >= 100
    assert twin.end(signal.SIGINT) == 0


BAD_FILE = """/**:
  ros__parameters:
    layer:
      thickness: 16.8
"""


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['-p', 'layer.thickness:=-1.0'], ['-p layer.thickness:=-1.0', 'got -1.0']),
        (['-p', 'layer.thickness:=.nan'], ['got nan']),
        (['-p', 'layer.thicknes:=0.01'], ['did you mean layer.thickness']),
        (['-p', 'engine.motion:=sampled'], ["got 'sampled'"]),
        (['-p', 'layer.thickness:=5e-4', '-p', 'layer.wave_speed:=200.0'], ['steps per second']),
        (['-p', 'foo'], ['-p foo']),
        (['--params-file', '{file}'], ['bad.yaml:4', 'got 16.8']),
        (['--params-file', '{file}.missing'], ['bad.yaml.missing']),
        (['-r', 'foo'], ['-r foo']),
        (['--bogus'], ['--bogus']),
    ],
)
def test_bad_argument_is_one_line_and_exit_code_2(
    start: Any, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    file = tmp_path / 'bad.yaml'
    file.write_text(BAD_FILE)
    arguments = [argument.format(file=file) for argument in arguments]
    twin = start(*COMMAND, '--ros-args', *arguments)
    assert twin.wait() == 2
    twin.close()
    (line,) = [line for line in twin.lines if 'compiling' not in line]
    assert line.startswith('twin: ')
    for word in words:
        assert word in line


def test_argument_that_is_none_of_ros_is_refused(start: Any) -> None:
    twin = start(*COMMAND, '--thickness', '3')
    assert twin.wait() == 2
    twin.close()
    assert twin.lines[0].startswith('twin: no such argument: --thickness 3; usage: twin')


def test_help_says_how(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['--help']) == 0
    assert capsys.readouterr().out.startswith('usage: twin [--ros-args')
    assert os.environ  # nothing was started
