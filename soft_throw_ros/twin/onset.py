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
"""How a throw of a measured plate begins: the plate is at rest, and then jumps up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
import scipy  # its parts are imported where they are first used, which takes 0.3 s
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import BEHIND, FEWEST
from soft_throw_ros.twin.engine_fit import EngineFit
from soft_throw_ros.twin.jump_filter import TYPICAL
from soft_throw_ros.twin.plate_estimator import (
    Floats,
    PlateEstimator,
    Sample,
    state_spacing_ns,
    STATES_PER_WINDOW,
)
from soft_throw_ros.twin.tick_schedule import SECOND

REST_WINDOWS = 8  # so many windows the plate must be at rest before a throw
RISE = 0.125  # part of the plate's period in which it gets to the speed of a start [-]
_TOPS = 3  # parabolas, after which the top is where it is
_SURE = 6.0  # standard errors that are no noise
_LEAST_DETERMINANT = 1e-12  # below which samples do not tell how the plate's size changes [-]
MOST_AMPLITUDE = 2.0  # by which a motion may differ that is still the engine's, as a factor [-]


@dataclass(frozen=True, kw_only=True)
class Rest:
    """Plate and projectile before a throw."""

    plate: float  # mean heights; that of the projectile is NaN if it was not measured [m]
    projectile: float
    noise: float  # standard deviation of the plate's samples [m]
    error: float  # standard error of its mean [m]

    @classmethod
    def before(cls, estimator: PlateEstimator, end_ns: float) -> Rest | None:
        """Return how things were for some windows before a time; None without samples."""
        window_ns = estimator.config.smoothing_window_ns
        samples = estimator.samples(end_ns - (REST_WINDOWS - 1) * window_ns, end_ns)
        if len(samples) < FEWEST:
            return None
        _, plate, _, projectile = np.array(samples).T
        measured = projectile[np.isfinite(projectile)]
        # the noise is at least what it is said to be: rounded samples at rest are all the same
        noise = estimator.config.position_noise
        away = np.abs(plate - np.median(plate))
        plate = plate[away <= _SURE * max(noise, float(np.median(away)) / TYPICAL)]
        noise = max(noise, float(plate.std()))
        return cls(
            plate=float(plate.mean()),
            projectile=float(measured.mean()) if measured.size else math.nan,
            noise=noise,
            error=noise / math.sqrt(plate.size),
        )

    def engine_fit(self, config: MeasurementConfig, onset_ns: int) -> EngineFit:
        """Return what fits the engine's motion to the samples of a throw from here."""
        return EngineFit(
            config, origin_ns=onset_ns, rest=self.plate, rest_error=self.error, noise=self.noise
        )


@dataclass(frozen=True, kw_only=True)
class Onset:
    """The plate has begun to move."""

    onset_ns: int  # when, which is when the throw starts [ns]
    rest: Rest  # how things were before
    samples: tuple[Sample, ...]  # taken, in order, from a window before on
    trusts_engine: bool = True  # whether the engine did as it should when it was seen last


def find_onset(
    estimator: PlateEstimator, *, begun: float, time: float, height: float, speed: float
) -> Onset | None:
    """Find when the plate started that was fast at `begun`, if it still goes up a window later."""
    config = estimator.config
    assert estimator.origin_ns is not None
    window_ns = config.smoothing_window_ns
    rest_ns = estimator.origin_ns + round(begun * SECOND) - window_ns
    rest = Rest.before(estimator, rest_ns)
    if rest is None or speed <= config.start_speed:
        return None
    since = time_since_start(height - rest.plate, speed, config.plate)
    onset_ns = estimator.origin_ns + round((time - since) * SECOND)
    onset_ns += find_start(estimator.samples(rest_ns), onset_ns, rest.plate, config)
    if len(estimator.samples(onset_ns + 1, onset_ns + window_ns)) < FEWEST - 1:
        return None
    return Onset(
        onset_ns=onset_ns, rest=rest, samples=tuple(estimator.samples(onset_ns - window_ns))
    )


