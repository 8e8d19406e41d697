# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Counts of lost messages by the sequence numbers of publishers, named and unnamed."""

from __future__ import annotations

import pytest
from soft_throw_ros.recording.loss_counter import LossCounter

FIRST, SECOND = b'first', b'second'


@pytest.mark.parametrize(('updates', 'lost'), [
    # Gaps of named publishers are losses, and first numbers are not
    ([([(8, FIRST), (1, SECOND), (9, FIRST), (3, SECOND), (12, FIRST)], [FIRST, SECOND], 99)], 3),
    # The same holds for the only publisher, named or not, with repeated and late messages
    *(
        ([([(number, publisher) for number in numbers], [FIRST], 99), ([], [FIRST], 99)], lost)
        for publisher in (FIRST, None)
        for numbers, lost in (
            ([6, 7, 10, 20], 2 + 9), ([1, 2, 2, 1, 3], 0), ([8, 9, 3, 4, 5, 6, 7, 10], 0),
        )
    ),
    # Reports count from the second unnamed publisher on, or without numbers
    ([([(1, None), (2, None), (4, None)], [FIRST], 0), ([(100, None)], [FIRST, SECOND], 0),
      ([(7, None)], [SECOND], 3)], 1 + 3),
    ([([(None, None)], [FIRST], 4)], 4),
])
def test_lost_messages_are_counted(updates, lost) -> None:
    counter = LossCounter()
    for messages, publishers, reported in updates:
        for number, publisher in messages:
            counter.add(number, publisher)
        counter.update(publishers, reported)
    assert counter.lost == lost
