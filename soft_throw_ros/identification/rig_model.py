# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The model of a fit: heights of all bodies in all throws, and their derivatives."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
import math
from time import thread_time
from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.cell_stepper import CellStepper
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event, PROJECTILE_POSITION, PROJECTILE_VELOCITY
from soft_throw_ros.core.throw import make_stepper
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    DEFAULTS,
    ENGINE,
    FitDescription,
    FREE,
    LOSS,
    NUISANCE_PARAMETERS,
    OWN,
    PARAMETERS,
    PLATE_ZERO,
    PROJECTILE_ZERO,
    START,
)
from soft_throw_ros.identification.least_squares import Fit, fit_tracks, FitError
from soft_throw_ros.identification.plate_fit import MAX_DAMPING_RATIO
from soft_throw_ros.identification.tracks import FEWEST, Floats, ThrowTracks, Track

_BOUNDS: Mapping[str, tuple[float, float]] = {
    'engine.frequency': (1e-6, math.inf),
    'engine.damping_ratio': (0.0, MAX_DAMPING_RATIO),
    'engine.amplitude': (1e-12, math.inf),
    'layer.wave_speed': (0.5, 300.0),
    'layer.thickness': (1e-4, 0.5),
    'layer.loss_tangent': (0.0, 2.0),
    'layer.density': (1.0, 1e5),
    'layer.diameter': (1e-4, 1.0),
    'projectile.mass': (1e-7, 1e3),
}
_MASS, _DIAMETER = 'projectile.mass', 'layer.diameter'
_UNBOUNDED = (-math.inf, math.inf)
_STEP = 3e-4  # relative step of derivatives, large against the errors of steppers
_STEPS = {'engine.damping_ratio': 3e-5, 'layer.loss_tangent': 3e-4}  # absolute
_OWN = FREE._replace(is_per_throw=True)  # treatment of the parameters that every throw has
_MAX_ERROR = 1e30  # error in SI units beyond which a parameter is not seen at all
_MAX_EVALUATIONS = 200  # largest number of evaluations of the model in one run of the solver
_MAX_COST = 0.16  # largest processor time of one simulation, as its stepper estimates it [s]
_MAX_CACHED = 64  # largest number of cached throws


class Series(NamedTuple):
    """The track of one body in one throw; throws count from 0."""

    throw: int
    body: str
    track: Track


class Trajectory(NamedTuple):
    """Heights of a body [m], of the projectile's lower face, its velocities [m/s], and events."""

    height: Floats
    velocity: Floats
    events: tuple[Event, ...] = ()


class ThrowSimulator:
    """Simulate throws within seconds of processor time of this thread; then raise FitError."""

    def __init__(self, seconds: float = math.inf) -> None:
        self._deadline = thread_time() + seconds
        self._cached = lru_cache(_MAX_CACHED)(self._simulate)

    @property
    def is_late(self) -> bool:
        """Whether the deadline is over."""
        return thread_time() > self._deadline

    def follow(self, rig: Rig, moments: Floats, *, by_cells: bool = False) -> Trajectory:
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

    def _simulate(self, rig: Rig, moments: bytes, by_cells: bool) -> Trajectory:
        if self.is_late:
            raise FitError(
                'the fit takes too long; leave out late samples, or fit fewer parameters'
            )
        try:
            return _follow(rig, np.frombuffer(moments), by_cells=by_cells)
        except ValueError as error:
            raise FitError(f'the throw cannot be followed: {error}') from None


def _follow(rig: Rig, times: Floats, *, by_cells: bool) -> Trajectory:
    """Follow a throw at times in any order, by the stepper of its rig or by cells."""
    moments, indices = np.unique(np.maximum(times, 0.0), return_inverse=True)
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
    heights, velocities = states[:, indices]
    return Trajectory(heights, velocities, tuple(events))


