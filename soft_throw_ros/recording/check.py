# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Comparison of a bag with the session that its own journal repeats.

The journal has the inputs of a twin, and checksums and results of its steps. The session is
repeated from the inputs, and every recorded state of the same stamp, checksum and result is
compared to the last bit. Other versions are refused, because they compute other last bits.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from soft_throw_ros.configuration.interface import find_topic, TWIN_TOPICS
from soft_throw_ros.recording.twin_journal import DECODING_ERRORS
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import decode, JointStateReader
from soft_throw_ros.storage.message import BagError
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import Outputs, State
from soft_throw_ros.twin.session import RequestRejected, Session

MAX_STEPS_BETWEEN_LINES = 20_000  # checksums come ten times a second, after 500 steps [-]
_COMPARED = ('throw', 'result', 'checksum')
_NOT_COMPARED = ('line', 'versions', 'motions', 'onset')
_SHOWN = 5  # differences that are described one by one


class CheckError(BagError):
    """A bag has nothing that could be checked."""


@dataclass(kw_only=True)
class CheckResult:
    """Outcome for a twin in a bag; it counts the `same`, `different` and `missing` outputs."""

    twin: str  # name of the node
    states: Counter[str] = field(default_factory=Counter)
    results: Counter[str] = field(default_factory=Counter)  # and checksums; `missing` are lines
    differences: list[str] = field(default_factory=list)
    reason: str = ''  # why nothing was compared, if so

    @property
    def exit_code(self) -> int:
        """1 if anything is different, 2 if nothing was compared, else 0."""
        if self.differences:
            return 1
        return 0 if self.results['same'] else 2

    def describe(self) -> str:
        """Return lines for people to read."""
        lines = [self.reason] if self.reason else []
        if self.differences or not self.reason:
            kinds = {'states': self.states, 'lines of the journal': self.results}
            lines += [
                f'{name}: {count["same"]} are the same to the last bit, {count["different"]} are '
                f'different, {count["missing"]} are not in the bag'
                for name, count in kinds.items()
            ]
        lines += [f'different: {sentence}' for sentence in self.differences[:_SHOWN]]
        if len(self.differences) > _SHOWN:
            lines.append(f'different: and {len(self.differences) - _SHOWN} more')
        return '\n'.join(lines)

    def count(self, counts: Counter[str], where: str, difference: str) -> None:
        """Count a comparison, with a description of the difference if there is one."""
        counts['different' if difference else 'same'] += 1
        if difference:
            self.differences.append(f'{where}: {difference}')


def check_bag(reader: BagReader) -> list[CheckResult]:
    """Check every twin in a bag, which is read twice for each; CheckError if there is none."""
    topics = dict.fromkeys(find_topic(item.topic, item.type) for item in reader.channels)
    nodes = [item[0] for item in topics if item and item[1] == TWIN_TOPICS.journal
             and (item[0], TWIN_TOPICS.joint_states) in topics]
    if not nodes:
        names = ', '.join(item.topic for item in reader.channels) or 'none'
        raise CheckError(f'{reader.path} has no journal and joint_states of a twin, only {names}')
    return [_Check(reader, node).run() for node in nodes]


