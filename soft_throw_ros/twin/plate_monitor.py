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
"""Watches a measured plate: takes its samples, and tells when a throw begins."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.twin.jump_filter import TYPICAL
from soft_throw_ros.twin.onset import find_engine_start, find_onset, Onset, REST_WINDOWS, RISE
from soft_throw_ros.twin.plate_estimator import (
    least_rate,
    PlateEstimator,
    PlateStates,
    Sample,
)
from soft_throw_ros.twin.results import State

MOST_NOISE = 1.5  # of the samples, in what it is said to be [-]
_CHECKING = 0.5  # from one look at it to the next [s]
_FEWEST_TO_CHECK = 30  # samples
_RATE_ERROR = 0.03  # of the rate of a sensor whose stamps jitter
_AT_REST = 15.0  # range of heights, in standard deviations, that is nothing but noise [-]
MOST_RISE = 100.0  # of the plate, in amplitudes of the engine: more is another unit [-]
_FALL = 0.5  # part of the plate's peak speed at which nobody lowers it [-]
_EARLY = 0.1  # rise of a projectile, in amplitudes of the engine, that is no noise [-]
_LAST_BEFORE = 3  # samples before the onset
_LEAST_RISE = 0.02  # of the plate's amplitude, which is looked at closely [-]
_SURE, _QUIET = 6.0, 4.0  # standard errors that are no noise, and that are nothing else


@dataclass
class SampleCounts:
    """Samples taken, of these after later ones and left out, and those refused, by reason."""

    taken: int = 0
    out_of_order: int = 0
    jumped: int = 0
    refused: Counter[str] = field(default_factory=Counter)


class PlateMonitor:
    """
    Watches a plate from one throw to the next.

    Parameters
    ----------
    config : MeasurementConfig
        How it is measured.
    counts : SampleCounts
        Where samples are counted.
    onset : Onset, optional
        Of the throw that has just begun: what was measured until then is kept.

    Attributes
    ----------
    estimator : PlateEstimator
        Samples in their order, and the motion through them.
    is_armed : bool
        Whether the plate is at rest, so that a throw starts when it jumps up.
    trusts_engine : bool
        Whether the engine has moved it in the last throw as it should.

    Notes
    -----
    The plate is at rest when for `REST_WINDOWS` windows it has not been faster than half of the
    speed of a start, or four standard errors, and no more when it has been for `RISE` of its
    period. A throw has begun when it goes upwards at that speed, and at six standard errors of
    it. The time of the start is found a window later, see `find_onset`; or at once, if the plate
    does as the engine should, see `find_engine_start`.

    """

    def __init__(
        self, config: MeasurementConfig, counts: SampleCounts, onset: Onset | None = None
    ) -> None:
        # `find_start` needs it, and a throw cannot wait for that
        import scipy.optimize  # noqa: F401

        self._counts = counts
        self.trusts_engine = onset is None or onset.trusts_engine
        self.estimator = PlateEstimator(
            config,
            origin_ns=None if onset is None else onset.onset_ns,
            samples=() if onset is None else onset.samples,
            refused=counts.refused,
        )
        self._wait_for_rest()
        self._problems: list[str] = []  # that have not been told
        self._told: set[str] = set()  # in this throw
        self._lowest, self._highest = math.inf, -math.inf  # of the smoothed heights
        # heights of the plate at rest and last seen, and of the plate when it last was slow: the
        # projectile goes with it then
        self._rest = self._height = self._carried = math.nan if onset is None else onset.rest.plate
        self._speed = self._carried_speed = 0.0

    def rearm(self, config: MeasurementConfig) -> None:
        """Wait for another rest before a throw, and measure as `config` says from now on."""
        if config != self.estimator.config:
            self.trusts_engine |= config.plate != self.estimator.config.plate
            self.estimator = PlateEstimator(config, refused=self._counts.refused)
            self._told.clear()
        self._wait_for_rest()

    def _wait_for_rest(self) -> None:
        self.is_armed = False
        self._first = math.nan  # when the plate was seen first, ...
        self._last_moving_time = -math.inf  # was last too fast to be at rest, ...
        self._last_quiet_time = -math.inf  # and was not,
        self._begun = math.inf  # and when it was fast enough to have started
        self._checked_time = math.nan  # when its noise was last
        self._rate_checked_ns = -math.inf  # the newest sample, when the rate was

    def take(self, samples: Sequence[Sample], now_ns: int) -> list[Sample]:
        """Take samples, or refuse and count them; return those taken."""
        newest_ns = self.estimator.newest_ns
        taken = self.estimator.take(samples, now_ns)
        self._counts.taken += len(taken)
        for sample in taken:
            self._counts.out_of_order += sample.stamp_ns < newest_ns
            newest_ns = max(newest_ns, sample.stamp_ns)
        return taken

    def advance(self, now_ns: int) -> tuple[PlateStates, Onset | None]:
        """Return how the plate has moved since the last call, and if a throw has begun, how."""
        before_ns, jumped = self.estimator.complete_ns, self.estimator.jumped
        motion = self.estimator.advance(now_ns)
        self._counts.jumped += self.estimator.jumped - jumped
        if motion.times.size:
            self._see(motion)
        onset = self._detect(motion)
        if onset is None and self.estimator.complete_ns > before_ns and self._may_have_started():
            onset = find_engine_start(self.estimator)
        if onset is None:
            return motion, None
        self.is_armed = False
        if self._has_swapped(onset):
            self._tell(
                'names',
                'the projectile has moved before the plate: if the names of the two joints are '
                'swapped in ~/measured_joint_states, swap them; no throw is followed',
            )
            return motion, None
        return motion, replace(onset, trusts_engine=self.trusts_engine)

    def problems(self) -> tuple[str, ...]:
        """Return what is wrong with the samples in sentences, each once in a throw."""
        found, self._problems = tuple(self._problems), []
        return found

    def _tell(self, kind: str, problem: str) -> None:
        if kind not in self._told:
            self._told.add(kind)
            self._problems.append(problem)

    def _has_swapped(self, onset: Onset) -> bool:
        """Tell whether the projectile has gone up before the plate, which no wave can do."""
        rest, plate = onset.rest, self.estimator.config.plate
        begin_ns = onset.onset_ns - self.estimator.config.smoothing_window_ns
        before = self.estimator.samples(begin_ns, onset.onset_ns)[-_LAST_BEFORE:]
        rises = [sample.projectile - rest.projectile for sample in before]
        least = max(_SURE * rest.noise, _EARLY * plate.amplitude)
        return len(rises) == _LAST_BEFORE and all(rise > least for rise in rises)

    def _check_noise(self, time: float) -> None:
        """Find a noise that hides that the plate is at rest."""
        if not self.is_armed and time - self._checked_time < _CHECKING:
            return
        self._checked_time = time
        if self.is_armed:
            return
        heights = np.array([sample.plate for sample in self.estimator.samples(-math.inf)])
        if heights.size < _FEWEST_TO_CHECK:
            return
        # second differences of what is even are six times as variable
        noise = float(np.median(np.abs(np.diff(heights, 2)))) / (TYPICAL * math.sqrt(6.0))
        given = self.estimator.config.position_noise
        if noise > MOST_NOISE * given and np.ptp(heights) < _AT_REST * noise:
            self._tell(
                'noise',
                f'the plate at rest scatters by {1e6 * noise:.3g} um, {noise / given:.1f} times '
                f'measured.position_noise {1e6 * given:.3g} um: set it, without which the plate '
                'may never seem at rest and no throw is followed',
            )

    def _check_heights(self, time: float) -> None:
        """Find heights that are in millimetres, or count downwards, by how the plate moves."""
        plate, window = self.estimator.config.plate, self.estimator.config.smoothing_window
        self._lowest = min(self._lowest, self._height)
        self._highest = max(self._highest, self._height)
        rise = self._highest - self._lowest
        if rise > MOST_RISE * plate.amplitude:
            self._tell(
                'units',
                f'the plate moves by {rise:.3g} m, {rise / plate.amplitude:.0f} times '
                'engine.amplitude: if heights are in millimetres, divide them by 1000',
            )
        since_rest = time - self._last_quiet_time
        is_falling = self._speed < -_FALL * plate.peak_velocity
        if self.is_armed and is_falling and since_rest < REST_WINDOWS * window:
            self._tell(
                'direction',
                f'the plate has jumped down, at {-self._speed:.3g} m/s: if heights count '
                'downwards, change their sign; no throw is followed',
            )

    def _may_have_started(self) -> bool:
        """Tell whether the last sample is above the plate at rest, if that is trusted to say."""
        if not (self.is_armed and self.trusts_engine):
            return False
        config, end_ns = self.estimator.config, self.estimator.complete_ns
        last = self.estimator.samples(end_ns - config.smoothing_window_ns, end_ns + 1)
        least = max(_SURE * config.position_noise, _LEAST_RISE * config.plate.amplitude)
        return bool(last) and last[-1].plate - self._height > least

    def _detect(self, motion: PlateStates) -> Onset | None:
        """Take in how the plate moves, and tell if it has begun to."""
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
                    begun, self._begun = self._begun, math.inf
                    self.is_armed = False
                    self._last_moving_time = time
                    onset = find_onset(
                        self.estimator, begun=begun, time=time, height=height, speed=speed
                    )
                    if onset is not None:
                        return onset
            elif self.is_armed and speed > max(start, _SURE * error):
                self._begun = time
            elif abs(speed) > max(0.5 * start, _QUIET * error):
                self._last_moving_time = time
                moving_time = time - self._last_quiet_time
                self.is_armed = self.is_armed and moving_time * config.plate.frequency <= RISE
            else:
                self._last_quiet_time = time
                if time - self._last_moving_time >= REST_WINDOWS * window:
                    self.is_armed = True
        return None

    def _see(self, motion: PlateStates) -> None:
        """Keep where the plate is."""
        self._height, self._speed, _ = motion.states[-1].tolist()
        self._check_heights(float(motion.times[-1]))
        self._check_noise(float(motion.times[-1]))
        if math.isnan(self._rest):
            self._rest = self._carried = self._height
        self._carried_speed = 0.0
        if abs(self._speed) < self.estimator.config.start_speed:
            self._carried, self._carried_speed = self._height, self._speed

    def state(self, rest: State) -> State:
        """Return the state of the plate, and of the projectile, which lies on the layer."""
        if math.isnan(self._rest):
            return rest
        return rest._replace(
            plate_position=rest.plate_position + self._height - self._rest,
            projectile_position=rest.projectile_position + self._carried - self._rest,
            plate_velocity=self._speed,
            projectile_velocity=self._carried_speed,
        )

    def is_blind(self) -> bool:
        """Tell, once in a throw, whether samples come, and too few to see any motion by."""
        newest_ns = self.estimator.newest_ns
        if self.is_armed or 'rate' in self._told or newest_ns == self._rate_checked_ns:
            return False  # a sensor that is silent is not looked at in every tick
        self._rate_checked_ns = newest_ns
        if self.estimator.rate() > 0.0 and self.rate_warning(math.inf):
            self._told.add('rate')
        return 'rate' in self._told

    def rate_warning(self, crossing_time: float) -> str:
        """Say it if there are too few samples for a throw to be followed; empty if not."""
        rate = self.estimator.rate()
        least, reason = least_rate(self.estimator.config, crossing_time)
        if rate >= (1.0 - _RATE_ERROR) * least:
            return ''
        return (
            f'the plate is measured at {rate:.0f} Hz, which must be at least {least:.0f} Hz, '
            f'{reason}: no throw is followed'
        )
