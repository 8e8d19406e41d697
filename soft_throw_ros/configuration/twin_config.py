# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The parameters of the twin as one typed value, constructed once from the settings.

The table, the journal and ROS use dotted names; computations read these fields.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from soft_throw_ros.configuration import motions
from soft_throw_ros.configuration.table import Settings
from soft_throw_ros.configuration.twin import rig_of, RIG_PARAMETERS
from soft_throw_ros.core.plate import motion_of as motion_of_engine
from soft_throw_ros.core.plate import PlateMotion, Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.storage.message import SECOND

_START_SPEED = 0.1
"""Speed at which a measured plate has started a throw, over the peak speed by `engine.*`. [-]"""

_RISE_TIMES = 1024
"""Times from the start to the largest speed at which the expected speed is evaluated. [-]"""

BOUND_PER_DEVIATION = math.sqrt(3.0)
"""Bound over standard deviation [-], of a quantity that is equally likely within its bounds."""


@dataclass(frozen=True, kw_only=True)
class MeasurementConfig:
    """Parameters of the estimation of a measured plate, and of the test of the model."""

    smoothing_window_ns: int  # length of the smoothing window [ns]
    latency_ns: int  # time to wait for samples out of order [ns]
    position_noise: float  # standard deviation of the heights of the plate [m]
    stamp_error: float  # standard deviation of the stamps [s]
    start_speed: float  # upward speed at which a throw has begun [m/s]
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
    def rise_time(self) -> float:
        """Time from the start of the expected motion until it has the speed of a start [s]."""
        times = np.linspace(0.0, self.motion.peak_velocity_time, _RISE_TIMES)
        return float(times[(np.abs(self.motion.velocity(times)) >= self.start_speed).argmax()])

    @cached_property
    def direction(self) -> float:
        """Sign of the velocity at this time; a commanded motion may go down first."""
        return float(np.sign(self.motion.velocity(self.rise_time)))


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """The configuration of the twin; requests for recommendations are in `design.requests`."""

    settings: Settings  # complete, the source of all other fields
    rig: Rig
    motion: str  # kind of the plate's motion: a name of `configuration.twin.MOTIONS`
    measurement: MeasurementConfig  # for a measured plate
    state_rate: float  # steps per second of the clock [Hz]
    field_rate: float  # rows of the field per second of the clock [Hz]
    time_scale: float  # time of the rig over that of the clock, 1 with a measured plate [-]
    # time from the command of a motion to its start; None if the plate is not commanded [s]
    command_lead: float | None
    throw_period: float  # from one start to the next; 0 to throw only on request [s]
    max_events: int  # contacts after which a throw is over [-]
    max_strain: float  # where the linear range of the layer ends [-]

    @property
    def is_measured(self) -> bool:
        """Whether the plate is measured."""
        return self.motion == 'measured'

    @property
    def motion_file(self) -> str:
        """Path of the file with the motion of the plate; empty for other motions."""
        return str(self.settings[motions.PARAMETER]) if self.rig.engine.motion else ''

    @classmethod
    def from_settings(
        cls,
        settings: Settings,
        motion_of: motions.MotionSource = motions.read,
        *,
        rig: Rig | None = None,
    ) -> TwinConfig:
        """
        Make the configuration that complete settings describe.

        Arguments and errors are those of `rig_of`, and the rig of the settings if it exists
        already.

        Examples
        --------
        >>> from soft_throw_ros.configuration.twin import TWIN
        >>> TwinConfig.from_settings(TWIN.defaults()).rig == Rig()
        True

        """
        rig = rig_of(settings, motion_of) if rig is None else rig
        motion = settings['engine.motion']
        plate = Underdamped.of(rig.engine)
        period, lead = settings['throw.period'], settings['engine.command_lead']
        if period:
            lead = min(lead, 0.25 * period)
        return cls(
            settings=settings,
            rig=rig,
            motion=motion,
            measurement=MeasurementConfig(
                smoothing_window_ns=round(settings['measured.smoothing_window'] * SECOND),
                latency_ns=round(settings['measured.latency'] * SECOND),
                position_noise=settings['measured.position_noise'],
                stamp_error=settings['measured.stamp_error'],
                start_speed=_START_SPEED * plate.peak_velocity,
                residual_threshold=settings['measured.residual_threshold'],
                plate=plate,
                motion=motion_of_engine(rig.engine),
                frequency_error=settings['uncertainty.frequency'] / BOUND_PER_DEVIATION,
                damping_error=settings['uncertainty.damping_ratio'] / BOUND_PER_DEVIATION,
            ),
            state_rate=settings['rate.state'],
            field_rate=settings['rate.field'],
            time_scale=1.0 if motion == 'measured' else settings['time_scale'],
            command_lead=lead if settings['engine.command'] else None,
            throw_period=period,
            max_events=settings['throw.max_events'],
            max_strain=rig.layer.linear_range,
        )

    def change(
        self, values: Settings, motion_of: motions.MotionSource = motions.read
    ) -> TwinConfig:
        """
        Return the configuration after changes, with all that they imply.

        The rig is built again only if its parameters change.

        """
        settings = {**self.settings, **values}
        is_same_rig = all(settings[name] == self.settings[name] for name in RIG_PARAMETERS)
        return self.from_settings(settings, motion_of, rig=self.rig if is_same_rig else None)
