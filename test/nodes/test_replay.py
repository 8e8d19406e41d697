# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tests of `replay`: playback of bags, checks, refused arguments and the end."""

from collections.abc import Callable
from pathlib import Path
import re
import signal
import sys
from typing import Any

from bags import BEGIN, channel, text, wait_until, write
from bench import processes
import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import REPLAY_SERVICES, TWIN_TOPICS
from soft_throw_ros.nodes.conversions import msg_to_time
from soft_throw_ros.nodes.player import Player
from soft_throw_ros.nodes.replay import main
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import Channel, Message, SECOND
from std_msgs.msg import String

FAST = channel('/fast', depth=5000)
OTHERS = [
    channel('/slow', durability='transient_local', depth=3),
    channel('/lossy', reliability='best_effort', depth=7),
    channel('/unknown', durability='transient_local', history='unknown', depth=0),
]


def messages(count: int) -> list[Message]:
    """Make a message every millisecond, and others every tenth of a second."""
    return [
        Message(item, text(f'{item.topic} {number}'), *2 * [BEGIN + number * SECOND // 1000])
        for number in range(count)
        for item in [FAST, *(OTHERS if number % 100 == 0 else [])]
    ]


@pytest.fixture
def play(request: Any, ros: Any, tmp_path: Path) -> Callable[..., Player]:
    """Return a function that plays messages, or a bag, to a number of subscribers."""

    def play(made: list[Message] | Path, listeners: int = 0, **options: Any) -> Player:
        if isinstance(made, list):
            made = write(tmp_path / f'bag{len(ros.nodes)}', made)
        reader = BagReader(made)
        request.addfinalizer(reader.__exit__)
        player = ros.node(Player, reader, **options)
        counts = [item.get_subscription_count for item in player.publishers]
        ros.spin_until(lambda: sum(count() for count in counts) >= listeners, 'the listeners')
        player.start()
        return player

    return play


def finish(ros: Any, player: Player) -> int | None:
    ros.spin_until(lambda: player.exit_code is not None, 'the end of the bag')
    return player.exit_code


def test_bag_is_played_byte_by_byte_and_paused_beside_a_clock_of_its_time(
    ros, play, capfd
):
    made = messages(500)
    for other in (channel('/clock', 'rosgraph_msgs/msg/Clock'), channel('/unwanted')):
        made.insert(50, made[50]._replace(channel=other))
    node, latched = ros.node(Node, 'listener'), DurabilityPolicy.TRANSIENT_LOCAL

    def listen(topic: str, kind: Any = String, **qos: Any) -> list[Any]:
        messages: list[Any] = []
        profile = QoSProfile(depth=5000, **qos)
        node.create_subscription(kind, topic, messages.append, profile, raw=kind is String)
        return messages

    heard = {topic: listen(topic) for topic in ('/fast', '/slow', '/unwanted')}
    clocks = listen('/clock', kind=Clock)
    topics = ['/clock', '/fast', '/slow', '/lossy', '/unknown']
    player = play(made, 3, paused=True, topics=topics, clock=200.0)
    listener = ros.listen_to(player)
    assert '0.000 s of 0.499 s' in listener.trigger(REPLAY_SERVICES.pause).message
    assert (player.played, player.exit_code) == (0, None)
    assert listener.trigger(REPLAY_SERVICES.resume).success
    ros.spin_until(lambda: player.played > 10, 'start of playback')
    position, played = listener.trigger(REPLAY_SERVICES.pause).message, player.played
    assert listener.trigger(REPLAY_SERVICES.pause).message == position
    assert player.played == played
    assert listener.trigger(REPLAY_SERVICES.resume).success
    assert finish(ros, player) == 0
    # Late subscribers get the publisher's history, or all messages if the bag has no depth
    late, heard['/unknown'] = (listen(name, durability=latched) for name in ('/slow', '/unknown'))
    sent = {
        topic: [item.data for item in made if item.channel.topic == topic in topics]
        for topic in heard
    }
    ros.spin_until(lambda: all(len(heard[it]) == len(sent[it]) for it in sent), 'all messages')
    ros.spin_until(lambda: len(late) == 3, 'receipt of latched messages')
    assert (heard, late) == (sent, sent['/slow'][-3:])
    stamps = [msg_to_time(message.clock) for message in clocks]
    assert stamps == sorted(stamps)
    assert BEGIN <= stamps[0] < stamps[-1] <= BEGIN + SECOND // 2
    assert len(set(stamps)) > 10
    infos = [player.get_publishers_info_by_topic(topic)[0] for topic in topics[1:4]]
    offers = [(i.qos_profile.durability.name, i.qos_profile.reliability.name) for i in infos]
    assert offers == [
        ('VOLATILE', 'RELIABLE'), ('TRANSIENT_LOCAL', 'RELIABLE'), ('VOLATILE', 'BEST_EFFORT')
    ]
    player.close()
    assert f'{len(made) - 2} messages of 4 topics played' in capfd.readouterr().err


def test_unplayable_topics_are_skipped_and_reported(ros, play, capfd):
    absent = [
        Channel(topic=f'/of_{number}', type=kind, schema='int32 x') for number, kind in enumerate(
            ('no_such_msgs/msg/Thing', 'no_such_msgs/action/Go_Feedback', 'Thing', 'this/msg/A')
        )
    ]
    string = channel('/any')
    strange = [
        *absent,
        Channel(topic='/otherwise', type=string.type, schema='', type_hash='RIHS01_ab'),
        Channel(topic='bad name', type=string.type, schema=string.schema),
        channel('/deep', depth=2**40),
        channel('/by_node', liveliness='manual_by_node'),
        channel('/late', deadline=-5),
    ]
    made = 2 * [Message(item, text('?'), BEGIN, BEGIN) for item in strange] + messages(100)
    player = play(made)
    assert finish(ros, player) == 0
    reasons = {item.topic: reason for item, reason in player.skipped.items()}
    assert 'this' not in sys.modules  # a bag imports nothing
    assert all(reasons[it.topic] == f'{it.type} is not installed here' for it in absent)
    assert {'bad name', '/deep', '/otherwise'} <= set(reasons)
    printed = capfd.readouterr().err
    assert all(f'{topic} is skipped: {reasons[topic]}' in printed for topic in reasons)
    assert player.played == len(made) - 2 * len(reasons)
    assert finish(ros, play(made[:1])) == 1


def test_damaged_bag_is_played_up_to_the_damage(ros, play, tmp_path, capfd):
    (file,) = write(tmp_path / 'bag', messages(5000), compression='none').glob('*.mcap')
    file.write_bytes(file.read_bytes().replace(b'fast 2500', b'fast 25oo'))
    player = play(file.parent, rate=20.0)
    assert (finish(ros, player), player.played) == (1, 2000)
    assert str(file) in capfd.readouterr().err


@pytest.fixture(scope='module')
def folder(module_ros: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with bags of half a second of a twin."""
    folder = tmp_path_factory.mktemp('recorded')
    twin = module_ros.start_twin(throw__period=0.1).go(500)
    twin.finish()
    state = twin.of(TWIN_TOPICS.joint_states)[0]
    other = state._replace(data=state.data[:-1] + bytes([state.data[-1] ^ 0x40]))
    made = {
        'whole': twin.messages,
        'wrong': [other if message is state else message for message in twin.messages],
        'silent': [item for item in twin.messages if not item.channel.topic.endswith('journal')],
        'cut': twin.messages,
    }
    files = {name: next(write(folder / name, made[name]).glob('*.mcap')) for name in made}
    files['cut'].write_bytes(files['whole'].read_bytes()[: files['whole'].stat().st_size // 2])
    return folder


@pytest.mark.parametrize(
    ('arguments', 'code', 'words'),
    [
        ('--check {folder}/wrong', 1, '/twin: '),
        ('--check {folder}/cut', 2, 'replay: .*{folder}/cut.*soft-throw recover'),
        ('{folder}/cut', 2, 'replay: .*{folder}/cut.*soft-throw recover'),
        ('--check {folder}/silent', 2, 'replay: .*journal'),
        ('', 2, 'replay: .*required: BAG'),
        ('{folder}/whole --rate 1e300', 2, "replay: .*--rate: .* got '1e300'"),
        ('{folder}/whole --check --rate 2', 2, 'replay: .*--rate: .*--check'),
        ('{folder}/whole --topics /twin/joint_state', 2,
         'replay: .*/twin/joint_state; .* /twin/joint_states'),
        ('{folder}/missing', 2, 'replay: .*{folder}/missing'),
        ('{folder} --check', 2, 'replay: .*{folder}'),
    ],
)
def test_refusal_or_difference_is_one_line_and_an_exit_code(
    folder, capsys, arguments, code, words
):
    try:
        ended = main(arguments.format(folder=folder).split())
    except SystemExit as exit_:
        ended = exit_.code
    assert ended == code
    out, err = capsys.readouterr()
    assert re.match(words.format(folder=folder), err or out)
    assert code == 1 or err.count('\n') == 1


WITHOUT_ROS = """
import sys
sys.modules.update(dict.fromkeys(('rclpy', 'std_msgs', 'sensor_msgs', 'rosgraph_msgs')))
from soft_throw_ros.nodes.replay import main
bag = sys.argv[1]
print([main(['--check', bag, '--ros-args', '-r', '__node:=other']), main([bag])])
"""


def test_check_needs_no_ros_and_playback_names_the_missing_ros(start, folder):
    process = start(sys.executable, '-c', WITHOUT_ROS, str(folder / 'whole'))
    assert process.wait() == 0
    expected = {'': 4, ' 0 are different': 2, 'replay: ': 1, 'rclpy': 1, '[0, 1]': 1}
    assert {word: sum(word in line for line in process.lines) for word in expected} == expected


@pytest.mark.slow
def test_stopped_subscriber_does_not_delay_the_end(start, stop, folder, tmp_path):
    heard = tmp_path / 'heard'
    command = (sys.executable, '-m', 'bench.soak', '--subscribe', str(heard))
    subscriber = start(*command, cwd=processes.ROOT)
    wait_until(heard.exists)
    command = (*processes.SOFT_THROW, 'replay', str(folder / 'whole'))
    by_itself = start(*command, '--rate', '0.1')  # so slow that it is found
    wait_until(lambda: heard.stat().st_size > 0)
    by_signal = start(*command, '--loop', '--clock')
    by_signal.wait_for('discovery range')
    stop(subscriber.process.pid)
    try:
        assert by_itself.wait() == 0
        assert by_signal.end(signal.SIGINT) == 0  # while messages pile up
    finally:
        subscriber.process.send_signal(signal.SIGCONT)
    for replay in (by_itself, by_signal):
        assert not any('Traceback' in line or 'rror' in line for line in replay.lines)
