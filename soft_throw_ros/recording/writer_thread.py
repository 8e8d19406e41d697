# SPDX-License-Identifier: Apache-2.0
"""Write a bag in a thread of its own, so that no disk holds up those who have messages."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
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
        self._dropped: Counter[Channel] = Counter()
        self._waiting: deque[Message | Callable[[BagWriter], None]] = deque()
        # Two sums, each of one thread, and no lock
        self._put_size = 0  # [bytes]
        self._written_size = 0  # [bytes]
        self._closing_error: BagError | None = None
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
        """How many messages wait to be written."""
        return len(self._waiting)

    def put(self, messages: Iterable[Message]) -> None:
        """Have messages written, or dropped if too much waits already."""
        for message in messages:
            size = len(message.data) + _OVERHEAD
            if self._put_size - self._written_size + size > self._capacity:
                self._dropped[message.channel] += 1
            else:
                self._put_size += size
                self._waiting.append(message)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Have named texts written."""
        self._waiting.append(lambda bag: bag.add_metadata(name, values))

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Have a file written into the bag."""
        self._waiting.append(lambda bag: bag.attach(name, data, media_type, time=time.time_ns()))

    def lost(self) -> Counter[Channel]:
        """Return how many messages are not in the bag, and will not be, by their channels."""
        bag = self.bag
        return Counter(self._dropped.copy()) + Counter(bag.lost if bag is not None else {})

    def close(self) -> None:
        """
        Write what waits, and finish the bag.

        Raises
        ------
        BagError
            If the end of the bag could not be written.

        """
        self._is_closing.set()
        self._thread.join()
        if self._closing_error is not None:
            raise self._closing_error

    def _run(self) -> None:
        next_flush = time.monotonic() + FLUSH_PERIOD
        while not self._is_closing.wait(_WRITE_PERIOD):
            self._write()
            if time.monotonic() >= next_flush:
                next_flush = time.monotonic() + FLUSH_PERIOD
                self._flush()
        if self.error:
            self._flush()
        self._write()
        self._dropped.update(item.channel for item in self._waiting if isinstance(item, Message))
        if self.bag is not None:
            try:
                self.bag.close()
            except BagError as error:
                self.error = str(error)
                self._closing_error = error

    def _write(self) -> None:
        """Write what waits, up to the first message that the bag refuses."""
        waiting, bag = self._waiting, self.bag
        while waiting and bag is not None and not self.error:
            item = waiting[0]
            if isinstance(item, Message):
                try:
                    bag.write(item)
                except BagError as error:
                    self.error = str(error)
                    return
                except ValueError:  # its times are none
                    self._dropped[item.channel] += 1
                self._written_size += len(item.data) + _OVERHEAD
            else:
                item(bag)
            waiting.popleft()

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
