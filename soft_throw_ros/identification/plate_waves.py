# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A plate that does more than a damped step: it rings from before, or has a second mode."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import SampledMotion, Underdamped

Floats = NDArray[np.float64]

_LEAD_IN = 2.0
"""Time before a record during which the waves grow. [periods of the plate]"""

_NODES_PER_PERIOD = 40.0
"""States per period of the fastest wave, between which steppers interpolate. [-]"""

_JUMP = 3e-5
"""Time before and after the start, between which velocity and acceleration change. [s]"""


class Mode(NamedTuple):
    """A second mode of a plate, which the throw excites."""

    frequency: float
    """[Hz]"""
    damping_ratio: float
    """[-]"""
    rise: float = 0.0
    """Size of 1 - cosine, over the amplitude of the step. [-]"""
    sine: float = 0.0
    """Size of the sine, over the amplitude of the step. [-]"""


class PlateWithWaves(NamedTuple):
    """The motion of a plate: a step, and waves beside it."""

    step: Underdamped
    """The motion without waves."""
    ringing: tuple[float, float] = (0.0, 0.0)
    """Cosine and sine amplitude of the earlier ringing at the start, over the amplitude. [-]"""
    ringing_damping: float | None = None
    """Damping ratio of the ringing; None for that of the step. [-]"""
    mode: Mode | None = None
    """The second mode, if there is one."""

    def position(self, since: Floats) -> Floats:
        """Height at times since the start [m]."""
        return self.step.position(since) + self._of_waves(since, 0)

    def velocity(self, since: Floats) -> Floats:
        """Velocity at times since the start [m/s]."""
        return self.step.velocity(since) + self._of_waves(since, 1)

    def sampled(self, first: float, last: float) -> SampledMotion | None:
        """Sample the motion from a lead-in before `first` to `last` [s]; None without waves."""
        if not any(self.ringing) and self.mode is None:
            return None
        fastest = self.mode.frequency if self.mode else self.step.frequency
        spacing = 1.0 / (_NODES_PER_PERIOD * fastest)
        lead = _LEAD_IN / self.step.frequency
        before = math.ceil((lead - min(first, 0.0)) / spacing)
        after = math.ceil(max(last, 0.0) / spacing) + 1
        steps = np.delete(np.arange(-before, after + 1), before).astype(np.float64)
        times = np.sort(np.append(spacing * steps, [-_JUMP, _JUMP]))
        begin = float(times[0])
        orders = [self._of_waves(times, order) for order in range(3)]
        # The ringing begins smoothly: a polynomial rises to 1 during the lead-in
        progress = np.clip((times - begin) / lead, 0.0, 1.0)
        rise = progress**3 * (10.0 + progress * (6.0 * progress - 15.0))
        slope = 30.0 * (progress * (1.0 - progress)) ** 2 / lead
        bend = 60.0 * progress * (1.0 - progress) * (1.0 - 2.0 * progress) / lead**2
        z, v, a = orders
        states = [z * rise, v * rise + z * slope, a * rise + 2.0 * v * slope + z * bend]
        states[0] += self.step.position(times)
        states[1] += self.step.velocity(times)
        rate = self.step.exponent
        later = np.maximum(times, 0.0)
        states[2] += (times >= 0.0) * np.imag(
            self.step.velocity_factor * rate * np.exp(rate * later)
        )
        return SampledMotion(times, np.stack(states, axis=1))

    def _of_waves(self, since: Floats, order: int) -> Floats:
        """Return a time derivative of the waves [m], [m/s], ..."""
        waves = np.zeros_like(since)
        if any(self.ringing):
            rate = self.step.exponent
            if self.ringing_damping is not None:
                rate = _exponent(self.step.frequency, self.ringing_damping)
            size = complex(self.ringing[0], -self.ringing[1])
            waves += np.real(size * rate**order * np.exp(rate * since))
        if self.mode is not None:
            rate = _exponent(self.mode.frequency, self.mode.damping_ratio)
            wave = rate**order * np.exp(rate * np.maximum(since, 0.0))
            rise = self.mode.rise * ((order == 0) - wave.real)
            waves += (since >= 0.0) * (rise + self.mode.sine * wave.imag)
        return self.step.amplitude * waves


def _exponent(frequency: float, damping_ratio: float) -> complex:
    """Return the complex rate of a damped oscillation [1/s]."""
    rate = complex(-damping_ratio, math.sqrt(1.0 - damping_ratio**2))
    return 2.0 * math.pi * frequency * rate
