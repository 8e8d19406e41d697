# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
The observer of a measured plate in a throw: a Kalman filter and smoother.

Notes
-----
The state is the height :math:`z` of the plate, its velocity and the amplitude :math:`A`. They obey
the equation of motion of the engine, Eq. (D1) of the paper, with an unknown acceleration
:math:`q`, which is white noise:

.. math:: \ddot z + 2 \zeta \omega \dot z + \omega^2 (z - A) = q

With a commanded motion they are differences from it, and :math:`\zeta`, :math:`\omega` and
:math:`A` are zero: the plate continues along the motion, shifted to its height and speed. Samples
are smoothed in the form of Bryson and Frazier [1]_, which needs no inverse matrix. Ahead of the
samples the filter predicts, which continues the motion.

The speed and the time of the release and the largest speed of the plate depend linearly on the
velocity of the plate. These three integrals are states of the filter too, so that their errors
are those of the whole path, with all correlations.

A stamp with the error :math:`\sigma_t` displaces a height by :math:`\dot z \sigma_t`, which adds
to the noise. A height counts as at most six standard errors off.

References
----------
.. [1] G. J. Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18
   (1973) 65.

"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.kernels import kernel, Record, subroutine
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.twin.outlier_filter import OUTLIER_SIGMAS
from soft_throw_ros.twin.sample_buffer import Onset, Samples

Floats = NDArray[np.float64]

UNMODELLED = 0.04
"""
Standard deviation of the change of the speed by unmodelled accelerations in the time 1 / omega,
over the peak speed of the plate. A second mode of 1 % of the amplitude at 5 f is as large. [-]
"""
_COMMANDED = 0.2
"""The same of a controlled plate around a commanded motion, over that of the engine. [-]"""
AMPLITUDE_ERROR = 0.025
"""Relative standard error of the amplitude before the throw. [-]"""
_SETTLED = 0.5
"""Age at which a smoothed state does not change any more, over the smoothing window. [-]"""
_SPACING = 0.125
"""Time between states of the plate, over the smoothing window. [-]"""
_COARSE = 4
"""Weights of the release that the prediction of its errors passes in a step. [-]"""
_AVERAGED = 16
"""Innovations whose mean square shows that more than the stated noise acts. [-]"""
_FIRST_RATIO = 0.5
"""Mean square before the first ones, so small that chance rarely makes it larger than 1. [-]"""

_CAPACITY = 128
"""Steps of the filter that a new observer can store; it grows. [-]"""

_STATES = 6
"""Height, velocity, amplitude, and the three integrals."""

_MEMORY = np.dtype(
    [
        ('omega', 'f8'),  # of Eq. (D1) [1/s]
        ('zeta', 'f8'),
        ('amplitude', 'f8'),  # expected [m]
        ('unmodelled', 'f8'),  # spectral density of q [m2/s3]
        ('time', 'f8'),  # since the start [s]
        ('state', 'f8', (3,)),
        ('covariance', 'f8', (_STATES, _STATES)),
        ('steps', 'i8'),  # of the filter since the last settled state
        ('settled', 'f8'),  # time of this state [s]
        ('ratio', 'f8'),  # mean square of normalised innovations [-]
    ],
    align=True,
)

STEP = np.dtype(
    [
        ('time', 'f8'),
        ('state', 'f8', (3,)),  # predicted
        ('covariance', 'f8', (3, 3)),
        ('gain', 'f8', (3,)),
        ('pull', 'f8'),  # innovation over its variance
    ],
    align=True,
)
"""Record of a step of the filter, for the smoother."""


class ReleaseWeights(NamedTuple):
    """
    Weights of the velocity of the plate in a release.

    A change of the velocity v by dv changes the speed of the release [m/s], its time [s] and the
    peak speed [m/s] by the integrals of -dv dw over time, where w are the rows of `weights`.
    """

    times: Floats  # since the start, shape (n,) [s]
    weights: Floats  # shape (3, n)
    release_time: float  # expected, 0 for none [s]


