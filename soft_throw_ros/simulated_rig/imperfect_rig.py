# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Throws of rigs whose plate has faults that no model of the core has.

The steppers of the core follow the layer and the projectile; the plate rings before the throw, or
has a second mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.plate import motion_of, SampledMotion, Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event, EventLimitError, PROJECTILE_POSITION
from soft_throw_ros.core.throw import make_stepper

Floats = NDArray[np.float64]

_STEP = 2e-5  # spacing of heights, of the states of an imperfect plate, and of deviations [s]
_RINGS_BEFORE = 0.1  # duration of tabulated ringing before the throw starts [s]
_LONGEST_THROW = 0.6  # longest time after the start with tabulated deviations [s]


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """Faults of the plate; amplitudes are relative to that of the engine."""

    ringing: float = 0.0  # amplitude of the plate's vibration before the throw [-]
    ringing_phase: float = 0.0  # at the start of the record [rad]
    ringing_damping_ratio: float | None = None  # None for that of the engine [-]
    second_mode: float = 0.0  # amplitude of a second mode, which the throw excites [-]
    second_mode_frequency: float = 310.0  # [Hz]
    second_mode_damping_ratio: float = 0.02  # [-]

    @property
    def are_present(self) -> bool:
        """Whether the rig has any imperfection."""
        return bool(self.ringing or self.second_mode)


@dataclass(frozen=True, kw_only=True)
class ImperfectThrow:
    """Events and paths of a simulated throw, as returned by `throw`."""

    rig: Rig
    events: tuple[Event, ...]  # releases and contacts, alternating, since the start of the throw
    plate: Callable[[ArrayLike], Floats]  # height at any time [m]
    projectile: Callable[[ArrayLike], Floats]  # of its lower face above the plate's rest [m]


def throw(
    rig: Rig, imperfections: Imperfections | None = None, *, until: float, start: float = 0.0
) -> ImperfectThrow:
    """
    Simulate a throw of a rig with faults from rest `until` a time after its start [s].

    A ringing plate grows for one period to its full amplitude at the time `start` of the first
    height [s].
    """
    imperfections = imperfections or Imperfections()
    start = min(start, 0.0)
    begin = start - 1.0 / rig.engine.frequency if imperfections.ringing else 0.0
    steps = np.arange(math.ceil((until - begin) / _STEP) + 1, dtype=np.float64)
    times = begin + _STEP * steps
    moving = rig
    if imperfections.are_present:
        heights = _plate(rig, imperfections, times, start)
        motion = SampledMotion.from_positions(times, heights)
        moving = replace(rig, engine=replace(rig.engine, motion=motion))
    stepper = make_stepper(moving, field_points=2)
    path = np.empty(times.size)
    for n, since in enumerate((times - begin).tolist()):
        try:
            stepper.advance_to(since)
        except EventLimitError:  # it chatters on a stiff layer, and stays there
            path[n:] = path[n - 1]
            break
        path[n] = stepper.state[PROJECTILE_POSITION]
    return ImperfectThrow(
        rig=rig,
        events=tuple(event._replace(time=event.time + begin) for event in stepper.events()),
        plate=lambda time: _plate(rig, imperfections, np.asarray(time, np.float64), start),
        projectile=lambda time: np.interp(np.asarray(time, np.float64), times, path),
    )


class Deviations:
    """
    Tabulated differences between the paths of an imperfect rig and a perfect one.

    They grow within a period of the plate. They fade within a crossing of the layer before the
    projectile lands, because the bounces that follow are chaotic.
    """

    def __init__(self, rig: Rig, imperfections: Imperfections) -> None:
        start = -_RINGS_BEFORE if imperfections.ringing else 0.0
        perfect, imperfect = (
            throw(rig, faults, start=start, until=_LONGEST_THROW)
            for faults in (Imperfections(), imperfections)
        )
        self.start = start  # of the first deviation, negative before the throw [s]
        landings = [
            event.time
            for event in (*perfect.events, *imperfect.events)
            if event.kind != 'release' and event.velocity <= 0.0 < event.time
        ]
        end = min([*landings, _LONGEST_THROW])
        self._time = time = np.arange(start, end + _STEP, _STEP)
        share = np.clip((end - time) / rig.crossing_time, 0.0, 1.0)
        if imperfections.ringing:
            share *= np.clip((time - start) * rig.engine.frequency, 0.0, 1.0)
        plate = imperfect.plate(time) - perfect.plate(time)
        projectile = imperfect.projectile(time) - perfect.projectile(time)
        self._columns = share * plate, share * projectile

    def at(self, since: float) -> tuple[float, float]:
        """Return the deviations of plate and projectile [m], at a time since the start [s]."""
        plate, projectile = (np.interp(since, self._time, column) for column in self._columns)
        return float(plate), float(projectile)


def _plate(rig: Rig, imperfections: Imperfections, time: Floats, start: float) -> Floats:
    """Return heights of the plate: the motion of the engine, ringing, and a second mode."""
    engine = rig.engine
    height = motion_of(engine).position(time)
    if imperfections.ringing:
        damping_ratio = imperfections.ringing_damping_ratio
        if damping_ratio is None:
            damping_ratio = engine.damping_ratio
        rate = Underdamped.of(replace(engine, damping_ratio=damping_ratio)).exponent
        growth = np.clip((time - start) * engine.frequency + 1.0, 0.0, 1.0)
        decay = np.exp(rate.real * np.maximum(time - start, 0.0))
        wave = np.sin(rate.imag * (time - start) + imperfections.ringing_phase)
        envelope = decay * growth**3 * (10.0 - 15.0 * growth + 6.0 * growth**2)
        height = height + imperfections.ringing * engine.amplitude * envelope * wave
    if imperfections.second_mode:
        since = np.maximum(time, 0.0)
        omega = 2.0 * math.pi * imperfections.second_mode_frequency
        decay = np.exp(-imperfections.second_mode_damping_ratio * omega * since)
        wave = np.sin(omega * since)
        height = height + imperfections.second_mode * engine.amplitude * decay * wave
    return height
