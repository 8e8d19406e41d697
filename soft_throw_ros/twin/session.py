# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A session of the twin without ROS.

A session counts its time in steps, the ticks of `rate.state`. A node, which advances it by the
clock, and a replay, which advances it as fast as it can, get the same outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
import math
from threading import Lock

from soft_throw_ros.configuration import motions, Settings
from soft_throw_ros.configuration.table import quote
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.plate_monitor import PlateMonitor
from soft_throw_ros.twin.prepared_rig import prepare, PreparedRig, waiting_values
from soft_throw_ros.twin.results import Outputs, Phase, PhaseChange, PlateCommand, ThrowResult
from soft_throw_ros.twin.rig_states import (
    AtRest,
    MeasuredThrow,
    OngoingThrow,
    Returning,
    RigState,
    ScheduledThrow,
)
from soft_throw_ros.twin.sample_buffer import LONG_AGO, Onset, SampleCounts, Samples

_NOW = LONG_AGO
"""Stamp of a phase that begins at the deadline of the step, which may be set later. [ns]"""


class RequestRejected(Exception):
    """A refused request; the message has the reason."""


@dataclass
class TickSchedule:
    """Absolute deadlines of steps, so that a delay of one step does not delay later ones."""

    step: int  # number of a step
    time_ns: int  # deadline of the step [ns]
    rate: float  # steps per second [Hz]

    def deadline(self, step: int) -> int:
        """Return the deadline of a step [ns]."""
        return self.time_ns + round((step - self.step) * SECOND / self.rate)

    def change_rate(self, *, step: int, rate: float) -> None:
        """Change the rate after a step, whose own deadline stays."""
        self.time_ns, self.step, self.rate = self.deadline(step), step, rate

    def skip(self, *, step: int, now: int, max_catch_up: int) -> int:
        """
        Delay all deadlines by the part of a stall beyond `max_catch_up` [ns].

        Steps stay consecutive; return the number of ticks of the clock without a step.
        """
        late = now - self.deadline(step) - max_catch_up
        ticks = max(0, int(late * self.rate / SECOND))
        if ticks:
            self.time_ns, self.step = self.deadline(step + ticks), step
        return ticks


