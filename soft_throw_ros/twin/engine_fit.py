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
The engine's motion through the samples of a throw: what the plate has done, and what it will do.

Notes
-----
The model is the damped step :math:`z_0 + A\,s(t - t_0; f, \zeta)` of `core.plate.Underdamped`.
Amplitude and start are free; frequency, damping ratio and the height at rest are known to an
error, which is their prior. All samples since the start are fitted again whenever there are new
ones, by Gauss-Newton from where the last fit ended. That is the iterated extended Kalman filter
without process noise [1]_, with two advantages: samples are judged anew by what is known now, and
neither their order nor the first guess leaves a trace. It costs some microseconds.

A sample beyond six standard errors of sample and prediction together is left out. The plate does
not do as the engine should when three in a row are, or when chance gives once in 20000 what the
samples give: the sum of squares of all, or of the last eight, or the change of frequency or
damping ratio, whose variance is that of the prior less that of the estimate. If the residuals are
as uneven as noise is (by the ratio of Durbin and Watson), it is the noise that is larger than at
rest, by stamps that are not exact for one, and the errors are larger by as much.

References
----------
.. [1] B. M. Bell and F. W. Cathey, "The iterated Kalman filter update as a Gauss-Newton method",
   IEEE Trans. Automat. Contr. 38 (1993) 294.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import factorise, solve
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.tick_schedule import SECOND

Floats = NDArray[np.float64]

AMPLITUDE, START, FREQUENCY, DAMPING, REST = range(5)
"""
Places of the unknowns: parts of the engine's amplitude and frequency that they are off [-], the
start [s], the damping ratio's difference [-], and the height at rest [m].
"""

FEWEST = 4  # samples that have moved, below which nothing is told
_LOOSE = 0.5  # standard error of the amplitude before the throw, as a part of it [-]
_START = 1e-3  # and of the start [s]
_TIGHTEST = 1e-6  # of what is said to be known exactly [-]
_SURE = 6.0  # standard errors beyond which a sample is left out
_MOST_IN_A_ROW = 3
_LAST = 8  # samples
_CHANCE = 3.9  # standard normal quantile of 1 / 20000
_FEWEST_FOR_NOISE = 12  # samples that tell noise from another motion
_WHITE = 1.0  # squares of differences of residuals over their squares: 2 for noise, 0 for a motion
_MOST_STEPS = 8
_CONVERGED = 1e-2  # of a standard error
_SLOPE = 1e-4  # of the damping ratio, for a difference

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
    engine: Floats,
    x: Floats,
    covariance: Floats,
    normal: Floats,
    right: Floats,
    residuals: Floats,
) -> tuple[float, float]:
    """
    Add samples to the normal equations; return the squares of all, and of the last ones.

    Rows of `samples` are time, height and speed; `engine` is amplitude, angular frequency, damping
    ratio, and the noise of heights and speeds. Residuals are NaN where a sample is left out.
    """
    amplitude = engine[0] * (1.0 + x[AMPLITUDE])
    omega, zeta = engine[1] * (1.0 + x[FREQUENCY]), engine[2] + x[DAMPING]
    of_height, of_speed = np.zeros(5), np.zeros(5)  # derivatives by the unknowns
    total, last, count = 0.0, np.zeros(_LAST), 0
    for n in range(len(samples)):
        since = samples[n, 0] - x[START]
        height, speed = 0.0, 0.0
        of_height[:] = 0.0
        of_height[REST] = 1.0
        if since > 0.0:
            height, speed, acceleration = _shape(since, omega, zeta)
            above, faster, _ = _shape(since, omega, zeta + _SLOPE)
            of_height[AMPLITUDE], of_speed[AMPLITUDE] = engine[0] * height, engine[0] * speed
            of_height[START], of_speed[START] = -amplitude * speed, -amplitude * acceleration
            stretch = amplitude / (1.0 + x[FREQUENCY])
            of_height[FREQUENCY] = stretch * since * speed
            of_speed[FREQUENCY] = stretch * (speed + since * acceleration)
            of_height[DAMPING] = amplitude * (above - height) / _SLOPE
            of_speed[DAMPING] = amplitude * (faster - speed) / _SLOPE
        error = samples[n, 1] - x[REST] - amplitude * height
        spread = engine[3] * engine[3]
        for i in range(5):
            for j in range(5):
                spread += of_height[i] * covariance[i, j] * of_height[j]
        is_left_out = error * error > _SURE * _SURE * spread
        residuals[n] = math.nan if is_left_out else error / engine[3]
        if is_left_out:
            continue
        _add(normal, right, of_height, error, engine[3])
        if since > 0.0 and np.isfinite(samples[n, 2]):
            _add(normal, right, of_speed, samples[n, 2] - amplitude * speed, engine[4])
        total += residuals[n] ** 2
        last[count % _LAST] = residuals[n] ** 2
        count += 1
    return total, last.sum()


@_jit
def _add(normal: Floats, right: Floats, row: Floats, error: float, noise: float) -> None:
    """Add an equation to the normal equations."""
    weight = 1.0 / (noise * noise)
    for i in range(5):
        right[i] += weight * row[i] * error
        for j in range(5):
            normal[i, j] += weight * row[i] * row[j]


