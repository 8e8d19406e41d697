# SPDX-License-Identifier: Apache-2.0
"""All that can be made ready before throws with given settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.core import grid_stepper, smoothing, spring_mass, stepper
from soft_throw_ros.core.finite_difference import first_releases
from soft_throw_ros.core.grid_stepper import cells_per_layer, GridStepper
from soft_throw_ros.core.peak import first_peaks
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Stepper, steps_per_crossing
from soft_throw_ros.core.stepping import ThrowStepper
from soft_throw_ros.core.travelling_wave import (
    first_release,
    FirstRelease,
    ThrowUnresolvedError,
)
from soft_throw_ros.twin.measurement import Tuning
from soft_throw_ros.twin.results import Field, Release, State, ThrowField

FIELD_POINTS = 64
"""Heights at which the layer is published."""

THROW_FIELD_ROWS = 200
"""Times at which the field of a throw holds the layer."""

_SWINGS = 4

_CELLS = 64  # by which finite differences predict for comparison, ...
_STIFFEST = 1000.0  # up to so many crossings in a plate period, which take long to follow

LONGEST_WINDOW = 0.2
"""Of the smoothing of a measured plate, in periods of it. [-]"""

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
    model : str
        By which it is followed.
    stepper : ThrowStepper
        This model, at rest.
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
    tuning : Tuning or None
        How the plate is measured, None if it is not. Then what depends on how it will move is
        not known beforehand: there is no `throw_field`, and there are no other models.
    scouts : tuple of ThrowStepper
        With a measured plate two that can go ahead of the stepper.

    """

    rig: Rig
    model: str
    stepper: ThrowStepper
    rate: float
    field_rate: float
    time_scale: float
    rest: State
    rest_field: Field
    peak_plate_speed: float
    peak_strain: float
    throw_field: ThrowField | None
    models: Mapping[str, Release | None]
    tuning: Tuning | None = None
    scouts: tuple[ThrowStepper, ...] = ()

    @classmethod
    def of(cls, settings: Settings) -> Plan:
        """
        Make everything ready, which takes milliseconds.

        Raises
        ------
        ValueError
            If the rig cannot be stepped in real time, with the number.

        """
        rig, model = rig_of(settings), model_of(settings)
        plate = Underdamped.of(rig.engine)
        is_measured = settings['engine.motion'] == 'measured'
        stepper = make_stepper(rig, model, 'measured' if is_measured else None)
        rest_field = Field(np.zeros(FIELD_POINTS), np.zeros(FIELD_POINTS))
        stepper.read_field(rest_field.strain, rest_field.velocity)
        return cls(
            rig=rig,
            model=model,
            stepper=stepper,
            rate=settings['rate.state'],
            field_rate=settings['rate.field'],
            time_scale=1.0 if is_measured else settings['time_scale'],
            rest=State._make(stepper.state.tolist()[1:]),
            rest_field=rest_field,
            peak_plate_speed=plate.peak_velocity,
            peak_strain=0.0 if is_measured else _peak_strain(stepper),
            throw_field=None if is_measured else _throw_field(stepper),
            models={} if is_measured else _other_models(rig, model),
            tuning=Tuning.of(settings, plate) if is_measured else None,
            scouts=(stepper.scout(), stepper.scout()) if is_measured else (),
        )

    @property
    def tick(self) -> float:
        """Time of the rig in one step. [s]"""
        return self.time_scale / self.rate

    @property
    def foresight(self) -> float:
        """How much longer than the plate the projectile is known: as long as a wave needs. [s]"""
        return 0.0 if self.model == 'spring_mass' else self.rig.crossing_time

    @property
    def release_foresight(self) -> float:
        """The same of its release, which is at the plate if the layer is thrown along. [s]"""
        return 0.0 if self.model == 'finite_difference_glued' else self.foresight

    def period_ticks(self, period: float) -> int:
        """Return the steps from one throw to the next: at least one to throw, one to return."""
        return max(2, round(period / self.tick))

    def return_ticks(self, period: float) -> int:
        """Return the steps that putting back takes: at most half of the period."""
        ticks = max(1, round(RETURN_TIME / self.tick))
        return min(ticks, self.period_ticks(period) // 2) if period else ticks


def model_of(settings: Settings) -> str:
    """
    Choose by which model a rig is followed.

    It is the one that is set, unless that is the travelling wave, which is lossless, and the layer
    has internal loss: then it is finite differences.
    """
    if settings['model'] == 'travelling_wave' and settings['layer.loss_tangent'] > 0.0:
        return 'finite_difference'
    return str(settings['model'])


def make_stepper(rig: Rig, model: str, motion: Literal['measured'] | None = None) -> ThrowStepper:
    """
    Make what follows a rig in real time, by the motion of its engine or a measured one.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, with the number.

    """
    if model == 'travelling_wave':
        return Stepper(rig, motion, field_points=FIELD_POINTS)
    return GridStepper(rig, motion, model=model, field_points=FIELD_POINTS)


def check(settings: Settings) -> None:
    """
    Tell whether settings can be stepped in real time, which takes microseconds.

    Raises
    ------
    ValueError
        If not, with the number and what would do.

    """
    rig, model = rig_of(settings), model_of(settings)
    if model == 'travelling_wave':
        steps_per_crossing(rig)
    else:
        cells_per_layer(rig, model)
    if settings['engine.motion'] == 'measured':
        _check_window(settings)


def _check_window(settings: Settings) -> None:
    """Raise ValueError if the window is too long to see the plate start, and stop."""
    window, frequency = settings['measured.window'], settings['engine.frequency']
    if window * frequency > LONGEST_WINDOW:
        raise ValueError(
            f'measured.window must be at most {LONGEST_WINDOW:g} of the plate period, '
            f'{LONGEST_WINDOW / frequency:.4g} s at engine.frequency {frequency:g} Hz, '
            f'got {window:g} s'
        )


def warm_up() -> None:
    """Compile or load the kernels of all models, so that no change of settings has to."""
    smoothing.warm_up()
    stepper.warm_up()
    grid_stepper.warm_up()
    _other_models(Rig(), '')
    _peak_strain(make_stepper(Rig(), 'travelling_wave'))


def _throw_field(stepper: ThrowStepper) -> ThrowField:
    """Let the layer go through a throw, to half as long again as the ejection time."""
    times = np.linspace(0.0, 1.5 * _ejection_time(stepper), THROW_FIELD_ROWS)
    strain = np.empty((THROW_FIELD_ROWS, FIELD_POINTS))
    stepper.reset()
    stepper.sample_field(times, strain)
    stepper.reset()
    return ThrowField(times, strain)


def _ejection_time(stepper: ThrowStepper) -> float:
    """Find when the projectile leaves, or, if it does not soon, how long its first swings take."""
    rig = stepper.rig
    swing = 1.0 / min(rig.engine.frequency, rig.natural_frequency) + rig.crossing_time
    for eighth in range(1, 8 * _SWINGS + 1):
        if stepper.advance_to(0.125 * eighth * swing):
            return stepper.events()[0].time
    return _SWINGS * swing


def _peak_strain(stepper: ThrowStepper) -> float:
    """Find the largest strain up to the first release, which may be within the layer."""
    if isinstance(stepper, GridStepper):
        _ejection_time(stepper)
        peak = stepper.first_peak_strain if stepper.event_count else 0.0
        stepper.reset()
        return peak
    rig = stepper.rig
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


def _other_models(rig: Rig, model: str) -> dict[str, Release | None]:
    """Let other models that can do it predict the first release; None if there is none."""
    ratios: dict[str, Any] = {
        'mass_ratio': rig.mass_ratio,
        'speed_ratio': rig.speed_ratio,
        'damping_ratio': rig.engine.damping_ratio,
        'gravity_ratio': rig.gravity_ratio,
    }
    loss = rig.layer.loss_tangent
    on_grid = partial(first_releases, **ratios, loss_tangent=loss, cells=_CELLS)
    ways: dict[str, Callable[[], FirstRelease | spring_mass.FirstRelease]] = {
        'travelling_wave': partial(first_release, **ratios),
        'finite_difference_elastic': partial(on_grid, crossing_ratio=rig.crossing_ratio),
        'finite_difference_glued': partial(on_grid, glued_to='projectile'),
        'spring_mass': partial(
            spring_mass.first_release,
            frequency_ratio=rig.natural_frequency / rig.engine.frequency,
        ),
    }
    if loss > 0.0:
        del ways['travelling_wave']
    if rig.speed_ratio > _STIFFEST:
        del ways['finite_difference_elastic'], ways['finite_difference_glued']
    return {name: _released(rig, way) for name, way in ways.items() if name != model}


def _released(
    rig: Rig, way: Callable[[], FirstRelease | spring_mass.FirstRelease]
) -> Release | None:
    try:
        release = way()
    except ThrowUnresolvedError:
        return None
    return Release(
        time=float(release.ejection_phase) / rig.engine.frequency,
        speed=float(release.speed) * rig.engine.speed_scale,
        energy_transfer=float(release.energy_transfer),
    )
