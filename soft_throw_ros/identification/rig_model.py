# SPDX-License-Identifier: Apache-2.0
"""A rig and tracks of its throws as a model to fit: one residual over all throws and bodies."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import ejections
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    DEFAULTS,
    ENGINE,
    FitDescription,
    PARAMETERS,
    TERMS,
    values_of,
)
from soft_throw_ros.identification.forward import ProjectilePath, ThrowSimulator
from soft_throw_ros.identification.least_squares import Estimate, Fit, fit_tracks, FitModel
from soft_throw_ros.identification.plate_fit import MAX_DAMPING_RATIO, PlateFit
from soft_throw_ros.identification.plate_modes import Mode, PlateWithModes
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]

START, PLATE_ZERO, PROJECTILE_ZERO = 'start_time', 'plate_offset', 'projectile_offset'
"""What each throw has for itself: when it begins, and the heights of its bodies at rest."""

WAVES = {
    'plate.ringing': ('plate.ringing_cosine', 'plate.ringing_sine'),
    'plate.mode': ('plate.mode_cosine', 'plate.mode_sine'),
}
"""Terms that are waves, each of two parts."""

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
    'projectile.sticking': (0.0, math.inf),
}
_ANYTHING = (-math.inf, math.inf)
_STEP = 3e-4  # relative, for derivatives: large against what steppers leave out ...
_LEAST_STEPS = {'engine.damping_ratio': 3e-5, 'layer.loss_tangent': 3e-4}  # ... and absolute
_RELEASED = 3.0  # plate periods until it is looked whether the projectile left
_WAVE_STEP = 1e-3  # for derivatives, of the plate's amplitude
START_OF_STICKING = 1e-4  # [s]
_JERK_STEP = 1e-2  # of the ejection time, over which the force is seen to vanish


class Channel(NamedTuple):
    """What was seen of one body in one throw, which is counted from 0."""

    throw: int
    body: str
    track: Track


class Path(NamedTuple):
    """
    Height [m] and velocity [m/s] of a body as it is seen.

    `travel` is how far it is from where it rests, and `stuck` how the height changes with the time
    for which the projectile is held. [m], [m/s]
    """

    height: Floats
    velocity: Floats
    travel: Floats
    stuck: Floats


class Nudge(NamedTuple):
    """A parameter that is changed in all throws by a part of its value, or by so much at least."""

    name: str
    part: float
    least: float = 0.0

    def apply(self, value: float) -> float:
        """Change a value within its bounds."""
        low, high = _BOUNDS[self.name]
        step = math.copysign(max(abs(self.part * value), self.least), self.part)
        return min(max(value + step, low), high)


@dataclass(frozen=True)
class RigModel:
    r"""
    What is fitted to what, from the values of `rig` on.

    Notes
    -----
    The values that are fitted stand in a series, see `places`: first those that all throws have in
    common, and then those of one or some of them. Drift, scale, delay, start and zeros change
    heights in ways that are known. Density and diameter matter by :math:`m / (\rho_s S)` alone,
    so their derivatives are those by the mass, and a layer that stiffens has another wave speed.
    The other derivatives are central differences, for which a parameter changes in all throws at
    once.

    """

    throws: tuple[ThrowTracks, ...]
    rig: Rig
    description: FitDescription
    simulator: ThrowSimulator
    found: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    """What was found before of the layers of some throws, to start from."""
    mode: Mode | None = None
    """Frequency and damping of a second mode of the plate."""

    @property
    def by_cells(self) -> bool:
        """Whether only cells can follow a layer, or there may be internal loss."""
        return any(
            rig.layer.needs_cells
            or self.description.treatment('layer.loss_tangent', throw.name).is_varied
            for rig, throw in zip(self.rigs, self.throws, strict=True)
        )

    @cached_property
    def rigs(self) -> list[Rig]:
        """The rig of each throw, as far as it is said or was found before."""
        return [
            changed_rig(self.description.prepare(self.rig, throw.name), self.found.get(number, {}))
            for number, throw in enumerate(self.throws)
        ]

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
    def groups(self) -> dict[tuple[str, Hashable], list[int]]:
        """Throws that have a parameter in common, by its name and by what tells them apart."""
        described, heights = self.description, self.description.heights
        groups: dict[tuple[str, Hashable], list[int]] = {}
        for name in DEFAULTS:
            for number, throw in enumerate(self.throws):
                is_seen = throw.projectile is not None or name.startswith(('engine', 'plate'))
                if is_seen and described.treatment(name, throw.name).is_varied:
                    key = described.group(name, throw.name, number)
                    for part in WAVES.get(name, (name,)):
                        groups.setdefault((part, key), []).append(number)
        own = [START]
        own += [] if heights == 'absolute' else [PLATE_ZERO]
        own += [PROJECTILE_ZERO] if heights == 'own' else []
        for number, throw in enumerate(self.throws):
            for name in own:
                if name != PROJECTILE_ZERO or throw.projectile is not None:
                    groups[name, number] = [number]
        return dict(sorted(groups.items(), key=lambda item: item[0][1] is not None))

    @cached_property
    def places(self) -> dict[str, dict[int, int]]:
        """Where each parameter stands among the values, by throw."""
        places: dict[str, dict[int, int]] = {}
        for place, ((name, _), throws) in enumerate(self.groups.items()):
            places.setdefault(name, {}).update(dict.fromkeys(throws, place))
        return places

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values; of some of several throws, with the number of the first from 1."""
        return tuple(
            name if key is None or len(self.throws) == 1 else f'{name}[{throws[0] + 1}]'
            for (name, key), throws in self.groups.items()
        )

    @cached_property
    def known(self) -> dict[int, Estimate]:
        """What is known with an error, by places."""
        found = {}
        for place, ((part, _), throws) in enumerate(self.groups.items()):
            names = [name for name in DEFAULTS if part in WAVES.get(name, (name,))]
            for name in names:
                known = self.description.known(
                    name, self.rigs[throws[0]], self.throws[throws[0]].name
                )
                if known is not None:
                    found[place] = known
        return found

    def places_of(self, name: str) -> list[int]:
        """Where a parameter stands among the values, of all throws."""
        return sorted(set(self.places[name].values()))

    def value(self, values: Floats, name: str, throw: int) -> float:
        """Look up what is no parameter of the rig, of a throw; 0 if nothing is said of it."""
        place = self.places.get(name, {}).get(throw)
        if place is not None:
            return float(values[place])
        if name in TERMS:
            return self.description.value(name, self.rigs[throw], self.throws[throw].name)
        return 0.0

    def rig_of(self, values: Floats, throw: int | None = None, nudge: Nudge | None = None) -> Rig:
        """
        Make the rig of a throw, with the wave speed that its layer has at this strain.

        By default that of the first throw, with the mean of what each has for itself.
        """
        number = 0 if throw is None else throw
        changes = {
            name: float(values[places[number]])
            for name, places in self.places.items()
            if name in PARAMETERS and number in places
        }
        if throw is None:
            for name in changes:
                if any(isinstance(key, int) for part, key in self.groups if part == name):
                    changes[name] = float(np.mean(values[self.places_of(name)]))
        rig = changed_rig(self.rigs[number], changes)
        if nudge is not None:
            value = values_of(rig, [nudge.name])[nudge.name]
            rig = changed_rig(rig, {nudge.name: nudge.apply(value)})
        stiffening = self.value(values, 'layer.stiffening', number)
        if stiffening:
            low, high = _BOUNDS['layer.wave_speed']
            speed = rig.layer.wave_speed + stiffening * rig.engine.speed_scale
            rig = changed_rig(rig, {'layer.wave_speed': min(max(speed, low), high)})
        return rig

    def nominal(self, values: Floats, name: str, throw: int) -> float:
        """Look up a parameter of the rig of a throw."""
        place = self.places.get(name, {}).get(throw)
        if place is not None:
            return float(values[place])
        return values_of(self.rigs[throw], [name])[name]

    def tracks(self) -> list[tuple[str, Track]]:
        """All tracks with their names."""
        several = len(self.throws) > 1
        return [
            (f'{body} of {self.throws[throw].name}' if several else body, track)
            for throw, body, track in self.channels
        ]

    def predict(self, values: Floats) -> Floats:
        """Heights of all tracks in one series."""
        return np.concatenate([path.height for path in self.paths(values)])

    def speed(self, values: Floats) -> Floats:
        """Speeds of all bodies in one series."""
        return np.asarray(np.abs(np.concatenate([path.velocity for path in self.paths(values)])))

    def paths(
        self,
        values: Floats,
        places: Sequence[tuple[int, str, Floats]] | None = None,
        *,
        nudge: Nudge | None = None,
    ) -> list[Path]:
        """
        Compute what is seen of bodies, or raise FitError if a throw cannot be followed.

        They are those of throws, bodies, and times on the clock of the tracks; by default those
        of all channels. Throws of the same rig are followed together.
        """
        if places is None:
            places = [(throw, body, track.time) for throw, body, track in self.channels]
        found: dict[int, Path] = {}
        alike: dict[tuple[Rig, PlateWithModes, float], list[int]] = {}
        since: dict[int, Floats] = {}
        for number, (throw, body, time) in enumerate(places):
            rig, motion = self._rig_and_motion(values, throw, nudge)
            since[number] = time - self.value(values, START, throw)
            if body == 'plate':
                height = self.value(values, PLATE_ZERO, throw) + motion.position(since[number])
                height += self._drift(values, throw, body, time)
                nothing = np.zeros_like(height)
                found[number] = Path(height, motion.velocity(since[number]), nothing, nothing)
            else:
                since[number] = since[number] - self.value(values, 'projectile.delay', throw)
                sticking = self.value(values, 'projectile.sticking', throw)
                alike.setdefault((rig, motion, sticking), []).append(number)
        for (rig, motion, sticking), numbers in alike.items():
            times = np.concatenate([since[number] for number in numbers])
            ends = np.cumsum([since[number].size for number in numbers])[:-1]
            parts = self._follow(rig, motion, times, sticking)
            pieces = zip(*(np.split(each, ends) for each in parts), strict=True)
            for number, (travel, velocity, stuck) in zip(numbers, pieces, strict=True):
                throw, body, time = places[number]
                scale = self.value(values, 'projectile.scale', throw)
                height = self._projectile_rest(values, throw, rig) + scale * travel
                height += self._drift(values, throw, body, time)
                found[number] = Path(height, scale * velocity, travel, scale * stuck)
        return [found[number] for number in range(len(places))]

    def _rig_and_motion(
        self, values: Floats, throw: int, nudge: Nudge | None
    ) -> tuple[Rig, PlateWithModes]:
        """Make the rig of a throw, and how its plate moves."""
        rig = self.rig_of(values, throw, nudge)
        waves = tuple(self.value(values, part, throw) for pair in WAVES.values() for part in pair)
        return rig, PlateWithModes(Underdamped.of(rig.engine), waves, self.mode)

    def _follow(
        self,
        rig: Rig,
        motion: PlateWithModes,
        since: Floats,
        sticking: float,
    ) -> tuple[Floats, Floats, Floats]:
        """Follow a projectile: travel, velocity, and how the former changes with sticking."""
        sampled = motion.sampled(float(since.min()), float(since.max()))
        follow = partial(self.simulator.follow, rig, motion=sampled, by_cells=self.by_cells)
        path = follow(since)
        travel, velocity = path.position - rest_height(rig), path.velocity
        left = ejections(path.events)
        if not sticking or not left:
            return travel, velocity, np.zeros_like(travel)
        jerk = _jerk(follow, left[-1].time)
        after = np.maximum(since - left[-1].time, 0.0)
        held, free = np.minimum(after, sticking), np.maximum(after - sticking, 0.0)
        travel = travel + jerk * (held**3 / 6.0 + 0.5 * sticking**2 * free)
        velocity = velocity + 0.5 * jerk * held**2
        return travel, velocity, jerk * sticking * free

    def release_shift(self, values: Floats, throw: int) -> tuple[float, float]:
        """How sticking and waves of the plate change time [s] and speed [m/s] of leaving."""
        rig, motion = self._rig_and_motion(values, throw, None)
        sticking = self.value(values, 'projectile.sticking', throw)
        until = np.array([_RELEASED / rig.engine.frequency])
        sampled = motion.sampled(
            self.throws[throw].plate.time[0] - self.value(values, START, throw), until[0]
        )
        follow = partial(self.simulator.follow, rig, by_cells=self.by_cells)
        plain, found = (
            ejections(follow(until).events),
            ejections(follow(until, motion=sampled).events),
        )
        if not plain or not found or not (sticking or sampled):
            return 0.0, 0.0
        pull = 0.0
        if sticking:
            pull = 0.5 * sticking**2 * _jerk(partial(follow, motion=sampled), found[0].time)
        change = found[0].time - plain[0].time, found[0].velocity - plain[0].velocity
        return change[0] + sticking, change[1] + pull

    def _drift(self, values: Floats, throw: int, body: str, time: Floats) -> Floats:
        """Height that drift adds, none at the middle of a record. [m]"""
        plate = self.throws[throw].plate
        part = (time - 0.5 * (plate.time[0] + plate.time[-1])) / plate.duration
        size = self.value(values, f'{body}.drift', throw) * self.rig.engine.amplitude
        return np.asarray(size * part)

    def _projectile_rest(self, values: Floats, throw: int, rig: Rig) -> float:
        """Height of the resting projectile as its track has it. [m]"""
        if self.description.heights == 'own':
            return self.value(values, PROJECTILE_ZERO, throw)
        half = 0.5 * rig.projectile.length if self.description.reference == 'centre' else 0.0
        scale = self.value(values, 'projectile.scale', throw)
        return self.value(values, PLATE_ZERO, throw) + scale * (half + rest_height(rig))

    def jacobian(self, values: Floats) -> Floats:
        """Differentiate `predict`."""
        sizes = [each.track.time.size for each in self.channels]
        rows = np.repeat([each.throw for each in self.channels], sizes)
        paths = self.paths(values)
        jacobian = np.zeros((rows.size, values.size))
        slopes = _Slopes(self, values, paths)
        for name, by_throw in self.places.items():
            slope = slopes.of(name)
            for throw, place in by_throw.items():
                jacobian[rows == throw, place] = slope[rows == throw]
        return jacobian

    def start(self, plates: Sequence[PlateFit]) -> Floats:
        """Find where to start from, given fits of the plates alone."""
        values = np.zeros(len(self.names))
        for name, places in self.places.items():
            for throw, place in places.items():
                if name in PARAMETERS:
                    values[place] = values_of(self.rigs[throw], [name])[name]
                elif name in TERMS:
                    values[place] = self.description.value(name, self.rig, self.throws[throw].name)
        if 'projectile.sticking' in self.places:
            values[self.places_of('projectile.sticking')] = START_OF_STICKING
        for throw, plate in enumerate(plates):
            found = {START: plate.start_time, PLATE_ZERO: plate.offset}
            engine = dict(zip(ENGINE, plate.fit.values[:3].tolist(), strict=True))
            own = {name for name, key in self.groups if key is not None}
            found |= {name: engine[name] for name in ENGINE if name in own}
            for name, value in found.items():
                if name in self.places:
                    values[self.places[name][throw]] = value
        if PROJECTILE_ZERO in self.places:
            paths = self.paths(values)
            for (throw, body, track), path in zip(self.channels, paths, strict=True):
                if body == 'projectile':
                    zero = float(np.median(track.position - path.height))
                    values[self.places[PROJECTILE_ZERO][throw]] = zero
        return values

    def start_from(self, fit: Fit, plates: Sequence[PlateFit]) -> Floats:
        """Start from a fit of fewer, or more, parameters."""
        before = dict(zip(fit.names, fit.values.tolist(), strict=True))
        start = self.start(plates)
        return np.array(
            [before.get(n, v) for n, v in zip(self.names, start.tolist(), strict=True)]
        )

    def fit(
        self, start: Floats, *, noise: Floats | None = None, max_evaluations: int = 100
    ) -> Fit:
        """Fit, or raise FitError if it cannot be done; see `fit_tracks`."""
        low, high = np.full((2, start.size), [[-math.inf], [math.inf]])
        for place, (name, _) in enumerate(self.groups):
            low[place], high[place] = _BOUNDS.get(name, _ANYTHING)
        model = FitModel(
            names=self.names,
            predict=self.predict,
            jacobian=self.jacobian,
            low=low,
            high=high,
            known=self.known,
            speed=self.speed,
        )
        return fit_tracks(
            model, start, self.tracks(), noise=noise, max_evaluations=max_evaluations
        )

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


