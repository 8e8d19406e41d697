# SPDX-License-Identifier: Apache-2.0
"""Bags read while they are written. Whoever waits for more is the one who writes it."""

from __future__ import annotations

import subprocess
import sys

from mcap.records import Metadata
import pytest
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.follow import follow
from soft_throw_ros.recording.message import BagError, Channel, Message

CHANNEL = Channel(topic='/text', type='std_msgs/msg/String', schema='string data')

RECORDER = """
import sys
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.message import Channel, Message

channel = Channel(topic='/text', type='std_msgs/msg/String', schema='string data')

writer = BagWriter(sys.argv[1], distribution='jazzy')
for number in range(50):
    writer.write(Message(channel, bytes(8), number, number, number))
writer.flush()
writer.write(Message(channel, bytes(8), 50, 50, 50))
print('flushed', flush=True)
sys.stdin.read()
"""


def message(number):
    return Message(CHANNEL, number.to_bytes(8, 'little'), number, number, number)


def numbers(items):
    return [item.log_time for item in items if isinstance(item, Message)]


class Script:
    """Does one thing after another, each time somebody waits."""

    def __init__(self, *steps):
        self._steps = iter(steps)

    def __call__(self):
        next(self._steps)()


def write(writer, *some):
    def step():
        for number in some:
            writer.write(message(number))
        writer.flush()

    return step


@pytest.mark.parametrize('compression', ['none', 'zstd'])
def test_following_gives_what_comes_until_the_bag_is_closed(tmp_path, compression):
    writer = BagWriter(tmp_path / 'bag', distribution='jazzy', compression=compression)
    write(writer, 0, 1)()
    seen = []
    script = Script(
        lambda: seen.append(list(so_far)),
        write(writer, 2),
        lambda: seen.append(list(so_far)),
        lambda: writer.add_metadata('note', {'a': 'b'}),
        write(writer, *range(3, 2000)),
        writer.close,
    )
    so_far = []
    so_far.extend(follow(tmp_path / 'bag', script))
    assert [numbers(items) for items in seen] == [[0, 1], [0, 1, 2]]
    assert numbers(so_far) == list(range(2000))
    assert Metadata('note', {'a': 'b'}) in so_far
    with BagReader(tmp_path / 'bag') as reader:
        assert numbers(so_far) == numbers(reader.messages())


def test_following_goes_on_in_the_next_file(tmp_path):
    writer = BagWriter(tmp_path / 'bag', distribution='jazzy')
    script = Script(
        write(writer, 0, 1), writer.split, write(writer, 2), writer.split, writer.close
    )
    assert numbers(follow(tmp_path / 'bag', script)) == [0, 1, 2]
    assert len(list((tmp_path / 'bag').glob('*.mcap'))) == 3


def test_following_a_bag_whose_recorder_is_killed_gives_all_but_what_was_not_flushed(tmp_path):
    folder = tmp_path / 'bag'
    with subprocess.Popen(
        [sys.executable, '-c', RECORDER, folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as recorder:
        assert recorder.stdout.readline() == 'flushed\n'

        def kill():
            recorder.kill()
            recorder.wait()

        assert numbers(follow(folder, Script(kill))) == list(range(50))


def test_following_what_somebody_else_writes_ends_with_its_file(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='jazzy') as writer:
        write(writer, *range(9))()
    data = (tmp_path / 'bag/bag_0.mcap').read_bytes()
    (tmp_path / 'other').mkdir()
    with (tmp_path / 'other/other_0.mcap').open('wb', buffering=0) as file:
        pieces = [data[place : place + 100] for place in range(0, len(data), 100)]
        script = Script(*(lambda piece=piece: file.write(piece) for piece in pieces))
        assert numbers(follow(tmp_path / 'other', script)) == list(range(9))


def test_following_a_file_that_is_cut_off_says_so_after_what_came_before(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='jazzy') as writer:
        write(writer, 0, 1)()
        cut = (tmp_path / 'bag/bag_0.mcap').read_bytes() + b'\x06\xff'
    (tmp_path / 'bag/bag_0.mcap').write_bytes(cut)
    (tmp_path / 'bag/bag_1.mcap').touch()  # so nothing is to come in the first one
    items = follow(tmp_path / 'bag', Script())
    assert isinstance(next(items), Metadata | Message)
    with pytest.raises(BagError, match=r'bag_0\.mcap: it ends within a record'):
        list(items)


def test_following_what_is_no_bag_is_refused(tmp_path):
    with pytest.raises(
        BagError, match=r'is no bag that is written, there is no file none_0\.mcap'
    ):
        next(follow(tmp_path / 'none', Script()))
