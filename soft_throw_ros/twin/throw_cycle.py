# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The cycle of a rig: at rest, throwing, returning to rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import TypeAlias

import numpy as np
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.journal import JournalWriter
from soft_throw_ros.twin.measured_throw import MeasuredThrow
from soft_throw_ros.twin.plate_estimator import NO_STATES, Onset, PlateStates, SampleCounts
from soft_throw_ros.twin.plate_monitor import PlateMonitor
from soft_throw_ros.twin.prepared_rig import FIELD_POINTS, PreparedRig
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
from soft_throw_ros.twin.sample_buffer import Samples
from soft_throw_ros.twin.sensor_checks import SensorChecks, SensorFault
from soft_throw_ros.twin.staged_settings import StagedSettings
from soft_throw_ros.twin.throws import OngoingThrow, ScheduledThrow, Tick
from soft_throw_ros.twin.tick_schedule import TickSchedule

_PHASES = {'release': Phase.FLIGHT, 'recontact': Phase.CONTACT, 'landing': Phase.LANDED}


@dataclass(frozen=True)
class AtRest:
    """Plate and projectile are at rest; the next throw starts when it is due or requested."""

    is_requested: bool = False
    start_step: int | None = None  # of the next throw, whose motion is commanded already
    onset: Onset | None = None  # of a measured throw that a journal starts with


@dataclass(frozen=True)
class Returning:
    """
    Plate and projectile return to rest between two steps.

    A measured plate returns by itself: it is at rest when its monitor is armed.
    """

    begin: int
    end: int
    origin: State
    is_requested: bool = False  # the next throw starts when they have arrived

    def state(self, step: int, goal: State, tick: float) -> State:
        """
        Return a point of the way to a state at rest with the least jerk [1]_.

        Plate and projectile have covered the same share of their ways at any time, so that they
        do not collide. Forces are zero, because the layer is left out. A step takes `tick` [s].

        References
        ----------
        .. [1] Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985) 1688.

        """
        ticks, origin = self.end - self.begin, self.origin
        time = (step - self.begin) / ticks  # over the duration
        share = time**3 * (10.0 - 15.0 * time + 6.0 * time**2)
        speed = 30.0 * (time * (1.0 - time)) ** 2 / (ticks * tick)
        plate = goal.plate_position - origin.plate_position
        projectile = goal.projectile_position - origin.projectile_position
        return State(
            plate_position=origin.plate_position + share * plate,
            projectile_position=origin.projectile_position + share * projectile,
            plate_velocity=speed * plate,
            projectile_velocity=speed * projectile,
            plate_force=0.0,
            projectile_force=0.0,
        )


