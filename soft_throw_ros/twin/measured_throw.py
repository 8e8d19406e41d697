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
"""
A throw of a measured plate, with states and predictions of the model ahead of the rig.

A wave needs a crossing time from the plate to the projectile. Therefore the motion of the
projectile is known for a crossing time longer than the motion of the plate: a fork of the stepper
advances with any continuation of the plate's motion (see `Stepper.sync_from`).
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math

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
from soft_throw_ros.twin.engine_forecast import EngineForecaster, ReleaseErrors, TWO_SIDED
from soft_throw_ros.twin.onset import Onset
from soft_throw_ros.twin.plate_estimator import PAST, PlateEstimator, PlateStates
from soft_throw_ros.twin.plate_source import FittedEngine, PlateSource, SmoothedSamples
from soft_throw_ros.twin.prepared_rig import (
    PreparedRig,
    stepper_of,
    THROW_FIELD_LENGTH,
    throw_field_of,
    Track,
)
from soft_throw_ros.twin.results import (
    Accuracy,
    Comparison,
    Disturbances,
    PredictedState,
    Residual,
    State,
    ThrowField,
    ThrowResult,
)
from soft_throw_ros.twin.throws import OngoingThrow, ThrowStep, Tick
from soft_throw_ros.twin.tick_schedule import SECOND

LOST = PAST
"""Time without samples after which the plate is lost, because later ones are too old. [ns]"""

FEWEST_IN_FLIGHT = 8
"""Fewest samples of the projectile in flight that give the errors of the release. [-]"""

MEASURED_REST_SPEED = 0.5
"""Largest speed at rest, over the speed of a start. [-]"""

_SIGNIFICANT_CHANGE = 0.1
"""Change of a release that starts a new simulation of the throw, in standard errors. [-]"""

_SKIPPED = 0.5
"""Delay between two steps that shows that steps have been skipped, in steps. [-]"""


class _Run:
    """A simulation of the throw from its start, by one source of the plate's motion."""

    def __init__(self, track: Track, source: PlateSource | None, start_ns: int) -> None:
        track.stepper.reset()
        self.track = track
        self.source = source  # of the following states; None while the plate is unknown
        self.start_ns = start_ns  # of the throw [ns]
        # motion until the first release; None for the smoothed plate
        self.estimate = source.estimate if isinstance(source, FittedEngine) else None
        self.times: list[float] = []  # of the states of the plate that the stepper knows
        self.states: list[list[float]] = []
        self._last = -1.0  # time of the last state [s]

    @property
    def time(self) -> float:
        """Time of the stepper since the start [s]."""
        return float(self.track.stepper.state[TIME])

    @property
    def known(self) -> float:
        """Time since the start until which the plate is known [s]."""
        return max(self.track.stepper.horizon, 0.0)

    def extend(self, complete_ns: float) -> None:
        """Append the states of the plate that have become known."""
        if self.source is None:
            return
        times, states = self.source.states(self._last, complete_ns)
        if not times.size:
            return
        self.track.stepper.append_plate_states(times, states)
        self._last = float(times[-1])
        if len(self.times) + times.size < MAX_PIECES_AHEAD:
            self.times += times.tolist()
            self.states += states.tolist()