@subroutine
def _transition(s: Record, h: float, f: Floats) -> None:
    """Write the transition of height, velocity and amplitude over a time."""
    turn = s.omega * math.sqrt(1.0 - s.zeta * s.zeta)
    fading = math.exp(-s.zeta * s.omega * h)
    sine = fading * (math.sin(turn * h) / turn if turn > 0.0 else h)
    cosine = fading * math.cos(turn * h)
    f[0, 0], f[0, 1] = cosine + s.zeta * s.omega * sine, sine
    f[1, 0], f[1, 1] = -s.omega * s.omega * sine, cosine - s.zeta * s.omega * sine
    f[0, 2], f[1, 2], f[2, 2] = 1.0 - f[0, 0], -f[1, 0], 1.0


@subroutine
def _predict(s: Record, time: float, axis: Floats, weights: Floats) -> None:
    """Go on to a later time."""
    h = time - s.time
    f, g, m = np.eye(_STATES), np.eye(_STATES), np.zeros((_STATES, _STATES))
    _transition(s, h, f)
    for n in range(3):  # integrals by the trapezoid rule
        w = weights[n]
        weight = 0.5 * (np.interp(s.time, axis, w) - np.interp(time, axis, w))
        for i in range(3):
            f[3 + n, i] = weight * f[1, i]
        f[3 + n, 1] += weight
        g[3 + n, 1] = weight
    m[0, 0], m[0, 1], m[1, 1] = h * h * h / 3.0, 0.5 * h * h, h
    m[1, 0] = m[0, 1]
    density = s.unmodelled * max(1.0, s.ratio) ** 2
    s.covariance[:] = _sandwich(f, s.covariance) + density * _sandwich(g, m)
    x0, x1, x2 = s.state[0], s.state[1], s.state[2]
    for i in range(3):
        s.state[i] = f[i, 0] * x0 + f[i, 1] * x1 + f[i, 2] * x2
    s.time = time


@subroutine
def _sandwich(f: Floats, p: Floats) -> Floats:
    """Return f p f^T; loops, because the last bits of a library depend on the alignment."""
    size = f.shape[0]
    half, out = np.zeros((size, size)), np.zeros((size, size))
    for i in range(size):
        for k in range(size):
            if f[i, k] != 0.0:
                for j in range(size):
                    half[i, j] += f[i, k] * p[k, j]
    for i in range(size):
        for k in range(size):
            if f[i, k] != 0.0:
                for j in range(size):
                    out[j, i] += half[j, k] * f[i, k]
    return out


@kernel
def _filter(
    memory: NDArray[np.void],
    times: Floats,
    heights: Floats,
    errors: Floats,
    stamp_error: float,
    axis: Floats,
    weights: Floats,
    steps: NDArray[np.void],
) -> None:
    """Go on to each time, and take the measured height there, unless it is NaN."""
    s, f = memory[0], np.zeros((3, 3))
    for n in range(times.size):
        _predict(s, times[n], axis, weights)
        p, step = s.covariance, steps[s.steps]
        s.steps += 1
        _transition(s, s.time, f)  # from the rest, which gives the expected speed
        noise = errors[n] ** 2 + (f[1, 2] * s.amplitude * stamp_error) ** 2
        variance = p[0, 0] + noise
        most = OUTLIER_SIGMAS * math.sqrt(variance)
        error = min(max(heights[n] - s.state[0], -most), most)
        step.time, step.pull = times[n], 0.0
        step.state[:], step.covariance[:], step.gain[:] = s.state, p[:3, :3], 0.0
        if np.isnan(heights[n]):
            continue
        step.pull = error / variance
        gain = p[:, 0] / variance
        step.gain[:] = gain[:3]
        for i in range(3):
            s.state[i] += gain[i] * error
        for i in range(_STATES):
            for j in range(_STATES):
                p[i, j] -= gain[i] * gain[j] * variance
        s.ratio += (error * step.pull - s.ratio) / _AVERAGED


