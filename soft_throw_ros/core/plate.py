# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Motions of the plate.

Every motion is at rest at height 0 before time 0 (a sampled one: before its first sample), and
has a position and a velocity at any time. An engine's motion starts at time 0. The closed form
takes `Underdamped`; measured motions and those from files are `SampledMotion`.
`soft_throw_ros.core.stepper` evaluates both inside compiled steppers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
import math
from typing import Any, TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.rig import Engine

if TYPE_CHECKING:  # SciPy takes half a second to import: that is done where a motion is sampled
    from scipy.interpolate import PPoly

Floats = NDArray[np.float64]


class Motion:
    """Base of the motions."""

    def states_at(self, time: Floats) -> Floats:
        """Height [m], velocity [m/s] and acceleration [m/s2], in the last axis."""
        raise NotImplementedError

    def position(self, time: ArrayLike) -> Floats:
        """Height of the plate [m]."""
        return np.asarray(self.states_at(np.asarray(time, dtype=np.float64))[..., 0])

    def velocity(self, time: ArrayLike) -> Floats:
        """Velocity of the plate [m/s]."""
        return np.asarray(self.states_at(np.asarray(time, dtype=np.float64))[..., 1])


@dataclass(frozen=True, kw_only=True)
class Underdamped(Engine, Motion):
    r"""
    The motion of an engine: a damped step up, over, and down to the new height.

    Eqs. (D2)-(D4) of [1]_, and (1) without damping, with
    :math:`\omega_d = \omega \sqrt{1 - \zeta^2}`:

    .. math:: V_p = \frac{A \omega}{\sqrt{1 - \zeta^2}} e^{-\zeta \omega t} \sin \omega_d t

    References
    ----------
    .. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

    Examples
    --------
    >>> plate = Underdamped(frequency=63.2, amplitude=2e-3, damping_ratio=0.064)
    >>> round(plate.peak_velocity, 6)
    0.721043

    """

    damping_ratio: float = 0.0

    @classmethod
    def of(cls, engine: Engine) -> Underdamped:
        """Make the motion of `engine` without its recorded one."""
        return cls(**{**vars(engine), 'motion': None})

    @property
    def exponent(self) -> complex:
        r""":math:`\lambda = -\zeta \omega + i \omega_d` [1/s]."""
        zeta = self.damping_ratio
        return self.angular_frequency * complex(-zeta, math.sqrt(1.0 - zeta**2))

    @property
    def peak_velocity(self) -> float:
        """:math:`V_p^*`, Eq. (D4) [m/s]."""
        return float(self.speed_scale * peak_velocity_ratio(self.damping_ratio))

    @property
    def peak_velocity_time(self) -> float:
        """:math:`t_v`, when the plate is fastest (D3) [s]."""
        return math.acos(self.damping_ratio) / self.exponent.imag

    def states_at(self, time: Floats) -> Floats:
        """Height [m], velocity [m/s] and acceleration [m/s2]."""
        rate, since = self.exponent, np.maximum(time, 0.0)
        height, velocity, acceleration = damped_state(since, self.amplitude, rate.real, rate.imag)
        return np.stack((height, velocity, np.where(time < 0.0, 0.0, acceleration)), axis=-1)


def damped_state(time: Any, amplitude: float, growth: float, turn: float) -> tuple[Any, Any, Any]:
    """Compute height, velocity and acceleration of a damped step, also inside kernels."""
    half_sine, half_cosine = np.sin(0.5 * turn * time), np.cos(0.5 * turn * time)
    fading = np.expm1(growth * time)
    decayed = 1.0 + fading
    # 1 - cos as 2 sin^2, so that the first micrometres keep their digits
    sine, versine = 2.0 * half_sine * half_cosine, 2.0 * half_sine * half_sine
    rise = versine * decayed - fading + growth / turn * decayed * sine  # Eq. (D2)
    turning = turn * (1.0 - versine) + growth * sine
    factor = amplitude * (turn + growth * growth / turn)
    return amplitude * rise, factor * decayed * sine, factor * decayed * turning  # Eq. (D1)


def peak_velocity_ratio(damping_ratio: Any) -> Any:
    r"""Compute the largest plate speed over :math:`A \omega`, Eq. (D4), of one or many plates."""
    rate = damping_ratio / np.sqrt(1.0 - damping_ratio**2)
    return np.exp(-rate * np.arccos(damping_ratio))


