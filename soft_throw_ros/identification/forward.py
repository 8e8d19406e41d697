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
"""The forward model: what a rig's projectile does, by the steppers that the twin runs."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import cell_stepper, closed_form
from soft_throw_ros.core.plate import peak_velocity_ratio, SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import (
    Event,
    EventLimitError,
    FirstThrows,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    Stepper,
)
from soft_throw_ros.core.throw import make_stepper
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plate_modes import PlateWithModes

Floats = NDArray[np.float64]

MAX_COST = 8.0
"""What following one throw with all its trial rigs should take of a processor at most. [s]"""

_COST_PER_THROW = 1e-3  # of being set up [s]
_COST_PER_SAMPLE = 4e-6  # of being asked for a state [s]
_SHARE_OF_PATH = 0.02  # of all that, which following a single rig takes at most
_HARD = 4.0  # times that, from which on even what has to be done is refused
_MORE = 1.3  # times what the fit has taken that all takes together at most
_KEPT = 64  # throws that are remembered


class EffortError(FitError):
    """A fit would take far too long."""


class ProjectilePath(NamedTuple):
    """Height of the projectile's lower face [m], its velocity [m/s], and what happened."""

    position: Floats
    velocity: Floats
    events: tuple[Event, ...]


class ThrowSimulator:
    """Follows throws, so many one by one, and refuses to go on when that takes too long."""

    def __init__(self, *, throws: int = 1) -> None:
        self.cost = 0.0
        """What it has taken of a processor so far. [s]"""
        self._usual = MAX_COST * throws
        self._limit = _HARD * self._usual
        self._kept: dict[Hashable, ProjectilePath] = {}

    def bound(self) -> None:
        """Let what is left to do be refused where it would take too long."""
        self._limit = max(self._usual, _MORE * self.cost)

    def allow_more(self) -> None:
        """Let as much be done again as one fit may take."""
        self._limit = max(self._limit, self.cost + self._usual)

    def unbind(self) -> None:
        """Refuse nothing any more."""
        self._limit = math.inf

    def follow(
        self,
        rig: Rig,
        time: Floats,
        *,
        motion: PlateWithModes | None = None,
        by_cells: bool = False,
    ) -> ProjectilePath:
        """
        Follow a throw.

        Parameters
        ----------
        rig : Rig
            That throws.
        time : ndarray, shape (n,)
            Since the plate began to move, in any order; before that all is at rest. [s]
        motion : PlateWithModes, optional
            How the plate moves; by default as the engine has it.
        by_cells : bool
            Whether to take cells though there is no internal loss: where the loss is fitted, all
            that is compared has to be of one model.

        Raises
        ------
        FitError
            If the model refuses the rig, or would take too long.

        """
        key = rig, motion, by_cells, time.tobytes()
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            sampled = motion and motion.sampled(float(time.min()), float(time.max()))
            self._kept[key] = self._follow(rig, time, sampled, by_cells)
        return self._kept[key]

    def _follow(
        self, rig: Rig, time: Floats, motion: SampledMotion | None, by_cells: bool
    ) -> ProjectilePath:
        """Follow a throw whose plate moves as it was sampled."""
        begin = 0.0  # steppers begin at 0
        if motion is not None:
            begin = motion.start_time
            motion = SampledMotion(motion.times - begin, motion.states)
        moments, places = np.unique(np.maximum(time - begin, 0.0), return_inverse=True)
        try:
            stepper = self._make_stepper(rig, motion, float(moments[-1]), moments.size, by_cells)
            states = np.empty((moments.size, stepper.state.size))
            for row, moment in zip(states, moments.tolist(), strict=True):
                stepper.advance_to(moment)
                row[:] = stepper.state
        except FitError:
            raise
        except (ValueError, EventLimitError) as error:
            raise FitError(f'the throw cannot be followed: {error}') from None
        position, velocity = states[places][:, [PROJECTILE_POSITION, PROJECTILE_VELOCITY]].T
        events = (each._replace(time=each.time + begin) for each in stepper.events())
        return ProjectilePath(position, velocity, tuple(events))

    def landing_time(self, rig: Rig, until: float, *, by_cells: bool = False) -> float:
        """Find when the projectile falls onto the layer; infinity if not before `until` [s]."""
        if rig.gravity > 0.0:
            for event in self.follow(rig, np.array([until]), by_cells=by_cells).events:
                if event.kind == 'landing':
                    return event.time
        return float('inf')

    def _make_stepper(
        self, rig: Rig, motion: SampledMotion | None, until: float, samples: int, by_cells: bool
    ) -> Stepper:
        """Make a stepper, and charge what it will cost."""
        has_cells = by_cells or rig.layer.needs_cells
        model = 'finite_difference' if has_cells else 'travelling_wave'
        stepper = make_stepper(rig, motion, model=model, field_points=2)
        cost = stepper.cost * until + _COST_PER_THROW + _COST_PER_SAMPLE * samples
        self.cost += cost
        limit = _SHARE_OF_PATH * MAX_COST
        if cost > limit:
            raise FitError(
                f'{until:.3g} s of a layer that a wave crosses in {rig.crossing_time:.2g} s take '
                f'{cost:.2g} s to follow, the limit is {limit:.2g} s; leave out what comes late'
            )
        if self.cost > self._limit:
            raise EffortError(
                f'the fit takes more than {self._limit:.2g} s of following the model; leave out '
                'what comes late in the tracks, or fit less'
            )
        return stepper


class FirstReleases(NamedTuple):
    """How projectiles leave, arrays over rigs; NaN where one does not."""

    time: Floats
    """Since the plate began to move. [s]"""
    speed: Floats
    """[m/s]"""
    energy_transfer: Floats
    """[-]"""
    peak_plate_speed: Floats
    """[m/s]"""
    echoes: NDArray[np.int64]
    """How many echoes of the wave came back before: time and energy jump where they change."""


def first_releases(rigs: Sequence[Rig]) -> FirstReleases:
    """Compute the first releases of rigs that differ in numbers only."""
    ratios: dict[str, Any] = {  # keyword arguments
        'mass_ratio': np.array([rig.mass_ratio for rig in rigs]),
        'speed_ratio': np.array([rig.speed_ratio for rig in rigs]),
        'damping_ratio': np.array([rig.engine.damping_ratio for rig in rigs]),
        'gravity_ratio': np.array([rig.gravity_ratio for rig in rigs]),
    }
    release: closed_form.FirstRelease | FirstThrows
    if any(rig.layer.needs_cells for rig in rigs):
        for name in ('loss_tangent', 'strain_ratio', 'constant_loss'):
            ratios[name] = np.array([rig.cell_ratios[name] for rig in rigs])
        release = cell_stepper.first_throws(
            **ratios, stack=rigs[0].cell_ratios['stack'], unresolved='nan'
        )
    else:
        release = closed_form.first_releases(**ratios, unresolved='nan')
    phase = np.asarray(release.ejection_phase)
    scale = np.array([rig.engine.speed_scale for rig in rigs])
    crossings = np.nan_to_num(phase * ratios['speed_ratio'])
    return FirstReleases(
        time=phase / [rig.engine.frequency for rig in rigs],
        speed=release.speed * scale,
        energy_transfer=np.asarray(release.energy_transfer),
        peak_plate_speed=scale * [peak_velocity_ratio(rig.engine.damping_ratio) for rig in rigs],
        echoes=((crossings - 1.0) // 2.0).astype(np.int64),
    )
