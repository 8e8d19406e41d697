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
"""A rig and tracks of its throws as a model to fit: one residual over all throws and bodies."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event
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
from soft_throw_ros.identification.forward import MAX_COST, ProjectilePath, ThrowSimulator
from soft_throw_ros.identification.least_squares import (
    Estimate,
    Fit,
    fit_tracks,
    FitError,
    FitModel,
)
from soft_throw_ros.identification.plate_fit import MAX_DAMPING_RATIO, PlateFit
from soft_throw_ros.identification.plate_modes import Mode, PlateWithModes
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

START, PLATE_ZERO, PROJECTILE_ZERO = 'start_time', 'plate_offset', 'projectile_offset'
OWN = (START, PLATE_ZERO, PROJECTILE_ZERO)
"""What each throw has for itself: when it begins, and the heights of its bodies at rest."""

STICKING = 'projectile.sticking'
"""For how long the layer holds the projectile when it would leave."""

PLATE_MODE = 'plate.mode'
"""A second mode of the plate."""

WAVES = {
    'plate.ringing': ('plate.ringing_cosine', 'plate.ringing_sine'),
    PLATE_MODE: ('plate.mode_cosine', 'plate.mode_sine'),
}
"""Terms that are waves, and their amplitudes."""

_TERM_OF = {part: name for name, parts in WAVES.items() for part in parts}

MODE = ('plate.mode_frequency', 'plate.mode_damping_ratio')
"""What is fitted with a second mode beside its amplitudes, and is the same in all throws."""

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
    STICKING: (0.0, math.inf),
    MODE[0]: (1e-3, math.inf),
    MODE[1]: (1e-4, 0.5),
}
_ANYTHING = (-math.inf, math.inf)
_STEP = 3e-4  # relative, for derivatives: large against what steppers leave out; or ...
_STEPS = {  # absolute
    'engine.damping_ratio': 3e-5,
    'layer.loss_tangent': 3e-4,
    'layer.stiffening': 2e-2,
    **dict.fromkeys((STICKING, PLATE_ZERO, PROJECTILE_ZERO), 1e-5),
    **dict.fromkeys(('plate.drift', 'projectile.drift', 'projectile.scale'), 1e-3),
    **dict.fromkeys((*_TERM_OF, MODE[1]), 1e-3),
}
_MOVING = {*PARAMETERS, 'layer.stiffening', *_TERM_OF, *MODE}
"""What another value of makes another throw, which has to be followed."""

_MODE_ERROR = 0.05  # of the frequency, relative, and the damping of a mode that is seen
_UNSEEN = 1e30  # error in SI units of what is not seen at all
_EVALUATIONS = 60  # of the model, in one run of the solver, unless ...
_SHARE_OF_FIT = 0.3  # of all effort goes into it; but there are ...
_FEWEST_EVALUATIONS = 8
_RELEASED = 3.0  # plate periods until it is looked whether the projectile left
START_OF_STICKING = 1e-4  # [s]
_TRIED = 400  # moments of that
_JERK_STEP = 0.05  # of the ejection time, over which the force is seen to vanish, at least


class Channel(NamedTuple):
    """What was seen of one body in one throw, which is counted from 0."""

    throw: int
    body: str
    track: Track


class Path(NamedTuple):
    """Height [m] and velocity [m/s] of a body as it is seen."""

    height: Floats
    velocity: Floats


class ReleaseShift(NamedTuple):
    """How waves of the plate change the release, and what a layer does that sticks."""

    time: float
    """[s]"""
    speed: float
    """[m/s]"""
    jerk: float
    """By how much the acceleration changes in a second in which the layer sticks. [m/s3]"""


@dataclass(frozen=True)
class RigModel:
    r"""
    What is fitted to what, from the values of `rig` on.

    Notes
    -----
    The values that are fitted stand in a series, see `places`: first those that all throws have in
    common, and then those of one or some of them. Derivatives are central differences, for which
    a parameter changes in all throws at once; where only what is seen of a throw changes, and not
    the throw, it is not followed again.

    """

    throws: tuple[ThrowTracks, ...]
    rig: Rig
    description: FitDescription
    simulator: ThrowSimulator
    found: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    """What was found before of the layers of some throws, to start from."""
    mode: Mode | None = None
    """Frequency and damping of a second mode of the plate."""
    likely_modes: tuple[Mode, ...] = ()
    """Second modes that the plate may have, by its own track."""

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
        """Return the rig of each throw, as far as it is said or was found before."""
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
    def rows(self) -> Integers:
        """Return the throw of each sample of all tracks."""
        sizes = [each.track.time.size for each in self.channels]
        return np.repeat([each.throw for each in self.channels], sizes)

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
                    for part in MODE if name == PLATE_MODE else ():
                        groups.setdefault((part, None), []).append(number)
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
        """Return what is known with an error, by places."""
        found: dict[int, Estimate | None] = {}
        for place, ((part, _), (throw, *_)) in enumerate(self.groups.items()):
            name = _TERM_OF.get(part, part)
            if name in DEFAULTS:
                found[place] = self.description.known(
                    name, self.rigs[throw], self.throws[throw].name
                )
            elif self.mode is not None and part == MODE[0]:
                found[place] = Estimate(self.mode.frequency, _MODE_ERROR * self.mode.frequency)
            elif self.mode is not None and part == MODE[1]:
                found[place] = Estimate(self.mode.damping_ratio, _MODE_ERROR)
        return {place: known for place, known in found.items() if known is not None}

    def places_of(self, name: str) -> list[int]:
        """Where a parameter stands among the values, of all throws."""
        return sorted(set(self.places[name].values()))

    def is_per_throw(self, name: str) -> bool:
        """Whether each throw has its own."""
        return any(isinstance(key, int) for part, key in self.groups if part == name)

    def value(self, values: Floats, name: str, throw: int) -> float:
        """Look up what is no parameter of the rig, of a throw; 0 if nothing is said of it."""
        place = self.places.get(name, {}).get(throw)
        if place is not None:
            return float(values[place])
        if name in TERMS:
            return self.description.value(name, self.rigs[throw], self.throws[throw].name)
        return 0.0

    def rig_of(self, values: Floats, throw: int | None = None) -> Rig:
        """
        Make the rig of a throw, with the wave speed that its layer has at this strain.

        By default that of the first throw, with the mean of what each has for itself.
        """
        number = 0 if throw is None else throw
        changes = {}
        for name, places in self.places.items():
            if name in PARAMETERS and number in places:
                is_mean = throw is None and self.is_per_throw(name)
                of_all = self.places_of(name) if is_mean else [places[number]]
                changes[name] = float(np.mean(values[of_all]))
        rig = changed_rig(self.rigs[number], changes)
        stiffening = self.value(values, 'layer.stiffening', number)
        if stiffening:
            low, high = _BOUNDS['layer.wave_speed']
            speed = rig.layer.wave_speed + stiffening * rig.engine.speed_scale
            rig = changed_rig(rig, {'layer.wave_speed': min(max(speed, low), high)})
        return rig

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
        self, values: Floats, places: Sequence[tuple[int, str, Floats]] | None = None
    ) -> list[Path]:
        """
        Compute what is seen of bodies, or raise FitError if a throw cannot be followed.

        They are those of throws, bodies, and times on the clock of the tracks; by default those
        of all channels.
        """
        if places is None:
            places = [(throw, body, track.time) for throw, body, track in self.channels]
        found = []
        for throw, body, time in places:
            rig, motion = self.motion(values, throw)
            since = time - self.value(values, START, throw)
            if body == 'plate':
                rest, scale = self.value(values, PLATE_ZERO, throw), 1.0
                travel, velocity = motion.position(since), motion.velocity(since)
            else:
                rest = self._projectile_rest(values, throw, rig)
                scale = self.value(values, 'projectile.scale', throw)
                since = since - self.value(values, 'projectile.delay', throw)
                path = self.simulator.follow(rig, since, motion=motion, by_cells=self.by_cells)
                sticking = self.value(values, STICKING, throw)
                travel, velocity = _travel(path, rig, since, sticking)
            height = rest + scale * travel + self.drift(values, throw, body, time)
            found.append(Path(height, scale * velocity))
        return found

    def wave_places(self, throw: int) -> list[int]:
        """Tell where waves of the plate of a throw stand among the values."""
        parts = [part for part in (*_TERM_OF, *MODE) if throw in self.places.get(part, ())]
        return [self.places[part][throw] for part in parts]

    def motion(self, values: Floats, throw: int) -> tuple[Rig, PlateWithModes]:
        """Make the rig of a throw, and how its plate moves."""
        rig = self.rig_of(values, throw)
        waves = tuple(self.value(values, part, throw) for pair in WAVES.values() for part in pair)
        mode = self.mode
        if mode is not None and MODE[0] in self.places:
            mode = Mode(*(self.value(values, part, throw) for part in MODE))
        return rig, PlateWithModes(Underdamped.of(rig.engine), waves, mode)

    def drift(self, values: Floats, throw: int, body: str, time: Floats) -> Floats:
        """Height that drift adds, none at the middle of a record [m]."""
        plate = self.throws[throw].plate
        part = (time - 0.5 * (plate.time[0] + plate.time[-1])) / plate.duration
        size = self.value(values, f'{body}.drift', throw) * self.rig.engine.amplitude
        return np.asarray(size * part)

    def _projectile_rest(self, values: Floats, throw: int, rig: Rig) -> float:
        """Height of the resting projectile as its track has it [m]."""
        if self.description.heights == 'own':
            return self.value(values, PROJECTILE_ZERO, throw)
        half = 0.5 * rig.projectile.length if self.description.reference == 'centre' else 0.0
        scale = self.value(values, 'projectile.scale', throw)
        return self.value(values, PLATE_ZERO, throw) + scale * (half + rest_height(rig))

    def jacobian(self, values: Floats, only: Sequence[str] | None = None) -> Floats:
        """Differentiate `predict` by all parameters, or some of them."""
        rows = self.rows
        sizes = [each.track.time.size for each in self.channels]
        is_plate = np.repeat([each.body == 'plate' for each in self.channels], sizes)
        velocity = np.concatenate([path.velocity for path in self.paths(values)])
        jacobian = np.zeros((rows.size, values.size))
        for name, by_throw in self.places.items():
            if only and name not in only:
                continue
            if name in (START, 'projectile.delay'):
                slope = -velocity * (1.0 if name == START else ~is_plate)
            else:
                slope = self._slope(values, name)
            for throw, place in by_throw.items():
                jacobian[rows == throw, place] = slope[rows == throw]
        return jacobian

    def _slope(self, values: Floats, name: str) -> Floats:
        """Take a central difference by a parameter, which changes in all throws."""
        places = self.places_of(name)
        low, high = _BOUNDS.get(name, _ANYTHING)
        ends = []
        for sign in (1.0, -1.0):
            moved = values.copy()
            step = _STEPS.get(name, 0.0) or _STEP * np.abs(values[places])
            moved[places] = np.clip(values[places] + sign * step, low, high)
            ends.append(moved)
        width = np.ones(len(self.throws))
        for throw, place in self.places[name].items():
            width[throw] = ends[0][place] - ends[1][place]
        return np.asarray((self.predict(ends[0]) - self.predict(ends[1])) / width[self.rows])

    def start(self, plates: Sequence[PlateFit]) -> Floats:
        """Find where to start from, given fits of the plates alone."""
        values = np.zeros(len(self.names))
        for name, places in self.places.items():
            for throw, place in places.items():
                if name in PARAMETERS:
                    values[place] = values_of(self.rigs[throw], [name])[name]
                elif name in TERMS:
                    values[place] = self.description.value(name, self.rig, self.throws[throw].name)
                elif name in MODE and self.mode is not None:
                    values[place] = self.mode[MODE.index(name)]
        if STICKING in self.places:
            values[self.places_of(STICKING)] = START_OF_STICKING
        for throw, plate in enumerate(plates):
            engine = zip(ENGINE, plate.fit.values[:3].tolist(), strict=True)
            found = {START: plate.start_time, PLATE_ZERO: plate.offset, **dict(engine)}
            for (name, key), throws in self.groups.items():
                if key is not None and throw in throws and name in found:
                    values[self.places[name][throw]] = found[name]
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

    def without_faults(self, values: Floats) -> Floats:
        """Put what a bench may add back to what is known of it, lest a fit go astray with that."""
        start: Floats = values.copy()
        for place, known in self.known.items():
            if not self.names[place].startswith('plate'):  # as the plates alone have it
                start[place] = known.value
        return start

    def fit(
        self,
        start: Floats,
        *,
        noise: Floats | None = None,
        max_evaluations: int = _EVALUATIONS,
        only: Sequence[str] | None = None,
    ) -> Fit:
        """Fit, or raise FitError if it cannot be done; see `fit_tracks`. `only` some may vary."""
        names = [name for name, _ in self.groups]
        free = [place for place, name in enumerate(names) if not only or name in only]
        low, high = np.transpose([_BOUNDS.get(names[place], _ANYTHING) for place in free])

        def whole(values: Floats) -> Floats:
            full: Floats = start.copy()
            full[free] = values
            return full

        model = FitModel(
            names=tuple(self.names[place] for place in free),
            predict=lambda values: self.predict(whole(values)),
            jacobian=lambda values: self.jacobian(whole(values), only)[:, free],
            low=low,
            high=high,
            known={k: self.known[place] for k, place in enumerate(free) if place in self.known},
            speed=lambda values: self.speed(whole(values)),
        )
        found = fit_tracks(
            model,
            start[free],
            self.tracks(),
            noise=noise,
            max_evaluations=min(
                max_evaluations,
                self._affordable(start, 1 + 2 * sum(names[place] in _MOVING for place in free)),
            ),
        )
        unseen = np.flatnonzero(~(found.errors < _UNSEEN))
        if unseen.size:
            raise FitError(
                f'these tracks say nothing of {", ".join(found.names[place] for place in unseen)}'
            )
        return found

    def _affordable(self, values: Floats, paths: int) -> int:
        """Tell how many evaluations of so many paths may be made."""
        before = self.simulator.cost
        self.predict(values)
        cost = (self.simulator.cost - before) * paths
        share = _SHARE_OF_FIT * MAX_COST * len(self.throws)
        return max(_FEWEST_EVALUATIONS, int(share / max(cost, 1e-9)))


def cut_after(model: RigModel, plates: Sequence[PlateFit], after: float) -> RigModel:
    """Leave out what the projectiles do later than so long after the start [s]."""
    throws = []
    for throw, plate in zip(model.throws, plates, strict=True):
        projectile = throw.projectile
        if projectile is not None:
            end = plate.start_time + after
            is_seen = int((projectile.time <= end).sum()) >= FEWEST
            projectile = projectile.between(-math.inf, end) if is_seen else None
        throws.append(replace(throw, projectile=projectile))
    return replace(model, throws=tuple(throws))


def _travel(
    path: ProjectilePath, rig: Rig, since: Floats, sticking: float
) -> tuple[Floats, Floats]:
    """Compute how far a projectile is from where it rests, and its velocity, if it is held."""
    travel, velocity = path.position - rest_height(rig), path.velocity
    left = ejections(path.events)
    if not sticking or not left:
        return travel, velocity
    jerk = _jerk(since, velocity, left[-1], rig.gravity)
    after = np.maximum(since - left[-1].time, 0.0)
    held, free = np.minimum(after, sticking), np.maximum(after - sticking, 0.0)
    travel = travel + jerk * (held**3 / 6.0 + 0.5 * sticking**2 * free)
    return travel, velocity + 0.5 * jerk * held**2


def shift_of_release(model: RigModel, values: Floats, throw: int) -> ReleaseShift:
    """How waves of the plate change time and speed of leaving, and what sticking would."""
    rig, motion = model.motion(values, throw)
    time = np.linspace(0.0, _RELEASED / rig.engine.frequency, _TRIED)
    follow = partial(model.simulator.follow, rig, time, by_cells=model.by_cells)
    path = follow(motion=motion)
    plain = ejections(follow().events)
    # Waves of the plate may let go of the projectile for a moment, long before it is thrown
    found = [event for event in path.events if event.kind == 'release']
    if not plain or not found:
        return ReleaseShift(0.0, 0.0, 0.0)
    release = min(found, key=lambda event: abs(event.time - plain[0].time))
    return ReleaseShift(
        release.time - plain[0].time,
        release.velocity - plain[0].velocity,
        _jerk(time, path.velocity, release, rig.gravity),
    )


def _jerk(time: Floats, velocity: Floats, release: Event, gravity: float) -> float:
    """By how much the acceleration changes in a second where the force vanishes [m/s3]."""
    # While the layer sticks, the force goes on changing like that
    before = np.flatnonzero(time < (1.0 - _JERK_STEP) * release.time)
    if not before.size:
        return 0.0
    place = before[np.argmax(time[before])]
    since = release.time - time[place]
    return float(2.0 * (velocity[place] - release.velocity - gravity * since) / since**2)


def rest_height(rig: Rig) -> float:
    """Height of the resting projectile's lower face above the plate [m]."""
    return rig.layer.thickness - rig.static_sag
