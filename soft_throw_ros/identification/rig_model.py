# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The model of a fit: heights of all bodies in all throws, and their derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    DEFAULTS,
    ENGINE,
    FitDescription,
    NUISANCE_PARAMETERS,
    PARAMETERS,
    values_of,
)
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.least_squares import (
    Estimate,
    Fit,
    fit_tracks,
    FitError,
    FitModel,
)
from soft_throw_ros.identification.parameter_layout import (
    ParameterLayout,
    PLATE_ZERO,
    PROJECTILE_ZERO,
    RINGING,
    RINGING_AMPLITUDES,
    START,
)
from soft_throw_ros.identification.plate_fit import MAX_DAMPING_RATIO, PlateFit
from soft_throw_ros.identification.plate_waves import PlateWithWaves
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

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
_STEP = 3e-4
"""Relative step of derivatives, large against the errors of steppers. [-]"""

_STEPS = {  # absolute
    'engine.damping_ratio': 3e-5,
    'layer.loss_tangent': 3e-4,
    'layer.stiffening': 2e-2,
    **dict.fromkeys((PLATE_ZERO, PROJECTILE_ZERO), 1e-5),
    **dict.fromkeys(('plate.drift', 'projectile.drift', 'projectile.scale'), 1e-3),
    **dict.fromkeys(RINGING_AMPLITUDES, 1e-3),
}
_MAX_ERROR = 1e30
"""Error in SI units beyond which a parameter is not seen at all."""

IN_FLIGHT = 0.97
"""Share of the time until the landing that a fit uses. [-]"""

