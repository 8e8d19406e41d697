# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
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

A stamp with the error :math:`\sigma_t` displaces a height by :math:`\dot z \sigma_t`, which adds
to the noise.

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

"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.kernels import kernel, subroutine
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.twin.outlier_filter import MAX_OUTLIERS_IN_A_ROW, OUTLIER_SIGMAS
from soft_throw_ros.twin.plate_estimator import Onset
from soft_throw_ros.twin.sample_buffer import Rows, seconds_since
from soft_throw_ros.twin.tick_schedule import SECOND

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
_FEWEST_FOR_NOISE = 12
"""Fewest samples that distinguish noise from another motion. [-]"""
_MIN_DURBIN_WATSON = 1.0
"""Least ratio of Durbin and Watson of noise; it is 2 for white noise, 0 for a motion. [-]"""
_MOST_STEPS = 8
"""Gauss-Newton steps of one update. [-]"""
_CONVERGED = 1e-2
"""Largest last step, in standard errors. [-]"""
_SLOPE = 1e-4
"""Change of the damping ratio for a difference quotient. [-]"""
_PIECES = 64
"""States of the plate in a period; quintics between them err by 2e-11 of the amplitude. [-]"""
_KEPT, _MOST = 128, 256
"""Samples kept after older ones went into the normal equations, and before. [-]"""


@subroutine
def _shape(time: float, omega: float, zeta: float) -> tuple[float, float]:
    """Evaluate height and velocity of a damped step of height 1."""
    root = math.sqrt(1.0 - zeta * zeta)
    decayed, phase = math.exp(-zeta * omega * time), root * omega * time
    sine = math.sin(phase) / root
    return 1.0 - decayed * (math.cos(phase) + zeta * sine), omega * decayed * sine


class _Model(NamedTuple):
    """The engine before the throw, and the noise of the samples."""

    amplitude: float  # [m]
    omega: float  # angular frequency [1/s]
    zeta: float  # damping ratio [-]
    height_noise: float  # standard deviation of heights [m]
    stamp_error: float  # of stamps [s]


@kernel
def _add_up(
    samples: Floats,
    model: _Model,
    x: Floats,
    covariance: Floats,
    normal: Floats,
    right: Floats,
    residuals: Floats,
) -> None:
    """
    Add samples to the normal equations about the unknowns `x`; write their residuals.

    Samples are rows of time and height. Residuals are columns: those of the heights over
    their standard errors, and whether they are outliers.
    """
    amplitude = model.amplitude * (1.0 + x[AMPLITUDE])
    omega, zeta = model.omega * (1.0 + x[FREQUENCY]), model.zeta + x[DAMPING]
    by_height = np.zeros(5)  # derivatives by the unknowns
    by_height[REST] = 1.0
    for n in range(len(samples)):
        since = samples[n, 0] - x[START]
        height, speed = 0.0, 0.0
        by_height[:REST] = 0.0
        if since > 0.0:
            height, speed = _shape(since, omega, zeta)
            above, _ = _shape(since, omega, zeta + _SLOPE)
            by_height[AMPLITUDE] = model.amplitude * height
            by_height[START] = -amplitude * speed
            by_height[FREQUENCY] = amplitude / (1.0 + x[FREQUENCY]) * since * speed
            by_height[DAMPING] = amplitude * (above - height) / _SLOPE
        error = samples[n, 1] - x[REST] - amplitude * height
        leverage = 0.0
        for i in range(5):
            for j in range(5):
                leverage += by_height[i] * covariance[i, j] * by_height[j]
        variance = model.height_noise**2 + (amplitude * speed * model.stamp_error) ** 2
        is_outlier = error * error > OUTLIER_SIGMAS * OUTLIER_SIGMAS * (variance + leverage)
        residuals[0, n], residuals[1, n] = error / math.sqrt(variance), is_outlier
        if is_outlier:
            continue
        for i in range(5):
            right[i] += by_height[i] * error / variance
            for j in range(5):
                normal[i, j] += by_height[i] * by_height[j] / variance


@kernel
def _solve(
    samples: Floats,
    model: _Model,
    information: Floats,
    pull: Floats,
    scales: Floats,
    x: Floats,
    covariance: Floats,
    residuals: Floats,
) -> bool:
    """
    Find the best unknowns `x` from the last solution on; return whether they exist.

    `information` and `pull` are the normal equations, about the origin, of the prior and of older
    samples; `scales` removes the units of the unknowns, which differ by ten orders of magnitude.
    """
    for _ in range(_MOST_STEPS):
        normal, right = information.copy(), pull - information @ x
        _add_up(samples, model, x, covariance, normal, right, residuals)
        scaled = scales * normal
        if not np.isfinite(scaled).all():
            return False  # the last solution was out of range
        covariance[:] = scales * np.linalg.inv(scaled)
        step = covariance @ right
        x += step
        x[DAMPING] = max(x[DAMPING], -model.zeta)
        if not (x[AMPLITUDE] > -1.0 and x[FREQUENCY] > -1.0 and model.zeta + x[DAMPING] < 1.0):
            return False
        if (step**2 < _CONVERGED**2 * np.diag(covariance)).all():
            break
    return True


