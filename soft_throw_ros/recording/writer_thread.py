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
"""Write a bag in a thread of its own, so that no disk holds up those who have messages."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
import threading
import time

from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.message import BagError, Channel, Message

FLUSH_PERIOD = 0.5
"""How often what is written is made to last; also how often a bad disk is tried again. [s]"""

_WRITE_PERIOD = 0.1  # how long messages wait to be written [s]

_OVERHEAD = 500  # what a message takes in memory besides its data [bytes]


class WriterThread:
    """
    A bag, and the thread that writes it.

    Parameters
    ----------
    open_bag : callable
        Makes the bag, or raises BagError; then it is called again every `FLUSH_PERIOD`.
    capacity : int
        How much may wait for the disk, or for room on it. What comes beyond is dropped. [bytes]

    Attributes
    ----------
    bag : BagWriter or None
        None while it could not be made.
    error : str
        Why nothing is written at present; empty if all is well.

    """

    def __init__(self, open_bag: Callable[[], BagWriter], *, capacity: int) -> None:
        self.bag: BagWriter | None = None
        self.error = ''
        self._open_bag = open_bag
        self._capacity = capacity
        self._count = 0
        self._dropped: Counter[Channel] = Counter()
        self._waiting: deque[Message | Callable[[BagWriter], None]] = deque()
        # Two sums, each of one thread, and no lock
        self._put_size = 0  # [bytes]
        self._written_size = 0  # [bytes]
        self._is_closing = threading.Event()
        self._flush()
        self._thread = threading.Thread(name='bag', target=self._run, daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @property
    def waiting(self) -> int:
        """How many messages wait for the disk."""
        kept = sum(self.bag.counts.values()) if self.bag is not None else 0
        return max(self._count - kept - sum(self.lost().values()), 0)

    def put(self, messages: Iterable[Message]) -> None:
        """Have messages written, or dropped if too much waits already."""
        room = self._capacity - self._put_size + self._written_size
        room -= self.bag.unsaved if self.bag is not None else 0
        for message in messages:
            size = len(message.data) + _OVERHEAD
            self._count += 1
            if size > room:
                self._dropped[message.channel] += 1
            else:
                room -= size
                self._put_size += size
                self._waiting.append(message)

    def call(self, act: Callable[[BagWriter], None]) -> None:
        """Have something else done with the bag, after the messages so far."""
        self._waiting.append(act)

    def lost(self) -> Counter[Channel]:
        """Return how many messages are not in the bag, and will not be, by their channels."""
        bag = self.bag
        return self._dropped.copy() + (bag.lost if bag is not None else Counter())

    def close(self) -> None:
        """Write what waits, and finish the bag; if its end could not be written, see `error`."""
        self._is_closing.set()
        self._thread.join()

    def _run(self) -> None:
        next_flush = time.monotonic() + FLUSH_PERIOD
        while not self._is_closing.wait(_WRITE_PERIOD):
            self._write()
            if time.monotonic() >= next_flush:
                next_flush = time.monotonic() + FLUSH_PERIOD
                self._flush()
        if self.bag is None:
            self._flush()
        self._write()
        self._dropped.update(item.channel for item in self._waiting if isinstance(item, Message))
        if self.bag is not None:
            try:
                self.bag.close()
            except BagError as error:
                self.error = str(error)
            else:
                self.error = ''

    def _write(self) -> None:
        """Write what waits."""
        while self._waiting and self.bag is not None:
            item = self._waiting.popleft()
            if not isinstance(item, Message):
                item(self.bag)
                continue
            try:
                self.bag.write(item)
            except ValueError:  # its times are none
                self._dropped[item.channel] += 1
            self._written_size += len(item.data) + _OVERHEAD

    def _flush(self) -> None:
        """Have all that is written kept, or, if that could not be done, try again."""
        try:
            if self.bag is None:
                self.bag = self._open_bag()
            self.bag.flush()
        except BagError as error:
            self.error = str(error)
        else:
            self.error = ''
