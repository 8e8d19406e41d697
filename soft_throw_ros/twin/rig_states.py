# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The states of a rig in a session: at rest, in a throw, and returning to rest.

Before `advance` gives the outputs of the present step, `start_next` enters the next state if it is
due. `refusal` returns the reason to refuse a throw, or an empty text, and the step of its end.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import math
from typing import Any, TYPE_CHECKING, TypeAlias

import numpy as np
from soft_throw_ros.core.plate_kernels import MAX_PIECES_AHEAD
from soft_throw_ros.core.stepper import (
    Event,
    EventLimitError,
    PLATE_POSITION,
    PROJECTILE_POSITION,
    Stepper,
)
from soft_throw_ros.core.throw import apex_height, ejections
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.plate_monitor import PlateMonitor
from soft_throw_ros.twin.plate_observer import PlateObserver
from soft_throw_ros.twin.prepared_rig import (
    FIELD_POINTS,
    layer_of,
    MOST_SHARE,
    state_of,
    stepper_of,
    THROW_FIELD_LENGTH,
    throw_field_of,
)
from soft_throw_ros.twin.results import (
    Accuracy,
    Comparison,
    Floats,
    INVALID_ENDS,
    LayerState,
    Outputs,
    Phase,
    PhaseChange,
    PredictedState,
    Release,
    Residual,
    State,
    ThrowField,
    ThrowResult,
)
from soft_throw_ros.twin.sample_buffer import Onset, PAST

if TYPE_CHECKING:
    from soft_throw_ros.twin.session import Session

Path: TypeAlias = tuple[Floats, Floats]  # times and states of the plate

LONGEST_THROW = 10.0
"""Longest duration of a throw, which without gravity would never end. [s]"""

REST_SPEED = 1e-3
"""Largest speed at rest, over the largest speed of the plate. [-]"""

_PREDICTION_ERROR = 0.03
"""Largest relative standard error of the ejection speed in the first prediction. [-]"""

_LONGER = 1.3
"""Latest release that is predicted, over the ejection time with the expected motion. [-]"""

_NOISY = 0.05
"""Relative error of the speed of a certain release beyond which noise may have caused it. [-]"""

MEASURED_REST_SPEED = 0.5
"""Largest speed at rest, over the speed of a start. [-]"""

_PHASES = {'release': Phase.FLIGHT, 'recontact': Phase.CONTACT, 'landing': Phase.LANDED}


@dataclass
class AtRest:
    """Plate and projectile are at rest; the next throw starts when it is due or requested."""

    session: Session
    start_step: int | None = None  # of the next throw, whose motion is commanded already

    def start_next(self) -> None:
        """Start the next throw, or put back a rig with pending changes first."""
        session = self.session
        if self.start_step is not None:
            if session.step >= self.start_step:
                session.begin_throw()
        elif session.step >= session.next_start:
            if session.pending:
                session.put_back()
            else:
                session.command_plate()

    def advance(self, outputs: Outputs) -> None:
        """Output the rest, of a measured plate as it is measured."""
        rest, monitor = self.session.prepared.rest, self.session.monitor
        outputs.state = rest if monitor is None else monitor.state(rest)

    def layer(self) -> LayerState:
        """Return the layer at rest."""
        return self.session.prepared.rest_layer

    def refusal(self) -> tuple[str, float]:
        """Refuse another throw if one is about to start."""
        is_about_to_start = self.session.is_requested or self.start_step is not None
        reason = f'throw {self.session.throws + 1} is about to start'
        return reason if is_about_to_start else '', math.inf


