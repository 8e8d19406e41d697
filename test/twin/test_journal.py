# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The journal: its entries, and the replay of a session from its journal."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
import math
from operator import itemgetter
import re
from typing import Any
from zlib import crc32

from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.twin import journal
from twin_runs import Run, Sample, samples_of


@pytest.fixture(scope='module')
def eventful() -> Any:
    """Return a run with throws, changes, a reset and a request."""
    run = Run(throw__max_events=4)
    for steps, changes in (
        (1234, {'layer.thickness': 0.0123, 'rate.state': 800.0}),
        (1111, {'uncertainty.mass': 0.02, 'gravity': 0.0}),
        (2000, {'throw.period': 0.6, 'throw.max_events': 2, 'layer.thickness': 0.0168}),
        (2000, {'throw.period': 0.0, 'time_scale': 0.1, 'rate.field': 333.0, 'gravity': 3.7}),
        (3000, {'projectile.mass': 4e-3}),
    ):
        run.go(steps)
        run.session.change(changes)
        run.session.reset()
    run.go(1500)
    run.session.request_throw()
    run.go(1000)
    run.session.change({'throw.period': 0.05, 'engine.frequency': 50.0})
    run.go(3000)
    run.session.close()
    return run


def test_replay_writes_the_same_journal_and_starts_at_a_throw(eventful) -> None:
    eventful.assert_repeated()
    eventful.assert_repeated(throw=3)
    lines = [journal.decode(line)['line'] for line in eventful.journal]
    assert lines == list(range(len(lines)))


# checksums and results


def test_checksums_are_those_of_the_states_and_fields(eventful) -> None:
    checksums = eventful.entries('checksum')
    assert checksums[0]['first'] == 0
    assert checksums[-1]['step'] == eventful.session.step
    for earlier, later in pairwise(checksums):
        assert later['first'] == earlier['step']
    assert max(entry['step'] - entry['first'] for entry in checksums) == 100
    assert set(eventful.starts()) < {entry['first'] for entry in checksums}
    for entry in checksums:
        outputs = eventful.outputs[entry['first']:entry['step']]
        fields = [array.tobytes() for item in outputs for array in item.layer or ()]
        states = [journal.STATE.pack(*item.state) for item in outputs]
        assert entry['states'] == crc32(b''.join(states))
        assert entry['fields'] == crc32(b''.join(fields))


def test_results_are_in_the_journal_with_all_digits(eventful) -> None:
    results = [result.values() for outputs in eventful.outputs for result in outputs.results]
    assert {math.inf} < {values['apex_height'] for values in results}  # without gravity
    assert [entry['result'] for entry in eventful.entries('result')] == [
        {name: None if value == math.inf else value for name, value in values.items()}
        for values in results
    ]


# samples

numbers = st.floats(allow_nan=False)
samples = st.builds(Sample, st.integers(0, 2**62), numbers, numbers)
batches = st.lists(samples, min_size=1, max_size=5).map(samples_of)


@given(
    st.lists(
        st.tuples(st.integers(0, 2**40), batches),
        min_size=1,
        max_size=6,
        unique_by=lambda batch: batch[0],
    ).map(partial(sorted, key=itemgetter(0)))
)
def test_encoded_samples_are_decoded_bit_by_bit(batches) -> None:
    lines: list[str] = []
    writer = journal.JournalWriter(lines.append, step=batches[-1][0])
    for step, batch in batches:
        writer.keep_samples(step, batch)
    writer.close(batches[-1][0])
    (entry,) = map(journal.decode, lines)
    assert repr(journal.decode_samples(entry)) == repr(batches)
    assert entry['count'] == sum(len(batch) for _, batch in batches)


# inconsistent journals


@pytest.mark.parametrize(
    'line',
    [
        'nonsense', '[1, 2]', '{"kind": "throw"}', '{"kind": "throw", "step": 0.5}',
        '{"kind": "throw", "step": 7, "throw": "one"}', '{"kind": "x", "step": 7, "line": ""}',
        '{"kind": "start", "step": 7, "versions": 6}', '{"kind": ["start"], "step": 7}',
    ],
)
def test_invalid_line_is_refused_and_quoted(line) -> None:
    with pytest.raises(journal.JournalError, match=re.escape(line[-9:])):
        journal.decode(line)


def test_unknown_input_is_refused_and_quoted() -> None:
    entry = {'kind': 'input', 'step': 2, 'input': 'sing'}
    with pytest.raises(journal.JournalError, match='sing'):
        list(Run().session.follow(entry))
