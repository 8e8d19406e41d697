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
r"""
Round spots on plate, layer and projectile, followed through high-speed videos.

Notes
-----
Spots are found in the first picture: what a closing by area fills in is dark and no larger than
that, whatever lies around it, and what of it is round is a spot. From then on each is looked
for where its last step leads. Its place is the centre of mass of its darkness, within a circle
around that place itself which is wider than the spot by the blur, so that the grid of pixels does
not show. Noise of the grey levels of :math:`\sigma` makes it err by at least :math:`\sigma
\sqrt{\sum (y - y_c)^2} / \sum w`, where :math:`w` is the darkness of the pixels of the circle.
Discs of 8 pixels that are 140 grey levels darker than what is around them, blurred by 1 pixel,
are found within 0.003 pixels, and with noise of 4 levels within 0.02 pixels (rms).

What covers a part of a spot shifts its centre of mass, and makes it unlike itself turned by half
a turn, which neither blur by motion nor uneven light does. So a spot counts as seen only if it
is apart from all else that is dark, as large, dark and round as before, and as symmetric; one
that moves far while a picture is taken is longer. Otherwise the sample is missing, and the spot
is looked for where it may have got to: the doubt about its place grows by the largest
acceleration of all spots. If two are found there, neither is taken, and if it may be too far away
it is given up. What comes after a gap counts if the speeds on both sides explain the way in
between, and if it is not aside: what hides at first may appear where another spot has hidden.
The samples beside a gap are left out, too, and so is what is seen for a few pictures only. What
covers a spot in the first picture already cannot be told from its shape.

trackpy links spots over gaps as well, but within a range that does not grow with the gap, and it
takes what is partly covered for a spot; that is where the errors are.

"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from soft_throw_ros.core import checks
from soft_throw_ros.identification.tracks import FEWEST, Track, TrackError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Picture = NDArray[Any]  # of whatever numbers the camera gives

BODIES = ('plate', 'layer', 'projectile', 'none')
"""What spots may be on."""

_SMOOTHING = 1.0  # of pictures, to find out what is dark [px]
_MAX_WIDTH = 3  # the shorter side of the picture over the width of the largest spot
_MIN_AREA = 9  # pixels of a spot
_MIN_DARKNESS = 0.3  # darkness of a spot over that of the darkest, and ...
_MIN_CONTRAST = 6.0  # over the noise
_MAX_ECCENTRICITY = 0.8  # of a spot at most, as an ellipse
_SMEARED = 0.4  # of its diameter per picture that a spot moves may make it longer
_MIN_SOLIDITY = 0.85  # of its convex hull that it fills at least
_BLUR = 2.0  # how far a spot reaches beyond where it is half as dark, and ...
_RING = 2.0  # half the width of what is looked at around that [px]
_MARGIN = 4  # beyond its diameter that it is looked for [px]
_ROUNDS = 3  # of finding the centre of a circle around it
_MAX_CHANGE = 1.6  # of the area and of the darkness of a spot since it was seen last
_MAX_MASS_CHANGE = 0.05  # of its darkness altogether, from what it usually was of late
_MASS_MEMORY = 20.0  # pictures that late is
_MAX_ASYMMETRY = 0.03  # of its darkness that turning it changes otherwise than at first (rms)
_ASYMMETRY_NOISE = 0.7  # times the noise of a pixel over the darkness that this may be more
_MASS_NOISE = 4.0  # times its standard error that the mass may be off
_MIN_ACCELERATION = 0.1  # of spots that is reckoned with [px per picture squared]
_ACCELERATION_SPAN = 4  # pictures between the places that the acceleration is seen from
_MAX_DOUBT = 3.0  # diameters; farther away it may be another spot
_BEND = 0.125  # of what the acceleration does in a gap, that mean speeds may be off
_ASIDE, _TILT = 0.5, 0.02  # that it may be aside then [px], and for each pixel up or down
_MIN_RUN = 3  # pictures one after the other that show a spot
_LEVELS = 63.0  # grey levels to find spots with


@dataclass(frozen=True, kw_only=True)
class Spot:
    """A spot as it moves: where it is in the pictures that show it as a whole."""

    picture: Integers
    """Numbers of these pictures, from 0."""
    row: Floats
    column: Floats
    """Its centre in each of them, counted from the upper left. [px]"""
    error: float
    """Standard error of each, were there nothing but the noise of the pictures. [px]"""

    @property
    def place(self) -> str:
        """Where it is at first, for messages."""
        if not self.row.size:
            return 'the edge'
        return f'column {self.column[0]:.0f} row {self.row[0]:.0f}'

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """First and last number of the pictures between others that do not show it."""
        before = np.flatnonzero(np.diff(self.picture) > 1)
        return [
            (int(self.picture[place]) + 1, int(self.picture[place + 1]) - 1) for place in before
        ]


def follow_spots(pictures: Iterable[Picture], *, light: bool = False) -> list[Spot]:
    """
    Follow round spots through a video.

    Parameters
    ----------
    pictures : iterable of ndarray, shape (rows, columns)
        Grey levels.
    light : bool
        Whether spots are lighter than what is around them, and not darker.

    Returns
    -------
    list of Spot
        Those of the first picture, the lowest one first.

    Raises
    ------
    TrackError
        If there are none, or pictures differ in size.

    """
    trackers: list[_SpotTracker] = []
    shape: tuple[int, ...] | None = None
    for number, picture in enumerate(pictures):
        levels = -picture.astype(np.float64) if light else picture
        if shape is None:
            shape, noise = picture.shape, _noise(levels)
            trackers = [_SpotTracker(found, noise) for found in find_spots(levels)]
            if not trackers:
                raise _no_spots(levels, light)
        if picture.shape != shape:
            raise TrackError(f'pictures must be of one size, got {picture.shape} after {shape}')
        acceleration = max(each.acceleration for each in trackers)
        taken: list[_Circle] = []
        for spot in sorted(trackers, key=lambda each: each.doubt):  # the surest ones first
            # Where another one may have got to, nobody knows which of them it is
            hidden = [
                each.whereabouts
                for each in trackers
                if each is not spot and each.doubt and spot.doubt
            ]
            spot.update(number, levels, acceleration, taken + hidden)
            if not spot.doubt:
                taken.append(spot.whereabouts)
    if shape is None:
        raise TrackError('there is no picture in it')
    return [spot.result() for spot in trackers]


def _no_spots(levels: Picture, light: bool) -> TrackError:
    """Say that there is no spot, and whether there are some of the other kind."""
    kind, other = ('light', 'dark') if light else ('dark', 'light')
    others = len(find_spots(-levels.astype(np.float64)))
    hint = f', but {others} {other} ones; see --light-spots' if others else ''
    return TrackError(f'the first picture shows no {kind} round spot{hint}')


def tracks_of(
    spots: Sequence[Spot], bodies: Sequence[str] | None = None, *, rate: float, scale: float
) -> dict[str, Track]:
    """
    Turn spots into tracks of bodies.

    Parameters
    ----------
    spots : sequence of Spot
        The lowest first.
    bodies : sequence of str, optional
        For each of them one of `BODIES`. Without, the lowest is on the plate, the highest on the
        projectile, and what is between on the layer; a single one is on the plate.
    rate : float
        Pictures per second of the camera. [Hz]
    scale : float
        Size of a pixel. [m]

    Returns
    -------
    dict of str to Track
        Heights above the first place of the lowest spot. Spots of a body are averaged where all
        are seen; but those of the layer, which do not move alike, are `layer 1` and so on, and
        those on `none` are left out.

    Raises
    ------
    TrackError
        If there are not as many bodies as spots, or one is seen in too few pictures.
    ValueError
        If a number is not finite and positive, or a body none of `BODIES`.

    """
    rate = checks.require_positive('rate', rate)
    scale = checks.require_positive('scale', scale)
    if bodies is None:
        bodies = ['plate', *['layer'] * (len(spots) - 2), 'projectile'][: len(spots)]
    for body in bodies:
        if body not in BODIES:
            raise ValueError(f'a spot is on one of {", ".join(BODIES)}, got {body!r}')
    if len(bodies) != len(spots):
        raise TrackError(
            f'{len(spots)} round spots are seen, at '
            f'{", ".join(spot.place for spot in spots)}, and not {len(bodies)}, '
            f'{", ".join(bodies)}'
        )
    groups: dict[str, list[Spot]] = {}
    for number, (spot, body) in enumerate(zip(spots, bodies, strict=True)):
        if body != 'none':
            name = f'layer {1 + bodies[:number].count("layer")}' if body == 'layer' else body
            groups.setdefault(name, []).append(spot)
    zero = next((float(spot.row[0]) for spot in spots if spot.row.size), 0.0)
    tracks = {}
    for name, some in groups.items():
        seen = reduce(np.intersect1d, [spot.picture for spot in some])
        if seen.size < FEWEST:
            raise TrackError(
                f'the spot at {" and at ".join(spot.place for spot in some)}, on the {name}, is '
                f'seen in {seen.size} pictures, where at least {FEWEST} are needed'
            )
        row = np.mean([spot.row[np.isin(spot.picture, seen)] for spot in some], axis=0)
        tracks[name] = Track(
            time=seen / rate,
            position=scale * (zero - row),
            least_noise=scale * math.hypot(*(spot.error for spot in some)) / len(some),
        )
    return tracks


class DetectedSpot(NamedTuple):
    """A spot in a picture: its centre and diameter [px], and the grey level of its edge."""

    row: float
    column: float
    diameter: float
    level: float


def find_spots(picture: Picture) -> list[DetectedSpot]:
    """Find the dark round spots of a picture, the lowest one first."""
    from skimage.measure import label, regionprops

    smooth = _smooth(picture)
    scale = max(float(np.ptp(smooth)), 1e-12) / _LEVELS
    levels = np.round((smooth - smooth.min()) / scale).astype(np.uint8)
    closed = close_by_area(levels, max((min(picture.shape) // _MAX_WIDTH) ** 2, _MIN_AREA))
    darkness = scale * (closed.astype(np.float64) - levels)
    faintest = max(_MIN_DARKNESS * float(darkness.max()), _MIN_CONTRAST * _noise(picture))
    found = []
    for region in regionprops(label(darkness > faintest), intensity_image=darkness):
        half = 0.5 * region.intensity_max
        core = np.where(region.image, region.image_intensity, 0.0) > half
        (spot,) = regionprops(core.astype(np.uint8))
        if spot.area >= _MIN_AREA and _is_round(spot):
            row, column = np.add(spot.centroid, region.bbox[:2])
            around = float(smooth.min()) + scale * float(closed[region.slice][core].mean())
            found.append(DetectedSpot(row, column, spot.equivalent_diameter_area, around - half))
    return sorted(found, reverse=True)


def close_by_area(levels: NDArray[np.uint8], area: int) -> NDArray[np.uint8]:
    """
    Fill each hole of a picture up to the level at which it has so many pixels, at least.

    Parameters
    ----------
    levels : ndarray of uint8, shape (rows, columns)
        Grey levels, few of which make it fast.
    area : int
        Of the smallest hole that is left. [px]

    Notes
    -----
    `skimage.morphology.area_closing` finds the same in a time that grows with the square of a
    noisy picture's pixels: a minute for a million of them, and this takes a second.

    """
    closed: NDArray[np.uint8] = levels.copy()
    is_open = np.ones(levels.shape, np.bool_)
    for level in np.unique(levels):
        parts, _ = ndimage.label(levels <= level)
        is_large = np.bincount(parts.ravel()) >= area
        is_large[0] = False  # what is above this level
        reached = is_open & is_large[parts]
        closed[reached] = level
        is_open &= ~reached
    closed[is_open] = levels.max()
    return closed


def _is_round(region: Any, *, smeared: bool = False) -> bool:  # scikit-image has no types
    is_long = region.eccentricity > _MAX_ECCENTRICITY and not smeared
    return bool(region.solidity > _MIN_SOLIDITY and not is_long)


class _Sighting(NamedTuple):
    """A spot as a picture shows it."""

    place: Floats
    error: float
    area: float
    depth: float
    level: float
    mass: float
    mass_error: float
    asymmetry: Floats


class _Circle(NamedTuple):
    """Where another spot is, or may be."""

    centre: Floats
    radius: float

    def has(self, place: Floats) -> bool:
        """Tell whether a place is within it."""
        return math.dist(self.centre, place) < self.radius


class _SpotTracker:
    """A spot, and where it was seen so far."""

    def __init__(self, found: DetectedSpot, noise: float) -> None:
        self.doubt = 0.0
        """How far it may be from where it is expected. [px]"""
        self.acceleration = 0.0
        """The largest so far. [px per picture squared]"""
        self._expected = np.array([found.row, found.column])
        self._velocity = np.zeros(2)
        self._velocity_doubt = 0.0
        self._diameter = found.diameter
        self._noise = noise
        self._level = found.level
        self._seen: list[tuple[int, _Sighting]] = []
        self._usual_mass = 0.0
        self._is_lost = False

    @property
    def whereabouts(self) -> _Circle:
        """Where it was seen in this picture, or may be."""
        place = self._expected if self.doubt or not self._seen else self._seen[-1][1].place
        return _Circle(place, self._diameter + self.doubt)

    def update(
        self, number: int, picture: Picture, acceleration: float, others: Sequence[_Circle]
    ) -> None:
        """Find it in the next picture, where its motion leads and no other spot is."""
        if self._is_lost:
            return
        found = self._find(picture, others)
        least = max(acceleration, _MIN_ACCELERATION)
        if found is None:
            self._velocity_doubt += least
            self.doubt += self._velocity_doubt
            self._expected = self._expected + self._velocity
            edge = 0.5 * self._diameter + _BLUR + 1.0
            beyond = np.maximum(edge - self._expected, self._expected + edge - picture.shape)
            if beyond.max() > 0.0 or self.doubt > _MAX_DOUBT * self._diameter:
                # It has left the picture, or may be anywhere
                self._is_lost, self.doubt = True, 0.0
            if self._velocity_doubt > np.linalg.norm(self._velocity):
                self._velocity = np.zeros(2)  # it may have turned
            return
        self._velocity_doubt = 0.0
        if self._seen:
            before, last = self._seen[-1]
            velocity = (found.place - last.place) / (number - before)
            self._velocity_doubt = (number - before - 1) * least
            self._velocity = velocity
        self.doubt = 0.0
        self._expected = found.place + self._velocity
        self._level = found.level
        memory = min(_MASS_MEMORY, len(self._seen) + 1.0)
        self._usual_mass += (found.mass - self._usual_mass) / memory
        self._seen.append((number, found))
        self._see_acceleration()

    def _see_acceleration(self) -> None:
        """Tell the acceleration from three places that are far enough apart not to be noise."""
        span = _ACCELERATION_SPAN
        if len(self._seen) > 2 * span:
            (first, before), (_, middle), (last, after) = self._seen[-1 - 2 * span:: span]
            if last - first == 2 * span:
                bend = after.place - 2.0 * middle.place + before.place
                self.acceleration = max(self.acceleration, float(np.linalg.norm(bend)) / span**2)

    def result(self) -> Spot:
        """Return what was seen for long enough, but for the samples beside gaps."""
        numbers = np.array([number for number, _ in self._seen], dtype=np.int64)
        runs = np.split(np.arange(numbers.size), np.flatnonzero(np.diff(numbers) > 1) + 1)
        kept = [
            run[(0 if place == 0 else 1):run.size - (0 if place == len(runs) - 1 else 1)]
            for place, run in enumerate(runs)
            if run.size >= _MIN_RUN + (place > 0) + (place < len(runs) - 1)
        ]
        while len(kept) > 1 and not all(map(self._is_one_motion, kept, kept[1:])):
            kept.pop()
        places = np.concatenate(kept) if kept else np.zeros(0, dtype=np.intp)
        seen = [self._seen[place][1] for place in places]
        row, column = np.array([each.place for each in seen]).reshape(-1, 2).T
        error = float(np.sqrt(np.mean(np.square([each.error for each in seen] or [0.0]))))
        return Spot(picture=numbers[places], row=row, column=column, error=error)

    def _is_one_motion(self, before: Integers, after: Integers) -> bool:
        """Tell whether the speeds on both sides of a gap explain how far it went in between."""
        pairs = ((before[-_MIN_RUN], before[-1]), (after[0], after[_MIN_RUN - 1]))
        (one, end), (start, other) = ((self._seen[i], self._seen[k]) for i, k in pairs)
        speeds = [
            (late[1].place - early[1].place) / (late[0] - early[0])
            for early, late in ((one, end), (start, other))
        ]
        pictures = start[0] - end[0]
        off = start[1].place - end[1].place - 0.5 * pictures * (speeds[0] + speeds[1])
        most = 0.5 * self._diameter + _BEND * self.acceleration * pictures**2
        up, aside = np.abs(start[1].place - end[1].place)
        return bool(np.linalg.norm(off) < most and aside < _ASIDE + _TILT * up)

    def _find(self, picture: Picture, others: Sequence[_Circle]) -> _Sighting | None:
        """Look for it; return nothing if it is not there as a whole, or if two may be it."""
        from skimage.measure import label, regionprops

        smear = float(np.linalg.norm(self._velocity))  # by motion while a picture is taken
        reach = self._diameter + _MARGIN + self.doubt + self._velocity_doubt + smear
        corner = np.maximum(np.floor(self._expected - reach).astype(int), 0)
        end = np.maximum(np.ceil(self._expected + reach).astype(int), 0)
        part = picture[corner[0]:end[0], corner[1]:end[1]].astype(np.float64)
        if min(part.shape) < 2 * _MARGIN:
            return None
        smooth = _smooth(part)
        usual = self._seen[-1][1].area if self._seen else 0.25 * math.pi * self._diameter**2
        candidates = [
            region
            for region in regionprops(label(smooth < self._level))
            if usual / _MAX_CHANGE < region.area < usual * _MAX_CHANGE
            and min(region.bbox[:2]) > 0
            and (np.array(region.bbox[2:]) < part.shape).all()
            and _is_round(region, smeared=smear > _SMEARED * self._diameter)
            and not any(other.has(corner + region.centroid) for other in others)
        ]
        sightings = [self._measure(region, part, smooth, smear) for region in candidates]
        whole = [each for each in sightings if each is not None and self._is_like(each)]
        if len(whole) > 1 and self.doubt > 0.0:
            return None
        middle = self._expected - corner
        far = 0.5 * self._diameter + _MARGIN + self.doubt + smear
        whole = [each for each in whole if math.dist(each.place, middle) < far]
        near = min(whole, key=lambda each: math.dist(each.place, middle), default=None)
        return near and near._replace(place=near.place + corner)

    def _is_like(self, found: _Sighting) -> bool:
        """Tell whether it is as dark and symmetric as it was."""
        if found.depth < _MIN_CONTRAST * self._noise:
            return False
        if not self._seen:
            return True
        (_, first), (_, latest) = self._seen[0], self._seen[-1]
        off = abs(found.mass - self._usual_mass)
        if off > _MAX_MASS_CHANGE * self._usual_mass + _MASS_NOISE * found.mass_error:
            return False
        change = max(found.depth / latest.depth, latest.depth / found.depth)
        noise = _ASYMMETRY_NOISE * self._noise / found.depth
        unlike = float(np.sqrt(np.mean((found.asymmetry - first.asymmetry) ** 2)))
        return change < _MAX_CHANGE and unlike < _MAX_ASYMMETRY + noise

    def _measure(
        self, region: Any, part: Floats, smooth: Floats, smear: float
    ) -> _Sighting | None:
        """Find the centre of a spot; nothing if it leaves the picture."""
        place = np.array(region.centroid)
        longer = smear if smear > _SMEARED * self._diameter else 0.0
        reach = 0.5 * (self._diameter + longer) + _BLUR
        pixels = np.indices(part.shape).reshape(2, -1).T
        levels = part.ravel()
        for _ in range(_ROUNDS):
            if (place < reach + 1.0).any() or (place > np.array(part.shape) - reach - 2.0).any():
                return None
            distance = np.linalg.norm(pixels - place, axis=1)
            around = float(np.median(levels[np.abs(distance - reach - _RING) < _RING]))
            within = np.clip(reach + 0.5 - distance, 0.0, 1.0)
            darkness = within * (around - levels)
            total = float(darkness.sum())
            if total <= 0.0:
                return None
            place = darkness @ pixels / total
        depth = around - float(smooth[region.slice][region.image].min())
        error = self._noise * math.sqrt(0.5 * float(np.sum((within * distance) ** 2))) / total
        size = math.ceil(0.5 * self._diameter + _BLUR)
        grid = np.indices((2 * size + 1, 2 * size + 1)).reshape(2, -1) - float(size)
        beside = grid[:, np.hypot(*grid) < 0.5 * self._diameter + _BLUR]
        this, turned = (
            ndimage.map_coordinates(smooth, place[:, None] + step, order=3, mode='nearest')
            for step in (beside, -beside)
        )
        return _Sighting(
            place=place,
            error=error,
            area=float(region.area),
            depth=depth,
            level=around - 0.5 * depth,
            mass=total,
            mass_error=self._noise * math.sqrt(float(np.sum(within**2))),
            asymmetry=(this - turned) / max(depth, 1e-12),
        )


def _smooth(picture: Picture) -> Floats:
    from skimage.filters import gaussian

    levels = picture.astype(np.float64)
    return np.asarray(gaussian(levels, _SMOOTHING, mode='nearest', preserve_range=True))


def _noise(picture: Picture) -> float:
    """Estimate the standard deviation of white noise, from differences along rows."""
    steps = np.diff(picture.astype(np.float64), 2, axis=1) / math.sqrt(6.0)
    return 1.4826 * float(np.median(np.abs(steps)))
