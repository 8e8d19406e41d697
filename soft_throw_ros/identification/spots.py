# SPDX-License-Identifier: Apache-2.0
r"""
Dark round spots on plate, layer and projectile, followed through a high-speed video.

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

"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.identification.tracks import FEWEST, Track, TrackError

Floats = NDArray[np.float64]
Picture = NDArray[Any]

BODIES = ('plate', 'layer', 'projectile', 'none')
"""What spots may be on."""

_SMOOTHING = 1.0  # of pictures, to find out what is dark [px]
_MAX_WIDTH = 3  # the shorter side of the picture over the width of the largest spot
_MIN_AREA = 9  # pixels of a spot
_MIN_DARKNESS = 0.3  # darkness of a spot over that of the darkest, and ...
_MIN_CONTRAST = 6.0  # over the noise
_MAX_ECCENTRICITY = 0.8  # of a spot at most, as an ellipse
_MIN_SOLIDITY = 0.85  # of its convex hull that it fills at least
_BLUR = 2.0  # how far a spot reaches beyond where it is half as dark, and ...
_RING = 2.0  # half the width of what is looked at around that [px]
_MARGIN = 4  # beyond its diameter that it is looked for [px]
_ROUNDS = 3  # of finding the centre of a circle around it
_MAX_CHANGE = 2.0  # of the area of a spot since the first picture
_LEVELS = 63.0  # grey levels to find spots with


@dataclass(frozen=True, kw_only=True)
class Spot:
    """
    A spot as it moves, from the first picture on as long as it is seen.

    Parameters
    ----------
    row, column : ndarray, shape (n,)
        Its centre in n pictures, counted from the upper left. [px]
    error : float
        Standard error of each, were there nothing but the noise of the pictures. [px]
    diameter : float
        In the first picture. [px]

    """

    row: Floats
    column: Floats
    error: float
    diameter: float


def follow_spots(pictures: Iterable[Picture]) -> list[Spot]:
    """
    Follow dark round spots through a video.

    Parameters
    ----------
    pictures : iterable of ndarray, shape (rows, columns)
        Grey levels. All have the same size.

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
    shape = None
    for picture in pictures:
        if shape is None:
            shape, noise = picture.shape, _noise(picture)
            trackers = [_SpotTracker(found, noise) for found in find_spots(picture)]
        if picture.shape != shape:
            raise TrackError(f'pictures must be of one size, got {picture.shape} after {shape}')
        for spot in trackers:
            spot.update(picture)
    if not trackers:
        raise TrackError('the first picture shows no dark round spot')
    return [spot.result() for spot in trackers]


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
        Heights above the first place of the lowest spot. Spots of a body are averaged, as long
        as all are seen; but those of the layer, which do not move alike, are `layer 1` and so on,
        and those on `none` are left out.

    Raises
    ------
    TrackError
        If there are not as many bodies as spots, or one is seen in less than `tracks.FEWEST`
        pictures.
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
        there = ', '.join(map(_describe_place, spots))
        raise TrackError(
            f'{len(spots)} dark round spots are seen, at {there}, and not {len(bodies)}, '
            f'{", ".join(bodies)}'
        )
    for spot, body in zip(spots, bodies, strict=True):
        if spot.row.size < FEWEST and body != 'none':
            raise TrackError(
                f'the spot at {_describe_place(spot)}, on the {body}, is seen in {spot.row.size} '
                f'pictures from the first one on, where at least {FEWEST} are needed'
            )
    numbered = [
        f'layer {1 + bodies[:place].count("layer")}' if body == 'layer' else body
        for place, body in enumerate(bodies)
    ]
    tracks = {}
    for name in dict.fromkeys(body for body in numbered if body != 'none'):
        some = [spot for spot, body in zip(spots, numbered, strict=True) if body == name]
        seen = min(spot.row.size for spot in some)
        row = np.mean([spot.row[:seen] for spot in some], axis=0)
        error = math.hypot(*(spot.error for spot in some)) / len(some)
        tracks[name] = Track(
            time=np.arange(seen) / rate,
            position=scale * (spots[0].row[0] - row),
            least_noise=scale * error,
        )
    return tracks


def _describe_place(spot: Spot) -> str:
    """Say where a spot is at first, for messages."""
    return f'column {spot.column[0]:.0f} row {spot.row[0]:.0f}' if spot.row.size else 'the edge'


class DetectedSpot(NamedTuple):
    """A spot in a picture: its centre and diameter [px], and the grey level of its edge."""

    row: float
    column: float
    diameter: float
    level: float


