# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The configuration of the twin: complete settings, the rig that they describe, derived values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import cast, TypeVar

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import motions
from soft_throw_ros.configuration.table import Settings
from soft_throw_ros.configuration.twin import rig_of, RIG_PARAMETERS
from soft_throw_ros.core.plate import motion_of as motion_of_engine
from soft_throw_ros.core.plate import PlateMotion, Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.storage.message import SECOND

T = TypeVar('T')

_START_SPEED = 0.1  # speed at which a throw has started, over the peak speed by `engine.*` [-]

BOUND_PER_DEVIATION = math.sqrt(3.0)
"""Bound over standard deviation [-], of a quantity that is equally likely within its bounds."""


@dataclass(frozen=True, kw_only=True)
class MeasurementConfig:
    """Parameters of the estimation of a measured plate, and of the test of the model."""

    smoothing_window_ns: int  # length of the smoothing window [ns]
    latency_ns: int  # time to wait for samples out of order [ns]
    position_noise: float  # standard deviation of the heights of the plate [m]
    stamp_error: float  # standard deviation of the stamps [s]
    residual_threshold: float  # rms of the projectile beyond which the model is wrong [m]
    plate: Underdamped  # motion of the engine
    motion: PlateMotion  # expected in a throw: that of the engine, or a commanded one
    frequency_error: float  # standard deviation of its frequency [Hz]
    damping_error: float  # standard deviation of its damping ratio [-]

    @property
    def smoothing_window(self) -> float:
        """Length of the smoothing window [s]."""
        return self.smoothing_window_ns / SECOND

    @cached_property
    def start_speed(self) -> float:
        """Upward speed at which a throw has begun [m/s]."""
        return _START_SPEED * self.plate.peak_velocity

    @cached_property
    def start_table(self) -> NDArray[np.float64]:
        """Times [s], heights [m] and velocities [m/s] of the expected motion, in rows."""
        end = self.motion.peak_velocity_time + self.smoothing_window
        times = np.linspace(0.0, end, 1024)
        height, velocity, _ = self.motion.states_at(times).T
        return np.stack((times, height, velocity))

    @cached_property
    def rise_time(self) -> float:
        """Time from the start of the expected motion until it has the speed of a start [s]."""
        times, _, velocity = self.start_table
        return float(times[(np.abs(velocity) >= self.start_speed).argmax()])

    @cached_property
    def direction(self) -> float:
        """Sign of the velocity at this time; a commanded motion may go down first."""
        return float(np.sign(self.motion.velocity(self.rise_time)))


def _value(name: str, _type: type[T]) -> T:
    """Return a property with the value of a parameter, for type checkers the value itself."""
    return cast('T', property(lambda config: config.settings[name]))


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """The configuration of the twin; `design` reads that of its requests from the settings."""

    settings: Settings  # complete
    rig: Rig

    motion = _value('engine.motion', str)
    state_rate = _value('rate.state', float)
    field_rate = _value('rate.field', float)
    throw_period = _value('throw.period', float)
    max_events = _value('throw.max_events', int)

    @property
    def is_measured(self) -> bool:
        """Whether the plate is measured."""
        return self.motion == 'measured'

    @property
    def motion_file(self) -> str:
        """Path of the file with the motion of the plate; empty for other motions."""
        return str(self.settings[motions.PARAMETER]) if self.rig.engine.motion else ''

    @property
    def time_scale(self) -> float:
        """Time of the rig over that of the clock, 1 with a measured plate [-]."""
        return 1.0 if self.is_measured else float(self.settings['time_scale'])

    @property
    def command_lead(self) -> float | None:
        """Time from the command of a motion to its start; None without commands [s]."""
        lead = self.settings['engine.command_lead']
        if not self.settings['engine.command']:
            return None
        return float(min(lead, 0.25 * self.throw_period) if self.throw_period else lead)

    @cached_property
    def measurement(self) -> MeasurementConfig:
        """Configuration of a measured plate."""
        return MeasurementConfig(
            smoothing_window_ns=round(self.settings['measured.smoothing_window'] * SECOND),
            latency_ns=round(self.settings['measured.latency'] * SECOND),
            position_noise=self.settings['measured.position_noise'],
            stamp_error=self.settings['measured.stamp_error'],
            residual_threshold=self.settings['measured.residual_threshold'],
            plate=Underdamped.of(self.rig.engine),
            motion=motion_of_engine(self.rig.engine),
            frequency_error=self.settings['uncertainty.frequency'] / BOUND_PER_DEVIATION,
            damping_error=self.settings['uncertainty.damping_ratio'] / BOUND_PER_DEVIATION,
        )

    def change(
        self, settings: Settings, motion_of: motions.MotionSource = motions.read
    ) -> TwinConfig:
        """Return the configuration of other settings; a rig whose parameters stay is kept."""
        is_same = all(settings[name] == self.settings[name] for name in RIG_PARAMETERS)
        return TwinConfig(
            settings=settings, rig=self.rig if is_same else rig_of(settings, motion_of)
        )
