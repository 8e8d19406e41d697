# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the recorded states of a twin with those of a repeated session."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from soft_throw_ros.configuration.interface import JOINTS
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateReader, MessageError
from soft_throw_ros.twin.journal import STATE
from soft_throw_ros.twin.results import State


class Step(NamedTuple):
    """A step of the repeated session."""

    due_ns: int
    number: int
    state: State


class RecordedStates:
    """
    The states on a topic of a bag, found by their stamps.

    Attributes
    ----------
    unreadable : int
        Number of messages that are no state of plate and projectile.

    """

    def __init__(self, reader: BagReader, topic: str) -> None:
        self.unreadable = 0
        recorded, values, read = array('q'), array('d'), JointStateReader().read
        for message in reader.messages([topic], by_log_time=False):
            try:
                stamp, _, *series = read(message.data)
            except MessageError:
                self.unreadable += 1
                continue
            if any(len(numbers) != len(JOINTS) for numbers in series):
                self.unreadable += 1
                continue
            recorded.append(stamp)
            for numbers in series:
                values.extend(numbers)
        stamps = np.asarray(recorded)
        self._order = np.argsort(stamps, kind='stable')
        self._stamps = stamps[self._order]
        self._bits = np.asarray(values).view(np.int64).reshape(-1, len(State._fields))
        # as sorted: whether a step has the stamp, and whether the stamp is between those of steps
        self._is_compared, self._is_between = np.zeros((2, len(stamps)), np.bool_)

    def compare(self, steps: Sequence[Step]) -> tuple[int, int, list[tuple[Step, State]]]:
        """
        Compare the states of steps with the recorded states of the same stamps, to the last bit.

        Returns
        -------
        same : int
            Number of equal states. [-]
        missing : int
            Number of steps without a recorded state. [-]
        different : list of (Step, State)
            Steps with a recorded state that is different.

        """
        due = np.array([step.due_ns for step in steps], np.int64)
        bits = np.frombuffer(b''.join(STATE.pack(*step.state) for step in steps), np.int64)
        first, last = (np.searchsorted(self._stamps, due, side) for side in ('left', 'right'))
        self._is_between[first.min():last.max()] = True
        counts = last - first  # more than 1 for doubled messages
        index = np.repeat(np.arange(len(steps)), counts)
        rows = np.arange(index.size) + (first - counts.cumsum() + counts)[index]
        self._is_compared[rows] = True
        recorded = self._bits[self._order[rows]]
        is_same = (recorded == bits.reshape(len(steps), -1)[index]).all(axis=1)
        different = [
            (steps[index[row]], State(*recorded[row].view(np.float64).tolist()))
            for row in np.flatnonzero(~is_same)
        ]
        return int(is_same.sum()), int((counts == 0).sum()), different

    def count_others(self) -> tuple[int, int]:
        """Return the numbers of states without a step: between compared ones, and elsewhere."""
        others = ~self._is_compared
        return int((others & self._is_between).sum()), int((others & ~self._is_between).sum())