@kernel
def _follow(
    memory: NDArray[np.void],
    steps: NDArray[np.void],
    spacing: float,
    age: float,
    ahead: Floats,
    times: Floats,
    states: Floats,
) -> tuple[int, int]:
    """
    Write smoothed states about a spacing apart, and the continuation at the times `ahead`.

    Return how many there are, and how many of them are settled, being older than an age. The
    steps up to the last settled state are removed.
    """
    s, count, settled, last = memory[0], 0, 0, memory[0].settled
    smoothed = _smooth(s, steps)
    for n in range(s.steps):
        time = steps[n].time
        if time >= last + spacing or n == s.steps - 1:
            last = times[count] = time
            states[count] = smoothed[n]
            count += 1
            if time <= s.time - age:
                settled, s.settled = count, time
    f = np.zeros((3, 3))
    for time in ahead:
        _transition(s, time - s.time, f)
        times[count] = time
        for i in range(3):
            states[count, i] = (
                f[i, 0] * s.state[0] + f[i, 1] * s.state[1] + f[i, 2] * s.state[2]
            )
        count += 1
    for n in range(count):
        pull = s.omega * (states[n, 2] - states[n, 0])
        states[n, 2] = s.omega * (pull - 2.0 * s.zeta * states[n, 1])  # (D1)
    kept = 0
    for n in range(s.steps):
        if steps[n].time > s.settled:
            steps[kept] = steps[n]
            kept += 1
    s.steps = kept
    return count, settled


@subroutine
def _smooth(s: Record, steps: NDArray[np.void]) -> Floats:
    """Return the smoothed states at all steps."""
    later, now, f = np.zeros(3), np.zeros(3), np.zeros((3, 3))  # the adjoint state
    states = np.empty((s.steps, 3))
    for n in range(s.steps - 1, -1, -1):
        step = steps[n]
        now[:] = later
        for i in range(3):
            now[0] -= step.gain[i] * later[i]
        now[0] -= step.pull
        for i in range(3):
            states[n, i] = step.state[i]
            for j in range(3):
                states[n, i] -= step.covariance[i, j] * now[j]
        if n > 0:
            _transition(s, step.time - steps[n - 1].time, f)
            for i in range(3):
                later[i] = f[0, i] * now[0] + f[1, i] * now[1] + f[2, i] * now[2]
    return states


