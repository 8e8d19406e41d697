# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A throw of a measured plate, with states and predictions of the model ahead of the rig.

A wave needs a crossing time from the plate to the projectile, whose motion is therefore known for
a crossing time longer than the motion of the plate.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math
from typing import Any, TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.stepper import (
    CAPACITY,
    Event,
    PLATE_POSITION,
    PROJECTILE_POSITION,
    Stepper,
)
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.plate_observer import PlateObserver
from soft_throw_ros.twin.prepared_rig import (
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
    LayerState,
    Outputs,
    PredictedState,
    Residual,
    State,
    ThrowField,
    ThrowResult,
)
from soft_throw_ros.twin.rig_states import OngoingThrow
from soft_throw_ros.twin.sample_buffer import Onset, PAST, SampleBuffer

if TYPE_CHECKING:
    from soft_throw_ros.twin.session import Session

Floats = NDArray[np.float64]
Path: TypeAlias = tuple[Floats, Floats]  # times and states of the plate

_PREDICTION_ERROR = 0.03
"""Largest relative standard error of the ejection speed in the first prediction. [-]"""

_LONGER = 1.3
"""Latest release that is predicted, over the ejection time with the expected motion. [-]"""

_NOISY = 0.05
"""Relative error of the speed of a certain release beyond which noise may have caused it. [-]"""

FEWEST_IN_FLIGHT = 8
"""Fewest samples of the projectile in flight that give the errors of the release. [-]"""

MEASURED_REST_SPEED = 0.5
"""Largest speed at rest, over the speed of a start. [-]"""


class MeasuredThrow(OngoingThrow):
    """
    A throw whose plate is measured, see `OngoingThrow`, by an observer from the onset on.

    The stepper follows the smoothed states that do not change any more. In each step a fork goes
    on from there (`Stepper.sync_from`), along the latest states and their continuation: to the
    present time, as far as the projectile is known, and until its release.
    """

    def __init__(self, session: Session, onset: Onset, buffer: SampleBuffer) -> None:
        prepared, config = session.prepared, buffer.config
        response, fork = prepared.release_response, prepared.fork
        assert response is not None
        assert fork is not None
        rest_speed = MEASURED_REST_SPEED * config.start_speed
        super().__init__(session, start_ns=onset.onset_ns, rest_speed=rest_speed)
        self._fork, self._onset, self._buffer = fork, onset, buffer
        self._observer = PlateObserver(config, onset, response)
        latest = _LONGER * response.release_time
        is_affordable = fork.cost * latest <= MOST_SHARE * prepared.tick
        self._latest_release = latest if is_affordable else 0.0  # predicted in a step [s]
        self._settled = np.empty(0), np.empty((0, 3))  # times and states of the plate
        self._path = self._settled  # after these, with the continuation
        self._now = 0.0  # time of the displayed state [s]
        self._period = 1.0 / config.plate.frequency  # of the plate [s]
        self._peak_by = 1.1 * config.motion.peak_velocity_time  # has its largest speed [s]
        self._compared = 0.0  # until when the projectile has been compared [s]
        self._differences = [np.empty((2, 0))]  # times [s], and model minus projectile [m]
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
                self._settled = _joined(self._settled, (times, states))

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
        self._differences.append(np.stack((times, differences[:, 1])))
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
            lead = release.time - (due_ns - self.start_ns) / SECOND
            result = self._result('predicted', self._fork)
            self.session.report(dataclasses.replace(result, lead=lead))
            self._lead = lead if self._lead is None else self._lead

    def _peak_plate_speed(self, release: Event | None) -> float:
        """Return the largest speed of the plate until both its peak and the release [m/s]."""
        times, states = _joined(self._settled, self._path)
        is_early = times <= max(self._peak_by, release.time if release else 0.0)
        _, speeds, accelerations = states[is_early].T
        gain, loss = accelerations[:-1].clip(1e-9), (-accelerations[1:]).clip(0.0)
        between = speeds[:-1] + 0.5 * np.diff(times[is_early]) * gain**2 / (gain + loss)
        fastest = max(speeds.max(initial=0.0), between.max(initial=0.0))
        return max(float(fastest), self._buffer.config.start_speed)

    def _result(self, stage: str, fork: Stepper | None = None) -> ThrowResult:
        """Return the result so far, with its accuracy and its comparison."""
        known: dict[str, Any] = {'clock_offset_ns': self._onset.clock_offset_ns}
        result, buffer = super()._result(stage, fork), self._buffer
        if result.first and stage != 'final':
            speed, peak_speed = result.first.ejection_speed, result.peak_plate_speed
            speed_error, time_error, peak_error = self._observer.errors()
            # errors of both speeds count as independent, as an unexpected motion makes them
            relative_error = 2.0 * math.hypot(speed_error / speed, peak_error / peak_speed)
            self._accuracy = Accuracy(
                is_certain=self._is_certain,
                release_time_error=time_error,
                ejection_speed_error=speed_error,
                energy_transfer_error=relative_error * result.first.energy_transfer,
                samples=len(buffer.between(self.start_ns)) + buffer.outliers,
                samples_left_out=buffer.outliers,
            )
        if result.is_valid:
            comparison = None if fork else self._compare()
            known |= {'lead': self._lead, 'accuracy': self._accuracy, 'comparison': comparison}
        return dataclasses.replace(result, **known)

    def _compare(self) -> Comparison | None:
        """Compare the throw with the samples of the projectile; None if there are none."""
        times, differences = np.concatenate(self._differences, axis=1)
        release, landing, *_ = [*(event.time for event in self.events), math.inf, math.inf]
        counted = differences[times <= release + self._period]
        if not counted.size:
            return None
        comparison = Comparison(
            samples=counted.size,
            position_rms=math.sqrt(np.square(counted).mean()),
            position_max=float(np.abs(counted).max()),
            threshold=self._buffer.config.residual_threshold,
        )
        is_flying = (times > release) & (times < landing)
        times, differences = times[is_flying] - release, differences[is_flying]
        if times.size < FEWEST_IN_FLIGHT or times[-1] < 0.5 * self._period:
            return comparison
        # model and projectile fly freely, so that the residual is linear in time
        slope, offset = np.polyfit(times, differences, 1).tolist()
        later = -offset / self.events[0].velocity
        return dataclasses.replace(
            comparison,
            ejection_time_error=later,
            ejection_speed_error=slope - self._prepared.rig.gravity * later,
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
        config, (times, states), start_ns = self._prepared.config, self._settled, self.start_ns

        def throw_field() -> ThrowField:
            stepper, shown = stepper_of(config), slice(CAPACITY)
            stepper.append_plate_states(times[shown], states[shown])
            return throw_field_of(stepper, min(length, stepper.horizon), start_ns=start_ns)

        return throw_field


def _joined(first: Path, second: Path) -> Path:
    """Return both parts of a path."""
    return np.concatenate((first[0], second[0])), np.concatenate((first[1], second[1]))
