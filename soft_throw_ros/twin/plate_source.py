# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The motion of a measured plate in a throw, by the fitted engine or by smoothed samples.

`MeasuredPlate` has all estimates of the motion. The states of a stepper's plate are from an
`EngineEstimate`, or from `SmoothedSamples`.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
import scipy  # imports its modules at their first use, which takes 0.3 s
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import BEHIND
from soft_throw_ros.twin.engine_fit import (
    EngineEstimate,
    EngineFit,
    largest_by_chance,
    plate_states,
)
from soft_throw_ros.twin.engine_forecast import EngineForecaster, ReleaseErrors
from soft_throw_ros.twin.plate_estimator import (
    Floats,
    Onset,
    PlateEstimator,
    PlateStates,
    state_spacing_ns,
    STATES_PER_WINDOW,
)
from soft_throw_ros.twin.sample_buffer import Rows, seconds_since
from soft_throw_ros.twin.tick_schedule import SECOND

_PARABOLAS = 3
"""Parabolas that are fitted in turn to find the time of the largest speed. [-]"""
_TIME, _SPEED, _TRANSFER = 1.0, 0.4, 1.4
"""
Relative errors of a release's time, speed and energy transfer over that of the smoothed velocity,
as trials have them. [-]
"""
_MIN_SPACING = 0.99
"""Smallest interval between joined states, over that of smoothed states. [-]"""
_FIRST_WINDOWS = 1.5
"""Windows after the onset until the start of a smoothed plate is fitted. [-]"""
_NOISY = 0.035
"""
Largest error of the smoothed velocity over the peak speed of the plate. Of 30 simulated throws all
are right with 0.03; noise releases the projectile too early in 3 with 0.045, and in 17 with 0.09.
[-]
"""
_SIGNIFICANT_CHANGE = 0.1
"""Change of a release that starts a new simulation of the throw, in standard errors. [-]"""
_SIGNIFICANT = 2.6
"""Standard normal quantile beyond which residuals are larger than noise. [-]"""


class SmoothedSamples:
    """Motion of the plate by its smoothed samples; every state is returned once."""

    def __init__(self, onset: Onset, estimator: PlateEstimator) -> None:
        self.start_ns = onset.onset_ns  # of the throw, the origin of times [ns]
        self._onset = onset
        self._estimator = estimator
        self._motions: list[PlateStates] = []  # not returned yet
        self._errors: list[float] = []  # of velocities [m/s]
        self._misfit = np.zeros(2)  # sum of squares and degrees of freedom, see `PlateStates`

    def add(self, motion: PlateStates) -> None:
        """Add the motion since the last call, by the clock of the estimator."""
        if motion.times.size:
            self._motions.append(motion)
            self._errors += motion.errors.tolist()
            moving = motion.times > self._estimator.config.smoothing_window
            self._misfit += motion.misfits[moving].sum(axis=0)

    def find_start(self) -> bool:
        """Find the start of the plate; return whether there are enough samples."""
        onset, config = self._onset, self._estimator.config
        window_ns = config.smoothing_window_ns
        end_ns = onset.onset_ns + round(_FIRST_WINDOWS * window_ns)
        if self._estimator.complete_ns < end_ns:
            return False
        samples = self._estimator.samples(onset.onset_ns - window_ns, end_ns + 1)
        self.start_ns = find_start(samples, onset.onset_ns, onset.rest.plate, config)
        self._first = first_states(samples, self.start_ns, onset.rest.plate, config)
        return True

    def states(self, after: float, complete_ns: float) -> tuple[Floats, Floats]:  # noqa: ARG002
        """
        Return the states until samples are complete, later than the last one before, if any.

        `after` is the time of the last one [s], or negative. The results are increasing times,
        shape (n,) [s], and height above rest [m], velocity [m/s] and acceleration [m/s2], shape
        (n, 3). The states of the first window are from a fit of their own.
        """
        times, states = [np.empty(0)], [np.empty((0, 3))]
        if after < 0.0:
            times, states = [self._first[0]], [self._first[1]]
            after = float(self._first[0][-1])
        shift = (self._onset.onset_ns - self.start_ns) / SECOND
        after += _MIN_SPACING * state_spacing_ns(self._estimator.config) / SECOND
        for known in self._motions:
            later = known.times + shift > after
            times.append(known.times[later] + shift)
            states.append(known.states[later] - [self._onset.rest.plate, 0.0, 0.0])
        self._motions.clear()
        return np.concatenate(times), np.concatenate(states)

    def velocity_error(self) -> float:
        """
        Return the standard error of the smoothed velocity [m/s], infinite if nothing is known.

        Errors of the stamps make the error larger, as at the peak speed of the plate. So do
        residuals that are larger than noise explains, by one standard deviation more than they
        are, so that few samples overestimate it. Windows that overlap share their residuals.
        """
        if not self._errors:
            return math.inf
        config = self._estimator.config
        squares, freedom = self._misfit.tolist()
        independent = max(freedom / STATES_PER_WINDOW, 1.0)
        ratio, excess = squares / max(freedom, 1.0), 1.0
        if ratio > largest_by_chance(independent, _SIGNIFICANT) / independent:
            excess = ratio * (1.0 + math.sqrt(2.0 / independent))
        displacement = config.plate.peak_velocity * config.stamp_error / config.position_noise
        excess = max(excess, 1.0 + displacement**2)
        return float(np.median(self._errors)) * math.sqrt(excess)

    def peak_speed(self, times: Sequence[float], speeds: Sequence[float]) -> float:
        """Return the largest speed until now, at least the speed of a start [m/s]."""
        config = self._estimator.config
        largest = peak_speed(times, speeds, config.plate) if speeds else 0.0
        return max(largest, config.start_speed)


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
    plate = config.plate
    since_ns = samples['stamp_ns'] - start_ns
    first = samples[(since_ns > 0) & (since_ns <= config.smoothing_window_ns)]
    since = seconds_since(start_ns, first)
    sizes = plate.position(since)
    basis, heights = np.stack((sizes, since * sizes), axis=1), first['plate'] - plate_rest
    # differences from the engine are the smallest possible ones if there are too few samples
    (p, q), *_ = np.linalg.lstsq(basis, heights - sizes, rcond=None)
    count = round(BEHIND * STATES_PER_WINDOW)
    times = state_spacing_ns(config) / SECOND * np.arange(count, dtype=np.float64)
    z, v, a = plate_states(plate, times).T
    size = 1.0 + p + q * times
    return times, np.stack((size * z, size * v + q * z, size * a + 2.0 * q * v), axis=1)


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


