# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A monitor of a measured plate that takes its samples and finds the onset of a throw."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.smoothing import FEWEST
from soft_throw_ros.twin.outlier_filter import OUTLIER_SIGMAS
from soft_throw_ros.twin.plate_estimator import (
    Onset,
    PlateEstimator,
    PlateStates,
    REST_WINDOWS,
    RestBaseline,
    SampleCounts,
)
from soft_throw_ros.twin.plate_observer import AMPLITUDE_ERROR
from soft_throw_ros.twin.results import State
from soft_throw_ros.twin.sample_buffer import Samples
from soft_throw_ros.twin.tick_schedule import SECOND

RISE = 0.125
"""Time until the plate reaches the speed of a start, over its period. [-]"""

_MOST_FOR_START = 128
"""Most samples in the fit of the start, to bound its cost. [-]"""

_MOST_MISFIT = 0.05
"""Median difference of the samples from a start, over the engine's amplitude, that is one. [-]"""

_START_STEPS = 6
"""Gauss-Newton steps of this fit. [-]"""

_REST_SIGMAS = 4.0
"""Standard errors of the speed within which the plate is at rest. [-]"""


@dataclass
class _JumpDetector:
    """A detector of rests and jumps of the plate; times are those of the estimator [s]."""

    is_armed: bool = False  # whether the plate is at rest, so that a jump starts a throw
    last_moving: float = math.nan  # last time at which the plate was too fast for a rest
    last_quiet: float = -math.inf  # last time at which it was slow enough
    begun: float = math.inf  # time at which it reached the speed of a start; infinite before

    def cancel(self) -> None:
        """Wait for another rest after a jump."""
        self.is_armed, self.begun = False, math.inf

    def observe(self, time: float, speed: float, error: float, config: MeasurementConfig) -> None:
        """Observe a smoothed speed in the direction of a start."""
        if math.isnan(self.last_moving):
            self.last_moving = time
        if self.begun < math.inf:
            if time >= self.begun + config.smoothing_window:  # it was no start
                self.cancel()
                self.last_moving = time
        elif self.is_armed and speed > max(config.start_speed, OUTLIER_SIGMAS * error):
            self.begun = time
        elif abs(speed) > max(0.5 * config.start_speed, _REST_SIGMAS * error):
            self.last_moving = time
            moving_time = time - self.last_quiet
            self.is_armed = self.is_armed and moving_time <= longest_rise(config)
        else:
            self.last_quiet = time
            if time - self.last_moving >= REST_WINDOWS * config.smoothing_window:
                self.is_armed = True


class PlateMonitor:
    """
    A monitor of the plate from one throw to the next.

    The monitor updates the counts of samples. The samples of the onset of a throw that has just
    begun are used again.

    Notes
    -----
    The plate is at rest when for `REST_WINDOWS` windows it has not been faster than half of the
    speed of a start, or four standard errors, and no more when it has been for `RISE` of its
    period. A throw has begun when it goes upwards at that speed, and at six standard errors of
    it, and has a start within the next window, see `find_onset`.

    """

    def __init__(
        self,
        config: MeasurementConfig,
        counts: SampleCounts,
        onset: Onset | None = None,
    ) -> None:
        self.estimator = PlateEstimator(
            config,
            counts,
            origin_ns=None if onset is None else onset.onset_ns,
            samples=None if onset is None else onset.samples,
        )
        self._jump = _JumpDetector()
        self._rest = math.nan if onset is None else onset.rest.plate  # height of the plate [m]
        # heights [m] and speeds [m/s] of the plate, and of a projectile that a slow plate carries
        self._plate = self._projectile = self._rest, 0.0

    def rearm(self, config: MeasurementConfig) -> None:
        """Wait for another rest before a throw, and use the parameters `config` from now on."""
        if config != self.estimator.config:
            self.estimator = PlateEstimator(config, self.estimator.counts)
        self._jump = _JumpDetector()

    @property
    def is_armed(self) -> bool:
        """Whether the plate is at rest, so that a jump starts a throw."""
        return self._jump.is_armed

    def advance(self, now_ns: int) -> tuple[PlateStates, Onset | None]:
        """Return the motion since the last call, and the onset of a throw if one has begun."""
        motion = self.estimator.advance(now_ns)
        if motion.times.size:
            self._update_state(motion)
        onset = self._detect(motion)
        if onset is not None:
            self._jump.cancel()
        return motion, onset

    def _to_ns(self, time: float) -> int:
        assert self.estimator.origin_ns is not None
        return self.estimator.origin_ns + round(time * SECOND)

    def _detect(self, motion: PlateStates) -> Onset | None:
        """Follow the smoothed motion of the plate; return the onset of a throw."""
        config = self.estimator.config
        if motion.gap > config.smoothing_window:
            self._jump = _JumpDetector()
            return None
        is_tried = False  # with all complete samples
        for time, (_, speed, _), error in zip(
            motion.times.tolist(), motion.states.tolist(), motion.errors.tolist(), strict=True
        ):
            self._jump.observe(time, config.direction * speed, error, config)
            if self._jump.begun < math.inf and not is_tried:
                onset, is_tried = find_onset(self.estimator, self._to_ns(self._jump.begun)), True
                if onset is not None:
                    return onset
        return None

    def _update_state(self, motion: PlateStates) -> None:
        """Store the latest state of the plate."""
        height, speed, _ = motion.states[-1].tolist()
        if math.isnan(self._rest):
            self._rest, self._projectile = height, (height, 0.0)
        self._plate = height, speed
        is_slow = abs(speed) < self.estimator.config.start_speed
        self._projectile = self._plate if is_slow else (self._projectile[0], 0.0)

    def state(self, rest: State) -> State:
        """Return the state of the plate, with the projectile lying on the layer."""
        if math.isnan(self._rest):
            return rest
        return rest._replace(
            plate_position=rest.plate_position + self._plate[0] - self._rest,
            projectile_position=rest.projectile_position + self._projectile[0] - self._rest,
            plate_velocity=self._plate[1],
            projectile_velocity=self._projectile[1],
        )


