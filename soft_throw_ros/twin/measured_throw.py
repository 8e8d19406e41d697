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
A throw of a measured plate: what the model says of it, ahead of the rig.

A wave needs a crossing time to get from the plate to the projectile. So what the projectile does
is known that much longer than what the plate does, by a fork of the stepper that goes ahead while
the plate, for all that it matters, goes on as it was (see `Stepper.sync_from`).
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math

import numpy as np
from soft_throw_ros.configuration.twin_config import TwinConfig
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
from soft_throw_ros.twin.engine_fit import EngineEstimate, EngineFit
from soft_throw_ros.twin.engine_forecast import ReleaseErrors, TWO_SIDED
from soft_throw_ros.twin.onset import find_start, first_states, Onset, peak_speed
from soft_throw_ros.twin.plate_estimator import (
    Floats,
    PAST,
    PlateEstimator,
    PlateStates,
    state_spacing_ns,
)
from soft_throw_ros.twin.prepared_rig import (
    FIELD_POINTS,
    PreparedRig,
    stepper_of,
    THROW_FIELD_LENGTH,
    THROW_FIELD_ROWS,
)
from soft_throw_ros.twin.results import (
    Accuracy,
    Comparison,
    PredictedState,
    Residual,
    State,
    ThrowField,
    ThrowResult,
)
from soft_throw_ros.twin.throws import OngoingThrow, ThrowStep
from soft_throw_ros.twin.tick_schedule import SECOND

LOST = PAST  # after so long without samples, what comes then is too old, and the plate lost [ns]
FEWEST_ALOFT = 8  # samples of the projectile in flight that tell its errors
# relative errors of a release by that of the smoothed velocity, as trials have them [-]
_TIME, _SPEED, _TRANSFER = 1.0, 0.4, 1.4
_APART = 0.99  # least distance of states that are joined, of those smoothed [-]
_FIRST_WINDOWS = 1.5  # after which it is found when a smoothed plate has started [-]
REST_SPEED = 0.5  # what is slower than this part of the speed of a start is at rest [-]


