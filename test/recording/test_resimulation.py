# SPDX-License-Identifier: Apache-2.0
"""Steps again from journals, whole and with lines missing, without bags."""

from __future__ import annotations

import json
import math
from pathlib import Path
import runpy
from typing import Any

import hypothesis
from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.resimulation import (
    Place,
    read_stretches,
    Resimulation,
    Step,
    Timeline,
)
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.pace import Pace
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session

rigs: Any = runpy.run_path(str(Path(__file__).parents[1] / 'twin' / 'rigs.py'))

SECOND = 1_000_000_000
BEGIN = 5 * SECOND + 123


class Run:
    """A session that keeps pace, its journal, and what came out when."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.came: list[tuple[int, Outputs]] = []
        self.now = BEGIN
        self.restart()

    def restart(self) -> None:
        settings = {**TWIN.defaults(), 'throw.period': 0.1}
        self.session = Session(settings, on_entry=self.lines.append)
        self.set_clock(self.now)

    def set_clock(self, now: int) -> None:
        self.pace = Pace(step=self.session.step, time_ns=now, rate=self.session.rate)
        self.session.keep_pace(self.pace)

    def go(self, steps: int) -> None:
        for _ in range(steps):
            self.now = self.pace.deadline(self.session.step)
            self.came.append((self.now, self.session.advance()))

    def steps(self, lines: list[str] | None = None) -> tuple[list[Step], list[str]]:
        """Repeat all; return what comes, and what does not fit."""
        misfits: list[str] = []
        lines = self.lines if lines is None else lines
        timeline = Timeline(read_stretches(lines))
        resimulation = Resimulation(read_stretches(lines), misfits.append)
        found, place = [], None
        for due, outputs in self.came:
            place = timeline.find(due, place) or place
            if place is not None and timeline.pieces[place.piece].pace is not None:
                assert place.step == outputs.step
                found += resimulation.until(timeline.pieces[place.piece].run, place.step)
        return found, misfits


@pytest.fixture
def run() -> Run:
    run = Run()
    run.go(250)
    return run


def kinds(lines: list[str]) -> list[str]:
    return [journal.decode(line)['kind'] for line in lines]


def test_steps_come_again_with_their_times_and_lines(run) -> None:
    run.session.reset()
    run.set_clock(run.now + SECOND)
    run.go(200)
    steps, misfits = run.steps()
    assert misfits == []
    assert [(step.due_ns, step.outputs.state) for step in steps] == [
        (due, outputs.state) for due, outputs in run.came
    ]
    assert [line for step in steps for line in step.lines] == run.lines
    for step in steps:
        for line in step.lines:
            assert journal.decode(line)['step'] == step.number


def test_stretches_go_from_start_to_start(run) -> None:
    stretches = list(read_stretches(run.lines))
    assert [(stretch.throw, stretch.begin, stretch.end) for stretch in stretches] == [
        (0, 0, 100),
        (1, 100, 200),
        (2, 200, None),
    ]
    assert [kinds([line for _, line in stretch.lines]) for stretch in stretches] == [
        ['start', 'pace'],
        ['pace', 'throw'],
        ['pace', 'throw'],
    ]
    assert [stretch.run for stretch in stretches] == [0, 0, 0]


def test_timeline_has_a_piece_for_every_pace_and_no_more(run) -> None:
    run.go(20)
    run.set_clock(run.now + SECOND)
    run.go(200)
    run.now += SECOND
    run.restart()
    run.go(250)
    timeline = Timeline(read_stretches(run.lines))
    assert [(piece.run, piece.begin, piece.end) for piece in timeline.pieces] == [
        (0, 0, 270),
        (0, 270, None),
        (1, 0, None),
    ]
    assert timeline.gaps == []
    assert timeline.begin_ns == BEGIN
    assert not timeline.is_set_back


def test_timeline_finds_every_step_and_nothing_between(run) -> None:
    run.set_clock(run.now - SECOND // 10)  # the clock is set back: two steps at some times
    run.go(300)
    timeline = Timeline(read_stretches(run.lines))
    assert timeline.is_set_back
    place = None
    for due, outputs in run.came:
        place = timeline.find(due, place)
        assert place is not None
        assert place.step == outputs.step
        assert timeline.find(due + 1, place) is None
        assert timeline.find(due, place) is None or due <= run.came[249][0]
    assert timeline.find(BEGIN - 1, None) is None
    assert timeline.find(run.came[-1][0] + 1_000_000, place) == Place(1, 550)


@pytest.mark.parametrize(
    ('missing', 'gap'),
    [
        (lambda entry: entry['step'] == 200, 'throw 2 is missing'),
        (lambda entry: entry['step'] in (200, 300), 'throw 3 is missing, and 1 before'),
        (
            lambda entry: entry['step'] == 200 and entry['kind'] == 'pace',
            'a line about the pace is missing before throw 2',
        ),
        (
            lambda entry: entry['kind'] == 'input',
            'a change of layer.thickness, gravity is missing before throw 3',
        ),
    ],
)
def test_what_lacks_a_line_is_left_out_and_the_rest_is_repeated(run, missing, gap) -> None:
    run.session.change({'layer.thickness': 0.01, 'gravity': 1.6})
    run.go(300)
    lines = [line for line in run.lines if not missing(journal.decode(line))]
    steps, misfits = run.steps(lines)
    assert misfits == []
    assert Timeline(read_stretches(lines)).gaps[0] == gap
    assert 100 <= len(steps) < len(run.came)
    states = {outputs.step: outputs.state for _, outputs in run.came}
    assert all(step.outputs.state == states[step.number] for step in steps)


def test_session_begins_with_the_last_start_before_the_first_step_asked_for() -> None:
    run = Run()
    run.go(1000)
    resimulation = Resimulation(read_stretches(run.lines), pytest.fail)
    steps = list(resimulation.until(0, 777))
    assert [step.number for step in steps] == list(range(700, 778))
    assert [step.number for step in resimulation.until(0, 780)] == [778, 779, 780]
    assert list(resimulation.until(0, 780)) == []


def test_next_session_waits_until_it_is_asked_for(run) -> None:
    run.restart()
    run.go(350)
    resimulation = Resimulation(read_stretches(run.lines), pytest.fail)
    assert [step.number for step in resimulation.until(0, 205)] == list(range(200, 206))
    assert [step.at for step in resimulation.until(1, 310)] == [(1, k) for k in range(300, 311)]


def test_start_that_does_not_come_again_is_told_and_begun_with(run) -> None:
    run.session.reset()
    run.go(300)
    lines = [line for line in run.lines if journal.decode(line)['kind'] != 'input']
    steps, misfits = run.steps(lines)
    assert misfits == [
        'throw 3 starts with step 350 in the journal, and not so when it is repeated'
    ]
    states = {outputs.step: outputs.state for _, outputs in run.came}
    assert all(step.outputs.state == states[step.number] for step in steps if step.number >= 350)


def test_steps_before_the_first_pace_are_not_repeated(run) -> None:
    start = journal.encode({**journal.decode(run.lines[0]), 'step': -1})
    steps, misfits = run.steps([start, *run.lines[1:]])
    assert misfits == []
    assert [step.number for step in steps] == list(range(100, 250))
    [gap] = Timeline(read_stretches([start, *run.lines[1:]])).gaps
    assert gap == 'the pace of step -1 is missing'


@given(data=st.data())
@hypothesis.settings(max_examples=300)
def test_journal_of_any_kind_is_repeated_or_left_out(data) -> None:
    run = Run()
    run.go(105)
    run.session.change({'throw.period': 0.05, 'gravity': 3.0})
    run.go(60)
    lines = list(run.lines)
    for _ in range(data.draw(st.integers(1, 3))):
        index = data.draw(st.integers(0, len(lines) - 1))
        lines[index] = data.draw(spoilt(lines[index]))
    timeline = Timeline(read_stretches(lines))
    assert all(isinstance(gap, str) and gap for gap in timeline.gaps)
    misfits: list[str] = []
    resimulation = Resimulation(read_stretches(lines), misfits.append)
    place = None
    for due, _ in run.came:
        place = timeline.find(due, place) or place
        if place is not None and place.step >= 0 and place.step < 1000:
            list(resimulation.until(timeline.pieces[place.piece].run, place.step))


class MeasuredRun(Run):
    """A session with a measured plate."""

    def restart(self) -> None:
        settings = {**TWIN.defaults(), 'engine.motion': 'measured'}
        self.session = Session(settings, on_entry=self.lines.append)
        self.set_clock(self.now)

    def throw(self) -> None:
        """Measure a throw, and break it off."""
        begin_ns = self.pace.deadline(self.session.step)
        samples = rigs['measured_throw'](Rig(), begin_ns=begin_ns, duration=0.12, noise=5e-6)
        while samples:
            now = self.pace.deadline(self.session.step)
            count = sum(sample.stamp_ns <= now for sample in samples)
            self.session.measure(samples[:count])
            del samples[:count]
            self.go(1)
        self.session.reset()


@pytest.fixture(scope='module')
def measured() -> MeasuredRun:
    run = MeasuredRun()
    run.throw()
    run.throw()
    run.session.close()
    return run


def test_measured_steps_come_again(measured) -> None:
    steps, misfits = measured.steps()
    assert misfits == []
    assert [(step.due_ns, step.outputs.state) for step in steps] == [
        (due, outputs.state) for due, outputs in measured.came
    ]


@given(data=st.data())
@hypothesis.settings(max_examples=60)
def test_measured_journal_of_any_kind_is_repeated_or_left_out(measured, data) -> None:
    lines = list(measured.lines)
    for _ in range(data.draw(st.integers(1, 3))):
        index = data.draw(st.integers(0, len(lines) - 1))
        lines[index] = data.draw(spoilt(lines[index]))
    timeline = Timeline(read_stretches(lines))
    misfits: list[str] = []
    resimulation = Resimulation(read_stretches(lines), misfits.append)
    place = None
    for due, _ in measured.came:
        place = timeline.find(due, place) or place
        if place is not None and 0 <= place.step < 1000:
            list(resimulation.until(timeline.pieces[place.piece].run, place.step))


VALUES = st.one_of(
    st.sampled_from([None, True, -1, 0, 2**70, 1e300, math.nan, '', [], {}, '[' * 100_000]),
    st.floats(),
    st.integers(),
    st.text(max_size=5),
)


@st.composite
def spoilt(draw: Any, line: str) -> str:
    """Change an entry of a journal in one place, or all of its line."""
    try:
        entry = journal.decode(line)
    except (journal.JournalError, RecursionError):
        return line  # it is spoilt already
    kind = draw(st.sampled_from(['cut', 'key', 'value', 'inner', 'other']))
    if kind == 'cut':
        return line[: draw(st.integers(0, len(line)))]
    if kind == 'other':
        return str(draw(VALUES))
    where = entry
    if kind == 'inner':
        inner = [entry[name] for name in ('settings', 'departure') if name in entry]
        where = draw(
            st.sampled_from([part for part in inner if isinstance(part, dict)] or [entry])
        )
    key = draw(st.sampled_from(sorted(where)))
    if kind == 'key':
        del where[key]
    else:
        where[key] = draw(VALUES)
    return json.dumps(entry)