def largest_by_chance(count: float, quantile: float) -> float:
    """Return the sum of `count` squares of standard normal numbers at a normal quantile [-]."""
    # Wilson and Hilferty, Proc. Natl. Acad. Sci. 17 (1931)
    variance = 2.0 / (9.0 * max(count, 1.0))
    return float(count * (1.0 - variance + quantile * math.sqrt(variance)) ** 3)


def plate_states(plate: Underdamped, times: Floats) -> Floats:
    """Return height, velocity and acceleration at times since the start, shape (n, 3)."""
    height, velocity = plate.position(times), plate.velocity(times)
    omega = 2.0 * math.pi * plate.frequency
    acceleration = omega * (
        omega * (plate.amplitude - height) - 2.0 * plate.damping_ratio * velocity
    )
    return np.stack((height, velocity, acceleration), axis=1)


def engine_states(plate: Underdamped, after: float, until: float) -> tuple[Floats, Floats]:
    """
    Return times since the start, and states of the plate, from one time to another.

    The first time is the start if `after` is 0, else it is later than `after`.
    """
    count = max(math.ceil(_PIECES * (until - after) * plate.frequency), 1)
    times = np.linspace(after, until, count + 1)[after > 0.0:]
    return times, plate_states(plate, times)


def _is_noise(residuals: Floats) -> bool:
    """Return whether normalised residuals are as uneven as noise, by Durbin and Watson."""
    steps = np.diff(residuals)
    return bool(steps @ steps >= _MIN_DURBIN_WATSON * (residuals @ residuals))


class _Solution:
    """
    The unknowns of a fit, with the normal equations of the prior and of condensed samples.

    The parameters are the expected unknowns and their standard errors, which remove the units of
    the unknowns.
    """

    def __init__(self, expected: Floats, errors: Floats) -> None:
        self.prior_variances = errors**2
        self.x = expected
        self.covariance = np.diag(self.prior_variances)
        self._scales = np.outer(errors, errors)
        self._information = np.diag(1.0 / self.prior_variances)
        self._pull = self._information @ self.x

    def solve(self, samples: Floats, model: _Model) -> tuple[Floats, bool]:
        """Find the best unknowns with samples; return residuals, and whether there is a best."""
        residuals = np.empty((2, len(samples)))
        is_solved = _solve(
            samples,
            model,
            self._information,
            self._pull,
            self._scales,
            self.x,
            self.covariance,
            residuals,
        )
        return residuals, is_solved

    def condense(self, samples: Floats, model: _Model) -> Floats:
        """Add samples to the normal equations, linearised at the present unknowns."""
        normal, right, residuals = np.zeros((5, 5)), np.zeros(5), np.empty((2, len(samples)))
        _add_up(samples, model, self.x, self.covariance, normal, right, residuals)
        self._information += normal
        self._pull += right + normal @ self.x
        return residuals


@dataclass(frozen=True)
class EngineEstimate:
    """The fitted motion of the engine in a throw; the plate moves so from `start_ns` on."""

    start_ns: int  # [ns]
    plate: Underdamped  # motion of the plate from the start on
    unknowns: Floats  # the solution, see `AMPLITUDE`, shape (5,)
    covariance: Floats  # of the unknowns, shape (5, 5)

    def states(self, after: float, complete_ns: float) -> tuple[Floats, Floats]:
        """Return the states until a time, see `plate_source.SmoothedSamples.states`."""
        after, until = max(after, 0.0), (complete_ns - self.start_ns) / SECOND
        if until <= after:
            return np.empty(0), np.empty((0, 3))
        return engine_states(self.plate, after, until)


