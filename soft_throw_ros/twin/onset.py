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
"""The onset of a throw of a measured plate: its rest before, and the time of its start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
import scipy  # imports its modules at their first use, which takes 0.3 s
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import BEHIND, FEWEST
from soft_throw_ros.twin.engine_fit import EngineFit, plate_states
from soft_throw_ros.twin.plate_estimator import (
    Floats,
    PlateEstimator,
    RestBaseline,
    state_spacing_ns,
    STATES_PER_WINDOW,
)
from soft_throw_ros.twin.sample_buffer import Rows, Sample, seconds_since, to_samples
from soft_throw_ros.twin.tick_schedule import SECOND

RISE = 0.125
"""Time until the plate reaches the speed of a start, over its period. [-]"""

MOST_AMPLITUDE = 2.0
"""Largest ratio of the fitted amplitude and the engine's amplitude, or its reciprocal. [-]"""

_PARABOLAS = 3
"""Parabolas that are fitted in turn to find the time of the largest speed. [-]"""

_MOST_FOR_START = 128
"""Most samples in the fit of the start, to bound its cost. [-]"""


@dataclass(frozen=True, kw_only=True)
class Onset:
    """The start of the plate's motion, and so of a throw."""

    onset_ns: int  # time of the start [ns]
    rest: RestBaseline
    samples: tuple[Sample, ...]  # sorted, from a window before the start on
    engine_is_nominal: bool = True  # whether the last motion was that of the engine
    stamp_scatter: float = 0.0  # standard deviation of stamps about an even rate [s]
    stamp_error: float = 0.0  # standard deviation of stamps in the last throw [s]

    def engine_fit(self, config: MeasurementConfig) -> EngineFit:
        """Return a fit of the engine's motion to the samples of the throw."""
        return EngineFit(
            config,
            origin_ns=self.onset_ns,
            rest=self.rest,
            stamp_scatter=self.stamp_scatter,
            stamp_error=self.stamp_error,
        )


def find_onset(
    estimator: PlateEstimator, *, begun_ns: int, time_ns: int, height: float, speed: float
) -> Onset | None:
    """Find the start of a plate that was fast at `begun_ns`, if it still rises a window later."""
    config = estimator.config
    window_ns = config.smoothing_window_ns
    rest_ns = begun_ns - window_ns
    rest = RestBaseline.before(estimator, rest_ns)
    if rest is None or speed <= config.start_speed:
        return None
    since = time_since_start(height - rest.plate, speed, config.plate)
    guess_ns = time_ns - round(since * SECOND)
    onset_ns = find_start(estimator.samples(rest_ns), guess_ns, rest.plate, config)
    if len(estimator.samples(onset_ns + 1, onset_ns + window_ns)) < FEWEST - 1:
        return None
    return _onset(estimator, onset_ns, rest)


def _onset(estimator: PlateEstimator, onset_ns: int, rest: RestBaseline) -> Onset:
    """Return an onset with enough samples of the rest before it for a fit."""
    begin_ns = onset_ns - estimator.config.smoothing_window_ns
    return Onset(
        onset_ns=onset_ns,
        rest=rest,
        samples=tuple(to_samples(estimator.samples(begin_ns))),
        stamp_scatter=estimator.stamp_scatter,
    )


def find_engine_start(
    estimator: PlateEstimator, begun_ns: int, stamp_error: float
) -> Onset | None:
    """
    Find the start of a plate that was fast at `begun_ns`, if it moves like the engine so far.

    The samples suffice one or two milliseconds after the start.
    """
    config, plate = estimator.config, estimator.config.plate
    margin_ns = max(config.smoothing_window_ns, round(RISE / plate.frequency * SECOND))
    rest = RestBaseline.before(estimator, begun_ns - margin_ns)
    samples = estimator.samples(begun_ns - margin_ns, estimator.complete_ns + 1)
    if rest is None or len(samples) < FEWEST:
        return None
    # a slow engine moves for many samples; a subset suffices
    samples = samples[::-math.ceil(len(samples) / _MOST_FOR_START)][::-1]
    acceleration = plate.amplitude * (2.0 * math.pi * plate.frequency) ** 2
    guess = Onset(
        onset_ns=begun_ns - round(config.start_speed / acceleration * SECOND),
        rest=rest,
        samples=(),
        stamp_scatter=estimator.stamp_scatter,
        stamp_error=stamp_error,
    )
    estimate = guess.engine_fit(config).update(samples)
    if estimate is None:
        return None
    now = (int(samples['stamp_ns'][-1]) - estimate.start_ns) / SECOND
    ratio = estimate.plate.amplitude / plate.amplitude
    is_like_it = 1.0 / MOST_AMPLITUDE < ratio < MOST_AMPLITUDE
    if not is_like_it or estimate.plate.velocity(now) < config.start_speed:
        return None
    return _onset(estimator, estimate.start_ns, rest)


