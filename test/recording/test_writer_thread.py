# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags written in a thread."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import threading
from typing import Any

from bags import PLAIN, plain, read, saved, wait_until
from soft_throw_ros.recording import writer_thread
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.writer_thread import WriterThread
from soft_throw_ros.storage.message import Channel, Message

SEVEN = [plain(number) for number in range(7)]


def start(folder: Path, bag: Any = BagWriter, capacity: int = 10**7) -> WriterThread:
    return WriterThread(lambda: bag(folder / 'bag', distribution=''), capacity=capacity)


def numbers(folder: Path) -> list[int]:
    return [sequence for *_, sequence in read(folder / 'bag')]


def test_bag_that_cannot_be_created_is_retried_and_lost_messages_are_counted(tmp_path) -> None:
    folder = tmp_path / 'folder'
    folder.write_text('in the way')
    writer, vain = start(folder), start(folder)
    assert str(folder) in writer.error
    for item in (writer, vain):
        item.put(SEVEN)
    assert (writer.bag, writer.waiting) == (None, 7)
    vain.close()
    assert (vain.bag, vain.lost()) == (None, {PLAIN: 7})
    folder.unlink()
    wait_until(lambda: not writer.error)
    writer.close()
    assert (writer.lost(), numbers(folder)) == ({}, list(range(7)))


def test_disk_that_hangs_while_the_bag_is_created_blocks_nobody(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(writer_thread, 'OPEN_TIMEOUT', 0.1)
    answers = threading.Event()

    def open_late(path: Path, **options: str) -> BagWriter:
        assert answers.wait(60.0)
        return BagWriter(path, **options)

    writer = start(tmp_path, open_late)
    assert 'has not created the bag' in writer.error
    writer.put(SEVEN)
    answers.set()
    writer.close()
    assert numbers(tmp_path) == list(range(7))


def test_hanging_disk_delays_the_end_for_a_bounded_time_and_drops_are_counted(
    tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(writer_thread, 'STALL_TIMEOUT', 0.3)
    goes_on = threading.Event()

    class HungBag(BagWriter):
        """A bag whose disk hangs after the first saved message."""

        def flush(self) -> None:
            if sum(self.counts.values()):
                assert goes_on.wait(60.0)
            super().flush()

    writer = start(tmp_path, HungBag, capacity=1_000_000)
    writer.put([plain(0)])
    wait_until(lambda: writer.waiting == 0)
    writer.put([plain(number, size=9_500) for number in range(1, 151)])  # 10 kB each in memory
    assert writer.lost()[PLAIN] == 50
    writer.close()
    assert '0.3 s' in writer.error
    assert writer.lost()[PLAIN] + len(saved(tmp_path / 'bag')) == 151
    assert writer.waiting == 0
    goes_on.set()
    wait_until(lambda: all(item.name != 'bag' for item in threading.enumerate()))
    assert numbers(tmp_path) == list(range(101))


def test_new_channel_may_appear_while_the_waiting_messages_are_counted(tmp_path) -> None:
    (tmp_path / 'bag').write_text('in the way')
    writer, is_counted = start(tmp_path), threading.Event()

    class LookedUp(Channel):
        """A channel at whose look-up another thread puts a message of a new one."""

        def __hash__(self) -> int:
            if is_counted.is_set():
                writer.put([plain(0)._replace(channel=replace(PLAIN))])
            return 0

    writer.put([plain(0)._replace(channel=LookedUp(topic='/a', type='', schema=''))])
    is_counted.set()
    assert writer.waiting == 1
    is_counted.clear()
    assert writer.waiting > 1
    writer.close()


def test_messages_except_those_with_invalid_time_are_written_in_order(tmp_path) -> None:
    writer = start(tmp_path)
    writer.put([Message(PLAIN, b'', -1, 0), *SEVEN])
    wait_until(lambda: len(saved(tmp_path / 'bag')) == 7)  # although it is not closed
    writer.close()
    assert (writer.error, writer.lost(), numbers(tmp_path)) == ('', {PLAIN: 1}, list(range(7)))