class EngineFit:
    """
    A fit of the engine's motion to the samples of a throw, see the module.

    Parameters
    ----------
    config : MeasurementConfig
        Parameters of the measurement, with the motion of the engine.
    onset : Onset
        Height before the throw, and a guess of the start within a millisecond.

    """

    def __init__(self, config: MeasurementConfig, onset: Onset) -> None:
        plate, rest = config.plate, onset.rest
        self.has_failed = False  # whether the plate has not moved as the engine should
        self.estimate: EngineEstimate | None = None  # the last one before the fit failed, if any
        # time from which samples are not in the fit yet [ns]
        self.next_ns = onset.onset_ns - config.smoothing_window_ns
        self._origin_ns = onset.onset_ns
        self._model = _Model(
            amplitude=plate.amplitude,
            omega=2.0 * math.pi * plate.frequency,
            zeta=plate.damping_ratio,
            height_noise=rest.noise,
            stamp_error=config.stamp_error,
        )
        self._engine = plate
        self._samples = np.empty((0, 2))  # times [s] and heights [m]
        self._is_outlier = np.empty(0)  # of the samples kept
        self._condensed_outliers = 0
        errors = [
            _AMPLITUDE_ERROR,
            _START_ERROR,
            max(config.frequency_error / plate.frequency, _TIGHTEST),
            max(config.damping_error, _TIGHTEST),
            max(rest.error, _TIGHTEST * plate.amplitude),
        ]
        self._solution = _Solution(np.array([0.0, 0.0, 0.0, 0.0, rest.plate]), np.array(errors))

    @property
    def outliers(self) -> int:
        """Number of outliers."""
        return self._condensed_outliers + int(self._is_outlier.sum())

    def update(self, rows: Rows) -> EngineEstimate | None:
        """Add later samples; return None if there are too few samples, or the fit fails."""
        if len(rows):
            self.next_ns = int(rows['stamp_ns'][-1]) + 1
        while len(rows):
            if len(self._samples) == _MOST:
                self._condense()
            new = rows[: _MOST - len(self._samples)]
            rows = rows[len(new):]
            added = seconds_since(self._origin_ns, new), new['plate']
            self._samples = np.concatenate((self._samples, np.stack(added, axis=1)))
            if len(self._samples) >= FEWEST:
                self._fit_and_judge()
        if self.has_failed or self._moved() < FEWEST:
            return None
        engine, x = self._engine, self._solution.x.tolist()
        plate = Underdamped(
            frequency=engine.frequency * (1.0 + x[FREQUENCY]),
            amplitude=engine.amplitude * (1.0 + x[AMPLITUDE]),
            damping_ratio=engine.damping_ratio + x[DAMPING],
        )
        self.estimate = EngineEstimate(
            start_ns=self._origin_ns + round(x[START] * SECOND),
            plate=plate,
            unknowns=self._solution.x.copy(),
            covariance=self._solution.covariance.copy(),
        )
        return self.estimate

    def _moved(self) -> int:
        """Count the samples kept that are later than the start."""
        return int((self._samples[:, 0] > self._solution.x[START]).sum())

    def _condense(self) -> None:
        """Keep the newest samples, and move the older ones into the normal equations."""
        old, self._samples = self._samples[:-_KEPT], self._samples[-_KEPT:]
        _, is_outlier = self._solution.condense(old, self._model)
        self._condensed_outliers += int(is_outlier.sum())

    def _fit_and_judge(self) -> None:
        """Fit all, with the noise that the residuals show."""
        used = self._fit()
        if self.has_failed and used.size >= _FEWEST_FOR_NOISE:
            # once more with the present noise, if it is larger than at rest
            larger = max(np.square(used).mean(), np.square(used[-_RECENT_SAMPLES:]).mean())
            if larger > 1.0 and _is_noise(used):
                model, factor = self._model, math.sqrt(larger)
                self._model = model._replace(height_noise=factor * model.height_noise)
                self._fit()

    def _fit(self) -> Floats:
        """Fit, test whether the plate moves as the engine should, and return the residuals."""
        solution = self._solution
        (residuals, self._is_outlier), is_solved = solution.solve(self._samples, self._model)
        if not is_solved:
            self.has_failed = True
            return np.empty(0)
        used: Floats = residuals[self._is_outlier == 0.0]
        most_in_a_row = np.convolve(self._is_outlier, np.ones(MAX_OUTLIERS_IN_A_ROW)).max()
        known = slice(FREQUENCY, DAMPING + 1)
        changes, prior = solution.x[known] ** 2, solution.prior_variances[known]
        reduction = prior - solution.covariance.diagonal()[known]
        self.has_failed = (
            most_in_a_row >= MAX_OUTLIERS_IN_A_ROW
            or bool((changes > _REJECTION_QUANTILE**2 * reduction + 1e-3 * prior).any())
            or any(
                tested @ tested > largest_by_chance(tested.size, _REJECTION_QUANTILE)
                for tested in (used, used[-_RECENT_SAMPLES:])
            )
        )
        return used


def warm_up() -> None:
    """Compile or load the kernels."""
    x, matrix, model = np.zeros(5), np.eye(5), _Model(*np.full(5, 0.1).tolist())
    samples, residuals = np.zeros((1, 2)), np.empty((2, 1))
    _add_up(samples, model, x, matrix, matrix, x, residuals)
    _solve(samples, model, matrix, x, matrix, x, matrix, residuals)
