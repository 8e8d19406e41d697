# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Comparison of a bag with the session that its own journal repeats.

The journal has the inputs of a twin, and checksums and results of its steps. The session is
repeated from the inputs. Every recorded state, every number of `~/throw/*`, every checksum and
every result is compared with the repeated one, to the last bit. The recorder must have counted
the messages that are missing. Sessions of other versions are not compared, because these compute
other last bits.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping, MutableSequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from soft_throw_ros.configuration.interface import JOINT_STATE, TEXT, THROW_TOPICS, TWIN_TOPICS
from soft_throw_ros.recording.recorded_outputs import (
    count_missing,
    count_skipped,
    RecordedNumbers,
    RecordedStates,
    Step,
)
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import decode, MessageError
from soft_throw_ros.storage.message import BagError, LOSSES, Message, MISSED_BEFORE_JOIN
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import RequestRejected, Session

MAX_STEPS_BETWEEN_LINES = 20_000
"""Largest number of steps from one line of a journal to the next [-]: checksums come every second,
which has 5000 steps at the highest rate."""

_MAX_EARLY_LINES = 16
"""Largest number of lines that wait for the first line of a journal. [-]

A recorder that joins late may receive new lines before the older, latched ones.
"""

JOURNAL_END = 3.0
"""Largest time from the last line of the journal to the last state [s]: lines come every second,
or later if the twin is busy."""

END_TIME = 0.1
"""Largest time from the last state to the end of the journal [s]: topics are drained in turn."""

_COMPARED = ('throw', 'result', 'checksum')
_INPUTS = ('kind', 'step', 'throw', 'settings', 'pending', 'schedule')
_CHECKSUMS = ('first', 'states', 'fields')
_SHOWN = 5  # differences that are described one by one
_PROGRESS = 100_000  # steps between two reports
_BATCH = 5_000  # steps whose states are compared at once
_UNREPEATABLE = (RequestRejected, ValueError, ArithmeticError)


class CheckError(BagError):
    """A bag has nothing that could be checked."""


@dataclass(kw_only=True)
class Count:
    """Numbers of outputs of one kind, by the outcome of the comparison [-]."""

    same: int = 0
    different: int = 0
    missing: int = 0  # and not counted as lost by the recorder
    lost: int = 0  # missing, and counted by the recorder, or from before it or after it
    unchecked: int = 0  # recorded, and not repeated

    def describe(self, name: str) -> str:
        """Return a sentence for people to read."""
        text = f'{self.same} {name} are the same, {self.different} are different'
        for count, outcome in (
            (self.missing, 'missing'),
            (self.lost, 'not recorded'),
            (self.unchecked, 'not compared'),
        ):
            text += f', {count} {outcome}' if count else ''
        return text


@dataclass(kw_only=True)
class CheckResult:
    """Outcome of the comparison for a twin in a bag."""

    twin: str  # name of the node
    states: Count = field(default_factory=Count)
    numbers: Count = field(default_factory=Count)  # messages of `~/throw/*`
    results: Count = field(default_factory=Count)  # in the journal, as the next two
    checksums: Count = field(default_factory=Count)
    lines: Count = field(default_factory=Count)  # the same if they are in order
    differences: list[str] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)  # of the journal
    reason: str = ''  # why nothing was compared, if so

    @property
    def exit_code(self) -> int:
        """0 if all is the same, 1 if something is not, 2 if nothing was compared."""
        if self.differences:
            return 1
        return 0 if self.checksums.same or self.results.same else 2

    def describe(self) -> str:
        """Return lines for people to read."""
        lines = [self.reason] if self.reason else []
        if self.differences or not self.reason:
            lines += [
                'compared to the last bit',
                self.states.describe('states'),
                self.numbers.describe('numbers of ~/throw/*'),
                self.results.describe('results of throws'),
                self.checksums.describe('checksums'),
                self.lines.describe('lines of the journal in order'),
            ]
        for kind, sentences in (('missing', self.gaps), ('different', self.differences)):
            lines += [f'{kind}: {sentence}' for sentence in sentences[:_SHOWN]]
            if len(sentences) > _SHOWN:
                lines.append(f'{kind}: and {len(sentences) - _SHOWN} more')
        return '\n'.join(lines)

    def count(self, count: Count, where: str, difference: str) -> None:
        """Count a comparison, with a description of the difference if there is one."""
        if difference:
            count.different += 1
            self.differences.append(f'{where}: {difference}')
        else:
            count.same += 1


