# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Round spots on plate, layer and projectile, followed through high-speed videos.

Notes
-----
Detection. A closing of the first picture fills dark regions up to a given width; the round ones
are spots.

Measurement. In every later picture, the search for a spot begins at its extrapolated position. The
measured position is the centre of mass of the darkness within a circle around this position. The
circle is wider than the spot by the blur, so that the grid of pixels has no influence. Noise of
the grey levels of :math:`\sigma` causes an error of at least :math:`\sigma \sqrt{\sum (y - y_c)^2}
/ \sum w`, where :math:`w` is the darkness of the pixels of the circle. Discs of 8 pixels that are
140 grey levels darker than their background, blurred by 1 pixel, are measured within 0.003 pixels,
and with noise of 4 levels within 0.02 pixels (rms).

Covered spots. A partly covered spot has another total darkness, and differs from its image turned
by half a turn; neither motion blur nor uneven light causes such an asymmetry. So a spot is
accepted only if it is separate from other dark regions, of similar area, and as dark in total and
as symmetric as before. Otherwise the sample is missing, and the radius of the search grows with
the largest acceleration of all spots until it is too large. Two candidates are both refused. After
a gap, a spot counts only if the speeds on both sides explain its path, and if it has not moved
aside. Samples beside a gap and runs of a few pictures are dropped.

Libraries. trackpy keeps partly covered spots (docs/measured.md). The regions and blobs of
scikit-image are less exact even without a wire (0.07 and 0.4 pixels rms, here 0.025), as is its
phase correlation (0.13).

"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
import math
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from soft_throw_ros.core import checks
from soft_throw_ros.identification.tracks import FEWEST, Track, TrackError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Picture = NDArray[Any]  # grey levels in the type of the video

BODIES = ('plate', 'layer', 'projectile', 'none')
"""Bodies that a spot can mark; `none` ignores the spot."""

_SMOOTHING = 1.0  # standard deviation of the filter of pictures before thresholds [px]
_MAX_WIDTH = 3  # shorter side of the picture over the width of the largest spot
_MIN_AREA = 9  # smallest area of a spot [pixels]
_MIN_DARKNESS = 0.3  # smallest darkness of a spot, relative to the darkest spot
_MIN_CONTRAST = 6.0  # smallest darkness of a detected spot, relative to the noise
_MAX_ECCENTRICITY = 0.8  # largest eccentricity of a spot as an ellipse
_MIN_SMEAR = 0.4  # motion per picture [diameters] above which a spot is elongated
_MIN_SOLIDITY = 0.85  # smallest area of a spot over the area of its convex hull
_BLUR = 2.0  # width of the blurred edge outside the contour of half darkness [px]
_RING = 2.0  # half the width of the ring that measures the background [px]
_MARGIN = 4  # margin of the search beyond the diameter [px]
_CENTRE_ROUNDS = 3  # iterations of the centre of the circle
_MAX_CHANGE = 1.6  # largest ratio of the areas of a spot in two pictures
_MAX_MASS_CHANGE = 0.05  # largest relative deviation of the total darkness from its recent mean
_MASS_MEMORY = 20  # length of the recent mean [measurements]
_MAX_ASYMMETRY = 0.03  # largest change of the asymmetry, relative to the darkness (rms)
_ASYMMETRY_NOISE = 0.7  # contribution of noise to the asymmetry, per noise over darkness
_MASS_NOISE = 4.0  # allowed deviation of the total darkness [standard errors]
_MIN_ACCELERATION = 0.1  # smallest assumed acceleration of spots [px per picture squared]
_ACCELERATION_SPAN = 4  # pictures between the positions that give the acceleration
_MAX_UNCERTAINTY = 3.0  # radius [diameters] beyond which another spot may be found
_BEND = 0.125  # allowed error of a path across a gap, over acceleration times gap squared
_MAX_SIDEWAYS = 0.5  # allowed sideways motion across a gap [px]
_MAX_TILT = 0.02  # allowed sideways motion across a gap, per pixel of height
_MIN_RUN = 3  # smallest number of consecutive pictures with a spot

_FIRST_SEARCH = 10
"""Number of the first picture that is searched for spots missing in the very first one."""

_SEARCH_RATIO = 1.25
"""Number of the next picture to search over that of the last; a search costs as 10 pictures."""


