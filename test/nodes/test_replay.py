# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tests of `replay`: refused arguments, checks of bags, playback and its end."""

from __future__ import annotations

from pathlib import Path
import re
import signal
import subprocess
import sys
from typing import Any

from bags import BEGIN, channel, text, write
import pytest
from rclpy.duration import Duration
from rclpy.node import Node
from soft_throw_ros.nodes.recorder import Recorder
from soft_throw_ros.nodes.replay import main
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import Message

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope='module')
def bag(module_ros: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a twin during half a second."""
    folder = tmp_path_factory.mktemp('recorded')
    rules = ('-p', f'folder:={folder}', '-p', 'name:=bag', '-p', 'topics:=[twin]')
    recorder = module_ros.node(Recorder, ros_args=rules)
    twin = module_ros.start_twin('-p', 'throw.period:=0.1')
    recorder.start()
    topics = {'/twin/joint_states', '/twin/journal', '/twin/throw_result'}
    publishers = [item for item in twin.publishers if item.topic_name in topics]
    module_ros.spin_until(
        lambda: all(item.get_subscription_count() > 0 for item in publishers), 'the recorder'
    )
    twin.go(500)
    twin.session.close()
    module_ros.spin_until(lambda: not twin._jobs, 'the journal')
    assert all(item.wait_for_all_acked(Duration(seconds=60.0)) for item in publishers)
    recorder.close()
    return folder / 'bag'


@pytest.fixture(scope='module')
def messages(bag: Path) -> list[Message]:
    with BagReader(bag) as reader:
        return list(reader.messages())


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ([], 'required: BAG'),
        (['BAG', '--rate', '1e300'], "--rate: .* got '1e300'"),
        (['BAG', '--check', '--rate', '2'], '--rate: .*--check'),
    ],
)
def test_wrong_argument_is_refused(bag, capsys, arguments, words) -> None:
    with pytest.raises(SystemExit) as exit_:
        main([str(bag) if argument == 'BAG' else argument for argument in arguments])
    assert exit_.value.code == 2
    assert re.search(words, capsys.readouterr().err.splitlines()[0])


@pytest.mark.parametrize('mode', [[], ['--check']])
def test_invalid_bag_is_one_line_and_exit_code_2(tmp_path, capsys, mode) -> None:
    (tmp_path / 'text').write_text('no bag')
    (tmp_path / 'empty').mkdir()
    for name in ('missing', 'text', 'empty'):
        assert main([str(tmp_path / name), *mode]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith('replay: ')
        assert str(tmp_path / name) in line


def test_missing_topic_is_refused_with_those_present(bag, capsys) -> None:
    assert main([str(bag), '--topics', '/twin/joint_state']) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert all(word in line for word in ['/twin/joint_state;', '/twin/joint_states']), line


def test_arguments_after_two_dashes_belong_to_the_command(bag) -> None:
    assert main(['--ros-args', '-r', '__node:=other', '--', '--check', str(bag)]) == 0


def test_check_of_a_wrong_bag_has_exit_code_1(messages, tmp_path, capsys) -> None:
    made = list(messages)
    index = [message.channel.topic for message in made].index('/twin/joint_states')
    data = made[index].data
    made[index] = made[index]._replace(data=data[:-1] + bytes([data[-1] ^ 0x40]))
    assert main(['--check', str(write(tmp_path / 'bag', made))]) == 1
    assert '/twin' in capsys.readouterr().out


def test_check_of_a_damaged_bag_or_one_without_journal_has_its_exit_code(
    messages, tmp_path, capsys
) -> None:
    (file,) = write(tmp_path / 'bag', messages, compression='none').glob('*.mcap')
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    assert main(['--check', str(tmp_path / 'bag')]) == 1
    assert f'{file}: ' in capsys.readouterr().err
    silent = [message for message in messages if not message.channel.topic.endswith('journal')]
    assert main(['--check', str(write(tmp_path / 'silent', silent))]) == 2
    assert 'journal' in capsys.readouterr().err
    line = next(item for item in messages if item.channel.topic.endswith('journal'))
    other = [*silent, line._replace(data=text('words of another program'))]
    assert main(['--check', str(write(tmp_path / 'other', other))]) == 2
    printed = capsys.readouterr()
    assert printed.out == ''
    assert 'no start' in printed.err


WITHOUT_ROS = """
import sys

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in ('rclpy', 'std_msgs', 'sensor_msgs', 'rosgraph_msgs'):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)

sys.meta_path.insert(0, Nothing())
from soft_throw_ros.nodes.replay import main
print([main(['--check', *sys.argv[1:]]), main([sys.argv[1]])])
"""


def test_check_needs_no_ros_and_playback_names_the_missing_ros(bag) -> None:
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS, str(bag), '--ros-args', '-r', '__node:=other'],
        capture_output=True,
        check=True,
        text=True,
        timeout=100,
    )
    assert ' 0 are different' in done.stdout
    assert done.stdout.splitlines()[-1] == '[0, 1]'
    (line,) = done.stderr.splitlines()
    assert 'rclpy' in line


COMMAND = (sys.executable, '-m', 'soft_throw_ros', 'replay')


SUBSCRIBER = """
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from soft_throw_ros.nodes.recorder import Recorder
from std_msgs.msg import String

rclpy.init()
node = Node('subscriber')
node.create_subscription(String, '/texts', lambda _: print('heard', flush=True), 10)
print('ready', flush=True)
rclpy.spin(node)
"""


@pytest.fixture(scope='module')
def texts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of a one-second bag with a message every millisecond."""
    texts = channel('/texts', depth=1000)
    times = range(BEGIN, BEGIN + 1_000_000_001, 1_000_000)
    made = [Message(texts, text(str(n)), time, time) for n, time in enumerate(times)]
    return write(tmp_path_factory.mktemp('texts') / 'bag', made)


@pytest.mark.slow
def test_stopped_subscriber_does_not_delay_the_end(start, stop, ros, texts) -> None:
    subscriber = start(sys.executable, '-c', SUBSCRIBER)
    subscriber.wait_for('ready')
    by_itself = start(*COMMAND, str(texts), '--rate', '0.1')  # so slow that it is found
    subscriber.wait_for('heard')
    by_signal = start(*COMMAND, str(texts), '--loop', '--clock')
    observer = ros.node(Node, 'observer')
    ros.spin_until(lambda: observer.count_publishers('/clock') > 0, 'the player')
    stop(subscriber.process.pid)
    try:
        assert by_itself.wait() == 0
        assert by_signal.end(signal.SIGINT) == 0  # while messages pile up
    finally:
        subscriber.process.send_signal(signal.SIGCONT)
    for replay in (by_itself, by_signal):
        assert not any('Traceback' in line or 'rror' in line for line in replay.lines)
