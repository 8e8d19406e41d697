# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A throw of a measured plate, with states and predictions of the model ahead of the rig.

A wave needs a crossing time from the plate to the projectile. Therefore the motion of the
projectile is known for a crossing time longer than the motion of the plate: a fork of the stepper
advances with any continuation of the plate's motion (see `Stepper.sync_from`).
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
from dataclasses import dataclass, field
from functools import partial
import math
from typing import TypeAlias

import numpy as np
from soft_throw_ros.core.plate_kernels import MAX_PIECES_AHEAD
from soft_throw_ros.core.stepper import (
    Event,
    EventLimitError,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    Stepper,
    TIME,
)
from soft_throw_ros.twin.engine_fit import EngineEstimate
from soft_throw_ros.twin.plate_estimator import Onset, PAST, PlateEstimator, PlateStates
from soft_throw_ros.twin.plate_source import MeasuredPlate, SmoothedSamples
from soft_throw_ros.twin.prepared_rig import (
    ForkedStepper,
    layer_of,
    PreparedRig,
    stepper_of,
    THROW_FIELD_LENGTH,
    throw_field_of,
)
from soft_throw_ros.twin.results import (
    Accuracy,
    Comparison,
    Disturbances,
    LayerState,
    Outputs,
    PredictedState,
    Residual,
    State,
    ThrowField,
    ThrowResult,
)
from soft_throw_ros.twin.throws import OngoingThrow, Tick
from soft_throw_ros.twin.tick_schedule import SECOND

PlateSource: TypeAlias = EngineEstimate | SmoothedSamples
"""Source of the states of a plate, with a time `start_ns` and a method `states`."""

_PREDICTION_ERROR = 0.01
"""
Largest half width of the 95 % interval of the ejection speed in the first prediction of a throw,
over the speed. [-]
"""

LOST = PAST
"""Time without samples after which the plate is lost, because later ones are too old. [ns]"""

FEWEST_IN_FLIGHT = 8
"""Fewest samples of the projectile in flight that give the errors of the release. [-]"""

MEASURED_REST_SPEED = 0.5
"""Largest speed at rest, over the speed of a start. [-]"""

_SKIPPED = 0.5
"""Delay between two steps that shows that steps have been skipped, in steps. [-]"""


class _Simulation:
    """A simulation of the throw from its start, by one source of the plate's motion."""

    def __init__(self, forked: ForkedStepper, source: PlateSource | None, start_ns: int) -> None:
        forked.stepper.reset()
        self.forked = forked
        self.source = source  # of the following states; None while the plate is unknown
        self.start_ns = start_ns  # of the throw [ns]
        # motion until the first release; None for the smoothed plate
        self.estimate = source if isinstance(source, EngineEstimate) else None
        self.times: list[float] = []  # of the states of the plate that the stepper knows
        self.states: list[list[float]] = []
        self._last = -1.0  # time of the last state [s]

    @property
    def time(self) -> float:
        """Time of the stepper since the start [s]."""
        return float(self.forked.stepper.state[TIME])

    @property
    def known(self) -> float:
        """Time since the start until which the plate is known [s]."""
        return max(self.forked.stepper.horizon, 0.0)

    def extend(self, complete_ns: float) -> None:
        """Append the states of the plate that have become known."""
        if self.source is None:
            return
        times, states = self.source.states(self._last, complete_ns)
        if not times.size:
            return
        self.forked.stepper.append_plate_states(times, states)
        self._last = float(times[-1])
        if len(self.times) + times.size < MAX_PIECES_AHEAD:
            self.times += times.tolist()
            self.states += states.tolist()


