# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Counts of lost messages by the sequence numbers of publishers, named and unnamed."""

from __future__ import annotations

import pytest
from soft_throw_ros.recording.loss_counter import LossCounter

FIRST, SECOND = b'first', b'second'


def test_gaps_of_named_publishers_are_losses_and_first_numbers_are_not() -> None:
    counter = LossCounter()
    for number, publisher in ((8, FIRST), (1, SECOND), (9, FIRST), (3, SECOND), (12, FIRST)):
        counter.add(number, publisher)
    counter.update([FIRST, SECOND], 99)
    assert counter.lost == 1 + 2


@pytest.mark.parametrize('publisher', [FIRST, None])
@pytest.mark.parametrize(('numbers', 'lost'), [
    ([6, 7, 10, 20], 2 + 9),
    ([1, 2, 2, 1, 3], 0),  # repeated
    ([8, 9, 3, 4, 5, 6, 7, 10], 0),  # latched messages that come late
    ([5001], 0),
])
def test_numbers_of_the_only_publisher_are_counted(publisher, numbers, lost) -> None:
    counter = LossCounter()
    for number in numbers:
        counter.add(number, publisher)
    counter.update([FIRST], 99)
    counter.update([FIRST], 99)
    assert counter.lost == lost


def test_reports_count_from_the_second_unnamed_publisher_on() -> None:
    counter = LossCounter()
    for number in (1, 2, 4):
        counter.add(number, None)
    counter.update([FIRST], 0)
    counter.add(100, None)
    counter.update([FIRST, SECOND], 0)
    counter.add(7, None)
    counter.update([SECOND], 3)
    assert counter.lost == 1 + 3


def test_reports_count_if_there_are_no_numbers() -> None:
    counter = LossCounter()
    counter.add(None, None)
    counter.update([FIRST], 4)
    assert counter.lost == 4