RigState: TypeAlias = AtRest | OngoingThrow | Returning


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
    return to rest along continuous paths, see `Returning`.

    Staged settings take effect when the return begins: after a throw, at a reset, or, if the rig
    is at rest, before the next throw, which starts later by the time of the return.

    If a controller moves the plate (`engine.command`), the motion is an output some time before
    the throw starts, and no settings take effect in between.

    If the plate is measured, a throw starts when the plate moves up suddenly after a rest,
    regardless of the period. It also ends when samples are missing for longer than a wave needs to
    cross the layer, or when the next throw starts. Staged settings then take effect with the
    throw. Between throws, plate and projectile stay at the last measured height of the plate.

    """

    def __init__(self, staged: StagedSettings, writer: JournalWriter, *, step: int) -> None:
        self.throws = 0  # number of started throws
        self.schedule = TickSchedule(step=step, time_ns=0, rate=staged.config.state_rate)
        self.clock_offset_ns = 0  # of the samples, see `Session.measure` [ns]
        self.sample_counts = SampleCounts()
        self.sensor_checks = SensorChecks()
        self.monitor: PlateMonitor | None = None
        self._staged = staged
        self._journal = writer
        self._rig_state: RigState = AtRest()
        self._state = staged.prepared.rest
        self._period_start = step  # of the last throw, or of a reset
        self._field_start = step  # since which rows of the field are counted
        self._rare_outputs = _RareOutputs(phases=((Phase.REST, None),))
        self._start_monitoring()

    @property
    def _prepared(self) -> PreparedRig:
        return self._staged.prepared

    @property
    def _due(self) -> float:
        """Step of the next throw by `throw.period`; infinite without, or with a measured plate."""
        config = self._staged.config
        if not config.throw_period or config.is_measured:
            return math.inf
        return self._period_start + self._prepared.period_ticks(config.throw_period)

    @property
    def _lead_ticks(self) -> int:
        """Steps from the command of a motion to its start; 0 without a command."""
        config = self._staged.config
        return round((config.command_lead or 0.0) * config.state_rate)

    def _commanded_end(self, step: int) -> float:
        """Return the step at which a controller has played the commanded motion, if any."""
        config, rig_state = self._staged.config, self._rig_state
        motion = self._prepared.rig.engine.motion
        if isinstance(rig_state, Returning):
            return rig_state.end
        start = rig_state.start_step if isinstance(rig_state, AtRest) else self._period_start
        if config.command_lead is None or motion is None or start is None:
            return step
        return start + motion.end_time * config.state_rate

    def resume(self, step: int, entry: journal.Entry) -> None:
        """Start the throw of an entry of a journal at its step."""
        self.throws = entry['throw'] - 1
        onset = None if self.monitor is None else journal.decode_onset(entry.get('onset', {}))
        self._rig_state = AtRest(start_step=step, onset=onset)  # at once, also if changes wait
        self._rare_outputs = _RareOutputs()
        if 'schedule' in entry:
            self.schedule = journal.decode_schedule(entry['schedule'])

    def request_throw(self, step: int) -> str:
        """Request a throw; return the reason of a refusal, or an empty text."""
        rig_state = self._rig_state
        if isinstance(rig_state, AtRest):
            if rig_state.is_requested or rig_state.start_step is not None:
                return f'throw {self.throws + 1} is about to start'
            self._rig_state = AtRest(is_requested=True)
            return ''
        if isinstance(rig_state, Returning):
            reason, end = 'resetting the rig', float(rig_state.end)
        else:
            reason, end = f'throw {rig_state.number} is under way', self._due
        left = (end - step) / self._staged.config.state_rate
        return f'{reason}: ready in at most {left:.2f} s' if left < math.inf else reason

    def reset(self, step: int) -> None:
        """Abort a throw under way, return to rest, and count the period from here."""
        if isinstance(self._rig_state, OngoingThrow):
            self._end_throw(step, self._rig_state, 'reset')
        else:
            self._put_back(step)
        self._period_start = step

    def add_samples(self, step: int, samples: Samples) -> Samples | None:
        """Add samples of the rig if the plate is measured; return the accepted ones."""
        if self.monitor is None or not samples:
            return None
        return self.monitor.estimator.add_samples(samples, self.schedule.deadline(step))

    def diagnose_sensors(self) -> tuple[SensorFault, ...]:
        """Return new faults of the sensors of a measured plate."""
        if self.monitor is None:
            return ()
        return self.sensor_checks.diagnose(
            self.monitor.estimator,
            self._prepared.rig.crossing_time,
            is_armed=self.monitor.is_armed,
        )

    def advance(self, step: int) -> Outputs:
        """Advance by one step."""
        motion = NO_STATES
        if self.monitor is not None:
            motion = self._watch_plate(step, self.monitor)
        elif not isinstance(self._rig_state, OngoingThrow):
            self._begin_throw_if_due(step, self._rig_state)
        if isinstance(self._rig_state, OngoingThrow):
            outputs = self._advance_throw(step, self._rig_state, motion)
        else:
            self._state = self._idle_state(step, self._rig_state)
            outputs = Outputs(step, self.throws, self._state)
        layer = self._layer(step)
        rare, self._rare_outputs = self._rare_outputs, _RareOutputs()
        return outputs._replace(
            phases=tuple(
                PhaseChange(phase, self.schedule.deadline(step) if stamp_ns is None else stamp_ns)
                for phase, stamp_ns in rare.phases
            ),
            results=rare.results,
            layer=layer,
            throw_field=rare.throw_field,
            command=rare.command,
        )

    def _begin_throw_if_due(self, step: int, rig_state: AtRest | Returning) -> None:
        """Start a throw, or return to rest before it if changes wait."""
        if isinstance(rig_state, AtRest) and rig_state.start_step is not None:
            if step >= rig_state.start_step:
                self._begin_throw(step)
            return
        has_returned = isinstance(rig_state, Returning)
        if isinstance(rig_state, Returning) and step < rig_state.end:
            return
        if not rig_state.is_requested and step < self._due - self._lead_ticks:
            if has_returned:
                self._enter(AtRest(), Phase.REST)
        elif has_returned or not self._staged.pending:
            self._command_plate(step, has_returned=has_returned)
        else:
            self._put_back(step, is_requested=rig_state.is_requested)

    def _command_plate(self, step: int, *, has_returned: bool) -> None:
        """Output the motion of the next throw if a controller plays it, and start the throw."""
        motion, start_step = self._prepared.rig.engine.motion, step + self._lead_ticks
        if self._staged.config.command_lead is not None and motion is not None:
            command = PlateCommand(self.schedule.deadline(start_step), motion)
            self._rare_outputs.command = command
        if start_step == step:
            self._begin_throw(step)
        elif has_returned:
            self._enter(AtRest(start_step=start_step), Phase.REST)
        else:
            self._rig_state = AtRest(start_step=start_step)

    def _begin_throw(self, step: int, onset: Onset | None = None) -> None:
        self.throws += 1
        self._field_start = self._period_start = step
        self._journal.begin(
            'throw',
            step,
            self._staged.config.settings,
            motions=self._staged.encoded_motions,
            throw=self.throws,
            pending=self._staged.pending,
            schedule=journal.encode_schedule(self.schedule),
            **({} if onset is None else {'onset': journal.encode_onset(onset)}),
        )
        throw: OngoingThrow
        if onset is None:
            throw = ScheduledThrow(
                self._prepared,
                number=self.throws,
                start_step=step,
                start_ns=self.schedule.deadline(step),
            )
        else:
            self._start_monitoring(onset)
            assert self.monitor is not None
            throw = MeasuredThrow(
                self._prepared, onset, self.monitor.estimator, number=self.throws
            )
        start_ns = None if onset is None else onset.onset_ns
        self._enter(throw, Phase.CONTACT, start_ns)

    def _tick(self, step: int) -> Tick:
        return Tick(step, self.schedule.deadline(step), self._staged.config)

    def _advance_throw(self, step: int, throw: OngoingThrow, motion: PlateStates) -> Outputs:
        """Advance the throw under way, and end it if it is over."""
        tick = self._tick(step)
        was_released = bool(throw.events)
        outputs = throw.advance(tick, motion)
        self._state = outputs.state
        self._rare_outputs.phases += tuple(
            (_PHASES[event.kind], throw.event_ns(event, tick)) for event in outputs.events
        )
        for result in outputs.results:
            self._report(step, result)
        if throw.events and not was_released:
            self._report(step, throw.result('release', tick))
        returning = self._prepared.return_ticks(tick.config.throw_period)
        latest_end = self._due - self._lead_ticks - returning
        if throw.ended_by or step >= latest_end:
            self._end_throw(step, throw, throw.ended_by or 'period')
        else:
            self._rare_outputs.throw_field = throw.throw_field()
        return outputs

    def _idle_state(self, step: int, rig_state: AtRest | Returning) -> State:
        """Return the state of plate and projectile between throws."""
        prepared = self._prepared
        if self.monitor is not None:
            return self.monitor.state(prepared.rest)
        if isinstance(rig_state, Returning):
            return rig_state.state(step, prepared.rest, prepared.tick)
        return prepared.rest

    def _end_throw(self, step: int, throw: OngoingThrow, ended_by: str) -> None:
        throw.ended_by = ended_by
        self._report(step, throw.result('final', self._tick(step)))
        self._rare_outputs.throw_field = throw.throw_field()
        self._put_back(step)

    def _put_back(self, step: int, *, is_requested: bool = False) -> None:
        """
        Begin the return to rest, with the settings that were pending in effect.

        It ends no sooner than a commanded motion, which the next command would replace.
        """
        commanded = (self._commanded_end(step) - step) / self._staged.config.state_rate
        self._commit(step)
        config, ticks = self._staged.config, 0
        if not config.is_measured:
            ticks = self._prepared.return_ticks(config.throw_period)
            ticks = max(ticks, math.ceil(commanded * config.state_rate))
        self._start_monitoring()
        self._field_start = step
        returning = Returning(
            step, step + ticks, self._state, is_requested=is_requested and self.monitor is None
        )
        self._enter(returning, Phase.RETURNING)

    def _commit(self, step: int) -> None:
        """Put pending settings in effect; the time since the last start stays the same."""
        if not self._staged.pending:
            return
        passed = (step - self._period_start) * self._prepared.tick
        self._staged.commit()
        self._period_start = step - round(passed / self._prepared.tick)

    def _layer(self, step: int) -> LayerState | None:
        """Return the state of the layer in the first step of every row by `rate.field`."""
        rig_state, config = self._rig_state, self._staged.config
        row, row_before = (
            since * config.field_rate // config.state_rate
            for since in (step - self._field_start, step - self._field_start - 1)
        )
        if row == row_before:
            return None
        if isinstance(rig_state, OngoingThrow):
            return rig_state.layer
        return self._prepared.rest_layer if isinstance(rig_state, AtRest) else self._idle_layer()

    def _idle_layer(self) -> LayerState:
        """Return the layer lying on the plate without force, as between throws."""
        rest, height, state = self._prepared.rest, self._prepared.rest_layer.height, self._state
        gap = state.projectile_position - state.plate_position
        scale = min(1.0, gap / (rest.projectile_position - rest.plate_position))
        return LayerState(
            state.plate_position + scale * (height - rest.plate_position),
            np.full(FIELD_POINTS, state.plate_velocity),
            np.zeros(FIELD_POINTS),
        )

    def _enter(self, rig_state: RigState, phase: Phase, stamp_ns: int | None = None) -> None:
        self._rig_state = rig_state
        self._rare_outputs.phases += ((phase, stamp_ns),)

    def _report(self, step: int, result: ThrowResult) -> None:
        self._rare_outputs.results += (result,)
        self._journal.write_result(step, result)

    def _start_monitoring(self, onset: Onset | None = None) -> None:
        """Wait for the next throw of the plate, if it is measured."""
        config = self._staged.config
        if not config.is_measured:
            self.monitor = None
        elif self.monitor is None or onset is not None:
            self.sensor_checks.begin()
            self.monitor = PlateMonitor(config.measurement, self.sample_counts, onset)
        else:
            self.monitor.rearm(config.measurement)

    def _watch_plate(self, step: int, monitor: PlateMonitor) -> PlateStates:
        """Return the motion of the plate, and start a throw at its onset."""
        now_ns, rig_state = self.schedule.deadline(step), self._rig_state
        motion = NO_STATES
        onset = rig_state.onset if isinstance(rig_state, AtRest) else None
        if onset is None:
            motion, onset = monitor.advance(now_ns)
            if onset is not None:
                onset = replace(onset, clock_offset_ns=self.clock_offset_ns)
            crossing_time = self._prepared.rig.crossing_time
            if onset and not self.sensor_checks.has_rate(monitor.estimator, crossing_time):
                onset = None
        if onset is not None:
            if isinstance(rig_state, OngoingThrow):
                self._end_throw(step, rig_state, 'next')
            self._commit(step)
            if self._staged.config.is_measured:
                self._begin_throw(step, onset)
                assert self.monitor is not None
                motion, _ = self.monitor.advance(now_ns)  # since the start of the throw
            elif self.monitor is not None:  # the change that took effect ends the measurement
                self._put_back(step)
        elif isinstance(rig_state, Returning) and monitor.is_armed:
            self._enter(AtRest(), Phase.REST)
        return motion
