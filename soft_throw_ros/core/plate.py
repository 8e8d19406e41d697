# SPDX-License-Identifier: Apache-2.0
"""
How the plate moves.

Every motion is at rest at height 0 before time 0 (a sampled one: before its first sample), and
answers position and velocity for any times. `Underdamped` is what the closed forms are made for,
`Sampled` is what was measured.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Engine

Floats = NDArray[np.float64]


class PlateMotion(Protocol):
    """What a model of a throw asks of the plate."""

    @property
    def peak_velocity(self) -> float:
        """Largest speed :math:`V_p^*`. [m/s]"""

    @property
    def knots(self) -> Floats:
        """Times at which the motion is not smooth, increasing, the start first. [s]"""

    def position(self, time: ArrayLike) -> Floats:
        """Height of the plate at `time`. [m]"""

    def velocity(self, time: ArrayLike) -> Floats:
        """Velocity of the plate at `time`. [m/s]"""


@dataclass(frozen=True, kw_only=True)
class Underdamped:
    r"""
    A step answered by a damped oscillator: up, over, and down to the new height.

    Parameters
    ----------
    frequency : float
        Natural frequency :math:`f` (of the undamped oscillator). [Hz]
    amplitude : float
        Height :math:`A` at which the plate settles. [m]
    damping_ratio : float
        :math:`\zeta`; 0 gives the harmonic motion :math:`A (1 - \cos \omega t)` of Eq. (1). [-]

    Raises
    ------
    ValueError
        If a value is not finite and positive, or `damping_ratio` is not in [0, 1).

    Notes
    -----
    Eqs. (D2)-(D4) of [1]_, with :math:`\omega_d = \omega \sqrt{1 - \zeta^2}`:

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

    frequency: float
    amplitude: float
    damping_ratio: float = 0.0

    def __post_init__(self) -> None:
        for name, check in (
            ('frequency', checks.positive),
            ('amplitude', checks.positive),
            ('damping_ratio', checks.below_one),
        ):
            object.__setattr__(self, name, check(name, getattr(self, name)))

    @classmethod
    def of(cls, engine: Engine) -> Underdamped:
        """Make the motion of `engine`."""
        return cls(
            frequency=engine.frequency,
            amplitude=engine.amplitude,
            damping_ratio=engine.damping_ratio,
        )

    @property
    def exponent(self) -> complex:
        r""":math:`\lambda = -\zeta \omega + i \omega_d`. [1/s]"""
        omega = 2.0 * math.pi * self.frequency
        return omega * complex(-self.damping_ratio, math.sqrt(1.0 - self.damping_ratio**2))

    @property
    def velocity_factor(self) -> float:
        r""":math:`V_p(t)` is the imaginary part of this times :math:`e^{\lambda t}`. [m/s]"""
        omega = 2.0 * math.pi * self.frequency
        return self.amplitude * omega / math.sqrt(1.0 - self.damping_ratio**2)

    @property
    def peak_velocity(self) -> float:
        """:math:`V_p^*`, Eq. (D4). [m/s]"""
        omega = 2.0 * math.pi * self.frequency
        return self.amplitude * omega * peak_velocity_ratio(self.damping_ratio)

    @property
    def peak_velocity_time(self) -> float:
        """:math:`t_v`, when the plate is fastest (D3). [s]"""
        return math.acos(self.damping_ratio) / self.exponent.imag

    @property
    def knots(self) -> Floats:
        """The start alone. [s]"""
        return np.zeros(1)

    def position(self, time: ArrayLike) -> Floats:
        """Height of the plate, Eq. (D2). [m]"""
        time = np.maximum(np.asarray(time, dtype=np.float64), 0.0)
        rate = self.exponent
        decayed = np.exp(rate.real * time)
        sine = -rate.real / rate.imag * np.sin(rate.imag * time)
        # 1 - cos as 2 sin^2, so that the first micrometres keep their digits
        rise = 2.0 * np.sin(0.5 * rate.imag * time) ** 2 * decayed - np.expm1(rate.real * time)
        return np.asarray(self.amplitude * (rise - decayed * sine))

    def velocity(self, time: ArrayLike) -> Floats:
        """Velocity of the plate. [m/s]"""
        time = np.maximum(np.asarray(time, dtype=np.float64), 0.0)
        rate = self.exponent
        return self.velocity_factor * np.exp(rate.real * time) * np.sin(rate.imag * time)


