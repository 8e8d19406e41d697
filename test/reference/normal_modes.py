# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Exact time and speed of the first release of a rigid projectile from a layer with internal loss.

Kelvin-Voigt loss, :math:`\sigma = E_s (\epsilon + \theta \dot\epsilon)`, whose loss tangent at
the plate's frequency is :math:`\omega \theta`. The modes of layer and mass are those without loss,
and each is damped by itself.

Notes
-----
Time in crossings :math:`t_s`, speed in :math:`A \omega / \sqrt{1 - \zeta^2}`, so that
:math:`V_p = \Im e^{\lambda t}`. In the Laplace domain, with :math:`q^2 = s^2 / (1 + \theta s)`,

.. math:: V_m = V_p / D, \qquad D = \cosh q + \mu\, q \sinh q

The poles are :math:`\lambda`, with the steady motion :math:`\Im e^{\lambda t} / D(\lambda)`,
and the modes :math:`q = i \beta_n` with :math:`\beta \tan \beta = 1 / \mu`, two for each n:
:math:`s = -\theta \beta^2 / 2 \pm \sqrt{\theta^2 \beta^4 / 4 - \beta^2}`. The residue there is

.. math::

    \frac{s^3}{\beta^4 (2 + \theta s)}\, \frac{\Im \lambda}{(s - \lambda)(s - \bar\lambda)}\,
    \frac{2}{(1 + \mu) \sin \beta / \beta + \mu \cos \beta}

The contact force is :math:`m (\dot V_m + g)`, and the projectile leaves when it first falls to 0.

"""

import cmath
import math

import numpy as np
from scipy.optimize import brentq

MODES = 400
EARLY = 0.5  # until then the sum need not be complete: nothing has arrived yet


def first_release(
    *, mass_ratio, speed_ratio, loss_tangent, damping_ratio=0.0, gravity_ratio=0.0, periods=8.0
):
    """
    Find the first release: (t_e f, V_e / (A w)), or None if there is none in so many periods.

    Errors are below 1e-7 for mass ratios from 0.01 and loss tangents from 1e-3 on.
    """
    mu, omega = mass_ratio, 2.0 * math.pi / speed_ratio
    root = math.sqrt(1.0 - damping_ratio**2)
    lam, theta = complex(-damping_ratio * omega, root * omega), loss_tangent / omega
    weight = gravity_ratio * omega * root
    q = lam / cmath.sqrt(1.0 + theta * lam)
    steady = 1.0 / (cmath.cosh(q) + mu * q * cmath.sinh(q))
    beta = np.array([
        brentq(lambda b: mu * b * math.sin(b) - math.cos(b), low, low + 0.5 * math.pi, xtol=1e-14)
        for low in math.pi * np.arange(MODES)
    ])
    half = 0.5 * theta * beta**2
    split = np.sqrt(half**2 - beta**2 + 1e-12j * beta**2)
    fast = -half - split
    s, beta = np.concatenate((fast, beta**2 / fast)), np.tile(beta, 2)
    shape = 2.0 / ((1.0 + mu) * np.sin(beta) / beta + mu * np.cos(beta))
    residues = s**3 / (beta**4 * (2.0 + theta * s)) * lam.imag
    residues = residues / ((s - lam) * (s - lam.conjugate())) * shape

    def sum_up(time, order):
        growing = np.exp(np.maximum((s * time).real, -600.0) + 1j * (s * time).imag)
        modes = (residues * s**order * growing).sum().real
        return (steady * lam**order * cmath.exp(lam * time)).imag + modes

    def push(time):
        return sum_up(time, 1) + weight

    step = min(max(0.25 * max(mu, math.sqrt(theta)), 1.0 / 64.0), 1.0 / 16.0, 0.1 / abs(lam))
    is_armed, before = weight > 0.0, EARLY
    for time in np.arange(EARLY, 1.0 + periods * speed_ratio, step):
        force = push(time)
        if is_armed and force <= 0.0:
            end = brentq(push, before, time, xtol=1e-13)
            return end / speed_ratio, sum_up(end, 0) / root
        is_armed = is_armed or force > 1e-6 * omega
        before = time
    return None
