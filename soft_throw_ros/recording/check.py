# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""
Whether a bag is what its own journal gives when it is repeated.

The journal tells what the twin was asked, and checksums and results of what it gave. The session
is repeated, and what the journal tells of it is compared with what the repeated one writes. Where
the bag has all the states of a checksum, they are compared, too.

Other versions compute other last bits, which checksums do not forgive. Numbers are compared then,
up to the first landing: from bounce to bounce a difference grows, often tenfold.
"""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
import contextlib
from dataclasses import dataclass, field
import math
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.cdr import decode, JointStateReader, MessageError
from soft_throw_ros.recording.message import BagError, Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.replay import follow
from soft_throw_ros.twin.results import Floats, Outputs, State
from soft_throw_ros.twin.session import RequestRejected, Session

TOLERANCE = 1e-12
"""What another installation may have otherwise, in SI units, or relative if larger than one."""

JOINTS = ('plate', 'projectile')

_JOURNAL, _STATES = 'journal', 'joint_states'
_TEXT, _JOINT_STATE = 'std_msgs/msg/String', 'sensor_msgs/msg/JointState'
_COMPARED = ('throw', 'result', 'checksum')
_SAME_OR_LOST = ('kind', 'step', 'throw', 'settings', 'pending', 'schedule')
_LONGEST = 3_600_000  # steps from one entry to the next: an hour at the default rate
_SHOWN = 5  # of what may be many
_UNREPEATABLE = (RequestRejected, ValueError, ArithmeticError)


class CheckError(BagError):
    """There is nothing in a bag that could be checked."""


@dataclass(kw_only=True)
class Count:
    """How many were the same, different, and not compared."""

    same: int = 0
    different: int = 0
    unchecked: int = 0

    def describe(self, what: str, unchecked: str) -> str:
        """Say it for people to read."""
        text = f'{self.same} {what} are the same, {self.different} are different'
        return f'{text}, {self.unchecked} {unchecked}' if self.unchecked else text


@dataclass(kw_only=True)
class CheckResult:
    """What was found out about a twin in a bag."""

    twin: str  # Name of the node
    # Of the journal
    checksums: Count = field(default_factory=Count)
    results: Count = field(default_factory=Count)
    # Seconds, or parts of one before and after a throw starts, whose states are in the bag
    states: Count = field(default_factory=Count)
    differences: list[str] = field(default_factory=list)  # What is not the same
    gaps: list[str] = field(default_factory=list)  # What is missing in the journal
    # What was another there, and here
    versions: dict[str, tuple[str, str]] = field(default_factory=dict)
    reason: str = ''  # Why it cannot be checked, empty if it can

    @property
    def exit_code(self) -> int:
        """0 if all is the same, 1 if something is not, 2 if nothing could be checked."""
        if self.differences:
            return 1
        return 0 if self.checksums.same or self.results.same else 2

    def describe(self) -> str:
        """Say it for people to read, in lines."""
        return '\n'.join(self._lines())

    def _lines(self) -> Iterator[str]:
        if self.reason:
            yield self.reason
            return
        for name, (there, here) in self.versions.items():
            yield f'recorded with {name} {there}, repeated with {here}'
        exact, near = 'to the last bit', f'to {TOLERANCE:g} up to the first landing'
        yield f'compared {near if self.versions else exact}'
        yield self.checksums.describe('checksums', 'say nothing about another installation')
        yield self.results.describe('results of throws', 'are not compared')
        yield self.states.describe('seconds of recorded states', 'are not complete in the bag')
        for kind, sentences in (('missing', self.gaps), ('different', self.differences)):
            yield from (f'{kind}: {sentence}' for sentence in sentences[:_SHOWN])
            if len(sentences) > _SHOWN:
                yield f'{kind}: and {len(sentences) - _SHOWN} more'


def check_bag(reader: BagReader) -> list[CheckResult]:
    """
    Check every twin in a bag.

    Parameters
    ----------
    reader : BagReader
        Of the bag, which is read once for every twin.

    Returns
    -------
    list of CheckResult
        One for each.

    Raises
    ------
    CheckError
        If there is no twin in it.
    BagError
        If the bag cannot be read.

    """
    types = {channel.topic: channel.type for channel in reader.channels}
    nodes = [
        topic.removesuffix(f'/{_JOURNAL}')
        for topic, kind in types.items()
        if topic.endswith(f'/{_JOURNAL}') and kind == _TEXT
    ]
    nodes = [node for node in nodes if types.get(f'{node}/{_STATES}') == _JOINT_STATE]
    if not nodes:
        raise CheckError(
            f'{reader.path}: the bag needs the topics {_JOURNAL} and {_STATES} of a twin, '
            f'and has {", ".join(types) or "none"}'
        )
    return [_check_twin(reader, node) for node in nodes]


def _check_twin(reader: BagReader, node: str) -> CheckResult:
    """Check one twin, in one pass over its journal and one over its states."""
    result = CheckResult(twin=node)
    repetition = _Repetition(result, _RecordedStates.read(reader, f'{node}/{_STATES}'))
    for message in reader.messages(f'{node}/{_JOURNAL}', by_log_time=False):
        entry = _entry(message)
        if 'line' not in entry:
            version = entry.get('versions', {}).get('soft_throw_ros', 'an earlier version')
            result.reason = (
                'cannot be checked: its journal has no checksums, since it was written by '
                f'soft_throw_ros {version}, before there were any'
            )
            return result
        repetition.take(entry)
    repetition.finish()
    if not repetition.has_begun:
        result.reason = 'cannot be checked: its journal has no start of a throw'
    return result


def _entry(message: Message) -> journal.Entry:
    """Read a line; what is none has no number."""
    try:
        text = str(decode(message.channel.type, message.channel.schema, message.data).data)
        return journal.decode(text)
    except (MessageError, AttributeError, journal.JournalError) as error:
        return {'kind': 'unreadable', 'line': -1, 'reason': str(error)}


class _RecordedStates(NamedTuple):
    """The states in a bag, by their stamps."""

    stamps: NDArray[np.int64]  # (n,) ascending [ns]
    values: Floats  # (n, 6) as in a `State`

    @classmethod
    def read(cls, reader: BagReader, topic: str) -> _RecordedStates:
        """Read a topic; what is no message of plate and projectile is left out, and so missing."""
        stamps, values, read = array('q'), array('d'), JointStateReader().read
        for message in reader.messages(topic, by_log_time=False):
            with contextlib.suppress(MessageError):
                stamp, names, *series = read(message.data)
                if names == JOINTS and all(len(each) == len(JOINTS) for each in series):
                    stamps.append(stamp)
                    for each in series:
                        values.extend(each)
        order = np.argsort(np.asarray(stamps), kind='stable')
        return cls(np.asarray(stamps)[order], np.reshape(values, (-1, len(State._fields)))[order])

    def at(self, stamps: list[int]) -> Floats | None:
        """Return the states of stamps, None unless all are there."""
        if not (len(self.stamps) and stamps):
            return None
        found = np.searchsorted(self.stamps, stamps).clip(max=len(self.stamps) - 1)
        return self.values[found] if (self.stamps[found] == stamps).all() else None


class _Step(NamedTuple):
    """What a repeated step gave, when it was due, and whether nothing had landed before."""

    due_ns: int
    number: int
    state: State
    is_before_landing: bool


class _Repetition:
    """
    Repeats a session from its journal, entry by entry, and compares what both tell.

    Parameters
    ----------
    result : CheckResult
        Where it is counted.
    recorded_states : _RecordedStates
        Of the bag.

    """

    def __init__(self, result: CheckResult, recorded_states: _RecordedStates) -> None:
        self.has_begun = False
        self._result = result
        self._recorded_states = recorded_states
        self._session: Session | None = None
        self._line = -1  # the last that was taken
        self._throw = 0
        self._recorded: deque[journal.Entry] = deque()  # by the journal, not compared yet
        self._repeated: deque[journal.Entry] = deque()  # by the repeated session
        self._steps: list[_Step] = []  # since the last checksum
        self._repeated_throw = 0
        self._has_landed = False
        self._versions: dict[str, tuple[str, str]] = {}

    def take(self, entry: journal.Entry) -> None:
        """Go on to an entry, or begin with it."""
        is_start = entry['kind'] == 'start'
        is_next = entry['line'] == self._line + 1
        if self._session is not None and not (is_start or is_next):
            missing = entry.get('reason') or f'lines before line {entry["line"]}'
            self._result.gaps.append(f'{missing} (after throw {self._throw})')
        if is_start or not is_next:
            self.finish()
        self._line = entry['line']
        self._throw = entry.get('throw', 0 if is_start else self._throw)
        try:
            if self._session is not None:
                if entry['step'] - self._session.step > _LONGEST:
                    raise journal.JournalError(f'step {entry["step"]} is too far')
                self._go_on(follow(self._session, entry))
            elif entry['kind'] in ('start', 'throw'):
                self._begin(entry)
            else:
                return
            if entry['kind'] in _COMPARED:
                self._recorded.append(entry)
            self._compare()
        except _UNREPEATABLE as error:
            self._give_up(f'what follows throw {self._throw} cannot be repeated: {error}')

    def finish(self) -> None:
        """Let the session end; what is recorded last may be of one more step, or of its end."""
        try:
            while self._session is not None and self._recorded:
                entry = self._recorded[0]
                is_last_checksum = entry['kind'] == 'checksum'
                if is_last_checksum:
                    self._session.close()
                elif self._session.step <= entry['step']:
                    self._go_on([self._session.advance()])
                self._compare()
                is_past = is_last_checksum or self._session.step > entry['step']
                if is_past and self._recorded and self._recorded[0] is entry:
                    self._give_up(f'{entry["kind"]} of step {entry["step"]} does not come again')
        except _UNREPEATABLE as error:
            self._give_up(f'the end of throw {self._throw} cannot be repeated: {error}')
        self._session = None

    def _begin(self, entry: journal.Entry) -> None:
        self.has_begun = True
        self._recorded.clear()
        self._repeated.clear()
        self._steps.clear()
        self._has_landed = False
        there = entry.get('versions', {})
        self._versions = {
            name: (str(there.get(name)), str(journal.VERSIONS.get(name)))
            for name in {**journal.VERSIONS, **there}
            if there.get(name) != journal.VERSIONS.get(name)
        }
        self._result.versions.update(self._versions)
        self._session = Session.from_entry(entry, on_entry=self._on_entry)

    def _on_entry(self, line: str) -> None:
        entry = journal.decode(line)
        if entry['kind'] in _COMPARED:
            self._repeated.append(entry)

    def _go_on(self, steps: Iterable[Outputs]) -> None:
        """Keep what steps give, and compare what they tell."""
        for outputs in steps:
            assert self._session is not None
            if outputs.throw != self._repeated_throw:  # which has forgotten the one before
                self._repeated_throw, self._has_landed = outputs.throw, False
            self._has_landed |= any(event.kind == 'landing' for event in outputs.events)
            due_ns = self._session.due_ns(outputs.step)
            self._steps.append(_Step(due_ns, outputs.step, outputs.state, not self._has_landed))
            self._compare()

    def _compare(self) -> None:
        """Compare the entries of both, in order."""
        while self._recorded and self._repeated:
            recorded, repeated = self._recorded.popleft(), self._repeated.popleft()
            for name in _SAME_OR_LOST:
                there, here = recorded.get(name), repeated.get(name)
                if there != here:
                    raise journal.JournalError(
                        f'{recorded["kind"]} of step {recorded["step"]} has {name} {there!r} in '
                        f'the journal, and {here!r} when repeated'
                    )
            if recorded['kind'] == 'checksum':
                self._compare_checksum(recorded, repeated)
            elif recorded['kind'] == 'result':
                self._compare_result(recorded, repeated)

    def _compare_result(self, recorded: journal.Entry, repeated: journal.Entry) -> None:
        """Compare the numbers of a result, and the checksums of its throw."""
        there, here = recorded.get('result', {}), repeated['result']
        reason = _first_difference(there, here, is_exact=not self._versions)
        if not (reason or self._versions):
            reason = _first_difference(*(_checksums(e) for e in (recorded, repeated)))
        self._count(self._result.results, f'throw {here["throw"]}, {here["stage"]}', reason)

    def _compare_checksum(self, recorded: journal.Entry, repeated: journal.Entry) -> None:
        """Compare the checksums of some steps, and their states in the bag if all are there."""
        steps = [step for step in self._steps if step.number < repeated['step']]
        del self._steps[: len(steps)]
        if self._versions:
            self._result.checksums.unchecked += 1
        else:
            reason = _first_difference(*(_checksums(e) for e in (recorded, repeated)))
            where = f'steps {repeated["first"]} to {repeated["step"] - 1}'
            self._count(self._result.checksums, where, reason)
        values = self._recorded_states.at([step.due_ns for step in steps])
        if values is None:
            self._result.states.unchecked += 1
            return
        reason = ''
        if self._versions or crc32(values.tobytes()) != repeated['states']:
            for step, row in zip(steps, values.tolist(), strict=True):
                if not reason and (step.is_before_landing or not self._versions):
                    states = State(*row)._asdict(), step.state._asdict()
                    reason = _first_difference(*states, is_exact=not self._versions)
                    reason = f'step {step.number}: {reason}' if reason else ''
        self._count(self._result.states, 'states', reason)

    def _count(self, count: Count, what: str, reason: str) -> None:
        """Count what was compared, and say why it is different if it is."""
        if reason:
            count.different += 1
            self._result.differences.append(f'{what}: {reason}')
        else:
            count.same += 1

    def _give_up(self, sentence: str) -> None:
        """Note that the session cannot be repeated, up to the next throw."""
        # what is not the same after a landing may come of another installation
        is_bouncing = self._versions and self._has_landed
        (self._result.gaps if is_bouncing else self._result.differences).append(sentence)
        self._recorded.clear()
        self._session = None


def _checksums(entry: journal.Entry) -> dict[str, object]:
    return {name: entry.get(name) for name in ('first', 'states', 'fields')}


def _first_difference(
    recorded: Mapping[str, object], repeated: Mapping[str, object], *, is_exact: bool = True
) -> str:
    """Say which value is the first that is not the same, if one is not."""
    for name in {**repeated, **recorded}:
        there, here = recorded.get(name), repeated.get(name)
        if is_exact:
            is_same = repr(there) == repr(here)  # which tells zeros by their signs
        else:  # counts and ends may come of bounces
            is_same = not isinstance(here, float) or _is_near(there, here)
        if not is_same:
            return f'{name} is {there!r} in the bag, and {here!r} when repeated'
    return ''


def _is_near(there: object, here: float) -> bool:
    """Tell whether numbers are the same but for last bits."""
    if not isinstance(there, (int, float)):
        return False
    return there == here or (
        math.isfinite(there) and abs(there - here) <= TOLERANCE * max(1.0, abs(here))
    )