def find_engine_start(estimator: PlateEstimator) -> Onset | None:
    """
    Find when the plate started, by the first samples that have moved as the engine moves it.

    That takes about a millisecond from the start; None if it does not move, or not like this.
    """
    config, plate = estimator.config, estimator.config.plate
    end_ns = estimator.complete_ns
    margin_ns = max(config.smoothing_window_ns, round(RISE / plate.frequency * SECOND))
    rest = Rest.before(estimator, end_ns - margin_ns)
    samples = estimator.samples(end_ns - margin_ns, end_ns + 1)
    if rest is None or len(samples) < FEWEST:
        return None
    height = max(samples[-1].plate - rest.plate, 0.0)
    begun = math.sqrt(2.0 * height / plate.amplitude) / (2.0 * math.pi * plate.frequency)
    fit = rest.engine_fit(config, samples[-1].stamp_ns - round(begun * SECOND))
    estimate = fit.update(samples)
    if estimate is None:
        return None
    onset_ns = fit.origin_ns + round(estimate.start * SECOND)
    now = (samples[-1].stamp_ns - onset_ns) / SECOND
    ratio = estimate.plate.amplitude / plate.amplitude
    is_like_it = 1.0 / MOST_AMPLITUDE < ratio < MOST_AMPLITUDE
    if not is_like_it or estimate.plate.velocity(now) < config.start_speed:
        return None
    # from enough before it that the fit sees the plate at rest
    begin_ns = onset_ns - config.smoothing_window_ns
    return Onset(onset_ns=onset_ns, rest=rest, samples=tuple(estimator.samples(begin_ns)))


def first_states(
    samples: Sequence[Sample], start_ns: int, plate_rest: float, config: MeasurementConfig
) -> tuple[Floats, Floats]:
    r"""
    Return how the plate has started, for as long as a window would reach to before that.

    Parameters
    ----------
    samples : sequence of Sample
        Of the first window after the start, and others.
    start_ns : int
        When it started. [ns]
    plate_rest : float
        Height before. [m]
    config : MeasurementConfig
        How the plate is measured, and moves but for its amplitude.

    Returns
    -------
    times : ndarray, shape (n,)
        Since the start, the first 0. [s]
    states : ndarray, shape (n, 3)
        Height above rest [m], velocity [m/s], acceleration [m/s2].

    Notes
    -----
    No cubic goes round the corner where the plate starts, at which its acceleration jumps. So the
    first window after it is fitted apart, by an underdamped start from rest whose size changes
    linearly, :math:`(p + q t) z(t)`, by least squares.

    """
    plate, ratio = config.plate, config.position_noise / config.velocity_noise
    first = [
        sample
        for sample in samples
        if 0 < sample.stamp_ns - start_ns <= config.smoothing_window_ns
    ]
    since = np.array([sample.stamp_ns - start_ns for sample in first]) / SECOND
    heights = np.array([sample.plate for sample in first]) - plate_rest
    speeds = np.array([sample.plate_velocity for sample in first])
    measured = np.isfinite(speeds)
    position, velocity = plate.position(since), plate.velocity(since)
    sizes = np.concatenate((position, ratio * velocity[measured]))
    slopes = np.concatenate((since * position, ratio * (position + since * velocity)[measured]))
    values = np.concatenate((heights, ratio * speeds[measured]))
    a, b, c = (sizes * sizes).sum(), (sizes * slopes).sum(), (slopes * slopes).sum()
    right, below = (sizes * values).sum(), (slopes * values).sum()
    determinant = a * c - b * b
    if determinant > _LEAST_DETERMINANT * a * c:
        p, q = (c * right - b * below) / determinant, (a * below - b * right) / determinant
    else:  # a sample, or none, as after a gap
        p, q = right / a if a > 0.0 else 1.0, 0.0

    times = np.arange(round(BEHIND * STATES_PER_WINDOW)) * (state_spacing_ns(config) / SECOND)
    z, v = plate.position(times), plate.velocity(times)
    omega = 2.0 * math.pi * plate.frequency
    acceleration: Floats = omega**2 * (plate.amplitude - z) - 2.0 * plate.damping_ratio * omega * v
    size = p + q * times
    states = np.stack((size * z, size * v + q * z, size * acceleration + 2.0 * q * v), axis=1)
    return np.asarray(times), states


