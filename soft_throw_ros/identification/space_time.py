# SPDX-License-Identifier: Apache-2.0
"""
What a vertical line through the layer shows over time (Fig. 8 of the paper), and its edges.

Notes
-----
An edge is where the line crosses the grey level that best divides the picture into dark and
bright (Otsu). Between two pixels it is interpolated, after smoothing over about one, so that an
edge that is blurred by the lens is found within some hundredths of a pixel.

"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from soft_throw_ros.core import checks
from soft_throw_ros.identification.spots import Picture
from soft_throw_ros.identification.tracks import Track, TrackError

Floats = NDArray[np.float64]

_SMOOTHING = 1.0  # along the line [px]
_WIDTH = 1  # columns to the left and to the right of the line that are averaged with it


@dataclass(frozen=True, kw_only=True)
class SpaceTime:
    """
    A line over time.

    Parameters
    ----------
    levels : ndarray, shape (pictures, heights)
        Grey levels, from the lower end of the line to its upper one.
    rate : float
        Pictures per second. [Hz]
    scale : float
        Size of a pixel. [m]

    """

    levels: Floats
    rate: float
    scale: float

    @property
    def time(self) -> Floats:
        """Of the pictures. [s]"""
        return np.arange(self.levels.shape[0]) / self.rate

    def edges(self) -> tuple[Track, Track]:
        """
        Follow the lowest edge and the highest one, those of a layer that fills the line.

        Returns
        -------
        tuple of Track
            Heights above the lower end of the line.

        Raises
        ------
        TrackError
            If there are not two of them in every picture.

        """
        from skimage.filters import threshold_otsu

        smooth = gaussian_filter1d(self.levels, _SMOOTHING, axis=1, mode='nearest')
        above = smooth - threshold_otsu(smooth)
        edges = np.empty((2, above.shape[0]))
        last = None
        for number, line in enumerate(above):
            places = np.flatnonzero(np.diff(line > 0.0))
            crossings = places + line[places] / (line[places] - line[places + 1])
            if crossings.size < 2:
                raise TrackError(
                    f'the line crosses {crossings.size} edges in picture {number + 1}, where the '
                    'lower and the upper one of the layer are needed'
                )
            if last is None:
                last = crossings[[0, -1]]
            last = np.array([crossings[np.argmin(np.abs(crossings - edge))] for edge in last])
            edges[:, number] = last
        bottom, top = (Track(time=self.time, position=self.scale * (0.5 + edge)) for edge in edges)
        return bottom, top


def space_time(
    pictures: Iterable[Picture],
    *,
    column: int,
    first: int,
    last: int,
    rate: float,
    scale: float,
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
        if not (0 <= first < last < rows and _WIDTH <= column < columns - _WIDTH):
            raise TrackError(
                f'a line from row {first} to row {last} of column {column} is not within pictures '
                f'of {rows} rows and {columns} columns'
            )
        part = picture[first : last + 1, column - _WIDTH : column + _WIDTH + 1]
        lines.append(part.astype(np.float64).mean(axis=1)[::-1])
    if not lines:
        raise TrackError('there is no picture')
    return SpaceTime(levels=np.array(lines), rate=rate, scale=scale)
