# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A session of the twin without ROS.

A session counts its time in steps, the ticks of `rate.state`. A node, which advances it by the
clock, and a replay, which advances it as fast as it can, get the same outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from threading import Lock

from soft_throw_ros.configuration import motions, Settings
from soft_throw_ros.configuration.motions import MotionSource
from soft_throw_ros.configuration.table import quote
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.journal import JournalWriter
from soft_throw_ros.twin.prepared_rig import prepare, PreparedRig
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.sample_buffer import SampleCounts, Samples
from soft_throw_ros.twin.throw_cycle import ThrowCycle
from soft_throw_ros.twin.tick_schedule import TickSchedule


class RequestRejected(Exception):
    """A refused request; the message has the reason."""


class Session:
    """
    The cycle of a rig, its settings and its journal.

    Inputs may come from another thread than the one that advances the session. An input takes
    effect between two steps, and has the number of the second one in the journal.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings at the start.
    step : int
        Number of the first step.
    on_entry : callable
        Called with every line of the journal, in order; it must not call the session.
    pending : mapping of str to value, optional
        Pending changes of a session that continues another one from its journal.
    motion_of : callable
        Returns the motion of a plate by the path of its file; by default it reads the file.
    prepared : PreparedRig, optional
        The result of `prepared_rig.prepare` for the settings; by default they are prepared here.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, with the number.

    """

    def __init__(
        self,
        settings: Settings,
        *,
        step: int = 0,
        on_entry: Callable[[str], None] = lambda _line: None,
        pending: Settings | None = None,
        motion_of: MotionSource = motions.read,
        prepared: PreparedRig | None = None,
    ) -> None:
        self.step = step  # number of the next step
        self._lock = Lock()  # held for microseconds
        self._journal = JournalWriter(on_entry, step=step)
        prepared = prepared or prepare(settings, motion_of=motion_of)
        self._cycle = ThrowCycle(prepared, self._journal, step=step)
        if pending is None:
            encoded = self._cycle.encoded_motions
            self._journal.begin('start', step, settings, motions=encoded)
        elif pending:
            self._cycle.stage(self._prepare(pending, motion_of))

    @classmethod
    def from_entry(
        cls, entry: journal.Entry, *, on_entry: Callable[[str], None] = lambda _line: None
    ) -> Session:
        """
        Continue from the entry of the journal for the start of a session or a throw.

        The next step is that of the entry. Its outputs equal the original ones to the last bit,
        and so do those of all later steps with the same inputs, see `follow`.

        Raises
        ------
        JournalError
            If the entry is of another kind, or incomplete.
        ValueError
            If the rig cannot be stepped in real time.

        """
        settings, step = journal.checked_settings(entry, 'settings'), entry['step']
        motion_of = journal.motion_source(entry)
        if entry['kind'] == 'start':
            return cls(settings, step=step, on_entry=on_entry, motion_of=motion_of)
        if entry['kind'] != 'throw' or 'throw' not in entry:
            raise journal.JournalError(
                f'a session starts with an entry start or throw, got {quote(dict(entry))}'
            )
        pending = journal.checked_settings(entry, 'pending')
        session = cls(
            settings, step=step, on_entry=on_entry, pending=pending, motion_of=motion_of
        )
        session._cycle.resume(step, entry)
        return session

    def _prepare(self, values: Settings, motion_of: MotionSource) -> PreparedRig:
        """Return the wanted rig after a change."""
        wanted = self._cycle.wanted
        return prepare({**wanted.config.settings, **values}, wanted, motion_of)

    @property
    def throws(self) -> int:
        """Number of throws that have started."""
        return self._cycle.throws

    @property
    def rate(self) -> float:
        """Present number of steps per second of the clock [Hz]."""
        return self._cycle.config.state_rate

    @property
    def time_scale(self) -> float:
        """Present time of the rig over time of the clock [-]."""
        return self._cycle.config.time_scale

    def due_ns(self, step: int) -> int:
        """Return the deadline of a step by the last schedule that was set [ns]."""
        return self._cycle.schedule.deadline(step)

    @property
    def pending(self) -> Settings:
        """Pending changes by name."""
        return self._cycle.pending

    @property
    def is_measured(self) -> bool:
        """Whether the plate is measured."""
        return self._cycle.monitor is not None

    @property
    def is_at_rest(self) -> bool:
        """Whether a measured plate is at rest, so that a throw can start."""
        monitor = self._cycle.monitor
        return monitor is not None and monitor.is_armed

    @property
    def sample_counts(self) -> SampleCounts:
        """Numbers of accepted and refused samples of the rig."""
        return self._cycle.sample_counts

    # inputs

    def request_throw(self) -> int:
        """
        Start a throw with the next step, or after a return to rest if changes are pending.

        Returns
        -------
        int
            Number of the throw.

        Raises
        ------
        RequestRejected
            If a throw is under way, or if the plate is measured.

        """
        with self._lock:
            if self.is_measured:
                raise RequestRejected('the plate is measured: a throw starts when it jumps up')
            if refusal := self._cycle.rig_state.request_throw(self.step):
                raise RequestRejected(refusal)
            self._journal.write('input', self.step, input='throw')
            return self.throws + 1

    def reset(self) -> None:
        """Abort a throw under way, return to rest, and count the period from here."""
        with self._lock:
            self._journal.write('input', self.step, input='reset')
            self._cycle.reset(self.step)

    def change(
        self,
        values: Settings,
        prepared: PreparedRig | None = None,
        *,
        motion_of: MotionSource = motions.read,
    ) -> None:
        """
        Change settings: at once, or when the rig is put back, see `ThrowCycle`.

        The values include all implied changes, and `prepared` is the rig with all of them; by
        default it is prepared here. Changes come from one thread.

        Raises
        ------
        ValueError
            If the rig could not be stepped in real time; then nothing has changed.

        """
        wanted = prepared or self._prepare(values, motion_of)
        with self._lock:
            before = self._cycle.encoded_motions
            self._cycle.stage(wanted)
            after = self._cycle.encoded_motions
            new = {path: text for path, text in after.items() if before.get(path) != text}
            self._journal.write(
                'input', self.step, input='parameters', values=dict(values), motions=new
            )

    def measure(self, samples: Samples, *, clock_offset_ns: int = 0) -> None:
        """
        Add samples of the rig, if the plate is measured, or refuse and count them.

        The next throw notes the offset that has been added to their stamps.
        """
        with self._lock:
            self._cycle.clock_offset_ns = clock_offset_ns
            if (monitor := self._cycle.monitor) is not None and samples:
                added = monitor.buffer.add(samples, self.due_ns(self.step))
                if added:
                    self._journal.keep_samples(self.step, added)

    def diagnose_sensors(self) -> tuple[str, ...]:
        """Return new faults of the sensors of a measured plate; call it about once a second."""
        with self._lock:
            monitor = self._cycle.monitor
            return () if monitor is None else monitor.faults()

    def set_tick_schedule(self, schedule: TickSchedule) -> None:
        """
        Set the deadlines of steps from the next one on.

        The schedule relates the stamps of samples and results to steps. It is written to the
        journal, and again with every throw, so that any part of a recording determines the steps
        of its messages.
        """
        with self._lock:
            self._cycle.schedule = replace(schedule)  # its owner changes it later
            self._journal.write('tick_schedule', self.step, **journal.encode_schedule(schedule))

    def close(self) -> None:
        """Write the remaining entries of the journal after the last step."""
        with self._lock:
            self._journal.close(self.step)

    # steps

    def advance(self) -> Outputs:
        """Advance by one step."""
        with self._lock:
            outputs = self._cycle.advance(self.step)
            self.step += 1
            rate = self._cycle.config.state_rate
            is_measured = self._cycle.monitor is not None
            self._journal.end_step(outputs, rate=rate, is_measured=is_measured)
            return outputs

    def advance_to(self, step: int) -> Iterator[Outputs]:
        """Advance until a step is the next one."""
        while self.step < step:
            yield self.advance()

    def follow(self, entry: journal.Entry) -> Iterator[Outputs]:
        """
        Advance to an entry of a journal of the session, and apply the input of the entry, if any.

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
                yield from self.advance_to(step)
                self.measure(samples)
            return
        yield from self.advance_to(entry['step'])
        if entry['kind'] == 'throw' and 'onset' in entry:
            self._cycle.clock_offset_ns = journal.decode_onset(entry['onset']).clock_offset_ns
        elif entry['kind'] == 'tick_schedule':
            self.set_tick_schedule(journal.decode_schedule(entry))
        elif entry['kind'] == 'input':
            if entry['step'] != self.step:
                raise journal.JournalError(
                    f'an input before step {self.step}, got {quote(dict(entry))}'
                )
            match entry.get('input'):
                case 'throw':
                    self.request_throw()
                case 'reset':
                    self.reset()
                case 'parameters':
                    values = journal.checked_settings(entry, 'values')
                    known = {**self._cycle.encoded_motions, **entry.get('motions', {})}
                    source = journal.motion_source({**entry, 'motions': known})
                    self.change(values, motion_of=source)
                case name:
                    raise journal.JournalError(f'no input is named {quote(name)}')
