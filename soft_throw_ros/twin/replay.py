# SPDX-License-Identifier: Apache-2.0
"""The steps of a session once more, from its journal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import takewhile

from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session


def replay(lines: Iterable[str], *, until: int, throw: int = 0) -> Iterator[Outputs]:
    """
    Repeat what a journal is of.

    Parameters
    ----------
    lines : iterable of str
        The journal, or its end.
    until : int
        The first step that is not asked for.
    throw : int
        Number of the throw to begin with; 0 for the first entry that can be begun with.

    Yields
    ------
    Outputs
        One for each step.

    Raises
    ------
    JournalError
        If there is no such throw, or the journal does not fit itself.
    RequestRejected
        If an input that was taken then is rejected now.

    """
    entries = map(journal.decode, lines)
    for entry in entries:
        if entry['kind'] == 'throw' and throw in (0, entry['throw']):
            break
        if entry['kind'] == 'start' and throw == 0:
            break
    else:
        raise journal.JournalError(f'the journal has no start of throw {throw}')
    session = Session.from_entry(entry)
    for entry in entries:
        if entry['kind'] == 'start' or session.step >= until:
            break
        if entry['kind'] == 'samples' or entry['step'] < until:
            yield from takewhile(lambda outputs: outputs.step < until, follow(session, entry))
    yield from _advance_to(session, until)


def follow(session: Session, entry: journal.Entry) -> Iterator[Outputs]:
    """
    Go on to an entry of the journal of a session, and take the input it tells, if it does.

    Yields
    ------
    Outputs
        One for each step.

    Raises
    ------
    JournalError
        If the entry cannot be read, or its input belongs before a step that has passed.
    RequestRejected
        If the input cannot be taken, so that this is not the session that the journal is of.

    """
    kind, step = entry['kind'], entry['step']
    if kind == 'samples':
        for before, samples in journal.entry_samples(entry):
            yield from _advance_to(session, before)
            session.measure(samples)
        return
    yield from _advance_to(session, step)
    if kind == 'tick_schedule':
        schedule = journal.entry_schedule(entry)
        assert schedule is not None
        session.set_tick_schedule(schedule)
    elif kind == 'input':
        if step != session.step:
            raise journal.JournalError(f'an input before step {session.step}, got {dict(entry)!r}')
        _take_input(session, entry)


def _take_input(session: Session, entry: journal.Entry) -> None:
    name = entry.get('input')
    if name == 'throw':
        session.request_throw()
    elif name == 'reset':
        session.reset()
    elif name == 'parameters':
        session.change(journal.checked_settings(entry, 'values'))
    else:
        raise journal.JournalError(f'no input is named {name!r}')


def _advance_to(session: Session, step: int) -> Iterator[Outputs]:
    while session.step < step:
        yield session.advance()
