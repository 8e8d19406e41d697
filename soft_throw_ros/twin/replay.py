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
"""The steps of a session once more, from its journal."""

from __future__ import annotations

from collections.abc import Iterator

from soft_throw_ros.configuration.table import quote
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session


def follow(session: Session, entry: journal.Entry) -> Iterator[Outputs]:
    """
    Advance a session to an entry of its journal, and apply the input of the entry, if any.

    Yields
    ------
    Outputs
        One for each step.

    Raises
    ------
    JournalError
        If the entry cannot be read, or its input belongs before a step that has passed.
    RequestRejected
        If the session rejects the input, so that the journal is of another session.

    """
    if entry['kind'] == 'samples':
        for step, samples in journal.decode_samples(entry):
            yield from advance_to(session, step)
            session.measure(samples)
        return
    yield from advance_to(session, entry['step'])
    if entry['kind'] == 'tick_schedule':
        session.set_tick_schedule(journal.decode_schedule(entry))
    elif entry['kind'] == 'input':
        if entry['step'] != session.step:
            raise journal.JournalError(
                f'an input before step {session.step}, got {quote(dict(entry))}'
            )
        match entry.get('input'):
            case 'throw':
                session.request_throw()
            case 'reset':
                session.reset()
            case 'parameters':
                values = journal.checked_settings(entry, 'values')
                session.change(values, motion_of=journal.motion_source(entry))
            case name:
                raise journal.JournalError(f'no input is named {quote(name)}')


def advance_to(session: Session, step: int) -> Iterator[Outputs]:
    """Advance until a step is the next one."""
    while session.step < step:
        yield session.advance()
