# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the recorded states and numbers of a twin with a repeated session."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Sequence
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.interface import JOINTS
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateReader, MessageError
from soft_throw_ros.storage.message import Message
from soft_throw_ros.twin.journal import STATE
from soft_throw_ros.twin.results import State

ORDER_TIME = 50_000_000
"""Longest time from the publishing of a number to that of its line of the journal. [ns]"""

_NUMBER = struct.Struct('<d')

Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Step(NamedTuple):
    """A step of the repeated session."""

    due_ns: int
    number: int
    state: State


def count_skipped(sequences: Sequence[int], *, is_from_first: bool) -> int:
    """
    Return how many messages are missing by the numbers that publishers gave them, from 1.

    A number that is not above the one before is of another publisher, or of an older, latched
    message that comes after a new one. Numbers are 0 if they are not known.

    Examples
    --------
    >>> count_skipped([3, 4, 7, 1, 2], is_from_first=True)
    4
    >>> count_skipped([4, 2, 3, 5, 6], is_from_first=True)
    1

    """
    numbers = np.array(sequences, np.int64)
    steps = np.diff(numbers)
    begins = np.concatenate([[0], np.flatnonzero(steps <= 0) + 1])
    ends = np.append(begins[1:], numbers.size)
    first, last = numbers[begins], numbers[ends - 1]
    skipped, lowest = int((steps[steps > 1] - 1).sum()), int(first[0])
    # New messages that fit into a gap between the older ones of the same publisher
    for run in np.flatnonzero((first[1:] < first[:-1]) & (last[:-1] < last[1:])):
        older = numbers[begins[run + 1]:ends[run + 1]]
        after = np.searchsorted(older, first[run])
        if (older[after - 1], older[after]) == (first[run] - 1, last[run] + 1):
            skipped -= int(last[run] - first[run] + 1)
            lowest = min(lowest, int(older[0])) if run == 0 else lowest
    return skipped + max(lowest - 1, 0) * is_from_first


def count_missing(is_recorded: Flags, longest_end: int) -> NDArray[np.int64]:
    """
    Return how many outputs of a run are missing at its ends, and between recorded ones.

    More than `longest_end` outputs after the last recorded one count as between.

    Examples
    --------
    >>> count_missing(np.array([0, 1, 0, 0, 1, 0], bool), 1).tolist()
    [2, 2]

    """
    recorded = np.flatnonzero(is_recorded)
    missing = is_recorded.size - recorded.size
    if not recorded.size:
        return np.array([missing, 0])
    end = is_recorded.size - 1 - int(recorded[-1])
    at_ends = int(recorded[0]) + (end if end <= longest_end else 0)
    return np.array([at_ends, missing - at_ends])


