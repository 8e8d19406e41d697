# SPDX-License-Identifier: Apache-2.0
"""The command line of `replay`: what it refuses, and what it says of bags that it checks."""

from __future__ import annotations

import os
from pathlib import Path
import re
import struct
import subprocess
import sys
from typing import Any

import pytest
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.nodes.replay import main
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.cdr import ArrayEncoder, JointStateEncoder
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.schemas import find_schema
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import TickSchedule

BEGIN = 1_700_000_000_000_000_000
PREFIXES = [*filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(':')), sys.prefix]


def channel(topic: str, kind: str) -> Channel:
    schema = find_schema(kind, PREFIXES)
    return Channel(topic=topic, type=kind, schema=schema.text, type_hash=schema.type_hash)


def messages_of_a_twin(steps: int, *, end: bool = True) -> list[Message]:
    """Make what a twin publishes in a run of so many steps."""
    journal = channel('/twin/journal', 'std_msgs/msg/String')
    states = channel('/twin/joint_states', 'sensor_msgs/msg/JointState')
    strain = channel('/twin/layer/strain', 'std_msgs/msg/Float64MultiArray')
    made: list[Message] = []
    due = BEGIN

    def write_line(line: str) -> None:
        data = line.encode() + b'\0'
        data = b'\0\1\0\0' + struct.pack('<I', len(data)) + data
        made.append(Message(journal, data, due, due))

    session = Session({**TWIN.defaults(), 'throw.period': 0.1}, on_entry=write_line)
    pace = TickSchedule(step=0, time_ns=BEGIN, rate=session.rate)
    session.set_tick_schedule(pace)
    encode = JointStateEncoder('rig', ('plate', 'projectile')).encode
    encode_field = ArrayEncoder({'y': 64}).encode
    for step in range(steps):
        due = pace.deadline(step)
        outputs = session.advance()
        made.append(Message(states, encode(due, outputs.state), due, due))
        if outputs.layer is not None:
            made.append(Message(strain, encode_field(outputs.layer.height), due, due))
    return made


def write(path: Path, made: list[Message], **kwargs: Any) -> Path:
    with BagWriter(path, distribution='jazzy', **kwargs) as writer:
        for number, message in enumerate(made):
            writer.write(message)
            if number % 100 == 99:
                writer.flush()
    return path


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp('good') / 'bag', messages_of_a_twin(500))


# what is refused


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ([], 'required: BAG'),
        (['BAG', '--rate', '0'], "--rate: .*'0'"),
        (['BAG', '--start', '-1'], "--start: .*'-1'"),
        (['BAG', '--duration', 'inf'], "--duration: .*'inf'"),
        (['BAG', '--clock', 'x'], "--clock: .*'x'"),
        (['BAG', '--check', '--rate', '2'], '--rate: .*--check'),
        (['BAG', '--speed', '2'], '--speed'),
    ],
)
def test_argument_that_is_wrong_is_refused(bag, capsys, arguments, words) -> None:
    with pytest.raises(SystemExit) as exit_:
        main([str(bag) if argument == 'BAG' else argument for argument in arguments])
    assert exit_.value.code == 2
    assert re.search(words, capsys.readouterr().err.splitlines()[-1])


@pytest.mark.parametrize('mode', [[], ['--check']])
def test_bag_that_is_none_is_one_line_and_exit_code_2(tmp_path, capsys, mode) -> None:
    (tmp_path / 'text').write_text('no bag')
    (tmp_path / 'empty').mkdir()
    for name in ('missing', 'text', 'empty'):
        assert main([str(tmp_path / name), *mode]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith('replay: ')
        assert str(tmp_path / name) in line


def test_topic_that_is_not_there_is_refused_with_those_that_are(bag, capsys) -> None:
    assert main([str(bag), '--topics', '/twin/joint_state']) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert '/twin/joint_state;' in line
    assert '/twin/joint_states' in line


def test_start_after_the_end_is_refused_with_the_length(bag, capsys) -> None:
    assert main([str(bag), '--start', '3']) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert '0.499 s' in line
    assert '--start 3' in line


# what is checked


def test_bag_that_is_right_is_checked_with_exit_code_0(bag, capsys) -> None:
    assert main(['--check', str(bag), '--ros-args', '-r', '__node:=other']) == 0
    said = capsys.readouterr()
    assert said.err == ''
    assert ' 0 are different' in said.out


def test_bag_that_is_not_right_is_checked_with_exit_code_1(tmp_path, capsys) -> None:
    made = messages_of_a_twin(1300)
    index = next(
        n
        for n, message in enumerate(made)
        if message.log_time == BEGIN + 250_000_000
        and message.channel.topic == '/twin/joint_states'
    )
    data = bytearray(made[index].data)
    data[-1] ^= 0x40
    made[index] = made[index]._replace(data=bytes(data))
    assert main(['--check', str(write(tmp_path / 'bag', made))]) == 1
    assert '/twin' in capsys.readouterr().out


def test_bag_that_is_damaged_is_checked_with_exit_code_1(tmp_path, capsys) -> None:
    made = messages_of_a_twin(500)
    (file,) = write(tmp_path / 'bag', made, compression='none').glob('*.mcap')
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    assert main(['--check', str(tmp_path / 'bag')]) == 1
    assert str(file) in capsys.readouterr().out


def test_bag_without_a_journal_is_exit_code_2(tmp_path, capsys) -> None:
    made = [
        message for message in messages_of_a_twin(10) if not message.channel.topic.endswith('nal')
    ]
    assert main(['--check', str(write(tmp_path / 'bag', made))]) == 2
    assert 'journal' in capsys.readouterr().err


WITHOUT_ROS = """
import sys

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in ('rclpy', 'std_msgs', 'sensor_msgs', 'rosgraph_msgs'):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)

sys.meta_path.insert(0, Nothing())
from soft_throw_ros.nodes.replay import main
print([main(['--check', sys.argv[1]]), main([sys.argv[1]])])
"""


def test_check_needs_no_ros_and_playing_says_that_it_does(bag) -> None:
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS, str(bag)],
        capture_output=True,
        check=True,
        text=True,
        timeout=100,
    )
    assert done.stdout.splitlines()[-1] == '[0, 1]'
    assert 'rclpy' in done.stderr
