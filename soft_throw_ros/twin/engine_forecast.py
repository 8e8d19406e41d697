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
"""What a throw gives if the engine goes on as it should, and how well that is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine
from soft_throw_ros.core.stepper import Event, Stepper
from soft_throw_ros.twin.engine_fit import AMPLITUDE, DAMPING, EngineEstimate, FREQUENCY, START

Floats = NDArray[np.float64]
Throw = Callable[[Engine], tuple[float, float] | None]

TWO_SIDED = 1.96  # standard errors to either side in a 95 % interval
_STEPS = {AMPLITUDE: 0.01, FREQUENCY: 2e-3, DAMPING: 5e-3}  # of differences, see `engine_fit`
_PIECES = 64  # states of the plate, joined by quintics, in a plate period
_LONGER = 1.3  # how long a throw is followed, in ejection times of the engine as it should be


class ReleaseErrors(NamedTuple):
    """Standard errors of a release: of its time [s], and relative ones of speed and alpha [-]."""

    time: float
    speed: float
    energy_transfer: float


@dataclass(frozen=True)
class EngineForecaster:
    """
    Predicts the release by what is known of the engine's motion.

    Attributes
    ----------
    ejection_time : float
        Of the engine as it should be. [s]
    gradient : ndarray, shape (3, 5)
        Of the time of the release [s], and the logarithms of speed and energy transfer, by the
        unknowns of `engine_fit`.
    stepper : Stepper
        By which throws are followed ahead of time.

    """

    ejection_time: float
    gradient: Floats
    stepper: Stepper

    @classmethod
    def of(cls, engine: Engine, throw: Throw, stepper: Stepper) -> EngineForecaster | None:
        """Make it by `throw`, which gives time and speed of a release; None if there is none."""
        gradient = np.zeros((3, 5))
        gradient[0, START] = 1.0
        for unknown, step in _STEPS.items():
            down = min(step, engine.damping_ratio) if unknown == DAMPING else step
            ends = [_changed(engine, unknown, step), _changed(engine, unknown, -down)]
            found = [throw(end) for end in ends]
            if found[0] is None or found[1] is None:
                return None
            (later, faster), (earlier, slower) = found[0], found[1]
            peaks = [Underdamped.of(end).peak_velocity for end in ends]
            speed = math.log(faster / slower)
            change = (later - earlier, speed, 2.0 * (speed - math.log(peaks[0] / peaks[1])))
            gradient[:, unknown] = np.array(change) / (step + down)
        release = throw(engine)
        return None if release is None else cls(release[0], gradient, stepper)

    def errors(self, estimate: EngineEstimate) -> ReleaseErrors:
        """Return how well the release is known."""
        variances = (self.gradient @ estimate.covariance * self.gradient).sum(axis=1)
        return ReleaseErrors(*np.sqrt(variances).tolist())

    def release(self, estimate: EngineEstimate) -> Event | None:
        """Go ahead to the first release; None if there is none where it should be."""
        length = _LONGER * self.ejection_time
        times = np.linspace(0.0, length, math.ceil(_PIECES * length * estimate.plate.frequency))
        self.stepper.reset()
        self.stepper.append_plate_states(times, estimate.states(times))
        count = self.stepper.advance_to(min(length, self.stepper.horizon))
        return self.stepper.events()[0] if count else None

    def states(self, estimate: EngineEstimate, until: float) -> tuple[Floats, Floats]:
        """Return times and states of the plate from its start to a time."""
        times = np.linspace(0.0, until, 2 + math.ceil(_PIECES * until * estimate.plate.frequency))
        return times, estimate.states(times)


def _changed(engine: Engine, unknown: int, step: float) -> Engine:
    """Change what an unknown is of by so much."""
    if unknown == AMPLITUDE:
        return replace(engine, amplitude=engine.amplitude * (1.0 + step))
    if unknown == FREQUENCY:
        return replace(engine, frequency=engine.frequency * (1.0 + step))
    return replace(engine, damping_ratio=engine.damping_ratio + step)
