# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A bag written in a thread of its own, so that a slow disk does not block the caller."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
import threading
import time

from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.message import BagError, Channel, Message

FLUSH_PERIOD = 0.5  # of writing, of retries after an error, and of looking for progress [s]
OPEN_TIMEOUT = 3.0  # longest wait for the first attempt to create the bag [s]
STALL_TIMEOUT = 15.0  # longest time without progress of the disk before closing gives up [s]
_OVERHEAD = 500  # memory that a waiting message takes besides its data [bytes]


class WriterThread:
    """
    A bag, and the thread that writes it.

    `open_bag` is called every `FLUSH_PERIOD` as long as it raises BagError; `bag` is None until
    then. Messages beyond `capacity` [bytes] that wait for the disk are dropped. `error` is the
    present error of writing.
    """

    def __init__(self, open_bag: Callable[[], BagWriter], *, capacity: int) -> None:
        self.bag: BagWriter | None = None
        self.error = ''
        self._open_bag = open_bag
        self._capacity = capacity
        self._count: Counter[Channel] = Counter()  # of all messages
        self._dropped: Counter[Channel] = Counter()
        self._is_over = False  # whether all that is not saved is lost
        self._waiting: deque[Message] = deque()
        self._notes: Mapping[str, Mapping[str, str]] = {}
        # Sizes of all messages so far, each changed by one thread only, without a lock [bytes]
        self._put_size = self._written_size = 0
        self._closing = threading.Event()
        self._is_last_try = False  # of a disk that takes nothing, at the end
        self._is_tried = threading.Event()  # set after the first attempt to create the bag
        self._thread = threading.Thread(name='bag', target=self._run, daemon=True)
        self._thread.start()
        if not self._is_tried.wait(OPEN_TIMEOUT):
            self.error = f'the disk has not created the bag within {OPEN_TIMEOUT:g} s'

    @property
    def waiting(self) -> int:
        """Number of messages that wait for the disk."""
        return (self._unsaved() - self.lost()).total()

    def put(self, messages: Iterable[Message]) -> None:
        """Queue messages for writing; drop them if too much data waits already."""
        free = self._capacity - self._put_size + self._written_size
        for message in messages:
            size = len(message.data) + _OVERHEAD
            self._count[message.channel] += 1
            if size > free or not message.has_valid_times:
                self._dropped[message.channel] += 1
            else:
                free -= size
                self._put_size += size
                self._waiting.append(message)

    def lost(self) -> Counter[Channel]:
        """Return the numbers of finally lost messages by channel."""
        return self._unsaved() if self._is_over else self._dropped.copy()

    def close(self, notes: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """
        Write all messages that wait and named texts, and finish the bag, or set `error`.

        A disk that takes nothing for `STALL_TIMEOUT` is left alone with all that it has not saved.
        """
        self._notes = notes or {}
        self._closing.set()
        progress, since = 0, time.monotonic()
        while self._thread.is_alive() and time.monotonic() < since + STALL_TIMEOUT:
            self._thread.join(FLUSH_PERIOD)
            done = self._written_size + (self.bag.saved_size if self.bag is not None else 0)
            if done > progress:
                progress, since = done, time.monotonic()
        if self._thread.is_alive():
            self.error = f'the disk took nothing for {STALL_TIMEOUT:g} s'
            self._is_over = True

    def _unsaved(self) -> Counter[Channel]:
        # A copy, since the caller of `put` may count a new channel meanwhile
        return self._count.copy() - (self.bag.counts if self.bag is not None else Counter())

    def _run(self) -> None:
        is_last = False
        while not is_last:
            is_last = self._closing.is_set()
            try:
                self._save()
                self.error = ''
            except BagError as error:
                self.error = str(error)
            self._is_tried.set()
            self._closing.wait(FLUSH_PERIOD)
        if self.bag is not None:
            try:
                with self.bag as bag:
                    for name, values in self._notes.items():
                        bag.add_metadata(name, values)
            except BagError as error:
                self.error = str(error)
        self._is_over = True

    def _save(self) -> None:
        """Write and flush the queued messages; create the bag if there is none."""
        if self.bag is None:
            self.bag = self._open_bag()
            self.bag.wait_for_disk = self._wait_for_disk
        while self._waiting:
            message = self._waiting[0]  # which waits until it is written
            self.bag.write(message)
            self._written_size += len(message.data) + _OVERHEAD
            self._waiting.popleft()
        self.bag.flush()

    def _wait_for_disk(self, reason: str) -> bool:
        """Wait for `FLUSH_PERIOD`; return whether to try again, which is once after the end."""
        self.error = reason
        was_last_try, self._is_last_try = self._is_last_try, self._closing.wait(FLUSH_PERIOD)
        return not was_last_try
