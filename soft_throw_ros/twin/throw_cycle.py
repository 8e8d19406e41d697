# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The cycle of a rig: at rest, throwing, returning to rest.

Each state is a class. Its `advance` gives the outputs of a step. Before that `start_next` enters
the next state if it is due. `request_throw` returns the reason of a refusal, or an empty text.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
import math
from typing import TypeAlias

import numpy as np
from soft_throw_ros.configuration import Settings
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.journal import JournalWriter
from soft_throw_ros.twin.measured_throw import MeasuredThrow
from soft_throw_ros.twin.plate_monitor import PlateMonitor
from soft_throw_ros.twin.prepared_rig import FIELD_POINTS, PreparedRig, waiting_values
from soft_throw_ros.twin.results import (
    LayerState,
    Outputs,
    Phase,
    PhaseChange,
    PlateCommand,
    State,
    ThrowField,
    ThrowResult,
)
from soft_throw_ros.twin.sample_buffer import Onset, SampleCounts
from soft_throw_ros.twin.throws import OngoingThrow, ScheduledThrow, Tick
from soft_throw_ros.twin.tick_schedule import TickSchedule

_PHASES = {'release': Phase.FLIGHT, 'recontact': Phase.CONTACT, 'landing': Phase.LANDED}


@dataclass
class _AtRest:
    """Plate and projectile are at rest; the next throw starts when it is due or requested."""

    cycle: ThrowCycle
    is_requested: bool = False
    start_step: int | None = None  # of the next throw, whose motion is commanded already
    onset: Onset | None = None  # of a measured throw that a journal starts with

    def start_next(self, step: int) -> None:
        cycle = self.cycle
        if self.start_step is not None:
            if step >= self.start_step:
                cycle.begin_throw(step)
        elif self.is_requested or step >= cycle.next_start:
            if cycle.pending:
                cycle.put_back(step, is_requested=self.is_requested)
            else:
                cycle.command_plate(step, self)

    def advance(self, step: int) -> Outputs:
        rest, monitor = self.cycle.prepared.rest, self.cycle.monitor
        return Outputs(step, self.cycle.throws, monitor.state(rest) if monitor else rest)

    def layer(self) -> LayerState:
        return self.cycle.prepared.rest_layer

    def request_throw(self, step: int) -> str:  # noqa: ARG002
        if self.is_requested or self.start_step is not None:
            return f'throw {self.cycle.throws + 1} is about to start'
        self.is_requested = True
        return ''


@dataclass
class _Throwing:
    """A throw is under way: in contact, in flight, or landed."""

    cycle: ThrowCycle
    throw: OngoingThrow

    def advance(self, step: int) -> Outputs:
        cycle, throw, tick = self.cycle, self.throw, self.cycle.tick(step)
        was_released = bool(throw.events)
        outputs = throw.advance(tick)
        cycle.state = outputs.state
        cycle.rare.phases += tuple(
            (_PHASES[event.kind], throw.event_ns(event, tick)) for event in outputs.events
        )
        for result in outputs.results:
            cycle.report(step, result)
        if throw.events and not was_released:
            cycle.report(step, throw.result('release', tick))
        returning = cycle.prepared.return_ticks(tick.config.throw_period)
        if throw.ended_by or step >= cycle.next_start - returning:
            self.end(step, throw.ended_by or 'period')
        else:
            cycle.rare.throw_field = throw.throw_field()
        return outputs

    def end(self, step: int, ended_by: str) -> None:
        """End the throw, and put the rig back."""
        self.throw.ended_by = ended_by
        self.cycle.report(step, self.throw.result('final', self.cycle.tick(step)))
        self.cycle.rare.throw_field = self.throw.throw_field()
        self.cycle.put_back(step)

    def layer(self) -> LayerState:
        return self.throw.layer

    def request_throw(self, step: int) -> str:
        until = self.cycle.due
        return self.cycle.refusal(step, f'throw {self.throw.number} is under way', until)


