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

The speed and the time of the release and the largest speed of the plate depend linearly on
:math:`q`, by `ReleaseResponse`. The covariances of their expected values with the state follow
from it, so that their errors are those of the whole path, with all correlations.

A stamp with the error :math:`\sigma_t` displaces a height by :math:`\dot z \sigma_t`, which adds
to the noise. A height counts as at most six standard errors off.

References
----------
.. [1] G. J. Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18
   (1973) 65.

"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.kernels import kernel, Record, subroutine
from soft_throw_ros.core.plate import PlateMotion, Underdamped
from soft_throw_ros.twin.sample_buffer import Onset, OUTLIER_SIGMAS, Samples

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
_AVERAGED = 16
"""Innovations whose mean square shows that more than the stated noise acts. [-]"""
_FIRST_RATIO = 0.5
"""Mean square before the first ones, so small that chance rarely makes it larger than 1. [-]"""

_MEMORY = np.dtype(
    [
        ('omega', 'f8'),  # of Eq. (D1) [1/s]
        ('zeta', 'f8'),
        ('unmodelled', 'f8'),  # spectral density of q [m2/s3]
        ('time', 'f8'),  # since the start [s]
        ('state', 'f8', (3,)),
        ('covariance', 'f8', (3, 6)),  # of the state with itself, and with the release
        ('release', 'f8', (3,)),  # variances of the expected release
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


@dataclass
class ReleaseResponse:
    """Changes of a throw by a change of the velocity of the plate by 1 m/s at a time."""

    times: Floats  # since the start, shape (n,) [s]
    changes: Floats  # of speed [m/s] and time [s] of the release, and peak speed [m/s]; (3, n)
    release_time: float  # expected, 0 for none [s]

    def __post_init__(self) -> None:
        """Integrate over time from each time to the last."""
        strips = 0.5 * np.diff(self.times, append=self.times[-1])
        # variances by later accelerations, over their density
        self.later = _integrals(strips, self.changes**2)
        self.total = _integrals(strips, self.changes)[:, 0].copy()


def pulse_of(motion: PlateMotion, since: Floats) -> Floats:
    """Return the states of a plate at times after a change of its velocity by 1 m/s."""
    if not isinstance(motion, Underdamped):
        return np.stack((since, np.ones(since.size), np.zeros(since.size)), axis=-1)
    omega = motion.angular_frequency
    # the velocity after a step of the force is the height after a pulse
    _, height, velocity = motion.states_at(since).T / (motion.amplitude * omega**2)
    acceleration = -omega * (omega * height + 2.0 * motion.damping_ratio * velocity)
    return np.stack((height, velocity, acceleration), axis=-1)


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
def _predict(s: Record, time: float, axis: Floats, changes: Floats) -> None:
    """Go on to a later time."""
    h, middle = time - s.time, 0.5 * (s.time + time)
    f, p, moved = np.zeros((3, 3)), s.covariance, np.zeros((3, 6))
    x0, x1, x2 = s.state[0], s.state[1], s.state[2]
    _transition(s, h, f)
    for i in range(3):
        s.state[i] = f[i, 0] * x0 + f[i, 1] * x1 + f[i, 2] * x2
        for j in range(6):
            moved[i, j] = f[i, 0] * p[0, j] + f[i, 1] * p[1, j] + f[i, 2] * p[2, j]
    for i in range(3):
        for j in range(3):
            p[i, j] = moved[i, 0] * f[j, 0] + moved[i, 1] * f[j, 1] + moved[i, 2] * f[j, 2]
            p[i, 3 + j] = moved[i, 3 + j]
    velocity = h * s.unmodelled * max(1.0, s.ratio) ** 2  # its variance by q
    p[0, 0] += h * h / 3.0 * velocity
    p[0, 1] += 0.5 * h * velocity
    p[1, 0] += 0.5 * h * velocity
    p[1, 1] += velocity
    for n in range(3):
        change = np.interp(middle, axis, changes[n])
        p[0, 3 + n] += 0.5 * h * velocity * change
        p[1, 3 + n] += velocity * change
        s.release[n] += velocity * change * change
    s.time = time


@kernel
def _begin(
    memory: NDArray[np.void], omega: float, zeta: float, amplitude: float, unmodelled: float,
    deviations: tuple[float, float, float], changes: Floats, total: Floats,
    steps: NDArray[np.void],
) -> None:
    """Write the state at the start, and a step without a sample."""
    s = memory[0]
    s.omega, s.zeta, s.unmodelled, s.state[2] = omega, zeta, unmodelled, amplitude
    s.ratio, s.settled = _FIRST_RATIO, -1.0
    for n in range(3):
        # by height, velocity and amplitude at the start: (D1) has the difference of two of them
        by_amplitude = s.omega**2 * total[n]
        by_state = -by_amplitude, changes[n, 0], by_amplitude
        for i in range(3):
            variance = deviations[i] ** 2
            s.covariance[i, i] = variance
            s.covariance[i, 3 + n] = variance * by_state[i]
            s.release[n] += variance * by_state[i] ** 2
    steps[0].state[:], steps[0].covariance[:] = s.state, s.covariance[:, :3]
    s.steps = 1


@kernel
def _filter(
    memory: NDArray[np.void], times: Floats, heights: Floats, errors: Floats, stamp_error: float,
    axis: Floats, changes: Floats, steps: NDArray[np.void],
) -> None:
    """Go on to each time, and take the measured height there."""
    s = memory[0]
    for n in range(times.size):
        _predict(s, times[n], axis, changes)
        p, step = s.covariance, steps[s.steps]
        s.steps += 1
        variance = p[0, 0] + errors[n] ** 2 + (s.state[1] * stamp_error) ** 2
        most = OUTLIER_SIGMAS * math.sqrt(variance)
        error = min(max(heights[n] - s.state[0], -most), most)
        gain = p[0] / variance
        step.time, step.pull = times[n], error / variance
        step.state[:], step.covariance[:], step.gain[:] = s.state, p[:, :3], gain[:3]
        for i in range(3):
            s.state[i] += gain[i] * error
            s.release[i] -= gain[3 + i] ** 2 * variance
            for j in range(6):
                p[i, j] -= gain[i] * gain[j] * variance
        s.ratio += (error * step.pull - s.ratio) / _AVERAGED


@kernel
def _follow(
    memory: NDArray[np.void], steps: NDArray[np.void], window: float, until: float
) -> tuple[Floats, Floats, int]:
    """Smooth and continue the states as `PlateObserver.motion`; remove the settled steps."""
    s, count, settled, last = memory[0], 0, 0, memory[0].settled
    ahead = max(math.ceil((until - s.time) / (_SPACING * window)), 0)
    times, states = np.empty(s.steps + ahead), np.empty((s.steps + ahead, 3))
    smoothed = _smooth(s, steps)
    for n in range(s.steps):
        time = steps[n].time
        # 0.99, because times are rounded
        if time >= last + 0.99 * _SPACING * window or n == s.steps - 1:
            last = times[count] = time
            states[count] = smoothed[n]
            count += 1
            if time <= s.time - _SETTLED * window:
                settled, s.settled = count, time
    f = np.zeros((3, 3))
    for n in range(1, ahead + 1):
        times[count] = s.time + (until - s.time) / ahead * n
        _transition(s, times[count] - s.time, f)
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
    return times[:count], states[:count], settled


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


@kernel
def _errors(
    memory: NDArray[np.void], axis: Floats, later: Floats
) -> tuple[float, float, float]:
    """Compute the standard errors of speed and time of the release, and of the peak speed."""
    s, errors = memory[0], np.empty(3)
    ratio = max(1.0, s.ratio)  # larger errors if more than the noise acts
    for n in range(3):
        unknown = ratio**2 * s.unmodelled * np.interp(s.time, axis, later[n])
        errors[n] = math.sqrt(ratio * (s.release[n] + unknown))
    return errors[0], errors[1], errors[2]


def _integrals(strips: Floats, rows: Floats) -> Floats:
    """Return the integrals of rows from each time to the last, with half of the spacings."""
    strips = strips * (rows + np.roll(rows, -1, axis=1))
    return np.ascontiguousarray(np.flip(np.flip(strips, axis=1).cumsum(axis=1), axis=1))


class PlateObserver:
    """
    The plate in a throw; times are since the onset [s].

    States are rows of height above rest [m], velocity [m/s] and acceleration [m/s2].
    """

    def __init__(
        self, config: MeasurementConfig, onset: Onset, response: ReleaseResponse
    ) -> None:
        plate, omega = config.plate, config.plate.angular_frequency
        self._config, self._onset, self._response = config, onset, response
        self.next_ns = onset.onset_ns + 1  # time from which samples are not used yet [ns]
        is_engine = isinstance(config.motion, Underdamped)
        self._command = None if is_engine else config.motion
        engine = (omega, plate.damping_ratio, plate.amplitude) if is_engine else (0.0, 0.0, 0.0)
        unmodelled = UNMODELLED if is_engine else _COMMANDED * UNMODELLED
        stiffness, damping = config.frequency_error / plate.frequency, config.damping_error
        relative = math.hypot(unmodelled, 2.0 * stiffness, 2.0 * damping)
        swing = plate.amplitude * omega
        deviations = onset.rest.error, unmodelled * swing, AMPLITUDE_ERROR * plate.amplitude
        self._memory = np.zeros(1, _MEMORY)
        self._present = self._memory[0]
        self._steps = np.zeros(128, STEP)  # of the filter, which grow
        _begin(
            self._memory, *engine, (relative * plate.peak_velocity) ** 2 * omega, deviations,
            response.changes, response.total, self._steps,
        )

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
        response, steps, used = self._response, self._steps, int(self._present['steps'])
        if used + times.size > steps.size:
            self._steps = np.zeros(2 * (used + times.size), STEP)
            self._steps[:used] = steps[:used]
        _filter(
            self._memory, times, heights, errors, stamp_error,
            response.times, response.changes, self._steps,
        )

    def motion(self, until: float) -> tuple[Floats, Floats, int]:
        """
        Return times and states by the samples, and their continuation up to a later time.

        They begin after those that earlier calls settled. The third result is the number of those
        that are settled now, and do not change any more.
        """
        window = self._config.smoothing_window
        times, states, settled = _follow(self._memory, self._steps, window, until)
        if self._command is not None:
            states += self._command.states_at(times)
        if times.size and times[0] == 0.0:
            # an onset that is too early must not pull the layer down
            states[0, 1] = max(states[0, 1], 0.0)
        return times, states, settled

    def errors(self) -> tuple[float, float, float]:
        """Return the standard errors of speed and time of the release, and of the peak speed."""
        errors: tuple[float, float, float]
        errors = _errors(self._memory, self._response.times, self._response.later)
        return errors


def warm_up() -> None:
    """Compile or load the kernels."""
    memory, steps, one, rows = np.zeros(1, _MEMORY), np.zeros(2, STEP), np.ones(1), np.ones((3, 1))
    _begin(memory, 1.0, 0.0, 1.0, 1.0, (1.0, 1.0, 1.0), rows, np.ones(3), steps)
    _filter(memory, one, one, one, 0.0, one, rows, steps)
    _follow(memory, steps, 1.0, 0.0)
    _errors(memory, one, rows)