class _Check:
    """The check of one twin; its lines are repeated from the start of a session or a throw on."""

    def __init__(self, reader: BagReader, node: str) -> None:
        self._reader = reader
        self._node = node
        self._result = CheckResult(twin=node)
        self._states: dict[int, list[bytes]] = defaultdict(list)  # recorded ones by stamp [ns]

    def run(self) -> CheckResult:
        """Repeat the journal, and return the result."""
        result, lines, last = self._result, deque[journal.Entry](), -1
        self._read_states()
        topic = TWIN_TOPICS.journal.at(self._node).name
        for message in self._reader.messages([topic], by_log_time=False):
            try:
                entry = journal.decode(str(decode(message).data))
                number = entry['line']
            except DECODING_ERRORS as error:
                if lines:  # else it may be of another program
                    result.differences.append(f'line {last + 1} is unreadable: {error!s:.200}')
                continue
            if last + 1 != number or entry['kind'] == 'start':
                result.results['missing'] += max(number - last - 1, 0)
                self._repeat_all(lines)
            last = number
            lines.append(entry)
        self._repeat_all(lines)
        if 'missing' not in result.states:  # which each repeated step counts
            result.reason = result.reason or 'not compared: the journal has no start of a throw'
        return result

    def _read_states(self) -> None:
        reader = JointStateReader()
        for message in self._reader.messages([TWIN_TOPICS.joint_states.at(self._node).name]):
            try:
                (stamp,), _, *series = reader.read_all([message.data])
                state = np.array(series).reshape(len(State._fields))
                self._states[int(stamp)].append(state.tobytes())
            except ValueError as error:
                difference = f'a message is no state of the rig, {error!s:.200}'
                self._result.count(self._result.states, 'states', difference)

    def _repeat_all(self, lines: deque[journal.Entry]) -> None:
        """Repeat lines without a gap, from the next throw on if some cannot be repeated."""
        while lines:
            first = lines.popleft()
            if first['kind'] not in ('start', 'throw'):
                continue
            versions = first.get('versions', {})
            others = [
                f'{name} {versions.get(name)!s:.40}, and this is {ours}'
                for name, ours in journal.VERSIONS.items() if versions.get(name) != ours
            ]
            if others:
                reason = 'not compared, because other versions compute other last bits: recorded '
                self._result.reason = f'{reason}with {"; ".join(others)}'
            else:
                self._repeat(first, lines)

    def _repeat(self, first: journal.Entry, lines: deque[journal.Entry]) -> None:
        """Repeat a session from a line on, up to the end or a line that cannot be repeated."""
        expected = deque(entry for entry in (first, *lines) if entry['kind'] in _COMPARED)
        line = first['line']

        def on_entry(text: str) -> None:
            entry = journal.decode(text)
            if entry['kind'] in _COMPARED and expected:
                self._compare_lines(expected.popleft(), entry)

        try:
            session = Session.from_entry(first, on_entry=on_entry)
            while lines:
                entry = lines.popleft()
                line, distance = entry['line'], entry['step'] - session.step
                if distance > MAX_STEPS_BETWEEN_LINES:
                    raise journal.JournalError(f'it is {distance} steps after the one before')
                self._compare_states(session, session.follow(entry))
            for entry in tuple(expected):  # of the last step, or of the end of the session
                if entry['kind'] == 'checksum':
                    session.close()
                elif entry in expected:
                    self._compare_states(session, [session.advance()])
            if expected:
                raise journal.JournalError(f'{expected[0]["kind"]} is not repeated')
        except (RequestRejected, *DECODING_ERRORS) as error:
            self._result.differences.append(f'line {line} cannot be repeated: {error!s:.300}')

    def _compare_lines(self, recorded: journal.Entry, repeated: journal.Entry) -> None:
        """Compare a line of the journal with the repeated one; JournalError for another event."""
        kind, step = recorded['kind'], recorded['step']
        difference = _first_difference(recorded, repeated)
        is_other = (kind, step) != (repeated['kind'], repeated['step'])
        if is_other or (kind == 'throw' and difference):
            raise journal.JournalError(f'{kind} of step {step}: {difference}')
        if kind != 'throw':
            where = f'steps {repeated.get("first")} to {step - 1}'
            if kind == 'result':
                where = f'throw {repeated["result"]["throw"]}, {repeated["result"]["stage"]}'
            self._result.count(self._result.results, where, difference)

    def _compare_states(self, session: Session, outputs: Iterable[Outputs]) -> None:
        """Compare the recorded states of steps, all those of the same stamp, to the last bit."""
        for item in outputs:
            rows = self._states.get(session.due_ns(item.step), [])
            self._result.states['missing'] += not rows
            for row in rows:
                difference = ''
                if row != journal.STATE.pack(*item.state):
                    recorded = State(*journal.STATE.unpack(row))._asdict()
                    difference = _first_difference(recorded, item.state._asdict())
                    difference = difference or 'other bits of a value'
                self._result.count(self._result.states, f'states: step {item.step}', difference)


def _first_difference(recorded: Mapping[str, object], repeated: Mapping[str, object]) -> str:
    """Return a description of the first value that is not the same; empty if all are."""
    for name in {**repeated, **recorded}:
        there, here = recorded.get(name), repeated.get(name)
        if name in _NOT_COMPARED or repr(there) == repr(here):  # which distinguishes signs of 0
            continue
        if name == 'result' and isinstance(there, Mapping) and isinstance(here, Mapping):
            return _first_difference(there, here)
        return f'{name:.80} is {there!r:.80} in the bag, and {here!r:.80} when repeated'
    return ''
