# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tests of `replay`: playback of bags, checks, refused arguments and the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from pathlib import Path
import re
import signal
import subprocess
import sys
from typing import Any

from bags import BEGIN, channel, text, write
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import REPLAY_SERVICES
from soft_throw_ros.nodes.conversions import msg_to_time
from soft_throw_ros.nodes.player import Player
from soft_throw_ros.nodes.replay import main
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import Channel, Message, SECOND
from std_msgs.msg import String

EVERYTHING = QoSProfile(depth=5000)

FAST = channel('/fast', depth=5000)
SLOW = channel('/slow', durability='transient_local', depth=3)
LOSSY = channel('/lossy', reliability='best_effort', depth=7)
UNKNOWN = channel('/unknown', durability='transient_local', history='unknown', depth=0)


def messages(count: int = 1000) -> list[Message]:
    """Make a message every millisecond, and others every tenth of a second."""
    made = []
    for number in range(count):
        time = BEGIN + number * 1_000_000
        made += [
            Message(item, text(f'{item.topic} {number}'), time, time)
            for item in (FAST, SLOW, LOSSY, UNKNOWN)[: 4 if number % 100 == 0 else 1]
        ]
    return made


def datas(made: list[Message], topic: str) -> list[bytes]:
    return [message.data for message in made if message.channel.topic == topic]


@pytest.fixture
def listen(ros: Any) -> Callable[..., list[bytes]]:
    """Return a function that returns the list of bytes that a topic will fill."""
    node = ros.node(Node, 'listener')

    def listen(topic: str, qos: QoSProfile = EVERYTHING, kind: Any = String) -> list[bytes]:
        heard: list[bytes] = []
        node.create_subscription(kind, topic, heard.append, qos, raw=kind is String)
        return heard

    return listen


@pytest.fixture
def play(ros: Any, tmp_path: Path) -> Iterator[Callable[..., Player]]:
    """Return a function that plays messages, or a bag, to a number of subscribers."""
    with contextlib.ExitStack() as readers:

        def play(made: list[Message] | Path, listeners: int = 0, **options: Any) -> Player:
            if isinstance(made, list):
                made.sort(key=lambda message: message.log_time)
                made = write(tmp_path / f'bag{len(ros.nodes)}', made)
            player = ros.node(Player, readers.enter_context(BagReader(made)), **options)
            publishers = list(player.publishers)
            ros.spin_until(
                lambda: sum(item.get_subscription_count() for item in publishers) >= listeners,
                'the listeners',
            )
            player.start()
            return player

        yield play


def finish(ros: Any, player: Player) -> int | None:
    ros.spin_until(lambda: player.exit_code is not None, 'the end of the bag')
    return player.exit_code


def test_bag_is_played_byte_by_byte_with_its_qualities_of_service(
    ros, listen, play, capfd
) -> None:
    made = messages()
    heard = {topic: listen(topic) for topic in ('/fast', '/slow')}
    player = play(made, 2, rate=10.0)
    assert finish(ros, player) == 0
    for topic, received in heard.items():
        sent = datas(made, topic)
        ros.spin_until(lambda r=received, s=sent: len(r) == len(s), topic)
        assert received == sent
    for topic, is_latched, is_reliable in (
        ('/fast', False, True), ('/slow', True, True), ('/lossy', False, False)
    ):
        (information,) = player.get_publishers_info_by_topic(topic)
        offer = information.qos_profile
        assert (offer.durability is DurabilityPolicy.TRANSIENT_LOCAL) == is_latched
        assert (offer.reliability is ReliabilityPolicy.RELIABLE) == is_reliable
    # Late subscribers get the publisher's history, or all messages if the bag has no history depth
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    slow, kept = listen('/slow', latched), listen('/unknown', latched)
    ros.spin_until(lambda: len(slow) == 3 and len(kept) == 10, 'receipt of latched messages')
    assert slow == datas(made, '/slow')[-3:]
    player.close()
    assert f'{len(made)} messages of 4 topics played' in capfd.readouterr().err