class MeasuredThrow(OngoingThrow):
    """
    A throw whose plate is measured, see `OngoingThrow`, by an estimator from the onset on.

    Until the release is certain, the plate is taken to have moved as the engine moves it, with
    what the samples tell of amplitude and start: the throw is followed once more from its start
    whenever they tell more. From then on, and before as soon as the plate does not do as the
    engine should, it moves as it is smoothed, which relies on nothing but samples.
    """

    def __init__(
        self, prepared: PreparedRig, onset: Onset, estimator: PlateEstimator, *, number: int
    ) -> None:
        config = estimator.config
        super().__init__(
            prepared,
            number=number,
            start_ns=onset.onset_ns,
            rest_speed=REST_SPEED * config.start_speed,
        )
        self._onset = onset
        self._estimator = estimator
        self._shown, self._far_fork = prepared.forks
        self._smoothed = SmoothedPlate(onset, estimator)
        self._fit: EngineFit | None = onset.rest.engine_fit(config, onset.onset_ns)
        self._follows_engine = onset.trusts_engine and prepared.forecaster is not None
        self._estimate: EngineEstimate | None = None  # by which the plate is followed
        self._times: list[float] = []  # since the start: what the stepper knows of the plate
        self._states: list[list[float]] = []
        self._residuals = _Residuals(
            longest=1.0 / prepared.rig.engine.frequency,
            threshold=config.residual_threshold,
            gravity=prepared.rig.gravity,
        )
        self._compared_ns = onset.onset_ns
        self._is_certain = False  # whether the plate cannot change the release any more
        self._accuracy: Accuracy | None = None
        self._lead: float | None = None  # of the first prediction
        self._left_out = 0

    def advance(
        self, step: int, now_ns: int, motion: PlateStates, config: TwinConfig
    ) -> ThrowStep:
        """Go on as far as the plate is known, and look ahead from there."""
        crossing = self._prepared.rig.crossing_time
        if motion.gap > crossing or now_ns - self._estimator.newest_ns > LOST:
            self.ended_by = 'gap'
        else:
            self._smoothed.add(motion)
            self._follow_engine()
            if not self._follows_engine:
                self._follow_smoothed()
        known = max(self._stepper.horizon, 0.0)
        events, residual = self._follow_plate(known, config.max_events)
        if self._follows_engine and self.events:
            self._follows_engine = False  # it is certain, and changes no more
        prediction, forecast = self._look_ahead(known, step, now_ns, config)
        # what was extrapolated any longer would say nothing
        farthest = known + crossing + self._estimator.config.smoothing_window
        now = (now_ns - self._start_ns) / SECOND
        self._send(self._shown, max(known, min(now, farthest)))
        state = State._make(self._shown.state.tolist()[1:])
        return ThrowStep(state, events, forecast, prediction, residual)

    def _follow_engine(self) -> None:
        """Fit the engine's motion to the samples, and follow it, unless it does not hold."""
        fit, estimator, onset = self._fit, self._estimator, self._onset
        if fit is None:
            return
        period_ns = round(SECOND / self._prepared.rig.engine.frequency)
        end_ns = min(estimator.complete_ns, onset.onset_ns + period_ns)
        begin_ns = onset.onset_ns - estimator.config.smoothing_window_ns
        samples = estimator.samples(begin_ns, end_ns + 1)
        estimate = fit.update(samples)
        self._left_out = fit.left_out
        self.engine_holds = not fit.has_failed
        is_over = end_ns < estimator.complete_ns
        if fit.has_failed or is_over:
            self._fit = None  # what comes later is not the throw
        if not self._follows_engine:
            return
        if fit.has_failed or is_over:
            self._follows_engine = False
            if fit.has_failed:
                self._estimate = None
                self._restart(onset.onset_ns)
        elif estimate is not None:
            assert self._prepared.forecaster is not None
            self._estimate = estimate
            start_ns = onset.onset_ns + round(estimate.start * SECOND)
            until = max((end_ns - start_ns) / SECOND, 0.0)
            self._restart(start_ns)
            self._append(*self._prepared.forecaster.states(estimate, until))

    def _restart(self, start_ns: int) -> None:
        """Follow the throw once more from its start, of which more is known."""
        self._stepper.reset()
        self._start_ns = start_ns
        self._times, self._states = [], []
        self.events = []

    def _follow_smoothed(self) -> None:
        """Go on with what the samples alone tell of the plate."""
        if not self._times:
            beginning = self._smoothed.begin()
            if beginning is None:
                return
            self._start_ns, times, states = beginning
            self._append(times, states)
        self._append(*self._smoothed.take(self._times[-1], self._start_ns))

    def _append(self, times: Floats, states: Floats) -> None:
        """Have the model know of the plate, at times since the start."""
        if not times.size:
            return
        self._stepper.append_plate_states(times, states)
        if len(self._times) + times.size < MAX_PIECES_AHEAD:
            self._times += times.tolist()
            self._states += states.tolist()

    def _follow_plate(
        self, known: float, max_events: int
    ) -> tuple[tuple[Event, ...], Residual | None]:
        """Go on as far as the plate is known, past the samples of the projectile."""
        onset = self._onset
        until_ns = self._start_ns + math.ceil(known * SECOND)
        happened: list[Event] = []
        residual = None
        samples = self._estimator.samples(self._compared_ns + 1, until_ns + 1)
        if self._residuals.is_complete:
            samples = samples[-2:]  # the last one may be too late
        for sample in samples:
            time = (sample.stamp_ns - self._start_ns) / SECOND
            if time > known:
                break
            self._compared_ns = sample.stamp_ns
            is_passed = time < self._stepper.state[TIME]  # it is late for the start
            if is_passed or math.isnan(sample.projectile - onset.rest.projectile):
                continue
            state, events = self._go_to(time, max_events)
            happened += events
            rise = state.projectile_position - self._prepared.rest.projectile_position
            residual = Residual(
                sample.stamp_ns,
                state.plate_position - (sample.plate - onset.rest.plate),
                rise - (sample.projectile - onset.rest.projectile),
            )
            self._residuals.add(time, residual.projectile, self.events)
        _, events = self._go_to(known, max_events)
        return (*happened, *events), residual

    def _look_ahead(
        self, known: float, step: int, now_ns: int, config: TwinConfig
    ) -> tuple[PredictedState, ThrowResult | None]:
        """Find out what the projectile does as long as the plate cannot change it any more."""
        prepared, fork, onset_ns = self._prepared, self._far_fork, self._start_ns
        ahead = known + prepared.lookahead
        self._send(fork, ahead)
        stamp_ns = onset_ns + round(ahead * SECOND)
        prediction = PredictedState(
            stamp_ns,
            float(fork.state[PROJECTILE_POSITION]),
            float(fork.state[PROJECTILE_VELOCITY]),
            float(fork.state[PROJECTILE_FORCE]),
            stamp_ns - now_ns,
        )
        return prediction, self._forecast(known, step, now_ns, config)

    def _forecast(
        self, known: float, step: int, now_ns: int, config: TwinConfig
    ) -> ThrowResult | None:
        """Tell of the release when it is first known well enough, and when it is certain."""
        prepared, fork = self._prepared, self._far_fork
        if self._is_certain:
            return None
        release = fork.events()[0] if fork.event_count else None
        if release is not None and release.time <= known + prepared.release_lookahead:
            self._is_certain = True
            return self._predict(fork, release, step, now_ns, config)
        if not self._follows_engine or self._estimate is None or self._lead is not None:
            return None
        forecaster = prepared.forecaster
        assert forecaster is not None
        error = TWO_SIDED * forecaster.errors(self._estimate).speed
        if error > self._estimator.config.prediction_error:
            return None
        release = forecaster.release(self._estimate)
        if release is None:
            return None
        return self._predict(forecaster.stepper, release, step, now_ns, config)

    def _predict(
        self, stepper: Stepper, release: Event, step: int, now_ns: int, config: TwinConfig
    ) -> ThrowResult:
        """Sum up what there will have been at the release."""
        lead = release.time - (now_ns - self._start_ns) / SECOND
        self._lead = lead if self._lead is None else self._lead
        self._measure_peak_speed()
        self._accuracy = self._judge(release)
        return self._sum_up(
            'predicted', step, config, stepper, [release], lead=lead, accuracy=self._accuracy
        )

    def _judge(self, release: Event) -> Accuracy:
        """Tell how well a release is known by the samples so far."""
        estimator = self._estimator
        if self._estimate is None:
            errors = self._smoothed.release_errors(release.time, self._peak_plate_speed)
        else:
            assert self._prepared.forecaster is not None
            errors = self._prepared.forecaster.errors(self._estimate)
        speed = release.velocity
        transfer = (speed / self._peak_plate_speed) ** 2
        left_out = estimator.jumped + self._left_out
        return Accuracy(
            basis='plate' if self._estimate is None else 'engine',
            is_certain=self._is_certain,
            release_ns=self._start_ns + round(release.time * SECOND),
            release_time_error=errors.time,
            ejection_speed_error=errors.speed * abs(speed),
            energy_transfer_error=errors.energy_transfer * transfer,
            samples=len(estimator.samples(self._start_ns)) + estimator.jumped,
            samples_left_out=left_out,
        )

    def _send(self, fork: Stepper, time: float) -> None:
        """Have a fork go ahead, or as far as its memory for events lasts."""
        fork.sync_from(self._stepper)
        try:
            fork.advance_to(time)
        except EventLimitError:
            self.ended_by = 'max_events'

    def _measure_peak_speed(self) -> None:
        """Find the largest speed of the plate, of the smoothed one so far."""
        if self._estimate is not None:
            self._peak_plate_speed = self._estimate.plate.peak_velocity
            return
        speeds = [speed for _, speed, _ in self._states]
        plate = self._estimator.config.plate
        largest = peak_speed(self._times, speeds, plate) if speeds else 0.0
        self._peak_plate_speed = max(largest, self._estimator.config.start_speed)

    def result(self, stage: str, step: int, config: TwinConfig) -> ThrowResult:
        """Sum up what there is so far."""
        self._measure_peak_speed()
        if stage == 'release' and self.first_release is not None:
            self._accuracy = self._judge(self.first_release)
        return self._sum_up(
            stage,
            step,
            config,
            self._stepper,
            self.events,
            lead=self._lead,
            accuracy=self._accuracy,
            comparison=self._residuals.compare(self.first_release),
        )

    def throw_field(self) -> ThrowField | None:
        """Return the layer over time, once, when the plate is known for long enough or no more."""
        if self._has_shown_field or not self._times:  # it may end before anything is known
            return None
        release, known = self.first_release, self._times[-1]
        if not (release or self.ended_by):
            return None
        length = THROW_FIELD_LENGTH * release.time if release else known
        if self._follows_engine or (length > known and not self.ended_by):
            return None
        self._has_shown_field = True
        stepper = stepper_of(self._prepared.config)
        stepper.append_plate_states(self._times, self._states)
        times = np.linspace(0.0, min(length, known), THROW_FIELD_ROWS)
        strain = np.empty((THROW_FIELD_ROWS, FIELD_POINTS))
        stepper.sample_strain(np.minimum(times, stepper.horizon), strain)
        return ThrowField.of(times, strain, start_ns=self._start_ns)


