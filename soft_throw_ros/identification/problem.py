# SPDX-License-Identifier: Apache-2.0
"""The comparison of a rig with tracks of its throws, as a problem of least squares."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepping import EventLimitError
from soft_throw_ros.identification.fit import Fit, fit_tracks, FitError, Model
from soft_throw_ros.identification.path import follow
from soft_throw_ros.identification.plate_fit import MOST_DAMPED, motion_slopes, PlateFit
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]

ENGINE = ('engine.frequency', 'engine.damping_ratio', 'engine.amplitude')
LAYER = ('layer.wave_speed', 'layer.thickness', 'layer.loss_tangent')
PARAMETERS = (*ENGINE, *LAYER)
"""What of a rig can be fitted, by the names that the twin has for it."""

USUAL = (*ENGINE, 'layer.wave_speed')
"""What is fitted if nobody says otherwise: who has the layer has measured its thickness."""

Heights = Literal['own', 'common', 'absolute']
"""
From where heights count: each track from a zero of its own; both from the same; or both from the
plate's position at rest.
"""

Reference = Literal['face', 'centre']
"""Point of the projectile whose heights a track has: its lower face, or its centre."""

_BOUNDS: Mapping[str, tuple[float, float]] = {
    'engine.frequency': (1e-6, math.inf),
    'engine.damping_ratio': (0.0, MOST_DAMPED),
    'engine.amplitude': (1e-12, math.inf),
    'layer.wave_speed': (0.5, 300.0),
    'layer.thickness': (1e-4, 0.5),
    'layer.loss_tangent': (0.0, 2.0),
}
_STEP = 3e-4  # of a parameter, relative, for derivatives; and at least ...
_LEAST_STEP = {'engine.damping_ratio': 3e-5, 'layer.loss_tangent': 3e-4}


@dataclass(frozen=True)
class Problem:
    """
    What is fitted to what.

    Parameters
    ----------
    throws : tuple of ThrowTracks
    rig : Rig
        What is known, and where to start.
    free : tuple of str
        Some of `PARAMETERS`, in their order.
    heights : {'own', 'common', 'absolute'}
    reference : {'face', 'centre'}

    Notes
    -----
    Values that are fitted stand in a series: those of `free`, then those of each throw, see
    `place`. Derivatives by the start and by heights at rest are velocities and 1, those of the
    plate are in `plate_fit`; the others are central differences, whose step is large against
    what the stepper leaves out and small against all that matters.

    """

    throws: tuple[ThrowTracks, ...]
    rig: Rig
    free: tuple[str, ...]
    heights: Heights
    reference: Reference

    @property
    def by_grid(self) -> bool:
        """Whether there is internal loss, or may be."""
        return 'layer.loss_tangent' in self.free or self.rig.layer.loss_tangent > 0.0

    @property
    def projectiles(self) -> list[tuple[int, Track]]:
        """Tracks of projectiles, with the numbers of their throws from 0."""
        return [
            (number, throw.projectile)
            for number, throw in enumerate(self.throws)
            if throw.projectile is not None
        ]

    @cached_property
    def place(self) -> dict[str, int]:
        """Where each parameter stands among the values."""
        names = list(self.free)
        for number, throw in enumerate(self.throws):
            names.append(self.local('start_time', number))
            if self.heights != 'absolute':
                names.append(self.local('plate_offset', number))
            if self.heights == 'own' and throw.projectile is not None:
                names.append(self.local('projectile_offset', number))
        return {name: place for place, name in enumerate(names)}

    def local(self, name: str, number: int) -> str:
        """Name a parameter of one throw."""
        return f'{name}[{number + 1}]' if len(self.throws) > 1 else name

    def value(self, values: Floats, name: str, number: int) -> float:
        """Look up a parameter of one throw; a height at rest that is not free is 0."""
        place = self.place.get(self.local(name, number))
        return 0.0 if place is None else float(values[place])

    def rig_of(self, values: Floats) -> Rig:
        """Make the rig."""
        return changed_rig(self.rig, dict(zip(self.free, values.tolist(), strict=False)))

    def tracks(self) -> list[tuple[str, Track]]:
        """All tracks with their names: the plates, then the projectiles."""
        several = len(self.throws) > 1
        plates = [(number, throw.plate) for number, throw in enumerate(self.throws)]
        return [
            (f'{body} of {self.throws[number].name}' if several else body, track)
            for body, tracks in (('plate', plates), ('projectile', self.projectiles))
            for number, track in tracks
        ]

    def sizes(self) -> list[int]:
        """How many samples each track has."""
        return [track.time.size for _, track in self.tracks()]

    def plate(self, values: Floats, number: int, time: Floats) -> Floats:
        """Heights of a plate, at times on the clock of its track."""
        motion = Underdamped.of(self.rig_of(values).engine)
        since = time - self.value(values, 'start_time', number)
        return self.value(values, 'plate_offset', number) + motion.position(since)

    def zero(self, values: Floats, number: int, rig: Rig) -> float:
        """Height of the tracked point of a projectile, less that of its face above the plate."""
        if self.heights == 'own':
            return self.value(values, 'projectile_offset', number) - rest_height(rig)
        half = 0.5 * rig.projectile.length if self.reference == 'centre' else 0.0
        return self.value(values, 'plate_offset', number) + half

    def projectile_path(self, values: Floats) -> tuple[Floats, Floats]:
        """Heights and velocities of all projectiles."""
        rig = self.rig_of(values)
        since = [
            track.time - self.value(values, 'start_time', number)
            for number, track in self.projectiles
        ]
        try:
            path = follow(rig, np.concatenate(since), by_grid=self.by_grid)
        except (ValueError, EventLimitError) as error:
            raise FitError(f'the throw cannot be followed: {error}') from None
        zeros = [
            np.full(track.time.size, self.zero(values, number, rig))
            for number, track in self.projectiles
        ]
        return path.position + np.concatenate(zeros), path.velocity

    def predict(self, values: Floats) -> Floats:
        """Heights of all tracks in one series."""
        parts = [
            self.plate(values, number, throw.plate.time)
            for number, throw in enumerate(self.throws)
        ]
        if self.projectiles:
            parts.append(self.projectile_path(values)[0])
        return np.concatenate(parts)

    def slopes(self, values: Floats) -> Floats:
        """Differentiate `predict`, by differences where there is no formula."""
        rows = self.sizes()
        ends = np.cumsum(rows)
        slopes = np.zeros((ends[-1], len(self.place)))
        motion = Underdamped.of(self.rig_of(values).engine)
        for number, throw in enumerate(self.throws):
            since = throw.plate.time - self.value(values, 'start_time', number)
            part = slopes[ends[number] - rows[number] : ends[number]]
            for name, column in zip(ENGINE, motion_slopes(motion, since), strict=True):
                if name in self.place:
                    part[:, self.place[name]] = column
            self._add_local(part, number, motion.velocity(since), 'plate_offset')
        if self.projectiles:
            first = int(ends[len(self.throws) - 1])
            for name in self.free:
                low, high = self._beside(values, name)
                change = self.projectile_path(high)[0] - self.projectile_path(low)[0]
                step = high[self.place[name]] - low[self.place[name]]
                slopes[first:, self.place[name]] = change / step
            offset = 'projectile_offset' if self.heights == 'own' else 'plate_offset'
            sizes = [track.time.size for _, track in self.projectiles]
            velocities = np.split(self.projectile_path(values)[1], np.cumsum(sizes)[:-1])
            parts = np.split(slopes[first:], np.cumsum(sizes)[:-1])
            for (number, _), part, velocity in zip(
                self.projectiles, parts, velocities, strict=True
            ):
                self._add_local(part, number, velocity, offset)
        return slopes

    def _add_local(self, slopes: Floats, number: int, velocity: Floats, offset: str) -> None:
        """Write the derivatives of one track by the parameters of its throw."""
        slopes[:, self.place[self.local('start_time', number)]] = -velocity
        if self.local(offset, number) in self.place:
            slopes[:, self.place[self.local(offset, number)]] = 1.0

    def _beside(self, values: Floats, name: str) -> tuple[Floats, Floats]:
        """Return values a little below and above, within the bounds."""
        place = self.place[name]
        step = max(_STEP * abs(values[place]), _LEAST_STEP.get(name, 0.0))
        low, high = values.copy(), values.copy()
        low[place] = max(values[place] - step, _BOUNDS[name][0])
        high[place] = min(values[place] + step, _BOUNDS[name][1])
        return low, high

    def start(self, plates: Sequence[PlateFit]) -> Floats:
        """Find where to start from, given fits of the plates alone."""
        values = np.zeros(len(self.place))
        for name, value in values_of(self.rig, self.free).items():
            values[self.place[name]] = value
        for number, plate in enumerate(plates):
            for name, value in (('start_time', plate.start_time), ('plate_offset', plate.offset)):
                if self.local(name, number) in self.place:
                    values[self.place[self.local(name, number)]] = value
        if self.heights == 'own' and self.projectiles:
            left = np.concatenate([track.position for _, track in self.projectiles])
            left = left - self.projectile_path(values)[0]
            sizes = [track.time.size for _, track in self.projectiles]
            for (number, _), part in zip(
                self.projectiles, np.split(left, np.cumsum(sizes)[:-1]), strict=True
            ):
                values[self.place[self.local('projectile_offset', number)]] = np.median(part)
        return values

    def fit(self, start: Floats) -> Fit:
        """Fit."""
        bounds = [_BOUNDS.get(name, (-math.inf, math.inf)) for name in self.place]
        low, high = np.array(bounds).T
        model = Model(tuple(self.place), self.predict, self.slopes, low, high)
        return fit_tracks(model, start, self.tracks())

    def cut(self, plates: Sequence[PlateFit], after: float) -> Problem:
        """Leave out what the projectiles do later than so long after the start."""
        throws = []
        for throw, plate in zip(self.throws, plates, strict=True):
            projectile = throw.projectile
            if projectile is not None:
                end = plate.start_time + after
                seen = int((projectile.time <= end).sum())
                projectile = projectile.between(-math.inf, end) if seen >= FEWEST else None
            throws.append(replace(throw, projectile=projectile))
        return replace(self, throws=tuple(throws))


def rest_height(rig: Rig) -> float:
    """Height of the resting projectile's lower face above the plate. [m]"""
    return rig.layer.thickness - rig.static_sag


def values_of(rig: Rig, names: Iterable[str]) -> dict[str, float]:
    """Look up some of `PARAMETERS`."""
    values = {}
    for name in names:
        part, _, field = name.partition('.')
        values[name] = float(getattr(getattr(rig, part), field))
    return values


def changed_rig(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Make another rig of one, with some of `PARAMETERS` changed."""
    parts = {}
    for part in ('engine', 'layer'):
        fields = {
            name.partition('.')[2]: value
            for name, value in values.items()
            if name.startswith(f'{part}.')
        }
        parts[part] = replace(getattr(rig, part), **fields)
    return replace(rig, **parts)
