# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The forward model: the motion of the projectile, computed with the steppers of the twin."""

from __future__ import annotations

from functools import lru_cache
import math
import time
from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.cell_stepper import CellStepper
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event, PROJECTILE_POSITION, PROJECTILE_VELOCITY
from soft_throw_ros.core.throw import make_stepper
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.tracks import Floats

_MAX_COST = 0.16  # largest processor time of one simulation, as its stepper estimates it [s]
_MAX_CACHED = 64  # largest number of cached throws


class ProjectilePath(NamedTuple):
    """Height of the projectile's lower face [m], its velocity [m/s], and the events."""

    position: Floats
    velocity: Floats
    events: tuple[Event, ...]


class ThrowSimulator:
    """
    Simulate throws until a deadline; raise FitError after it.

    The deadline is in seconds of the processor time of this thread, from now.
    """

    def __init__(self, seconds: float = math.inf) -> None:
        self._deadline = time.thread_time() + seconds
        self._cached = lru_cache(_MAX_CACHED)(self._simulate)

    @property
    def is_late(self) -> bool:
        """Whether the deadline is over."""
        return time.thread_time() > self._deadline

    def follow(self, rig: Rig, moments: Floats, *, by_cells: bool = False) -> ProjectilePath:
        """
        Follow a throw at times since the start of the plate, before which all is at rest [s].

        `by_cells` uses cells also without internal loss: all rigs that a fit of the loss compares
        need the same model. Raise FitError if the model refuses the rig, or a single simulation
        would take too long.
        """
        return self._cached(rig, moments.tobytes(), by_cells)

    def landing_time(self, rig: Rig, until: float, *, by_cells: bool = False) -> float:
        """Return the time of landing on the layer, infinity if after `until` [s]."""
        events = self.follow(rig, np.array([until]), by_cells=by_cells).events
        landings = (event.time for event in events if event.kind == 'landing')
        return next(landings, math.inf) if rig.gravity > 0.0 else math.inf

    def _simulate(self, rig: Rig, moments: bytes, by_cells: bool) -> ProjectilePath:
        if self.is_late:
            raise FitError(
                'the fit takes too long; leave out late samples, or fit fewer parameters'
            )
        time, indices = np.unique(np.maximum(np.frombuffer(moments), 0.0), return_inverse=True)
        try:
            positions, velocities, events = _follow(rig, time, by_cells=by_cells)
        except ValueError as error:
            raise FitError(f'the throw cannot be followed: {error}') from None
        return ProjectilePath(positions[indices], velocities[indices], events)


def _follow(rig: Rig, moments: Floats, *, by_cells: bool) -> ProjectilePath:
    """Follow a throw at increasing times by the stepper of its rig, or by cells."""
    until = float(moments[-1])
    stepper = (CellStepper if by_cells else make_stepper)(rig, field_points=2)
    cost = stepper.cost * until
    if cost > _MAX_COST:
        raise ValueError(
            f'{until:.3g} s of a layer that a wave crosses in {rig.crossing_time:.2g} s take '
            f'{cost:.2g} s to simulate, the limit is {_MAX_COST:g} s; leave out late samples'
        )
    stepper.advance_to(until)
    events = stepper.events()
    states, is_flying = np.empty((2, moments.size)), np.zeros(moments.size, dtype=bool)
    ends = [*(event.time for event in events[1:]), math.inf]
    for release, end in zip(events, ends, strict=False):
        if release.kind == 'release':
            flight = (moments >= release.time) & (moments < end)
            since = moments[flight] - release.time
            mean_velocity = release.velocity - 0.5 * rig.gravity * since
            states[0, flight] = release.position + mean_velocity * since
            states[1, flight] = release.velocity - rig.gravity * since
            is_flying |= flight
    stepper.reset()
    for index in np.flatnonzero(~is_flying).tolist():
        stepper.advance_to(float(moments[index]))
        states[:, index] = stepper.state[[PROJECTILE_POSITION, PROJECTILE_VELOCITY]]
    return ProjectilePath(states[0], states[1], tuple(events))