class SmoothedPlate:
    """What the plate has done by its samples alone."""

    def __init__(self, onset: Onset, estimator: PlateEstimator) -> None:
        self._onset = onset
        self._estimator = estimator
        self._motions: list[PlateStates] = []  # that have not been taken
        self._errors: list[float] = []  # of velocities [m/s]

    def add(self, motion: PlateStates) -> None:
        """Take how the plate has moved since the last call, by the clock of the estimator."""
        if motion.times.size:
            self._motions.append(motion)
            self._errors += motion.errors.tolist()

    def begin(self) -> tuple[int, Floats, Floats] | None:
        """
        Return when the plate has started, and times and states since, over the first window.

        They are fitted apart, see `first_states`; None if there are too few samples yet.
        """
        onset, config = self._onset, self._estimator.config
        window_ns, rest = config.smoothing_window_ns, onset.rest.plate
        end_ns = onset.onset_ns + round(_FIRST_WINDOWS * window_ns)
        if self._estimator.complete_ns < end_ns:
            return None
        samples = self._estimator.samples(onset.onset_ns - window_ns, end_ns + 1)
        start_ns = onset.onset_ns + find_start(samples, onset.onset_ns, rest, config)
        return start_ns, *first_states(samples, start_ns, rest, config)

    def take(self, after: float, start_ns: int) -> tuple[Floats, Floats]:
        """Return times since a start, and states, after a time, which are taken once."""
        shift = (self._onset.onset_ns - start_ns) / SECOND
        after += _APART * state_spacing_ns(self._estimator.config) / SECOND
        times, states = [np.empty(0)], [np.empty((0, 3))]
        for known in self._motions:
            later = known.times + shift > after
            times.append(known.times[later] + shift)
            states.append(known.states[later] - [self._onset.rest.plate, 0.0, 0.0])
        self._motions.clear()
        return np.concatenate(times), np.concatenate(states)

    def release_errors(self, time: float, peak_plate_speed: float) -> ReleaseErrors:
        """Return about how well a release at a time after the start is known by it."""
        speed = float(np.median(self._errors)) / peak_plate_speed if self._errors else 1.0
        return ReleaseErrors(_TIME * speed * time, _SPEED * speed, _TRANSFER * speed)