def find_spots(picture: Picture) -> list[DetectedSpot]:
    """Find the dark round spots of a picture, the lowest one first."""
    from skimage.measure import label, regionprops
    from skimage.morphology import area_closing

    smooth = _smooth(picture)
    # The fewer levels there are, the faster it is closed
    scale = max(float(np.ptp(smooth)), 1e-12) / _LEVELS
    levels = np.round((smooth - smooth.min()) / scale).astype(np.uint8)
    closed = area_closing(levels, max((min(picture.shape) // _MAX_WIDTH) ** 2, _MIN_AREA))
    darkness = scale * (closed.astype(np.float64) - levels)
    faintest = max(_MIN_DARKNESS * float(darkness.max()), _MIN_CONTRAST * _noise(picture))
    found = []
    for region in regionprops(label(darkness > faintest), intensity_image=darkness):
        half = 0.5 * region.intensity_max
        core = np.where(region.image, region.image_intensity, 0.0) > half
        (spot,) = regionprops(core.astype(np.uint8))
        if spot.area < _MIN_AREA or spot.eccentricity > _MAX_ECCENTRICITY:
            continue
        if spot.solidity > _MIN_SOLIDITY:
            row, column = np.add(spot.centroid, region.bbox[:2])
            around = float(smooth.min()) + scale * float(closed[region.slice][core].mean())
            found.append(DetectedSpot(row, column, spot.equivalent_diameter_area, around - half))
    return sorted(found, reverse=True)


class _SpotTracker:
    """A spot, and where it was seen so far."""

    def __init__(self, found: DetectedSpot, noise: float) -> None:
        self._places: list[Floats] = []
        self._errors: list[float] = []
        self._expected = np.array([found.row, found.column])
        self._diameter = found.diameter
        self._level = found.level
        self._noise = noise
        self._is_lost = False

    def update(self, picture: Picture) -> None:
        """Find it in the next picture, where its last step leads."""
        found = None if self._is_lost else self._find(picture)
        if found is None:
            self._is_lost = True
            return
        place, error = found
        step = place - self._places[-1] if self._places else 0.0
        self._places.append(place)
        self._errors.append(error)
        self._expected = place + step

    def result(self) -> Spot:
        """Return what was seen."""
        row, column = np.array(self._places).reshape(-1, 2).T
        error = float(np.sqrt(np.mean(np.square(self._errors or [0.0]))))
        return Spot(row=row, column=column, error=error, diameter=self._diameter)

    def _find(self, picture: Picture) -> tuple[Floats, float] | None:
        """Return centre and standard error; nothing if it is not there as a whole."""
        from skimage.measure import label, regionprops

        corner = np.maximum(np.floor(self._expected - self._diameter).astype(int) - _MARGIN, 0)
        end = np.maximum(np.ceil(self._expected + self._diameter).astype(int) + _MARGIN, 0)
        part = picture[corner[0] : end[0], corner[1] : end[1]].astype(np.float64)
        if min(part.shape) < 2 * _MARGIN:
            return None
        smooth = _smooth(part)
        regions = regionprops(label(smooth < self._level))
        usual = 0.25 * math.pi * self._diameter**2
        near = min(
            (each for each in regions if usual / _MAX_CHANGE < each.area < usual * _MAX_CHANGE),
            key=lambda region: math.dist(region.centroid, self._expected - corner),
            default=None,
        )
        if near is None:
            return None
        place = np.array(near.centroid)
        reach = 0.5 * self._diameter + _BLUR
        if (place < reach + 1.0).any() or (place > np.array(part.shape) - reach - 2.0).any():
            return None  # it leaves the picture
        pixels = np.indices(part.shape).reshape(2, -1).T
        levels = part.ravel()
        for _ in range(_ROUNDS):
            distance = np.linalg.norm(pixels - place, axis=1)
            around = float(np.median(levels[np.abs(distance - reach - _RING) < _RING]))
            within = np.clip(reach + 0.5 - distance, 0.0, 1.0)
            darkness = within * (around - levels)
            total = float(darkness.sum())
            if total <= 0.0:
                return None
            place = darkness @ pixels / total
        depth = around - float(smooth[near.slice][near.image].min())
        if depth < _MIN_CONTRAST * self._noise:
            return None
        self._level = around - 0.5 * depth
        error = self._noise * math.sqrt(0.5 * float(np.sum((within * distance) ** 2))) / total
        return place + corner, error


def _smooth(picture: Picture) -> Floats:
    from skimage.filters import gaussian

    levels = picture.astype(np.float64)
    return np.asarray(gaussian(levels, _SMOOTHING, mode='nearest', preserve_range=True))


def _noise(picture: Picture) -> float:
    """Estimate the standard deviation of white noise, from differences along rows."""
    steps = np.diff(picture.astype(np.float64), 2, axis=1) / math.sqrt(6.0)
    return 1.4826 * float(np.median(np.abs(steps)))