def check_bag(
    reader: BagReader, on_progress: Callable[[str, int], None] = lambda _twin, _steps: None
) -> list[CheckResult]:
    """
    Check every twin in a bag, which is read twice for each.

    `on_progress` is called with the name of a twin and the number of its repeated steps.

    Raises
    ------
    CheckError
        If the bag contains no twin.
    BagError
        If the bag cannot be read.

    """
    types = {channel.topic: channel.type for channel in reader.channels}
    ending = TWIN_TOPICS.journal.at('').name
    nodes = [
        topic.removesuffix(ending)
        for topic, type_name in types.items()
        if topic.endswith(ending) and type_name == TEXT
    ]
    nodes = [
        node for node in nodes if types.get(TWIN_TOPICS.joint_states.at(node).name) == JOINT_STATE
    ]
    if not nodes:
        raise CheckError(
            f'{reader.path}: the bag needs the topics {TWIN_TOPICS.journal.relative_name} and '
            f'{TWIN_TOPICS.joint_states.relative_name} of a twin, and has '
            f'{", ".join(types) or "none"}'
        )
    return [_Check(reader, node, on_progress).run() for node in nodes]


class _Check:
    """
    The check of one twin: its session is repeated line by line of the journal.

    A run is a part of the journal without missing lines. It begins with the start of a session or
    of a throw, because these lines have all that is needed to go on.
    """

    def __init__(
        self, reader: BagReader, node: str, on_progress: Callable[[str, int], None]
    ) -> None:
        self._reader = reader
        self._node = node
        self._on_progress = on_progress
        self._result = CheckResult(twin=node)
        self._journal_topic = TWIN_TOPICS.journal.at(node).name
        self._states_topic = TWIN_TOPICS.joint_states.at(node).name
        self._states = RecordedStates(reader, self._states_topic)
        recorded = {channel.topic for channel in reader.channels}
        self._numbers = {  # of throws, by topic
            topic.at(node).name: RecordedNumbers(number.name, number.stage)
            for number, topic in THROW_TOPICS
            if number.is_repeatable and topic.at(node).name in recorded
        }
        # messages that are missing at the ends of runs and within runs, by topic
        self._missing: defaultdict[str, np.ndarray[Any, Any]] = defaultdict(
            lambda: np.zeros(2, np.int64)
        )
        # numbers that publishers gave to messages, by topic
        self._sequences: defaultdict[str, MutableSequence[int]] = defaultdict(list)
        self._line = -1  # the last one that was read
        self._early: dict[int, tuple[journal.Entry, int]] = {}  # lines and log times, by number
        self._throw = 0
        self._step_count = 0
        self._last_due_ns = 0  # of the last repeated step [ns]
        self._last_rate = 0.0  # of the last run [Hz]
        self._is_complete = True  # whether the last run came to its end
        self._has_begun = False  # whether a session was repeated
        self._session: Session | None = None
        self._begin_run(None)

    def run(self) -> CheckResult:
        """Repeat the journal in one pass, and return the result."""
        topics = self._journal_topic, *self._numbers
        for message in self._reader.messages(topics, by_log_time=False):
            topic = message.channel.topic
            self._sequences[topic].append(message.sequence)
            if topic == self._journal_topic:
                self._receive(_entry(message), message.published)
            else:
                self._numbers[topic].add(message, is_in_run=self._session is not None)
        self._read_early_lines(math.inf)
        self._end_run()
        self._conclude()
        return self._result

    # the journal

    def _receive(self, entry: journal.Entry, published: int) -> None:
        """Read a line of the journal, and early lines once their turn comes."""
        number = entry['line']
        if self._line < 0 < number and len(self._early) < _MAX_EARLY_LINES:
            self._early[number] = entry, published
            return
        self._read_early_lines(number)
        self._read_line(entry, published)
        while self._line + 1 in self._early:
            self._read_line(*self._early.pop(self._line + 1))

    def _read_early_lines(self, end: float) -> None:
        """Read the early lines before a line, in their order."""
        for number in sorted(number for number in self._early if number < end):
            self._read_line(*self._early.pop(number))

    def _read_line(self, entry: journal.Entry, published: int) -> None:
        """Advance to a line of the journal; a start line begins a run."""
        kind, number = entry['kind'], entry['line']
        is_start = kind == 'start'
        is_next = number == self._line + 1
        self._count_line(entry)
        if is_start or not is_next:
            self._end_run()
            self._is_complete = is_start
        self._line = number
        self._throw = entry.get('throw', 0 if is_start else self._throw)
        if kind == 'unreadable':
            return
        try:
            if self._session is not None:
                self._go_on(entry, self._session)
            elif kind in ('start', 'throw') and self._is_of_these_versions(entry):
                self._begin_run(Session.from_entry(entry, on_entry=self._on_entry))
            if self._session is not None and kind in _COMPARED:
                self._recorded.append(entry)
                stage = entry.get('result', {}).get('stage', '')
                times = self._result_times[stage]
                times.append(max([published, *times[-1:]]))
            self._compare_lines()
        except _UNREPEATABLE as error:
            self._give_up(f'throw {self._throw} cannot be repeated from here: {error!s:.300}')

    def _count_line(self, entry: journal.Entry) -> None:
        """Count a line of the journal, and those that are missing before it."""
        lines, number = self._result.lines, entry['line']
        missing = self._missing[self._journal_topic]
        if entry['kind'] == 'unreadable':
            where = f'a line after line {self._line} cannot be read'
            if self._session is not None:
                self._result.count(lines, where, entry['reason'])
        elif entry['kind'] == 'start' or self._line < 0:
            lines.same += 1
            missing[0] += max(number, 0)
        elif number > self._line:
            lines.same += 1
            missing[1] += number - self._line - 1
            if number > self._line + 1:
                self._result.gaps.append(
                    f'{number - self._line - 1} lines before line {number} '
                    f'(after throw {self._throw})'
                )
        else:
            self._result.count(lines, f'line {number}', f'it comes after line {self._line}')

    def _is_of_these_versions(self, entry: journal.Entry) -> bool:
        """Return whether a run can be compared here; note the reason if not."""
        recorded = entry.get('versions', {})
        others = [
            f'{name} {recorded.get(name)!s:.40}, and this is {journal.VERSIONS.get(name)}'
            for name in {**journal.VERSIONS, **recorded}
            if recorded.get(name) != journal.VERSIONS.get(name)
        ]
        if others:
            self._result.reason = (
                'not compared, because other versions compute other last bits: recorded with '
                + '; '.join(others)
            )
        return not others

    # a run

    def _begin_run(self, session: Session | None) -> None:
        """Forget the outputs of the run before."""
        self._session = session
        self._is_complete |= session is not None
        self._has_begun |= session is not None
        self._recorded: deque[journal.Entry] = deque()  # lines to be compared
        self._repeated: deque[journal.Entry] = deque()  # the same, by the repeated session
        # log times of lines about results, by the stage of the result [ns]
        self._result_times: defaultdict[str, list[int]] = defaultdict(list)
        self._steps: list[Step] = []  # steps whose states are to be compared
        self._is_recorded: list[np.ndarray[Any, Any]] = []  # of earlier steps, in parts

    def _on_entry(self, line: str) -> None:
        entry = journal.decode(line)
        if entry['kind'] in _COMPARED:
            self._repeated.append(entry)

    def _go_on(self, entry: journal.Entry, session: Session) -> None:
        """Repeat the steps up to a line, and the input that it has."""
        distance = entry['step'] - session.step
        if distance > MAX_STEPS_BETWEEN_LINES:
            raise journal.JournalError(
                f'line {entry["line"]} is {distance} steps after the one before, which is more '
                f'than {MAX_STEPS_BETWEEN_LINES}'
            )
        self._keep(session.follow(entry), session)

    def _keep(self, steps: Iterable[Outputs], session: Session) -> None:
        """Store the outputs of steps for the comparison."""
        for outputs in steps:
            self._last_due_ns = session.due_ns(outputs.step)
            self._steps.append(Step(self._last_due_ns, outputs.step, outputs.state))
            for result in outputs.results:
                values = result.values() if result.is_valid else {}
                for numbers in self._numbers.values():
                    if numbers.stage == result.stage and numbers.name in values:
                        numbers.expect(float(values[numbers.name]), outputs.step)
            if len(self._steps) >= _BATCH:
                self._compare_states()
            self._step_count += 1
            if self._step_count % _PROGRESS == 0:
                self._on_progress(self._node, self._step_count)
            self._compare_lines()

    def _finish(self, session: Session) -> None:
        """Compare the last lines with one more step, or with the end of the session."""
        while self._recorded:
            entry = self._recorded[0]
            is_end = entry['kind'] == 'checksum'
            if is_end:
                session.close()
            elif session.step <= entry['step']:
                self._keep([session.advance()], session)
            self._compare_lines()
            is_past = is_end or session.step > entry['step']
            if is_past and self._recorded and self._recorded[0] is entry:
                raise journal.JournalError(
                    f'{entry["kind"]} of step {entry["step"]} is not repeated'
                )

    def _end_run(self) -> None:
        """Compare the outputs that wait, and forget the session."""
        session = self._session
        if session is None:
            return
        try:
            self._finish(session)
        except _UNREPEATABLE as error:
            self._give_up(f'the end of throw {self._throw} cannot be repeated: {error!s:.300}')
            return
        self._close_run(session)

    def _give_up(self, difference: str) -> None:
        """Note that the session cannot be repeated, up to the next throw."""
        self._result.differences.append(difference)
        if self._session is not None:
            self._close_run(self._session)
        self._is_complete = False

    def _close_run(self, session: Session) -> None:
        self._compare_states()
        self._last_rate = session.rate
        end = math.ceil(END_TIME * session.rate)
        is_recorded = np.concatenate(self._is_recorded)
        self._missing[self._states_topic] += count_missing(is_recorded, end)
        count = self._result.numbers
        for topic, numbers in self._numbers.items():
            times = self._result_times[numbers.stage]
            is_recorded, different, unchecked = numbers.end_run(times)
            count.same += int(is_recorded.sum())
            count.unchecked += unchecked
            for value in different:
                difference = f'{value!r} in the bag has another value here'
                self._result.count(count, numbers.name, difference)
            # The recorder may have ended between a line and its number
            end = int(numbers.last_step + END_TIME * session.rate >= session.step)
            self._missing[topic] += count_missing(is_recorded, end)
        self._begin_run(None)

    # comparisons

    def _compare_lines(self) -> None:
        """Compare the lines of the journal and of the repeated session, in order."""
        while self._recorded and self._repeated:
            recorded, repeated = self._recorded.popleft(), self._repeated.popleft()
            kind, step = recorded['kind'], recorded['step']
            difference = _first_difference(_values(recorded, _INPUTS), _values(repeated, _INPUTS))
            if difference:
                raise journal.JournalError(f'{kind} of step {step}: {difference}')
            difference = _first_difference(
                recorded.get('result', {}), repeated.get('result', {})
            ) or _first_difference(_values(recorded, _CHECKSUMS), _values(repeated, _CHECKSUMS))
            if kind == 'checksum':
                where = f'steps {repeated["first"]} to {step - 1}'
                self._result.count(self._result.checksums, where, difference)
            elif kind == 'result':
                result = repeated['result']
                where = f'throw {result["throw"]}, {result["stage"]}'
                self._result.count(self._result.results, where, difference)

    def _compare_states(self) -> None:
        """Compare the recorded states of the steps that wait."""
        is_recorded, different = self._states.compare(self._steps)
        self._is_recorded.append(is_recorded)
        self._result.states.same += int(is_recorded.sum()) - len(different)
        for step, state in different:
            difference = _first_difference(state._asdict(), step.state._asdict())
            where = f'states: step {step.number}'
            self._result.count(self._result.states, where, difference or 'other bits of a value')
        self._steps.clear()

    def _conclude(self) -> None:
        """Judge all outputs that have no counterpart, once the journal is at its end."""
        result, states = self._result, self._states
        if not self._has_begun:
            result.reason = result.reason or 'not compared: the journal has no start of a throw'
        for numbers in self._numbers.values():
            if numbers.unreadable:
                result.numbers.different += numbers.unreadable
                result.differences.append(
                    f'{numbers.unreadable} messages of {numbers.name} are no number'
                )
        if self._has_begun:
            between, elsewhere = states.unmatched()
            result.states.different += len(between) + states.unreadable
            result.states.unchecked += len(elsewhere)
            if len(between):
                result.differences.append(
                    f'{len(between)} states are doubled, or of no step of the session, such as '
                    f'that at {between[0]} ns'
                )
            if states.unreadable:
                result.differences.append(
                    f'{states.unreadable} messages are no state of plate and projectile'
                )
            after = int((elsewhere > self._last_due_ns).sum())
            if self._is_complete and after > JOURNAL_END * self._last_rate:
                result.differences.append(
                    f'{after} states come after the last line of the journal'
                )
        self._sequences[self._states_topic] = states.sequences
        for topic in self._numbers:
            self._judge_missing(result.numbers, topic)
        self._judge_missing(result.states, self._states_topic)
        self._judge_missing(result.lines, self._journal_topic)

    def _judge_missing(self, count: Count, topic: str) -> None:
        """Compare the number of missing messages with the losses that the recorder counted."""
        notes = {record.name: record.metadata for record in self._reader.metadata}
        lost = _number(notes.get(LOSSES, {}).get(topic, ''))
        known = lost + _number(notes.get(MISSED_BEFORE_JOIN, {}).get(topic, ''))
        at_ends, within = (int(number) for number in self._missing[topic])
        sequences = self._sequences[topic]
        uncounted = max(within - lost, 0)
        if not len(sequences):  # the time at which the recorder joined is unknown
            uncounted = max(at_ends + within - known, 0)
        elif LOSSES in notes:  # not after a kill, and not of other recorders
            skipped = count_skipped(sequences, is_from_first=self._reader.path.is_dir())
            uncounted = max(uncounted, skipped - known)
        count.missing += uncounted
        count.lost += max(at_ends + within - uncounted, 0)
        if uncounted:
            counted = f'the recorder counted {known}' if LOSSES in notes else 'nobody counted them'
            self._result.differences.append(
                f'{uncounted} messages of {topic} are missing, and {counted} as lost'
            )


def _entry(message: Message) -> journal.Entry:
    """Read a line of a journal; one that cannot be read has the number -1."""
    try:
        entry = journal.decode(str(decode(message).data))
    except (MessageError, AttributeError, journal.JournalError) as error:
        return {'kind': 'unreadable', 'line': -1, 'reason': f'{error!s:.200}'}
    if 'line' not in entry:
        return {'kind': 'unreadable', 'line': -1, 'reason': 'it has no number'}
    return entry


def _number(text: str) -> int:
    """Return a count that the recorder wrote; 0 if it is none."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 20 else 0


def _values(entry: journal.Entry, names: Iterable[str]) -> dict[str, object]:
    return {name: entry.get(name) for name in names}


def _first_difference(recorded: Mapping[str, object], repeated: Mapping[str, object]) -> str:
    """Return a description of the first value that is not the same; empty if all are."""
    for name in {**repeated, **recorded}:
        there, here = recorded.get(name), repeated.get(name)
        if repr(there) != repr(here):  # which distinguishes zeros by their signs
            return f'{name:.80} is {there!r:.80} in the bag, and {here!r:.80} when repeated'
    return ''
