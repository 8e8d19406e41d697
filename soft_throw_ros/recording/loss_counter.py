# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Count the lost messages of a topic by the sequence numbers of its publishers."""

from __future__ import annotations

from collections.abc import Iterable


class LossCounter:
    """
    Numbers of lost messages, and of messages published before joining, of one topic.

    Notes
    -----
    A publisher numbers its messages from 1 on. The messages before its first received message
    were published before joining; later gaps are losses. Latched messages may come later than a
    new one, and are not missing then.

    Before ROS 2 Kilted, the middleware does not identify the publisher of a message. From the
    discovery of a second publisher on, and for messages without numbers, only the losses count
    that the middleware reports.

    One thread calls `add`, and another one may call `update`.

    """

    def __init__(self) -> None:
        self.lost = 0  # at the last update
        self.missed_before_join = 0
        self._gaps = self._counted_gaps = 0  # so far, and at the last update
        self._reported = 0  # at the last update
        self._has_numbers = True
        self._ends: dict[bytes | None, tuple[int, int]] = {}  # first and highest number
        self._publishers: set[bytes] = set()  # all that were discovered

    def add(self, number: int | None, publisher: bytes | None) -> None:
        """Count a message by its sequence number and publisher, each None if unknown."""
        if number is None:
            self._has_numbers = False
            return
        if publisher is None and len(self._publishers) > 1:
            return
        first, last = self._ends.get(publisher, (number, 0))
        if not last:
            self.missed_before_join += number - 1
        elif number < first:
            self.missed_before_join -= 1
        else:
            self._gaps += max(number - last - 1, 0)
        self._ends[publisher] = first, max(number, last)

    def update(self, publishers: Iterable[bytes], reported: int) -> None:
        """Count the losses since the last update, with all those that the middleware reported."""
        self._publishers.update(publishers)
        gaps = self._gaps
        is_by_number = None not in self._ends or len(self._publishers) <= 1
        if self._has_numbers and is_by_number:
            self.lost += gaps - self._counted_gaps
        else:
            self.lost += reported - self._reported
        self._counted_gaps, self._reported = gaps, reported