@_jit
def _fit(
    samples: Floats,
    engine: Floats,
    expected: Floats,
    weights: Floats,
    x: Floats,
    covariance: Floats,
    residuals: Floats,
) -> tuple[float, float]:
    """Go on to the best unknowns `x`, see `_add_up`; NaN if there are none."""
    normal, right, scale = np.empty((5, 5)), np.empty(5), np.empty(5)
    total, last = 0.0, 0.0
    for _ in range(_MOST_STEPS):
        normal[:] = 0.0
        for i in range(5):
            normal[i, i] = weights[i]
            right[i] = weights[i] * (expected[i] - x[i])
        total, last = _add_up(samples, engine, x, covariance, normal, right, residuals)
        for i in range(5):
            scale[i] = 1.0 / math.sqrt(normal[i, i])
        for i in range(5):  # units differ by ten orders of magnitude
            right[i] *= scale[i]
            for j in range(5):
                normal[i, j] *= scale[i] * scale[j]
        if not factorise(normal):
            return math.nan, math.nan
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
        x[DAMPING] = max(x[DAMPING], -engine[2])
        if x[AMPLITUDE] <= -1.0 or x[FREQUENCY] <= -1.0 or engine[2] + x[DAMPING] >= 1.0:
            return math.nan, math.nan
        if has_converged:
            break
    return total, last


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
    The engine's motion in a throw, as far as is known.

    Attributes
    ----------
    start : float
        After the time that the fit counts from. [s]
    plate : Underdamped
        How the plate moves.
    rest : float
        Its height before. [m]
    covariance : ndarray, shape (5, 5)
        Of the unknowns, see `AMPLITUDE`.
    moved : int
        Samples since the start.

    """

    start: float
    plate: Underdamped
    rest: float
    covariance: Floats
    moved: int

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

    Attributes
    ----------
    has_failed : bool
        Whether the plate has not done as the engine should.
    left_out : int
        Samples that are left out, by the last fit.

    """

    def __init__(
        self,
        config: MeasurementConfig,
        *,
        origin_ns: int,
        rest: float,
        rest_error: float,
        noise: float,
    ) -> None:
        plate = config.plate
        self.has_failed = False
        self.left_out = 0
        self._config = config
        self.origin_ns = origin_ns
        ratio = noise / config.position_noise
        self._engine = np.array(
            [
                plate.amplitude,
                2.0 * math.pi * plate.frequency,
                plate.damping_ratio,
                noise,
                ratio * config.velocity_noise,
            ]
        )
        errors = [
            _LOOSE,
            _START,
            max(config.frequency_error / plate.frequency, _TIGHTEST),
            max(config.damping_error, _TIGHTEST),
            max(rest_error, _TIGHTEST * plate.amplitude),
        ]
        self._expected = np.array([0.0, 0.0, 0.0, 0.0, rest])
        self._weights = np.array(errors) ** -2.0
        self._x = self._expected.copy()
        self._covariance = np.diag(np.array(errors) ** 2)

    def update(self, samples: Sequence[Sample]) -> EngineEstimate | None:
        """Fit samples from before the start to now; None if they are few or do not fit."""
        if len(samples) < FEWEST:
            return None
        origin_ns = self.origin_ns
        table = np.array(
            [((stamp_ns - origin_ns) / SECOND, at, speed) for stamp_ns, at, speed, _ in samples]
        )
        used = self._fit(table)
        if self.has_failed and used.size >= _FEWEST_FOR_NOISE:
            # once more with the noise that is there, if it is larger than at rest
            larger = max(np.square(used).mean(), np.square(used[-_LAST:]).mean())
            is_noise = np.square(np.diff(used)).sum() >= _WHITE * np.square(used).sum()
            if is_noise and larger > 1.0:
                self._engine[3:] *= math.sqrt(larger)
                self._fit(table)
        moved = int((table[:, 0] > self._x[START]).sum())
        if self.has_failed or moved < FEWEST:
            return None
        return self._estimate(moved)

    def _fit(self, table: Floats) -> Floats:
        """Fit, tell whether the plate does as the engine should, and return what is left over."""
        residuals = np.empty(len(table))
        total, last = _fit(
            table,
            self._engine,
            self._expected,
            self._weights,
            self._x,
            self._covariance,
            residuals,
        )
        left_out = np.isnan(residuals)
        used = residuals[~left_out]
        self.left_out = int(left_out.sum())
        most_in_a_row = np.convolve(left_out, np.ones(_MOST_IN_A_ROW)).max()
        known = slice(FREQUENCY, DAMPING + 1)
        moved = (self._x - self._expected)[known] ** 2
        told = 1.0 / self._weights[known] - self._covariance.diagonal()[known]
        self.has_failed = (
            math.isnan(total)
            or most_in_a_row >= _MOST_IN_A_ROW
            or bool((moved > _CHANCE**2 * told + 1e-3 / self._weights[known]).any())
            or total > largest_by_chance(used.size)
            or last > largest_by_chance(min(used.size, _LAST))
        )
        return used[:0] if math.isnan(total) else used

    def _estimate(self, moved: int) -> EngineEstimate:
        amplitude, omega, zeta, *_ = self._engine.tolist()
        x = self._x.tolist()
        return EngineEstimate(
            start=x[START],
            plate=Underdamped(
                frequency=omega * (1.0 + x[FREQUENCY]) / (2.0 * math.pi),
                amplitude=amplitude * (1.0 + x[AMPLITUDE]),
                damping_ratio=zeta + x[DAMPING],
            ),
            rest=x[REST],
            covariance=self._covariance.copy(),
            moved=moved,
        )


def largest_by_chance(count: int) -> float:
    """Return the sum of squares of standard normal numbers exceeded once in 20000 times [-]."""
    part = 2.0 / (9.0 * max(count, 1))  # Wilson and Hilferty, Proc. Natl. Acad. Sci. 17 (1931) 684
    return count * (1.0 - part + _CHANCE * math.sqrt(part)) ** 3


def warm_up() -> None:
    """Compile or load the kernel."""
    five = np.ones(5)
    _fit(np.zeros((2, 3)), 0.1 * five, 0.0 * five, five, 0.0 * five, np.eye(5), np.zeros(2))
    damped_states(np.zeros(2), 1.0, 1.0, 0.0, np.empty((2, 3)))
