# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Two limits of the model: a thick layer (App. C) and a massless spring (App. A, Fig. 7).

The projectile leaves a thick layer before the wave has returned. The throw then depends only on
:math:`\omega \tau`. Its results are the angle :math:`\omega (t_e - t_s)` of the plate when the
wave of the release starts there, and the energy transfer factor. The plate is harmonic, without
gravity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from soft_throw_ros.core.closed_form import first_releases, spring_release
import style

Floats = NDArray[np.float64]

_SPEED_RATIO = 1.0
"""Any value below 4: the wave must return after half a plate period. [-]"""


class ThickLayer(NamedTuple):
    r"""Angle :math:`\omega (t_e - t_s)` [rad] and energy transfer factor [-]."""

    angle: Floats
    energy_transfer: Floats


def exact(omega_tau: ArrayLike) -> ThickLayer:
    r"""Return the exact results for given :math:`\omega \tau`."""
    mass_ratio = np.asarray(omega_tau) * _SPEED_RATIO / (2.0 * math.pi)
    releases = first_releases(mass_ratio=mass_ratio, speed_ratio=_SPEED_RATIO)
    angle = 2.0 * math.pi * (np.asarray(releases.ejection_phase) - 1.0 / _SPEED_RATIO)
    return ThickLayer(angle, np.asarray(releases.energy_transfer))


def light_projectile(omega_tau: ArrayLike) -> ThickLayer:
    r"""
    Return the approximation for small :math:`\omega \tau`: App. C(i), corrected.

    Notes
    -----
    The angle :math:`a` is :math:`\pi / 2 + \arctan \omega \tau - e^{-1 - \pi / (2 \omega \tau)}`,
    and the transfer factor :math:`4 \sin^2 a`, which tends to :math:`4 / (1 + (\omega \tau)^2)`.

    """
    omega_tau = np.asarray(omega_tau, dtype=np.float64)
    delay = np.arctan(omega_tau) - np.exp(-1.0 - math.pi / (2.0 * omega_tau))
    return ThickLayer(0.5 * math.pi + delay, 4.0 * np.cos(delay) ** 2)


def heavy_projectile(omega_tau: ArrayLike) -> ThickLayer:
    r"""Return the approximation for large :math:`\omega \tau`, App. C(ii)."""
    omega_tau = np.asarray(omega_tau, dtype=np.float64)
    return ThickLayer(math.pi - 2.0 / omega_tau + math.pi / omega_tau**2, 16.0 / omega_tau**2)


def best_frequency_ratio() -> float:
    """Return the best frequency ratio f_0 / f of a massless spring, from Eq. (A4)."""

    def slope(q: float) -> float:
        """Return the logarithmic derivative of the speed."""
        angle = 2.0 * math.pi / (q + 1.0)
        return angle / (q + 1.0) / math.tan(angle) + 1.0 / (q * (q - 1.0))

    return float(brentq(slope, 1.1, 2.9, xtol=1e-15))


def draw_spring() -> Figure:
    """Draw Fig. 7: the massless spring, and layers with different masses."""
    figure, panels = style.new_figure(
        'Fig. 7   App. A: the massless spring, and layers that have mass',
        'A layer much lighter than the projectile acts as a spring. Lighter projectiles gain more '
        'energy than from any spring.',
        height=4.5,
    )
    ratio = np.linspace(0.02, 5.0, 1200)
    spring = spring_release(frequency_ratio=ratio)
    for mu, color in ((0.25, style.ORANGE), (1.0, style.SKY), (4.0, style.BLUE)):
        layer = first_releases(
            mass_ratio=mu, speed_ratio=2.0 * math.pi * math.sqrt(mu) * ratio
        )
        label = rf'layer, $\mu = m/\rho_s S L_s$ = {mu:g}'
        results = layer.ejection_phase, layer.energy_transfer
        style.draw_results(panels, ratio, *results, color=color, label=label)
    best = best_frequency_ratio()
    for axes, values in zip(panels, (spring.ejection_phase, spring.energy_transfer), strict=True):
        axes.plot(ratio, values, color=style.BLACK, ls='--', label=r'spring: $\mu \to \infty$')
        axes.axvline(best, color='0.7', lw=0.8, zorder=0)
    style.label_results(panels, phase_end=1.2, xlabel='$f_0 / f$', xlim=(0.0, 5.0))
    panels[1].plot(1.62, 3.13, **style.PAPER, label=r'paper: $f_0/f$ = 1.62, $\alpha$ = 3.13')
    return style.legend_below(figure, panels[1], columns=3)
