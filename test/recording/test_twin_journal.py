# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rigs and throws read from the journal of a twin."""

from __future__ import annotations

from collections.abc import Iterable

from bags import BEGIN, channel, text
import numpy as np
import pytest
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording import twin_journal
from soft_throw_ros.recording.twin_journal import find_throws, ThrowStart, TwinJournal
from soft_throw_ros.storage import cdr
from soft_throw_ros.storage.message import Message, SECOND
from soft_throw_ros.twin.journal import decode
from twin_runs import Run

JOURNAL = channel('/twin/journal')


def lines_of(run: Run) -> list[Message]:
    return [Message(JOURNAL, text(line), 1, 1) for line in run.journal]


def journal_of(lines: Iterable[Message]) -> TwinJournal:
    journal = TwinJournal()
    for message in lines:
        journal.read(message)
    return journal


def test_rig_changes_with_a_throw() -> None:
    twin = Run(throw__period=0.1, time_scale=0.1)
    twin.go(1500)
    twin.session.change({'layer.thickness': 0.01})
    assert journal_of(lines_of(twin)).rig == Rig()
    twin.go(1000)
    assert journal_of(lines_of(twin)).rig.layer.thickness == 0.01


def test_a_throw_is_over_when_its_end_is_reported() -> None:
    twin = Run(throw__period=0.3)
    twin.go(620)  # the second throw has been released
    journal = lines_of(twin)
    first, second = find_throws(journal)['/twin'][-2:]
    assert first.ejection_time == second.ejection_time
    assert first.stamp == twin.schedule.deadline(twin.starts()[-2])
    assert (first.is_over, second.is_over) == (True, False)
    last = next(item for item in reversed(journal) if '"throw":1,' in str(item.data))
    cut = journal[:journal.index(last)]  # repeated, up to before the end of the first throw
    assert find_throws(journal + cut)['/twin'][-2].is_over


@pytest.mark.parametrize('motion', ['underdamped', 'measured'])
def test_most_lines_need_not_be_read(motion) -> None:
    twin = Run(throw__period=0.3, engine__motion=motion)
    twin.go(620)
    kinds = {decode(line)['kind'] for line in twin.journal}
    lines = lines_of(twin)
    read = [message for message in lines if TwinJournal.reads(message)]
    read_kinds = {decode(cdr.decode(message).data)['kind'] for message in read}
    assert kinds - read_kinds == kinds & {'checksum', 'samples'} != set()
    assert vars(journal_of(read)) == vars(journal_of(lines))


def test_stamps_of_slow_motion_are_times_of_the_rig() -> None:
    throw = ThrowStart(stamp=BEGIN, number=1, time_scale=0.1)
    stamps = throw.stamps_at(np.array([-0.5, 0.0, 2.0]))
    assert (stamps - BEGIN).tolist() == [-5 * SECOND, 0, 20 * SECOND]
    assert throw.seconds_to(stamps) == pytest.approx([-0.5, 0.0, 2.0])


@pytest.mark.parametrize('line', [
    '{}', '[' * 100_000, '{"kind": "throw", "step": 3}',
    '{"kind": "start", "step": 3, "settings": {"layer.thickness": "thick"}}',
    '{"kind": "start", "step": 3, "settings": [1]}',
    '{"kind": "throw", "step": 3, "throw": 1, "settings": {}, "schedule": {"rate": -1}}',
])
def test_invalid_journal_lines_are_refused_like_damage(line) -> None:
    journal = TwinJournal()
    with pytest.raises(twin_journal.DECODING_ERRORS):
        journal.read(Message(JOURNAL, text(line), 5, 5))
    assert journal.rig is None
