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


def test_all_is_written_in_its_order_but_what_has_no_valid_time(tmp_path: Path) -> None:
    writer = thread(tmp_path / 'bag')
    writer.call(lambda bag: bag.add_metadata('name', {'key': 'value'}))
    for number in range(0, 1000, 10):
        writer.put([plain(n) for n in range(number, number + 10)])
    writer.put([Message(PLAIN, b'', -1, 0)])
    writer.close()
    assert (writer.error, writer.lost()) == ('', {PLAIN: 1})
    assert numbers(tmp_path / 'bag') == list(range(1000))
    assert [item.name for item in read(tmp_path / 'bag').metadata] == ['name']


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
