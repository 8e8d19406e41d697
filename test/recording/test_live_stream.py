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
"""Messages through a pipe to another process, whatever that does."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import sys
from test.recording.conftest import PLAIN, wait_until
import time

from bags import profiles
import pytest
from soft_throw_ros.recording.live_stream import LiveStream
from soft_throw_ros.recording.message import Channel, Message

LATCHED = Channel(
    topic='/latched',
    type='std_msgs/msg/String',
    schema='string data',
    qos=profiles({'durability': 'transient_local'}),
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


def test_all_arrives_in_its_order(tmp_path: Path) -> None:
    path = tmp_path / 'read'
    stream = LiveStream(reader(path))
    for number in range(0, 1000, 2):
        stream.put([message(PLAIN, number), message(LATCHED, number + 1)])
    wait_until(lambda: '/latched 999' in path.read_text())
    stream.close()
    first, *lines, last = path.read_text().splitlines()
    assert first.startswith('start')
    assert last == 'end'
    assert lines == [f'/{"latched" if number % 2 else "plain"} {number}' for number in range(1000)]
    assert (stream.dropped, stream.starts, stream.error) == (0, 1, '')


def test_process_that_was_killed_is_started_again_and_gets_what_it_missed(tmp_path: Path) -> None:
    path = tmp_path / 'read'
    stream = LiveStream(reader(path))
    stream.put([message(LATCHED, 1), message(PLAIN, 2)])
    wait_until(lambda: '/plain 2' in path.read_text())
    os.kill(int(path.read_text().split()[1]), signal.SIGKILL)
    path.write_text('')

    def goes_on() -> bool:
        stream.put([message(PLAIN, 3)])
        return '/plain 3' in path.read_text()

    wait_until(goes_on)
    stream.close()
    assert stream.starts == 2
    first, second, *_ = path.read_text().splitlines()
    assert first.startswith('start')
    assert second == '/latched 1'
    assert not stream.error


def test_process_that_does_not_read_loses_the_oldest_and_does_not_hold_up_the_end(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'read'
    wait = f'import os, time; open({str(path)!r}, "w").write(str(os.getpid())); time.sleep(60)'
    stream = LiveStream([sys.executable, '-c', wait], capacity=2_000_000)
    wait_until(lambda: path.exists() and bool(path.read_text()))
    for number in range(100):
        stream.put([message(PLAIN, number, size=100_000)])
        time.sleep(0.002)
    wait_until(lambda: stream.dropped > 50)
    begin = time.monotonic()
    stream.close()
    assert time.monotonic() - begin < 10.0
    with pytest.raises(ProcessLookupError):  # it did not end when its input did
        os.kill(int(path.read_text()), 0)


@pytest.mark.parametrize(
    ('command', 'reason'),
    [
        (['/no/such/program'], '/no/such/program: No such file or directory'),
        ([sys.executable, '-c', 'import sys; sys.exit(3)'], 'exit code 3'),
    ],
)
def test_program_that_does_not_run_is_told(command: list[str], reason: str) -> None:
    stream = LiveStream(command)

    def is_told() -> bool:
        stream.put([message(PLAIN, 1)])
        return reason in stream.error and stream.dropped > 0

    wait_until(is_told)
    stream.close()
