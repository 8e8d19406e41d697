# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A rig with all values that are computed before a throw."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from soft_throw_ros.configuration import motions, rig_of, Settings, TWIN
from soft_throw_ros.configuration.interface import FIELD_POINTS
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.core.plate import motion_of as motion_of_engine
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import (
    Event,
    EventLimitError,
    PROJECTILE_FORCE,
    PROJECTILE_VELOCITY,
    Stepper,
)
from soft_throw_ros.core.throw import make_stepper
from soft_throw_ros.twin.plate_observer import pulse_of, ReleaseResponse
from soft_throw_ros.twin.results import LayerState, State, ThrowField

_ROWS = 200
"""Times in a throw with the field, the energies, or the answer of the release to a pulse. [-]"""

THROW_FIELD_LENGTH = 1.5
"""Duration of the field of a throw, in ejection times. [-]"""

LONGEST_WINDOW = 0.2
"""Longest smoothing window in periods of the plate; longer ones hide the start. [-]"""

MOST_SHARE = 0.5
"""
Share of a step that the stepper of a measured throw and its forks may take, in addition to the
remaining work of a step. [-]
"""
RETURN_TIME = 0.1
"""Duration of the return to rest, unless the period of the throws is too short. [s]"""

_REST = 1e-7
"""Largest height, velocity and acceleration of a commanded plate at rest. [m], [m/s], [m/s2]"""

_PULSE = 1e-6
"""Jump of the plate's velocity, so small that the layer is linear and stays compressed. [m/s]"""

_WAITING = frozenset(
    entry.name
    for entry in TWIN.entries
    if entry.is_of_rig or entry.group in ('rate', 'time_scale', 'measured')
)
"""Parameters whose changes wait until the rig is put back."""


