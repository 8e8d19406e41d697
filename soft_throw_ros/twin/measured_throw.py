# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A throw of a measured plate, with states and predictions of the model ahead of the rig.

A wave needs a crossing time from the plate to the projectile. Therefore the motion of the
projectile is known for a crossing time longer than the motion of the plate: a fork of the stepper
advances with any continuation of the plate's motion (see `Stepper.sync_from`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate_kernels import MAX_PIECES_AHEAD
from soft_throw_ros.core.stepper import (
    Event,
    PLATE_POSITION,
    PROJECTILE_POSITION,
    TIME,
)
from soft_throw_ros.twin.plate_estimator import Onset, PAST, PlateEstimator, PlateStates
from soft_throw_ros.twin.plate_observer import PlateObserver
from soft_throw_ros.twin.prepared_rig import (
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

Floats = NDArray[np.float64]

_PREDICTION_ERROR = 0.03
"""Largest relative standard error of the ejection speed in the first prediction. [-]"""

LOST = PAST
"""Time without samples after which the plate is lost, because later ones are too old. [ns]"""

FEWEST_IN_FLIGHT = 8
"""Fewest samples of the projectile in flight that give the errors of the release. [-]"""

MEASURED_REST_SPEED = 0.5
"""Largest speed at rest, over the speed of a start. [-]"""

_NOISY = 0.05
"""Relative error of the speed of a certain release beyond which noise may have caused it. [-]"""

_SKIPPED = 0.5
"""Delay between two steps that shows that steps have been skipped, in steps. [-]"""


class MeasuredThrow(OngoingThrow):
    """
    A throw whose plate is measured, see `OngoingThrow`, by an observer from the onset on.

    The stepper follows the smoothed states that do not change any more. In each step a fork goes
    on from there, along the latest states and their continuation: to the present time, as far as
    the projectile is known, and until its release.
    """

    def __init__(
        self, prepared: PreparedRig, onset: Onset, estimator: PlateEstimator, *, number: int
    ) -> None:
        config = estimator.config
        assert prepared.fork is not None
        assert prepared.release_weights is not None
        rest_speed = MEASURED_REST_SPEED * config.start_speed
        super().__init__(
            prepared, number=number, start_ns=onset.onset_ns, rest_speed=rest_speed
        )
        self._fork = prepared.fork
        self._onset, self._estimator = onset, estimator
        self._observer = PlateObserver(config, onset, prepared.release_weights)
        self._settled = [(np.empty(0), np.empty((0, 3)))]  # times and states of the plate
        self._path = self._settled[0]  # after these, with the continuation
        self._now = 0.0  # time of the displayed state [s]
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

    @property
    def layer(self) -> LayerState:
        """Return the present state of the layer."""
        self._fork.sync_from(self._stepper, *self._path)
        self._move_fork(self._now)
        return layer_of(self._fork)

    @property
    def _is_certain(self) -> bool:
        """Whether the plate cannot change the release any more."""
        return self._accuracy is not None and self._accuracy.is_certain

    def advance(self, tick: Tick, motion: PlateStates) -> Outputs:
        """Advance as far as the plate is known, and predict from there."""
        estimator, observer, start_ns = self._estimator, self._observer, self.start_ns
        crossing, window = self._prepared.rig.crossing_time, estimator.config.smoothing_window
        if motion.gap > crossing or tick.due_ns - estimator.newest_ns > LOST:
            self.ended_by = 'gap'
        else:
            observer.add(estimator.samples(observer.next_ns, estimator.complete_ns + 1))
        known = observer.newest + crossing
        # a longer extrapolation has no meaning
        now = min((tick.due_ns - start_ns) / SECOND, known + window)
        self._move_plate(max(now, known, self._latest_release))
        self._count_skipped_time(tick.due_ns)
        horizon = self._stepper.horizon
        events, residual = self._follow_plate(horizon, tick.config.max_events)
        self._now, ahead = max(now, horizon), max(known, horizon)
        self._fork.sync_from(self._stepper, *self._path)
        states = {time: self._move_fork(time) for time in sorted((self._now, ahead))}
        forecast = self._forecast(known, tick)
        if self.ended_by == 'noise':
            self.events, events = [], ()
        predicted, stamp_ns = states[ahead], start_ns + round(ahead * SECOND)
        return Outputs(
            tick.step,
            self.number,
            states[self._now],
            events=events,
            results=() if forecast is None else (forecast,),
            prediction=PredictedState(
                stamp_ns,
                predicted.projectile_position,
                predicted.projectile_velocity,
                predicted.projectile_force,
            ),
            residual=residual,
        )

    @property
    def _latest_release(self) -> float:
        """Latest time of a release that the next prediction needs [s]."""
        return self._prepared.latest_release if self._lead is None else 0.0

    def _move_plate(self, until: float) -> None:
        """Append the states of the plate that do not change any more, and store the others."""
        times, states, settled = self._observer.motion(until)
        self._path = times[settled:], states[settled:]
        if settled:
            times, states = times[:settled], states[:settled]
            self._stepper.append_plate_states(times, states)
            if not self._has_shown_field or times[0] < self._latest_peak(None):
                self._settled.append((times, states))

    def _move_fork(self, time: float) -> State:
        """Advance the fork to a time, along the latest states of the plate."""
        self._try_to_advance(self._fork, time)
        return State._make(self._fork.state.tolist()[1:])

    def event_ns(self, event: Event, tick: Tick) -> int:  # noqa: ARG002
        """Return the time of an event by the stamps of the samples [ns]."""
        return self.start_ns + round(event.time * SECOND)

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
        rest, start_ns, residuals = self._onset.rest, self.start_ns, self._residuals
        if residuals.is_complete:
            return self._go_to(known, max_events)[1], None
        stepper, first_ns = self._stepper, start_ns + round(self._stepper.state[TIME] * SECOND)
        samples = self._estimator.samples(
            max(residuals.last_ns, first_ns) + 1, start_ns + math.floor(known * SECOND) + 1
        )
        heights = samples.heights - (rest.plate, rest.projectile)
        is_measured = np.isfinite(heights[:, 1])
        stamps, heights = samples.stamps[is_measured], heights[is_measured]
        times = (stamps - start_ns) / SECOND
        for n, time in enumerate(times.tolist()):
            self._try_to_advance(stepper, min(time, known))
            heights[n] -= stepper.state[PLATE_POSITION:PROJECTILE_POSITION + 1]
        _, events = self._go_to(known, max_events)
        if not stamps.size:
            return events, None
        heights[:, 1] += self._prepared.rest.projectile_position
        residuals.last_ns = int(stamps[-1])
        residuals.add(times, -heights[:, 1], self.events)
        plate, projectile = (-heights[-1]).tolist()
        return events, Residual(residuals.last_ns, plate, projectile)

    def _forecast(self, ahead: float, tick: Tick) -> ThrowResult | None:
        """Return the release when it is first known well enough, and when it is certain."""
        fork = self._fork
        if self._is_certain or self.ended_by:
            return None
        if not fork.event_count and self._latest_release > ahead:
            self._try_to_advance(fork, self._latest_release)
        if not fork.event_count:
            return None
        release = fork.events()[0]
        accuracy = self._assess_accuracy(release, is_certain=release.time <= ahead)
        error = accuracy.ejection_speed_error / abs(release.velocity)
        if accuracy.is_certain:
            if error > _NOISY:
                self.ended_by = 'noise'
                return None
        elif self._lead is not None or error > _PREDICTION_ERROR:
            return None
        self._accuracy = accuracy
        lead = release.time - (tick.due_ns - self.start_ns) / SECOND
        self._lead = lead if self._lead is None else self._lead
        result = self._result_of('predicted', tick, fork, [release])
        return self._with_measurement(result, lead, None)

    def _latest_peak(self, release: Event | None) -> float:
        """Return the time until which the plate has its peak speed: until the release too [s]."""
        peak_time = 1.1 * self._estimator.config.motion.peak_velocity_time
        return max(peak_time, release.time if release else 0.0)

    def peak_plate_speed(self, release: Event | None) -> float:
        """Return the largest speed of the plate until both its peak and the release [m/s]."""
        times, states = self._plate(self._path)
        is_early = times <= self._latest_peak(release)
        fastest = peak_speed(times[is_early], states[is_early])
        return max(fastest, self._estimator.config.start_speed)

    def _plate(self, *more: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
        """Return times and states of the plate that are settled, and more."""
        times, states = zip(*self._settled, *more, strict=True)
        return np.concatenate(times), np.concatenate(states)

    def _assess_accuracy(self, release: Event, *, is_certain: bool) -> Accuracy:
        """Return the accuracy of a release."""
        speed, peak_speed = release.velocity, self.peak_plate_speed(release)
        errors = self._observer.errors(speed, peak_speed)
        estimator = self._estimator
        return Accuracy(
            is_certain=is_certain,
            release_time_error=errors.time,
            ejection_speed_error=errors.speed * abs(speed),
            energy_transfer_error=errors.energy_transfer * (speed / peak_speed) ** 2,
            samples=len(estimator.samples(self.start_ns)) + estimator.outliers,
            samples_left_out=estimator.outliers + self._observer.outliers,
        )

    def result(self, stage: str, tick: Tick) -> ThrowResult:
        """Return the result so far, with its accuracy and the faults of the measurement."""
        release = self.first_release
        if stage == 'release' and release is not None:
            self._accuracy = self._assess_accuracy(release, is_certain=self._is_certain)
        result = super().result(stage, tick)
        return self._with_measurement(result, self._lead, self._residuals.compare(release))

    def _with_measurement(
        self, result: ThrowResult, lead: float | None, comparison: Comparison | None
    ) -> ThrowResult:
        """Add the faults of the measurement until now, and to a valid result its accuracy."""
        disturbances = Disturbances(
            clock_offset_ns=self._onset.clock_offset_ns,
            samples_missing=self._estimator.missing_since(self.start_ns),
            time_skipped=self._time_skipped,
        )
        known: dict[str, Any] = {}
        if result.is_valid:
            known = {'lead': lead, 'accuracy': self._accuracy, 'comparison': comparison}
        return dataclasses.replace(result, disturbances=disturbances, **known)

    def throw_field(self) -> Callable[[], ThrowField] | None:
        """Return the layer over time once, when the plate is known for long enough or lost."""
        release, known = self.first_release, self._stepper.horizon
        if self._has_shown_field or known <= 0.0 or not (release or self.ended_by):
            return None  # the throw may end before the plate is known
        length = THROW_FIELD_LENGTH * release.time if release else known
        if length > known and not self.ended_by:
            return None
        self._has_shown_field = True
        config, (times, states), start_ns = self._prepared.config, self._plate(), self.start_ns

        def throw_field() -> ThrowField:
            stepper, shown = stepper_of(config), slice(MAX_PIECES_AHEAD)
            stepper.append_plate_states(times[shown], states[shown])
            return throw_field_of(stepper, min(length, stepper.horizon), start_ns=start_ns)

        return throw_field


def peak_speed(times: Floats, states: Floats) -> float:
    """Return the largest speed of a plate from its states, with the peak between two of them."""
    if not times.size:
        return 0.0
    best = int(states[:, 1].argmax())
    speed = float(states[best, 1])
    other = best + (1 if states[best, 2] > 0.0 else -1)
    if not 0 <= other < times.size:
        return speed
    change = states[best, 2] - states[other, 2]
    share = states[best, 2] / change if change else 0.0  # of the way to no acceleration
    return speed + 0.5 * float(states[best, 2] * np.clip(share, 0.0, 1.0) * (
        times[other] - times[best]
    ))


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
    in_flight: list[Floats] = field(default_factory=list)
    """Times since the release [s], and residuals [m], shapes (2, n)."""

    def add(self, times: Floats, differences: Floats, events: Sequence[Event]) -> None:
        """Add residuals at times since the start, with the events until the last one."""
        release, landing, *_ = [*(event.time for event in events), math.inf, math.inf]
        self.is_complete = bool(times[-1] > release + self.longest)
        is_flying = (times > release) & (times < landing)
        self.in_flight.append(np.stack((times - release, differences))[:, is_flying])
        counted = differences[times <= release + self.longest]
        self.count += len(counted)
        self.sum_of_squares += float(np.square(counted).sum())
        self.largest = max(self.largest, float(np.abs(counted).max(initial=0.0)))

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
        times, differences = np.concatenate(self.in_flight, axis=1)
        is_enough = times.size >= FEWEST_IN_FLIGHT and times[-1] >= 0.5 * self.longest
        if release is None or not is_enough:
            return comparison
        # model and projectile fly freely, so that the residual is linear in time
        slope, offset = np.polyfit(times, differences, 1).tolist()
        later = -offset / release.velocity
        return dataclasses.replace(
            comparison,
            ejection_time_error=later,
            ejection_speed_error=slope - self.gravity * later,
        )