class MeasuredThrow(OngoingThrow):
    """
    A throw whose plate is measured, see `OngoingThrow`, by an estimator from the onset on.

    Until the release is certain, the throw is simulated with the fitted motion of the engine, and
    anew from its start when the fit has changed by more than `_SIGNIFICANT_CHANGE`. Afterwards, or
    as soon as the engine model fails, it is simulated with the smoothed samples alone.

    A new simulation advances by at most `PreparedRig.catch_up` in a step, beside the present one,
    and replaces that when it has caught up. Therefore the cost of a step does not depend on the
    length of the throw.
    """

    def __init__(
        self, prepared: PreparedRig, onset: Onset, estimator: PlateEstimator, *, number: int
    ) -> None:
        config = estimator.config
        super().__init__(
            prepared,
            number=number,
            start_ns=onset.onset_ns,
            rest_speed=MEASURED_REST_SPEED * config.start_speed,
        )
        self._onset = onset
        self._estimator = estimator
        self._smoothed = SmoothedSamples(onset, estimator)
        self._fit = onset.engine_fit(config)
        self._fit_end_ns = onset.onset_ns + round(SECOND / prepared.rig.engine.frequency)
        self._relies_on_engine = onset.engine_is_nominal and prepared.forecaster is not None
        track, self._spare = prepared.tracks
        self._pursuit: _Run | None = None  # a new simulation that has not caught up
        self._use(_Run(track, None, onset.onset_ns))
        self._residuals = _Residuals(
            longest=1.0 / prepared.rig.engine.frequency,
            threshold=config.residual_threshold,
            gravity=prepared.rig.gravity,
        )
        self._compared_ns = onset.onset_ns
        self._forecast_by: EngineEstimate | None = None  # which the forecaster simulates
        self._is_certain = False  # whether the plate cannot change the release any more
        self._accuracy: Accuracy | None = None
        self._lead: float | None = None  # of the first prediction
        self._due_ns = 0  # time of the last step [ns]
        self._time_skipped = 0.0  # of skipped steps [s]

    @property
    def engine_is_nominal(self) -> bool:
        """Whether the motion so far is that of the engine."""
        return not self._fit.has_failed

    @property
    def stamp_error(self) -> float:
        """Estimated standard deviation of the stamps, 0 without an estimate [s]."""
        return self._onset.stamp_error if self._fit.has_failed else self._fit.stamp_error

    @property
    def _is_fitted(self) -> bool:
        """Whether the fit has failed, or has the samples of a period of the plate."""
        return self._fit.has_failed or self._estimator.complete_ns > self._fit_end_ns

    @property
    def _forecaster(self) -> EngineForecaster:
        assert self._prepared.forecaster is not None
        return self._prepared.forecaster

    def advance(self, tick: Tick, motion: PlateStates) -> ThrowStep:
        """Advance as far as the plate is known, and predict from there."""
        crossing, max_events = self._prepared.rig.crossing_time, tick.config.max_events
        if motion.gap > crossing or tick.due_ns - self._estimator.newest_ns > LOST:
            self.ended_by = 'gap'
        else:
            self._smoothed.add(motion)
            self._update_fit()
            self._choose_source()
        self._count_skipped_time(tick.due_ns)
        had_left = bool(self.events)
        known = self._run.known
        events, residual = self._follow_plate(known, max_events)
        if self._relies_on_engine and self.events:
            self._abandon_engine()  # the release is certain, and does not change
        if self.events and not had_left and self._is_lost_in_noise():
            self.ended_by, self.events, events = 'noise', [], ()
        prediction, forecast = self._predict_state(known, tick), self._forecast(known, tick)
        # a longer extrapolation has no meaning
        farthest = known + crossing + self._estimator.config.smoothing_window
        now = (tick.due_ns - self._start_ns) / SECOND
        self._advance_fork(self._display_fork, max(known, min(now, farthest)))
        state = State._make(self._display_fork.state.tolist()[1:])
        return ThrowStep(state, events, forecast, prediction, residual)

    def event_ns(self, event: Event, tick: Tick) -> int:  # noqa: ARG002
        """Return the time of an event by the stamps of the samples [ns]."""
        return self._start_ns + round(event.time * SECOND)

    def _update_fit(self) -> None:
        """Fit the engine's motion to the samples of a plate period; later ones may be at rest."""
        if not self._fit.has_failed:
            end_ns = min(self._estimator.complete_ns, self._fit_end_ns)
            rows = self._estimator.samples(self._fit.next_ns, end_ns + 1)
            if len(rows):
                self._fit.update(rows)
        self._smoothed.stamp_error = self.stamp_error

    def _choose_source(self) -> None:
        """Simulate the throw on, or anew, by the fitted engine or by smoothed samples."""
        run, smoothed, estimate = self._run, self._smoothed, self._fit.estimate
        if self._relies_on_engine:
            is_outdated = estimate is not None and self._is_outdated(run.estimate, estimate)
            if self._fit.has_failed or (self._is_fitted and not is_outdated):
                self._abandon_engine()
            elif estimate is not None and is_outdated:
                self._begin_pursuit(FittedEngine(estimate))
        if not self._relies_on_engine and run.source is not smoothed:
            is_known = run.source is not None and (self.events or not self._fit.has_failed)
            if is_known and (self._is_fitted or not smoothed.is_noisy):
                smoothed.start_ns, run.source = run.start_ns, smoothed
            elif not is_known and not self._pursuit and smoothed.find_start():
                self._begin_pursuit(smoothed)
        complete_ns = self._estimator.complete_ns
        run.extend(complete_ns)
        if self._pursuit is not None:
            self._pursuit.extend(complete_ns)
            self._pursue(self._pursuit)

    def _abandon_engine(self) -> None:
        self._relies_on_engine, self._pursuit = False, None

    def _is_lost_in_noise(self) -> bool:
        """Return whether noise of the smoothed plate may have released the projectile."""
        return self._run.estimate is None and self._smoothed.is_noisy

    def _count_skipped_time(self, due_ns: int) -> None:
        """Count the time of skipped steps."""
        late = (due_ns - self._due_ns) / SECOND - self._prepared.tick
        if self._due_ns and late > _SKIPPED * self._prepared.tick:
            self._time_skipped += late
        self._due_ns = due_ns

    def _is_outdated(self, simulated: EngineEstimate | None, latest: EngineEstimate) -> bool:
        """Return whether the release of the latest estimate differs from the simulated one."""
        if self._pursuit is not None or latest is simulated:
            return False
        if simulated is None:
            return True
        forecaster = self._forecaster
        pairs = zip(forecaster.change(simulated, latest), forecaster.errors(latest), strict=True)
        return any(abs(change) > _SIGNIFICANT_CHANGE * error for change, error in pairs)

    def _begin_pursuit(self, source: PlateSource) -> None:
        self._pursuit = _Run(self._spare, source, source.start_ns)

    def _pursue(self, pursuit: _Run) -> None:
        """Advance a new simulation, and use it when it has caught up with the present one."""
        run = self._run
        now = run.time + (run.start_ns - pursuit.start_ns) / SECOND
        goal = min(max(now, 0.0), pursuit.known)
        self._try_to_advance(
            pursuit.track.stepper,
            min(pursuit.time + self._prepared.catch_up, max(goal, pursuit.time)),
        )
        if pursuit.time >= goal or self.ended_by:
            self._pursuit, self._spare = None, run.track
            self._use(pursuit)

    def _use(self, run: _Run) -> None:
        """Switch to another simulation of the throw."""
        self._run = run
        self._start_ns = run.start_ns
        self._stepper, self._display_fork, self._lookahead_fork = run.track
        self.events = []

    def _follow_plate(
        self, known: float, max_events: int
    ) -> tuple[tuple[Event, ...], Residual | None]:
        """Advance as far as the plate is known, and compare with samples of the projectile."""
        rest = self._onset.rest
        until_ns = self._start_ns + math.ceil(known * SECOND)
        happened: list[Event] = []
        residual = None
        samples = self._estimator.samples(self._compared_ns + 1, until_ns + 1)
        if self._residuals.is_complete:
            samples = samples[-2:]  # the last one may be too late
        for stamp_ns, plate, _, projectile in samples.tolist():
            time = (stamp_ns - self._start_ns) / SECOND
            if time > known:
                break
            self._compared_ns = stamp_ns
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
            self._residuals.add(time, residual.projectile, self.events)
        _, events = self._go_to(known, max_events)
        return (*happened, *events), residual

    def _predict_state(self, known: float, tick: Tick) -> PredictedState:
        """Predict the projectile up to the time that the future plate cannot influence."""
        fork, ahead = self._lookahead_fork, known + self._prepared.lookahead
        self._advance_fork(fork, ahead)
        stamp_ns = self._start_ns + round(ahead * SECOND)
        return PredictedState(
            stamp_ns,
            float(fork.state[PROJECTILE_POSITION]),
            float(fork.state[PROJECTILE_VELOCITY]),
            float(fork.state[PROJECTILE_FORCE]),
            stamp_ns - tick.due_ns,
        )

    def _forecast(self, known: float, tick: Tick) -> ThrowResult | None:
        """Return the release when it is first known well enough, and when it is certain."""
        prepared, run, fork = self._prepared, self._run, self._lookahead_fork
        is_fit_lost = run.estimate is not None and self._fit.has_failed and not self.events
        if self._is_certain or is_fit_lost:
            return None
        release = fork.events()[0] if fork.event_count else None
        if release is not None and release.time <= known + prepared.release_lookahead:
            if self._is_lost_in_noise():
                self.ended_by = 'noise'
                return None
            self._is_certain = True
            return self._predict(fork, release, run.estimate, tick)
        if not self._relies_on_engine or self._fit.estimate is None or self._lead is not None:
            return None
        forecaster = self._forecaster
        if self._forecast_by is None:
            error = TWO_SIDED * forecaster.errors(self._fit.estimate).speed
            if error > self._estimator.config.prediction_error:
                return None
            self._forecast_by = self._fit.estimate
            forecaster.begin(self._fit.estimate)
        if not forecaster.advance(prepared.catch_up):
            return None
        estimate, self._forecast_by = self._forecast_by, None
        if not forecaster.stepper.event_count:
            return None  # the next estimate may have a release
        return self._predict(forecaster.stepper, forecaster.stepper.events()[0], estimate, tick)

    def _predict(
        self, stepper: Stepper, release: Event, estimate: EngineEstimate | None, tick: Tick
    ) -> ThrowResult:
        """Return the result at a release to come, by a stepper that has reached the release."""
        self._measure_peak_speed(estimate)
        self._accuracy = self._assess_accuracy(release, estimate)
        lead = release.time - (tick.due_ns - self._start_of(estimate)) / SECOND
        self._lead = lead if self._lead is None else self._lead
        result = self._make_result('predicted', tick, stepper, [release])
        return self._add_measurement(result, lead)

    def _start_of(self, estimate: EngineEstimate | None) -> int:
        """Return the start of a throw with the fitted or the smoothed motion [ns]."""
        return self._start_ns if estimate is None else estimate.start_ns

    def _assess_accuracy(self, release: Event, estimate: EngineEstimate | None) -> Accuracy:
        """Return the accuracy of a release, by an estimate if that was simulated."""
        estimator = self._estimator
        errors = self._release_errors(release, estimate)
        speed = release.velocity
        transfer = (speed / self._peak_plate_speed) ** 2
        return Accuracy(
            basis='plate' if estimate is None else 'engine',
            is_certain=self._is_certain,
            release_ns=self._start_of(estimate) + round(release.time * SECOND),
            release_time_error=errors.time,
            ejection_speed_error=errors.speed * abs(speed),
            energy_transfer_error=errors.energy_transfer * transfer,
            samples=len(estimator.samples(self._start_ns)) + estimator.outliers,
            samples_left_out=estimator.outliers + self._fit.outliers,
        )

    def _release_errors(self, release: Event, estimate: EngineEstimate | None) -> ReleaseErrors:
        """Return the standard errors of a release, see `_assess_accuracy`."""
        if estimate is None or self._fit.estimate is None:
            return self._smoothed.release_errors(release.time, self._peak_plate_speed)
        forecaster = self._forecaster
        changes = forecaster.change(estimate, self._fit.estimate)
        return ReleaseErrors(*map(math.hypot, forecaster.errors(self._fit.estimate), changes))

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

    def _measure_peak_speed(self, estimate: EngineEstimate | None) -> None:
        """Update the largest speed of the plate, from the fit or from the smoothed samples."""
        if estimate is not None:
            self._peak_plate_speed = estimate.plate.peak_velocity
        else:
            speeds = [speed for _, speed, _ in self._run.states]
            self._peak_plate_speed = self._smoothed.peak_speed(self._run.times, speeds)

    def result(self, stage: str, tick: Tick) -> ThrowResult:
        """Return the preliminary result."""
        release, estimate = self.first_release, self._run.estimate
        self._measure_peak_speed(estimate)
        if stage == 'release' and release is not None:
            self._accuracy = self._assess_accuracy(release, estimate)
        result = self._add_measurement(super().result(stage, tick), self._lead)
        if not result.is_valid:
            return result
        return dataclasses.replace(result, comparison=self._residuals.compare(release))

    def _add_measurement(self, result: ThrowResult, lead: float | None) -> ThrowResult:
        """Add the faults of the measurement until now, and if the result is valid its accuracy."""
        stamp_error = self.stamp_error
        if self.ended_by == 'noise' and not stamp_error:
            stamp_error = self._onset.stamp_scatter  # the only information on the stamps
        disturbances = Disturbances(
            stamp_error=stamp_error,
            samples_missing=self._estimator.missing_since(self._onset.onset_ns),
            time_skipped=self._time_skipped,
        )
        if not result.is_valid:
            return dataclasses.replace(result, disturbances=disturbances)
        return dataclasses.replace(
            result, lead=lead, accuracy=self._accuracy, disturbances=disturbances
        )

    def throw_field(self) -> ThrowField | None:
        """Return the layer over time once, when the plate is known for long enough or lost."""
        times = self._run.times
        if self._has_shown_field or not times:  # the throw may end before the plate is known
            return None
        release, known = self.first_release, times[-1]
        if not (release or self.ended_by):
            return None
        length = THROW_FIELD_LENGTH * release.time if release else known
        if self._relies_on_engine or (length > known and not self.ended_by):
            return None
        self._has_shown_field = True
        stepper = stepper_of(self._prepared.config)
        stepper.append_plate_states(times, self._run.states)
        return throw_field_of(stepper, min(length, stepper.horizon), start_ns=self._start_ns)


