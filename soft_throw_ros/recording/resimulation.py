# SPDX-License-Identifier: Apache-2.0
"""
The steps of a twin once more, from its journal, of which lines may be missing.

A stretch goes from one start, of a session or of a throw, to the next. Every stretch can be
repeated without those before it, so one that lacks something is left out, and the next one begins
anew. That something is missing shows in the numbers of the throws, in the pace, which is told
again before every throw, and in settings that no entry accounts for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
import math
from typing import Any, NamedTuple

from soft_throw_ros.configuration import ParameterError, TWIN
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.journal import Entry, JournalError
from soft_throw_ros.twin.pace import Pace
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Refused, Session

_INPUTS = ('throw', 'reset', 'parameters')

_RATES = (1e-3, 1e9)  # [Hz]

_FARTHEST = 2**62  # of a step, or of a time [ns]

LONGEST = 3_600_000
"""How many steps are repeated at most to get from a start to the first one that is asked for."""


@dataclass(kw_only=True)
class Stretch:
    """
    What a journal says from one start, of a session or of a throw, to the next.

    Parameters
    ----------
    run : int
        Number of the session that the stretch is of.
    first : mapping
        The entry that it begins with.
    end : int or None
        The step that the next stretch of the same session begins with; None if there is none.
    inputs : list of mapping
        Entries of the inputs, of samples, and of the pace after the first.
    paces : list of (int, Pace)
        When steps are due, each from a step on.
    lines : list of (int, str)
        All lines, each with the step before which it stands.
    gap : str
        Why it cannot be repeated, empty if it can.

    """

    run: int
    first: Entry
    end: int | None = None
    inputs: list[Entry] = field(default_factory=list)
    paces: list[tuple[int, Pace]] = field(default_factory=list)
    lines: list[tuple[int, str]] = field(default_factory=list)
    gap: str = ''

    @property
    def begin(self) -> int:
        """The step that it begins with."""
        return int(self.first['step'])

    @property
    def throw(self) -> int:
        """Number of the throw that it begins with, 0 at the start of a session."""
        return int(self.first.get('throw', 0))

    @property
    def last_step(self) -> int:
        """The step before which its last line stands."""
        return self.lines[-1][0]

    @property
    def wanted(self) -> dict[str, Any]:
        """The settings that are in effect, or wait for it, at its end."""
        wanted = {**self.first['settings'], **self.first.get('pending', {})}
        for entry in self.inputs:
            wanted.update(entry.get('values', {}))
        return wanted

    def lack(self, what: str) -> None:
        """Take note that it cannot be repeated, and why."""
        self.gap = self.gap or what


def read_stretches(lines: Iterable[str]) -> Iterator[Stretch]:
    """Divide a journal; what comes before the first start is left out."""
    reader = _StretchReader()
    for line in lines:
        yield from reader.take(line)
    yield from reader.end()


class _StretchReader:
    """Puts stretches together, line by line."""

    def __init__(self) -> None:
        self._open: Stretch | None = None
        self._held: tuple[Entry, str] | None = None  # a pace, which may go with a throw
        self._sampled: int | None = None  # how many samples have been told of

    def take(self, line: str) -> Iterator[Stretch]:
        """Take the next line, and yield the stretch that it completes."""
        try:
            entry = _decode(line)
        except JournalError as error:
            self._let_go()
            if self._open is not None:
                self._open.lack(f'a line after throw {self._open.throw} cannot be read, {error}')
                self._open.lines.append((self._open.last_step, line))
            return
        if entry['kind'] == 'throw':
            yield from self._begin_throw(entry, line)
            return
        self._let_go()
        if entry['kind'] == 'start':
            run = 0 if self._open is None else self._open.run + 1
            if self._open is not None and (self._open.paces or self._open.gap):
                yield self._open
            self._open = Stretch(run=run, first=entry, lines=[(entry['step'], line)])
            self._sampled = 0
        elif entry['kind'] == 'pace':
            self._held = entry, line
        elif self._open is not None:
            self._add(entry, line)
            self._open.inputs.append(entry)
            if entry['kind'] == 'samples':
                if self._sampled not in (None, entry['first']):
                    self._open.lack(f'samples are missing before step {entry["step"]}')
                self._sampled = entry['first'] + entry['count']

    def end(self) -> Iterator[Stretch]:
        """Yield the last stretch."""
        self._let_go()
        if self._open is not None:
            if not self._open.paces:
                self._open.lack(f'the pace after throw {self._open.throw} is missing')
            yield self._open

    def _begin_throw(self, entry: Entry, line: str) -> Iterator[Stretch]:
        step, before, run = entry['step'], self._open, 0
        lines = [(step, line)]
        pace = None
        if self._held is not None and self._held[0]['step'] == step:
            pace = journal.entry_pace(self._held[0])
            lines.insert(0, (step, self._held[1]))
            self._held = None
        self._let_go()
        if before is not None:
            if entry['throw'] > before.throw and step >= before.last_step:
                run, before.end = before.run, step
                before.lack(_missing(before, entry, pace))
            else:
                run = before.run + 1
                self._sampled = None
                before.lack(f'the start of a session is missing after throw {before.throw}')
            yield before
        elif pace is None:
            return
        self._open = Stretch(run=run, first=entry, lines=lines)
        if pace is None:
            self._open.lack(f'the pace of throw {entry["throw"]} is missing')
        else:
            self._open.paces.append((step, pace))

    def _let_go(self) -> None:
        """Take the pace that is held for a change of it."""
        if self._held is not None and self._open is not None:
            entry, line = self._held
            self._add(entry, line)
            if not self._open.paces and entry['step'] > self._open.begin:
                self._open.lack(f'the pace of step {self._open.begin} is missing')
            self._open.paces.append((entry['step'], journal.entry_pace(entry)))
            self._open.inputs.append(entry)
        self._held = None

    def _add(self, entry: Entry, line: str) -> None:
        assert self._open is not None
        if entry['step'] < self._open.last_step:
            self._open.lack(f'step {self._open.last_step} is before step {entry["step"]}')
        self._open.lines.append((entry['step'], line))


def _missing(before: Stretch, entry: Entry, pace: Pace | None) -> str:
    """Say what must be missing between the start of a stretch and that of the next, if any."""
    throw = entry['throw']
    count = throw - before.throw - 1
    if count:
        return f'throw {throw - 1} is missing' + (f', and {count - 1} before' if count > 1 else '')
    told = before.paces[-1][1] if before.paces else None
    if pace is None or told is None or vars(pace) != vars(told):
        return f'a line about the pace is missing before throw {throw}'
    wanted = {**entry['settings'], **entry['pending']}
    changed = [name for name, value in before.wanted.items() if wanted.get(name) != value]
    if changed:
        return f'a change of {", ".join(changed)} is missing before throw {throw}'
    return ''


def _decode(line: str) -> dict[str, Any]:
    """Read an entry that a session can take, or raise JournalError."""
    try:
        entry = journal.decode(line)
    except (ValueError, RecursionError) as error:
        raise JournalError(str(error)) from error
    kind, step = entry['kind'], entry['step']
    if type(step) is not int or abs(step) > _FARTHEST:
        raise JournalError(f'a step is a whole number, got {step!r}')
    if kind in ('start', 'throw'):
        _check_start(entry)
    elif kind == 'pace':
        pace = journal.entry_pace(entry)
        is_near = max(abs(pace.step), abs(pace.time_ns)) <= _FARTHEST
        if not (is_near and _RATES[0] <= pace.rate <= _RATES[1]):
            raise JournalError(f'no twin has such a pace: {line!r}')
    elif kind == 'samples':
        journal.entry_samples(entry)
        if type(entry.get('first')) is not int:
            raise JournalError(f'samples have a number, got {entry.get("first")!r}')
    elif kind != 'input' or entry.get('input') not in _INPUTS:
        raise JournalError(f'no entry is of kind {kind!r}, {entry.get("input")!r}')
    elif entry['input'] == 'parameters':
        _check_settings(entry, 'values')
    return entry


def _check_start(entry: Entry) -> None:
    _check_settings(entry, 'settings')
    for name in TWIN.defaults():
        if name not in entry['settings']:
            raise JournalError(f'settings have {name}, got {entry["settings"]!r}')
    if entry['kind'] == 'throw':
        _check_settings(entry, 'pending')
        if type(entry.get('throw')) is not int or entry['throw'] < 1:
            raise JournalError(f'a throw has a number from 1 on, got {entry.get("throw")!r}')
    if not isinstance(entry.get('versions'), Mapping):
        raise JournalError(f'a start has versions, got {entry.get("versions")!r}')


def _check_settings(entry: Entry, key: str) -> None:
    settings = entry.get(key)
    if not isinstance(settings, Mapping):
        raise JournalError(f'an entry lacks {key}: {dict(entry)!r}')
    try:
        for name, value in settings.items():
            TWIN.check_value(name, value)
    except ParameterError as error:
        raise JournalError(str(error)) from error


@dataclass(frozen=True, kw_only=True)
class Piece:
    """
    Consecutive steps that follow one pace; or a gap, of which steps and pace are not known.

    Parameters
    ----------
    run : int
        Number of the session.
    begin : int
        First step.
    end : int or None
        First step that does not belong to it, None if it has no end.
    pace : Pace or None
        When steps are due, None for a gap.
    begin_ns, end_ns : int, float
        From when to when it may reach. [ns]

    """

    run: int
    begin: int
    end: int | None = None
    pace: Pace | None = None
    begin_ns: int
    end_ns: float = math.inf

    @property
    def last_ns(self) -> int:
        """When the last step that is known of is due. [ns]"""
        if self.pace is None or self.end is None:
            return self.begin_ns
        return self.pace.deadline(self.end - 1)

    def is_continued_by(self, other: Piece) -> bool:
        """Tell whether the two are one."""
        if self.pace is None or other.pace is None:
            return self.pace is other.pace
        is_next = (self.run, self.end) == (other.run, other.begin)
        return is_next and vars(self.pace) == vars(other.pace)

    def step_due(self, time_ns: int) -> int | None:
        """Return its step that is due at a time, None if there is none."""
        if self.pace is None or not self.begin_ns <= time_ns < self.end_ns:
            return None
        step = self.pace.step_due(time_ns)
        if step is None or step < self.begin or (self.end is not None and step >= self.end):
            return None
        return step


class Place(NamedTuple):
    """A step in a timeline, by the index of its piece; the step of a gap is -1."""

    piece: int
    step: int


class Timeline:
    """
    Which step is due when, in all of a journal.

    Parameters
    ----------
    stretches : iterable of Stretch
        All there are.

    Attributes
    ----------
    pieces : list of Piece
        In the order of the journal.
    gaps : list of str
        What is missing.

    """

    def __init__(self, stretches: Iterable[Stretch]) -> None:
        self.pieces: list[Piece] = []
        self.gaps: list[str] = []
        for stretch in stretches:
            self._add(stretch)
        # Clocks may have been set back, so that something earlier comes later
        self._earliest: list[float] = [math.inf]
        for piece in reversed(self.pieces):
            self._earliest.append(min(piece.begin_ns, self._earliest[-1]))
        self._earliest.reverse()

    @property
    def begin_ns(self) -> float:
        """When the first step is due; infinite if there is none. [ns]"""
        return self.pieces[0].begin_ns if self.pieces else math.inf

    @property
    def is_set_back(self) -> bool:
        """Whether something that comes later was due earlier."""
        return any(later.begin_ns <= piece.last_ns for piece, later in pairwise(self.pieces))

    def find(self, time_ns: int, after: Place | None) -> Place | None:
        """Return the first place after another, or of all, whose step is due at a time."""
        begin = after.piece if after is not None else 0
        gap = None
        for index in range(begin, len(self.pieces)):
            if time_ns < self._earliest[index]:
                break
            piece = self.pieces[index]
            if gap is None and piece.pace is None and piece.begin_ns <= time_ns < piece.end_ns:
                gap = Place(index, -1)  # unless something later is known to be due then
            step = piece.step_due(time_ns)
            if step is None:
                continue
            is_passed = after is not None and index == after.piece and step <= after.step
            if not is_passed:
                return Place(index, step)
        return gap

    def _add(self, stretch: Stretch) -> None:
        if stretch.gap:
            self.gaps.append(stretch.gap)
            if stretch.paces:
                begin_ns = stretch.paces[0][1].deadline(stretch.begin)
            else:
                begin_ns = self.pieces[-1].begin_ns if self.pieces else 0
            self._append(Piece(run=stretch.run, begin=stretch.begin, begin_ns=begin_ns))
            return
        ends = [*(begin for begin, _ in stretch.paces[1:]), stretch.end]
        for (begin, pace), end in zip(stretch.paces, ends, strict=True):
            if begin != end:
                begin_ns = pace.deadline(begin)
                self._append(
                    Piece(run=stretch.run, begin=begin, end=end, pace=pace, begin_ns=begin_ns)
                )

    def _append(self, piece: Piece) -> None:
        """Add a piece, or let the last one go on."""
        if self.pieces:
            last = self.pieces[-1]
            if last.is_continued_by(piece):
                self.pieces[-1] = replace(last, end=piece.end)
                return
            if last.end is None and piece.begin_ns > last.begin_ns:
                self.pieces[-1] = replace(last, end_ns=piece.begin_ns)
        self.pieces.append(piece)


class Step(NamedTuple):
    """
    A step once more.

    Parameters
    ----------
    run : int
        Number of the session.
    outputs : Outputs
        What it gives.
    pace : Pace
        By which it was due.
    stretch : Stretch
        Where it belongs.
    lines : tuple of str
        What stands in the journal before it, and after the step before.

    """

    run: int
    outputs: Outputs
    pace: Pace
    stretch: Stretch
    lines: tuple[str, ...]

    @property
    def number(self) -> int:
        """Which step it is."""
        return self.outputs.step

    @property
    def at(self) -> tuple[int, int]:
        """Run and number, by which steps follow each other."""
        return self.run, self.number

    @property
    def due_ns(self) -> int:
        """When it was due. [ns]"""
        return self.pace.deadline(self.number)


class Resimulation:
    """
    Repeats what a journal is of, as far as asked.

    It begins every session with the last start before the first step that is asked for, or with
    the next one if that is more than `LONGEST` steps before.

    Parameters
    ----------
    stretches : iterable of Stretch
        All there are.
    on_misfit : callable
        Called with a sentence if the journal does not fit what it gives when it is repeated.

    """

    def __init__(self, stretches: Iterable[Stretch], on_misfit: Callable[[str], None]) -> None:
        self._on_misfit = on_misfit
        self._goal = (0, 0)
        self._steps = self._repeat(stretches)
        self._ahead: Step | None = None
        self._session: Session | None = None
        self._own: list[str] = []  # what the session writes
        self._lines: deque[tuple[float, str]] = deque()  # what has not been handed on

    def until(self, run: int, step: int) -> Iterator[Step]:
        """
        Yield the steps up to one that is given, and with it, but none again.

        Steps that cannot be repeated are left out.
        """
        self._goal = goal = (run, step)
        while True:
            coming = self._ahead or next(self._steps, None)
            if coming is None or coming.at > goal:
                self._ahead = coming
                return
            self._ahead = None
            yield coming
            if coming.at == goal:
                return

    def _repeat(self, stretches: Iterable[Stretch]) -> Iterator[Step | None]:
        """Yield steps, and None where the next one is of a session that is not asked for."""
        run, is_asked_for = -1, False
        for stretch in stretches:
            if stretch.run != run:
                run, is_asked_for, self._session = stretch.run, False, None
                while run > self._goal[0]:
                    yield None
            is_asked_for = is_asked_for or self._asks_for(stretch)
            if not is_asked_for:
                continue
            self._lines = deque((-math.inf, line) for _, line in self._lines)
            self._lines.extend(stretch.lines)
            if stretch.gap:
                self._session = None
                continue
            try:
                for outputs in self._go_through(stretch):
                    yield self._step(stretch, outputs)
            except (Refused, ValueError, ArithmeticError) as error:
                self._session = None
                self._on_misfit(f'what follows throw {stretch.throw} cannot be repeated: {error}')

    def _asks_for(self, stretch: Stretch) -> bool:
        """Tell whether to begin with a stretch: it is not all before what is asked for, or far."""
        run, step = self._goal
        has_goal = stretch.run == run and (stretch.end is None or stretch.end > step)
        return has_goal and step - stretch.begin <= LONGEST

    def _go_through(self, stretch: Stretch) -> Iterator[Outputs]:
        session = self._session
        if session is not None:
            self._own.clear()
            outputs = session.advance()
            if self._has_begun(stretch):
                yield outputs
            else:
                self._on_misfit(
                    f'throw {stretch.throw} starts with step {stretch.begin} in the journal, '
                    'and not so when it is repeated'
                )
                session = None
        if session is None:
            session = Session.from_entry(stretch.first, on_entry=self._own.append)
            self._session = session
            if stretch.throw:  # which has its pace before it
                session.keep_pace(stretch.paces[0][1])
        for entry in stretch.inputs:
            yield from session.follow(entry)
        end = stretch.end
        while session.step < end if end is not None else self._goal[0] == stretch.run:
            if end is None and session.is_measured and session.step >= stretch.last_step:
                return  # samples may have been taken since, of which nothing is told yet
            yield session.advance()

    def _has_begun(self, stretch: Stretch) -> bool:
        """Tell whether the session has just begun what a stretch begins with."""
        told = [journal.decode(line) for line in self._own]
        entries = [entry for entry in told if entry['kind'] not in ('samples', 'pace')]
        keys = ('kind', 'step', 'throw', 'settings', 'pending')
        return [[entry.get(key) for key in keys] for entry in entries] == [
            [stretch.first[key] for key in keys]
        ]

    def _step(self, stretch: Stretch, outputs: Outputs) -> Step:
        pace = next(pace for begin, pace in reversed(stretch.paces) if begin <= outputs.step)
        lines = []
        while self._lines and self._lines[0][0] <= outputs.step:
            lines.append(self._lines.popleft()[1])
        return Step(stretch.run, outputs, pace, stretch, tuple(lines))