def peak_velocity_ratio(damping_ratio: float) -> float:
    r"""Largest plate speed over :math:`A \omega`, Eq. (D4). [-]"""
    angle = math.acos(damping_ratio)
    return math.exp(-damping_ratio / math.sqrt(1.0 - damping_ratio**2) * angle)


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """
    A measured motion: at rest before the first sample, smooth between samples.

    Make it with `from_positions` or `from_velocities`.

    Parameters
    ----------
    path : PPoly
        Position as a piecewise polynomial of time. [m]
    after : {'error', 'hold'}
        Beyond the last sample: raise, or stay there.

    """

    path: PPoly
    after: Literal['error', 'hold'] = 'error'
    _speed: PPoly = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.after not in ('error', 'hold'):
            raise ValueError(f"after must be 'error' or 'hold', got {self.after!r}")
        object.__setattr__(self, '_speed', self.path.derivative())

    @classmethod
    def from_positions(
        cls, times: ArrayLike, positions: ArrayLike, *, after: Literal['error', 'hold'] = 'error'
    ) -> Sampled:
        """
        Lay a twice differentiable cubic spline through positions.

        It starts at rest. Heights count from the first sample. Fourth order in the spacing.

        Parameters
        ----------
        times : array_like, shape (n,)
            Increasing. [s]
        positions : array_like, shape (n,)
            [m]
        after : {'error', 'hold'}
            Beyond the last sample: raise, or stay there.

        Raises
        ------
        ValueError
            If fewer than 4 samples are given, a value is not finite, or times do not increase.

        """
        times, positions = _checked_samples(times, positions, 'positions')
        spline = CubicSpline(times, positions - positions[0], bc_type=((1, 0.0), 'not-a-knot'))
        return cls(path=spline, after=after)

    @classmethod
    def from_velocities(
        cls, times: ArrayLike, velocities: ArrayLike, *, after: Literal['error', 'hold'] = 'error'
    ) -> Sampled:
        """
        Lay a monotone cubic (PCHIP) through velocities, which overshoots nowhere.

        Third order in the spacing. Parameters and errors as for `from_positions`.
        """
        times, velocities = _checked_samples(times, velocities, 'velocities')
        return cls(path=PchipInterpolator(times, velocities).antiderivative(), after=after)

    @property
    def start_time(self) -> float:
        """Time of the first sample. [s]"""
        return float(self.path.x[0])

    @property
    def end_time(self) -> float:
        """Time of the last sample. [s]"""
        return float(self.path.x[-1])

    @property
    def knots(self) -> Floats:
        """The times of the samples. [s]"""
        return np.asarray(self.path.x)

    @property
    def peak_velocity(self) -> float:
        """Largest upward speed. [m/s]"""
        extrema = self._speed.derivative().roots(extrapolate=False)
        candidates = np.concatenate((self.path.x, extrema[np.isfinite(extrema)]))
        return float(np.max(self._speed(candidates)))

    def position(self, time: ArrayLike) -> Floats:
        """
        Height of the plate. [m]

        Raises
        ------
        ValueError
            Beyond the last sample, unless `after` is 'hold'.

        """
        return np.asarray(self.path(self._within(time)))

    def velocity(self, time: ArrayLike) -> Floats:
        """
        Velocity of the plate. [m/s]

        Raises
        ------
        ValueError
            Beyond the last sample, unless `after` is 'hold'.

        """
        time = np.asarray(time, dtype=np.float64)
        moving = (time >= self.start_time) & (time <= self.end_time)
        return np.where(moving, self._speed(self._within(time)), 0.0)

    def _within(self, time: ArrayLike) -> Floats:
        """Clip times into the samples."""
        time = np.asarray(time, dtype=np.float64)
        if self.after == 'error' and time.size and time.max() > self.end_time:
            raise ValueError(
                f'time {time.max():g} s is after the last plate sample at {self.end_time:g} s'
            )
        return np.asarray(np.clip(time, self.start_time, self.end_time))


def _checked_samples(times: ArrayLike, values: ArrayLike, name: str) -> tuple[Floats, Floats]:
    """Return both as float arrays, or raise ValueError."""
    times = np.asarray(times, dtype=np.float64)
    values = np.asarray(values, dtype=np.float64)
    if times.ndim != 1 or times.shape != values.shape or times.size < 4:
        raise ValueError(
            f'times and {name} must be two series of the same length, at least 4, '
            f'got shapes {times.shape} and {values.shape}'
        )
    for label, array in (('times', times), (name, values)):
        if not np.isfinite(array).all():
            first = int(np.flatnonzero(~np.isfinite(array))[0])
            raise ValueError(f'{label} must be finite, got {array[first]} at index {first}')
    backward = np.flatnonzero(np.diff(times) <= 0.0)
    if backward.size:
        first = int(backward[0])
        raise ValueError(
            f'times must increase, got {times[first + 1]} after {times[first]} '
            f'at index {first + 1}'
        )
    return times, values
