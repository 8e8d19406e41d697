# SPDX-License-Identifier: Apache-2.0
"""Bags written in a thread."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import threading
import time

import pytest
from soft_throw_ros.recording.background import BackgroundWriter
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.message import BagError, Channel, Message

PATIENCE = 20.0
CHANNEL = Channel(topic='/text', type='std_msgs/msg/String', schema='string data')


def message(number: int, size: int = 100) -> Message:
    return Message(CHANNEL, bytes(size), log_time=number, publish_time=number, sequence=number)


def wait_until(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_all_is_written_in_its_order(tmp_path: Path) -> None:
    writer = BackgroundWriter(
        lambda: BagWriter(tmp_path / 'bag', distribution='jazzy'), capacity=10**7
    )
    writer.attach('file.txt', b'content', 'text/plain')
    writer.add_metadata('name', {'key': 'value'})
    for number in range(0, 1000, 10):
        writer.put([message(n) for n in range(number, number + 10)])
    writer.close()
    assert not writer.trouble
    assert not writer.lost()
    with BagReader(tmp_path / 'bag') as bag:
        assert [item.sequence for item in bag.messages()] == list(range(1000))
        assert {item.name: item.metadata for item in bag.metadata}['name'] == {'key': 'value'}
        assert [item.name for item in bag.attachments()] == ['file.txt']


def test_what_is_put_lasts_before_the_bag_is_closed(tmp_path: Path) -> None:
    writer = BackgroundWriter(lambda: BagWriter(tmp_path / 'bag', distribution=''), capacity=10**7)
    writer.put([message(number) for number in range(100)])

    def count() -> int:
        with BagReader(tmp_path / 'bag') as bag:
            return len(list(bag.messages()))

    wait_until(lambda: count() == 100)
    writer.close()


def test_bag_that_cannot_be_made_is_tried_again(tmp_path: Path) -> None:
    place = tmp_path / 'place'
    place.write_text('in the way')
    writer = BackgroundWriter(lambda: BagWriter(place / 'bag', distribution=''), capacity=10**7)
    assert str(place) in writer.trouble
    assert writer.bag is None
    writer.attach('file.txt', b'content', 'text/plain')
    writer.put([message(number) for number in range(7)])
    assert writer.waiting == 8
    place.unlink()
    wait_until(lambda: not writer.trouble)
    writer.put([message(7)])
    writer.close()
    assert not writer.lost()
    with BagReader(place / 'bag') as bag:
        assert [item.sequence for item in bag.messages()] == list(range(8))
        assert [item.name for item in bag.attachments()] == ['file.txt']


def test_what_waits_in_vain_is_counted_in_the_end(tmp_path: Path) -> None:
    place = tmp_path / 'place'
    place.write_text('in the way')
    writer = BackgroundWriter(lambda: BagWriter(place / 'bag', distribution=''), capacity=10**7)
    writer.put([message(number) for number in range(7)])
    writer.close()
    assert writer.lost()[CHANNEL] == 7
    assert writer.bag is None


class SlowBag(BagWriter):
    """A bag on a disk that waits for something."""

    goes_on = threading.Event()

    def write(self, message: Message) -> None:
        assert self.goes_on.wait(PATIENCE)
        super().write(message)


def test_what_waits_is_bounded_and_the_rest_is_counted(tmp_path: Path) -> None:
    writer = BackgroundWriter(
        lambda: SlowBag(tmp_path / 'bag', distribution=''), capacity=1_000_000
    )
    writer.put([message(number, size=9_500) for number in range(250)])  # 10 kB each in memory
    assert writer.lost()[CHANNEL] == 150
    SlowBag.goes_on.set()
    writer.close()
    with BagReader(tmp_path / 'bag') as bag:
        assert [item.sequence for item in bag.messages()] == list(range(100))


class LostBag(BagWriter):
    """A bag on a disk that goes away in the end."""

    def close(self) -> None:
        super().close()
        raise BagError('the disk is gone')


def test_error_at_the_end_is_told(tmp_path: Path) -> None:
    writer = BackgroundWriter(lambda: LostBag(tmp_path / 'bag', distribution=''), capacity=10**7)
    with pytest.raises(BagError, match='the disk is gone'):
        writer.close()
