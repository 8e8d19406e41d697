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
"""A rig with all that can be made ready before it throws."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from soft_throw_ros.configuration import Settings
from soft_throw_ros.configuration.interface import FIELD_POINTS
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.core.cell_stepper import cells_per_layer
from soft_throw_ros.core.plate import motion_of
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.stepper import EventLimitError, Stepper
from soft_throw_ros.core.throw import make_stepper
from soft_throw_ros.core.wave_stepper import steps_per_crossing
from soft_throw_ros.twin.engine_forecast import EngineForecaster
from soft_throw_ros.twin.results import LayerState, State, ThrowField

THROW_FIELD_ROWS = 200  # times at which the field of a throw holds the layer
THROW_FIELD_LENGTH = 1.5  # how long the field of a throw lasts, in ejection times [-]
LONGEST_WINDOW = 0.2  # of the smoothing, in plate periods: longer ones hide the start [-]
RETURN_TIME = 0.1  # of putting back, unless the period of the throws is too short for it [s]

_LONGEST_CONTACT = 4  # oscillation cycles: what has not left by then counts as never leaving


@dataclass(frozen=True, kw_only=True)
class PreparedRig:
    """A rig that is ready to throw."""

    config: TwinConfig  # what it was made of
    stepper: Stepper  # the rig by its model, at rest
    rest: State  # where plate and projectile are at rest
    rest_layer: LayerState
    peak_plate_speed: float  # by the engine [m/s]
    throw_field: ThrowField | None  # what the layer will do; unknown if the plate is measured
    forks: tuple[Stepper, ...] = ()  # with a measured plate two that go ahead of the stepper
    forecaster: EngineForecaster | None = None  # with a measured plate, if the projectile leaves

    @classmethod
    def from_config(cls, config: TwinConfig) -> PreparedRig:
        """
        Make everything ready, which takes milliseconds.

        Raises
        ------
        ValueError
            If the rig cannot be stepped in real time, with the number.

        """
        stepper = stepper_of(config)
        rest_layer = np.empty((3, FIELD_POINTS))
        stepper.read_layer(rest_layer)
        is_measured = config.is_measured
        return cls(
            config=config,
            stepper=stepper,
            rest=State._make(stepper.state.tolist()[1:]),
            rest_layer=LayerState(*rest_layer),
            peak_plate_speed=motion_of(config.rig.engine).peak_velocity,
            throw_field=None if is_measured else _throw_field(stepper),
            forks=(stepper.fork(), stepper.fork()) if is_measured else (),
            forecaster=_forecaster(config) if is_measured else None,
        )

    @property
    def rig(self) -> Rig:
        """Return the rig."""
        return self.config.rig

    @cached_property
    def tick(self) -> float:
        """Time of the rig in one step [s]."""
        return self.config.time_scale / self.config.state_rate

    @property
    def lookahead(self) -> float:
        """How much longer than the plate the projectile is known: as long as a wave needs [s]."""
        return 0.0 if self.config.model == 'spring_mass' else self.rig.crossing_time

    @property
    def release_lookahead(self) -> float:
        """Return the same of its release, at the plate if the layer is thrown along [s]."""
        return 0.0 if self.config.model == 'finite_difference_glued' else self.lookahead

    def period_ticks(self, period: float) -> int:
        """Return the steps from one throw to the next: at least one to throw, one to return."""
        return max(2, round(period / self.tick))

    def return_ticks(self, period: float) -> int:
        """Return the steps that putting back takes: at most half of the period."""
        ticks = max(1, round(RETURN_TIME / self.tick))
        return min(ticks, self.period_ticks(period) // 2) if period else ticks


def stepper_of(config: TwinConfig) -> Stepper:
    """
    Make what follows the rig in real time, by the motion of its engine or a measured one.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, with the number.

    """
    return make_stepper(
        config.rig,
        'measured' if config.is_measured else None,
        model=config.model,
        field_points=FIELD_POINTS,
    )


def _forecaster(config: TwinConfig) -> EngineForecaster | None:
    """Make what predicts throws by the engine's motion; None if the projectile does not leave."""

    def throw(engine: Engine) -> tuple[float, float] | None:
        rig = dataclasses.replace(config.rig, engine=engine)
        try:
            stepper = stepper_of(dataclasses.replace(config, rig=rig, motion='underdamped'))
        except ValueError:  # the rig is at the limit of what can be stepped
            return None
        _ejection_time(stepper)
        events = stepper.events()
        return (events[0].time, events[0].velocity) if events else None

    return EngineForecaster.of(config.rig.engine, throw, stepper_of(config))


def check_settings(settings: Settings) -> None:
    """
    Tell whether settings can be stepped in real time, which takes microseconds.

    Raises
    ------
    ValueError
        If not, with the number and what would do.

    """
    config = TwinConfig.from_settings(settings)
    if config.model == 'travelling_wave':
        steps_per_crossing(config.rig)
    else:
        cells_per_layer(config.rig, config.model)
    window, frequency = config.measurement.smoothing_window, config.rig.engine.frequency
    if config.is_measured and window * frequency > LONGEST_WINDOW:
        raise ValueError(
            f'measured.window must be at most {LONGEST_WINDOW:g} of the plate period, '
            f'{LONGEST_WINDOW / frequency:.4g} s at engine.frequency {frequency:g} Hz, '
            f'got {window:g} s'
        )


def _throw_field(stepper: Stepper) -> ThrowField:
    """Let the layer go through a throw, to half as long again as the ejection time."""
    times = np.linspace(0.0, THROW_FIELD_LENGTH * _ejection_time(stepper), THROW_FIELD_ROWS)
    strain = np.empty((THROW_FIELD_ROWS, FIELD_POINTS))
    stepper.reset()
    stepper.sample_strain(times, strain)
    stepper.reset()
    return ThrowField.of(times, strain)


def _ejection_time(stepper: Stepper) -> float:
    """Find when the projectile leaves, or, if it does not soon, how long it was waited for."""
    rig = stepper.rig
    cycle = 1.0 / min(rig.engine.frequency, rig.natural_frequency) + rig.crossing_time
    if rig.engine.motion:
        cycle += rig.engine.motion.end_time
    for eighth in range(1, 8 * _LONGEST_CONTACT + 1):
        try:
            has_left = stepper.advance_to(0.125 * eighth * cycle) > 0
        except EventLimitError:  # it has, and bounced on a stiff layer countless times
            has_left = True
        if has_left:
            return stepper.events()[0].time
    return _LONGEST_CONTACT * cycle