def first_states(
    samples: Rows, start_ns: int, plate_rest: float, config: MeasurementConfig
) -> tuple[Floats, Floats]:
    r"""
    Return the states of the plate in the time after its start whose windows include the rest.

    A cubic cannot follow the jump of the acceleration at the start. Therefore the first window is
    fitted by the engine's motion with an amplitude that changes linearly, by least squares.

    Returns
    -------
    times : ndarray, shape (n,)
        Since the start, the first 0. [s]
    states : ndarray, shape (n, 3)
        Height above rest [m], velocity [m/s], acceleration [m/s2].

    """
    plate, ratio = config.plate, config.position_noise / config.velocity_noise
    since_ns = samples['stamp_ns'] - start_ns
    first = samples[(since_ns > 0) & (since_ns <= config.smoothing_window_ns)]
    since = seconds_since(start_ns, first)
    heights, speeds = first['plate'] - plate_rest, first['plate_velocity']
    measured = np.isfinite(speeds)
    position, velocity = plate.position(since), plate.velocity(since)
    sizes = np.concatenate((position, ratio * velocity[measured]))
    slopes = np.concatenate((since * position, ratio * (position + since * velocity)[measured]))
    values = np.concatenate((heights, ratio * speeds[measured]))
    # differences from the engine are the smallest possible ones if there are too few samples
    (p, q), *_ = np.linalg.lstsq(np.stack((sizes, slopes), axis=1), values - sizes)
    count = round(BEHIND * STATES_PER_WINDOW)
    times = state_spacing_ns(config) / SECOND * np.arange(count, dtype=np.float64)
    z, v, a = plate_states(plate, times).T
    size = 1.0 + p + q * times
    return times, np.stack((size * z, size * v + q * z, size * a + 2.0 * q * v), axis=1)


def time_since_start(height: float, speed: float, plate: Underdamped) -> float:
    r"""
    Return the time since the start of an underdamped plate of unknown amplitude.

    The ratio of height [m] and speed [m/s] determines the time, at most that of the largest height
    [s]: without damping it is :math:`\arctan(2 \pi f z / v) / \pi f`.
    """
    highest = math.pi / plate.exponent.imag
    ratio = max(height, 0.0) / speed
    if ratio == 0.0:
        return 0.0

    def excess(time: float) -> float:
        return float(plate.position(time) - ratio * plate.velocity(time))

    # before its largest speed, the plate has risen less than it would have at its present speed
    low = min(ratio, plate.peak_velocity_time)
    return float(scipy.optimize.brentq(excess, low, highest, xtol=1e-12))


def find_start(
    samples: Rows, onset_ns: int, plate_rest: float, config: MeasurementConfig
) -> int:
    """
    Return the start of the plate by least squares, within a quarter of a window of a guess [ns].

    The samples are from before the start to about a window after it.
    """
    since, heights = seconds_since(onset_ns, samples), samples['plate'] - plate_rest

    def mismatch(later: float) -> float:
        shape = config.plate.position(since - later)
        energy = (shape * shape).sum()  # 0 if all samples are from before
        size = (shape * heights).sum() / energy if energy > 0.0 else 0.0
        return float(((heights - size * shape) ** 2).sum())

    reach = 0.25 * config.smoothing_window
    best = scipy.optimize.minimize_scalar(
        mismatch, bounds=(-reach, reach), method='bounded', options={'xatol': 1e-8}
    )
    return onset_ns + round(float(best.x) * SECOND)


def peak_speed(times: Sequence[float], speeds: Sequence[float], plate: Underdamped) -> float:
    """
    Return the largest speed of a plate from noisy speeds, as the maximum of a parabola.

    The parabola is fitted to a fifth of the period around its own maximum. The iteration starts
    at the expected time of the maximum, because the largest sample may be noise.
    """
    time, speed = np.array(times), np.array(speeds)
    largest, half = float(speed.max()), 0.1 / plate.frequency
    top = plate.peak_velocity_time
    for _ in range(_PARABOLAS):
        near = np.abs(time - top) <= half
        if near.sum() < 5 or time[-1] - top < 0.5 * half:
            return largest  # the speed still grows
        c, b, a = np.polyfit(time[near] - top, speed[near], 2).tolist()
        if c >= 0.0:
            return largest
        top -= float(np.clip(0.5 * b / c, -0.5 * half, 0.5 * half))
    return float(a - 0.25 * b * b / c)
