# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Forecast of a release by the fitted motion of the engine, with its errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine
from soft_throw_ros.core.stepper import Event, Stepper, TIME
from soft_throw_ros.twin.engine_fit import (
    AMPLITUDE,
    DAMPING,
    engine_states,
    EngineEstimate,
    FREQUENCY,
    START,
)

Floats = NDArray[np.float64]
Throw = Callable[[Engine], tuple[float, float] | None]

TWO_SIDED = 1.96
"""Half of a 95 % interval in standard errors. [-]"""

_STEPS = {
    AMPLITUDE: ('amplitude', 0.01),
    FREQUENCY: ('frequency', 2e-3),
    DAMPING: ('damping_ratio', 5e-3),
}
"""Fields of an engine, and steps of difference quotients by the unknowns of `engine_fit`. [-]"""

_LONGER = 1.3
"""Duration of a forecast over the ejection time with the nominal engine. [-]"""


class ReleaseErrors(NamedTuple):
    """Standard errors of a release: of its time [s], and relative ones of speed and alpha [-]."""

    time: float
    speed: float
    energy_transfer: float


class EngineForecaster:
    """
    A forecast of the release by the fitted motion of the engine.

    The parameters are the ejection time with the nominal engine [s], a stepper that simulates
    throws ahead of time, and the derivatives, shape (3, 5), of the time of the release [s] and of
    the logarithms of speed and energy transfer by the unknowns of `engine_fit`.
    """

    def __init__(self, ejection_time: float, gradient: Floats, stepper: Stepper) -> None:
        self.stepper = stepper
        self._ejection_time = ejection_time
        self._gradient = gradient
        self._simulated: EngineEstimate | None = None  # of the throw that is simulated ahead

    def reset(self) -> None:
        """Abandon the throw that is simulated ahead, if any."""
        self._simulated = None

    @classmethod
    def of(cls, engine: Engine, throw: Throw, stepper: Stepper) -> EngineForecaster | None:
        """Return a forecaster by `throw`, which computes time and speed of a release, if any."""
        gradient = np.zeros((3, 5))
        gradient[0, START] = 1.0
        for unknown, (field, step) in _STEPS.items():
            value = getattr(engine, field)
            unit = 1.0 if unknown == DAMPING else value
            down = min(step, value / unit)  # the damping ratio may be 0
            ends = [replace(engine, **{field: value + k * unit}) for k in (step, -down)]
            releases = [throw(end) for end in ends]
            if releases[0] is None or releases[1] is None:
                return None
            (later, faster), (earlier, slower) = releases[0], releases[1]
            peaks = [Underdamped.of(end).peak_velocity for end in ends]
            speed = math.log(faster / slower)
            change = (later - earlier, speed, 2.0 * (speed - math.log(peaks[0] / peaks[1])))
            gradient[:, unknown] = np.array(change) / (step + down)
        release = throw(engine)
        return None if release is None else cls(release[0], gradient, stepper)

    def errors(self, estimate: EngineEstimate) -> ReleaseErrors:
        """Return the standard errors of a release."""
        variances = (self._gradient @ estimate.covariance * self._gradient).sum(axis=1)
        return ReleaseErrors(*np.sqrt(variances).tolist())

    def change(self, earlier: EngineEstimate, later: EngineEstimate) -> ReleaseErrors:
        """Return the changes of a release from one estimate to another, to first order."""
        return ReleaseErrors(*(self._gradient @ (later.unknowns - earlier.unknowns)).tolist())

    def find_release(
        self, latest: EngineEstimate, *, max_error: float, duration: float
    ) -> tuple[EngineEstimate, Event] | None:
        """
        Simulate a throw ahead for a time; return its estimate and its release, once it has come.

        The simulation begins with the latest estimate if half of the 95 % interval of the
        ejection speed is at most `max_error` [-].
        """
        stepper = self.stepper
        if self._simulated is None:
            if TWO_SIDED * self.errors(latest).speed > max_error:
                return None
            self._simulated = latest
            stepper.reset()
            length = _LONGER * self._ejection_time
            stepper.append_plate_states(*engine_states(latest.plate, 0.0, length))
        goal = min(float(stepper.state[TIME]) + duration, stepper.horizon)
        if not stepper.advance_to(goal) and goal < stepper.horizon:
            return None
        estimate, self._simulated = self._simulated, None
        # without a release, the next estimate may have one
        return (estimate, stepper.events()[0]) if stepper.event_count else None
