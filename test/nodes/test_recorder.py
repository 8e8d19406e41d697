# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The recorder and its raw subscriptions in this process; the mcap library reads its bags."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
import shutil
from typing import Any

from bags import notes, PLAIN, saved
from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from ros_nodes import rules
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import RECORDER_SERVICES, RECORDER_TOPICS, TWIN_TOPICS
from soft_throw_ros.nodes import recorder as recorder_module
from soft_throw_ros.nodes.conversions import msg_to_values, text_to_profiles, time_to_msg
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.nodes.recorder import Recorder
from soft_throw_ros.nodes.topics import qos_profile
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import SECOND
from std_msgs.msg import String

BEST_EFFORT = QoSProfile(depth=9, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=9, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATER = '/talk of a later publisher'
START, STOP = RECORDER_SERVICES.start, RECORDER_SERVICES.stop


def texts(path: Path) -> list[str]:
    """Return the texts of the messages of a bag, read by the mcap library."""
    return [deserialize_message(data, String).data for _, data, *_ in saved(path)]


@pytest.fixture
def recorder(ros: Any, tmp_path: Path) -> Callable[..., Recorder]:
    """Return a function that starts a recorder of `/talk` and the topics below it."""

    def start(*words: str, **parameters: Any) -> Recorder:
        values = {'folder': tmp_path, 'topics': ['/talk'], **parameters}
        node = ros.node(Recorder, ros_args=(*words, *rules(**values)))
        node.start()
        return node

    return start


def say(ros: Any, recorder: Recorder, publisher: Any, *contents: str) -> None:
    """Publish texts, and wait until the recorder has them."""
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    subscriptions = recorder.recording.subscriptions
    before = subscriptions.received
    for text in contents:
        publisher.publish(String(data=text))
    ros.spin_until(lambda: subscriptions.received >= before + len(contents), 'the messages')


def test_services_start_and_stop_bags_of_the_present_parameters_and_overwrite_none(
    ros, recorder, talker, tmp_path
):
    node = recorder('-r', '__ns:=/rig1', start='false', name='deleted', topics=['twin'])
    listener = ros.listen_to(node)
    listener.listen(RECORDER_TOPICS.status)  # latched
    assert not list(tmp_path.iterdir())
    publisher = talker.create_publisher(String, '/rig1/twin/phase', 100)
    talker.create_publisher(String, '/rig2/twin/phase', 100).publish(String())
    for service, is_accepted, words, name in (
        (STOP, False, 'nothing has been recorded', 'deleted'),
        (START, True, str(tmp_path / 'deleted'), 'first'),
        (STOP, False, 'No such file', 'first'),
        (START, True, str(tmp_path / 'first'), 'second'),
        (START, False, 'already', 'second'),
        (STOP, True, '1 messages', 'second'),
        (START, True, str(tmp_path / 'second'), ''),
        (STOP, True, '1 messages', ''),
        (START, True, str(tmp_path / 'soft_throw_20'), 'first'),
        (STOP, True, '1 messages', 'first'),
        (START, False, 'never overwritten', 'first'),
    ):
        response = listener.trigger(service)
        assert (response.success, words in response.message) == (is_accepted, True), response
        node.parameters.apply({'name': name})
        if service is START and is_accepted:
            say(ros, node, publisher, words)
        if words.endswith('deleted'):
            ros.spin_until(lambda: saved(tmp_path / 'deleted'), 'the message in the bag')
            shutil.rmtree(tmp_path / 'deleted')
    assert [texts(path) for path in sorted(tmp_path.iterdir())] == [
        [str(tmp_path / name)] for name in ('first', 'second', 'soft_throw_20')
    ]
    statuses = [msg_to_values(item.status[0]) for item in listener.hear(RECORDER_TOPICS.status, 9)]
    assert [status['is_recording'] for status in statuses] == [False, *4 * [True, False]]
    assert node.exit_code is None  # it can record again
    node.close()
    assert node.exit_code == 1  # of the deleted bag


def test_losses_and_silent_processes_are_in_diagnostics_log_and_bag(ros, recorder, monkeypatch):
    monkeypatch.setattr(recorder_module, 'SILENCE_LIMIT', 1)
    monkeypatch.setattr(recorder_module, 'PUBLISHER_TIMEOUT', 0.0)
    node = recorder(name='bag', topics=['/talk', '/silence'])
    listener = ros.listen_to(node)
    log = listener.log()
    listener.listen(RECORDER_TOPICS.diagnostics)

    def report(task: str, level: bytes, **values: int) -> str:
        return listener.status(
            RECORDER_TOPICS.diagnostics, task,
            lambda s: s.level == level and values.items() <= msg_to_values(s).items(),
        ).message

    others = type(ros)(ros.domain_id)  # a participant of its own
    quiet = others.node(Node, 'quiet')
    say(ros, node, quiet.create_publisher(String, '/talk/quiet', 100), 'a', 'b', 'c')
    quiet.create_publisher(String, '/talk/once', LATCHED)
    report('bag', DiagnosticStatus.OK, messages=3, topics=2)
    report('losses', DiagnosticStatus.OK, lost=0)
    assert report('losses', DiagnosticStatus.WARN).endswith(' /talk/quiet')
    listener.hear(RECORDER_TOPICS.diagnostics, len(listener.heard['/diagnostics']) + 2)
    assert sum('/talk/quiet' in line for line in log) == 1
    assert sum('nothing is published yet on /silence' in line for line in log) == 1
    others.close()
    ros.spin_until(lambda: not node.recording.silent_topics, 'the end of the participant')
    monkeypatch.setattr(node.recording, 'losses', lambda: Counter({'/talk': 2}))
    report('losses', DiagnosticStatus.WARN, **{'lost': 2, '/talk': 2})
    path = node.recording.bag
    node.close()
    assert notes(path)['losses'] == {'total': '2', '/talk': '2'}


@pytest.mark.filterwarnings('ignore:Deprecated in favor of:DeprecationWarning')  # rclpy's own
@pytest.mark.parametrize(
    ('first', 'second', 'kind'), [(LATCHED, 9, String), (9, BEST_EFFORT, String), (9, 9, Clock)]
)
def test_later_publisher_of_another_quality_of_service_or_type_is_reported_as_missing(
    ros, recorder, talker, first, second, kind
):
    node = recorder()
    listener = ros.listen_to(node)
    publisher = talker.create_publisher(String, '/talk', first)
    say(ros, node, publisher, 'a')
    bag = node.recording.bag
    others = type(ros)(ros.domain_id)  # one participant publishes one type
    later = others.node(Node, 'other').create_publisher(kind, '/talk', second)
    ros.spin_until(lambda: LATER in node.recording.subscriptions.refused, 'the later one')
    later.publish(kind())
    say(ros, node, publisher, 'c')
    response = listener.trigger(STOP)
    assert (response.success, LATER in response.message) == (True, True)
    assert texts(bag) == ['a', 'c']
    assert LATER in notes(bag)['not recorded']
    assert listener.trigger(START).success
    bag, refused = node.recording.bag, node.recording.subscriptions.refused
    for one in (publisher, later) if kind is String else ():
        say(ros, node, one, 'd')
    assert ['several types' in reason for reason in refused.values()] == [True] * (kind is Clock)
    node.close()
    assert texts(bag)[-2:] == ['d', 'd'] * (kind is String)
    others.close()


def test_end_saves_all_messages_before_anything_that_takes_time(
    ros, recorder, talker, tmp_path, monkeypatch
):
    monkeypatch.setattr(recorder_module, '_DRAIN_TIME', 60.0)  # none is taken before the end
    node = recorder(name='bag')
    publisher = talker.create_publisher(String, '/talk', LATCHED)
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    publisher.publish(String(data='a'))
    assert publisher.wait_for_all_acked(Duration(seconds=60.0))
    close = node.recording.subscriptions.close

    def close_late() -> None:
        ros.spin_until(lambda: saved(tmp_path / 'bag'), 'the message in the bag')
        close()

    monkeypatch.setattr(node.recording.subscriptions, 'close', close_late)
    node.close()
    assert texts(tmp_path / 'bag') == ['a']


def test_bag_has_bytes_times_and_channels_as_published(ros, recorder, talker, tmp_path):
    row = TWIN_TOPICS.phase
    for topic, profile in {'/talk': LATCHED, '/rig1/twin/phase': qos_profile(row)}.items():
        publisher = talker.create_publisher(String, topic, profile)
        for number in range(5):
            publisher.publish(String(data=f'number {number}'))
    node = recorder(name='bag', topics=['/talk', '/rig1'])
    ros.spin_until(lambda: node.recording.subscriptions.received == 5 + row.depth, 'the messages')
    node.close()
    assert sorted(texts(tmp_path / 'bag')) == [f'number {i}' for i in (0, 1, 2, 3, 4, 4)]
    now = talker.get_clock().now().nanoseconds
    rows = saved(tmp_path / 'bag')
    assert [number for topic, *_, number in rows if topic == '/talk'] == [1, 2, 3, 4, 5]
    assert all(now - 60 * SECOND < sent <= received <= now for _, _, received, sent, _ in rows)
    with BagReader(tmp_path / 'bag') as bag:
        channels = {channel.topic: channel for channel in bag.channels}
    talk, phase = channels['/talk'], channels['/rig1/twin/phase']
    assert (talk.type, talk.type_hash[:7]) == ('std_msgs/msg/String', 'RIHS01_')
    assert 'string data' in talk.schema
    (offer,) = text_to_profiles(talk.qos)
    assert (offer.reliability.name, offer.durability.name) == ('RELIABLE', 'TRANSIENT_LOCAL')
    (offer,) = text_to_profiles(phase.qos)  # its depth is known
    assert (offer.history, offer.depth) == (HistoryPolicy.KEEP_LAST, row.depth)


def test_no_message_is_read_before_the_clock_starts(ros, recorder, talker, tmp_path):
    talker.create_publisher(String, '/talk', LATCHED).publish(String())
    node = recorder(name='bag', use_sim_time='true')
    ros.spin_until(lambda: list(node.recording.subscriptions), 'the topic')
    assert node.recording.subscriptions.received == 0
    clock, begin = talker.create_publisher(Clock, '/clock', 10), time_to_msg(5 * SECOND)
    subscriptions = node.recording.subscriptions
    ros.spin_until(lambda: clock.publish(Clock(clock=begin)) or subscriptions.received, 'time')
    node.close()
    ((_, _, *times, _),) = saved(tmp_path / 'bag')
    assert times == [5 * SECOND, 5 * SECOND]


def test_gaps_are_lost_and_messages_before_the_first_one_are_not(ros, talker):
    publisher = talker.create_publisher(String, PLAIN.topic, 100)
    for _ in range(7):
        publisher.publish(String(data='too early'))
    subscription = RawSubscription(ros.node(Node, 'listener'), PLAIN, QoSProfile(depth=3))
    numbers: list[int] = []

    def last() -> int:
        numbers.extend(message.sequence for message in subscription.drain())
        return max(numbers, default=0)

    # The publisher may be matched before the subscription is
    ros.spin_until(lambda: publisher.publish(String()) or last() > 0, 'the first message')
    for _ in range(100):  # the subscription keeps the last three
        publisher.publish(String())
    ros.spin_until(lambda: last() >= numbers[0] + 100, 'the last message')
    subscription.poll_losses()
    assert subscription.received == len(numbers)
    assert numbers[0] > 7
    assert subscription.lost == last() - numbers[0] + 1 - len(numbers) > 0
    subscription.close()