class MeasuredPlate:
    """The plate in a throw from its onset on: its samples, smoothed and fitted by the engine."""

    def __init__(
        self, onset: Onset, estimator: PlateEstimator, forecaster: EngineForecaster | None
    ) -> None:
        self.onset = onset
        self.estimator = estimator
        self.smoothed = SmoothedSamples(onset, estimator)
        self.fit = EngineFit(estimator.config, onset)  # to a period; the plate may rest later
        # whether the plate is assumed to move as the engine should
        self.relies_on_engine = onset.engine_is_nominal and forecaster is not None
        self._forecaster = forecaster
        self._fit_end_ns = onset.onset_ns + round(SECOND / estimator.config.plate.frequency)

    @property
    def forecaster(self) -> EngineForecaster:
        """The forecaster, which exists if the twin relies on the engine."""
        assert self._forecaster is not None
        return self._forecaster

    @property
    def is_fit_over(self) -> bool:
        """Whether the fit has failed, or has the samples of a period of the plate."""
        return self.fit.has_failed or self.estimator.complete_ns > self._fit_end_ns

    @property
    def is_noisy(self) -> bool:
        """Whether the noise of the smoothed plate may release a projectile too early."""
        peak_speed = self.estimator.config.plate.peak_velocity
        return self.smoothed.velocity_error() > _NOISY * peak_speed

    def add(self, motion: PlateStates) -> None:
        """Add the motion since the last call, and fit the engine to the new samples."""
        self.smoothed.add(motion)
        if not self.fit.has_failed:
            end_ns = min(self.estimator.complete_ns, self._fit_end_ns)
            rows = self.estimator.samples(self.fit.next_ns, end_ns + 1)
            if len(rows):
                self.fit.update(rows)

    def newer_estimate(self, simulated: EngineEstimate | None) -> EngineEstimate | None:
        """Return the latest estimate if its release differs from that of the simulated one."""
        latest = self.fit.estimate
        if latest is None or latest is simulated:
            return None
        if simulated is None:
            return latest
        changes, errors = self.forecaster.change(simulated, latest), self.forecaster.errors(latest)
        is_different = any(
            abs(change) > _SIGNIFICANT_CHANGE * error
            for change, error in zip(changes, errors, strict=True)
        )
        return latest if is_different else None

    def release_errors(
        self, time: float, simulated: EngineEstimate | None, peak_speed: float
    ) -> ReleaseErrors:
        """Return the errors of a release at a time, by an estimate or by the smoothed plate."""
        if simulated is None or self.fit.estimate is None:
            speed = self.smoothed.velocity_error() / peak_speed
            return ReleaseErrors(_TIME * speed * time, _SPEED * speed, _TRANSFER * speed)
        changes = self.forecaster.change(simulated, self.fit.estimate)
        errors = self.forecaster.errors(self.fit.estimate)
        return ReleaseErrors(*map(math.hypot, errors, changes))
