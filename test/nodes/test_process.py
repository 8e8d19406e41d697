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
"""Nodes as processes: how they start, refuse and end."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.nodes.twin import main

SOFT_THROW = (sys.executable, '-m', 'soft_throw_ros')
INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


def assert_ends_well(process: Any, number: int) -> None:
    assert process.end(number) == 0, process.lines
    assert not any('Traceback' in line for line in process.lines), process.lines


def test_nodes_end_well_by_a_signal(start) -> None:
    fast = ('--ros-args', '-p', 'throw.period:=0.05')
    expected = (
        ('twin', INT, 'throw 3: left'),  # while it throws
        ('twin', HUP, 'ready'),
        ('rig', INT, 'ready'),
        ('calibrator', TERM, 'ready'),
    )
    started = [
        start(*SOFT_THROW, name, *(fast if name == 'twin' else ())) for name, *_ in expected
    ]
    for process, (_, number, line) in zip(started, expected, strict=True):
        process.wait_for(line)
        assert_ends_well(process, number)


def test_twin_that_is_still_compiling_ends_well_by_a_signal(start, tmp_path) -> None:
    twin = start(*SOFT_THROW, 'twin', env=os.environ | {'NUMBA_CACHE_DIR': str(tmp_path)})
    twin.wait_for('compiling')
    assert_ends_well(twin, INT)


def test_twin_that_is_still_being_imported_ends_well_by_a_signal(start) -> None:
    # whatever is imported first tells that importing has begun, and takes long
    telling = (
        'import builtins, sys, time, types; import soft_throw_ros.__main__ as umbrella\n'
        'class Slow:\n'
        '    def find_spec(self, name, *_):\n'
        "        print('importing', flush=True); time.sleep(60)\n"
        'sys.meta_path.insert(0, Slow())\n'
        "sys.exit(umbrella.main(['twin']))"
    )
    twins = {number: start(sys.executable, '-c', telling) for number in (INT, TERM, HUP)}
    for number, twin in twins.items():
        twin.wait_for('importing')
        assert twin.end(number) == 0
        assert twin.lines == ['importing']


SUBSCRIBER = """
import rclpy
from rclpy.node import Node
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.nodes.topics import create_subscription

rclpy.init()
node = Node('subscriber')
for topic in (TWIN_TOPICS.joint_states, TWIN_TOPICS.journal, TWIN_TOPICS.throw_result):
    create_subscription(node, topic.at('/twin'), lambda message: print('heard', flush=True))
rclpy.spin(node)
"""


def test_twin_outlives_subscribers_that_are_stopped_or_killed(start, listen_to) -> None:
    twin = start(*SOFT_THROW, 'twin', '--ros-args', '-p', 'throw.period:=0.1')
    numbers = (signal.SIGSTOP, signal.SIGKILL)
    subscribers = [start(sys.executable, '-c', SUBSCRIBER) for _ in numbers]
    for subscriber, number in zip(subscribers, numbers, strict=True):
        subscriber.wait_for('heard')
        subscriber.process.send_signal(number)
    listener = listen_to()
    listener.listen(TWIN_TOPICS.diagnostics)
    listener.hear(TWIN_TOPICS.diagnostics, 3)  # it goes on for seconds
    assert_ends_well(twin, TERM)


BAD_FILE = """/**:
  ros__parameters:
    layer:
      thickness: 16.8
"""
REFUSED = (
    ('twin', '-p layer.thickness:=-1.0', ['-p layer.thickness:=-1.0', 'got -1.0']),
    ('twin', '-p engine.frequency:=1000.0 -p layer.wave_speed:=1.0 -p layer.thickness:=0.1',
     ['steps per crossing']),
    ('twin', '-p use_sim_time:=maybe', ['use_sim_time', 'maybe']),
    ('twin', '-p foo', ['-p foo']),
    ('twin', '--params-file {file}', ['bad.yaml:4', 'got 16.8']),
    ('twin', '--params-file {file}.missing', ['bad.yaml.missing']),
    ('twin', '-r foo', ['-r foo']),
    ('twin', '-r __node:=no-name', ['no-name']),
    ('twin', '-- --thickness 3', ['no such argument: --thickness 3; usage: twin']),
    ('rig', '-p layer.name:=gelatin_2.0mm', ['layer.name']),
    ('calibrator', '-p twin:=/twin/', ["got '/twin/'"]),
    ('recorder', '-p name:=../bag', ["'../bag'"]),
)


def test_bad_argument_is_one_line_and_exit_code_2(start, tmp_path) -> None:
    file = tmp_path / 'bad.yaml'
    file.write_text(BAD_FILE)
    for refused in (REFUSED[:4], REFUSED[4:8], REFUSED[8:]):  # four at a time
        nodes = [
            start(*SOFT_THROW, name, '--ros-args', *arguments.format(file=file).split())
            for name, arguments, _ in refused
        ]
        for node, (name, _, words) in zip(nodes, refused, strict=True):
            assert node.wait() == 2, node.lines
            (line,) = node.lines
            assert line.startswith(f'{name}: ')
            assert all(word in line for word in words), line


def test_help_says_how(capsys) -> None:
    assert main(['--help']) == 0
    assert capsys.readouterr().out.startswith('usage: twin [--ros-args')
