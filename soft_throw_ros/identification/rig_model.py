# SPDX-License-Identifier: Apache-2.0
"""A rig and tracks of its throws as a model to fit: one residual over all throws and bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    ENGINE,
    FitDescription,
    values_of,
)
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.least_squares import (
    central_difference,
    Estimate,
    Fit,
    fit_tracks,
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
_STEP = 3e-4  # relative, for derivatives: large against what steppers leave out ...
_LEAST_STEPS = {'engine.damping_ratio': 3e-5, 'layer.loss_tangent': 3e-4}  # ... and absolute
_START, _PLATE_ZERO, _PROJECTILE_ZERO = 'start_time', 'plate_offset', 'projectile_offset'


class Channel(NamedTuple):
    """What was seen of one body in one throw, which is counted from 0."""

    throw: int
    body: str
    track: Track


@dataclass(frozen=True)
class RigModel:
    """
    What is fitted to what, from the values of `rig` on.

    Notes
    -----
    The values that are fitted stand in a series, see `places`: those of the rig, and then those
    of each throw: when it starts, the heights from which its tracks count, and whatever of the
    rig each throw has for itself. Derivatives by start and heights are velocities and 1; the
    others are central differences, for which a value that each throw has for itself changes in
    all throws at once.

    """

    throws: tuple[ThrowTracks, ...]
    rig: Rig
    description: FitDescription
    known: Mapping[str, Estimate]
    simulator: ThrowSimulator

    @property
    def by_cells(self) -> bool:
        """Whether there is internal loss, or may be."""
        loss = self.description.treatments['layer.loss_tangent']
        return loss.is_varied or self.rig.layer.loss_tangent > 0.0

    @cached_property
    def channels(self) -> list[Channel]:
        """All tracks, throw by throw."""
        return [
            Channel(number, body, track)
            for number, throw in enumerate(self.throws)
            for body, track in (('plate', throw.plate), ('projectile', throw.projectile))
            if track is not None
        ]

    @property
    def projectiles(self) -> list[Channel]:
        """Tracks of projectiles alone."""
        return [channel for channel in self.channels if channel.body == 'projectile']

    @cached_property
    def places(self) -> dict[str, dict[int | None, int]]:
        """Where each parameter stands among the values: by throw, or once, by None."""
        per_throw = self.description.per_throw
        shared = [name for name in self.description.varied if name not in per_throw]
        places: dict[str, dict[int | None, int]] = {
            name: {None: place} for place, name in enumerate(shared)
        }
        own = [*per_throw, _START]
        own += [] if self.description.heights == 'absolute' else [_PLATE_ZERO]
        own += [_PROJECTILE_ZERO] if self.description.heights == 'own' else []
        count = len(places)
        for number, throw in enumerate(self.throws):
            for name in own:
                if name != _PROJECTILE_ZERO or throw.projectile is not None:
                    places.setdefault(name, {})[number] = count
                    count += 1
        return places

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values; of several throws each has its number from 1 in brackets."""
        named = {
            place: name if throw is None or len(self.throws) == 1 else f'{name}[{throw + 1}]'
            for name, places in self.places.items()
            for throw, place in places.items()
        }
        return tuple(named[place] for place in sorted(named))

    def places_of(self, name: str) -> list[int]:
        """Where a parameter stands among the values, of all throws."""
        return list(self.places[name].values())

    def value(self, values: Floats, name: str, throw: int) -> float:
        """Look up a parameter of a throw; a height from which none counts is 0."""
        places = self.places.get(name, {})
        place = places.get(throw, places.get(None))
        return 0.0 if place is None else float(values[place])

    def rig_of(self, values: Floats, throw: int | None = None) -> Rig:
        """Make the rig of a throw; by default with the mean of what each has for itself."""
        changes = {}
        for name in self.description.varied:
            mean = float(np.mean(values[self.places_of(name)]))
            changes[name] = mean if throw is None else self.value(values, name, throw)
        return changed_rig(self.rig, changes)

    def tracks(self) -> list[tuple[str, Track]]:
        """All tracks with their names."""
        several = len(self.throws) > 1
        return [
            (f'{body} of {self.throws[throw].name}' if several else body, track)
            for throw, body, track in self.channels
        ]

    def predict(self, values: Floats) -> Floats:
        """Heights of all tracks in one series."""
        return np.concatenate([heights for heights, _ in self.paths(values)])

    def paths(
        self, values: Floats, places: Sequence[tuple[int, str, Floats]] | None = None
    ) -> list[tuple[Floats, Floats]]:
        """
        Compute heights [m] and velocities [m/s], or raise FitError if a throw cannot be followed.

        They are those of throws, bodies, and times on the clock of the tracks; by default those
        of all channels. Throws of the same rig are followed together.
        """
        if places is None:
            places = [(throw, body, track.time) for throw, body, track in self.channels]
        since = [time - self.value(values, _START, throw) for throw, _, time in places]
        found: dict[int, tuple[Floats, Floats]] = {}
        alike: dict[Rig, list[int]] = {}
        for number, (throw, body, _) in enumerate(places):
            rig = self.rig_of(values, throw)
            if body == 'plate':
                motion = Underdamped.of(rig.engine)
                height = self.value(values, _PLATE_ZERO, throw) + motion.position(since[number])
                found[number] = height, motion.velocity(since[number])
            else:
                alike.setdefault(rig, []).append(number)
        for rig, numbers in alike.items():
            times = np.concatenate([since[number] for number in numbers])
            path = self.simulator.follow(rig, times, by_cells=self.by_cells)
            ends = np.cumsum([since[number].size for number in numbers])[:-1]
            parts = np.split(path.position, ends), np.split(path.velocity, ends)
            for number, position, velocity in zip(numbers, *parts, strict=True):
                zero = self._projectile_zero(values, places[number][0], rig)
                found[number] = zero + position, velocity
        return [found[number] for number in range(len(places))]

    def _projectile_zero(self, values: Floats, throw: int, rig: Rig) -> float:
        """Height that the track of a projectile has where that of its face is 0."""
        if self.description.heights == 'own':
            return self.value(values, _PROJECTILE_ZERO, throw) - rest_height(rig)
        half = 0.5 * rig.projectile.length if self.description.reference == 'centre' else 0.0
        return self.value(values, _PLATE_ZERO, throw) + half

    def jacobian(self, values: Floats) -> Floats:
        """Differentiate `predict`."""
        sizes = [each.track.time.size for each in self.channels]
        rows = np.repeat([each.throw for each in self.channels], sizes)
        is_plate = np.repeat([each.body == 'plate' for each in self.channels], sizes)
        velocity = np.concatenate([velocities for _, velocities in self.paths(values)])
        jacobian = np.zeros((rows.size, values.size))
        for name, by_throw in self.places.items():
            places = self.places_of(name)
            widths = np.ones(len(places))
            if name == _START:
                change = -velocity
            elif name == _PLATE_ZERO:
                change = (is_plate | (self.description.heights != 'own')).astype(np.float64)
            elif name == _PROJECTILE_ZERO:
                change = (~is_plate).astype(np.float64)
            else:
                low, high = _BOUNDS[name]
                step = max(
                    _STEP * float(np.abs(values[places]).max()), _LEAST_STEPS.get(name, 0.0)
                )
                change, widths = central_difference(
                    self.predict, values, places, step=step, low=low, high=high
                )
            for (throw, place), width in zip(by_throw.items(), widths, strict=True):
                inside = slice(None) if throw is None else rows == throw
                jacobian[inside, place] = change[inside] / width
        return jacobian

    def start(self, plates: Sequence[PlateFit]) -> Floats:
        """Find where to start from, given fits of the plates alone."""
        values = np.zeros(len(self.names))
        for name, value in values_of(self.rig, self.description.varied).items():
            values[self.places_of(name)] = value
        for throw, plate in enumerate(plates):
            found = {_START: plate.start_time, _PLATE_ZERO: plate.offset}
            engine = dict(zip(ENGINE, plate.fit.values[:3].tolist(), strict=True))
            found |= {name: engine[name] for name in ENGINE if name in self.description.per_throw}
            for name, value in found.items():
                if name in self.places:
                    values[self.places[name][throw]] = value
        if _PROJECTILE_ZERO in self.places:
            paths = self.paths(values)
            for (throw, body, track), (heights, _) in zip(self.channels, paths, strict=True):
                if body == 'projectile':
                    zero = float(np.median(track.position - heights))
                    values[self.places[_PROJECTILE_ZERO][throw]] = zero
        return values

    def fit(self, start: Floats, *, max_evaluations: int = 100) -> Fit:
        """Fit, or raise FitError if it cannot be done."""
        low, high = np.full((2, start.size), [[-math.inf], [math.inf]])
        for name in self.description.varied:
            places = self.places_of(name)
            low[places], high[places] = _BOUNDS[name]
        model = FitModel(
            names=self.names,
            predict=self.predict,
            jacobian=self.jacobian,
            low=low,
            high=high,
            known={
                place: estimate
                for name, estimate in self.known.items()
                for place in self.places_of(name)
            },
        )
        return fit_tracks(model, start, self.tracks(), max_evaluations=max_evaluations)

    def cut(self, plates: Sequence[PlateFit], after: float) -> RigModel:
        """Leave out what the projectiles do later than so long after the start. [s]"""
        throws = []
        for throw, plate in zip(self.throws, plates, strict=True):
            projectile = throw.projectile
            if projectile is not None:
                end = plate.start_time + after
                is_seen = int((projectile.time <= end).sum()) >= FEWEST
                projectile = projectile.between(-math.inf, end) if is_seen else None
            throws.append(replace(throw, projectile=projectile))
        return replace(self, throws=tuple(throws))


def rest_height(rig: Rig) -> float:
    """Height of the resting projectile's lower face above the plate. [m]"""
    return rig.layer.thickness - rig.static_sag