class MeasuredThrow(OngoingThrow):
    """
    A throw whose plate is measured, see `OngoingThrow`, by an estimator from the onset on.

    Until the release is certain, the throw is simulated with the fitted motion of the engine, and
    anew from its start when the fit has changed significantly. Afterwards, or as soon as the
    engine model fails, it is simulated with the smoothed samples alone.

    A new simulation advances by at most `PreparedRig.catch_up` in a step, beside the present one,
    and replaces that when it has caught up. Therefore the cost of a step does not depend on the
    length of the throw.
    """

    def __init__(
        self, prepared: PreparedRig, onset: Onset, estimator: PlateEstimator, *, number: int
    ) -> None:
        config = estimator.config
        self._plate = MeasuredPlate(onset, estimator, prepared.forecaster)
        self._present = _Simulation(prepared.forked_steppers[0], None, onset.onset_ns)
        self._newer: _Simulation | None = None  # one that has not caught up with the present one
        super().__init__(
            prepared,
            self._present.forked.stepper,
            number=number,
            rest_speed=MEASURED_REST_SPEED * config.start_speed,
        )
        self._residuals = _ResidualStatistics(
            last_ns=onset.onset_ns,
            longest=1.0 / prepared.rig.engine.frequency,
            threshold=config.residual_threshold,
            gravity=prepared.rig.gravity,
        )
        self._accuracy: Accuracy | None = None  # of the last prediction, or of the release
        self._lead: float | None = None  # of the first prediction [s]
        self._last_due_ns = 0  # time of the last step [ns]
        self._time_skipped = 0.0  # of skipped steps [s]
        if prepared.forecaster is not None:
            prepared.forecaster.reset()

    @property
    def engine_is_nominal(self) -> bool:
        """Whether the motion so far is that of the engine."""
        return not self._plate.fit.has_failed

    @property
    def layer(self) -> LayerState:
        """Return the present state of the layer."""
        return layer_of(self._present.forked.display)

    @property
    def _is_certain(self) -> bool:
        """Whether the plate cannot change the release any more."""
        return self._accuracy is not None and self._accuracy.is_certain

    @property
    def _is_lost_in_noise(self) -> bool:
        """Whether noise of the smoothed plate may have released the projectile."""
        return self._present.estimate is None and self._plate.is_noisy

    def advance(self, tick: Tick, motion: PlateStates) -> Outputs:
        """Advance as far as the plate is known, and predict from there."""
        plate, crossing = self._plate, self._prepared.rig.crossing_time
        if motion.gap > crossing or tick.due_ns - plate.estimator.newest_ns > LOST:
            self.ended_by = 'gap'
        else:
            plate.add(motion)
            self._choose_simulation()
        self._count_skipped_time(tick.due_ns)
        was_released = bool(self.events)
        known = self._present.known
        events, residual = self._follow_plate(known, tick.config.max_events)
        if plate.relies_on_engine and self.events:
            self._abandon_engine()  # the release is certain, and does not change
        if self.events and not was_released and self._is_lost_in_noise:
            self.ended_by, self.events, events = 'noise', [], ()
        prediction, forecast = self._predict_state(known, tick), self._forecast(known, tick)
        # a longer extrapolation has no meaning
        farthest = known + crossing + plate.estimator.config.smoothing_window
        now = (tick.due_ns - self._present.start_ns) / SECOND
        display = self._present.forked.display
        self._advance_fork(display, max(known, min(now, farthest)))
        state = State._make(display.state.tolist()[1:])
        return Outputs(
            tick.step,
            self.number,
            state,
            events=events,
            results=() if forecast is None else (forecast,),
            prediction=prediction,
            residual=residual,
        )

    def event_ns(self, event: Event, tick: Tick) -> int:  # noqa: ARG002
        """Return the time of an event by the stamps of the samples [ns]."""
        return self._present.start_ns + round(event.time * SECOND)

    def _choose_simulation(self) -> None:
        """Simulate the throw on, or anew, by the fitted engine or by smoothed samples."""
        plate, present, smoothed = self._plate, self._present, self._plate.smoothed
        if plate.relies_on_engine:
            newer = plate.newer_estimate(present.estimate) if self._newer is None else None
            if plate.fit.has_failed or (plate.is_fit_over and newer is None):
                self._abandon_engine()
            elif newer is not None:
                self._simulate_anew(newer)
        if not plate.relies_on_engine and present.source is not smoothed:
            # smoothed samples continue a known motion, or begin a simulation of their own
            is_known = present.source is not None and (self.events or not plate.fit.has_failed)
            if is_known and (plate.is_fit_over or not plate.is_noisy):
                smoothed.start_ns, present.source = present.start_ns, smoothed
            elif not is_known and not self._newer and smoothed.find_start():
                self._simulate_anew(smoothed)
        complete_ns = plate.estimator.complete_ns
        present.extend(complete_ns)
        if self._newer is not None:
            self._newer.extend(complete_ns)
            self._catch_up(self._newer)

    def _abandon_engine(self) -> None:
        self._plate.relies_on_engine, self._newer = False, None

    def _simulate_anew(self, source: PlateSource) -> None:
        """Begin a simulation by the forked stepper that the present one does not use."""
        one, other = self._prepared.forked_steppers
        spare = other if self._present.forked is one else one
        self._newer = _Simulation(spare, source, source.start_ns)

    def _catch_up(self, newer: _Simulation) -> None:
        """Advance a new simulation, and use it when it has caught up with the present one."""
        present = self._present
        now = present.time + (present.start_ns - newer.start_ns) / SECOND
        goal = min(max(now, 0.0), newer.known)
        self._try_to_advance(
            newer.forked.stepper,
            min(newer.time + self._prepared.catch_up, max(goal, newer.time)),
        )
        if newer.time >= goal or self.ended_by:
            self._present, self._newer = newer, None
            self._stepper, self.events = newer.forked.stepper, []

    def _count_skipped_time(self, due_ns: int) -> None:
        """Count the time of skipped steps."""
        late = (due_ns - self._last_due_ns) / SECOND - self._prepared.tick
        if self._last_due_ns and late > _SKIPPED * self._prepared.tick:
            self._time_skipped += late
        self._last_due_ns = due_ns

    def _follow_plate(
        self, known: float, max_events: int
    ) -> tuple[tuple[Event, ...], Residual | None]:
        """Advance as far as the plate is known, and compare with samples of the projectile."""
        rest, start_ns, residuals = self._plate.onset.rest, self._present.start_ns, self._residuals
        until_ns = start_ns + math.ceil(known * SECOND)
        happened: list[Event] = []
        residual = None
        samples = self._plate.estimator.samples(residuals.last_ns + 1, until_ns + 1)
        if residuals.is_complete:
            samples = samples[-2:]  # the last one may be too late
        for stamp_ns, plate, projectile in samples.tolist():
            time = (stamp_ns - start_ns) / SECOND
            if time > known:
                break
            residuals.last_ns = stamp_ns
            is_passed = time < self._stepper.state[TIME]  # it is late for the start
            if is_passed or math.isnan(projectile - rest.projectile):
                continue
            state, events = self._go_to(time, max_events)
            happened += events
            rise = state.projectile_position - self._prepared.rest.projectile_position
            residual = Residual(
                stamp_ns,
                state.plate_position - (plate - rest.plate),
                rise - (projectile - rest.projectile),
            )
            residuals.add(time, residual.projectile, self.events)
        _, events = self._go_to(known, max_events)
        return (*happened, *events), residual

    def _predict_state(self, known: float, tick: Tick) -> PredictedState:
        """Predict the projectile up to the time that the future plate cannot influence."""
        fork, ahead = self._present.forked.lookahead, known + self._prepared.rig.crossing_time
        self._advance_fork(fork, ahead)
        stamp_ns = self._present.start_ns + round(ahead * SECOND)
        return PredictedState(
            stamp_ns,
            float(fork.state[PROJECTILE_POSITION]),
            float(fork.state[PROJECTILE_VELOCITY]),
            float(fork.state[PROJECTILE_FORCE]),
            stamp_ns - tick.due_ns,
        )

    def _forecast(self, known: float, tick: Tick) -> ThrowResult | None:
        """Return the release when it is first known well enough, and when it is certain."""
        prepared, plate, present = self._prepared, self._plate, self._present
        is_fit_lost = present.estimate is not None and plate.fit.has_failed and not self.events
        if self._is_certain or is_fit_lost:
            return None
        fork = present.forked.lookahead
        release = fork.events()[0] if fork.event_count else None
        if release is not None and release.time <= known + prepared.rig.crossing_time:
            if self._is_lost_in_noise:
                self.ended_by = 'noise'
                return None
            return self._predict(fork, release, present.estimate, tick, is_certain=True)
        if not plate.relies_on_engine or plate.fit.estimate is None or self._lead is not None:
            return None
        early = plate.forecaster.find_release(
            plate.fit.estimate,
            max_error=_PREDICTION_ERROR,
            duration=prepared.catch_up,
        )
        if early is None:
            return None
        estimate, release = early
        return self._predict(plate.forecaster.stepper, release, estimate, tick, is_certain=False)

    def _predict(
        self,
        stepper: Stepper,
        release: Event,
        estimate: EngineEstimate | None,
        tick: Tick,
        *,
        is_certain: bool,
    ) -> ThrowResult:
        """Return the result at a release to come, by a stepper that has reached the release."""
        peak_speed = self._peak_speed(estimate)
        self._accuracy = self._assess_accuracy(
            release, estimate, peak_speed=peak_speed, is_certain=is_certain
        )
        lead = release.time - (tick.due_ns - self._start_of(estimate)) / SECOND
        self._lead = lead if self._lead is None else self._lead
        start_ns = self._start_of(estimate)
        result = self._make_result(
            'predicted', tick, stepper, [release],
            start_ns=start_ns, stamp_of=lambda event: start_ns + round(event.time * SECOND),
            peak_plate_speed=peak_speed,
        )
        return self._with_measurement(result, lead, None)

    def _start_of(self, estimate: EngineEstimate | None) -> int:
        """Return the start of a throw with the fitted or the smoothed motion [ns]."""
        return self._present.start_ns if estimate is None else estimate.start_ns

    def _peak_speed(self, estimate: EngineEstimate | None) -> float:
        """Return the largest speed of the plate, by the fit or by the smoothed samples [m/s]."""
        if estimate is not None:
            return estimate.plate.peak_velocity
        speeds = [speed for _, speed, _ in self._present.states]
        return self._plate.smoothed.peak_speed(self._present.times, speeds)

    def _assess_accuracy(
        self,
        release: Event,
        estimate: EngineEstimate | None,
        *,
        peak_speed: float,
        is_certain: bool,
    ) -> Accuracy:
        """Return the accuracy of a release, by an estimate if that was simulated."""
        plate, estimator = self._plate, self._plate.estimator
        errors = plate.release_errors(release.time, estimate, peak_speed)
        speed = release.velocity
        transfer = (speed / peak_speed) ** 2
        return Accuracy(
            basis='plate' if estimate is None else 'engine',
            is_certain=is_certain,
            release_time_error=errors.time,
            ejection_speed_error=errors.speed * abs(speed),
            energy_transfer_error=errors.energy_transfer * transfer,
            samples=len(estimator.samples(self._present.start_ns)) + estimator.outliers,
            samples_left_out=estimator.outliers + plate.fit.outliers,
        )

    def _try_to_advance(self, stepper: Stepper, time: float) -> None:
        """Advance a stepper to a time, or until its memory for events is full."""
        try:
            stepper.advance_to(time)
        except EventLimitError:
            self.ended_by = 'max_events'

    def _advance_fork(self, fork: Stepper, time: float) -> None:
        """Advance a fork of the present simulation to a time."""
        fork.sync_from(self._stepper)
        self._try_to_advance(fork, time)

    def result(self, stage: str, tick: Tick) -> ThrowResult:
        """Return the preliminary result."""
        release, estimate = self.first_release, self._present.estimate
        peak_speed = self._peak_speed(estimate)
        if stage == 'release' and release is not None:
            self._accuracy = self._assess_accuracy(
                release, estimate, peak_speed=peak_speed, is_certain=self._is_certain
            )
        result = self._make_result(
            stage, tick, self._stepper, self.events,
            start_ns=self._present.start_ns, stamp_of=partial(self.event_ns, tick=tick),
            peak_plate_speed=peak_speed,
        )
        return self._with_measurement(result, self._lead, self._residuals.compare(release))

    def _with_measurement(
        self, result: ThrowResult, lead: float | None, comparison: Comparison | None
    ) -> ThrowResult:
        """Add the faults of the measurement until now, and to a valid result its accuracy."""
        plate = self._plate
        disturbances = Disturbances(
            clock_offset_ns=plate.onset.clock_offset_ns,
            samples_missing=plate.estimator.missing_since(plate.onset.onset_ns),
            time_skipped=self._time_skipped,
        )
        if not result.is_valid:
            return dataclasses.replace(result, disturbances=disturbances)
        return dataclasses.replace(
            result,
            lead=lead,
            accuracy=self._accuracy,
            comparison=comparison,
            disturbances=disturbances,
        )

    def throw_field(self) -> ThrowField | None:
        """Return the layer over time once, when the plate is known for long enough or lost."""
        present, release = self._present, self.first_release
        if self._has_shown_field or not present.times or not (release or self.ended_by):
            return None  # the throw may end before the plate is known
        known = present.times[-1]
        length = THROW_FIELD_LENGTH * release.time if release else known
        if self._plate.relies_on_engine or (length > known and not self.ended_by):
            return None
        self._has_shown_field = True
        stepper = stepper_of(self._prepared.config)
        stepper.append_plate_states(present.times, present.states)
        length = min(length, stepper.horizon)
        return throw_field_of(stepper, length, start_ns=present.start_ns)


