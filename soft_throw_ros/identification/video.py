# SPDX-License-Identifier: Apache-2.0
r"""
Tracks from high-speed videos: dark round spots, and the edges along a vertical line.

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

An edge (Fig. 8 of the paper) is where a line crosses the grey level that best divides it into dark
and bright (Otsu). Between two pixels it is interpolated, after smoothing over about one, so that
an edge that is blurred by the lens is found within some hundredths of a pixel.

"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from soft_throw_ros.core import checks
from soft_throw_ros.identification.tracks import FEWEST, Track, TrackError

Floats = NDArray[np.float64]
Picture = NDArray[Any]

BODIES = ('plate', 'layer', 'projectile', 'none')
"""What spots may be on."""

_SMOOTHING = 1.0  # of pictures and lines, to find out what is dark [px]
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
_SIDE = 1  # columns on either side of a line that are averaged with it


@dataclass(frozen=True, kw_only=True)
class Spot:
    """A spot as it moves, from the first picture on as long as it is seen."""

    row: Floats
    column: Floats
    """Its centre in each picture, counted from the upper left. [px]"""
    error: float
    """Standard error of each, were there nothing but the noise of the pictures. [px]"""

    @property
    def place(self) -> str:
        """Where it is at first, for messages."""
        if not self.row.size:
            return 'the edge'
        return f'column {self.column[0]:.0f} row {self.row[0]:.0f}'


def follow_spots(pictures: Iterable[Picture]) -> list[Spot]:
    """
    Follow dark round spots through a video.

    Parameters
    ----------
    pictures : iterable of ndarray, shape (rows, columns)
        Grey levels.

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
            f'{len(spots)} dark round spots are seen, at '
            f'{", ".join(spot.place for spot in spots)}, and not {len(bodies)}, '
            f'{", ".join(bodies)}'
        )
    groups: dict[str, list[Spot]] = {}
    for number, (spot, body) in enumerate(zip(spots, bodies, strict=True)):
        if body == 'none':
            continue
        if spot.row.size < FEWEST:
            raise TrackError(
                f'the spot at {spot.place}, on the {body}, is seen in {spot.row.size} '
                f'pictures from the first one on, where at least {FEWEST} are needed'
            )
        name = f'layer {1 + bodies[:number].count("layer")}' if body == 'layer' else body
        groups.setdefault(name, []).append(spot)
    tracks = {}
    for name, some in groups.items():
        seen = min(spot.row.size for spot in some)
        row = np.mean([spot.row[:seen] for spot in some], axis=0)
        tracks[name] = Track(
            time=np.arange(seen) / rate,
            position=scale * (spots[0].row[0] - row),
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
        self._expected = 2.0 * place - self._places[-1] if self._places else place
        self._places.append(place)
        self._errors.append(error)

    def result(self) -> Spot:
        """Return what was seen."""
        row, column = np.array(self._places).reshape(-1, 2).T
        error = float(np.sqrt(np.mean(np.square(self._errors or [0.0]))))
        return Spot(row=row, column=column, error=error)

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


@dataclass(frozen=True, kw_only=True)
class SpaceTime:
    """What a vertical line through the layer shows over time."""

    levels: Floats
    """Grey levels, shape (pictures, heights), from its lower end to its upper one."""
    rate: float
    """Pictures per second. [Hz]"""
    scale: float
    """Size of a pixel. [m]"""

    @property
    def time(self) -> Floats:
        """Of the pictures. [s]"""
        return np.arange(self.levels.shape[0]) / self.rate

    def edges(self) -> tuple[Track, Track]:
        """
        Follow the lowest edge and the highest one, those of a layer that fills the line.

        Heights count from its lower end. A picture with fewer edges raises TrackError.
        """
        from skimage.filters import threshold_otsu

        smooth = gaussian_filter1d(self.levels, _SMOOTHING, axis=1, mode='nearest')
        edges: list[Floats] = []
        for number, line in enumerate(smooth - threshold_otsu(smooth), 1):
            places = np.flatnonzero(np.diff(line > 0.0))
            crossings = places + line[places] / (line[places] - line[places + 1])
            if crossings.size < 2:
                raise TrackError(
                    f'the line crosses {crossings.size} edges in picture {number}, where the '
                    'lower and the upper one of the layer are needed'
                )
            last = edges[-1] if edges else crossings[[0, -1]]
            edges.append(crossings[np.abs(crossings[:, None] - last).argmin(axis=0)])
        bottom, top = (
            Track(time=self.time, position=self.scale * (0.5 + edge))
            for edge in np.transpose(edges)
        )
        return bottom, top


def space_time(
    pictures: Iterable[Picture], *, column: int, first: int, last: int, rate: float, scale: float
) -> SpaceTime:
    """
    Cut a vertical line out of every picture.

    Parameters
    ----------
    pictures : iterable of ndarray, shape (rows, columns)
        Grey levels.
    column : int
        Of the line, from the left. [px]
    first, last : int
        Its rows, from the top, both included. [px]
    rate : float
        Pictures per second of the camera. [Hz]
    scale : float
        Size of a pixel. [m]

    Raises
    ------
    TrackError
        If the line is not within the pictures, or there is none.
    ValueError
        If a number is not finite and positive.

    """
    rate = checks.require_positive('rate', rate)
    scale = checks.require_positive('scale', scale)
    lines = []
    for picture in pictures:
        rows, columns = picture.shape
        if not (0 <= first < last < rows and _SIDE <= column < columns - _SIDE):
            raise TrackError(
                f'a line from row {first} to row {last} of column {column} is not within pictures '
                f'of {rows} rows and {columns} columns'
            )
        part = picture[first : last + 1, column - _SIDE : column + _SIDE + 1]
        lines.append(part.astype(np.float64).mean(axis=1)[::-1])
    if not lines:
        raise TrackError('there is no picture')
    return SpaceTime(levels=np.array(lines), rate=rate, scale=scale)


def _smooth(picture: Picture) -> Floats:
    from skimage.filters import gaussian

    levels = picture.astype(np.float64)
    return np.asarray(gaussian(levels, _SMOOTHING, mode='nearest', preserve_range=True))


def _noise(picture: Picture) -> float:
    """Estimate the standard deviation of white noise, from differences along rows."""
    steps = np.diff(picture.astype(np.float64), 2, axis=1) / math.sqrt(6.0)
    return 1.4826 * float(np.median(np.abs(steps)))