class _Residuals:
    """Residuals of the projectile's position, until a time `longest` after the release."""

    def __init__(self, *, longest: float, threshold: float, gravity: float) -> None:
        self.is_complete = False
        self._longest = longest
        self._threshold = threshold
        self._gravity = gravity
        self._count = 0
        self._sum = 0.0  # of squares
        self._largest = 0.0
        self._in_flight: list[tuple[float, float]] = []  # times since the release, residuals

    def add(self, time: float, difference: float, events: Sequence[Event]) -> None:
        """Add a residual at a time since the start, after the events until now."""
        since = time - events[0].time if events else 0.0
        if since > self._longest:
            self.is_complete = True
            return
        self._count += 1
        self._sum += difference**2
        self._largest = max(self._largest, abs(difference))
        if len(events) == 1:  # they have not met again since the release
            self._in_flight.append((since, difference))

    def compare(self, release: Event | None) -> Comparison | None:
        """Return the statistics of the residuals; None if there are none."""
        if not self._count:
            return None
        comparison = Comparison(
            samples=self._count,
            position_rms=math.sqrt(self._sum / self._count),
            position_max=self._largest,
            threshold=self._threshold,
        )
        is_enough = (
            len(self._in_flight) >= FEWEST_IN_FLIGHT
            and self._in_flight[-1][0] >= 0.5 * self._longest
        )
        if release is None or not is_enough:
            return comparison
        times, differences = np.array(self._in_flight).T
        # model and projectile fly freely, so that the residual is linear in time
        slope, offset = np.polyfit(times, differences, 1).tolist()
        later = -offset / release.velocity
        return dataclasses.replace(
            comparison,
            ejection_time_error=later,
            ejection_speed_error=slope - self._gravity * later,
        )
