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
"""The cycle of a rig: it rests, throws, is put back, and rests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

import numpy as np
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.journal import JournalWriter
from soft_throw_ros.twin.measured_throw import MeasuredThrow
from soft_throw_ros.twin.onset import Onset
from soft_throw_ros.twin.plate_estimator import NO_STATES, PlateStates, Sample
from soft_throw_ros.twin.plate_monitor import PlateMonitor, SampleCounts
from soft_throw_ros.twin.prepared_rig import FIELD_POINTS, PreparedRig
from soft_throw_ros.twin.results import (
    LayerState,
    Outputs,
    Phase,
    State,
    ThrowField,
    ThrowResult,
)
from soft_throw_ros.twin.staged_settings import StagedSettings
from soft_throw_ros.twin.throws import OngoingThrow, ScheduledThrow, ThrowStep, time_until_over
from soft_throw_ros.twin.tick_schedule import TickSchedule

_PHASES = {'release': Phase.FLIGHT, 'recontact': Phase.CONTACT, 'landing': Phase.LANDED}


def between(origin: State, goal: State, part: float, duration: float) -> State:
    """
    Return a part of the way from standing still to standing still with the least jerk [1]_.

    Plate and projectile do not run into each other, since both go the same part of their way at a
    time. Forces are zero, since the layer is left out.

    References
    ----------
    .. [1] Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985) 1688.

    """
    mixture = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    speed = 30.0 * (part * (1.0 - part)) ** 2 / duration
    plate = goal.plate_position - origin.plate_position
    projectile = goal.projectile_position - origin.projectile_position
    return State(
        plate_position=origin.plate_position + mixture * plate,
        projectile_position=origin.projectile_position + mixture * projectile,
        plate_velocity=speed * plate,
        projectile_velocity=speed * projectile,
        plate_force=0.0,
        projectile_force=0.0,
    )


class ThrowCycle:
    """
    What the rig does at every step, from the first one on, at which it is at rest.

    Notes
    -----
    A throw starts when it is due by `throw.period`, counted from the last start, or when asked
    for. It is over when the projectile is at rest, after `throw.max_events` contacts, when the
    period leaves just the time to put things back, or after `throws.LONGEST_THROW`. Then plate
    and projectile are put back, see `between`: positions are continuous.

    What is staged takes effect whenever things are put back: after a throw, at a reset, or, if
    the rig is at rest, before the next throw, which starts so much later.

    If the plate is measured, a throw starts when that jumps up after a rest, whatever the period,
    and is over, besides, when nothing is known of the plate for longer than a wave needs to cross
    the layer, or when it jumps again. What is staged then takes effect with the throw. In between
    plate and projectile are where the plate was measured last.

    """

    def __init__(self, staged: StagedSettings, writer: JournalWriter, *, step: int) -> None:
        self.throws = 0  # that have started
        self.schedule = TickSchedule(step=step, time_ns=0, rate=staged.config.state_rate)
        self.sample_counts = SampleCounts()
        self.monitor: PlateMonitor | None = None
        self._staged = staged
        self._journal = writer
        self._phase = Phase.REST
        self._state = staged.prepared.rest
        self._throw: OngoingThrow | None = None
        self._start = step  # what the period and the time of a throw are counted from
        self._throw_due = math.inf  # by the period
        self._latest_end = math.inf  # of a throw, before the next one is due
        self._throw_requested_at = math.inf
        self._return = (step, step, self._state)  # from a step to a step, and from where
        self._layer_start, self._layer_row = step, -1
        self._phases: tuple[Phase, ...] = (Phase.REST,)
        self._results: tuple[ThrowResult, ...] = ()
        self._throw_field: ThrowField | None = None
        self._notices: tuple[str, ...] = ()
        self._onset: Onset | None = None  # which is to begin a throw, if a journal says so
        self._start_monitoring()
        self.set_throw_due()

    @property
    def _prepared(self) -> PreparedRig:
        return self._staged.prepared

    def resume(self, step: int, entry: journal.Entry) -> None:
        """Have the throw of an entry of a journal begin at its step, whatever was before."""
        self.throws = entry['throw'] - 1
        self._throw_requested_at = step
        self._phase = Phase.RETURNING  # until this very step, so that nothing delays it
        self._phases = ()
        if 'schedule' in entry:
            self.schedule = journal.decode_schedule(entry['schedule'])
        if self.monitor is not None:
            self._onset = journal.decode_onset(entry.get('onset', {}))

    def request_throw(self, step: int) -> Callable[[], str] | None:
        """
        Have a throw start; or return what says why not, and how long it is until one can.

        To find that out may take as long as a throw takes to compute.
        """
        if self._phase is Phase.REST:
            if self._throw_requested_at < math.inf:
                return lambda: f'throw {self.throws + 1} is about to start'
            self._throw_requested_at = step
            return None
        prepared, throw, config = self._prepared, self._throw, self._staged.config
        elapsed = (step - self._start) * prepared.tick
        longest = (self._return[1] if throw is None else self._throw_due) - step

        def refusal() -> str:
            reason, ticks = 'the rig is being put back', max(longest, 0)
            if throw is not None:
                left = time_until_over(prepared, elapsed, max_events=config.max_events)
                returning = prepared.return_ticks(config.throw_period)
                reason = f'throw {throw.number} is under way'
                ticks = min(left / prepared.tick + returning, longest)
            return f'{reason}: ready in {ticks / config.state_rate:.2f} s'

        return refusal

    def reset(self, step: int) -> None:
        """Break off a throw under way, put things back, and count the period from here."""
        if self._throw is not None:
            self._end_throw(step, self._throw, 'reset')
        else:
            self._put_back(step)
        self._throw_requested_at = math.inf
        self._start = step
        self.set_throw_due()

    def take(self, step: int, samples: Sequence[Sample]) -> list[Sample]:
        """Take samples of the rig if the plate is measured; return those not refused."""
        if self.monitor is None:
            return []
        return self.monitor.take(samples, self.schedule.deadline(step))

    def advance(self, step: int) -> Outputs:
        """Go one step on."""
        motion = NO_STATES
        if self.monitor is not None:
            motion = self._watch_plate(step, self.monitor)
        elif self._phase in (Phase.REST, Phase.RETURNING):
            self._begin_throw_if_due(step)
        advanced = self._advance_throw(step, motion)
        outputs = Outputs(
            step,
            self.throws,
            self._state,
            self._phases,
            () if advanced is None else advanced.events,
            self._results,
            self._layer(step),
            self._throw_field,
            None if advanced is None else advanced.prediction,
            None if advanced is None else advanced.residual,
            self._notices,
        )
        self._phases = self._results = self._notices = ()
        self._throw_field = None
        return outputs

    def _begin_throw_if_due(self, step: int) -> None:
        """Start a throw, or put things back before it if changes wait."""
        has_returned = self._phase is Phase.RETURNING
        if has_returned and step < self._return[1]:
            return
        if step < min(self._throw_requested_at, self._throw_due):
            if has_returned:
                self._enter(Phase.REST)
        elif has_returned or not self._staged.pending:
            self._begin_throw(step)
        else:
            self._put_back(step)

    def _begin_throw(self, step: int, onset: Onset | None = None) -> None:
        self.throws += 1
        self._throw_requested_at = math.inf
        self._start = step
        self._layer_start, self._layer_row = step, -1
        self.set_throw_due()
        self._journal.begin(
            'throw',
            step,
            self._staged.settings,
            throw=self.throws,
            pending=self._staged.pending,
            schedule=journal.encode_schedule(self.schedule),
            **({} if onset is None else {'onset': journal.encode_onset(onset)}),
        )
        if onset is None:
            self._throw = ScheduledThrow(
                self._prepared,
                number=self.throws,
                start_step=step,
                start_ns=self.schedule.deadline(step),
            )
        else:
            self._start_monitoring(onset)
            assert self.monitor is not None
            self._throw = MeasuredThrow(
                self._prepared, onset, self.monitor.estimator, number=self.throws
            )
        self._enter(Phase.CONTACT)

    def _advance_throw(self, step: int, motion: PlateStates) -> ThrowStep | None:
        """Bring the state to a step; return what the throw under way gives, if there is one."""
        throw, config = self._throw, self._staged.config
        if throw is None:
            self._state = self._idle_state(step)
            return None
        had_left = bool(throw.events)
        advanced = throw.advance(step, self.schedule.deadline(step), motion, config)
        if self.monitor is not None:
            self.monitor.trusts_engine = throw.engine_holds
        self._state = advanced.state
        for event in advanced.events:
            self._enter(_PHASES[event.kind])
        if advanced.forecast is not None:
            self._report(step, advanced.forecast)
        if throw.events and not had_left:
            self._report(step, throw.result('release', step, config))
        if throw.ended_by or step >= self._latest_end:
            self._end_throw(step, throw, throw.ended_by or 'period')
        else:
            self._throw_field = throw.throw_field()
        return advanced

    def _idle_state(self, step: int) -> State:
        """Return where plate and projectile are between throws."""
        prepared = self._prepared
        if self.monitor is not None:
            return self.monitor.state(prepared.rest)
        if self._phase is Phase.RETURNING:
            begin, end, origin = self._return
            part = (step - begin) / (end - begin)
            return between(origin, prepared.rest, part, (end - begin) * prepared.tick)
        return prepared.rest

    def _end_throw(self, step: int, throw: OngoingThrow, ended_by: str) -> None:
        throw.ended_by = ended_by
        self._report(step, throw.result('final', step, self._staged.config))
        self._throw_field = throw.throw_field()
        self._throw = None
        self._put_back(step)

    def _put_back(self, step: int) -> None:
        """Begin the way back to rest, with whatever has waited in effect."""
        self._commit(step)
        config = self._staged.config
        if not config.is_measured:
            ticks = self._prepared.return_ticks(config.throw_period)
            self._return = (step, step + ticks, self._state)
        self._start_monitoring()
        self._layer_start, self._layer_row = step, -1
        self._enter(Phase.RETURNING)

    def _commit(self, step: int) -> None:
        """Put in effect what has waited; the period goes on as long as it was for the rig."""
        if not self._staged.pending:
            return
        passed = (step - self._start) * self._prepared.tick
        self._staged.commit()
        self._start = step - round(passed / self._prepared.tick)
        self.set_throw_due()

    def set_throw_due(self) -> None:
        """Find when the next throw is due by the period."""
        period, prepared = self._staged.config.throw_period, self._prepared
        self._throw_due = self._latest_end = math.inf
        if period and not self._staged.config.is_measured:
            self._throw_due = self._start + prepared.period_ticks(period)
            self._latest_end = self._throw_due - prepared.return_ticks(period)

    def _layer(self, step: int) -> LayerState | None:
        """Return the layer, if `rate.field` has it due."""
        config = self._staged.config
        row = int((step - self._layer_start) * config.field_rate // config.state_rate)
        if row == self._layer_row:
            return None
        self._layer_row = row
        if self._phase is Phase.REST:
            return self._prepared.rest_layer
        if self._throw is None:
            return self._idle_layer()
        return self._throw.layer

    def _idle_layer(self) -> LayerState:
        """Return the layer lying on the plate, without force, between throws."""
        rest, height, state = self._prepared.rest, self._prepared.rest_layer.height, self._state
        room = state.projectile_position - state.plate_position
        part = min(1.0, room / (rest.projectile_position - rest.plate_position))
        return LayerState(
            state.plate_position + part * (height - rest.plate_position),
            np.full(FIELD_POINTS, state.plate_velocity),
            np.zeros(FIELD_POINTS),
        )

    def _enter(self, phase: Phase) -> None:
        self._phase = phase
        self._phases += (phase,)

    def _report(self, step: int, result: ThrowResult) -> None:
        self._results += (result,)
        self._journal.write_result(step, result)

    def _start_monitoring(self, onset: Onset | None = None) -> None:
        """Wait for the next jump of the plate, if it is measured."""
        config = self._staged.config
        if not config.is_measured:
            self.monitor = None
            return
        self._throw_requested_at = math.inf
        if self.monitor is None or onset is not None:
            self.monitor = PlateMonitor(config.measurement, self.sample_counts, onset)
        else:
            self.monitor.rearm(config.measurement)

    def _watch_plate(self, step: int, monitor: PlateMonitor) -> PlateStates:
        """See how the plate moves, and start a throw when it jumps up."""
        now_ns = self.schedule.deadline(step)
        onset, self._onset = self._onset, None
        motion = NO_STATES
        if onset is None:
            motion, onset = monitor.advance(now_ns)
            self._notices += monitor.problems()
            if onset is not None and not self._is_fast_enough(monitor):
                onset = None
        if onset is not None:
            if self._throw is not None:
                self._end_throw(step, self._throw, 'next')
            self._commit(step)
            if self._staged.config.is_measured:
                self._begin_throw(step, onset)
                assert self.monitor is not None
                motion, _ = self.monitor.advance(now_ns)  # since the start of the throw
            elif self.monitor is not None:  # from now on it is not measured
                self._put_back(step)
        elif self._phase is Phase.RETURNING and monitor.is_armed:
            self._enter(Phase.REST)
            self._is_fast_enough(monitor)
        elif self._throw is None and not motion.times.size and monitor.is_blind():
            self._is_fast_enough(monitor)
        return motion

    def _is_fast_enough(self, monitor: PlateMonitor) -> bool:
        """Tell whether there are enough samples, and if not, say so."""
        rate_warning = monitor.rate_warning(self._prepared.rig.crossing_time)
        if rate_warning:
            self._notices += (rate_warning,)
        return not rate_warning