@dataclass(frozen=True)
class RigModel:
    """
    A model of the tracks of all throws, around the values of `rig`.

    The fitted values form a vector, see `parameters`. Derivatives are forward differences, which
    need a simulation only for the parameters of the rig.
    """

    throws: tuple[ThrowTracks, ...]
    rig: Rig
    description: FitDescription
    simulator: ThrowSimulator
    initial: Mapping[str, float]  # start values by `names`, at least those of fits of the plates

    @property
    def by_cells(self) -> bool:
        """Whether the layer needs cells, or its loss is fitted."""
        return self.description.treatment(LOSS).is_varied or self.rig.layer.needs_cells

    @cached_property
    def series(self) -> list[Series]:
        """All tracks, throw by throw."""
        return [
            Series(number, body, track)
            for number, throw in enumerate(self.throws)
            for body, track in (('plate', throw.plate), ('projectile', throw.projectile))
            if track is not None
        ]

    @property
    def projectiles(self) -> list[Series]:
        """Tracks of projectiles alone."""
        return [item for item in self.series if item.body == 'projectile']

    @cached_property
    def parameters(self) -> list[tuple[str, int | None]]:
        """
        Parameter of each value, and the number of its throw, None if all throws share it.

        The shared ones come first, and the starts and the heights at rest last.
        """
        thrown, shared, own = [item.throw for item in self.projectiles], [], []
        for name in (*DEFAULTS, *OWN):
            is_of_plate = name.startswith(('engine', 'plate', START))
            throws = range(len(self.throws)) if is_of_plate else thrown
            treatment = _OWN if name in OWN else self.description.treatment(name)
            if throws and treatment.is_varied and treatment.is_per_throw:
                own += [(name, throw) for throw in throws]
            elif throws and treatment.is_varied:
                shared.append((name, None))
        return [*shared, *own]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the values; of those of one of several throws with its number from 1."""
        return tuple(
            name if throw is None else self.own_name(name, throw)
            for name, throw in self.parameters
        )

    def own_name(self, name: str, throw: int) -> str:
        """Return the name of a value of one throw, counted from 0."""
        return name if len(self.throws) == 1 else f'{name}[{throw + 1}]'

    @cached_property
    def indices(self) -> dict[str, dict[int, int]]:
        """Indices of each parameter among the values, by throw."""
        indices: dict[str, dict[int, int]] = {}
        for index, (name, throw) in enumerate(self.parameters):
            throws = range(len(self.throws)) if throw is None else [throw]
            indices.setdefault(name, {}).update(dict.fromkeys(throws, index))
        return indices

    def indices_of(self, name: str) -> list[int]:
        """Return the indices of a parameter among the values, of all throws."""
        return sorted(set(self.indices[name].values()))

    def value(self, values: Floats, name: str, throw: int) -> float:
        """Return a value of a throw; the default if it is not fitted."""
        index = self.indices.get(name, {}).get(throw)
        if index is not None:
            return float(values[index])
        return self.description.value(name, self.rig) if name in NUISANCE_PARAMETERS else 0.0

    def rig_of(self, values: Floats, throw: int | None = None) -> Rig:
        """Return the rig of a throw, or by default that with the means of values per throw."""
        return changed_rig(self.rig, {
            name: float(np.mean(values[self.indices_of(name)])) if throw is None
            else float(values[by_throw[throw]])
            for name, by_throw in self.indices.items()
            if name in PARAMETERS and (throw is None or throw in by_throw)
        })

    def predict(self, values: Floats) -> Floats:
        """Heights of all tracks in one series; see `trajectory`."""
        return np.concatenate([
            self.trajectory(values, throw, body, track.time).height
            for throw, body, track in self.series
        ])

    def trajectory(
        self, values: Floats, throw: int, body: str, time: Floats, rig: Rig | None = None
    ) -> Trajectory:
        """
        Compute the trajectory of a body at times on the clock of the tracks.

        The rig is by default that of the values. Raise FitError if it cannot be followed.
        """
        rig = rig or self.rig_of(values, throw)
        since = time - self.value(values, START, throw)
        plate = self.throws[throw].plate
        share = (time - 0.5 * (plate.time[0] + plate.time[-1])) / plate.duration
        drift = self.value(values, f'{body}.drift', throw) * (share * self.rig.engine.amplitude)
        if body == 'plate':
            motion = Underdamped.of(rig.engine)
            rest = self.value(values, PLATE_ZERO, throw)
            return Trajectory(rest + motion.position(since) + drift, motion.velocity(since))
        scale, delay, rest = (
            self.value(values, name, throw)
            for name in ('projectile.scale', 'projectile.delay', PROJECTILE_ZERO)
        )
        path = self.simulator.follow(rig, since - delay, by_cells=self.by_cells)
        height = rest + scale * (path.height - rig.rest_height) + drift
        return Trajectory(height, scale * path.velocity)

    def jacobian(self, values: Floats, only: Collection[str] = ()) -> Floats:
        """Return the derivatives of `predict` by all or some parameters."""
        blocks, has_both = [], {_MASS, _DIAMETER} <= self.indices.keys()
        for throw, body, track in self.series:
            block = np.zeros((track.time.size, values.size))
            now = self.trajectory(values, throw, body, track.time)
            for name, by_throw in self.indices.items():
                is_of_body = name in (START, *ENGINE) or name.startswith(
                    'plate' if body == 'plate' else ('projectile', 'layer')
                )
                if throw not in by_throw or not is_of_body or (only and name not in only):
                    continue
                if name == _MASS and has_both:
                    continue  # see below
                index = by_throw[throw]
                if name in (START, 'projectile.delay'):
                    block[:, index] = -now.velocity
                    continue
                moved = values.copy()
                size = abs(values[index]) if name in PARAMETERS else 1.0
                step = _STEPS.get(name, _STEP * size)
                is_within = values[index] + step < _BOUNDS.get(name, _UNBOUNDED)[1]
                moved[index] += step if is_within else -step
                change = self.trajectory(moved, throw, body, track.time).height - now.height
                block[:, index] = change / (moved[index] - values[index])
            if has_both and body == 'projectile':
                # both enter by the relaxation time m / (rho_s S c_s) alone
                mass, diameter = (self.indices[name][throw] for name in (_MASS, _DIAMETER))
                block[:, mass] = -0.5 * values[diameter] / values[mass] * block[:, diameter]
            blocks.append(block)
        return np.concatenate(blocks)

    def start(self, before: Mapping[str, float] | None = None) -> Floats:
        """Return start values: those of `before`, of `initial`, or of the description."""
        values = np.zeros(len(self.names))
        fitted = {**self.initial, **(before or {})}
        for index, (name, throw) in enumerate(self.parameters):
            if self.names[index] in fitted:
                values[index] = fitted[self.names[index]]
            elif name in DEFAULTS:
                values[index] = self.description.value(name, self.rig)
            elif throw is not None:  # the zero of the projectile, after all others
                projectile = self.throws[throw].projectile
                assert projectile is not None
                path = self.trajectory(values, throw, 'projectile', projectile.time)
                values[index] = float(np.median(projectile.position - path.height))
        return values

    def fit(
        self, start: Floats, *, max_evaluations: int = _MAX_EVALUATIONS, only: Collection[str] = ()
    ) -> Fit:
        """Fit all values, or only some parameters, by `fit_tracks`."""
        free = [i for i, (name, _) in enumerate(self.parameters) if not only or name in only]
        kinds = [self.parameters[index][0] for index in free]
        known = {
            k: prior for k, name in enumerate(kinds)
            if name in DEFAULTS and (prior := self.description.known(name, self.rig))
        }

        def whole(values: Floats) -> Floats:
            full: Floats = start.copy()
            full[free] = values
            return full

        several = len(self.throws) > 1
        tracks = [
            (f'{body} of {self.throws[throw].name}' if several else body, track)
            for throw, body, track in self.series
        ]
        low, high = np.transpose([_BOUNDS.get(name, _UNBOUNDED) for name in kinds])
        result = fit_tracks(
            lambda values: self.predict(whole(values)), start[free], tracks,
            names=tuple(self.names[index] for index in free),
            bounds=(low, high),
            jacobian=lambda values: self.jacobian(whole(values), only)[:, free],
            known=known,
            max_evaluations=max_evaluations,
        )
        errors = zip(result.names, result.errors, strict=True)
        if unseen := [name for name, error in errors if not error < _MAX_ERROR]:
            raise FitError(f'these tracks say nothing of {", ".join(unseen)}')
        return result

    def start_of(self, throw: int) -> float:
        """Return the start of a throw that counts from 0, on the clock of its tracks [s]."""
        return self.initial[self.own_name(START, throw)]

    def cut_after(self, after: float) -> RigModel:
        """Remove the samples of projectiles later than a time after the start [s]."""
        throws = list(self.throws)
        for throw, _, track in self.projectiles:
            is_early = track.time <= self.start_of(throw) + after
            rest = track.where(is_early) if is_early.sum() >= FEWEST else None
            throws[throw] = replace(throws[throw], projectile=rest)
        return replace(self, throws=tuple(throws))