class RecordedStates:
    """The states on a topic of a bag, found by their stamps."""

    def __init__(self, reader: BagReader, topic: str) -> None:
        self.unreadable = 0  # number of messages that are no state of plate and projectile
        self.sequences = array('L')  # numbers that publishers gave to the messages
        stamps, values, read = array('q'), array('d'), JointStateReader().read
        for message in reader.messages([topic], by_log_time=False):
            self.sequences.append(message.sequence)
            try:
                stamp, names, *series = read(message.data)
            except MessageError:
                self.unreadable += 1
                continue
            if names != JOINTS or any(len(numbers) != len(JOINTS) for numbers in series):
                self.unreadable += 1
                continue
            stamps.append(stamp)
            for numbers in series:
                values.extend(numbers)
        recorded = np.asarray(stamps)
        self._order = np.argsort(recorded, kind='stable')
        self._stamps: Integers = recorded[self._order]
        self._bits: Integers = np.asarray(values).view(np.int64).reshape(-1, len(State._fields))
        self._is_used = np.zeros(len(recorded), np.bool_)  # as sorted
        self._repeated: list[tuple[int, int]] = []  # first and last stamps of repeated steps [ns]

    def compare(self, steps: Sequence[Step]) -> tuple[Flags, list[tuple[Step, State]]]:
        """
        Compare the states of steps with the recorded states of the same stamps, to the last bit.

        Returns
        -------
        is_recorded : array of bool, shape (n,)
            Whether each step has a recorded state.
        different : list of (Step, State)
            Steps with the recorded state where that is different.

        """
        is_recorded = np.zeros(len(steps), np.bool_)
        if not steps:
            return is_recorded, []
        due = np.array([step.due_ns for step in steps], np.int64)
        self._repeated.append((int(due.min()), int(due.max())))
        bits = np.frombuffer(b''.join(STATE.pack(*step.state) for step in steps), np.int64)
        bits = bits.reshape(len(steps), -1)
        different = []
        first, last = (np.searchsorted(self._stamps, due, side) for side in ('left', 'right'))
        for index in np.flatnonzero(first < last).tolist():
            rows = np.arange(first[index], last[index])
            rows = rows[~self._is_used[rows]]
            if not rows.size:
                continue
            is_same = (self._bits[self._order[rows]] == bits[index]).all(axis=1)
            row = rows[is_same.argmax()]
            self._is_used[row] = is_recorded[index] = True
            if not is_same.any():
                recorded = self._bits[self._order[row]].view(np.float64)
                different.append((steps[index], State(*recorded.tolist())))
        return is_recorded, different

    def unmatched(self) -> tuple[Integers, Integers]:
        """Return the stamps of states without a step: between repeated steps, and elsewhere."""
        stamps = self._stamps[~self._is_used]
        starts = [start for start, _ in sorted(self._repeated)]
        ends = np.maximum.accumulate([0, *(end for _, end in sorted(self._repeated))])
        is_between = stamps <= ends[np.searchsorted(starts, stamps, 'right')]
        return stamps[is_between], stamps[~is_between]


class RecordedNumbers:
    """
    The numbers of one topic `~/throw/*`, compared in their order because they have no stamps.

    A recorded number belongs to the last throw with the same value in the journal so far. Numbers
    before the start of a run may belong to the run, since a recorder that joins late receives the
    last number and the journal at once.
    """

    def __init__(self, name: str, stage: str) -> None:
        self.name = name  # in the results of throws
        self.stage = stage  # of the results that have the number
        self.unreadable = 0  # number of messages that are no number
        self.last_step = 0  # step of the last expected number of this run
        self._recorded: list[tuple[bytes, int, bool]] = []  # publishing [ns], whether in the run
        self._expected: list[bytes] = []

    def add(self, message: Message, *, is_in_run: bool) -> None:
        """Add a recorded message std_msgs/Float64."""
        if message.data[:2] != b'\0\1' or len(message.data) < 12:
            self.unreadable += 1
        else:
            self._recorded.append((message.data[4:12], message.published, is_in_run))

    def expect(self, value: float, step: int) -> None:
        """Add a number of the repeated session, and its step."""
        self._expected.append(_NUMBER.pack(value))
        self.last_step = step

    def end_run(self, result_times: Sequence[int]) -> tuple[Flags, list[float], int]:
        """
        Compare the numbers of a run, and begin another one.

        Parameters
        ----------
        result_times : sequence of int
            Times of publishing of the lines of the journal about results of this stage. [ns]

        Returns
        -------
        is_recorded : array of bool, shape (n,)
            Whether each expected number is recorded.
        different : list of float
            Recorded numbers that are not expected.
        unchecked : int
            How many recorded numbers may be of a throw before the run [-].

        """
        indices: dict[bytes, list[int]] = {}
        for index, number in enumerate(self._expected):
            indices.setdefault(number, []).append(index)
        is_recorded = np.zeros(len(self._expected), np.bool_)
        limit, unchecked = len(self._expected), 0
        different: list[float] = []
        for number, time, is_in_run in reversed(self._recorded):
            limit = min(limit, bisect_right(result_times, time + ORDER_TIME))
            candidates = indices.get(number, [])
            while candidates and candidates[-1] >= limit:
                candidates.pop()
            if candidates:
                limit = candidates.pop()
                is_recorded[limit] = True
            elif is_in_run:
                different.extend(_NUMBER.unpack(number))
            else:
                unchecked += 1
        self._recorded, self._expected = [], []
        return is_recorded, different, unchecked