@dataclass(frozen=True, eq=False)
class SampledMotion(Motion):
    """
    A motion given by states of the plate, which quintics join: at rest before and after them.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Increasing. [s]
    states : ndarray, shape (n, 3)
        Height, velocity and acceleration at each. [m], [m/s], [m/s2]

    Raises
    ------
    ValueError
        If fewer than 2 states are given, a value is not finite, or times do not increase.

    """

    times: Floats
    states: Floats
    _path: PPoly = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times, states = require_samples(self.times, self.states, 'states', least=2, columns=(3,))
        from scipy.interpolate import PPoly

        path = PPoly(quintic(np.diff(times), states[:-1].T, states[1:].T)[::-1], times)
        for name, value in (('times', times), ('states', states), ('_path', path)):
            object.__setattr__(self, name, value)

    @classmethod
    def from_positions(cls, times: ArrayLike, positions: ArrayLike) -> SampledMotion:
        """
        Lay a twice differentiable cubic spline through positions; fourth order in the spacing.

        It starts at rest, and heights [m] count from the first sample. ValueError if fewer than 4
        samples are given, a value is not finite, or times [s] do not increase.
        """
        times, positions = require_samples(times, positions, 'positions')
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(times, positions - positions[0], bc_type=((1, 0.0), 'not-a-knot'))
        return cls(times, np.stack([spline(times, order) for order in range(3)], axis=1))

    def scaled(self, *, time: float = 1.0, height: float = 1.0) -> SampledMotion:
        """Return the motion with scaled times and scaled heights."""
        states = self.states * height / time ** np.arange(3.0)
        return SampledMotion(self.times * time, states)

    @property
    def end_time(self) -> float:
        """Time of the last state [s]."""
        return float(self.times[-1])

    @cached_property
    def peak_velocity_time(self) -> float:
        """Time of the largest upward speed, of 16 points between states [s]."""
        between = np.linspace(self.times[:-1], self.times[1:], 17)
        return float(between.flat[self.velocity(between).argmax()])

    @property
    def peak_velocity(self) -> float:
        """Largest upward speed [m/s]."""
        return float(self.velocity(self.peak_velocity_time))

    def states_at(self, time: Floats) -> Floats:
        """Height [m], velocity [m/s] and acceleration [m/s2]."""
        inside = np.clip(time, self.times[0], self.times[-1])
        rates = (np.where(time == inside, self._path(inside, order), 0.0) for order in (1, 2))
        return np.stack((self._path(inside), *rates), axis=-1)


PlateMotion: TypeAlias = Underdamped | SampledMotion
"""A motion that every model of a throw accepts."""


def motion_of(engine: Engine) -> PlateMotion:
    """Return how the plate of an engine moves."""
    return engine.motion or Underdamped.of(engine)


def require_samples(
    times: ArrayLike, values: ArrayLike, name: str, *, least: int = 4,
    columns: tuple[int, ...] = (),
) -> tuple[Floats, Floats]:
    """Return times, which increase, and values as arrays of finite floats, or raise ValueError."""
    times = np.ascontiguousarray(times, dtype=np.float64)
    values = np.ascontiguousarray(values, dtype=np.float64)
    if times.ndim != 1 or times.size < least or values.shape != (times.size, *columns):
        raise ValueError(
            f'{name} must be of shape {(times.size, *columns)} for their times, at least {least}, '
            f'got shapes {values.shape} and {times.shape}'
        )
    for label, array in (('times', times), (name, values)):
        for index in zip(*np.nonzero(~np.isfinite(array)), strict=True):
            raise ValueError(f'{label} must be finite, got {array[index]} at index {index[0]}')
    for n in (1 + np.flatnonzero(np.diff(times) <= 0.0)).tolist():
        raise ValueError(f'times must increase, got {times[n]} after {times[n - 1]} at index {n}')
    return times, values


def quintic(D: Any, state: Any, later: Any) -> tuple[Any, ...]:
    """Return the coefficients, lowest order first, of a quintic between states D apart."""
    rise = later[0] - state[0]
    v, w = state[1] * D, later[1] * D
    q, r = state[2] * D * D, later[2] * D * D
    return (
        state[0], state[1], 0.5 * state[2],
        (10.0 * rise - 4.0 * w - 6.0 * v + 0.5 * r - 1.5 * q) / D**3,
        (7.0 * w + 8.0 * v - 15.0 * rise + 1.5 * q - r) / D**4,
        (6.0 * rise - 3.0 * (v + w) + 0.5 * (r - q)) / D**5,
    )
