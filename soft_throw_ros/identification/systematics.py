# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Systematic errors, which tracks hardly show, as floors of the errors of the results of a fit.

A layer that sticks, a stress that is no linear function of the strain, or a second mode of the
plate change a throw by more than the tracks show. The floors are added to the standard errors in
quadrature. `make trials` calibrates them: with them 95 % of the intervals contain the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import NamedTuple

from soft_throw_ros.identification.least_squares import Estimate


class Floor(NamedTuple):
    """The systematic error of a quantity, as one standard error."""

    size: float
    unit: str
    """`%` of the value, or the SI unit of the quantity."""

    def of(self, value: float) -> float:
        """Return the systematic error of a value, in its unit."""
        return 0.01 * self.size * abs(value) if self.unit == '%' else self.size

    def __str__(self) -> str:
        return f'{self.size:g} {self.unit}'.rstrip()


FLOORS: Mapping[str, Floor] = {
    # A second mode of 1 % of the amplitude, or a plate that rings before its throw
    'engine.frequency': Floor(0.05, '%'),
    'engine.damping_ratio': Floor(5e-4, ''),
    'engine.amplitude': Floor(0.2, '%'),
    # The same modes, and a stress law that another wave speed does not explain
    'layer.wave_speed': Floor(2.5, '%'),
    # The same modes, which look like a loss
    'layer.loss_tangent': Floor(0.02, ''),
    # A layer that holds the projectile for up to 0.2 ms after the computed release
    'ejection.time': Floor(2e-4, 's'),
    # The plate's mode at the release, and the force of the layer while it sticks
    'ejection.speed': Floor(0.3, '%'),
    'ejection.energy_transfer': Floor(0.6, '%'),
}
"""Floors by quantity, with their reasons."""


def with_floor(name: str, estimate: Estimate) -> Estimate:
    """Return an estimate whose error includes the systematic error of a quantity."""
    if name not in FLOORS:
        return estimate
    return Estimate(
        estimate.value, math.hypot(estimate.error, FLOORS[name].of(estimate.value))
    )