@dataclass(frozen=True, kw_only=True)
class PreparedRig:
    """A rig that is ready to throw."""

    config: TwinConfig  # the configuration of this rig
    encoded_motion: Mapping[str, str]  # of a file, for the journal, by the path of the file
    stepper: Stepper  # the rig at rest
    rest: State  # where plate and projectile are at rest
    rest_layer: LayerState
    peak_plate_speed: float  # by the engine [m/s]
    throw_field: ThrowField | None  # None if the plate is measured
    ahead: tuple[Stepper, ReleaseResponse] | None  # a fork of the stepper, with a measured plate

    @property
    def rig(self) -> Rig:
        """Return the rig."""
        return self.config.rig

    @cached_property
    def tick(self) -> float:
        """Time of the rig in one step [s]."""
        return self.config.time_scale / self.config.state_rate

    def period_ticks(self, period: float) -> int:
        """Return the steps from one throw to the next: at least one to throw, one to return."""
        return max(2, round(period / self.tick))

    def return_ticks(self, period: float) -> int:
        """Return the steps of the return to rest, at most half of the period."""
        ticks = max(1, round(RETURN_TIME / self.tick))
        return min(ticks, self.period_ticks(period) // 2) if period else ticks


def state_of(stepper: Stepper) -> State:
    """Return the present state of plate and projectile."""
    return State._make(stepper.state.tolist()[1:])


def layer_of(stepper: Stepper) -> LayerState:
    """Return the present state of the layer."""
    return LayerState(*stepper.read_layer()[:3].copy())


def throw_field_of(stepper: Stepper, length: float, *, start_ns: int = 0) -> ThrowField:
    """Return the strain of the layer and the energies over a time [s] from the start on."""
    times = np.linspace(0.0, length, _ROWS)
    strain = np.empty((_ROWS, FIELD_POINTS))
    rig, energies = stepper.rig, []
    for row, time in enumerate(times.tolist()):
        if not stepper.advance_to(time):
            state, total = state_of(stepper), stepper.stored_energy()
            rise = state.projectile_position - rig.rest_height
            per_mass = 0.5 * state.projectile_velocity**2 + rig.gravity * rise
            projectile = rig.projectile.mass * per_mass
            energies.append((time, stepper.plate_work, projectile, total - projectile, total))
        strain[row] = stepper.read_layer()[3]
    heights = np.linspace(0.0, stepper.rig.layer.thickness, FIELD_POINTS)
    return ThrowField(times, heights, strain, np.array(energies), start_ns)


def stepper_of(config: TwinConfig) -> Stepper:
    """Return a stepper of the rig with the motion of its engine or a measured plate."""
    return make_stepper(config.rig, is_measured=config.is_measured, field_points=FIELD_POINTS)


def _release_response(config: TwinConfig) -> ReleaseResponse:
    """
    Return the response of the release; without one, of the speed after half a period.

    By superposition it is the motion of the projectile after a small pulse of the plate.
    """
    rig, motion = config.rig, config.measurement.motion
    nominal = make_stepper(rig, is_measured=False)
    release = _first_release(nominal)
    end = 0.5 / rig.engine.frequency if release is None else release.time
    since = np.linspace(0.0, end, _ROWS)
    nominal.reset()
    nominal.advance_to(since[-2])
    force_rate = nominal.state[PROJECTILE_FORCE] / (end - since[-2])
    in_contact = dataclasses.replace(rig, gravity=max(rig.gravity, Rig().gravity))
    stepper = make_stepper(in_contact, is_measured=True)
    times = np.append(since, 2.0 * end)  # cells go on to the end of their step
    stepper.append_plate_states(times, _PULSE * pulse_of(motion, times))
    speeds = []
    for time in since.tolist():
        stepper.advance_to(time)
        speeds.append(stepper.state[PROJECTILE_VELOCITY] / _PULSE)
    delays = rig.projectile.mass / force_rate * np.gradient(speeds, since)
    peak_time = motion.peak_velocity_time
    times = np.linspace(0.0, max(end, peak_time), _ROWS)
    rows = [np.interp(end - times, since, row, left=0.0) for row in (speeds, delays)]
    peak = np.where(times < peak_time, pulse_of(motion, peak_time - times)[:, 1], 0.0)
    expected = 0.0 if release is None else release.time
    return ReleaseResponse(times, np.array([*rows, peak]), expected)


def prepare(
    settings: Settings,
    before: PreparedRig | None = None,
    motion_of: motions.MotionSource = motions.read,
) -> PreparedRig:
    """
    Prepare the rig that complete settings describe, which takes milliseconds.

    The steppers of the rig `before` are used again unless a parameter in `waiting_values` differs,
    and its motion unless the path of the file differs. ValueError if the rig cannot be stepped in
    real time, or a controller cannot play the motion that is to be commanded.
    """
    if before is None:
        config = TwinConfig(settings=settings, rig=rig_of(settings, motion_of))
    else:
        path, motion = before.config.motion_file, before.rig.engine.motion
        config = before.config.change(
            settings, lambda name: motion if motion and name == path else motion_of(name)
        )
    if config.command_lead is not None:
        _require_playable(config, config.command_lead)
    if before is not None and waiting_values(settings) == waiting_values(before.config.settings):
        return dataclasses.replace(before, config=config)
    stepper = stepper_of(config)
    throw_field = ahead = None
    if config.is_measured:
        _require_time(config, stepper)
        ahead = stepper.fork(), _release_response(config)
    else:
        release = _first_release(stepper)
        length = THROW_FIELD_LENGTH * (release.time if release else config.rig.longest_wait)
        stepper.reset()
        throw_field = throw_field_of(stepper, length)
        stepper.reset()
    path, motion = config.motion_file, config.rig.engine.motion
    return PreparedRig(
        config=config,
        encoded_motion={path: motions.encode(motion)} if path and motion else {},
        stepper=stepper,
        rest=state_of(stepper),
        rest_layer=layer_of(stepper),
        peak_plate_speed=motion_of_engine(config.rig.engine).peak_velocity,
        throw_field=throw_field,
        ahead=ahead,
    )


def waiting_values(settings: Settings) -> Settings:
    """Return the settings whose changes wait until the rig is put back."""
    return {name: value for name, value in settings.items() if name in _WAITING}


def _require_time(config: TwinConfig, stepper: Stepper) -> None:
    """Raise ValueError unless a measured throw can be stepped in real time."""
    window, frequency = config.measurement.smoothing_window, config.rig.engine.frequency
    if window * frequency > LONGEST_WINDOW:
        raise ValueError(
            f'measured.smoothing_window must be at most {LONGEST_WINDOW / frequency:.4g} s, '
            f'{LONGEST_WINDOW:g} of the plate period, got {window:g} s'
        )
    # in each step, the fork advances by the time that it is ahead, and for the layer once more
    ahead = 2.0 * config.rig.crossing_time + window
    share = stepper.cost * (1.0 + ahead * config.state_rate)
    if share > MOST_SHARE:
        feasible = 0.999 * (MOST_SHARE / stepper.cost - 1.0) / ahead
        raise ValueError(
            f'rate.state {config.state_rate:g} Hz with a measured plate needs {100.0 * share:.3g} '
            f'% of the processor time of a step, the limit is {100.0 * MOST_SHARE:g} %; '
            f'feasible: rate.state of {feasible:.4g} Hz or less'
        )


def _require_playable(config: TwinConfig, lead: float) -> None:
    """
    Raise ValueError unless a controller can play the motion of the plate before each throw.

    A joint_trajectory_controller joins the held state to the first point by a quintic over the
    lead, rejects a last velocity, and drops the rest of a motion when the next one arrives.
    """
    path, motion, period = config.motion_file, config.rig.engine.motion, config.throw_period
    if motion is None or config.motion != 'file' or config.time_scale != 1.0:
        raise ValueError(
            "engine.command needs engine.motion 'file' and time_scale 1, "
            f'got {config.motion!r} and {config.time_scale:g}'
        )
    for name, state in (('first', motion.states[0]), ('last', motion.states[-1])):
        if np.abs(state).max() > _REST:
            raise ValueError(
                'engine.command needs a motion that begins and ends at rest at the same height, '
                f'as those of `soft-throw design motion`; in {path} the {name} height is '
                '{:g} m, velocity {:g} m/s, acceleration {:g} m/s2'.format(*state)
            )
    if period and motion.end_time > period - lead:
        raise ValueError(
            f'engine.command needs a motion of at most {period - lead:g} s, which is '
            f'throw.period {period:g} s minus engine.command_lead {lead:g} s; '
            f'{path} lasts {motion.end_time:g} s'
        )


def _first_release(stepper: Stepper) -> Event | None:
    """Advance to the first release, and return it, or None if there is none soon."""
    try:
        return stepper.advance_to_release(latest=stepper.rig.longest_wait)
    except EventLimitError:  # the projectile has left, and bounces on a stiff layer
        return stepper.events()[0]
