# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Counts of lost messages by the sequence numbers of publishers, named and unnamed."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from soft_throw_ros.recording.loss_counter import LossCounter

FIRST, SECOND = b'first', b'second'


def count(
    numbers: Iterable[int], publishers: Iterable[bytes], *, shared: bool = False, reported: int = 0
) -> tuple[int, int]:
    """Return the lost and missed messages of a sequence without names."""
    counter = LossCounter(has_one_publisher=not shared)
    for number in numbers:
        counter.add(number, None)
    counter.update(publishers, reported)
    return counter.lost, counter.missed_before_join


def test_gaps_of_named_publishers_are_losses_and_first_numbers_are_not() -> None:
    counter = LossCounter(has_one_publisher=False)
    for number, publisher in ((8, FIRST), (1, SECOND), (9, FIRST), (3, SECOND), (12, FIRST)):
        counter.add(number, publisher)
    counter.update([FIRST, SECOND], 99)
    assert (counter.lost, counter.missed_before_join) == (1 + 2, 7)


def test_repeated_message_of_a_named_publisher_is_neither_lost_nor_another_publisher() -> None:
    counter = LossCounter(has_one_publisher=True)
    for number in (1, 2, 2, 1, 3):
        counter.add(number, FIRST)
    assert (counter.lost, counter.missed_before_join) == (0, 0)


def test_latched_messages_of_a_named_publisher_that_come_late_are_not_missing() -> None:
    counter = LossCounter(has_one_publisher=True)
    for number in (8, 9, 3, 4, 5, 6, 7, 10):
        counter.add(number, FIRST)
    assert (counter.lost, counter.missed_before_join) == (0, 2)


@pytest.mark.parametrize('shared', [True, False])
def test_gaps_of_the_only_publisher_are_losses(shared: bool) -> None:
    assert count([6, 7, 10, 20], [FIRST], shared=shared, reported=99) == (2 + 9, 5)


def test_lower_number_starts_another_publisher() -> None:
    assert count([1, 2, 5, 3, 4, 6], [FIRST, SECOND]) == (2 + 1, 2)


def test_first_gap_after_a_discovery_belongs_to_the_new_publisher() -> None:
    counter = LossCounter(has_one_publisher=True)
    for number in (1, 2, 3):
        counter.add(number, None)
    counter.update([FIRST], 0)
    counter.add(5, None)
    counter.update([FIRST], 0)
    assert (counter.lost, counter.missed_before_join) == (1, 0)
    counter.update([SECOND], 0)  # the first one was killed
    for number in (6, 100, 101, 103):
        counter.add(number, None)
    counter.update([SECOND], 0)
    assert (counter.lost, counter.missed_before_join) == (1 + 1, 99)


def test_burst_before_the_subscription_is_matched_is_not_lost() -> None:
    assert count([5001], [FIRST]) == (0, 5000)


@pytest.mark.parametrize('reported', [0, 3])
def test_reports_of_the_middleware_count_if_publishers_are_simultaneous(reported: int) -> None:
    numbers = (8, 1, 9, 2, 10, 3)
    assert count(numbers, [FIRST, SECOND], reported=reported) == (reported, 0)


def test_reports_of_the_middleware_count_on_shared_topics_of_several_publishers() -> None:
    assert count([1, 2, 9], [FIRST, SECOND], shared=True, reported=3) == (3, 0)


def test_reports_of_the_middleware_count_if_it_gives_no_numbers() -> None:
    counter = LossCounter(has_one_publisher=True)
    counter.add(None, None)
    counter.update([FIRST], 4)
    assert (counter.lost, counter.missed_before_join) == (4, 0)
