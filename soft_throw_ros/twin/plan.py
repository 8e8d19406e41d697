# SPDX-License-Identifier: Apache-2.0
"""All that can be made ready before throws with given settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.peak import first_peaks
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.travelling_wave import ThrowUnresolvedError
from soft_throw_ros.twin.results import Field, Release, State, ThrowField

FIELD_POINTS = 64
"""Heights at which the layer is published."""

THROW_FIELD_ROWS = 200
"""Times at which the field of a throw holds the layer."""

_SWINGS = 4

RETURN_TIME = 0.1
"""How long putting back takes, unless the period of the throws is too short for it. [s]"""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """
    A rig that is ready to throw, and how its time is divided.

    Parameters
    ----------
    rig : Rig
        The rig.
    stepper : Stepper
        Its model, at rest.
    rate, field_rate : float
        Steps, and rows of the field, per second of the clock. [Hz]
    time_scale : float
        Time of the rig over time of the clock. [-]
    rest : State
        Where plate and projectile are at rest.
    rest_field : Field
        The layer at rest.
    peak_plate_speed : float
        :math:`V_p^*`. [m/s]
    peak_strain : float
        Largest magnitude of the strain anywhere in the layer up to the first release; 0 if there
        is none. [-]
    throw_field : ThrowField
        What the layer will do in a throw.
    models : mapping of str to Release or None
        The first release by models other than the stepper's.

    """

    rig: Rig
    stepper: Stepper
    rate: float
    field_rate: float
    time_scale: float
    rest: State
    rest_field: Field
    peak_plate_speed: float
    peak_strain: float
    throw_field: ThrowField
    models: Mapping[str, Release | None]

    @classmethod
    def of(cls, settings: Settings) -> Plan:
        """
        Make everything ready, which takes milliseconds.

        Raises
        ------
        ValueError
            If the rig cannot be stepped in real time, with the number.

        """
        rig = rig_of(settings)
        stepper = Stepper(rig, field_points=FIELD_POINTS)
        stepper.reset()
        rest_field = Field(np.zeros(FIELD_POINTS), np.zeros(FIELD_POINTS))
        stepper.read_field(rest_field.strain, rest_field.velocity)
        return cls(
            rig=rig,
            stepper=stepper,
            rate=settings['rate.state'],
            field_rate=settings['rate.field'],
            time_scale=settings['time_scale'],
            rest=State._make(stepper.state.tolist()[1:]),
            rest_field=rest_field,
            peak_plate_speed=Underdamped.of(rig.engine).peak_velocity,
            peak_strain=_peak_strain(rig),
            throw_field=_throw_field(stepper, rig),
            models=_other_models(rig),
        )

    @property
    def tick(self) -> float:
        """Time of the rig in one step. [s]"""
        return self.time_scale / self.rate

    def period_ticks(self, period: float) -> int:
        """Return the steps from one throw to the next: at least one to throw, one to return."""
        return max(2, round(period / self.tick))

    def return_ticks(self, period: float) -> int:
        """Return the steps that putting back takes: at most half of the period."""
        ticks = max(1, round(RETURN_TIME / self.tick))
        return min(ticks, self.period_ticks(period) // 2) if period else ticks


def _throw_field(stepper: Stepper, rig: Rig) -> ThrowField:
    """Let the layer go through a throw, to half as long again as the ejection time."""
    times = np.linspace(0.0, 1.5 * _ejection_time(stepper, rig), THROW_FIELD_ROWS)
    strain = np.empty((THROW_FIELD_ROWS, FIELD_POINTS))
    stepper.reset()
    stepper.sample_field(times, strain)
    stepper.reset()
    return ThrowField(times, strain)


def _ejection_time(stepper: Stepper, rig: Rig) -> float:
    """Find when the projectile leaves, or, if it does not soon, how long its first swings take."""
    swing = 1.0 / min(rig.engine.frequency, rig.natural_frequency) + rig.crossing_time
    for eighth in range(1, 8 * _SWINGS + 1):
        if stepper.advance_to(0.125 * eighth * swing):
            return stepper.events()[0].time
    return _SWINGS * swing


def _peak_strain(rig: Rig) -> float:
    """Find what the stepper, which looks at plate and top, does not see within the layer."""
    try:
        peaks = first_peaks(
            mass_ratio=rig.mass_ratio,
            speed_ratio=rig.speed_ratio,
            damping_ratio=rig.engine.damping_ratio,
            gravity_ratio=rig.gravity_ratio,
        )
    except ThrowUnresolvedError:
        return 0.0
    return peaks.strain * rig.engine.speed_scale / rig.layer.wave_speed


def _other_models(rig: Rig) -> dict[str, Release | None]:
    """Let other models predict the first release."""
    frequency = rig.engine.frequency
    ratio = rig.natural_frequency / frequency
    release = spring_mass.first_release(frequency_ratio=ratio)
    return {
        'spring_mass': Release(
            time=float(release.ejection_phase) / frequency,
            speed=float(release.speed) * rig.engine.speed_scale,
            energy_transfer=float(release.energy_transfer),
        )
    }
