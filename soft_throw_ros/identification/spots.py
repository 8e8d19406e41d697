# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Round spots on plate, layer and projectile, followed through high-speed videos.

Notes
-----
trackpy locates the spots of each picture: the centres of mass after a band-pass filter. A spot of
the first picture is followed to the nearest one within a radius of its extrapolated position. A
partly covered spot has another mass (total brightness) or size (radius of gyration); before a
bright object, whose light replaces the covered part, it has a higher peak. Pictures without a
spot of the same mass, size and peak give no sample, nor do those beside such a gap.

"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
import math
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.identification.tracks import FEWEST, Floats, Track, TrackError

Picture = NDArray[Any]  # grey levels in the type of the video

BODIES = ('plate', 'layer', 'projectile', 'none')
"""Bodies that a spot can mark; `none` ignores the spot."""

_COLUMNS = ['y', 'x', 'mass', 'size', 'ecc', 'signal']
_SMALLEST = 7  # first diameter that the search tries [px]
_FILL = 0.27  # largest size over a diameter that includes the blurred edge; a full disc has 0.35
_MIN_MASS = 0.3  # smallest mass of a spot of the first picture, over that of the largest
_MAX_ECCENTRICITY = 0.3  # largest eccentricity of a spot of the first picture
_MAX_MASS_CHANGE = 0.07  # largest deviation from the mass in the first picture, relative
_MAX_SIZE_CHANGE = 0.06  # largest deviation from the size in the first picture, relative
_MAX_PEAK_RISE = 0.06  # largest rise of the peak over the first picture; motion blur lowers it
_MAX_GAP = 20  # number of pictures without a spot after which it is lost


@dataclass(kw_only=True)
class Spot:
    """Path of a spot through the pictures that show it completely."""

    first: Floats  # row and column [px], mass, size, eccentricity and peak in the first picture
    picture: list[int]  # numbers of these pictures, from 0
    centre: list[Floats]  # row and column in each of them [px]
    has_left: bool = False  # whether the spot left the view in the end

    @property
    def location(self) -> str:
        """Description of the first position, for messages."""
        return f'column {self.first[1]:.0f} row {self.first[0]:.0f}'

    @property
    def velocity(self) -> Floats:
        """Between the last two of these pictures [px per picture]."""
        if len(self.centre) < 2:
            return np.zeros(2)
        step = self.centre[-1] - self.centre[-2]
        return np.asarray(step / (self.picture[-1] - self.picture[-2]))

    def take(self, number: int, found: Floats, radius: float) -> Floats:
        """Add the nearest similar spot of a picture; return the other ones."""
        gap, last = number - self.picture[-1], self.centre[-1]
        if gap > _MAX_GAP:
            return found
        distance = np.linalg.norm(found[:, :2] - last - gap * self.velocity, axis=1)
        mass, size, _, peak = (found[:, 2:] / self.first[2:] - 1.0).T
        is_like = (np.abs(mass) < _MAX_MASS_CHANGE) & (np.abs(size) < _MAX_SIZE_CHANGE)
        distance[~is_like | (peak > _MAX_PEAK_RISE)] = math.inf
        if distance.min(initial=math.inf) > radius:
            return found
        nearest = int(np.argmin(distance))
        self.picture.append(number)
        self.centre.append(found[nearest, :2])
        return np.delete(found, nearest, axis=0)

    def finish(self, count: int, shape: tuple[int, ...], diameter: int) -> None:
        """Remove samples beside gaps, and find out whether the spot has left the view."""
        coming = self.centre[-1] + self.velocity
        from_edge = np.minimum(coming, np.array(shape) - 1.0 - coming)
        self.has_left = bool(from_edge.min() < 0.5 * diameter + 1.0)  # no farther trackpy looks
        is_gap = np.diff([*self.picture, count]) > 1
        kept = np.flatnonzero(~(is_gap | np.append(False, is_gap[:-1])))
        self.picture = [self.picture[index] for index in kept]
        self.centre = [self.centre[index] for index in kept]