class _Residuals:
    """Positions of the projectile by the model less those measured, until `longest` aloft."""

    def __init__(self, *, longest: float, threshold: float, gravity: float) -> None:
        self.is_complete = False
        self._longest = longest
        self._threshold = threshold
        self._gravity = gravity
        self._count = 0
        self._sum = 0.0  # of squares
        self._largest = 0.0
        self._aloft: list[tuple[float, float]] = []  # time since the release, and difference

    def add(self, time: float, difference: float, events: Sequence[Event]) -> None:
        """Take one, at a time since the start, after the events so far."""
        since = time - events[0].time if events else 0.0
        if since > self._longest:
            self.is_complete = True
            return
        self._count += 1
        self._sum += difference**2
        self._largest = max(self._largest, abs(difference))
        if len(events) == 1:  # they have not met again since the release
            self._aloft.append((since, difference))

    def compare(self, release: Event | None) -> Comparison | None:
        """Return what they come to; None if there is none."""
        if not self._count:
            return None
        comparison = Comparison(
            samples=self._count,
            position_rms=math.sqrt(self._sum / self._count),
            position_max=self._largest,
            threshold=self._threshold,
        )
        is_enough = len(self._aloft) >= FEWEST_ALOFT and self._aloft[-1][0] >= 0.5 * self._longest
        if release is None or not is_enough:
            return comparison
        times, differences = np.array(self._aloft).T
        # both fly freely, so that the difference is a line
        slope, ahead = np.polyfit(times, differences, 1).tolist()
        later = -ahead / release.velocity
        return dataclasses.replace(
            comparison,
            ejection_time_error=later,
            ejection_speed_error=slope - self._gravity * later,
        )
