# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A plate that rings from before its step."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import SampledMotion, Underdamped

Floats = NDArray[np.float64]

_LEAD_IN = 2.0
"""Time before a record during which the ringing grows. [periods of the plate]"""

_NODES_PER_PERIOD = 40.0
"""States per period of the plate, between which steppers interpolate. [-]"""

_JUMP = 3e-5
"""Time before and after the start, between which velocity and acceleration change. [s]"""


class PlateWithWaves(NamedTuple):
    """The motion of a plate: a step, and ringing beside it."""

    step: Underdamped
    """The motion without ringing."""
    ringing: tuple[float, float] = (0.0, 0.0)
    """Cosine and sine amplitude of the earlier ringing at the start, over the amplitude. [-]"""

    def position(self, since: Floats) -> Floats:
        """Height at times since the start [m]."""
        return self.step.position(since) + self._of_ringing(since, 0)

    def velocity(self, since: Floats) -> Floats:
        """Velocity at times since the start [m/s]."""
        return self.step.velocity(since) + self._of_ringing(since, 1)

    def sampled(self, first: float, last: float) -> SampledMotion | None:
        """Sample the motion from a lead-in before `first` to `last` [s]; None without ringing."""
        if not any(self.ringing):
            return None
        spacing = 1.0 / (_NODES_PER_PERIOD * self.step.frequency)
        lead = _LEAD_IN / self.step.frequency
        before = math.ceil((lead - min(first, 0.0)) / spacing)
        after = math.ceil(max(last, 0.0) / spacing) + 1
        steps = np.delete(np.arange(-before, after + 1), before).astype(np.float64)
        times = np.sort(np.append(spacing * steps, [-_JUMP, _JUMP]))
        begin = float(times[0])
        orders = [self._of_ringing(times, order) for order in range(3)]
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

    def _of_ringing(self, since: Floats, order: int) -> Floats:
        """Return a time derivative of the ringing [m], [m/s], ..."""
        rate = self.step.exponent
        size = self.step.amplitude * complex(self.ringing[0], -self.ringing[1])
        return np.asarray(np.real(size * rate**order * np.exp(rate * since)))
