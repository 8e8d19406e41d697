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
r"""
The engine's motion fitted to the samples of a throw.

Notes
-----
The model is the damped step :math:`z_0 + A\,s(t - t_0; f, \zeta)` of `core.plate.Underdamped`.
Amplitude and start are free; frequency, damping ratio and height at rest are known to an error,
which is their prior. New samples are added to the fit, and Gauss-Newton steps go on from the last
solution. That is the iterated extended Kalman filter without process noise [1]_. The last
`_KEPT` to `_MOST` samples are kept and tested again in every step; older ones stay in the normal
equations only, linearised at their last solution. So the cost of a step does not grow with the
duration of the throw.

A stamp with the error :math:`\sigma_t` displaces a height by :math:`\dot z \sigma_t` and a
velocity by :math:`\ddot z \sigma_t`. If the residuals grow with the speed, and are as uneven as
noise, :math:`\sigma_t` is estimated by the method of Paule and Mandel for the variance between
laboratories [2]_: the weighted sum of squares has its expected value, less a standard deviation,
so that few samples overestimate :math:`\sigma_t`. Its upper bound is twice the scatter of the
stamps about an even rate.

A sample is an outlier if its residual exceeds six standard errors of sample and prediction
together; outliers are ignored. The fit fails after three outliers in a row, or if a test rejects
the residuals at a significance of 1 / 20000. The tests are the sum of squares of all samples, the
sum of squares of the last eight, and the changes of frequency and damping ratio; the variance of a
change is the variance of the prior less the variance of the estimate. If the residuals are as
uneven as noise (by the ratio of Durbin and Watson), the noise is larger than at rest, for example
because heights are rounded, and the standard errors grow in proportion.

References
----------
.. [1] B. M. Bell and F. W. Cathey, "The iterated Kalman filter update as a Gauss-Newton method",
   IEEE Trans. Automat. Contr. 38 (1993) 294.
.. [2] R. C. Paule and J. Mandel, "Consensus values and weighting factors", J. Res. Natl. Bur.
   Stand. 87 (1982) 377.

"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import factorise, solve
from soft_throw_ros.twin.outlier_filter import MAX_OUTLIERS_IN_A_ROW, OUTLIER_SIGMAS
from soft_throw_ros.twin.plate_estimator import MOST_SCATTER
from soft_throw_ros.twin.sample_buffer import Rows, seconds_since

Floats = NDArray[np.float64]

AMPLITUDE, START, FREQUENCY, DAMPING, REST = range(5)
"""
Indices of the unknowns: relative changes of the engine's amplitude and frequency [-], the start
[s], the change of the damping ratio [-], and the height at rest [m].
"""

FEWEST = 4
"""Fewest samples after the start of motion that give an estimate. [-]"""

_AMPLITUDE_ERROR = 0.5
"""Relative standard error of the amplitude before the throw. [-]"""
_START_ERROR = 1e-3
"""Standard error of the start before the throw. [s]"""
_TIGHTEST = 1e-6
"""Least relative standard error of a value that the settings call exact. [-]"""
_RECENT_SAMPLES = 8
"""Newest samples, which have a test of their own for their sum of squares. [-]"""
_REJECTION_QUANTILE = 3.9
"""Standard normal quantile of 1 / 20000. [-]"""
_SUSPICION, _EARLY_SUSPICION = 1.645, 3.09
"""
Standard normal quantiles of 1 / 20, and of 1 / 1000 with fewer than `_FEWEST_FOR_NOISE` moving
samples, beyond which stamps are taken to be wrong. [-]
"""
_FEWEST_FOR_NOISE = 12
"""Fewest samples that distinguish noise from another motion. [-]"""
_MIN_DURBIN_WATSON = 1.0
"""Least ratio of Durbin and Watson of noise; it is 2 for white noise, 0 for a motion. [-]"""
_HALVINGS = 20
"""Bisections of the error of stamps, which leave a millionth. [-]"""
_MOST_STEPS = 8
"""Gauss-Newton steps of one update. [-]"""
_CONVERGED = 1e-2
"""Largest last step, in standard errors. [-]"""
_SLOPE = 1e-4
"""Change of the damping ratio for a difference quotient. [-]"""

_KEPT, _MOST = 128, 256
"""Samples kept after older ones went into the normal equations, and before. [-]"""

_LEFT_OUT, _NORMALISED, _ERROR, _SPEED, _LEVERAGE = range(5)
"""
Columns of the residuals: whether the sample is an outlier, the residual over its standard error
[-], the residual [m], the speed of the plate [m/s], and the variance of the fit there [m2].
"""

_ENGINE = np.dtype(
    [
        ('amplitude', 'f8'),  # [m]
        ('omega', 'f8'),  # angular frequency [1/s]
        ('zeta', 'f8'),  # damping ratio [-]
        ('height_noise', 'f8'),  # standard deviation of heights [m]
        ('speed_noise', 'f8'),  # of speeds [m/s]
        ('stamp_error', 'f8'),  # of stamps [s]
        ('most_stamp_error', 'f8'),  # largest possible one [s]
    ],
    align=True,
)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


@_jit
def _shape(time: float, omega: float, zeta: float) -> tuple[float, float, float]:
    """Evaluate height, velocity and acceleration of a damped step of height 1."""
    root = math.sqrt(1.0 - zeta * zeta)
    decayed, phase = math.exp(-zeta * omega * time), root * omega * time
    sine = math.sin(phase) / root
    height = 1.0 - decayed * (math.cos(phase) + zeta * sine)
    speed = omega * decayed * sine
    return height, speed, omega * (omega * (1.0 - height) - 2.0 * zeta * speed)


@_jit
def _add_up(
    samples: Floats,
    engine: NDArray[np.void],
    x: Floats,
    covariance: Floats,
    normal: Floats,
    right: Floats,
    residuals: Floats,
) -> None:
    """Add samples (time, height, speed) to the normal equations; write their residuals."""
    e = engine[0]
    amplitude = e.amplitude * (1.0 + x[AMPLITUDE])
    omega, zeta = e.omega * (1.0 + x[FREQUENCY]), e.zeta + x[DAMPING]
    by_height, by_speed = np.zeros(5), np.zeros(5)  # derivatives by the unknowns
    by_height[REST] = 1.0
    for n in range(len(samples)):
        since = samples[n, 0] - x[START]
        height, speed, acceleration = 0.0, 0.0, 0.0
        by_height[:REST] = 0.0
        if since > 0.0:
            height, speed, acceleration = _shape(since, omega, zeta)
            above, faster, _ = _shape(since, omega, zeta + _SLOPE)
            by_height[AMPLITUDE], by_speed[AMPLITUDE] = e.amplitude * height, e.amplitude * speed
            by_height[START], by_speed[START] = -amplitude * speed, -amplitude * acceleration
            stretch = amplitude / (1.0 + x[FREQUENCY])
            by_height[FREQUENCY] = stretch * since * speed
            by_speed[FREQUENCY] = stretch * (speed + since * acceleration)
            by_height[DAMPING] = amplitude * (above - height) / _SLOPE
            by_speed[DAMPING] = amplitude * (faster - speed) / _SLOPE
        speed, acceleration = amplitude * speed, amplitude * acceleration
        error = samples[n, 1] - x[REST] - amplitude * height
        leverage = 0.0
        for i in range(5):
            for j in range(5):
                leverage += by_height[i] * covariance[i, j] * by_height[j]
        variance = e.height_noise**2 + (speed * e.stamp_error) ** 2
        largest = e.height_noise**2 + (speed * e.most_stamp_error) ** 2 + leverage
        is_left_out = error * error > OUTLIER_SIGMAS * OUTLIER_SIGMAS * largest
        row = residuals[n]
        row[_LEFT_OUT], row[_NORMALISED] = is_left_out, error / math.sqrt(variance)
        row[_ERROR], row[_SPEED], row[_LEVERAGE] = error, speed, leverage
        if is_left_out:
            continue
        _add(normal, right, by_height, error, variance)
        if since > 0.0 and np.isfinite(samples[n, 2]):
            variance = e.speed_noise**2 + (acceleration * e.stamp_error) ** 2
            _add(normal, right, by_speed, samples[n, 2] - speed, variance)


@_jit
def _add(normal: Floats, right: Floats, row: Floats, error: float, variance: float) -> None:
    """Add an equation to the normal equations."""
    for i in range(5):
        right[i] += row[i] * error / variance
        for j in range(5):
            normal[i, j] += row[i] * row[j] / variance


@_jit
def _fit(
    samples: Floats,
    engine: NDArray[np.void],
    information: Floats,
    pull: Floats,
    x: Floats,
    covariance: Floats,
    residuals: Floats,
) -> bool:
    """
    Solve for the best unknowns `x`, from the last solution; return whether a solution exists.

    `information` and `pull` are the normal equations, about the origin, of the prior and of
    older samples.
    """
    normal, right, scale = np.empty((5, 5)), np.empty(5), np.empty(5)
    e = engine[0]
    for _ in range(_MOST_STEPS):
        normal[:] = information
        right[:] = pull
        for i in range(5):
            for j in range(5):
                right[i] -= information[i, j] * x[j]
        _add_up(samples, engine, x, covariance, normal, right, residuals)
        for i in range(5):
            scale[i] = 1.0 / math.sqrt(normal[i, i])
        for i in range(5):  # units differ by ten orders of magnitude
            right[i] *= scale[i]
            for j in range(5):
                normal[i, j] *= scale[i] * scale[j]
        if not factorise(normal):
            return False
        solve(normal, right)
        has_converged = True
        for i in range(5):
            column = covariance[i]
            column[:] = 0.0
            column[i] = 1.0
            solve(normal, column)
            has_converged &= right[i] * right[i] < _CONVERGED * _CONVERGED * column[i]
            x[i] += scale[i] * right[i]
            for j in range(5):
                column[j] *= scale[i] * scale[j]
        x[DAMPING] = max(x[DAMPING], -e.zeta)
        if x[AMPLITUDE] <= -1.0 or x[FREQUENCY] <= -1.0 or e.zeta + x[DAMPING] >= 1.0:
            return False
        if has_converged:
            break
    return True


@_jit
def _condense(
    samples: Floats,
    engine: NDArray[np.void],
    x: Floats,
    covariance: Floats,
    information: Floats,
    pull: Floats,
    residuals: Floats,
) -> None:
    """Add samples to the prior information, linearised at the unknowns `x`."""
    normal, right = np.zeros((5, 5)), np.zeros(5)
    _add_up(samples, engine, x, covariance, normal, right, residuals)
    for i in range(5):
        pull[i] += right[i]
        for j in range(5):
            pull[i] += normal[i, j] * x[j]
            information[i, j] += normal[i, j]


@_jit
def _stamp_error(residuals: Floats, engine: NDArray[np.void]) -> float:
    """Estimate the standard error of stamps by residuals that grow with the speed [s]."""
    e = engine[0]
    high = e.most_stamp_error
    total, expected, count = _excess(residuals, e.height_noise, 0.0)
    if count < FEWEST:
        return e.stamp_error  # type: ignore[no-any-return]
    suspicion = _SUSPICION if count >= _FEWEST_FOR_NOISE else _EARLY_SUSPICION
    if total <= largest_by_chance(expected, suspicion):
        return 0.0
    if not _is_noise(residuals, e.height_noise, high):
        return e.stamp_error  # type: ignore[no-any-return]
    low = 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        total, expected, _ = _excess(residuals, e.height_noise, middle)
        if total > expected - math.sqrt(2.0 * expected):
            low = middle
        else:
            high = middle
    return high  # type: ignore[no-any-return]


@_jit
def _excess(residuals: Floats, noise: float, stamp_error: float) -> tuple[float, float, int]:
    """Return the weighted squares of moving samples, their expectation, and how many there are."""
    total, expected, count = 0.0, 0.0, 0
    for n in range(len(residuals)):
        row = residuals[n]
        if row[_LEFT_OUT] or row[_SPEED] == 0.0:
            continue
        variance = noise * noise + (row[_SPEED] * stamp_error) ** 2
        total += row[_ERROR] ** 2 / variance
        expected += max(1.0 - row[_LEVERAGE] / variance, 0.0)
        count += 1
    return total, max(expected, 1.0), count


@_jit
def _is_noise(residuals: Floats, noise: float, stamp_error: float) -> bool:
    """Return whether moving samples are as uneven as noise, by the ratio of Durbin and Watson."""
    squares, steps, before = 0.0, 0.0, math.nan
    for n in range(len(residuals)):
        row = residuals[n]
        if row[_LEFT_OUT] or row[_SPEED] == 0.0:
            continue
        value = row[_ERROR] / math.sqrt(noise * noise + (row[_SPEED] * stamp_error) ** 2)
        squares += value * value
        if not math.isnan(before):
            steps += (value - before) ** 2
        before = value
    return steps >= _MIN_DURBIN_WATSON * squares


@_jit
def largest_by_chance(count: float, quantile: float) -> float:
    """Return the sum of `count` squares of standard normal numbers at a normal quantile [-]."""
    part = 2.0 / (9.0 * max(count, 1.0))  # Wilson and Hilferty, Proc. Natl. Acad. Sci. 17 (1931)
    return float(count * (1.0 - part + quantile * math.sqrt(part)) ** 3)


@_jit
def damped_states(
    times: Floats, amplitude: float, omega: float, zeta: float, states: Floats
) -> None:
    """Write height, velocity and acceleration of a damped step at times since its start."""
    for n in range(times.size):
        height, speed, acceleration = _shape(times[n], omega, zeta)
        states[n, 0], states[n, 1] = amplitude * height, amplitude * speed
        states[n, 2] = amplitude * acceleration


@dataclass(frozen=True)
class EngineEstimate:
    """
    The fitted motion of the engine in a throw.

    Attributes
    ----------
    start : float
        After the time that the fit counts from. [s]
    plate : Underdamped
        Motion of the plate.
    rest : float
        Height of the plate before. [m]
    unknowns : ndarray, shape (5,)
        The solution, see `AMPLITUDE`.
    covariance : ndarray, shape (5, 5)
        Covariance of the unknowns.
    stamp_error : float
        Standard deviation of the stamps. [s]

    """

    start: float
    plate: Underdamped
    rest: float
    unknowns: Floats
    covariance: Floats
    stamp_error: float = 0.0

    def states(self, times: Floats) -> Floats:
        """Return height above rest, velocity and acceleration at times since the start."""
        plate, states = self.plate, np.empty((times.size, 3))
        omega = 2.0 * math.pi * plate.frequency
        damped_states(times, plate.amplitude, omega, plate.damping_ratio, states)
        return states


class EngineFit:
    """
    Fits the engine's motion to the samples of a throw, see the module.

    Parameters
    ----------
    config : MeasurementConfig
        How the plate is measured, and how its engine moves it.
    origin_ns : int
        Time that `start` counts from, within a millisecond of the start. [ns]
    rest, rest_error : float
        Height before the throw, and its standard error. [m]
    noise : float
        Standard deviation of heights. [m]
    stamp_scatter, stamp_error : float
        Standard deviation of the stamps about an even rate, and as far as it is known that they
        are wrong. [s]

    Attributes
    ----------
    has_failed : bool
        Whether the plate has not moved as the engine should.
    stamp_error : float
        Standard deviation of the stamps by the last fit. [s]

    """

    def __init__(
        self,
        config: MeasurementConfig,
        *,
        origin_ns: int,
        rest: float,
        rest_error: float,
        noise: float,
        stamp_scatter: float = 0.0,
        stamp_error: float = 0.0,
    ) -> None:
        plate = config.plate
        self.has_failed = False
        self.origin_ns = origin_ns
        self._samples = np.empty((_MOST, 3))
        self._residuals = np.zeros((_MOST, 5))
        self._count = 0  # of the samples kept
        self._condensed_left_out = 0
        self._known_stamp_error = stamp_error  # by earlier throws [s]
        self._engine = np.zeros(1, _ENGINE)
        most_stamp_error = max(MOST_SCATTER * stamp_scatter, stamp_error)
        self._engine[0] = (
            plate.amplitude,
            2.0 * math.pi * plate.frequency,
            plate.damping_ratio,
            noise,
            noise / config.position_noise * config.velocity_noise,
            stamp_error,
            most_stamp_error,
        )
        errors = [
            _AMPLITUDE_ERROR,
            _START_ERROR,
            max(config.frequency_error / plate.frequency, _TIGHTEST),
            max(config.damping_error, _TIGHTEST),
            max(rest_error, _TIGHTEST * plate.amplitude),
        ]
        self._variances = np.array(errors) ** 2  # before the throw
        self._information = np.diag(1.0 / self._variances)
        self._x = np.array([0.0, 0.0, 0.0, 0.0, rest])
        self._pull = self._information @ self._x
        self._covariance = np.diag(self._variances)

    @property
    def left_out(self) -> int:
        """Number of outliers."""
        last = self._residuals[: self._count, _LEFT_OUT]
        return self._condensed_left_out + int(last.sum())

    @property
    def stamp_error(self) -> float:
        """Standard deviation of the stamps by the last fit [s]."""
        return float(self._engine['stamp_error'][0])

    def update(self, rows: Rows) -> EngineEstimate | None:
        """Add later samples; return None if there are too few samples, or the fit fails."""
        while len(rows):
            if self._count == _MOST:
                self._condense()
            new = rows[: _MOST - self._count]
            rows = rows[len(new):]
            last = self._count + len(new)
            table = self._samples[self._count:last]
            table[:, 0] = seconds_since(self.origin_ns, new)
            table[:, 1], table[:, 2] = new['plate'], new['plate_velocity']
            self._count = last
            if last >= FEWEST:
                self._fit_and_judge()
        if self._count < FEWEST or self.has_failed or self._moved() < FEWEST:
            return None
        return self._estimate()

    def _moved(self) -> int:
        """Count the samples kept that are later than the start."""
        return int((self._samples[: self._count, 0] > self._x[START]).sum())

    def _condense(self) -> None:
        """Move the oldest samples into the normal equations."""
        old = _MOST - _KEPT
        _condense(
            self._samples[:old], self._engine, self._x, self._covariance,
            self._information, self._pull, self._residuals[:old],
        )
        self._condensed_left_out += int(self._residuals[:old, _LEFT_OUT].sum())
        for table in (self._samples, self._residuals):
            table[:_KEPT] = table[old:].copy()
        self._count = _KEPT

    def _fit_and_judge(self) -> None:
        """Fit all, with the errors of stamps and the noise that the residuals show."""
        engine = self._engine
        used = self._fit()
        if self._moved() >= _FEWEST_FOR_NOISE:
            self._known_stamp_error = 0.0  # this throw alone tells it better
        if engine['most_stamp_error'][0] > 0.0:
            before = self.stamp_error
            error = _stamp_error(self._residuals[: self._count], engine)
            engine['stamp_error'] = max(error, self._known_stamp_error)
            if self.stamp_error != before:
                used = self._fit()
        if self.has_failed and used.size >= _FEWEST_FOR_NOISE:
            # once more with the noise that is there, if it is larger than at rest
            larger = max(np.square(used).mean(), np.square(used[-_RECENT_SAMPLES:]).mean())
            is_noise = np.square(np.diff(used)).sum() >= _MIN_DURBIN_WATSON * np.square(used).sum()
            if is_noise and larger > 1.0:
                engine['height_noise'] *= math.sqrt(larger)
                engine['speed_noise'] *= math.sqrt(larger)
                self._fit()

    def _fit(self) -> Floats:
        """Fit, test whether the plate moves as the engine should, and return the residuals."""
        residuals = self._residuals[: self._count]
        is_solved = _fit(
            self._samples[: self._count],
            self._engine,
            self._information,
            self._pull,
            self._x,
            self._covariance,
            residuals,
        )
        left_out = residuals[:, _LEFT_OUT] > 0.0
        used = residuals[~left_out, _NORMALISED]
        most_in_a_row = np.convolve(left_out, np.ones(MAX_OUTLIERS_IN_A_ROW)).max()
        known = slice(FREQUENCY, DAMPING + 1)
        moved = self._x[known] ** 2
        prior = self._variances[known]
        told = prior - self._covariance.diagonal()[known]
        squares = np.square(used)
        recent = squares[-_RECENT_SAMPLES:]
        self.has_failed = (
            not is_solved
            or most_in_a_row >= MAX_OUTLIERS_IN_A_ROW
            or bool((moved > _REJECTION_QUANTILE**2 * told + 1e-3 * prior).any())
            or squares.sum() > largest_by_chance(float(used.size), _REJECTION_QUANTILE)
            or recent.sum() > largest_by_chance(float(recent.size), _REJECTION_QUANTILE)
        )
        return np.asarray(used if is_solved else used[:0])

    def _estimate(self) -> EngineEstimate:
        engine, x = self._engine[0], self._x.tolist()
        return EngineEstimate(
            start=x[START],
            plate=Underdamped(
                frequency=float(engine['omega']) * (1.0 + x[FREQUENCY]) / (2.0 * math.pi),
                amplitude=float(engine['amplitude']) * (1.0 + x[AMPLITUDE]),
                damping_ratio=float(engine['zeta']) + x[DAMPING],
            ),
            rest=x[REST],
            unknowns=self._x.copy(),
            covariance=self._covariance.copy(),
            stamp_error=self.stamp_error,
        )


def warm_up() -> None:
    """Compile or load the kernels."""
    x, pull, engine = np.zeros(5), np.ones(5), np.full(1, 0.1).astype(_ENGINE)
    samples, residuals, information, covariance = (
        np.zeros((2, 3)), np.zeros((4, 5)), np.eye(5), np.eye(5),
    )
    _fit(samples, engine, information, pull, x, covariance, residuals)
    _condense(samples, engine, x, covariance, information, pull, residuals)
    _stamp_error(residuals, engine)
    largest_by_chance(1.0, 1.0)
    damped_states(np.zeros(2), 1.0, 1.0, 0.0, np.empty((2, 3)))
