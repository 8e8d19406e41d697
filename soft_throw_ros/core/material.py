# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Materials of a layer: laws of stress and strain, and of internal loss.

Notes
-----
With the stretch :math:`\lambda = 1 + \epsilon` the nominal stress of a rod is :math:`E \epsilon`,
or that of a neo-Hookean one, :math:`\frac{E}{3} (\lambda - \lambda^{-2})`. Where the stress grows
faster than strain, compression waves steepen into shocks. They are resolved by an artificial
viscosity (von Neumann and Richtmyer, [1]_), a stress :math:`2 \rho (\Delta v)^2` in cells that are
being compressed, which is of second order where waves are smooth; its work counts as heat.
In very strong shocks the stress grows only linearly, so that the step stays stable.

A constant loss tangent is that of a spring beside a few Maxwell elements,

.. math::

    \sigma = E_\infty \epsilon + \sum_l E_l q_l, \qquad \dot q_l = \dot \epsilon - \omega_l q_l,

whose strengths are fitted by least squares to the loss tangent over a band around the plate's
frequency, as seismology does ([2]_), and scaled so that the wave speed is that at the plate's
frequency. Heat is :math:`\sum E_l \omega_l q_l^2`, which is never negative. Where the layer is
neo-Hookean, it is the spring that is.

References
----------
.. [1] J. VonNeumann and R. D. Richtmyer, J. Appl. Phys. 21, 232 (1950).
.. [2] H. Emmerich and M. Korn, Geophysics 52, 1252 (1987).

"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

STRESS_STRAIN_LAWS = ('linear', 'neo_hookean')
"""Laws of stress over strain of a layer."""

LOSSES = ('kelvin_voigt', 'constant')
"""Frequency dependence of the loss tangent: in proportion to the frequency, or constant."""

LARGEST_STRAIN = 0.5
"""
Largest compression at which a neo-Hookean layer follows its law; beyond it the stress continues
along the tangent, which bounds the wave speed and the time step. [-]
"""

LARGEST_CONSTANT_LOSS = 0.8
"""Largest constant loss tangent: a material that loses more is almost a liquid."""

BAND = (0.25, 16.0)
"""
Range of frequencies in which the loss tangent is fitted. [plate frequencies]

The fit deviates by 5 % up to a loss tangent of 0.2, and by 12 % up to 0.8.
"""

RELAXATION_RATES = (0.2, 2.0, 20.0)
"""Relaxation rates of the Maxwell elements, over the plate's angular frequency. [-]"""


@lru_cache(maxsize=4096)
def relaxation(loss_tangent: float) -> tuple[float, ...]:
    """
    Fit Maxwell elements to a constant loss tangent, at most `LARGEST_CONSTANT_LOSS`.

    The moduli, over that at the plate's frequency, are those of the spring and of each element.
    """
    if loss_tangent == 0.0:
        return 1.0, 0.0, 0.0, 0.0
    from scipy.optimize import nnls  # which takes long to import, and few layers need

    rates = np.array(RELAXATION_RATES)
    omega = np.geomspace(*BAND, 41)[:, None]
    matrix = (rates * omega + rates**2 * loss_tangent) / (rates**2 + omega**2)
    shares, _ = nnls(matrix, np.full(len(matrix), loss_tangent))
    storage = 1.0 - float((shares * rates**2 / (rates**2 + 1.0)).sum())  # at the plate's frequency
    return tuple((np.append(1.0 - shares.sum(), shares) / storage).tolist())


def static_stretch(load: float) -> float:
    """Find the stretch of a neo-Hookean layer under a load over a third of modulus and section."""
    stretch = 1.0
    for _ in range(50):  # Newton, from above: the curve is concave
        excess = stretch - 1.0 / (stretch * stretch) + load
        stretch = max(stretch - excess / (1.0 + 2.0 / stretch**3), 0.5 * stretch)
    return stretch