class Session:
    """
    A rig at rest, throwing or returning to rest, with its settings and its journal.

    Inputs may come from another thread than the one that advances the session. An input takes
    effect between two steps, and has the number of the second one in the journal.

    Parameters
    ----------
    prepared : PreparedRig
        The rig at the start, by `prepared_rig.prepare`.
    step : int
        Number of the first step.
    on_entry : callable
        Called with every line of the journal, in order; it must not call the session.

    Notes
    -----
    A throw starts on request, or `throw.period` after the start of the last throw. It ends when
    the projectile is at rest, after `throw.max_events` contacts, after 10 s, or when only the time
    to return to rest remains until the next throw. Then plate and projectile return to rest along
    continuous paths.

    A change of the rig, of the measurement, of rates or of the time scale waits until the return
    begins, and all that wait take effect together: after a throw, at a reset, or, if the rig is at
    rest, before the next throw. Not while a controller has the motion of the next throw
    (`engine.command`). Every other change is effective at once.

    If the plate is measured, a throw starts when it jumps up after a rest, with the settings that
    wait. It also ends when samples are missing for longer than a wave needs to cross the layer,
    or when the next throw starts. Between throws, the rig stays at the last measured height.

    """

    def __init__(
        self,
        prepared: PreparedRig,
        *,
        step: int = 0,
        on_entry: Callable[[str], None] = lambda _line: None,
    ) -> None:
        self.step = step  # number of the next step
        self.throws = 0  # number of throws that have started
        self.is_requested = False  # a throw
        self.sample_counts = SampleCounts()  # of the rig
        self.prepared = self.wanted = prepared
        self.config = prepared.config  # in effect
        self.monitor: PlateMonitor | None = None  # if the plate is measured
        self.outputs = Outputs(step, 0, prepared.rest)  # of the next step
        self._lock = Lock()  # held for microseconds
        self._journal = journal.JournalWriter(on_entry, step=step)
        self._schedule = TickSchedule(step=step, time_ns=0, rate=self.rate)
        self._clock_offset_ns = 0  # of the samples, see `measure` [ns]
        self._period_start = step  # of the last throw, or of a reset
        self._busy_until: float = step  # at the end of a commanded motion, or of a return
        self._start_monitoring()
        self.enter(AtRest(self), Phase.REST)
        self._journal.begin('start', step, self.config.settings, motions=self._encoded_motions)

    @classmethod
    def from_entry(
        cls, entry: journal.Entry, *, on_entry: Callable[[str], None] = lambda _line: None
    ) -> Session:
        """
        Continue from the entry of the journal for the start of a session or a throw.

        The next step is that of the entry. Its outputs equal the original ones to the last bit,
        and so do those of all later steps with the same inputs, see `follow`. An entry of another
        program may raise any error of its values.
        """
        settings, motion_of = journal.checked(entry['settings']), journal.motion_source(entry)
        prepared = prepare(settings, motion_of=motion_of)
        session = cls(prepared, step=entry['step'], on_entry=on_entry)
        if entry['kind'] == 'throw':
            session.outputs.phases.clear()
            if pending := journal.checked(entry['pending']):
                session._stage(prepare({**settings, **pending}, prepared, motion_of))
            session.throws = entry['throw'] - 1
            session._schedule = TickSchedule(**entry['schedule'])
            onset = journal.decode_onset(entry['onset']) if session.is_measured else None
            session.begin_throw(onset)
        return session

    @property
    def rate(self) -> float:
        """Present number of steps per second of the clock [Hz]."""
        return self.config.state_rate

    @property
    def pending(self) -> Settings:
        """The changes that wait, by name."""
        wanted, present = self.wanted.config.settings, self.config.settings
        return {name: value for name, value in wanted.items() if value != present[name]}

    @property
    def is_measured(self) -> bool:
        """Whether the plate is measured."""
        return self.monitor is not None

    @property
    def is_at_rest(self) -> bool:
        """Whether a measured plate is at rest, so that a throw can start."""
        return self.monitor is not None and self.monitor.is_armed

    def due_ns(self, step: int) -> int:
        """Return the deadline of a step by the last schedule that was set [ns]."""
        return self._schedule.deadline(step)

    # inputs

    def request_throw(self) -> int:
        """
        Start a throw with the next step, or after a return if changes are pending.

        Return its number; RequestRejected if a throw is under way, or if the plate is measured.
        """
        with self._lock:
            if self.is_measured:
                raise RequestRejected('the plate is measured: a throw starts when it jumps up')
            reason, until = self._rig_state.refusal()
            if until < math.inf:
                reason += f': ready in at most {(until - self.step) / self.rate:.2f} s'
            if reason:
                raise RequestRejected(reason)
            self.is_requested = True
            self._journal.write('input', self.step, input='throw')
            return self.throws + 1

    def reset(self) -> None:
        """Abort a throw under way, return to rest, and count the period from here."""
        with self._lock:
            self._journal.write('input', self.step, input='reset')
            self.is_requested = False
            if isinstance(self._rig_state, OngoingThrow):
                self._rig_state.end('reset')
            else:
                self.put_back()
            self._period_start = self.step

    def change(
        self,
        values: Settings,
        prepared: PreparedRig | None = None,
        *,
        motion_of: motions.MotionSource = motions.read,
    ) -> None:
        """
        Change settings: at once, or when the rig is put back, see the class.

        The values include all implied changes, and `prepared` is the rig with all of them; by
        default it is prepared here, ValueError if it could not be stepped in real time. Changes
        come from one thread.
        """
        wanted = prepared or prepare(
            {**self.wanted.config.settings, **values}, self.wanted, motion_of
        )
        with self._lock:
            before = self._encoded_motions
            self._stage(wanted)
            after = self._encoded_motions
            new = {path: text for path, text in after.items() if before.get(path) != text}
            self._journal.write(
                'input', self.step, input='parameters', values=dict(values), motions=new
            )

    def _stage(self, wanted: PreparedRig) -> None:
        """Stage a wanted rig; put the changes in effect that need not wait."""
        self.wanted = wanted
        waiting = waiting_values(self.config.settings)
        self.config = self.config.change({**wanted.config.settings, **waiting})

    @property
    def _encoded_motions(self) -> Mapping[str, str]:
        """The motions of files of both rigs, encoded, by their paths."""
        return {**self.prepared.encoded_motion, **self.wanted.encoded_motion}

    def measure(self, samples: Samples, *, clock_offset_ns: int = 0) -> None:
        """
        Add samples of the rig, if the plate is measured, or refuse and count them.

        The next throw notes the offset that has been added to their stamps.
        """
        with self._lock:
            self._clock_offset_ns = clock_offset_ns
            if self.monitor is not None and samples:
                added = self.monitor.buffer.add(samples, self.due_ns(self.step))
                if added:
                    self._journal.keep_samples(self.step, added)

    def diagnose_sensor(self) -> str:
        """Return the fault of the sensor of a measured plate, if any."""
        with self._lock:
            return '' if self.monitor is None else self.monitor.rate_fault()

    def set_tick_schedule(self, schedule: TickSchedule) -> None:
        """
        Set the deadlines of steps from the next one on.

        The journal has the schedule, and again with every throw, so that any part of a recording
        determines the steps of its messages.
        """
        with self._lock:
            self._schedule = replace(schedule)  # its owner changes it later
            self._journal.write('tick_schedule', self.step, schedule=vars(schedule))

    def close(self) -> None:
        """Write the remaining entries of the journal after the last step."""
        with self._lock:
            self._journal.close(self.step)

    # steps

    def advance(self) -> Outputs:
        """Advance by one step."""
        with self._lock:
            if self.monitor is not None:
                self._watch_plate(self.monitor)
            elif not isinstance(self._rig_state, OngoingThrow):
                self._rig_state.start_next()
            outputs = self.outputs
            outputs.throw = self.throws
            self._rig_state.advance(outputs)
            due_ns, step = self.due_ns(self.step), self.step
            outputs.phases = [
                phase._replace(stamp_ns=due_ns) if phase.stamp_ns == _NOW else phase
                for phase in outputs.phases
            ]
            row, last_row = (k * self.config.field_rate // self.rate for k in (step, step - 1))
            if row != last_row:
                outputs.layer = self._rig_state.layer()
            self.step += 1
            self.outputs = Outputs(self.step, self.throws, outputs.state)
            self._journal.end_step(outputs, rate=self.rate, is_measured=self.is_measured)
            return outputs

    def advance_to(self, step: int) -> Iterator[Outputs]:
        """Advance until a step is the next one."""
        while self.step < step:
            yield self.advance()

    def follow(self, entry: journal.Entry) -> Iterator[Outputs]:
        """
        Advance to an entry of a journal of the session, and apply the input of the entry, if any.

        RequestRejected if the session rejects the input, so that the journal is of another
        session. An entry of another program may raise any error of its values.
        """
        if entry['kind'] == 'samples':
            for step, samples in journal.decode_samples(entry):
                yield from self.advance_to(min(step, entry['step']))
                self.measure(samples)
            return
        yield from self.advance_to(entry['step'])
        match entry:
            case {'kind': 'throw', 'onset': onset}:
                self._clock_offset_ns = onset['clock_offset_ns']
            case {'kind': 'tick_schedule', 'schedule': schedule}:
                self.set_tick_schedule(TickSchedule(**schedule))
            case {'kind': 'input', 'input': 'throw'}:
                self.request_throw()
            case {'kind': 'input', 'input': 'reset'}:
                self.reset()
            case {'kind': 'input', 'input': 'parameters', 'values': values}:
                known = {**self._encoded_motions, **entry.get('motions', {})}
                source = journal.motion_source({'motions': known})
                self.change(journal.checked(values), motion_of=source)
            case {'kind': 'input'}:
                raise journal.JournalError(f'no input is {quote(dict(entry))}')

    # for the states of the rig

    @property
    def due(self) -> float:
        """Step of the next throw by `throw.period`; infinite without, or with a measured plate."""
        config = self.config
        if not config.throw_period or config.is_measured:
            return math.inf
        return self._period_start + self.prepared.period_ticks(config.throw_period)

    @property
    def next_start(self) -> float:
        """Step at which the next throw starts, or at which it is commanded."""
        return -math.inf if self.is_requested else self.due - self._lead_ticks

    @property
    def _lead_ticks(self) -> int:
        """Steps from the command of a motion to its start; 0 without a command."""
        return round((self.config.command_lead or 0.0) * self.rate)

    def report(self, result: ThrowResult) -> None:
        """Output a result, and write it to the journal."""
        self.outputs.results.append(result)
        self._journal.write_result(self.step, result)

    def enter(self, rig_state: RigState, phase: Phase, stamp_ns: int = _NOW) -> None:
        """Enter a state with a phase, by default at the deadline of the step."""
        self._rig_state = rig_state
        self.outputs.phases.append(PhaseChange(phase, stamp_ns))

    def command_plate(self) -> None:
        """Output the motion of the next throw if a controller plays it, and start the throw."""
        start_step, self.is_requested = self.step + self._lead_ticks, False
        if (motion := self._occupy_controller(start_step)) is not None:
            self.outputs.command = PlateCommand(self.due_ns(start_step), motion)
        if start_step == self.step:
            self.begin_throw()
        elif isinstance(self._rig_state, AtRest):
            self._rig_state.start_step = start_step
        else:
            self.enter(AtRest(self, start_step=start_step), Phase.REST)

    def _occupy_controller(self, start_step: int) -> SampledMotion | None:
        """Return the motion that a controller plays from a step on, if any, and await its end."""
        motion = None if self.config.command_lead is None else self.prepared.rig.engine.motion
        if motion is not None:
            self._busy_until = start_step + motion.end_time * self.rate
        return motion

    def begin_throw(self, onset: Onset | None = None) -> None:
        """Begin a throw, of a measured plate with an onset."""
        step = self.step
        self.throws += 1
        self._period_start = step
        self._occupy_controller(step)
        self._journal.begin(
            'throw',
            step,
            self.config.settings,
            motions=self._encoded_motions,
            throw=self.throws,
            pending=self.pending,
            schedule=vars(self._schedule),
            **({} if onset is None else {'onset': journal.encode_onset(onset)}),
        )
        self._start_monitoring(onset)
        if onset is None or self.monitor is None:
            self.enter(ScheduledThrow(self), Phase.CONTACT)
        else:
            throw = MeasuredThrow(self, onset, self.monitor)
            self.enter(throw, Phase.CONTACT, onset.onset_ns)

    def put_back(self) -> None:
        """Begin the return to rest, with pending settings, until a commanded motion is over."""
        busy_time, ticks = (self._busy_until - self.step) / self.rate, 0
        self._commit()
        if not self.config.is_measured:
            ticks = self.prepared.return_ticks(self.config.throw_period)
            ticks = max(ticks, math.ceil(busy_time * self.rate))
        self._start_monitoring()
        self._busy_until = self.step + ticks
        self.is_requested &= self.monitor is None
        returning = Returning(self, self.step, self.step + ticks, self.outputs.state)
        self.enter(returning, Phase.RETURNING)

    def _commit(self) -> None:
        """Put pending settings in effect; the time since the last start stays the same."""
        passed = (self.step - self._period_start) * self.prepared.tick
        self.prepared, self.config = self.wanted, self.wanted.config
        self._period_start = self.step - round(passed / self.prepared.tick)

    def _start_monitoring(self, onset: Onset | None = None) -> None:
        """Wait for the next throw of the plate, or watch one from its onset on, if measured."""
        if not self.config.is_measured:
            self.monitor = None
            return
        config, crossing_time = self.config.measurement, self.prepared.rig.crossing_time
        if self.monitor is None or onset is not None:
            self.monitor = PlateMonitor(config, crossing_time, self.sample_counts, onset)
        else:
            self.monitor.rearm(config, crossing_time)

    def _watch_plate(self, monitor: PlateMonitor) -> None:
        """Take over the samples of the plate, and start a throw at its onset."""
        now_ns, rig_state = self.due_ns(self.step), self._rig_state
        if (onset := monitor.advance(now_ns)) is not None:
            if isinstance(rig_state, OngoingThrow):
                rig_state.end('next')
            self._commit()
            if self.config.is_measured:
                self.outputs.phases.clear()  # without a return, whose stamp would be later
                self.begin_throw(replace(onset, clock_offset_ns=self._clock_offset_ns))
                assert self.monitor is not None
                self.monitor.advance(now_ns)  # since the start of the throw
            elif self.monitor is not None:  # the change that took effect ends the measurement
                self.put_back()
        elif isinstance(rig_state, Returning) and monitor.is_armed:
            self.enter(AtRest(self), Phase.REST)
