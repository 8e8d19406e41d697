# SPDX-License-Identifier: Apache-2.0
"""How a throw of a measured plate begins: the plate is at rest, and then jumps up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import BEHIND, FEWEST
from soft_throw_ros.twin.plate_estimator import (
    Floats,
    PlateEstimator,
    Sample,
    state_spacing_ns,
    STATES_PER_WINDOW,
)
from soft_throw_ros.twin.tick_schedule import SECOND

REST_WINDOWS = 8  # so many windows the plate must be at rest before a throw


@dataclass(frozen=True, kw_only=True)
class Onset:
    """The plate has begun to move."""

    onset_ns: int  # when, which is when the throw starts [ns]
    plate_rest: float  # where they were measured before [m]
    projectile_rest: float  # NaN if it was not [m]
    samples: tuple[Sample, ...]  # taken, in order, from a window before on


def find_onset(
    estimator: PlateEstimator, *, begun: float, time: float, height: float, speed: float
) -> Onset | None:
    """Find when the plate started that was fast at `begun`, if it still goes up a window later."""
    config = estimator.config
    assert estimator.origin_ns is not None
    window_ns = config.smoothing_window_ns
    begun_ns = estimator.origin_ns + round(begun * SECOND)
    at_rest = estimator.samples(begun_ns - REST_WINDOWS * window_ns, begun_ns - window_ns)
    if not at_rest or speed <= config.start_speed:
        return None
    _, plate, _, projectile = np.array(at_rest).T
    plate_rest = float(plate.mean())
    measured = projectile[np.isfinite(projectile)]
    since = time_since_start(height - plate_rest, speed, config.plate)
    onset_ns = estimator.origin_ns + round((time - since) * SECOND)
    onset_ns += find_start(estimator.samples(at_rest[-1].stamp_ns), onset_ns, plate_rest, config)
    if len(estimator.samples(onset_ns + 1, onset_ns + window_ns)) < FEWEST - 1:
        return None
    return Onset(
        onset_ns=onset_ns,
        plate_rest=plate_rest,
        projectile_rest=float(measured.mean()) if measured.size else math.nan,
        samples=tuple(estimator.samples(onset_ns - window_ns)),
    )


def first_states(onset: Onset, config: MeasurementConfig) -> tuple[Floats, Floats]:
    r"""
    Return how the plate has started, for as long as a window would reach to before that.

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
        for sample in onset.samples
        if 0 < sample.stamp_ns - onset.onset_ns <= config.smoothing_window_ns
    ]
    since = np.array([sample.stamp_ns - onset.onset_ns for sample in first]) / SECOND
    heights = np.array([sample.plate for sample in first]) - onset.plate_rest
    speeds = np.array([sample.plate_velocity for sample in first])
    measured = np.isfinite(speeds)
    position, velocity = plate.position(since), plate.velocity(since)
    sizes = np.concatenate((position, ratio * velocity[measured]))
    slopes = np.concatenate((since * position, ratio * (position + since * velocity)[measured]))
    values = np.concatenate((heights, ratio * speeds[measured]))
    a, b, c = (sizes * sizes).sum(), (sizes * slopes).sum(), (slopes * slopes).sum()
    right, below = (sizes * values).sum(), (slopes * values).sum()
    determinant = a * c - b * b
    p, q = (c * right - b * below) / determinant, (a * below - b * right) / determinant

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
    return float(brentq(excess, min(ratio, plate.peak_velocity_time), highest, xtol=1e-12))


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
        size = (shape * heights).sum() / (shape * shape).sum()
        return float(((heights - size * shape) ** 2).sum())

    reach = 0.25 * config.smoothing_window
    best = minimize_scalar(
        mismatch, bounds=(-reach, reach), method='bounded', options={'xatol': 1e-8}
    )
    return round(float(best.x) * SECOND)


def peak_speed(times: Sequence[float], speeds: Sequence[float], period: float) -> float:
    """
    Find the largest of noisy speeds, by a parabola through those around it.

    It goes through an eighth of the plate's period [s].
    """
    time, speed = np.array(times), np.array(speeds)
    largest = int(np.argmax(speed))
    since = time - time[largest]
    near = np.abs(since) <= period / 16.0
    if near.sum() < 5 or since[-1] < period / 16.0:
        return float(speed[largest])
    c, b, a = np.polyfit(since[near], speed[near], 2).tolist()
    return a - 0.25 * b * b / c if c < 0.0 else float(speed[largest])
