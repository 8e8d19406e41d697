# SPDX-License-Identifier: Apache-2.0
r"""
A layer so thick that the projectile is gone before a wave has gone down and up again (App. C).

Then one number decides, :math:`\omega \tau`, and what is asked for is the angle
:math:`\omega (t_e - t_s)` that the plate has behind it when the wave of the release starts, and
the energy transfer factor. The plate is harmonic, and there is no gravity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.travelling_wave import first_releases

Floats = NDArray[np.float64]

_SPEED_RATIO = 1.0  # any below 4 will do: half a plate period is over before the wave returns


class ThickLayer(NamedTuple):
    r"""Angle :math:`\omega (t_e - t_s)` [rad] and energy transfer factor [-]."""

    angle: Floats
    energy_transfer: Floats


def exact(omega_tau: ArrayLike) -> ThickLayer:
    r"""
    Compute both without approximation.

    Parameters
    ----------
    omega_tau : array_like
        :math:`\omega \tau`. [-]

    Returns
    -------
    ThickLayer

    """
    mass_ratio = np.asarray(omega_tau) * _SPEED_RATIO / (2.0 * math.pi)
    releases = first_releases(mass_ratio=mass_ratio, speed_ratio=_SPEED_RATIO)
    angle = 2.0 * math.pi * (np.asarray(releases.ejection_phase) - 1.0 / _SPEED_RATIO)
    return ThickLayer(angle, np.asarray(releases.energy_transfer))


def light_projectile(omega_tau: ArrayLike) -> ThickLayer:
    r"""
    Approximate both for small :math:`\omega \tau`.

    Notes
    -----
    App. C(i), mended, with :math:`d = \omega \tau - e^{-1 - \pi / (2 \omega \tau)}`:
    the angle is :math:`\pi / 2 + d`, the transfer factor :math:`4 - 4 d^2`.

    """
    omega_tau = np.asarray(omega_tau, dtype=np.float64)
    delay = omega_tau - np.exp(-1.0 - math.pi / (2.0 * omega_tau))
    return ThickLayer(0.5 * math.pi + delay, 4.0 - 4.0 * delay**2)


def light_projectile_as_printed(omega_tau: ArrayLike) -> ThickLayer:
    r"""
    Approximate both as App. C(i) is printed, with another sign, without 1/e, and with 2 for 4.

    Notes
    -----
    With :math:`d = \omega \tau + e^{-\pi / (2 \omega \tau)}`, the angle is :math:`\pi / 2 + d`,
    the transfer factor :math:`4 - 2 d^2`.

    """
    omega_tau = np.asarray(omega_tau, dtype=np.float64)
    delay = omega_tau + np.exp(-math.pi / (2.0 * omega_tau))
    return ThickLayer(0.5 * math.pi + delay, 4.0 - 2.0 * delay**2)


def heavy_projectile(omega_tau: ArrayLike) -> ThickLayer:
    r"""
    Approximate both for large :math:`\omega \tau`, App. C(ii).

    Notes
    -----
    The plate is back at rest, half a period after the start, when the wave of the release starts
    there; the transfer factor is :math:`16 / (\omega \tau)^2`.

    """
    omega_tau = np.asarray(omega_tau, dtype=np.float64)
    return ThickLayer(np.full(omega_tau.shape, math.pi), 16.0 / omega_tau**2)