@dataclass
class _Returning:
    """
    Plate and projectile return to rest between two steps.

    A measured plate returns by itself: it is at rest when its monitor is armed.
    """

    cycle: ThrowCycle
    begin: int
    end: int
    origin: State
    is_requested: bool = False  # the next throw starts when they have arrived

    def start_next(self, step: int) -> None:
        if step >= self.end:
            if self.is_requested or step >= self.cycle.next_start:
                self.cycle.command_plate(step)
            else:
                self.cycle.enter(_AtRest(self.cycle), Phase.REST)

    def advance(self, step: int) -> Outputs:
        """
        Return a point of the way to rest with the least jerk [1]_, or that of a measured plate.

        Plate and projectile have covered the same share of their ways at any time, so that they
        do not collide. Forces are zero, because the layer is left out.

        References
        ----------
        .. [1] Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985) 1688.

        """
        cycle, origin, goal = self.cycle, self.origin, self.cycle.prepared.rest
        if cycle.monitor is not None:
            return Outputs(step, cycle.throws, cycle.monitor.state(goal))
        ticks = self.end - self.begin
        time = (step - self.begin) / ticks  # over the duration
        share = time**3 * (10.0 - 15.0 * time + 6.0 * time**2)
        speed = 30.0 * (time * (1.0 - time)) ** 2 / (ticks * cycle.prepared.tick)
        plate = goal.plate_position - origin.plate_position
        projectile = goal.projectile_position - origin.projectile_position
        state = State(
            plate_position=origin.plate_position + share * plate,
            projectile_position=origin.projectile_position + share * projectile,
            plate_velocity=speed * plate,
            projectile_velocity=speed * projectile,
            plate_force=0.0,
            projectile_force=0.0,
        )
        return Outputs(step, cycle.throws, state)

    def layer(self) -> LayerState:
        """Return the layer lying on the plate without force."""
        rest, state = self.cycle.prepared.rest, self.cycle.state
        gap = state.projectile_position - state.plate_position
        scale = min(1.0, gap / (rest.projectile_position - rest.plate_position))
        height = self.cycle.prepared.rest_layer.height - rest.plate_position
        return LayerState(
            state.plate_position + scale * height,
            np.full(FIELD_POINTS, state.plate_velocity),
            np.zeros(FIELD_POINTS),
        )

    def request_throw(self, step: int) -> str:
        return self.cycle.refusal(step, 'resetting the rig', self.end)


RigState: TypeAlias = _AtRest | _Throwing | _Returning


@dataclass
class _RareOutputs:
    """Outputs of a step that most steps do not have."""

    # with the time of each change [ns]; None for the deadline of the step
    phases: tuple[tuple[Phase, int | None], ...] = ()
    results: tuple[ThrowResult, ...] = ()
    throw_field: Callable[[], ThrowField] | None = None
    command: PlateCommand | None = None