def follow_spots(pictures: Iterable[Picture], *, light: bool = False) -> tuple[list[Spot], int]:
    """
    Follow round spots, dark or light, through pictures of shape (rows, columns).

    Return the spots of the first picture, the lowest one first, and the number of pictures. Raise
    TrackError if there are none, or pictures differ in size.
    """
    number, every = 0, iter(pictures)
    if (first := next(every, None)) is None:
        raise TrackError('contains no picture')
    spots, diameter = _first_spots(first, light)
    for number, picture in enumerate(every, 1):
        if picture.shape != first.shape:
            wrong = f'{picture.shape} after {first.shape}'
            raise TrackError(f'pictures must be of one size, got {wrong}')
        found = _locate(picture, diameter, light)
        for spot in sorted(spots, key=lambda spot: -spot.picture[-1]):
            found = spot.take(number, found, diameter)
    for spot in spots:
        spot.finish(number + 1, first.shape, diameter)
    return spots, number + 1


def _locate(picture: Picture, diameter: int, light: bool) -> Floats:
    """Return `Spot.first` of all bright places of a picture, shape (n, 6)."""
    import trackpy

    with warnings.catch_warnings(), np.errstate(divide='ignore', invalid='ignore'):
        warnings.simplefilter('ignore')  # of pictures without a bright place or without noise
        found = trackpy.locate(picture if light else picture.max() - picture, diameter)
    return np.asarray(found[_COLUMNS].to_numpy(dtype=np.float64))


def _first_spots(picture: Picture, light: bool) -> tuple[list[Spot], int]:
    """Return the round spots of a picture, the lowest first, and the diameter to search with."""
    for diameter in range(_SMALLEST, min(picture.shape) // 2, 2):
        found = _locate(picture, diameter, light)
        found = found[found[:, 2] > _MIN_MASS * found[:, 2].max(initial=0.0)]
        found = found[found[:, 4] < _MAX_ECCENTRICITY]
        if found.size and found[:, 3].max() < _FILL * diameter:
            lowest_first = found[np.argsort(-found[:, 0])]
            return [Spot(first=r, picture=[0], centre=[r[:2]]) for r in lowest_first], diameter
    kind = 'light' if light else 'dark'
    raise TrackError(f'the first picture shows no {kind} round spot (see --light-spots)')


def tracks_of(
    spots: Sequence[Spot], bodies: Sequence[str] | None = None, *, rate: float, scale: float
) -> dict[str, Track]:
    """
    Turn spots, the lowest first, into tracks of bodies, with heights above the lowest place.

    By default the lowest spot is on the plate, the highest on the projectile, and all others on
    the layer. Spots of a body are averaged where all are seen; but those of the layer, which do
    not move alike, are `layer 1` and so on. `rate` is that of the camera [Hz], `scale` the size of
    a pixel [m]. Raise ValueError if the bodies do not fit, or one is seen in too few pictures.
    """
    if bodies is None:
        bodies = ['plate', *['layer'] * (len(spots) - 2), 'projectile'][: len(spots)]
    for body in bodies:
        if body not in BODIES:
            raise ValueError(f'a spot is on one of {", ".join(BODIES)}, got {body!r}')
    if len(bodies) != len(spots):
        places = ', '.join(spot.location for spot in spots)
        raise TrackError(f'{len(spots)} round spots are seen, at {places}, not {len(bodies)}')
    groups: dict[str, list[Spot]] = {}
    for number, (spot, body) in enumerate(zip(spots, bodies, strict=True)):
        name = f'layer {1 + bodies[:number].count("layer")}' if body == 'layer' else body
        groups.setdefault(name, []).append(spot)
    groups.pop('none', None)
    tracks = {}
    for name, some in groups.items():
        seen = reduce(np.intersect1d, [np.array(spot.picture) for spot in some])
        if seen.size < FEWEST:
            raise TrackError(f'{name} is seen in {seen.size} pictures, {FEWEST} are needed')
        rows = [np.array(spot.centre)[np.isin(spot.picture, seen), 0] for spot in some]
        height = scale * (spots[0].first[0] - np.mean(rows, axis=0))
        tracks[name] = Track(time=seen / rate, position=height)
    return tracks