@dataclass(frozen=True, kw_only=True)
class Spot:
    """Path of a spot through the pictures that show it completely."""

    picture: Integers
    """Numbers of these pictures, from 0."""
    row: Floats
    column: Floats
    """Centre of the spot in each picture, counted from the upper left. [px]"""
    error: float
    """Standard error of each centre due to the noise of the pictures. [px]"""
    start: tuple[float, float]
    """Row and column in the first picture. [px]"""
    has_left: bool = False
    """Whether the spot left the view in the end."""

    @property
    def location(self) -> str:
        """Description of the first position, for messages."""
        row, column = self.start
        return f'column {column:.0f} row {row:.0f}'

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """First and last number of the pictures between others that do not show it."""
        before = np.flatnonzero(np.diff(self.picture) > 1)
        return [
            (int(self.picture[index]) + 1, int(self.picture[index + 1]) - 1) for index in before
        ]


class FollowedSpots(NamedTuple):
    """The spots of a video."""

    spots: list[Spot]
    """Spots of the first picture, the lowest one first."""
    pictures: int
    """Number of pictures of the video."""
    late: tuple[int, DetectedSpot] | None
    """A spot that was not followed, and the number of a picture that shows it."""


def follow_spots(pictures: Iterable[Picture], *, light: bool = False) -> FollowedSpots:
    """
    Follow round spots through a video.

    Parameters
    ----------
    pictures : iterable of ndarray, shape (rows, columns)
        Grey levels of at least one picture.
    light : bool
        Whether spots are lighter than their background, and not darker.

    Returns
    -------
    FollowedSpots
        Those of the first picture, and perhaps one that it does not show.

    Raises
    ------
    TrackError
        If there are none, or pictures differ in size.

    """
    trackers: list[_SpotTracker] = []
    exposure: _Exposure | None = None
    search = _LateSearch()
    for number, picture in enumerate(pictures):
        if exposure is None:
            levels = picture * (-1.0 if light else 1.0)
            detected = find_spots(levels)
            if not detected:
                raise _no_spots(levels, light)
            smallest = min(spot.diameter for spot in detected)
            exposure = _Exposure(picture, 0.25 * math.pi * smallest**2 if light else None)
            noise = _noise(levels)
            trackers = [_SpotTracker(spot, noise) for spot in detected]
        if picture.shape != exposure.shape:
            raise TrackError(
                f'pictures must be of one size, got {picture.shape} after {exposure.shape}'
            )
        levels = exposure.normalise(picture)
        acceleration = max(item.acceleration for item in trackers)
        assigned: list[_Circle] = []
        for spot in sorted(trackers, key=attrgetter('uncertainty')):
            # In a shared search region, a candidate cannot be assigned to one of two spots
            hidden = [
                item.search_region
                for item in trackers
                if item is not spot and item.uncertainty and spot.uncertainty
            ]
            spot.update(number, levels, acceleration, assigned + hidden)
            if not spot.uncertainty:
                assigned.append(spot.search_region)
        search.update(number, levels, trackers)
    if exposure is None:
        raise TrackError('contains no picture')
    return FollowedSpots([spot.result() for spot in trackers], number + 1, search.detected)


class _Exposure:
    """
    The brightness of pictures, which varies under lamps on mains current.

    With dark spots, the background determines the brightness pixel by pixel, since most of the
    background does not move. With light spots, the brightest region of a picture does. Its area is
    half of the smallest spot, so that covered spots do not matter.

    Parameters
    ----------
    picture : ndarray, shape (rows, columns)
        The first picture, to whose brightness others are scaled.
    light_area : float or None
        Area of the smallest spot if spots are light. [px]

    """

    def __init__(self, picture: Picture, light_area: float | None) -> None:
        self.shape = picture.shape
        self._bright_pixels = light_area and max(1, round(0.5 * light_area))
        self._first = picture
        self._is_background = picture >= max(float(np.median(picture)), 1.0)
        self._reference = self._peak(picture)

    def normalise(self, picture: Picture) -> Floats:
        """Return grey levels at the brightness of the first picture, with dark spots."""
        if self._bright_pixels:
            return picture * (-self._reference / max(self._peak(picture), 1e-12))
        if not self._is_background.any():
            return picture.astype(np.float64)
        ratios = picture[self._is_background] / self._first[self._is_background]
        return picture / max(float(np.median(ratios)), 1e-12)

    def _peak(self, picture: Picture) -> float:
        """Return the level that the brightest part exceeds."""
        count = self._bright_pixels or 1
        levels = ndimage.gaussian_filter(picture.astype(np.float32), _SMOOTHING).ravel()
        return float(np.partition(levels, -count)[-count])