def test_clock_topic_has_the_time_of_the_bag_instead_of_a_recorded_clock(
    ros, listen, play
) -> None:
    made = messages(500)
    recorded = channel('/clock', 'rosgraph_msgs/msg/Clock')
    made.append(Message(recorded, b'\0\1\0\0' + bytes(8), BEGIN + SECOND // 4, BEGIN))
    clocks = listen('/clock', kind=Clock)
    player = play(made, 1, clock=200.0, rate=0.5)
    assert finish(ros, player) == 0
    stamps = [msg_to_time(message.clock) for message in clocks]
    assert stamps == sorted(stamps)
    assert BEGIN <= stamps[0] < stamps[-1] <= BEGIN + SECOND // 2
    assert len(set(stamps)) > 10
    assert player.played == len(made) - 1


def test_paused_bag_is_resumed_and_only_requested_topics_are_played(ros, listen, play) -> None:
    fast, slow = listen('/fast'), listen('/slow')
    player = play(messages(300), 1, paused=True, topics=['/fast'], rate=0.5)
    listener = ros.listen_to(player)
    response = listener.trigger(REPLAY_SERVICES.pause)
    assert '0.000 s of 0.299 s' in response.message
    assert (player.played, player.exit_code) == (0, None)
    assert listener.trigger(REPLAY_SERVICES.resume).success
    ros.spin_until(lambda: player.played > 10, 'start of playback')
    assert listener.trigger(REPLAY_SERVICES.pause).success
    played = player.played
    assert listener.trigger(REPLAY_SERVICES.pause).success  # nothing was played during the call
    assert player.played == played
    assert listener.trigger(REPLAY_SERVICES.resume).success
    assert finish(ros, player) == 0
    ros.spin_until(lambda: len(fast) == 300, 'receipt of all messages')
    assert fast == [text(f'/fast {number}') for number in range(300)]
    assert slow == []


def test_unplayable_topics_are_skipped_and_reported(ros, play, capfd) -> None:
    absent = [
        Channel(topic=f'/{kind.replace("/", "_")}', type=kind, schema='int32 x')
        for kind in (
            'no_such_msgs/msg/Thing', 'no_such_msgs/action/Go_FeedbackMessage', 'Thing',
            'this/msg/Thing',
        )
    ]
    string = channel('/any')
    strange = [
        *absent,
        Channel(topic='bad name', type=string.type, schema=string.schema),
        Channel(topic='/otherwise', type=string.type, schema='', type_hash='RIHS01_ab'),
        channel('/deep', depth=2**40),
        channel('/by_node', liveliness='manual_by_node'),
        channel('/late', deadline=-5),
    ]
    made = messages(100) + 2 * [Message(item, text('?'), BEGIN, BEGIN) for item in strange]
    player = play(made)
    assert finish(ros, player) == 0
    reasons = {item.topic: reason for item, reason in player.skipped.items()}
    assert 'this' not in sys.modules  # a bag imports nothing
    for item in absent:
        assert reasons[item.topic] == f'{item.type} is not installed here'
    assert {'bad name', '/deep'} <= set(reasons)
    printed = capfd.readouterr().err
    for topic, reason in reasons.items():
        assert f'{topic} is skipped: {reason}' in printed
    assert player.played == len(made) - 2 * len(reasons)
    assert finish(ros, play([Message(absent[0], b'', BEGIN, BEGIN)])) == 1


def test_damaged_bag_is_played_up_to_the_damage(ros, listen, play, tmp_path, capfd) -> None:
    made = messages(5000)
    (file,) = write(tmp_path / 'bag', made, compression='none').glob('*.mcap')
    file.write_bytes(file.read_bytes().replace(b'fast 2500', b'fast 25oo'))
    heard = listen('/fast')
    player = play(tmp_path / 'bag', 1, rate=20.0)
    assert finish(ros, player) == 1
    assert str(file) in capfd.readouterr().err
    assert player.played == 2000
    kept = datas(made[:2000], '/fast')
    ros.spin_until(lambda: len(heard) == len(kept), 'receipt of all undamaged messages')
    assert heard == kept


@pytest.fixture(scope='module')
def recorded(module_ros: Any) -> list[Message]:
    """Return the messages of a twin during half a second."""
    twin = module_ros.start_twin(throw__period=0.1).go(500)
    twin.finish()
    return twin.messages


@pytest.fixture(scope='module')
def bag(recorded: list[Message], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp('recorded') / 'bag', recorded)


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


def test_check_of_a_wrong_bag_has_its_exit_code(recorded, tmp_path, capsys) -> None:
    made = list(recorded)
    index = [message.channel.topic for message in made].index('/twin/joint_states')
    data = made[index].data
    made[index] = made[index]._replace(data=data[:-1] + bytes([data[-1] ^ 0x40]))
    code, output = check(capsys, tmp_path / 'wrong', made)
    assert (code, '/twin: ' in output) == (1, True)
    code, output = check(capsys, tmp_path / 'cut', recorded, size=0.5)
    assert (code, str(tmp_path / 'cut') in output) == (1, True)
    silent = [message for message in recorded if not message.channel.topic.endswith('journal')]
    code, output = check(capsys, tmp_path / 'silent', silent)
    assert (code, 'journal' in output) == (2, True)


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
