# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The model of a fit: heights of all bodies in all throws, and their derivatives."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
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
    ParameterLayout,
    PARAMETERS,
    PLATE_ZERO,
    PROJECTILE_ZERO,
    START,
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
from soft_throw_ros.identification.plate_fit import MAX_DAMPING_RATIO, PlateFit
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]

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

_STEPS = {'engine.damping_ratio': 3e-5, 'layer.loss_tangent': 3e-4}  # absolute
_MASS_POWERS = {'layer.density': -1.0, 'layer.diameter': -2.0}
"""Powers of parameters that enter by the mass of the projectile over that of the layer. [-]"""

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
    values of one or some throws. Derivatives by parameters of the rig are forward differences, one
    simulation each; those by density and diameter follow from that by the mass. All others need
    no simulation.

    """

    throws: tuple[ThrowTracks, ...]
    rig: Rig
    description: FitDescription
    simulator: ThrowSimulator
    plates: tuple[PlateFit, ...]
    """Fits of the plates alone, throw by throw."""
    initial: Mapping[str, float] = field(default_factory=dict)
    """Start values from an earlier fit or a search, by the names of the values."""

    @property
    def by_cells(self) -> bool:
        """Whether the layer needs cells, or its loss is fitted."""
        is_varied = self.description.treatment('layer.loss_tangent').is_varied
        return is_varied or self.rig.layer.needs_cells

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

    @property
    def sample_count(self) -> int:
        """Number of samples of all tracks."""
        return sum(item.track.time.size for item in self.series)

    @cached_property
    def layout(self) -> ParameterLayout:
        """Return the order of the values that are fitted."""
        return ParameterLayout.of(self.throws, self.description)

    @cached_property
    def known(self) -> dict[int, Estimate]:
        """Priors by the indices of the values."""
        priors = {
            index: self.description.known(name, self.rig)
            for index, (name, _) in enumerate(self.layout.values) if name in DEFAULTS
        }
        return {index: known for index, known in priors.items() if known is not None}

    def value(self, values: Floats, name: str, throw: int) -> float:
        """Return a value of a throw; the default if it is not fitted."""
        index = self.layout.indices.get(name, {}).get(throw)
        if index is not None:
            return float(values[index])
        return self.description.value(name, self.rig) if name in NUISANCE_PARAMETERS else 0.0

    def rig_of(self, values: Floats, throw: int | None = None) -> Rig:
        """Return the rig of a throw, or by default that with the means of values per throw."""
        layout = self.layout
        return changed_rig(self.rig, {
            name: float(np.mean(values[layout.indices_of(name)])) if throw is None
            else float(values[by_throw[throw]])
            for name, by_throw in layout.indices.items()
            if name in PARAMETERS and (throw is None or throw in by_throw)
        })

    def tracks(self) -> list[tuple[str, Track]]:
        """All tracks with their names."""
        several = len(self.throws) > 1
        return [
            (f'{body} of {self.throws[throw].name}' if several else body, track)
            for throw, body, track in self.series
        ]

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
        drift = self.value(values, f'{body}.drift', throw) * self._drift(throw, time)
        if body == 'plate':
            motion = Underdamped.of(rig.engine)
            rest = self.value(values, PLATE_ZERO, throw)
            return Trajectory(rest + motion.position(since) + drift, motion.velocity(since))
        scale = self.value(values, 'projectile.scale', throw)
        delay = self.value(values, 'projectile.delay', throw)
        path = self.simulator.follow(rig, since - delay, by_cells=self.by_cells)
        rest = self.value(values, PROJECTILE_ZERO, throw)
        height = rest + scale * (path.position - rig.rest_height) + drift
        return Trajectory(height, scale * path.velocity)

    def _drift(self, throw: int, time: Floats) -> Floats:
        """Return the heights of a drift by the amplitude, none in the middle of a record [m]."""
        plate = self.throws[throw].plate
        share = (time - 0.5 * (plate.time[0] + plate.time[-1])) / plate.duration
        return np.asarray(share * self.rig.engine.amplitude)

    def jacobian(self, values: Floats, only: Sequence[str] | None = None) -> Floats:
        """Return the derivatives of `predict` by all or some parameters."""
        jacobian = np.zeros((self.sample_count, values.size))
        begin = 0
        for series in self.series:
            rows = slice(begin, begin + series.track.time.size)
            begin = rows.stop
            indices = {
                name: throws[series.throw] for name, throws in self.layout.indices.items()
                if series.throw in throws and (not only or name in only)
            }
            for name, slope in self._slopes(values, series, indices).items():
                jacobian[rows, indices[name]] = slope
        return jacobian

    def _slopes(
        self, values: Floats, series: Series, names: Collection[str]
    ) -> dict[str, Floats | float]:
        """Return the derivatives of one track by some parameters, without those that are 0."""
        throw, body, track = series
        rig = self.rig_of(values, throw)
        now = self.trajectory(values, throw, body, track.time)
        slopes: dict[str, Floats | float] = {
            START: -now.velocity, f'{body}.drift': self._drift(throw, track.time)
        }
        if body == 'plate':
            slopes[PLATE_ZERO] = 1.0
        else:
            zero = self.value(values, PROJECTILE_ZERO, throw)
            drift = self.value(values, 'projectile.drift', throw) * slopes['projectile.drift']
            scale = self.value(values, 'projectile.scale', throw)
            slopes |= {
                PROJECTILE_ZERO: 1.0,
                'projectile.delay': -now.velocity,
                'projectile.scale': (now.height - zero - drift) / scale,
            }

        @cache
        def by(name: str) -> Floats:
            value = values_of(rig, [name])[name]
            step = _STEPS.get(name, _STEP * value)
            if value + step > _BOUNDS[name][1]:
                step = -step
            moved = changed_rig(rig, {name: value + step})
            change = self.trajectory(values, throw, body, track.time, moved).height
            return np.asarray((change - now.height) / step)

        for name in names:
            if name in ENGINE or (name in PARAMETERS and body == 'projectile'):
                power = _MASS_POWERS.get(name)
                if power is None:
                    slopes[name] = by(name)
                else:
                    ratio = rig.projectile.mass / values_of(rig, [name])[name]
                    slopes[name] = power * ratio * by('projectile.mass')
        return {name: slope for name, slope in slopes.items() if name in names}

    def start(self, before: Fit | None = None) -> Floats:
        """Return start values, from a fit of fewer or more parameters, `initial` or the plates."""
        values = np.zeros(len(self.layout.names))
        fitted = before.by_name if before else self.initial
        for index, (name, throw) in enumerate(self.layout.values):
            plate, projectile = self.plates[throw or 0], self.throws[throw or 0].projectile
            engine = zip(ENGINE, plate.fit.values[:3].tolist(), strict=True)
            own = {START: plate.start_time, PLATE_ZERO: plate.offset, **dict(engine)}
            if self.layout.names[index] in fitted:
                values[index] = fitted[self.layout.names[index]]
            elif throw is not None and name in own:
                values[index] = own[name]
            elif name in DEFAULTS:
                values[index] = self.description.value(name, self.rig)
            elif projectile is not None:  # its zero is the last value of a throw
                path = self.trajectory(values, throw or 0, 'projectile', projectile.time)
                values[index] = float(np.median(projectile.position - path.height))
        return values

    def fit(
        self,
        start: Floats,
        *,
        max_evaluations: int = _MAX_EVALUATIONS,
        only: Sequence[str] | None = None,
    ) -> Fit:
        """Fit all values, or only some parameters, by `fit_tracks`."""
        names = [name for name, _ in self.layout.values]
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
            model, start[free], self.tracks(), max_evaluations=max_evaluations
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