class _Slopes:
    """Derivatives of the heights of all tracks by parameters, each computed once."""

    def __init__(self, model: RigModel, values: Floats, paths: Sequence[Path]) -> None:
        self._model = model
        self._values = values
        self._paths = paths
        self._sizes = [channel.track.time.size for channel in model.channels]
        self._is_plate = self._spread([channel.body == 'plate' for channel in model.channels])
        self._by_rig: dict[str, Floats] = {}

    def of(self, name: str) -> Floats:
        """Differentiate by a parameter."""
        model, paths, is_plate = self._model, self._paths, self._is_plate
        velocity = np.concatenate([path.velocity for path in paths])
        if name == START:
            return -velocity
        if name == PLATE_ZERO:
            return is_plate if model.description.heights == 'own' else np.ones_like(is_plate)
        if name == PROJECTILE_ZERO:
            return 1.0 - is_plate
        if name == 'projectile.delay':
            return -velocity * (1.0 - is_plate)
        if name == 'projectile.scale':
            return self._of_scale()
        if name == 'projectile.sticking':
            return np.concatenate([path.stuck for path in paths])
        if name.endswith('.drift'):
            return self._of_drift(name)
        if name == 'layer.stiffening':
            return self._of_rig('layer.wave_speed') * self._spread(
                [rig.engine.speed_scale for rig in self._rigs()]
            )
        if name in ('layer.density', 'layer.diameter'):
            power = {'layer.density': -1.0, 'layer.diameter': -2.0}[name]
            return self._of_rig('projectile.mass') * self._spread(
                [
                    power * rig.projectile.mass / values_of(rig, [name])[name]
                    for rig in self._rigs()
                ]
            )
        return self._of_rig(name) if name in PARAMETERS else self._of_wave(name)

    def _rigs(self) -> list[Rig]:
        return [self._model.rig_of(self._values, each.throw) for each in self._model.channels]

    def _spread(self, numbers: Sequence[float]) -> Floats:
        """Repeat a number for each sample of each track."""
        return np.repeat(np.asarray(numbers, dtype=np.float64), self._sizes)

    def _of_rig(self, name: str) -> Floats:
        """Take a central difference of the rigs of all throws."""
        if name not in self._by_rig:
            nudges = [
                Nudge(name, sign * _STEP, _LEAST_STEPS.get(name, 0.0)) for sign in (1.0, -1.0)
            ]
            ahead, behind = (self._model.paths(self._values, nudge=each) for each in nudges)
            change = [up.height - down.height for up, down in zip(ahead, behind, strict=True)]
            widths = []
            for each in self._model.channels:
                value = self._model.nominal(self._values, name, each.throw)
                widths.append(nudges[0].apply(value) - nudges[1].apply(value))
            self._by_rig[name] = np.concatenate(change) / self._spread(widths)
        return self._by_rig[name]

    def _of_wave(self, name: str) -> Floats:
        """Take a central difference by a part of a wave, in all throws at once."""
        change = np.zeros_like(self._values)
        change[self._model.places_of(name)] = _WAVE_STEP
        ahead, behind = (self._model.predict(self._values + sign * change) for sign in (1.0, -1.0))
        return np.asarray((ahead - behind) / (2.0 * _WAVE_STEP))

    def _of_scale(self) -> Floats:
        """Differentiate by the scale of the projectile, about where its heights count from."""
        model = self._model
        travel = np.concatenate([path.travel for path in self._paths])
        if model.description.heights == 'own':
            return travel
        rests = []
        for (_, body, _), rig in zip(model.channels, self._rigs(), strict=True):
            half = 0.5 * rig.projectile.length if model.description.reference == 'centre' else 0.0
            rests.append(0.0 if body == 'plate' else half + rest_height(rig))
        return travel + self._spread(rests)

    def _of_drift(self, name: str) -> Floats:
        """Differentiate by the drift of a body."""
        model = self._model
        values = self._values.copy()
        values[model.places_of(name)] = 1.0
        return np.concatenate(
            [
                model._drift(values, throw, body, track.time)
                if name == f'{body}.drift'
                else np.zeros_like(track.time)
                for throw, body, track in model.channels
            ]
        )


def _jerk(follow: Callable[[Floats], ProjectilePath], release: float) -> float:
    """By how much the acceleration changes in a second where the force vanishes. [m/s3]"""
    # While the layer sticks, the force goes on changing like that
    step = _JERK_STEP * release
    velocity = follow(release - step * np.arange(3.0)).velocity
    return float(velocity[0] - 2.0 * velocity[1] + velocity[2]) / step**2


def rest_height(rig: Rig) -> float:
    """Height of the resting projectile's lower face above the plate. [m]"""
    return rig.layer.thickness - rig.static_sag
