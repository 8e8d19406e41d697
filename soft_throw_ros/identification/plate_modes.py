# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""A plate that does more than a damped step: it still rings from before, or has a second mode."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from soft_throw_ros.core.plate import SampledMotion, Underdamped

Floats = NDArray[np.float64]

_LEAD_IN = 2.0  # periods before a record in which what rings begins to
_NODES_PER_PERIOD = 40.0  # of the motion that steppers take
_JUMP = 3e-5  # before and after the start, between which velocity and acceleration change [s]
_LOWEST = 1.5  # frequency of a second mode, over that of the first
_PER_CYCLE = 2.5  # samples at least, of a second mode
_DAMPING_RATIOS = (0.005, 0.02, 0.06)
_MOST_MODES = 8  # that are tried


class Mode(NamedTuple):
    """A second mode of a plate: frequency [Hz] and damping ratio."""

    frequency: float
    damping_ratio: float


class PlateWithModes(NamedTuple):
    """
    The motion of a plate: a step, waves that were there before, and a second mode.

    Parameters
    ----------
    step : Underdamped
    waves : tuple of float
        Over the amplitude: cosine and sine of the ringing, 1 - cosine and sine of the mode.
    mode : Mode or None

    """

    step: Underdamped
    waves: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    mode: Mode | None = None

    def position(self, since: Floats) -> Floats:
        """Height at times since the start [m]."""
        return self.step.position(since) + self._of_waves(since, 0)

    def velocity(self, since: Floats) -> Floats:
        """Velocity at times since the start [m/s]."""
        return self.step.velocity(since) + self._of_waves(since, 1)

    def sampled(self, first: float, last: float) -> SampledMotion | None:
        """Sample it from a lead-in before `first` to `last` [s]; None if it is a mere step."""
        if not any(self.waves):
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
        # What rings begins smoothly, by a polynomial that rises to 1 in the lead-in
        part = np.clip((times - begin) / lead, 0.0, 1.0)
        rise = part**3 * (10.0 + part * (6.0 * part - 15.0))
        slope = 30.0 * (part * (1.0 - part)) ** 2 / lead
        bend = 60.0 * part * (1.0 - part) * (1.0 - 2.0 * part) / lead**2
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
        """Differentiate what is not the step, so many times."""
        found = np.zeros_like(since)
        if any(self.waves[:2]):
            size = complex(self.waves[0], -self.waves[1])
            rate = self.step.exponent
            found += np.real(size * rate**order * np.exp(rate * since))
        if self.mode is not None and any(self.waves[2:]):
            shapes = _mode_shapes(self.mode, since, order)
            found += self.waves[2] * shapes[0] + self.waves[3] * shapes[1]
        return self.step.amplitude * found


def _mode_shapes(mode: Mode, since: Floats, order: int = 0) -> tuple[Floats, Floats]:
    """Differentiate 1 - cosine and sine of a mode that is excited at time 0, so many times."""
    rate = complex(-mode.damping_ratio, math.sqrt(1.0 - mode.damping_ratio**2))
    rate *= 2.0 * math.pi * mode.frequency
    wave = rate**order * np.exp(rate * np.maximum(since, 0.0))
    began = since >= 0.0
    return began * ((order == 0) - wave.real), began * wave.imag


def find_modes(
    since: Sequence[Floats], residuals: Sequence[Floats], frequency: float
) -> tuple[Mode, ...]:
    """
    Find second modes that may explain what a step leaves of plates, the likeliest first.

    Parameters
    ----------
    since : sequence of ndarray
        Times since the start, for each throw. [s]
    residuals : sequence of ndarray
        Data less model, each over its noise.
    frequency : float
        Of the first mode. [Hz]

    """
    if not since:
        return ()
    interval = max(float(np.median(np.diff(time))) for time in since)
    duration = max(float(time[-1]) for time in since)
    highest = 1.0 / (_PER_CYCLE * interval)
    if highest <= _LOWEST * frequency or duration <= 0.0:
        return ()

    def left(values: Floats) -> float:
        mode = _mode(values)
        total = 0.0
        for time, residual in zip(since, residuals, strict=True):
            columns = np.stack([*_mode_shapes(mode, time), np.ones_like(time)], axis=1)
            found, *_ = np.linalg.lstsq(columns, residual, rcond=None)
            total += float(np.sum((residual - columns @ found) ** 2))
        return total

    def refined(frequency: float, damping_ratio: float) -> optimize.OptimizeResult:
        corners = [
            (frequency, damping_ratio),
            (frequency + 0.2 / duration, damping_ratio),
            (frequency, 1.5 * damping_ratio),
        ]
        return optimize.minimize(
            left, corners[0], method='Nelder-Mead',
            options={'initial_simplex': np.array(corners), 'maxfev': 80, 'xatol': 1e-3},
        )

    frequencies = np.arange(_LOWEST * frequency, highest, 0.4 / duration)
    table = np.array([
        [left(np.array([f, damping])) for damping in _DAMPING_RATIOS]
        for f in frequencies.tolist()
    ])
    least = np.pad(table.min(axis=1), 1, constant_values=np.inf)
    minima = np.flatnonzero((least[1:-1] <= least[:-2]) & (least[1:-1] <= least[2:]))
    minima = minima[np.argsort(least[1:-1][minima])][:_MOST_MODES]
    found = [refined(frequencies[n], _DAMPING_RATIOS[table[n].argmin()]) for n in minima.tolist()]
    return tuple(_mode(each.x) for each in sorted(found, key=lambda each: float(each.fun)))


def _mode(values: Floats) -> Mode:
    """Make a mode of frequency and damping, which is kept within what can be."""
    return Mode(float(values[0]), min(max(float(values[1]), 1e-4), 0.5))