@dataclass(kw_only=True)
class _ResidualStatistics:
    """Statistics of the residuals of the projectile, until `longest` after the release."""

    last_ns: int  # time of the last sample that was compared [ns]
    longest: float  # [s]
    threshold: float  # of a normal rms residual [m]
    gravity: float  # [m/s2]
    is_complete: bool = False
    count: int = 0
    sum_of_squares: float = 0.0  # [m2]
    largest: float = 0.0  # [m]
    in_flight: list[tuple[float, float]] = field(default_factory=list)
    """Times since the release [s], and residuals [m]."""

    def add(self, time: float, difference: float, events: Sequence[Event]) -> None:
        """Add a residual at a time since the start, after the events until now."""
        since = time - events[0].time if events else 0.0
        if since > self.longest:
            self.is_complete = True
            return
        self.count += 1
        self.sum_of_squares += difference**2
        self.largest = max(self.largest, abs(difference))
        if len(events) == 1:  # they have not met again since the release
            self.in_flight.append((since, difference))

    def compare(self, release: Event | None) -> Comparison | None:
        """Return the statistics of the residuals; None if there are none."""
        if not self.count:
            return None
        comparison = Comparison(
            samples=self.count,
            position_rms=math.sqrt(self.sum_of_squares / self.count),
            position_max=self.largest,
            threshold=self.threshold,
        )
        is_enough = (
            len(self.in_flight) >= FEWEST_IN_FLIGHT
            and self.in_flight[-1][0] >= 0.5 * self.longest
        )
        if release is None or not is_enough:
            return comparison
        times, differences = np.array(self.in_flight).T
        # model and projectile fly freely, so that the residual is linear in time
        slope, offset = np.polyfit(times, differences, 1).tolist()
        later = -offset / release.velocity
        return dataclasses.replace(
            comparison,
            ejection_time_error=later,
            ejection_speed_error=slope - self.gravity * later,
        )