class ThrowCycle:
    """
    A state machine for the rig: at rest, throwing, or returning to rest.

    Notes
    -----
    A throw starts on request, or `throw.period` after the start of the last throw. It ends when
    the projectile is at rest, after `throw.max_events` contacts, after `throws.LONGEST_THROW`, or
    when only the time to return to rest remains until the next throw. Then plate and projectile
    return to rest along continuous paths.

    A change of the rig, of the measurement, of rates or of the time scale waits until the return
    begins, and all that wait take effect together: after a throw, at a reset, or, if the rig is at
    rest, before the next throw. Not while a controller has the motion of the next throw
    (`engine.command`). Every other change is effective at once.

    If the plate is measured, a throw starts when the plate moves up suddenly after a rest,
    regardless of the period. It also ends when samples are missing for longer than a wave needs to
    cross the layer, or when the next throw starts. Settings that wait then take effect with the
    throw. Between throws, plate and projectile stay at the last measured height of the plate.

    """

    def __init__(self, prepared: PreparedRig, writer: JournalWriter, *, step: int) -> None:
        self.config = prepared.config  # in effect
        self.prepared = prepared
        self.wanted = prepared  # with the changes that wait
        self.throws = 0  # number of started throws
        self.schedule = TickSchedule(step=step, time_ns=0, rate=self.config.state_rate)
        self.clock_offset_ns = 0  # of the samples, see `Session.measure` [ns]
        self.sample_counts = SampleCounts()
        self.monitor: PlateMonitor | None = None  # if the plate is measured
        self.state = prepared.rest  # in the last step
        self._period_start = step  # of the last throw, or of a reset
        self.rare = _RareOutputs(phases=((Phase.REST, None),))
        self._journal = writer
        self.rig_state: RigState = _AtRest(self)
        self._field_start = step  # since which rows of the field are counted
        self._busy_until: float = step  # at the end of a commanded motion, or of a return
        self._start_monitoring()

    @property
    def pending(self) -> Settings:
        """The changes that wait, by name."""
        wanted, present = self.wanted.config.settings, self.config.settings
        return {name: value for name, value in wanted.items() if value != present[name]}

    @property
    def encoded_motions(self) -> Mapping[str, str]:
        """The motions of files of both rigs, encoded, by their paths."""
        return {**self.prepared.encoded_motion, **self.wanted.encoded_motion}

    @property
    def due(self) -> float:
        """Step of the next throw by `throw.period`; infinite without, or with a measured plate."""
        config = self.config
        if not config.throw_period or config.is_measured:
            return math.inf
        return self._period_start + self.prepared.period_ticks(config.throw_period)

    @property
    def _lead_ticks(self) -> int:
        """Steps from the command of a motion to its start; 0 without a command."""
        return round((self.config.command_lead or 0.0) * self.config.state_rate)

    @property
    def next_start(self) -> float:
        """Step at which the next throw starts by the period, or at which it is commanded."""
        return self.due - self._lead_ticks

    def _end_of_command(self, start: int) -> float:
        """Return the step at which a controller has played a motion from `start` on, if any."""
        motion = self.prepared.rig.engine.motion
        if self.config.command_lead is None or motion is None:
            return start
        return start + motion.end_time * self.config.state_rate

    def refusal(self, step: int, reason: str, until: float) -> str:
        """Return a reason with the time until a step."""
        remaining = (until - step) / self.config.state_rate
        return f'{reason}: ready in at most {remaining:.2f} s' if until < math.inf else reason

    def tick(self, step: int) -> Tick:
        """Return a step with its deadline."""
        return Tick(step, self.schedule.deadline(step), self.config)

    # inputs

    def stage(self, wanted: PreparedRig) -> None:
        """Stage a wanted rig; put the changes in effect that need not wait."""
        self.wanted = wanted
        waiting = waiting_values(self.config.settings)
        self.config = self.config.change({**wanted.config.settings, **waiting})

    def resume(self, step: int, entry: journal.Entry) -> None:
        """Start the throw of an entry of a journal at its step."""
        self.throws = entry['throw'] - 1
        onset = None if self.monitor is None else journal.decode_onset(entry.get('onset', {}))
        self.rig_state = _AtRest(self, start_step=step, onset=onset)  # also if changes wait
        self.rare = _RareOutputs()
        if 'schedule' in entry:
            self.schedule = journal.decode_schedule(entry['schedule'])

    def reset(self, step: int) -> None:
        """Abort a throw under way, return to rest, and count the period from here."""
        if isinstance(self.rig_state, _Throwing):
            self.rig_state.end(step, 'reset')
        else:
            self.put_back(step)
        self._period_start = step

    # steps

    def advance(self, step: int) -> Outputs:
        """Advance by one step."""
        if self.monitor is not None:
            self._watch_plate(step, self.monitor)
        elif not isinstance(self.rig_state, _Throwing):
            self.rig_state.start_next(step)
        outputs = self.rig_state.advance(step)
        self.state = outputs.state
        rows = [
            since * self.config.field_rate // self.config.state_rate
            for since in (step - self._field_start, step - self._field_start - 1)
        ]
        rare, self.rare = self.rare, _RareOutputs()
        return outputs._replace(
            phases=tuple(
                PhaseChange(phase, self.schedule.deadline(step) if stamp_ns is None else stamp_ns)
                for phase, stamp_ns in rare.phases
            ),
            results=rare.results,
            layer=None if rows[0] == rows[1] else self.rig_state.layer(),
            throw_field=rare.throw_field,
            command=rare.command,
        )

    def report(self, step: int, result: ThrowResult) -> None:
        """Output a result in a step, and write it to the journal."""
        self.rare.results += (result,)
        self._journal.write_result(step, result)

    def enter(self, rig_state: RigState, phase: Phase, stamp_ns: int | None = None) -> None:
        """Enter a state with a phase."""
        self.rig_state = rig_state
        self.rare.phases += ((phase, stamp_ns),)

    def command_plate(self, step: int, rest: _AtRest | None = None) -> None:
        """Output the motion of the next throw if a controller plays it, and start the throw."""
        motion, start_step = self.prepared.rig.engine.motion, step + self._lead_ticks
        if self.config.command_lead is not None and motion is not None:
            self.rare.command = PlateCommand(self.schedule.deadline(start_step), motion)
        self._busy_until = self._end_of_command(start_step)
        if start_step == step:
            self.begin_throw(step)
        elif rest is not None:
            rest.start_step = start_step
        else:
            self.enter(_AtRest(self, start_step=start_step), Phase.REST)

    def begin_throw(self, step: int, onset: Onset | None = None) -> None:
        """Begin a throw, of a measured plate with an onset."""
        self.throws += 1
        self._field_start = self._period_start = step
        self._busy_until = self._end_of_command(step)
        self._journal.begin(
            'throw',
            step,
            self.config.settings,
            motions=self.encoded_motions,
            throw=self.throws,
            pending=self.pending,
            schedule=journal.encode_schedule(self.schedule),
            **({} if onset is None else {'onset': journal.encode_onset(onset)}),
        )
        throw: OngoingThrow
        if onset is None:
            due_ns = self.schedule.deadline(step)
            throw = ScheduledThrow(
                self.prepared, number=self.throws, start_step=step, start_ns=due_ns
            )
        else:
            self._start_monitoring(onset)
            assert self.monitor is not None
            throw = MeasuredThrow(
                self.prepared, onset, self.monitor.buffer, number=self.throws
            )
        self.enter(
            _Throwing(self, throw), Phase.CONTACT, None if onset is None else onset.onset_ns
        )

    def put_back(self, step: int, *, is_requested: bool = False) -> None:
        """
        Begin the return to rest, with the settings that were pending in effect.

        It ends no sooner than a commanded motion, which the next command would replace.
        """
        busy_time = (self._busy_until - step) / self.config.state_rate
        self._commit(step)
        config, ticks = self.config, 0
        if not config.is_measured:
            ticks = self.prepared.return_ticks(config.throw_period)
            ticks = max(ticks, math.ceil(busy_time * config.state_rate))
        self._start_monitoring()
        self._field_start, self._busy_until = step, step + ticks
        is_requested = is_requested and self.monitor is None
        returning = _Returning(self, step, step + ticks, self.state, is_requested)
        self.enter(returning, Phase.RETURNING)

    def _commit(self, step: int) -> None:
        """Put pending settings in effect; the time since the last start stays the same."""
        if not self.pending:
            return
        passed = (step - self._period_start) * self.prepared.tick
        self.prepared, self.config = self.wanted, self.wanted.config
        self._period_start = step - round(passed / self.prepared.tick)

    def _start_monitoring(self, onset: Onset | None = None) -> None:
        """Wait for the next throw of the plate, if it is measured."""
        config, crossing_time = self.config.measurement, self.prepared.rig.crossing_time
        if not self.config.is_measured:
            self.monitor = None
        elif self.monitor is None or onset is not None:
            self.monitor = PlateMonitor(config, crossing_time, self.sample_counts, onset)
        else:
            self.monitor.rearm(config, crossing_time)

    def _watch_plate(self, step: int, monitor: PlateMonitor) -> None:
        """Take over the samples of the plate, and start a throw at its onset."""
        now_ns, rig_state = self.schedule.deadline(step), self.rig_state
        onset = rig_state.onset if isinstance(rig_state, _AtRest) else None
        if onset is None and (onset := monitor.advance(now_ns)) is not None:
            onset = replace(onset, clock_offset_ns=self.clock_offset_ns)
        if onset is not None:
            if isinstance(rig_state, _Throwing):
                rig_state.end(step, 'next')
            self._commit(step)
            if self.config.is_measured:
                self.begin_throw(step, onset)
                assert self.monitor is not None
                self.monitor.advance(now_ns)  # since the start of the throw
            elif self.monitor is not None:  # the change that took effect ends the measurement
                self.put_back(step)
        elif isinstance(rig_state, _Returning) and monitor.is_armed:
            self.enter(_AtRest(self), Phase.REST)
