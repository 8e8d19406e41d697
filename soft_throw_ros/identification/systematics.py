# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Systematic errors, which tracks hardly show, as floors of the errors of the results of a fit.

A layer that sticks, a stress that is no linear function of the strain, or another motion of the
plate change a throw by more than the tracks show. The floors are added to the standard errors in
quadrature. They grow with the oscillations that the residuals of the plate show, and with those
that its noise may hide. `make trials` calibrates them: with smaller ones, some of its trials are
silently wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.rig import Engine
from soft_throw_ros.identification.least_squares import Estimate, TrackResidual
from soft_throw_ros.identification.tracks import FEWEST, Floats

_HIGHEST = 12.0  # largest frequency of another oscillation, over that of the plate
_CHANCE = 11.0  # power of an oscillation that noise reaches in one of fifty records [noise]
_PARTS = (1.0, 2.0, 4.0)  # lengths of the searched parts of a throw, since its start [periods]
_HIDDEN = 0.4  # amplitude of an oscillation that noise may hide, over the noise
_DOUBLING = 0.006  # amplitude of another oscillation that doubles the floors, over the plate's


class Floor(NamedTuple):
    """The systematic error of a quantity, as one standard error."""

    size: float
    unit: str  # `%` of the value, or the SI unit of the quantity

    def of(self, value: float) -> float:
        """Return the systematic error of a value, in its unit."""
        return 0.01 * self.size * abs(value) if self.unit == '%' else self.size

    def __str__(self) -> str:
        return f'{self.size:g} {self.unit}'.rstrip()


FLOORS: Mapping[str, Floor] = {
    # A plate that rings before its throw
    'engine.frequency': Floor(0.05, '%'),
    'engine.damping_ratio': Floor(1.0, '%'),
    'engine.amplitude': Floor(0.15, '%'),
    # A stress law that another wave speed does not explain, and modes of the plate
    'layer.wave_speed': Floor(2.5, '%'),
    # Modes of the plate, which look like a loss
    'layer.loss_tangent': Floor(0.015, ''),
    # A layer that holds the projectile after the computed release
    'ejection.time': Floor(1e-4, 's'),
    'ejection.speed': Floor(0.1, '%'),
    'ejection.energy_transfer': Floor(0.2, '%'),
}
"""Floors by quantity, with their reasons, in tracks without noise."""


def with_floor(name: str, estimate: Estimate, growth: float) -> Estimate:
    """Return an estimate whose error includes the systematic error of a quantity."""
    if name not in FLOORS:
        return estimate
    floor = growth * FLOORS[name].of(estimate.value)
    return Estimate(estimate.value, math.hypot(estimate.error, floor))


def growth_by(residual: TrackResidual, engine: Engine, start: float) -> float:
    """
    Return the factor by which other oscillations of the plate enlarge all floors.

    They are searched before the start of the throw [s], where the plate may ring, and after it,
    where a second mode decays.
    """
    track = residual.track
    values = np.clip(residual.scaled, -residual.limit, residual.limit) * track.deviations
    noise = math.sqrt(0.5 * float(np.mean(np.diff(values) ** 2)))
    since = (track.time - start) * engine.frequency
    parts = [values[since < 0.0], *(values[(since >= 0.0) & (since < end)] for end in _PARTS)]
    found = max(_oscillation(part, noise, track.interval * engine.frequency) for part in parts)
    return 1.0 + (found + _HIDDEN * noise) / (_DOUBLING * engine.amplitude)


def _oscillation(values: Floats, noise: float, interval: float) -> float:
    """
    Return the amplitude of the largest oscillation among white noise, 0 if it is chance.

    Times are in periods of the plate. The amplitude of a faster oscillation than the plate is
    multiplied by its frequency, since its speed matters.
    """
    size = values.size
    if size < FEWEST:
        return 0.0
    frequency = np.fft.rfftfreq(4 * size, interval)
    power = np.abs(np.fft.rfft(values, 4 * size)) ** 2 / size - _CHANCE * noise**2
    amplitude = 2.0 * np.sqrt(np.maximum(power, 0.0) / size) * np.maximum(frequency, 1.0)
    return float(np.max(amplitude * (frequency < _HIGHEST)))