_MAX_EVALUATIONS = 200
"""Largest number of evaluations of the model in one run of the solver."""


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
    r"""
    A model of the tracks of all throws, around the values of `rig`.

    Notes
    -----
    The fitted values form a vector, see `layout`: first the values that all throws share, then the
    values of one or some throws. Derivatives are central differences, with a parameter changed in
    all throws at once. A parameter of the measurement needs no new simulation.

    """

    throws: tuple[ThrowTracks, ...]
    rig: Rig
    description: FitDescription
    simulator: ThrowSimulator
    plates: tuple[PlateFit, ...] = ()
    """Fits of the plates alone, throw by throw."""
    initial: Mapping[str, float] = field(default_factory=dict)
    """Start values from an earlier fit or a search, by the names of the values."""

    @property
    def by_cells(self) -> bool:
        """Whether the layer needs cells, or its loss is fitted."""
        return any(
            rig.layer.needs_cells
            or self.description.treatment('layer.loss_tangent', throw.name).is_varied
            for rig, throw in zip(self.rigs, self.throws, strict=True)
        )

    @cached_property
    def rigs(self) -> list[Rig]:
        """Rig of each throw, with the values of the description."""
        return [self.description.prepare(self.rig, throw.name) for throw in self.throws]

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
    def throw_of_sample(self) -> Integers:
        """Return the throw of each sample of all tracks."""
        return self._by_sample([item.throw for item in self.series])

    def _by_sample(self, values: Sequence[int]) -> Integers:
        """Repeat the value of each track for all its samples."""
        return np.repeat(values, [item.track.time.size for item in self.series])

    @cached_property
    def layout(self) -> ParameterLayout:
        """Return the order of the values that are fitted."""
        return ParameterLayout.of(self.throws, self.description)

    @cached_property
    def known(self) -> dict[int, Estimate]:
        """Priors by the indices of the values."""
        result: dict[int, Estimate | None] = {}
        for index, ((value_name, _), (throw, *_)) in enumerate(self.layout.groups.items()):
            name = RINGING if value_name in RINGING_AMPLITUDES else value_name
            if name in DEFAULTS:
                result[index] = self.description.known(
                    name, self.rigs[throw], self.throws[throw].name
                )
        return {index: known for index, known in result.items() if known is not None}

    def value(self, values: Floats, name: str, throw: int) -> float:
        """Return a value of a throw; the default if it is not fitted."""
        index = self.layout.indices.get(name, {}).get(throw)
        if index is not None:
            return float(values[index])
        if name in NUISANCE_PARAMETERS:
            return self.description.value(name, self.rigs[throw], self.throws[throw].name)
        return 0.0

    def rig_of(self, values: Floats, throw: int | None = None) -> Rig:
        """
        Return the rig of a throw, with the wave speed of its layer at the strain of the throw.

        By default, return the rig of the first throw with the mean of the values per throw.
        """
        number = 0 if throw is None else throw
        changes = {}
        for name, indices in self.layout.indices.items():
            if name in PARAMETERS and number in indices:
                if throw is None and self.layout.is_per_throw(name):
                    changes[name] = float(np.mean(values[self.layout.indices_of(name)]))
                else:
                    changes[name] = float(values[indices[number]])
        stiffening = self.value(values, 'layer.stiffening', number)
        if stiffening:
            rig = self.rigs[number]
            frequency = changes.get(ENGINE[0], rig.engine.frequency)
            amplitude = changes.get(ENGINE[2], rig.engine.amplitude)
            speed = changes.get('layer.wave_speed', rig.layer.wave_speed)
            speed += stiffening * 2.0 * math.pi * frequency * amplitude
            low, high = _BOUNDS['layer.wave_speed']
            changes['layer.wave_speed'] = min(max(speed, low), high)
        return changed_rig(self.rigs[number], changes)

    def tracks(self) -> list[tuple[str, Track]]:
        """All tracks with their names."""
        several = len(self.throws) > 1
        return [
            (f'{body} of {self.throws[throw].name}' if several else body, track)
            for throw, body, track in self.series
        ]

    def predict(self, values: Floats) -> Floats:
        """Heights of all tracks in one series; see `trajectories`."""
        return np.concatenate([item.height for item in self.trajectories(values)])

    def trajectories(
        self, values: Floats, requests: Sequence[tuple[int, str, Floats]] | None = None
    ) -> list[Trajectory]:
        """
        Compute trajectories of bodies, or raise FitError if a throw cannot be followed.

        They are those of throws, bodies, and times on the clock of the tracks; by default those
        of all tracks.
        """
        if requests is None:
            requests = [(throw, body, track.time) for throw, body, track in self.series]
        result = []
        motions = {throw: self.motion(values, throw) for throw in {item[0] for item in requests}}
        for throw, body, time in requests:
            rig, motion = motions[throw]
            since = self.since(values, throw, body, time)
            if body == 'plate':
                rest, scale = self.value(values, PLATE_ZERO, throw), 1.0
                travel, velocity = motion.position(since), motion.velocity(since)
            else:
                rest = self._projectile_rest(values, throw, rig)
                scale = self.value(values, 'projectile.scale', throw)
                path = self.simulator.follow(rig, since, motion=motion, by_cells=self.by_cells)
                travel, velocity = path.position - rig.rest_height, path.velocity
            height = rest + scale * travel + self.drift(values, throw, body, time)
            result.append(Trajectory(height, scale * velocity))
        return result

    def since(self, values: Floats, throw: int, body: str, time: Floats) -> Floats:
        """Return times since the start of a throw at which a body is seen [s]."""
        since = time - self.value(values, START, throw)
        if body == 'projectile':
            since = since - self.value(values, 'projectile.delay', throw)
        return since

    def motion(self, values: Floats, throw: int) -> tuple[Rig, PlateWithWaves]:
        """Return the rig of a throw, and the motion of its plate."""
        rig = self.rig_of(values, throw)
        cosine, sine = (self.value(values, name, throw) for name in RINGING_AMPLITUDES)
        return rig, PlateWithWaves(Underdamped.of(rig.engine), (cosine, sine))

    def drift(self, values: Floats, throw: int, body: str, time: Floats) -> Floats:
        """Height that drift adds, none at the middle of a record [m]."""
        plate = self.throws[throw].plate
        share = (time - 0.5 * (plate.time[0] + plate.time[-1])) / plate.duration
        size = self.value(values, f'{body}.drift', throw) * self.rig.engine.amplitude
        return np.asarray(size * share)

    def _projectile_rest(self, values: Floats, throw: int, rig: Rig) -> float:
        """Height of the resting projectile, from the zero of its track [m]."""
        if self.description.heights == 'own':
            return self.value(values, PROJECTILE_ZERO, throw)
        half = 0.5 * rig.projectile.length if self.description.reference == 'centre' else 0.0
        scale = self.value(values, 'projectile.scale', throw)
        return self.value(values, PLATE_ZERO, throw) + scale * (half + rig.rest_height)

    def jacobian(self, values: Floats, only: Sequence[str] | None = None) -> Floats:
        """Return the derivatives of `predict` by all or some parameters."""
        throws = self.throw_of_sample
        is_projectile = self._by_sample([item.body == 'projectile' for item in self.series])
        velocity = np.concatenate([item.velocity for item in self.trajectories(values)])
        jacobian = np.zeros((throws.size, values.size))
        for name, by_throw in self.layout.indices.items():
            if only and name not in only:
                continue
            if name in (START, 'projectile.delay'):
                slope = -velocity * (1.0 if name == START else is_projectile)
            else:
                slope = self._slope(values, name)
            for throw, index in by_throw.items():
                jacobian[throws == throw, index] = slope[throws == throw]
        return jacobian

    def _slope(self, values: Floats, name: str) -> Floats:
        """Return the central difference by a parameter, changed in all throws."""
        indices = self.layout.indices_of(name)
        low, high = _BOUNDS.get(name, _UNBOUNDED)
        ends = []
        for sign in (1.0, -1.0):
            moved = values.copy()
            step = _STEPS.get(name, 0.0) or _STEP * np.abs(values[indices])
            moved[indices] = np.clip(values[indices] + sign * step, low, high)
            ends.append(moved)
        width = np.ones(len(self.throws))
        for throw, index in self.layout.indices[name].items():
            width[throw] = ends[0][index] - ends[1][index]
        change = self.predict(ends[0]) - self.predict(ends[1])
        return np.asarray(change / width[self.throw_of_sample])

    def start(self, before: Fit | None = None) -> Floats:
        """Return start values, from a fit of fewer or more parameters, `initial` or the plates."""
        values = np.zeros(len(self.layout.names))
        for name, by_throw in self.layout.indices.items():
            for throw, index in by_throw.items():
                if name in PARAMETERS:
                    values[index] = values_of(self.rigs[throw], [name])[name]
                elif name in NUISANCE_PARAMETERS:
                    values[index] = self.description.value(name, self.rig, self.throws[throw].name)
        for throw, plate in enumerate(self.plates):
            engine = zip(ENGINE, plate.fit.values[:3].tolist(), strict=True)
            own = {START: plate.start_time, PLATE_ZERO: plate.offset, **dict(engine)}
            for index, ((name, key), throws) in enumerate(self.layout.groups.items()):
                if key is not None and throw in throws and name in own:
                    values[index] = own[name]
        if PROJECTILE_ZERO in self.layout:
            trajectories = self.trajectories(values)
            for (throw, body, track), trajectory in zip(self.series, trajectories, strict=True):
                if body == 'projectile':
                    zero = float(np.median(track.position - trajectory.height))
                    values[self.layout.indices[PROJECTILE_ZERO][throw]] = zero
        fitted = before.by_name if before else self.initial
        for index, name in enumerate(self.layout.names):
            values[index] = fitted.get(name, values[index])
        return values

    def fit(
        self,
        start: Floats,
        *,
        max_evaluations: int = _MAX_EVALUATIONS,
        only: Sequence[str] | None = None,
    ) -> Fit:
        """Fit all values, or only some parameters, by `fit_tracks`."""
        names = [name for name, _ in self.layout.groups]
        free = [index for index, name in enumerate(names) if not only or name in only]
        low, high = np.transpose([_BOUNDS.get(names[index], _UNBOUNDED) for index in free])

        def whole(values: Floats) -> Floats:
            full: Floats = start.copy()
            full[free] = values
            return full

        model = FitModel(
            names=tuple(self.layout.names[index] for index in free),
            predict=lambda values: self.predict(whole(values)),
            jacobian=lambda values: self.jacobian(whole(values), only)[:, free],
            low=low,
            high=high,
            known={k: self.known[index] for k, index in enumerate(free) if index in self.known},
        )
        result = fit_tracks(
            model,
            start[free],
            self.tracks(),
            max_evaluations=max_evaluations,
        )
        unseen = np.flatnonzero(~(result.errors < _MAX_ERROR))
        if unseen.size:
            raise FitError(
                f'these tracks say nothing of {", ".join(result.names[index] for index in unseen)}'
            )
        return result

    def cut_after(self, after: float) -> RigModel:
        """Remove the samples of projectiles later than a time after the start [s]."""
        throws = []
        for throw, plate in zip(self.throws, self.plates, strict=True):
            projectile = throw.projectile
            if projectile is not None:
                end = plate.start_time + after
                is_measured = int((projectile.time <= end).sum()) >= FEWEST
                projectile = projectile.between(-math.inf, end) if is_measured else None
            throws.append(replace(throw, projectile=projectile))
        return replace(self, throws=tuple(throws))

    def flight_end(self, rig: Rig) -> float:
        """Return the time since the start until which a fit uses the flight of a rig [s]."""
        longest = max(
            float(track.time[-1]) - self.plates[throw].start_time
            for throw, _, track in self.projectiles
        )
        landing = self.simulator.landing_time(rig, max(longest, 0.0), by_cells=self.by_cells)
        return IN_FLIGHT * landing