@dataclass
class Returning:
    """
    Plate and projectile return to rest between two steps.

    A measured plate returns by itself: it is at rest when its monitor is armed.
    """

    session: Session
    begin: int
    end: int
    origin: State

    def start_next(self) -> None:
        """Start a throw that is due, or else rest."""
        session = self.session
        if session.step >= self.end:
            if session.step >= session.next_start:
                session.command_plate()
            else:
                session.enter(AtRest(session), Phase.REST)

    def advance(self, outputs: Outputs) -> None:
        """
        Output a point of the way to rest with the least jerk [1]_, or that of a measured plate.

        Plate and projectile have covered the same share of their ways at any time, so that they
        do not collide. Forces are zero, because the layer is left out.

        References
        ----------
        .. [1] Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985) 1688.

        """
        session, origin, goal = self.session, self.origin, self.session.prepared.rest
        if session.monitor is not None:
            outputs.state = session.monitor.state(goal)
            return
        ticks = self.end - self.begin
        time = (session.step - self.begin) / ticks  # over the duration
        share = time**3 * (10.0 - 15.0 * time + 6.0 * time**2)
        speed = 30.0 * (time * (1.0 - time)) ** 2 / (ticks * session.prepared.tick)
        plate, projectile = origin.plate_position, origin.projectile_position
        way, other = goal.plate_position - plate, goal.projectile_position - projectile
        outputs.state = State(
            plate + share * way, projectile + share * other, speed * way, speed * other, 0.0, 0.0
        )

    def layer(self) -> LayerState:
        """Return the layer lying on the plate without force."""
        prepared, state = self.session.prepared, self.session.outputs.state
        rest, gap = prepared.rest, state.projectile_position - state.plate_position
        scale = min(1.0, gap / (rest.projectile_position - rest.plate_position))
        height = prepared.rest_layer.height - rest.plate_position
        velocity = np.full(FIELD_POINTS, state.plate_velocity)
        return LayerState(state.plate_position + scale * height, velocity, 0.0 * velocity)

    def refusal(self) -> tuple[str, float]:
        """Refuse a throw until the rig is at rest."""
        return 'resetting the rig', self.end


class OngoingThrow(ABC):
    """
    A state of the rig: a throw from its start to its end, with its events and results.

    A throw ends at rest, or for another reason, see `ThrowResult`. Rest means contact, and speeds
    of plate and projectile below `rest_speed` [m/s] for the longer of their periods.
    """

    def __init__(self, session: Session, *, start_ns: int, rest_speed: float) -> None:
        session.prepared.stepper.reset()
        self.session = session
        self.number = session.throws
        self.start_ns = start_ns  # by the clock of the ticks [ns]
        self.ended_by = ''  # while it goes on
        self.events: list[Event] = []  # so far
        self._prepared = session.prepared
        self._stepper = session.prepared.stepper
        rig, self._rest_speed = session.prepared.rig, rest_speed
        self._settling_time = 1.0 / min(rig.engine.frequency, rig.natural_frequency)
        self._last_moving_time = 0.0  # since the start [s]
        self._has_shown_field = False

    def advance(self, outputs: Outputs) -> None:
        """Advance to the present step, and end the throw if it is over."""
        session, was_released = self.session, bool(self.events)
        self._advance(outputs)
        for event in outputs.events:
            outputs.phases.append(PhaseChange(_PHASES[event.kind], self._event_ns(event)))
        if self.events and not was_released:
            session.report(self._result('release'))
        returning = self._prepared.return_ticks(session.config.throw_period)
        if self.ended_by or session.step >= session.next_start - returning:
            self.end(self.ended_by or 'period')
        else:
            outputs.throw_field = self._throw_field()

    def end(self, ended_by: str) -> None:
        """End the throw, and put the rig back."""
        self.ended_by = ended_by
        self.session.report(self._result('final'))
        self.session.outputs.throw_field = self._throw_field()
        self.session.put_back()

    def layer(self) -> LayerState:
        """Return the present state of the layer."""
        return layer_of(self._stepper)

    def refusal(self) -> tuple[str, float]:
        """Refuse another throw."""
        return f'throw {self.number} is under way', self.session.due

    @abstractmethod
    def _advance(self, outputs: Outputs) -> None:
        """Advance to the present step; end the throw by `ended_by`."""

    @abstractmethod
    def _throw_field(self) -> Callable[[], ThrowField] | None:
        """Return the layer over time once, when it is known for long enough or the throw ends."""

    @abstractmethod
    def _event_ns(self, event: Event) -> int:
        """Return the time of an event, by the clock of the ticks [ns]."""

    @abstractmethod
    def _peak_plate_speed(self, release: Event | None) -> float:
        """Return the largest speed of the plate, until the first release if it is known [m/s]."""

    def _go_to(self, time: float) -> tuple[State, list[Event]]:
        """Advance to a time after the start; return the state and the new events."""
        stepper, seen = self._stepper, len(self.events)
        count = self._try_to_advance(stepper, time)
        state = state_of(stepper)
        if max(abs(state.plate_velocity), abs(state.projectile_velocity)) > self._rest_speed:
            self._last_moving_time = time
        if count > seen:
            self.events = stepper.events()
            contacts = sum(event.kind != 'release' for event in self.events)
            if contacts >= self.session.config.max_events:
                self.ended_by = 'max_events'
        if time > LONGEST_THROW:
            self.ended_by = 'duration'
        elif time - self._last_moving_time > self._settling_time and stepper.in_contact:
            self.ended_by = 'rest'
        return state, self.events[seen:]

    def _try_to_advance(self, stepper: Stepper, time: float) -> int:
        """Advance a stepper to a time; return its number of events, 0 if that is too large."""
        try:
            return stepper.advance_to(time)
        except EventLimitError:
            self.ended_by = 'max_events'
            return 0

    def _result(self, stage: str, fork: Stepper | None = None) -> ThrowResult:
        """Return the result so far, or by a fork; an invalid throw has no events."""
        stepper, events = fork or self._stepper, fork.events()[:1] if fork else self.events
        rig, loads = self._prepared.rig, stepper.loads
        peak_speed = self._peak_plate_speed(events[0] if events else None)
        if self.ended_by in INVALID_ENDS:
            events = []
        ejected, kinds = ejections(events), [event.kind for event in events]
        releases = [
            Release(
                ejection_time=event.time,
                ejection_speed=event.velocity,
                energy_transfer=(event.velocity / peak_speed) ** 2,
                release_ns=self._event_ns(event),
            )
            for event in ejected
        ]
        first, rest = releases[0] if releases else None, self._prepared.rest
        return ThrowResult(
            throw=self.number,
            step=self.session.step,
            stage=stage,
            ended_by=self.ended_by,
            start_ns=self.start_ns,
            rig=rig,
            first=first,
            last=releases[-1] if releases else None,
            peak_plate_speed=peak_speed,
            peak_strain=loads.strain,
            max_strain=self.session.config.rig.layer.linear_range,
            peak_acceleration=loads.acceleration,
            peak_plate_force=loads.plate_force,
            plate_work=stepper.plate_work,
            apex_height=(
                apex_height(ejected[-1], rig.gravity) if ejected else rest.projectile_position
            ),
            recontacts=kinds.count('recontact'),
            landings=kinds.count('landing'),
            **self._measurement(stage, first, peak_speed),
        )

    def _measurement(
        self, _stage: str, _first: Release | None, _peak_speed: float
    ) -> dict[str, Any]:
        """Return the values of a result that a measured plate adds."""
        return {}


