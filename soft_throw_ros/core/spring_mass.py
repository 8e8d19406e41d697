# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Time and speed of the release of a projectile from a massless spring (App. A of the paper).

The spring is the limit of a layer with a crossing time of zero: accurate for light, stiff layers,
and a reference for others. The only parameter is the natural frequency of the projectile on the
layer over the frequency of the engine, :math:`q = f_0 / f`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import FirstRelease


def first_release(*, frequency_ratio: ArrayLike) -> FirstRelease:
    r"""
    Compute time and speed of the first release from a massless spring.

    The plate is harmonic, and there is no gravity.

    Parameters
    ----------
    frequency_ratio : array_like
        :math:`q = f_0 / f`, `Rig.natural_frequency` over the frequency of the engine. [-]

    Returns
    -------
    FirstRelease
        Floats or arrays, with the shape of `frequency_ratio`.

    Raises
    ------
    ValueError
        If a ratio is not finite and positive.

    Notes
    -----
    Eqs. (A2)-(A4), :math:`t_e f = 1 / (1 + q)` and

    .. math:: \frac{V_e}{V_p^*} = \frac{q}{q - 1} \sin \frac{2 \pi}{q + 1},

    written as :math:`\pi q / (q + 1)\, \mathrm{sinc}\, \pi (q - 1) / (q + 1)`, which is
    :math:`\pi / 2` at :math:`q = 1` instead of 0/0. As in the paper, the plate has no damping;
    typical damping changes a throw by a few percent.

    Examples
    --------
    >>> release = first_release(frequency_ratio=[0.5, 1.0, 2.0])
    >>> release.ejection_phase.round(4), release.energy_transfer.round(4)
    (array([0.6667, 0.5   , 0.3333]), array([0.75  , 2.4674, 3.    ]))

    """
    q = checks.require_all('frequency_ratio', frequency_ratio, 'positive')
    speed = math.pi * q / (q + 1.0) * np.sinc((q - 1.0) / (q + 1.0))
    return FirstRelease(1.0 / (1.0 + q), speed, speed**2)
