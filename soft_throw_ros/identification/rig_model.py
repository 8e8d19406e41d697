# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The model of a fit: heights of all bodies in all throws, and their derivatives."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
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
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.least_squares import Fit, fit_tracks, FitError, FitModel
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
_UNBOUNDED = (-math.inf, math.inf)
_STEP = 3e-4  # relative step of derivatives, large against the errors of steppers
_STEPS = {'engine.damping_ratio': 3e-5, 'layer.loss_tangent': 3e-4}  # absolute

_OWN = FREE._replace(is_per_throw=True)  # treatment of the parameters that every throw has
_MAX_ERROR = 1e30  # error in SI units beyond which a parameter is not seen at all
_MAX_EVALUATIONS = 200  # largest number of evaluations of the model in one run of the solver


class Series(NamedTuple):
    """The track of one body in one throw; throws count from 0."""

    throw: int
    body: str
    track: Track


class Trajectory(NamedTuple):
    """Measured height [m] and velocity [m/s] of a body."""

    height: Floats
    velocity: Floats


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
        """Return the name of a value of one throw, which throws count from 0."""
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
        height = rest + scale * (path.position - rig.rest_height) + drift
        return Trajectory(height, scale * path.velocity)

    def jacobian(self, values: Floats, only: Collection[str] = ()) -> Floats:
        """Return the derivatives of `predict` by all or some parameters."""
        blocks = []
        for throw, body, track in self.series:
            block = np.zeros((track.time.size, values.size))
            now = self.trajectory(values, throw, body, track.time)
            for name, by_throw in self.indices.items():
                is_of_body = name in (START, *ENGINE) or name.startswith(
                    'plate' if body == 'plate' else ('projectile', 'layer')
                )
                if throw not in by_throw or not is_of_body or (only and name not in only):
                    continue
                index = by_throw[throw]
                if name in (START, 'projectile.delay'):
                    block[:, index] = -now.velocity
                    continue
                moved = values.copy()
                moved[index] += self._step(name, float(values[index]))
                change = self.trajectory(moved, throw, body, track.time).height - now.height
                block[:, index] = change / (moved[index] - values[index])
            blocks.append(block)
        return np.concatenate(blocks)

    @staticmethod
    def _step(name: str, value: float) -> float:
        """Return a step for a derivative that remains within the bounds."""
        step = _STEPS.get(name, _STEP * (abs(value) if name in PARAMETERS else 1.0))
        return step if value + step < _BOUNDS.get(name, _UNBOUNDED)[1] else -step

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
        low, high = np.transpose([_BOUNDS.get(name, _UNBOUNDED) for name in kinds])

        def whole(values: Floats) -> Floats:
            full: Floats = start.copy()
            full[free] = values
            return full

        model = FitModel(
            names=tuple(self.names[index] for index in free),
            predict=lambda values: self.predict(whole(values)),
            jacobian=lambda values: self.jacobian(whole(values), only)[:, free],
            low=low,
            high=high,
            known=known,
        )
        several = len(self.throws) > 1
        tracks = [
            (f'{body} of {self.throws[throw].name}' if several else body, track)
            for throw, body, track in self.series
        ]
        result = fit_tracks(model, start[free], tracks, max_evaluations=max_evaluations)
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
