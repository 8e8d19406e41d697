# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The best layer without limits, gravity and loss, by its two ratios (Fig. 3)."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.design.maximise import Box, maximise
from soft_throw_ros.design.score import peak, Score


class BestRatios(NamedTuple):
    r""":math:`\zeta, \mu, \kappa`, and the release without gravity and loss [-]."""

    damping_ratio: float
    mass_ratio: float
    speed_ratio: float
    ejection_phase: float
    energy_transfer: float


@functools.lru_cache(maxsize=64)
def best_ratios(damping_ratio: float) -> BestRatios:
    r"""
    Find the mass and speed ratio that transfer the most energy without limits.

    Notes
    -----
    The ratios are exact to 1e-5. For all :math:`\zeta` from 0 to 0.99 the best of :math:`\mu`
    from 0.001 to 1000 and :math:`\kappa` from 0.15 to 500 is at :math:`\mu` from 0.23 to 0.44
    and :math:`\kappa` from 8.2 to 12.3; it is looked for nearby.

    Examples
    --------
    >>> best = best_ratios(0.064)
    >>> round(best.mass_ratio, 5), round(best.speed_ratio, 5), round(best.energy_transfer, 6)
    (0.2554, 8.57592, 4.142897)

    """
    damping_ratio = checks.require_in_unit_interval('damping_ratio', damping_ratio)
    # a rig whose layer has these very ratios for thickness and wave speed
    rig = Rig(
        engine=Engine(frequency=1.0, amplitude=1.0, damping_ratio=damping_ratio),
        layer=Layer(thickness=1.0, wave_speed=1.0, density=1.0, diameter=2.0 / math.sqrt(math.pi)),
        projectile=Projectile(mass=1.0),
        gravity=0.0,
    )
    layers = Box(thickness=(1.5, 6.0), wave_speed=(15.0, 75.0))
    best = maximise(Score(rig, peak), layers, step=0.06, tolerance=1e-7)
    assert best is not None  # without gravity every layer throws
    mass_ratio, speed_ratio = 1.0 / best.thickness, best.wave_speed / best.thickness
    phase = first_releases(
        mass_ratio=mass_ratio, speed_ratio=speed_ratio, damping_ratio=damping_ratio
    ).ejection_phase
    return BestRatios(damping_ratio, mass_ratio, speed_ratio, float(phase), best.score)
