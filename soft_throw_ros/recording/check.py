# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Comparison of a bag with the session that its own journal repeats.

The journal has the inputs of a twin, and checksums and results of its steps. The session is
repeated from the inputs. Every recorded state, every checksum and every result is compared with
the repeated one, to the last bit. Sessions of other versions are not compared, because these
compute other last bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from soft_throw_ros.configuration.interface import JOINT_STATE, TEXT, TWIN_TOPICS
from soft_throw_ros.recording.recorded_states import RecordedStates, Step
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import decode, MessageError
from soft_throw_ros.storage.message import BagError, Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import RequestRejected, Session

MAX_STEPS_BETWEEN_LINES = 20_000
"""Largest number of steps from one line of a journal to the next [-]: checksums come every second,
which has 5000 steps at the highest rate."""

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
    missing: int = 0  # repeated, and not in the bag
    unchecked: int = 0  # in the bag, and not repeated

    def describe(self, name: str) -> str:
        """Return a sentence for people to read."""
        text = f'{self.same} {name} are the same, {self.different} are different'
        for count, outcome in ((self.missing, 'in the bag'), (self.unchecked, 'compared')):
            text += f', {count} not {outcome}' if count else ''
        return text


@dataclass(kw_only=True)
class CheckResult:
    """Outcome of the comparison for a twin in a bag."""

    twin: str  # name of the node
    states: Count = field(default_factory=Count)
    results: Count = field(default_factory=Count)  # in the journal, as the next one
    checksums: Count = field(default_factory=Count)
    missing_lines: int = 0  # of the journal
    differences: list[str] = field(default_factory=list)
    reason: str = ''  # why nothing was compared, if so

    @property
    def exit_code(self) -> int:
        """1 if anything is different, 2 if nothing was compared, else 0."""
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
                self.results.describe('results of throws'),
                self.checksums.describe('checksums'),
                f'{self.missing_lines} lines of the journal are not in the bag',
            ]
        lines += [f'different: {sentence}' for sentence in self.differences[:_SHOWN]]
        if len(self.differences) > _SHOWN:
            lines.append(f'different: and {len(self.differences) - _SHOWN} more')
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
        self._states = RecordedStates(reader, TWIN_TOPICS.joint_states.at(node).name)
        self._line = -1  # the last one that was read
        self._step_count = 0
        self._begin_run(None)

    def run(self) -> CheckResult:
        """Repeat the journal in one pass, and return the result."""
        topic = TWIN_TOPICS.journal.at(self._node).name
        for message in self._reader.messages([topic], by_log_time=False):
            try:
                entry = _entry(message)
            except journal.JournalError as error:
                if self._session is not None:  # else it may be of another program
                    self._give_up(f'a line after line {self._line} is unreadable: {error!s:.200}')
            else:
                self._read_line(entry)
        self._end_run()
        result = self._result
        if not self._step_count:
            result.reason = result.reason or 'not compared: the journal has no start of a throw'
            return result
        between, result.states.unchecked = self._states.count_others()
        for count, reason in (
            (between, 'states are of no step of the session'),
            (self._states.unreadable, 'messages are no state of plate and projectile'),
        ):
            if count:
                result.states.different += count
                result.differences.append(f'{count} {reason}')
        return result

    # the journal

    def _read_line(self, entry: journal.Entry) -> None:
        """Advance to a line of the journal; a start line begins a run."""
        kind, number = entry['kind'], entry['line']
        if kind == 'start':
            self._line = -1
        self._result.missing_lines += max(number - self._line - 1, 0)
        if kind == 'start' or number != self._line + 1:
            self._end_run()
        self._line = number
        try:
            if self._session is not None:
                self._go_on(entry, self._session)
            elif kind in ('start', 'throw') and self._is_of_these_versions(entry):
                self._begin_run(Session.from_entry(entry, on_entry=self._on_entry))
            if self._session is not None and kind in _COMPARED:
                self._recorded.append(entry)
            self._compare_lines()
        except _UNREPEATABLE as error:
            self._give_up(f'line {number} cannot be repeated: {error!s:.300}')

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
        self._recorded: deque[journal.Entry] = deque()  # lines to be compared
        self._repeated: deque[journal.Entry] = deque()  # the same, by the repeated session
        self._steps: list[Step] = []  # steps whose states are to be compared

    def _on_entry(self, line: str) -> None:
        entry = journal.decode(line)
        if entry['kind'] in _COMPARED:
            self._repeated.append(entry)

    def _go_on(self, entry: journal.Entry, session: Session) -> None:
        """Repeat the steps up to a line, and the input that it has."""
        distance = entry['step'] - session.step
        if distance > MAX_STEPS_BETWEEN_LINES:
            raise journal.JournalError(
                f'it is {distance} steps after the one before, which is more than '
                f'{MAX_STEPS_BETWEEN_LINES}'
            )
        self._keep(session.follow(entry), session)

    def _keep(self, steps: Iterable[Outputs], session: Session) -> None:
        """Store the outputs of steps for the comparison."""
        for outputs in steps:
            self._steps.append(Step(session.due_ns(outputs.step), outputs.step, outputs.state))
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
            if entry['kind'] == 'checksum':
                session.close()
            else:
                self._keep([session.advance()], session)
            self._compare_lines()
            if self._recorded and self._recorded[0] is entry:
                raise journal.JournalError(
                    f'{entry["kind"]} of step {entry["step"]} is not repeated'
                )

    def _end_run(self) -> None:
        """Compare the outputs that wait, and forget the session."""
        if self._session is None:
            return
        try:
            self._finish(self._session)
        except _UNREPEATABLE as error:
            self._give_up(f'the steps up to line {self._line} cannot be repeated: {error!s:.300}')
            return
        self._compare_states()
        self._begin_run(None)

    def _give_up(self, difference: str) -> None:
        """Note that the session cannot be repeated, up to the next throw."""
        self._result.differences.append(difference)
        self._compare_states()
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
        if not self._steps:
            return
        count = self._result.states
        same, missing, different = self._states.compare(self._steps)
        count.same += same
        count.missing += missing
        for step, state in different:
            difference = _first_difference(state._asdict(), step.state._asdict())
            where = f'states: step {step.number}'
            self._result.count(count, where, difference or 'other bits of a value')
        self._steps.clear()


def _entry(message: Message) -> journal.Entry:
    """Read a line of a journal; raise JournalError if it cannot be read, or has no number."""
    try:
        entry = journal.decode(str(decode(message).data))
    except (MessageError, AttributeError) as error:
        raise journal.JournalError(str(error)) from error
    if 'line' not in entry:
        raise journal.JournalError('it has no number')
    return entry


def _values(entry: journal.Entry, names: Iterable[str]) -> dict[str, object]:
    return {name: entry.get(name) for name in names}


def _first_difference(recorded: Mapping[str, object], repeated: Mapping[str, object]) -> str:
    """Return a description of the first value that is not the same; empty if all are."""
    for name in {**repeated, **recorded}:
        there, here = recorded.get(name), repeated.get(name)
        if repr(there) != repr(here):  # which distinguishes zeros by their signs
            return f'{name:.80} is {there!r:.80} in the bag, and {here!r:.80} when repeated'
    return ''
