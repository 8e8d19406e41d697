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
"""Bags written in a thread."""

from __future__ import annotations

from pathlib import Path
import resource
import shutil
from test.recording.conftest import PLAIN, plain, read, TIMEOUT, wait_until
import threading
from typing import Any

from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.message import Message
from soft_throw_ros.recording.writer_thread import WriterThread


def thread(path: Path, bag: Any = BagWriter, capacity: int = 10**7) -> WriterThread:
    return WriterThread(lambda: bag(path, distribution=''), capacity=capacity)


def numbers(path: Path) -> list[int]:
    return [message.sequence for message in read(path).messages]


def test_all_is_written_in_its_order(tmp_path: Path) -> None:
    writer = thread(tmp_path / 'bag')
    writer.call(lambda bag: bag.attach('file.txt', b'content', 'text/plain'))
    writer.call(lambda bag: bag.add_metadata('name', {'key': 'value'}))
    for number in range(0, 1000, 10):
        writer.put([plain(n) for n in range(number, number + 10)])
    writer.close()
    assert (writer.error, writer.lost()) == ('', {})
    assert numbers(tmp_path / 'bag') == list(range(1000))
    bag = read(tmp_path / 'bag')
    assert [(item.name, item.metadata) for item in bag.metadata] == [('name', {'key': 'value'})]
    assert [item.name for item in bag.attachments] == ['file.txt']


def test_bag_that_cannot_be_made_is_tried_again_and_what_waits_is_counted(tmp_path: Path) -> None:
    place = tmp_path / 'place'
    place.write_text('in the way')
    writer, vain = thread(place / 'bag'), thread(place / 'vain')
    assert str(place) in writer.error
    assert writer.bag is None
    for item in (writer, vain):
        item.put([plain(number) for number in range(7)])
    assert writer.waiting == 7
    vain.close()
    assert (vain.bag, vain.lost()) == (None, {PLAIN: 7})
    place.unlink()
    wait_until(lambda: not writer.error)
    writer.close()
    assert not writer.lost()
    assert numbers(place / 'bag') == list(range(7))


def test_disk_that_is_full_for_a_while_costs_nothing(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer = thread(tmp_path / 'bag')
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        for number in range(1000):
            writer.put([Message(PLAIN, number.to_bytes(100, 'big'), number, number, number)])
        wait_until(lambda: 'File too large' in writer.error)
        writer.put([plain(1000)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    wait_until(lambda: not writer.error)
    writer.close()
    assert not writer.lost()
    assert numbers(tmp_path / 'bag') == list(range(1001))


def test_bag_that_is_deleted_is_named_and_all_is_lost(tmp_path: Path) -> None:
    writer = thread(tmp_path / 'bag')
    writer.put([plain(number) for number in range(50)])
    wait_until(lambda: writer.bag is not None and sum(writer.bag.counts.values()) == 50)
    shutil.rmtree(tmp_path / 'bag')
    wait_until(lambda: 'deleted' in writer.error)
    writer.put([plain(number) for number in range(50, 70)])
    writer.close()
    assert 'deleted' in writer.error
    assert (writer.lost(), writer.waiting) == ({PLAIN: 70}, 0)


class SlowBag(BagWriter):
    """A bag on a disk that waits for something."""

    goes_on = threading.Event()

    def write(self, message: Message) -> None:
        assert self.goes_on.wait(TIMEOUT)
        super().write(message)


def test_what_waits_is_bounded_and_the_rest_is_counted(tmp_path: Path) -> None:
    writer = thread(tmp_path / 'bag', SlowBag, capacity=1_000_000)
    writer.put([plain(number, size=9_500) for number in range(250)])  # 10 kB each in memory
    assert writer.lost()[PLAIN] == 150
    SlowBag.goes_on.set()
    writer.close()
    assert numbers(tmp_path / 'bag') == list(range(100))


def test_message_without_a_valid_time_is_counted_and_left_out(tmp_path: Path) -> None:
    writer = thread(tmp_path / 'bag')
    writer.put([plain(0), Message(PLAIN, b'', -1, 0), plain(1)])
    writer.close()
    assert writer.lost() == {PLAIN: 1}
    assert numbers(tmp_path / 'bag') == [0, 1]
