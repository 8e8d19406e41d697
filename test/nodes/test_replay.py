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
from rclpy.node import Node
from soft_throw_ros.nodes.replay import main
from soft_throw_ros.storage.message import Message

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope='module')
def messages(module_ros: Any) -> list[Message]:
    """Return the messages of a twin during half a second."""
    twin = module_ros.start_twin(throw__period=0.1).go(500)
    twin.finish()
    return twin.messages


@pytest.fixture(scope='module')
def bag(messages: list[Message], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp('recorded') / 'bag', messages)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ('', 'required: BAG'),
        ('{bag} --rate 1e300', "--rate: .* got '1e300'"),
        ('{bag} --check --rate 2', '--rate: .*--check'),
        ('{bag} --topics /twin/joint_state', '/twin/joint_state; .* /twin/joint_states'),
        ('{folder}/missing', '{folder}/missing'),
        ('{folder}/text --check', '{folder}/text'),
        ('{folder}', '{folder}'),
    ],
)
def test_wrong_argument_or_bag_is_one_line_and_exit_code_2(
    bag, tmp_path, capsys, arguments, words
) -> None:
    (tmp_path / 'text').write_text('no bag')
    try:
        code = main(arguments.format(bag=bag, folder=tmp_path).split())
    except SystemExit as exit_:
        code = exit_.code
    assert code == 2
    line = capsys.readouterr().err.splitlines()[0]
    assert line.startswith('replay: ')
    assert re.search(words.format(folder=tmp_path), line)


def check(capsys: Any, folder: Path, made: list[Message], *, size: float = 1.0) -> tuple[int, str]:
    """Check a bag whose file is cut to a part of its size; return exit code and output."""
    (file,) = write(folder, made, compression='none').glob('*.mcap')
    data = file.read_bytes()
    file.write_bytes(data[: round(size * len(data))])
    code = main(['--check', str(folder)])
    return code, ''.join(capsys.readouterr())


def test_check_of_a_wrong_bag_has_its_exit_code(messages, tmp_path, capsys) -> None:
    made = list(messages)
    index = [message.channel.topic for message in made].index('/twin/joint_states')
    data = made[index].data
    made[index] = made[index]._replace(data=data[:-1] + bytes([data[-1] ^ 0x40]))
    code, output = check(capsys, tmp_path / 'wrong', made)
    assert (code, '/twin: ' in output) == (1, True)
    code, output = check(capsys, tmp_path / 'cut', messages, size=0.5)
    assert (code, str(tmp_path / 'cut') in output) == (1, True)
    silent = [message for message in messages if not message.channel.topic.endswith('journal')]
    code, output = check(capsys, tmp_path / 'silent', silent)
    assert (code, 'journal' in output) == (2, True)
    line = next(item for item in messages if item.channel.topic.endswith('journal'))
    other = [*silent, line._replace(data=text('words of another program'))]
    code, output = check(capsys, tmp_path / 'other', other)
    assert (code, 'no start' in output) == (2, True)


WITHOUT_ROS = """
import sys

class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in ('rclpy', 'std_msgs', 'sensor_msgs', 'rosgraph_msgs'):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)

sys.meta_path.insert(0, Nothing())
from soft_throw_ros.nodes.replay import main
bag, of_ros = sys.argv[1], ['--ros-args', '-r', '__node:=other']
print([main(['--check', bag, *of_ros]), main([bag])])
"""


def test_check_needs_no_ros_and_playback_names_the_missing_ros(bag) -> None:
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS, str(bag)],
        capture_output=True, check=True, text=True, timeout=100,
    )
    assert ' 0 are different' in done.stdout
    assert done.stdout.splitlines()[-1] == '[0, 1]'
    (line,) = done.stderr.splitlines()
    assert 'rclpy' in line


SUBSCRIBER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node('subscriber')
node.create_subscription(String, '/texts', lambda _: print('heard', flush=True), 10)
print('ready', flush=True)
rclpy.spin(node)
"""


@pytest.mark.slow
def test_stopped_subscriber_does_not_delay_the_end(start, stop, ros, tmp_path) -> None:
    texts = channel('/texts', depth=1000)
    times = range(BEGIN, BEGIN + 1_000_000_001, 1_000_000)
    made = [Message(texts, text(str(n)), time, time) for n, time in enumerate(times)]
    bag = str(write(tmp_path / 'bag', made))
    subscriber = start(sys.executable, '-c', SUBSCRIBER)
    subscriber.wait_for('ready')
    command = (sys.executable, '-m', 'soft_throw_ros', 'replay', bag)
    by_itself = start(*command, '--rate', '0.1')  # so slow that it is found
    subscriber.wait_for('heard')
    by_signal = start(*command, '--loop', '--clock')
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
