# SPDX-License-Identifier: Apache-2.0
"""The command line of `replay`: what it refuses, and what it says of bags that it checks."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import struct
import subprocess
import sys
from typing import Any

import hypothesis
from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.nodes.replay import main
from soft_throw_ros.recording.bag import BagReader, BagWriter
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
            made.append(Message(strain, encode_field(outputs.layer.velocity), due, due))
    return made


def write(path: Path, made: list[Message], **kwargs: Any) -> Path:
    with BagWriter(path, distribution='jazzy', **kwargs) as writer:
        for message in made:
            writer.write(message)
    return path


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp('good') / 'bag', messages_of_a_twin(500))


# what is refused


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ([], 'required: BAG'),
        (['BAG', '--rate', '0'], "argument --rate: must be a positive number, got '0'"),
        (['BAG', '--rate', 'nan'], "got 'nan'"),
        (['BAG', '--start', '-1'], 'argument --start: must be a number, and not negative'),
        (['BAG', '--duration', 'inf'], "got 'inf'"),
        (['BAG', '--clock', 'x'], 'argument --clock: must be a number'),
        (['BAG', '--check', '--rate', '2'], 'argument --rate: not allowed with argument --check'),
        (['BAG', '--check', '--loop'], 'argument --loop: not allowed with argument --check'),
        (['BAG', '--to', 'other'], 'argument --to: needs --check'),
        (['BAG', '--speed', '2'], '--speed'),
    ],
)
def test_argument_that_is_wrong_is_refused(bag, capsys, arguments, words) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(
            [
                argument.replace('BAG', str(bag)) if argument == 'BAG' else argument
                for argument in arguments
            ]
        )
    assert exit_.value.code == 2
    assert words in capsys.readouterr().err.splitlines()[-1]


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
    assert line.endswith(
        'has no topic /twin/joint_state; there are: '
        '/twin/joint_states, /twin/journal, /twin/layer/strain'
    )


def test_start_after_the_end_is_refused_with_the_length(bag, capsys) -> None:
    assert main([str(bag), '--start', '3']) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith('lasts 0.499 s, got --start 3')


def test_help_says_how(capsys) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(['--help'])
    assert exit_.value.code == 0
    said = capsys.readouterr().out
    assert said.startswith('usage: replay [--rate R]')
    assert 'replay --check [--to OTHER_BAG] BAG' in said


# what is checked


def test_bag_that_is_right_is_checked_with_exit_code_0(bag, capsys) -> None:
    assert main(['--check', str(bag), '--ros-args', '-r', '__node:=other']) == 0
    said = capsys.readouterr()
    assert said.err == ''
    assert said.out.splitlines() == [
        '/twin: 500 states are the same to the last bit, 0 are different, '
        '0 were lost by the recorder',
        '/twin: layer/strain: 29 messages are the same, 0 are different, 0 are not checked',
    ]


def test_bag_that_is_not_right_is_checked_with_exit_code_1(tmp_path, capsys) -> None:
    made = messages_of_a_twin(300)
    index = next(n for n, message in enumerate(made) if message.log_time == BEGIN + 250_000_000)
    data = bytearray(made[index].data)
    data[-1] ^= 0x40
    made[index] = made[index]._replace(data=bytes(data))
    assert main(['--check', str(write(tmp_path / 'bag', made))]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith('/twin: 299 states are the same to the last bit, 1 are different')
    assert said[-1].startswith(
        '/twin: joint_states: throw 2, step 250, due at 1700000000.250000000 s: '
        'effort of projectile is '
    )


def test_bag_that_is_damaged_is_checked_with_exit_code_1(tmp_path, capsys) -> None:
    made = messages_of_a_twin(500)
    (file,) = write(tmp_path / 'bag', made, compression='none').glob('*.mcap')
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    assert main(['--check', str(tmp_path / 'bag')]) == 1
    said = capsys.readouterr().out.splitlines()
    assert '0 are different' in said[0]
    assert said[-1].startswith('replay: damaged, so that something may be missing: ')


def test_bag_without_a_journal_is_exit_code_2(tmp_path, capsys) -> None:
    made = [
        message for message in messages_of_a_twin(10) if not message.channel.topic.endswith('nal')
    ]
    assert main(['--check', str(write(tmp_path / 'bag', made))]) == 2
    assert 'needs the topics journal and joint_states' in capsys.readouterr().err


def test_what_is_repeated_is_written_and_never_overwrites(bag, tmp_path, capsys) -> None:
    other = tmp_path / 'other'
    assert main(['--check', str(bag), '--to', str(other)]) == 0
    assert main(['--check', str(other)]) == 0
    with BagReader(bag) as ours, BagReader(other) as theirs:
        assert [message.data for message in ours.messages('/twin/joint_states')] == [
            message.data for message in theirs.messages('/twin/joint_states')
        ]
    capsys.readouterr()
    assert main(['--check', str(bag), '--to', str(other)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f'replay: {other} exists')


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
    assert done.stderr == (
        "replay: playing needs ROS 2, and --check does not: No module named 'rclpy'\n"
    )


# damaged and foreign files


@pytest.fixture(scope='module')
def files(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """Give files of bags, small ones, with chunks and without checksums."""
    made = messages_of_a_twin(260)
    folder = tmp_path_factory.mktemp('files')
    written = []
    for compression in ('zstd', 'none', 'lz4'):
        (file,) = write(folder / compression, made, compression=compression).glob('*.mcap')
        written.append(file.read_bytes())
    written.append(without_checksums(written[1]))
    return written


def without_checksums(data: bytes) -> bytes:
    """Set the checksums of chunks to 0, which stands for none."""
    changed = bytearray(data)
    at = 8
    while at + 9 <= len(data) - 8:
        opcode, length = struct.unpack_from('<BQ', data, at)
        if opcode == 0x06:
            struct.pack_into('<I', changed, at + 9 + 24, 0)
        at += 9 + length
    return bytes(changed)


@given(data=st.data())
@hypothesis.settings(max_examples=200)
def test_whatever_is_done_to_a_bag_is_told_or_does_no_harm(files, tmp_path_factory, data) -> None:
    content = bytearray(data.draw(st.sampled_from(files)))
    kind = data.draw(st.sampled_from(['cut', 'flip', 'flip', 'insert', 'zero', 'foreign']))
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, max(len(content) - 1, 0)))
        if kind == 'cut':
            del content[at:]
        elif kind == 'flip' and content:
            content[at] ^= 1 << data.draw(st.integers(0, 7))
        elif kind == 'insert':
            content[at:at] = data.draw(st.binary(max_size=20))
        elif kind == 'zero':
            content[at : at + data.draw(st.integers(1, 300))] = bytes(10)
        else:
            content = bytearray(data.draw(st.binary(max_size=300)))
    path = tmp_path_factory.mktemp('spoilt') / 'bag.mcap'
    path.write_bytes(content)
    output = path.with_suffix('.txt')
    with (
        output.open('w') as stream,
        contextlib.redirect_stdout(stream),
        contextlib.redirect_stderr(stream),
    ):
        code = main(['--check', str(path)])
    assert code in (0, 1, 2)
    assert output.read_text()
