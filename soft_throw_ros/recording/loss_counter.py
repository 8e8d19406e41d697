# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Count the lost messages of a topic by the sequence numbers of its publishers."""

from __future__ import annotations

from collections.abc import Iterable


class LossCounter:
    """
    Number of lost messages of one topic.

    Gaps in the numbers of a publisher after its first received message are losses; latched
    messages may come late. Before ROS 2 Kilted, the middleware does not identify the publisher of
    a message. From the discovery of a second publisher on, and for messages without numbers, only
    the losses count that the middleware reports. One thread calls `add`, and another `update`.
    """

    def __init__(self) -> None:
        self.lost = 0  # at the last update
        self._gaps = self._counted_gaps = 0  # so far, and at the last update
        self._reported = 0  # at the last update
        self._has_numbers = True
        self._last: dict[bytes | None, int] = {}  # highest number of a publisher
        self._publishers: set[bytes] = set()  # all that were discovered

    def add(self, number: int | None, publisher: bytes | None) -> None:
        """Count a message by its sequence number and publisher, each None if unknown."""
        if number is None:
            self._has_numbers = False
        elif publisher is not None or len(self._publishers) <= 1:
            last = self._last.get(publisher, number)
            self._gaps += max(number - last - 1, 0)
            self._last[publisher] = max(number, last)

    def update(self, publishers: Iterable[bytes], reported: int) -> None:
        """Count the losses since the last update, with all those that the middleware reported."""
        self._publishers.update(publishers)
        gaps = self._gaps
        if self._has_numbers and (None not in self._last or len(self._publishers) <= 1):
            self.lost += gaps - self._counted_gaps
        else:
            self.lost += reported - self._reported
        self._counted_gaps, self._reported = gaps, reported
