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
"""A monitor of a measured plate that takes its samples and finds the onset of a throw."""

from __future__ import annotations

from dataclasses import replace
import math

from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.twin.onset import find_engine_start, find_onset, Onset, RISE
from soft_throw_ros.twin.outlier_filter import OUTLIER_SIGMAS
from soft_throw_ros.twin.plate_estimator import (
    PlateEstimator,
    PlateStates,
    REST_WINDOWS,
    SampleCounts,
)
from soft_throw_ros.twin.results import State
from soft_throw_ros.twin.sensor_checks import SensorChecks
from soft_throw_ros.twin.tick_schedule import SECOND

_EARLY_RISE = 0.1
"""Rise of the projectile before the plate, in amplitudes of the engine, that is no noise. [-]"""

_SAMPLES_BEFORE = 3
"""Last samples before the onset, which all show whether the projectile moved first. [-]"""

_REST_SIGMAS = 4.0
"""Standard errors of the speed within which the plate is at rest. [-]"""


class PlateMonitor:
    """
    A monitor of the plate from one throw to the next.

    The monitor updates the counts of samples and the diagnoses. The samples of the onset of a
    throw that has just begun are used again.

    Notes
    -----
    The plate is at rest when for `REST_WINDOWS` windows it has not been faster than half of the
    speed of a start, or four standard errors, and no more when it has been for `RISE` of its
    period. A throw has begun when it goes upwards at that speed, and at six standard errors of
    it. The time of the start is found at once if the plate moves as the engine should, see
    `find_engine_start`, and otherwise a window later, see `find_onset`.

    """

    def __init__(
        self,
        config: MeasurementConfig,
        counts: SampleCounts,
        checks: SensorChecks,
        onset: Onset | None = None,
    ) -> None:
        # `find_start` imports SciPy, which is too slow during a throw
        import scipy.optimize  # noqa: F401

        self._checks = checks
        # of the last throw: whether its motion was that of the engine, and of its stamps [s]
        self.engine_is_nominal = onset is None or onset.engine_is_nominal
        self.stamp_error = 0.0 if onset is None else onset.stamp_error
        self.estimator = PlateEstimator(
            config,
            origin_ns=None if onset is None else onset.onset_ns,
            samples=() if onset is None else onset.samples,
            counts=counts,
        )
        self._wait_for_rest()
        # Heights of the plate at rest, at present, and when it last was slow: the projectile moves
        # with a slow plate.
        self._rest = self._height = self._carried = math.nan if onset is None else onset.rest.plate
        self._speed = self._carried_speed = 0.0

    def rearm(self, config: MeasurementConfig) -> None:
        """Wait for another rest before a throw, and use the parameters `config` from now on."""
        if config != self.estimator.config:
            self.engine_is_nominal |= config.plate != self.estimator.config.plate
            self._checks.begin(self.estimator.config)
            self.estimator = PlateEstimator(config, counts=self.estimator.counts)
        self._wait_for_rest()

    def _wait_for_rest(self) -> None:
        self.is_armed = False  # whether the plate is at rest, so that a jump starts a throw
        self._first = math.nan  # time of the first smoothed state
        self._last_moving_time = -math.inf  # last time at which it was too fast to be at rest
        self._last_quiet_time = -math.inf  # last time at which it was not
        self._begun = math.inf  # time at which it was fast enough to have started

    def advance(self, now_ns: int) -> tuple[PlateStates, Onset | None]:
        """Return the motion since the last call, and the onset of a throw if one has begun."""
        motion = self.estimator.advance(now_ns)
        if motion.times.size:
            self._see(motion)
        onset = self._detect(motion)
        if onset is None and self._begun < math.inf and self.engine_is_nominal:
            onset = find_engine_start(
                self.estimator, self._to_ns(self._begun), self.stamp_error
            )
        if onset is None:
            return motion, None
        self.is_armed, self._begun = False, math.inf
        if self._has_swapped(onset):
            self._checks.report(
                'names',
                'the projectile has moved before the plate: if the names of the two joints are '
                'swapped in ~/measured_joint_states, swap them; no throw is followed',
            )
            return motion, None
        return motion, replace(
            onset, engine_is_nominal=self.engine_is_nominal, stamp_error=self.stamp_error
        )

    def _has_swapped(self, onset: Onset) -> bool:
        """Return whether the projectile has risen before the plate, which no wave can cause."""
        rest, plate = onset.rest, self.estimator.config.plate
        begin_ns = onset.onset_ns - self.estimator.config.smoothing_window_ns
        before = self.estimator.samples(begin_ns, onset.onset_ns)[-_SAMPLES_BEFORE:]
        rises = before['projectile'] - rest.projectile
        least = max(OUTLIER_SIGMAS * rest.noise, _EARLY_RISE * plate.amplitude)
        return len(rises) == _SAMPLES_BEFORE and bool((rises > least).all())

    def _to_ns(self, time: float) -> int:
        assert self.estimator.origin_ns is not None
        return self.estimator.origin_ns + round(time * SECOND)

    def _detect(self, motion: PlateStates) -> Onset | None:
        """Follow the smoothed motion of the plate; return the onset of a throw."""
        config = self.estimator.config
        window, start = config.smoothing_window, config.start_speed
        if motion.gap > window:
            self._first, self._begun = math.nan, math.inf
            self.is_armed = False
            return None
        for time, (height, speed, _), error in zip(
            motion.times.tolist(), motion.states.tolist(), motion.errors.tolist(), strict=True
        ):
            if math.isnan(self._first):
                self._first = self._last_moving_time = time
            if self._begun < math.inf:
                if time >= self._begun + window:
                    begun_ns, self._begun = self._to_ns(self._begun), math.inf
                    self.is_armed = False
                    self._last_moving_time = time
                    onset = find_onset(
                        self.estimator,
                        begun_ns=begun_ns,
                        time_ns=self._to_ns(time),
                        height=height,
                        speed=speed,
                    )
                    if onset is not None:
                        return onset
            elif self.is_armed and speed > max(start, OUTLIER_SIGMAS * error):
                self._begun = time
            elif abs(speed) > max(0.5 * start, _REST_SIGMAS * error):
                self._last_moving_time = time
                moving_time = time - self._last_quiet_time
                self.is_armed = self.is_armed and moving_time * config.plate.frequency <= RISE
            else:
                self._last_quiet_time = time
                if time - self._last_moving_time >= REST_WINDOWS * window:
                    self.is_armed = True
        return None

    def _see(self, motion: PlateStates) -> None:
        """Store the position of the plate."""
        self._height, self._speed, _ = motion.states[-1].tolist()
        since_rest = float(motion.times[-1]) - self._last_quiet_time
        window = self.estimator.config.smoothing_window
        was_at_rest = self.is_armed and since_rest < REST_WINDOWS * window
        self._checks.observe(self._height, self._speed, was_at_rest=was_at_rest)
        if math.isnan(self._rest):
            self._rest = self._carried = self._height
        self._carried_speed = 0.0
        if abs(self._speed) < self.estimator.config.start_speed:
            self._carried, self._carried_speed = self._height, self._speed

    def state(self, rest: State) -> State:
        """Return the state of the plate, with the projectile lying on the layer."""
        if math.isnan(self._rest):
            return rest
        return rest._replace(
            plate_position=rest.plate_position + self._height - self._rest,
            projectile_position=rest.projectile_position + self._carried - self._rest,
            plate_velocity=self._speed,
            projectile_velocity=self._carried_speed,
        )
