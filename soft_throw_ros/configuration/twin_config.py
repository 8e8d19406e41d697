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
"""
The parameters of the twin as one typed value, made once where they come in.

Dotted names stay in the table, in the journal and in ROS; what computes reads these fields.
"""

from __future__ import annotations

from dataclasses import dataclass

from soft_throw_ros.configuration.table import Settings
from soft_throw_ros.configuration.twin import rig_of
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig

_SECOND = 1_000_000_000  # [ns]


@dataclass(frozen=True, kw_only=True)
class MeasurementConfig:
    """
    How a measured plate is estimated, and when the model is off.

    Parameters
    ----------
    smoothing_window_ns, wait_ns : int
        Over which the plate is smoothed, and for samples that come after later ones. [ns]
    position_noise, velocity_noise : float
        Standard deviations. [m], [m/s]
    start_speed : float
        Of the plate, upwards, at which a throw has begun. [m/s]
    residual_threshold : float
        How far the projectile may be off the model, rms. [m]
    plate : Underdamped
        About how the plate moves in a throw.
    frequency_error, damping_error : float
        Standard errors of its frequency [Hz] and damping ratio [-].
    prediction_error : float
        Half of the 95 % interval of the ejection speed at which a throw is predicted, as a part
        of it. [-]

    """

    smoothing_window_ns: int
    wait_ns: int
    position_noise: float
    velocity_noise: float
    start_speed: float
    residual_threshold: float
    plate: Underdamped
    frequency_error: float
    damping_error: float
    prediction_error: float

    @property
    def smoothing_window(self) -> float:
        """Over which the plate is smoothed [s]."""
        return self.smoothing_window_ns / _SECOND


@dataclass(frozen=True, kw_only=True)
class TwinConfig:
    """
    What the twin is to be; what is asked of a recommendation is in `design.requests`.

    Parameters
    ----------
    rig, model, motion
        The rig, the model by which it is followed (see `model_of`), and how the plate moves:
        'underdamped', 'harmonic' or 'measured'.
    measurement : MeasurementConfig
        How the plate is estimated if it is measured.
    state_rate, field_rate : float
        Steps, and rows of the field, per second of the clock. [Hz]
    time_scale : float
        Time of the rig over time of the clock, 1 with a measured plate. [-]
    throw_period : float
        From one throw to the next; 0 throws only on request. [s]
    max_events, max_strain
        Contacts after which a throw is over, and where the linear range ends [-].

    """

    rig: Rig
    model: str
    motion: str
    measurement: MeasurementConfig
    state_rate: float
    field_rate: float
    time_scale: float
    throw_period: float
    max_events: int
    max_strain: float

    @property
    def is_measured(self) -> bool:
        """Whether the plate moves as it is measured."""
        return self.motion == 'measured'

    @classmethod
    def from_settings(cls, settings: Settings) -> TwinConfig:
        """
        Make the configuration that complete settings describe.

        Examples
        --------
        >>> from soft_throw_ros.configuration.twin import TWIN
        >>> TwinConfig.from_settings(TWIN.defaults()).rig == Rig()
        True

        """
        rig, motion = rig_of(settings), settings['engine.motion']
        plate = Underdamped.of(rig.engine)
        return cls(
            rig=rig,
            model=model_of(settings, rig),
            motion=motion,
            measurement=MeasurementConfig(
                smoothing_window_ns=round(settings['measured.window'] * _SECOND),
                wait_ns=round(settings['measured.wait'] * _SECOND),
                position_noise=settings['measured.position_noise'],
                velocity_noise=settings['measured.velocity_noise'],
                # relative to the plate's
                start_speed=settings['measured.start'] * plate.peak_velocity,
                residual_threshold=settings['measured.band'],
                plate=plate,
                frequency_error=settings['uncertainty.frequency'],
                damping_error=settings['uncertainty.damping_ratio'],
                prediction_error=settings['measured.prediction_error'],
            ),
            state_rate=settings['rate.state'],
            field_rate=settings['rate.field'],
            time_scale=1.0 if motion == 'measured' else settings['time_scale'],
            throw_period=settings['throw.period'],
            max_events=settings['throw.max_events'],
            max_strain=rig.layer.linear_range(settings['max_strain']),
        )


def model_of(settings: Settings, rig: Rig) -> str:
    """
    Choose by which model a rig is followed.

    It is the one that is set, unless that is the travelling wave and the layer is a stack, not
    linear, or has internal loss: then it is finite differences.
    """
    is_wave = settings['model'] == 'travelling_wave'
    return 'finite_difference' if is_wave and rig.layer.needs_cells else str(settings['model'])
