# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags written in a thread."""

from __future__ import annotations

from pathlib import Path
from test.recording.conftest import PLAIN, plain, read, TIMEOUT, wait_until
import threading
from typing import Any

from bags import saved
from soft_throw_ros.recording import writer_thread
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.writer_thread import WriterThread
from soft_throw_ros.storage.message import Message


def thread(path: Path, bag: Any = BagWriter, capacity: int = 10**7) -> WriterThread:
    return WriterThread(lambda: bag(path, distribution=''), capacity=capacity)


def numbers(path: Path) -> list[int]:
    return [message.sequence for message in read(path).messages]


def test_messages_are_written_in_order_except_those_with_invalid_time(tmp_path: Path) -> None:
    writer = thread(tmp_path / 'bag')
    writer.call(lambda bag: bag.add_metadata('name', {'key': 'value'}))
    for number in range(0, 1000, 10):
        writer.put([plain(n) for n in range(number, number + 10)])
    writer.put([Message(PLAIN, b'', -1, 0)])
    writer.close()
    assert (writer.error, writer.lost()) == ('', {PLAIN: 1})
    assert numbers(tmp_path / 'bag') == list(range(1000))
    assert [item.name for item in read(tmp_path / 'bag').metadata] == ['name']


def test_bag_that_cannot_be_created_is_retried_and_lost_messages_are_counted(
    tmp_path: Path
) -> None:
    folder = tmp_path / 'folder'
    folder.write_text('in the way')
    writer, vain = thread(folder / 'bag'), thread(folder / 'vain')
    assert str(folder) in writer.error
    assert writer.bag is None
    for item in (writer, vain):
        item.put([plain(number) for number in range(7)])
    assert writer.waiting == 7
    vain.close()
    assert (vain.bag, vain.lost()) == (None, {PLAIN: 7})
    folder.unlink()
    wait_until(lambda: not writer.error)
    writer.close()
    assert not writer.lost()
    assert numbers(folder / 'bag') == list(range(7))


def test_disk_that_hangs_while_the_bag_is_created_blocks_nobody(tmp_path: Path) -> None:
    answers = threading.Event()

    def open_late() -> BagWriter:
        assert answers.wait(TIMEOUT)
        return BagWriter(tmp_path / 'bag', distribution='')

    writer = WriterThread(open_late, capacity=10**7)
    assert 'has not created the bag' in writer.error
    writer.put([plain(number) for number in range(7)])
    answers.set()
    wait_until(lambda: not writer.error)
    writer.close()
    assert numbers(tmp_path / 'bag') == list(range(7))


class SlowBag(BagWriter):
    """A bag on a disk that waits for an event."""

    goes_on = threading.Event()

    def write(self, message: Message) -> None:
        assert self.goes_on.wait(TIMEOUT)
        super().write(message)


class HungBag(BagWriter):
    """A bag whose disk hangs after the first saved message."""

    goes_on = threading.Event()

    def flush(self) -> None:
        if sum(self.counts.values()):
            assert self.goes_on.wait(TIMEOUT)
        super().flush()


def test_queue_is_bounded_and_dropped_messages_are_counted(tmp_path: Path) -> None:
    writer = thread(tmp_path / 'bag', SlowBag, capacity=1_000_000)
    writer.put([plain(number, size=9_500) for number in range(250)])  # 10 kB each in memory
    assert writer.lost()[PLAIN] == 150
    SlowBag.goes_on.set()
    writer.close()
    assert numbers(tmp_path / 'bag') == list(range(100))


def is_writing() -> bool:
    """Return whether the thread of a writer runs."""
    return any(item.name == 'bag' for item in threading.enumerate())


def test_hanging_disk_delays_the_end_for_a_bounded_time(
    tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(writer_thread, 'STALL_TIMEOUT', 0.3)
    writer = thread(tmp_path / 'bag', HungBag)
    assert writer.bag is not None
    writer.put([plain(0)])
    wait_until(lambda: writer.waiting == 0)
    writer.put([plain(number) for number in range(1, 8)])
    writer.close()
    assert is_writing()
    assert '0.3 s' in writer.error
    assert (writer.lost(), writer.waiting) == ({PLAIN: 7}, 0)
    HungBag.goes_on.set()
    wait_until(lambda: not is_writing())


def test_requested_flush_does_not_wait_for_its_period(
    tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(writer_thread, 'FLUSH_PERIOD', 1e6)
    monkeypatch.setattr(writer_thread, '_WRITE_PERIOD', 1e6)
    writer = thread(tmp_path / 'bag')
    writer.put([plain(number) for number in range(9)])
    writer.flush()

    def is_saved() -> bool:
        return len(saved(tmp_path / 'bag')) == 9

    wait_until(is_saved)
    assert is_writing()
    writer.close()
