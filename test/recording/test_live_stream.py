# SPDX-License-Identifier: Apache-2.0
"""Messages through a pipe to another process, whatever that does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import sys
import time

from soft_throw_ros.recording.feed import Feed
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.qos import Qos

PATIENCE = 20.0
STATES = Channel(topic='/states', type='std_msgs/msg/String', schema='string data')
LATCHED = Channel(
    topic='/latched',
    type='std_msgs/msg/String',
    schema='string data',
    qos=(Qos(durability='transient_local'),),
)

READER = """
import os, sys
from soft_throw_ros.recording.bag_reader import read_stream
from soft_throw_ros.recording.message import Message
with open(sys.argv[1], 'a') as file:
    print('start', os.getpid(), file=file, flush=True)
    for item in read_stream(sys.stdin.buffer):
        if isinstance(item, Message):
            print(item.channel.topic, item.sequence, file=file, flush=True)
    print('end', file=file, flush=True)
"""


def reader(path: Path) -> list[str]:
    path.touch()
    return [sys.executable, '-c', READER, str(path)]


def message(channel: Channel, number: int, size: int = 100) -> Message:
    return Message(channel, bytes(size), log_time=number, publish_time=number, sequence=number)


def wait_until(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_all_arrives_in_its_order(tmp_path: Path) -> None:
    path = tmp_path / 'read'
    feed = Feed(reader(path))
    for number in range(0, 1000, 2):
        feed.put([message(STATES, number), message(LATCHED, number + 1)])
    wait_until(lambda: '/latched 999' in path.read_text())
    feed.close()
    first, *lines, last = path.read_text().splitlines()
    assert first.startswith('start')
    assert last == 'end'
    assert lines == [
        f'/{"latched" if number % 2 else "states"} {number}' for number in range(1000)
    ]
    assert (feed.dropped, feed.starts, feed.trouble) == (0, 1, '')


def test_process_that_was_killed_is_started_again_and_gets_what_it_missed(tmp_path: Path) -> None:
    path = tmp_path / 'read'
    feed = Feed(reader(path))
    feed.put([message(LATCHED, 1), message(STATES, 2)])
    wait_until(lambda: '/states 2' in path.read_text())
    assert feed._process is not None
    feed._process.kill()
    path.write_text('')

    def goes_on() -> bool:
        feed.put([message(STATES, 3)])
        return '/states 3' in path.read_text()

    wait_until(goes_on)
    feed.close()
    assert feed.starts == 2
    first, second, *_ = path.read_text().splitlines()
    assert first.startswith('start')
    assert second == '/latched 1'
    assert not feed.trouble


def test_process_that_does_not_read_loses_the_oldest(tmp_path: Path) -> None:
    path = tmp_path / 'read'
    wait = f'import sys, time; open({str(path)!r}, "w").close(); time.sleep({PATIENCE})'
    feed = Feed([sys.executable, '-c', wait], capacity=2_000_000)
    wait_until(path.exists)
    for number in range(100):
        feed.put([message(STATES, number, size=100_000)])
        time.sleep(0.002)
    wait_until(lambda: not feed._incoming)
    wait_until(lambda: feed.dropped > 50)
    assert feed._size <= 2_000_000
    process = feed._process
    feed.close()
    assert process is not None
    assert process.returncode < 0  # it did not end when its input did


def test_program_that_is_not_there_is_told_and_costs_nothing() -> None:
    feed = Feed(['/no/such/program'])
    feed.put([message(STATES, 1)])
    wait_until(lambda: feed.dropped == 1)
    assert feed.trouble == '/no/such/program: No such file or directory'
    feed.close()
    assert feed.starts == 0


def test_program_that_ends_at_once_is_told() -> None:
    feed = Feed([sys.executable, '-c', 'import sys; sys.exit(3)'])

    def is_told() -> bool:
        feed.put([message(STATES, 1)])
        return 'exit code 3' in feed.trouble

    wait_until(is_told)
    feed.close()
