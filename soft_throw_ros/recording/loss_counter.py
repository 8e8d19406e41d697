# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Count the lost messages of a topic by the sequence numbers of its publishers."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable


class LossCounter:
    """
    Numbers of lost messages, and of messages published before joining, of one topic.

    With `has_one_publisher`, publishers follow one another and never publish at the same time.

    Notes
    -----
    A publisher numbers its messages from 1 on. The messages before its first received message
    were published before joining; later gaps are losses. Latched messages may come later than a
    new one, and are not missing then.

    Before ROS 2 Kilted, the middleware does not identify the publisher of a message. Then all
    messages form one sequence. The number after a jump is the first one of another publisher if
    it is not above the previous number, or if a discovered publisher has not sent yet. If there
    are more first numbers than publishers, several publish at the same time; then, and on topics
    that several publishers share, only the losses reported by the middleware count.

    One thread calls `add`, and another one may call `update`.

    """

    def __init__(self, *, has_one_publisher: bool) -> None:
        self._has_one_publisher = has_one_publisher
        self._has_numbers = True
        self._lost = self._missed = self._reported = 0
        self._ends: dict[bytes, tuple[int, int]] = {}  # first and highest number by publisher
        # for messages without a publisher
        self._latest = 0
        self._jumps: deque[tuple[int, int]] = deque()  # numbers before and after
        self._senders = 0  # publishers that have sent
        self._publishers: set[bytes] = set()  # discovered ones

    @property
    def lost(self) -> int:
        """Number of lost messages."""
        return self._lost if self._is_by_number else self._reported

    @property
    def missed_before_join(self) -> int:
        """Number of messages that publishers had published before the first received one."""
        return self._missed if self._is_by_number else 0

    def add(self, number: int | None, publisher: bytes | None) -> None:
        """Count a message by its sequence number and publisher, each None if unknown."""
        if number is None:
            self._has_numbers = False
        elif publisher is not None:
            first, last = self._ends.get(publisher, (number, 0))
            if not last:
                self._missed += number - 1
            elif number < first:
                self._missed -= 1
            else:
                self._lost += max(number - last - 1, 0)
            self._ends[publisher] = first, max(number, last)
        else:
            if not self._latest or number != self._latest + 1:
                self._jumps.append((self._latest, number))
            self._latest = number

    def update(self, publishers: Iterable[bytes], reported: int) -> None:
        """
        Count the jumps so far, with the publishers of the topic and the number of reported losses.

        Lower numbers have precedence as starts of publishers.
        """
        self._publishers.update(publishers)
        self._reported = reported
        jumps = [self._jumps.popleft() for _ in range(len(self._jumps))]
        starts = sum(after <= before or not before for before, after in jumps)
        unassigned = len(self._publishers) - self._senders - starts
        for before, after in jumps:
            is_start = after <= before or not before
            if is_start or unassigned > 0:
                unassigned -= not is_start
                self._senders += 1
                self._missed += after - 1
            else:
                self._lost += after - before - 1

    @property
    def _is_by_number(self) -> bool:
        """Whether each sequence number can be assigned to a publisher."""
        publishers = max(len(self._publishers), 1)
        is_assigned = self._senders <= publishers and (publishers == 1 or self._has_one_publisher)
        return self._has_numbers and (is_assigned or not self._senders)