class ScheduledThrow(OngoingThrow):
    """A throw by the period or on request, see `OngoingThrow`."""

    def __init__(self, session: Session) -> None:
        rest_speed = REST_SPEED * session.prepared.peak_plate_speed
        super().__init__(session, start_ns=session.due_ns(session.step), rest_speed=rest_speed)
        self._start_step = session.step
        self._time = 0.0  # since the start [s]
        self._stamps: dict[Event, int] = {}  # of events, by the clock of the ticks [ns]

    def _advance(self, outputs: Outputs) -> None:
        self._time = (outputs.step - self._start_step) * self._prepared.tick
        outputs.state, outputs.events = self._go_to(self._time)

    def _event_ns(self, event: Event) -> int:
        # relative to the step, because steps may be skipped
        since = (self._time - event.time) / self._prepared.config.time_scale
        due_ns = self.session.due_ns(self.session.step)
        return self._stamps.setdefault(event, due_ns - round(since * SECOND))

    def _peak_plate_speed(self, release: Event | None) -> float:  # noqa: ARG002
        return self._prepared.peak_plate_speed

    def _throw_field(self) -> Callable[[], ThrowField] | None:
        field = self._prepared.throw_field
        if self._has_shown_field or field is None:
            return None
        if self._time < field.times[-1] and not self.ended_by:
            return None
        self._has_shown_field = True
        return partial(field._replace, start_ns=self.start_ns)


