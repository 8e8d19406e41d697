# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The schedule of a playback by the clock of the caller in nanoseconds, which never goes back."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import itertools

from soft_throw_ros.storage.message import Message

MAX_CATCH_UP = 100_000_000  # delay beyond which later messages are postponed [ns]
SHORTEST_LOOP = 1_000_000  # period of repetition of very short recordings [ns]


class PlaybackSchedule:
    """
    Deadlines of the messages of a recording, at a selectable rate, optionally repeated.

    `messages` returns them from the beginning, by log time. Playback is paused at the beginning
    until it is resumed.
    """

    def __init__(
        self, messages: Callable[[], Iterable[Message]], *, begin_ns: int, end_ns: int,
        rate: float = 1.0, is_looping: bool = False,
    ) -> None:
        self._messages = messages
        self.rate = rate
        self.is_paused = True
        self._begin = begin_ns
        self._length = end_ns - begin_ns
        if is_looping:  # the beginning must come later than the end
            self._length = max(self._length + 1, SHORTEST_LOOP)
        self._is_looping = is_looping
        # Times of the recording count from its beginning, and continue through repetitions.
        # At the caller's time `_now`, the time of the recording was `_passed`.
        self._now = self._passed = 0
        self._coming = self._repeat()
        self._next_time, self._next = next(self._coming)

    @property
    def is_over(self) -> bool:
        """Whether all messages have been returned."""
        return self._next is None

    def time(self, now: int) -> int:
        """Return the time of the recording, at most that of the next message [ns]."""
        passed = self._passed_by(now)
        is_repeated = self._is_looping and not self.is_over
        return self._begin + (passed % self._length if is_repeated else passed)

    def deadline(self) -> int | None:
        """Return when the next message is due, None if paused or over [ns]."""
        if self.is_over or self.is_paused:
            return None
        return self._now + round((self._next_time - self._passed) / self.rate)

    def next_due(self, now: int) -> Message | None:
        """Remove and return the next message if it is due."""
        deadline = self.deadline()
        if deadline is None or deadline > now:
            return None
        self._now += max(now - deadline - MAX_CATCH_UP, 0)
        message = self._next
        self._next_time, self._next = next(self._coming)
        return message

    def pause(self, now: int) -> None:
        """Pause playback."""
        self._now, self._passed = now, self._passed_by(now)
        self.is_paused = True

    def resume(self, now: int) -> None:
        """Resume playback."""
        if self.is_paused:
            self._now = now
            self.is_paused = False

    def _passed_by(self, now: int) -> int:
        """Return the time of the recording since its beginning [ns]."""
        passed = 0 if self.is_paused else max(int((now - self._now) * self.rate), 0)
        return min(self._passed + passed, self._next_time)

    def _repeat(self) -> Iterator[tuple[int, Message | None]]:
        """Yield messages and at last None, with times since the beginning of the first loop."""
        for loop in itertools.count():
            message = None
            for message in self._messages():
                yield loop * self._length + message.log_time - self._begin, message
            if message is None or not self._is_looping:
                break
        yield self._length, None