class _LateSearch:
    """A search for round spots that the first picture does not show, as behind a wire."""

    def __init__(self) -> None:
        self.detected: tuple[int, DetectedSpot] | None = None
        """Picture and place of the first such spot."""
        self._next = _FIRST_SEARCH
        self._last: list[DetectedSpot] = []

    def update(self, number: int, levels: Floats, trackers: Sequence[_SpotTracker]) -> None:
        """Search some pictures, more and more seldom; two in a row must show the spot."""
        if self.detected or any(item.is_lost for item in trackers) or number < self._next:
            return
        known = [item.search_region for item in trackers]
        largest = _MAX_CHANGE * max(item.diameter for item in trackers)
        smallest = min(item.diameter for item in trackers) / _MAX_CHANGE
        new = [
            spot
            for spot in find_spots(levels)
            if smallest < spot.diameter < largest
            and not any(circle.has(np.array(spot[:2])) for circle in known)
        ]
        for spot in new:
            if any(math.dist(spot[:2], old[:2]) < spot.diameter for old in self._last):
                self.detected = number, spot
        self._last = [] if self._last else new
        if not self._last:
            self._next = math.ceil(_SEARCH_RATIO * number)


def _no_spots(levels: Picture, light: bool) -> TrackError:
    """Return the error for missing spots, with a hint if spots of the other kind exist."""
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
        One of `BODIES` per spot. By default the lowest is on the plate, the highest on the
        projectile, and all others on the layer; a single one is on the plate.
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
            f'{", ".join(spot.location for spot in spots)}, and not {len(bodies)}, '
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
                f'the spot at {" and at ".join(spot.location for spot in some)}, on the {name}, '
                f'is seen in {seen.size} pictures, where at least {FEWEST} are needed'
            )
        row = np.mean([spot.row[np.isin(spot.picture, seen)] for spot in some], axis=0)
        tracks[name] = Track(
            time=seen / rate,
            position=scale * (zero - row),
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
    width = max(min(picture.shape) // _MAX_WIDTH, 3)
    closed = ndimage.grey_closing(smooth, size=(width, width), mode='nearest')
    closed -= np.median(closed - smooth)  # a closing follows the upper envelope of the noise
    darkness = closed - smooth
    faintest = max(_MIN_DARKNESS * float(darkness.max()), _MIN_CONTRAST * _noise(picture))
    detected = []
    for region in regionprops(label(darkness > faintest), intensity_image=darkness):
        half = 0.5 * region.intensity_max
        core = np.where(region.image, region.image_intensity, 0.0) > half
        (spot,) = regionprops(core.astype(np.uint8))
        is_round = spot.solidity > _MIN_SOLIDITY and spot.eccentricity < _MAX_ECCENTRICITY
        if spot.area >= _MIN_AREA and is_round:
            row, column = np.add(spot.centroid, region.bbox[:2])
            around = float(closed[region.slice][core].mean())
            diameter = spot.equivalent_diameter_area
            detected.append(DetectedSpot(row, column, diameter, around - half))
    return sorted(detected, reverse=True)


class SpotMeasurement(NamedTuple):
    """A spot as measured in one picture."""

    picture: int
    position: Floats
    error: float
    area: float
    level: float
    mass: float
    mass_error: float
    asymmetry: Floats
    asymmetry_noise: float


class _Circle(NamedTuple):
    """Known or possible position of another spot."""

    centre: Floats
    radius: float

    def has(self, position: Floats) -> bool:
        """Return whether a position is within the circle."""
        return math.dist(self.centre, position) < self.radius


class _SpotTracker:
    """A spot with its measurements so far."""

    def __init__(self, detected: DetectedSpot, noise: float) -> None:
        self.diameter = detected.diameter
        self.uncertainty = 0.0
        """Uncertainty of the expected position; 0 while the spot is seen. [px]"""
        self.acceleration = 0.0
        """Largest acceleration so far. [px per picture squared]"""
        self.is_lost = False
        self._has_left = False
        self._start = (float(detected.row), float(detected.column))
        self._noise = noise
        self._level = detected.level
        self._seen: list[SpotMeasurement] = []
        self._expected = np.array(self._start)
        self._velocity = np.zeros(2)
        self._velocity_uncertainty = 0.0

    @property
    def search_region(self) -> _Circle:
        """Measured or possible position in this picture."""
        is_measured = self._seen and not self.uncertainty
        position = self._seen[-1].position if is_measured else self._expected
        return _Circle(position, self.diameter + self.uncertainty)

    def update(
        self, number: int, picture: Picture, acceleration: float, others: Sequence[_Circle]
    ) -> None:
        """Search the spot in the next picture, except at the positions of other spots."""
        if self.is_lost:
            return
        acceleration = max(acceleration, _MIN_ACCELERATION)
        spot = self._find(number, picture, others)
        if spot is None:
            self._extrapolate(acceleration, picture.shape)
            return
        if self._seen:
            last = self._seen[-1]
            self._velocity = (spot.position - last.position) / (number - last.picture)
            self._velocity_uncertainty = (number - last.picture - 1) * acceleration
        else:
            self._velocity_uncertainty = 0.0
        self.uncertainty = 0.0
        self._expected = spot.position + self._velocity
        self._level = spot.level
        self._seen.append(spot)
        recent = self._seen[-1 - 2 * _ACCELERATION_SPAN::_ACCELERATION_SPAN]
        if number - recent[0].picture == 2 * _ACCELERATION_SPAN:
            bend = np.diff([item.position for item in recent], 2, axis=0)
            latest = float(np.linalg.norm(bend)) / _ACCELERATION_SPAN**2
            self.acceleration = max(self.acceleration, latest)

    def _extrapolate(self, acceleration: float, shape: tuple[int, ...]) -> None:
        """Expect the spot farther on; give up if it has left the picture or may be anywhere."""
        self._velocity_uncertainty += acceleration
        self.uncertainty += self._velocity_uncertainty
        self._expected = self._expected + self._velocity
        edge = 0.5 * self.diameter + _BLUR + 1.0
        beyond = np.maximum(edge - self._expected, self._expected - np.subtract(shape, edge))
        is_inside = bool(beyond.max() <= 0.0)
        if not is_inside or self.uncertainty > _MAX_UNCERTAINTY * self.diameter:
            self.is_lost, self._has_left, self.uncertainty = True, not is_inside, 0.0

    def result(self) -> Spot:
        """Return all runs of sufficient length, without the samples beside gaps."""
        numbers = np.array([spot.picture for spot in self._seen], dtype=np.int64)
        positions = np.array([spot.position for spot in self._seen]).reshape(-1, 2)
        runs = np.split(np.arange(numbers.size), np.flatnonzero(np.diff(numbers) > 1) + 1)
        kept = [
            run[int(number > 0):run.size - int(number < len(runs) - 1)]
            for number, run in enumerate(runs)
            if run.size >= _MIN_RUN + (number > 0) + (number < len(runs) - 1)
        ]
        while len(kept) > 1 and not all(
            self._is_one_motion(numbers, positions, before[-_MIN_RUN:], after[:_MIN_RUN])
            for before, after in pairwise(kept)
        ):
            kept.pop()
        indices = np.concatenate([*kept, np.zeros(0, dtype=np.intp)])
        errors = [self._seen[index].error for index in indices]
        return Spot(
            picture=numbers[indices],
            row=positions[indices, 0],
            column=positions[indices, 1],
            error=float(np.sqrt(np.mean(np.square(errors or [0.0])))),
            has_left=self._has_left,
            start=self._start,
        )

    def _is_one_motion(
        self, numbers: Integers, positions: Floats, before: Integers, after: Integers
    ) -> bool:
        """Return whether the speeds on both sides of a gap explain the path in between."""
        velocities = [
            (positions[last] - positions[first]) / (numbers[last] - numbers[first])
            for first, last in (before[[0, -1]], after[[0, -1]])
        ]
        pictures = numbers[after[0]] - numbers[before[-1]]
        step = positions[after[0]] - positions[before[-1]]
        deviation = float(np.linalg.norm(step - pictures * np.mean(velocities, axis=0)))
        largest = 0.5 * self.diameter + _BEND * self.acceleration * pictures**2
        up, aside = np.abs(step)
        return bool(deviation < largest and aside < _MAX_SIDEWAYS + _MAX_TILT * up)

    def _find(
        self, number: int, picture: Picture, others: Sequence[_Circle]
    ) -> SpotMeasurement | None:
        """Search the spot; return None if it is covered or missing, or for two candidates."""
        from skimage.measure import label, regionprops

        smear = float(np.linalg.norm(self._velocity))  # motion during the exposure at most [px]
        far = 0.5 * self.diameter + _MARGIN + self.uncertainty + smear
        reach = far + 0.5 * self.diameter + self._velocity_uncertainty
        corner = np.maximum(np.floor(self._expected - reach).astype(int), 0)
        end = np.maximum(np.ceil(self._expected + reach).astype(int), 0)
        window = picture[corner[0]:end[0], corner[1]:end[1]]
        if min(window.shape) < 2 * _MARGIN:
            return None
        smooth = _smooth(window)
        usual = self._seen[-1].area if self._seen else 0.25 * math.pi * self.diameter**2
        candidates = (
            self._measure(number, region, window, smooth, smear)
            for region in regionprops(label(smooth < self._level))
            if usual / _MAX_CHANGE < region.area < usual * _MAX_CHANGE
            and not any(other.has(corner + region.centroid) for other in others)
        )
        spots = [spot for spot in candidates if spot is not None and self._is_like(spot)]
        if not spots or (len(spots) > 1 and self.uncertainty > 0.0):
            return None
        positions = [corner + spot.position for spot in spots]
        distances = [math.dist(position, self._expected) for position in positions]
        nearest = int(np.argmin(distances))
        if distances[nearest] >= far:
            return None
        return spots[nearest]._replace(position=positions[nearest])

    def _is_like(self, spot: SpotMeasurement) -> bool:
        """Return whether a candidate is as dark in total and as symmetric as the spot before."""
        if not self._seen:
            return True
        usual = float(np.mean([item.mass for item in self._seen[-_MASS_MEMORY:]]))
        change = spot.asymmetry - self._seen[0].asymmetry
        return bool(
            abs(spot.mass - usual) <= _MAX_MASS_CHANGE * usual + _MASS_NOISE * spot.mass_error
            and np.sqrt(np.mean(change**2)) < _MAX_ASYMMETRY + spot.asymmetry_noise
        )

    def _measure(
        self, number: int, region: Any, window: Floats, smooth: Floats, smear: float
    ) -> SpotMeasurement | None:
        """Measure the centre of a spot; return None if the circle leaves the window."""
        position = np.array(region.centroid)
        longer = smear if smear > _MIN_SMEAR * self.diameter else 0.0
        reach = 0.5 * (self.diameter + longer) + _BLUR
        pixels = np.indices(window.shape).reshape(2, -1).T
        levels = window.ravel()
        lowest, highest = reach + 1.0, np.subtract(window.shape, reach + 2.0)
        for _ in range(_CENTRE_ROUNDS):
            if (position < lowest).any() or (position > highest).any():
                return None
            distance = np.linalg.norm(pixels - position, axis=1)
            background = float(np.median(levels[np.abs(distance - reach - _RING) < _RING]))
            within = np.clip(reach + 0.5 - distance, 0.0, 1.0)
            darkness = within * (background - levels)
            total = float(darkness.sum())
            if total <= 0.0:
                return None
            position = darkness @ pixels / total
        depth = max(background - float(smooth[region.slice][region.image].min()), 1e-12)
        size = math.ceil(0.5 * self.diameter + _BLUR)
        grid = np.indices((2 * size + 1, 2 * size + 1)).reshape(2, -1) - float(size)
        disc = position[:, None] + grid[:, np.hypot(*grid) < 0.5 * self.diameter + _BLUR]
        seen = ndimage.map_coordinates(smooth, disc, order=3, mode='nearest')
        return SpotMeasurement(
            picture=number,
            position=position,
            error=self._noise * math.sqrt(0.5 * float(np.sum((within * distance) ** 2))) / total,
            area=float(region.area),
            level=background - 0.5 * depth,
            mass=total,
            mass_error=self._noise * math.sqrt(float(np.sum(within**2))),
            asymmetry=(seen - seen[::-1]) / depth,  # the reversed disc is turned by half a turn
            asymmetry_noise=_ASYMMETRY_NOISE * self._noise / depth,
        )


def _smooth(picture: Picture) -> Floats:
    levels = picture.astype(np.float64)
    return np.asarray(ndimage.gaussian_filter(levels, _SMOOTHING, mode='nearest'))


def _noise(picture: Picture) -> float:
    """Estimate the standard deviation of white noise, from differences along rows."""
    steps = np.diff(picture.astype(np.float64), 2, axis=1) / math.sqrt(6.0)
    return 1.4826 * float(np.median(np.abs(steps)))