class MeasuredThrow(OngoingThrow):
    """
    A throw whose plate is measured, see `OngoingThrow`, by an observer from the onset on.

    The stepper follows the smoothed states that do not change any more. In each step a fork goes
    on from there (`Stepper.sync_from`), along the latest states and their continuation: to the
    present time, as far as the projectile is known, and until its release.
    """

    def __init__(self, session: Session, onset: Onset, monitor: PlateMonitor) -> None:
        prepared, config = session.prepared, monitor.buffer.config
        assert prepared.ahead is not None
        fork, response = prepared.ahead
        rest_speed = MEASURED_REST_SPEED * config.start_speed
        super().__init__(session, start_ns=onset.onset_ns, rest_speed=rest_speed)
        self._start_step = session.step
        self._fork, self._onset, self._monitor = fork, onset, monitor
        self._buffer = monitor.buffer
        self._observer = PlateObserver(config, onset, response)
        latest = _LONGER * response.release_time
        is_affordable = fork.cost * latest <= MOST_SHARE * prepared.tick
        self._latest_release = latest if is_affordable else 0.0  # predicted in a step [s]
        self._settled: list[Path] = []  # which do not change any more
        self._path: Path = np.empty(0), np.empty((0, 3))  # after these, with the continuation
        self._now = 0.0  # time of the displayed state [s]
        self._period = 1.0 / config.plate.frequency  # of the plate [s]
        self._peak_by = 1.1 * config.motion.peak_velocity_time  # has its largest speed [s]
        self._compared = 0.0  # until when the projectile has been compared [s]
        # times [s], and model minus projectile [m]
        self._differences = [(np.empty(0), np.empty(0))]
        self._is_certain = False  # the plate cannot change the release any more
        self._accuracy: Accuracy | None = None  # of the last prediction, or of the release
        self._lead: float | None = None  # of the first prediction [s]

    def layer(self) -> LayerState:
        """Return the present state of the layer."""
        self._fork.sync_from(self._stepper, *self._path)
        self._move_fork(self._now)
        return layer_of(self._fork)

    def _advance(self, outputs: Outputs) -> None:
        """Advance as far as the plate is known, and predict from there."""
        buffer, observer, fork = self._buffer, self._observer, self._fork
        due_ns, crossing = self.session.due_ns(outputs.step), self._prepared.rig.crossing_time
        if buffer.gap > crossing or due_ns - buffer.newest_ns > PAST:
            self.ended_by = 'gap'  # after `PAST`, missing samples would be refused
        elif outputs.step == self._start_step:  # whose tick has found the start
            outputs.state = self._monitor.state(self._prepared.rest)
            return
        else:
            observer.add(buffer.between(observer.next_ns, buffer.complete_ns + 1))
        known = observer.newest + crossing
        # a longer extrapolation has no meaning
        latest = known + buffer.config.smoothing_window
        now = min((due_ns - self.start_ns) / SECOND, latest)
        release_by = self._latest_release if self._lead is None else 0.0
        self._move_plate(max(now, known, release_by))
        horizon = self._stepper.horizon
        outputs.events, outputs.residual = self._follow_plate(horizon)
        self._now, ahead = max(now, horizon), max(known, horizon)
        fork.sync_from(self._stepper, *self._path)
        states = {time: self._move_fork(time) for time in sorted((self._now, ahead))}
        if not (self._is_certain or self.ended_by):
            if not fork.event_count and release_by > known:
                self._try_to_advance(fork, release_by)
            if fork.event_count:
                self._predict(fork.events(), known, due_ns)
        if self.ended_by == 'noise':
            self.events, outputs.events = [], []
        outputs.state = states[self._now]
        outputs.prediction = PredictedState(
            self.start_ns + round(ahead * SECOND), *states[ahead][1::2]  # of the projectile
        )

    def _move_plate(self, until: float) -> None:
        """Append the states of the plate that do not change any more, and store the others."""
        times, states, settled = self._observer.motion(until)
        self._path = times[settled:], states[settled:]
        if settled:
            times, states = times[:settled], states[:settled]
            self._stepper.append_plate_states(times, states)
            if not self._has_shown_field:
                self._settled.append((times, states))

    def _move_fork(self, time: float) -> State:
        """Advance the fork to a time, along the latest states of the plate."""
        self._try_to_advance(self._fork, time)
        return state_of(self._fork)

    def _event_ns(self, event: Event) -> int:
        """Return the time of an event by the stamps of the samples [ns]."""
        return self.start_ns + round(event.time * SECOND)

    def _follow_plate(self, known: float) -> tuple[list[Event], Residual | None]:
        """Advance as far as the plate is known; compare until a period after the release."""
        rest, stepper, begin = self._onset.rest, self._stepper, self._compared
        if self.events and begin > self.events[0].time + self._period:
            return self._go_to(known)[1], None
        self._compared = known
        begin_ns, end_ns = (self.start_ns + math.floor(t * SECOND) + 1 for t in (begin, known))
        samples = self._buffer.between(begin_ns, end_ns)
        samples = samples[np.isfinite(samples.projectile)]
        times = samples.seconds_since(self.start_ns)
        modelled = np.empty((len(samples), 2))
        for n, time in enumerate(times.tolist()):
            self._try_to_advance(stepper, min(time, known))
            modelled[n] = stepper.state[PLATE_POSITION:PROJECTILE_POSITION + 1]
        _, events = self._go_to(known)
        if not samples:
            return events, None
        modelled[:, 1] -= self._prepared.rest.projectile_position
        differences = modelled - (samples.heights - (rest.plate, rest.projectile))
        self._differences.append((times, differences[:, 1]))
        return events, Residual(int(samples.stamps[-1]), *differences[-1].tolist())

    def _predict(self, events: list[Event], known: float, due_ns: int) -> None:
        """Report the release when it is first known well enough, and when it is certain."""
        release, (speed_error, time_error, _) = events[0], self._observer.errors()
        relative_error, in_doubt = speed_error / abs(release.velocity), release.time + time_error
        self._is_certain = in_doubt <= known
        is_brief = any(event.time < in_doubt for event in events[1:])
        if self._is_certain and (is_brief or relative_error > _NOISY):
            self.ended_by = 'noise'
        elif self._is_certain or (self._lead is None and relative_error <= _PREDICTION_ERROR):
            if self._lead is None:
                self._lead = release.time - (due_ns - self.start_ns) / SECOND
            self.session.report(self._result('predicted', self._fork))

    def _peak_plate_speed(self, release: Event | None) -> float:
        """Return the largest speed of the plate until both its peak and the release [m/s]."""
        times, states = _joined([*self._settled, self._path])
        is_early = times <= max(self._peak_by, release.time if release else 0.0)
        _, speeds, accelerations = states[is_early].T
        gain, loss = accelerations[:-1].clip(1e-9), (-accelerations[1:]).clip(0.0)
        between = speeds[:-1] + 0.5 * np.diff(times[is_early]) * gain**2 / (gain + loss)
        fastest = max(speeds.max(initial=0.0), between.max(initial=0.0))
        return max(float(fastest), self._buffer.config.start_speed)

    def _measurement(
        self, stage: str, first: Release | None, peak_speed: float
    ) -> dict[str, Any]:
        buffer = self._buffer
        if first and stage != 'final':
            speed_error, time_error, peak_error = self._observer.errors()
            # errors of both speeds count as independent, as an unexpected motion makes them
            relative_error = 2.0 * math.hypot(
                speed_error / first.ejection_speed, peak_error / peak_speed
            )
            self._accuracy = Accuracy(
                is_certain=self._is_certain,
                release_time_error=time_error,
                ejection_speed_error=speed_error,
                energy_transfer_error=relative_error * first.energy_transfer,
                samples=len(buffer.between(self.start_ns)) + buffer.outliers,
                samples_left_out=buffer.outliers,
            )
        values = {'clock_offset_ns': self._onset.clock_offset_ns}
        if self.ended_by in INVALID_ENDS:
            return values
        comparison = None if stage == 'predicted' else self._compare()
        return {
            **values, 'lead': self._lead, 'accuracy': self._accuracy, 'comparison': comparison
        }

    def _compare(self) -> Comparison | None:
        """Compare the throw with the samples of the projectile; None if there are none."""
        times, differences = _joined(self._differences)
        until = self.events[0].time + self._period if self.events else math.inf
        counted = differences[times <= until]
        if not counted.size:
            return None
        return Comparison(
            samples=counted.size,
            position_rms=math.sqrt(np.square(counted).mean()),
            position_max=float(np.abs(counted).max()),
            threshold=self._buffer.config.residual_threshold,
        )

    def _throw_field(self) -> Callable[[], ThrowField] | None:
        """Return the layer over time once, when the plate is known for long enough or lost."""
        release, known = self.events[0] if self.events else None, self._stepper.horizon
        if self._has_shown_field or known <= 0.0 or not (release or self.ended_by):
            return None  # the throw may end before the plate is known
        length = THROW_FIELD_LENGTH * release.time if release else known
        if max(length, self._peak_by) > known and not self.ended_by:
            return None
        self._has_shown_field = True
        config, start_ns = self._prepared.config, self.start_ns
        times, states = _joined(self._settled)

        def throw_field() -> ThrowField:
            stepper, shown = stepper_of(config), slice(MAX_PIECES_AHEAD)
            stepper.append_plate_states(times[shown], states[shown])
            return throw_field_of(stepper, min(length, stepper.horizon), start_ns=start_ns)

        return throw_field


def _joined(parts: list[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Join the arrays of all parts."""
    first, second = map(np.concatenate, zip(*parts, strict=True))
    return first, second


RigState: TypeAlias = AtRest | OngoingThrow | Returning
