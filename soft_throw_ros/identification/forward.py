# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The forward model: the motion of the projectile, computed with the steppers of the twin."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.cell_stepper import CellStepper
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import (
    Event,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    Stepper,
)
from soft_throw_ros.core.throw import make_stepper, throw_many
from soft_throw_ros.identification.least_squares import FitError

Floats = NDArray[np.float64]

_MAX_COST = 0.16
"""Largest processor time of one simulation, as its stepper estimates it. [s]"""

_MAX_CACHED = 64
"""Largest number of cached throws."""


class DeadlineExceeded(Exception):
    """A fit takes too long."""


class ProjectilePath(NamedTuple):
    """Height of the projectile's lower face [m], its velocity [m/s], and the events."""

    position: Floats
    velocity: Floats
    events: tuple[Event, ...]


class ThrowSimulator:
    """
    Simulate throws until a deadline; raise `DeadlineExceeded` after it.

    The deadline is in seconds of the processor time of this thread, from now.
    """

    def __init__(self, seconds: float = math.inf) -> None:
        self._deadline = time.thread_time() + seconds
        self._cache: dict[Hashable, ProjectilePath] = {}

    def follow(self, rig: Rig, moments: Floats, *, by_cells: bool = False) -> ProjectilePath:
        """
        Follow a throw at times since the start of the plate, before which all is at rest [s].

        `by_cells` uses cells also without internal loss: all rigs that a fit of the loss compares
        need the same model. Raise FitError if the model refuses the rig, or a single simulation
        would take too long.
        """
        key = rig, by_cells, moments.tobytes()
        if key not in self._cache:
            if time.thread_time() > self._deadline:
                raise DeadlineExceeded
            if len(self._cache) >= _MAX_CACHED:
                self._cache.pop(next(iter(self._cache)))
            self._cache[key] = _follow(rig, moments, by_cells=by_cells)
        return self._cache[key]

    def landing_time(self, rig: Rig, until: float, *, by_cells: bool = False) -> float:
        """Return the time of landing on the layer, infinity if after `until` [s]."""
        if rig.gravity > 0.0:
            for event in self.follow(rig, np.array([until]), by_cells=by_cells).events:
                if event.kind == 'landing':
                    return event.time
        return float('inf')


def _follow(rig: Rig, time: Floats, *, by_cells: bool) -> ProjectilePath:
    """Follow a throw by the stepper of its rig, or by cells."""
    moments, indices = np.unique(np.maximum(time, 0.0), return_inverse=True)
    until = float(moments[-1])
    try:
        stepper = (CellStepper if by_cells else make_stepper)(rig, field_points=2)
        _check_cost(stepper, until, rig)
        stepper.advance_to(until)
        events = stepper.events()
        states, is_flying = _flights(events, moments, rig.gravity)
        stepper.reset()
        for index in np.flatnonzero(~is_flying).tolist():
            stepper.advance_to(float(moments[index]))
            states[0, index] = stepper.state[PROJECTILE_POSITION]
            states[1, index] = stepper.state[PROJECTILE_VELOCITY]
    except FitError:
        raise
    except ValueError as error:
        raise FitError(f'the throw cannot be followed: {error}') from None
    position, velocity = states[:, indices]
    return ProjectilePath(position, velocity, tuple(events))


def _check_cost(stepper: Stepper, until: float, rig: Rig) -> None:
    """Raise FitError if a simulation takes too long."""
    cost = stepper.cost * until
    if cost > _MAX_COST:
        raise FitError(
            f'{until:.3g} s of a layer that a wave crosses in {rig.crossing_time:.2g} s take '
            f'{cost:.2g} s to simulate, the limit is {_MAX_COST:g} s; leave out late samples'
        )


def _flights(
    events: Sequence[Event], moments: Floats, gravity: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """
    Compute heights and velocities of the flights between a release and the next contact.

    Returns an array of shape (2, n), and whether the projectile flies at each moment; the columns
    of the other moments are 0.
    """
    states = np.zeros((2, moments.size))
    if not events:
        return states, np.zeros(moments.size, dtype=bool)
    times, heights, speeds = np.array([event[1:] for event in events]).T
    is_release = np.array([event.kind == 'release' for event in events])
    last = np.searchsorted(times, moments, side='right') - 1
    is_flying = (last >= 0) & is_release[last]
    start = last[is_flying]
    since = moments[is_flying] - times[start]
    states[0, is_flying] = heights[start] + since * (speeds[start] - 0.5 * gravity * since)
    states[1, is_flying] = speeds[start] - gravity * since
    return states, is_flying


class FirstReleases(NamedTuple):
    """First releases, as arrays over rigs; NaN for rigs without a release."""

    time: Floats
    """Time since the plate began to move. [s]"""
    speed: Floats
    """[m/s]"""
    peak_plate_speed: Floats
    """[m/s]"""
    echoes: NDArray[np.int64]
    """Number of echoes of the wave before; time and energy jump where this number changes."""

    @property
    def energy_transfer(self) -> Floats:
        """Square of the speed over that of the plate [-]."""
        return (self.speed / self.peak_plate_speed) ** 2


def first_releases(rigs: Sequence[Rig]) -> FirstReleases:
    """Compute the first releases of rigs."""
    time, speed, energy_transfer = np.transpose([throw_many(rig)[:3] for rig in rigs])
    crossings = time / [rig.crossing_time for rig in rigs]
    return FirstReleases(
        time=time,
        speed=speed,
        peak_plate_speed=speed / np.sqrt(energy_transfer),
        echoes=((np.nan_to_num(crossings) - 1.0) // 2.0).astype(np.int64),
    )