def time_since_start(height: float, speed: float, plate: Underdamped) -> float:
    r"""
    Find how long ago an underdamped plate started, whatever its amplitude.

    Its height over its speed is the same at one time only: without damping, that is
    :math:`\arctan(2 \pi f z / v) / \pi f`.

    Parameters
    ----------
    height, speed : float
        Of the plate, going up for the first time. [m], [m/s]
    plate : Underdamped
        Of the same frequency and damping.

    Returns
    -------
    float
        At most until the plate is highest. [s]

    Examples
    --------
    >>> plate = Underdamped(frequency=63.2, amplitude=1.0, damping_ratio=0.064)
    >>> round(time_since_start(3.0 * plate.position(2e-3), 3.0 * plate.velocity(2e-3), plate), 9)
    0.002

    """
    highest = math.pi / plate.exponent.imag
    ratio = max(height, 0.0) / speed
    if ratio == 0.0:
        return 0.0

    def excess(time: float) -> float:
        return float(plate.position(time) - ratio * plate.velocity(time))

    # until it is fastest, the plate has come less far than it would have at its speed now
    low = min(ratio, plate.peak_velocity_time)
    return float(scipy.optimize.brentq(excess, low, highest, xtol=1e-12))


def find_start(
    samples: Sequence[Sample], onset_ns: int, plate_rest: float, config: MeasurementConfig
) -> int:
    """
    Find when the plate has started, by least squares.

    Parameters
    ----------
    samples : sequence of Sample
        From before the start to about a window after it.
    onset_ns : int
        First guess, to a quarter of the window. [ns]
    plate_rest : float
        Height before the start. [m]
    config : MeasurementConfig
        How the plate is measured, and moves but for its amplitude.

    Returns
    -------
    int
        How much later than `onset_ns`. [ns]

    """
    since = np.array([sample.stamp_ns - onset_ns for sample in samples]) / SECOND
    heights = np.array([sample.plate for sample in samples]) - plate_rest

    def mismatch(later: float) -> float:
        shape = config.plate.position(since - later)
        energy = (shape * shape).sum()  # 0 if all samples are from before
        size = (shape * heights).sum() / energy if energy > 0.0 else 0.0
        return float(((heights - size * shape) ** 2).sum())

    reach = 0.25 * config.smoothing_window
    best = scipy.optimize.minimize_scalar(
        mismatch, bounds=(-reach, reach), method='bounded', options={'xatol': 1e-8}
    )
    return round(float(best.x) * SECOND)


def peak_speed(times: Sequence[float], speeds: Sequence[float], plate: Underdamped) -> float:
    """
    Find the largest of noisy speeds of about such a plate: the top of a parabola around it.

    It goes through a fifth of the period, in the middle of which is its own top. It is looked for
    from where it should be: around the largest of the speeds is where noise is.
    """
    time, speed = np.array(times), np.array(speeds)
    largest, half = float(speed.max()), 0.1 / plate.frequency
    top = plate.peak_velocity_time
    for _ in range(_TOPS):
        near = np.abs(time - top) <= half
        if near.sum() < 5 or time[-1] - top < 0.5 * half:
            return largest  # it still grows
        c, b, a = np.polyfit(time[near] - top, speed[near], 2).tolist()
        if c >= 0.0:
            return largest
        top -= float(np.clip(0.5 * b / c, -0.5 * half, 0.5 * half))
    return float(a - 0.25 * b * b / c)
