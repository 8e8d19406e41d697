# SPDX-License-Identifier: Apache-2.0
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
from soft_throw_ros.twin.onset import first_states, Onset, peak_speed
from soft_throw_ros.twin.plate_estimator import PAST, PlateEstimator, PlateStates
from soft_throw_ros.twin.prepared_rig import (
    FIELD_POINTS,
    PreparedRig,
    stepper_of,
    THROW_FIELD_LENGTH,
    THROW_FIELD_ROWS,
)
from soft_throw_ros.twin.results import (
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
REST_SPEED = 0.5  # what is slower than this part of the speed of a start is at rest [-]


class MeasuredThrow(OngoingThrow):
    """A throw whose plate is measured, see `OngoingThrow`, by an estimator from the onset on."""

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
        times, states = first_states(onset, config)
        self._stepper.append_plate_states(times, states)
        self._times, self._states = times.tolist(), states.tolist()
        self._residuals = _Residuals(
            longest=1.0 / prepared.rig.engine.frequency,
            threshold=config.residual_threshold,
            gravity=prepared.rig.gravity,
        )
        self._compared_ns = onset.onset_ns
        self._lead: float | None = None

    def advance(
        self, motion: PlateStates, *, step: int, now_ns: int, config: TwinConfig
    ) -> ThrowStep:
        """Go on as far as the plate is known, and look ahead from there."""
        crossing = self._prepared.rig.crossing_time
        if motion.gap > crossing or now_ns - self._estimator.newest_ns > LOST:
            self.ended_by = 'gap'
        else:
            self._append(motion)
        known = self._stepper.horizon
        events, residual = self._follow_plate(known, config.max_events)
        prediction, forecast = self._look_ahead(known, step, now_ns, config)
        # what was extrapolated any longer would say nothing
        farthest = known + crossing + self._estimator.config.smoothing_window
        now = (now_ns - self._start_ns) / SECOND
        self._send(self._shown, max(known, min(now, farthest)))
        state = State._make(self._shown.state.tolist()[1:])
        return ThrowStep(state, events, forecast, prediction, residual)

    def _append(self, motion: PlateStates) -> None:
        """Have the model know of the plate."""
        later = motion.times > self._times[-1]
        if not later.any():
            return
        times, states = motion.times[later], motion.states[later]
        states[:, 0] -= self._onset.plate_rest
        self._stepper.append_plate_states(times, states)
        if len(self._times) + times.size < MAX_PIECES_AHEAD:
            self._times += times.tolist()
            self._states += states.tolist()

    def _follow_plate(
        self, known: float, max_events: int
    ) -> tuple[tuple[Event, ...], Residual | None]:
        """Go on as far as the plate is known, past the samples of the projectile."""
        onset = self._onset
        until_ns = onset.onset_ns + math.ceil(known * SECOND)
        happened: list[Event] = []
        residual = None
        samples = self._estimator.samples(self._compared_ns + 1, until_ns + 1)
        if self._residuals.is_complete:
            samples = samples[-2:]  # the last one may be too late
        for sample in samples:
            time = (sample.stamp_ns - onset.onset_ns) / SECOND
            if time > known:
                break
            self._compared_ns = sample.stamp_ns
            is_passed = time < self._stepper.state[TIME]  # it is late for the start
            if is_passed or math.isnan(sample.projectile - onset.projectile_rest):
                continue
            state, events = self._go_to(time, max_events)
            happened += events
            rise = state.projectile_position - self._prepared.rest.projectile_position
            residual = Residual(
                sample.stamp_ns,
                state.plate_position - (sample.plate - onset.plate_rest),
                rise - (sample.projectile - onset.projectile_rest),
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
        if self._lead is not None or not fork.event_count:
            return prediction, None
        release = fork.events()[0]
        if release.time > known + prepared.release_lookahead:
            return prediction, None
        self._lead = release.time - (now_ns - onset_ns) / SECOND
        self._measure_peak_speed()
        forecast = self._sum_up('predicted', step, config, fork, [release], lead=self._lead)
        return prediction, forecast

    def _send(self, fork: Stepper, time: float) -> None:
        """Have a fork go ahead, or as far as its memory for events lasts."""
        fork.sync_from(self._stepper)
        try:
            fork.advance_to(time)
        except EventLimitError:
            self.ended_by = 'max_events'

    def _measure_peak_speed(self) -> None:
        """Find the largest speed of the plate so far, which has started by all means."""
        speeds = [speed for _, speed, _ in self._states]
        period = 1.0 / self._prepared.rig.engine.frequency
        self._peak_plate_speed = max(
            peak_speed(self._times, speeds, period), self._estimator.config.start_speed
        )

    def result(self, stage: str, step: int, config: TwinConfig) -> ThrowResult:
        """Sum up what there is so far."""
        self._measure_peak_speed()
        return self._sum_up(
            stage,
            step,
            config,
            self._stepper,
            self.events,
            lead=self._lead,
            comparison=self._residuals.compare(self.first_release),
        )

    def throw_field(self) -> ThrowField | None:
        """Return the layer over time, once, when the plate is known for long enough or no more."""
        release, known = self.first_release, self._times[-1]
        if self._has_shown_field or not (release or self.ended_by):
            return None
        length = THROW_FIELD_LENGTH * release.time if release else known
        if length > known and not self.ended_by:
            return None
        self._has_shown_field = True
        stepper = stepper_of(self._prepared.config)
        stepper.append_plate_states(self._times, self._states)
        times = np.linspace(0.0, min(length, known), THROW_FIELD_ROWS)
        strain = np.empty((THROW_FIELD_ROWS, FIELD_POINTS))
        stepper.sample_strain(np.minimum(times, stepper.horizon), strain)
        return ThrowField.of(times, strain, start_ns=self._start_ns)


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