class PlateObserver:
    """
    The plate in a throw from its onset on, see the module.

    Times are since the onset. States are rows of height above rest [m], velocity [m/s] and
    acceleration [m/s2].
    """

    def __init__(
        self, config: MeasurementConfig, onset: Onset, weights: ReleaseWeights
    ) -> None:
        plate = config.plate
        self._config, self._onset, self._weights = config, onset, weights
        self.next_ns = onset.onset_ns + 1  # time from which samples are not used yet [ns]
        omega = 2.0 * math.pi * plate.frequency
        speed, swing = plate.peak_velocity, plate.amplitude * omega
        is_engine = isinstance(config.motion, Underdamped)
        self._command = None if is_engine else config.motion
        unmodelled = UNMODELLED if is_engine else _COMMANDED * UNMODELLED
        relative = (
            unmodelled,
            2.0 * config.frequency_error / plate.frequency,
            2.0 * config.damping_error,
        )
        self._memory = memory = np.zeros(1, _MEMORY)
        if is_engine:
            memory['omega'], memory['zeta'] = omega, plate.damping_ratio
            memory['amplitude'] = memory['state'][0, 2] = plate.amplitude
        memory['unmodelled'] = math.hypot(*relative) ** 2 * speed**2 * omega
        memory['ratio'] = _FIRST_RATIO
        memory['settled'] = -1.0
        memory['covariance'][0][range(3), range(3)] = np.square(
            [onset.rest.error, unmodelled * swing, AMPLITUDE_ERROR * plate.amplitude]
        )
        self._present = memory[0]
        self._steps = np.zeros(_CAPACITY, STEP)
        self._spacing = 0.99 * _SPACING * config.smoothing_window  # least, by samples [s]
        self._filter(np.zeros(1), np.full(1, np.nan), np.zeros(1), 0.0)

    @property
    def newest(self) -> float:
        """Time of the newest sample [s]."""
        return float(self._present['time'])

    def add(self, samples: Samples) -> None:
        """Add later samples."""
        if not samples:
            return
        onset, stamp_error = self._onset, self._config.stamp_error
        self.next_ns = int(samples.stamps[-1]) + 1
        times, heights = samples.seconds_since(onset.onset_ns), samples.plate - onset.rest.plate
        errors = np.full(times.size, onset.rest.noise)
        if self._command is not None:
            expected = self._command.states_at(times)
            heights -= expected[:, 0]
            errors, stamp_error = np.hypot(errors, expected[:, 1] * stamp_error), 0.0
        self._filter(times, heights, errors, stamp_error)

    def _filter(
        self, times: Floats, heights: Floats, errors: Floats, stamp_error: float
    ) -> None:
        steps, weights = self._steps, self._weights
        used = int(self._present['steps'])
        if used + times.size > steps.size:
            self._steps = np.zeros(2 * (used + times.size), STEP)
            self._steps[:used] = steps[:used]
        _filter(
            self._memory, times, heights, errors, stamp_error,
            weights.times, weights.weights, self._steps,
        )

    def motion(self, until: float) -> tuple[Floats, Floats, int]:
        """
        Return times and states by the samples, and their continuation up to a later time.

        They begin after those that were settled in earlier calls. The number of those that are
        settled now is the third result: they do not change any more.
        """
        window, newest = self._config.smoothing_window, self.newest
        count = max(math.ceil((until - newest) / (_SPACING * window)), 0)
        ahead = newest + (until - newest) / max(count, 1) * np.arange(1, count + 1)
        size = int(self._present['steps']) + count
        times, states = np.empty(size), np.empty((size, 3))
        count, settled = _follow(
            self._memory, self._steps, self._spacing, _SETTLED * window, ahead, times, states
        )
        times, states = times[:count], states[:count]
        if self._command is not None:
            states += self._command.states_at(times)
        if count and times[0] == 0.0:
            # an onset that is too early must not pull the layer down
            states[0, 1] = max(states[0, 1], 0.0)
        return times, states, settled

    def errors(self, speed: float, peak_speed: float) -> tuple[float, float, float]:
        """
        Return the standard errors of time [s], speed [m/s] and energy transfer [-] of a release.

        Innovations that are larger than the stated noise explains make the errors larger.
        """
        memory, weights = self._memory.copy(), self._weights
        later = weights.times[::_COARSE]
        later = later[later > self.newest]
        memory['steps'] = 0
        nothing, steps = np.full(later.size, np.nan), np.zeros(later.size, STEP)
        _filter(memory, later, nothing, nothing, 0.0, weights.times, weights.weights, steps)
        variances = memory['covariance'][0].diagonal()[3:] * max(1.0, float(memory['ratio'][0]))
        speed_error, time_error, peak_error = np.sqrt(variances).tolist()
        # errors of both speeds count as independent: another motion than expected makes them so
        relative_error = 2.0 * math.hypot(speed_error / speed, peak_error / peak_speed)
        return time_error, speed_error, relative_error * (speed / peak_speed) ** 2


def warm_up() -> None:
    """Compile or load the kernels."""
    memory, steps, one = np.zeros(1, _MEMORY), np.zeros(1, STEP), np.ones(1)
    _filter(memory, one, one, one, 0.0, one, np.ones((3, 1)), steps)
    _follow(memory, steps, 0.0, 0.0, np.empty(0), np.empty(1), np.empty((1, 3)))