def longest_rise(config: MeasurementConfig) -> float:
    """Return the longest time from a slow motion to the speed of a start [s]."""
    return max(RISE / config.plate.frequency, 2.0 * config.rise_time)


def find_onset(estimator: PlateEstimator, begun_ns: int) -> Onset | None:
    """Find the start of a plate that was fast at `begun_ns`, if its motion is that of a start."""
    config = estimator.config
    window_ns = config.smoothing_window_ns
    margin_ns = max(window_ns, round(longest_rise(config) * SECOND))
    rest = estimator.rest_before(begun_ns - margin_ns)
    samples = estimator.samples(begun_ns - margin_ns, estimator.complete_ns + 1)
    if rest is None or len(samples) < FEWEST:
        return None
    # a slow engine moves for many samples; a subset suffices
    stride = math.ceil(len(samples) / _MOST_FOR_START)
    thinned = samples[(len(samples) - 1) % stride::stride]
    onset_ns, size = find_start(thinned, begun_ns, rest, config)
    moved = estimator.samples(onset_ns + 1, estimator.complete_ns + 1)
    if len(moved) < FEWEST - 1:
        return None
    height, speed, _ = size * config.motion.states_at(moved.seconds_since(onset_ns)).T
    if (config.direction * speed).max() < config.start_speed:
        return None
    misfit = float(np.median(np.abs(moved.plate - rest.plate - height)))
    if misfit > max(_MOST_MISFIT * config.plate.amplitude, OUTLIER_SIGMAS * rest.noise):
        return None
    before = estimator.samples(onset_ns - window_ns)
    return Onset(onset_ns=onset_ns, rest=rest, samples=before)


def find_start(
    samples: Samples, begun_ns: int, rest: RestBaseline, config: MeasurementConfig
) -> tuple[int, float]:
    """
    Return the start of a plate that was fast at `begun_ns` [ns], and its relative amplitude [-].

    Both are by least squares, in Gauss-Newton steps, with their expected errors as samples.
    """
    window = config.smoothing_window
    since, heights = samples.seconds_since(begun_ns), samples.plate - rest.plate
    start, size = -config.rise_time, 1.0
    prior = np.array([1.0 / AMPLITUDE_ERROR, 1.0 / window]) ** 2
    for _ in range(_START_STEPS):
        height, speed, _ = config.motion.states_at(since - start).T
        error = np.hypot(rest.noise, size * speed * config.stamp_error)
        rows = np.stack((height, -size * speed)) / error
        misfit = rows @ ((heights - size * height) / error) + prior * [1.0 - size, 0.0]
        change = np.linalg.solve(rows @ rows.T + np.diag(prior), misfit)
        size += float(change[0])
        start += float(np.clip(change[1], -0.25 * window, 0.25 * window))
    return begun_ns + round(start * SECOND), size
