# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Videos: their pictures in grey levels, and the edges along a vertical line over time.

Notes
-----
An edge (Fig. 8 of the paper) is where a line crosses the grey level that best divides it into dark
and bright (Otsu). Between two pixels it is interpolated, after smoothing over about one, so that
an edge that is blurred by the lens is found within some hundredths of a pixel.

"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
import logging
import mimetypes
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from soft_throw_ros.core import checks
from soft_throw_ros.identification.spots import Picture
from soft_throw_ros.identification.tracks import Track, TrackError
from soft_throw_ros.storage.regular_file import open_regular_file

Floats = NDArray[np.float64]

_SMOOTHING = 1.0  # standard deviation of the filter of lines before the threshold [px]
_MAX_BYTES = 1 << 40
"""Size of a video or a picture [byte]; its pictures are bounded one by one."""

_SIDE = 1  # number of columns on either side of a line in its average
_MAX_CHANNELS = 4  # largest number of channels of a picture; a stack has more
_MAX_PIXELS = 2**24  # largest size of a picture [pixels]: twice that of high-speed cameras
_OTHER_VIDEOS = ('.cine', '.mxf', '.y4m')
"""Suffixes of videos for FFmpeg that `mimetypes` does not know; Phantom cameras write .cine."""
_DEEP = re.compile(r'(?:9|1[0-6])(?:le|be)?$')
"""End of the names of pixel formats with more than 8 bits."""


def is_video(path: str) -> bool:
    """Return whether a path is a folder or has the suffix of a video or picture."""
    return Path(path).is_dir() or _kind(path) in ('video', 'image')


def read_pictures(path: str) -> Iterator[Picture]:
    """
    Read the pictures of a video, of a file or of a folder.

    Parameters
    ----------
    path : str
        A video that FFmpeg reads, Phantom's `.cine` among them; a picture or a stack; or a folder
        of pictures in the order of their numbers.

    Yields
    ------
    ndarray, shape (rows, columns)
        Grey levels, of all bits that the file has.

    Raises
    ------
    TrackError
        If the pictures cannot be read, or none exists.

    """
    if not Path(path).exists():
        raise TrackError('No such file or directory')
    count = 0
    try:
        for picture in _pictures(path):
            count += 1
            yield picture
    except TrackError:
        raise
    except Exception as error:  # noqa: BLE001  whatever damaged bytes lead the libraries to
        reason = getattr(error, 'strerror', None) or str(error) or repr(error)
        raise TrackError(
            f'cannot be read after {count} pictures, or has a format unknown to FFmpeg '
            f'and Pillow: {" ".join(reason.split())}'
        ) from None
    if not count:
        raise TrackError('contains no picture')


def camera_rate(path: str) -> float | None:
    """Return the number of pictures per second in the metadata [Hz], None without one."""
    if not path.lower().endswith('.cine'):
        return None  # other formats contain the rate of display
    from imageio import v3 as imageio

    _require_file(path)
    return float(imageio.immeta(path, plugin='pyav')['fps'])


def _pictures(path: str) -> Iterator[Picture]:
    """Read pictures by imageio."""
    from imageio import v3 as imageio

    if Path(path).is_dir():
        files = [item for item in Path(path).iterdir() if _kind(str(item)) == 'image']
        if not files:
            raise TrackError('there is no picture in this folder')
        for file in sorted(files, key=_by_number):
            yield from _read_pages(file)
    elif _kind(path) == 'video':
        _require_file(path)
        with imageio.imopen(path, 'r', plugin='pyav') as video:
            depth = str(video.metadata().get('video_format', ''))
            # Phantom's pictures are upside down in memory, which PyAV does not notice unless they
            # are converted, if only to bytes in another order
            _check_size(video.properties(format='gray').shape)
            deep = 'gray16be' if path.lower().endswith('.cine') else 'gray16le'
            pixels = deep if _DEEP.search(depth) or deep == 'gray16be' else 'gray'
            for picture in video.iter(format=pixels):
                yield from _grey(picture)
    elif _kind(path) == 'image':
        yield from _read_pages(Path(path))
    else:
        raise TrackError('must be a video or a folder of pictures')


def _read_pages(path: Path) -> Iterator[Picture]:
    """Read a picture, or a stack page by page, if a page is no larger than it can be."""
    from imageio import v3 as imageio

    logging.getLogger('tifffile').setLevel(logging.CRITICAL)  # a damaged file is one line
    _require_file(path)
    _check_size(imageio.improps(path).shape)
    for page in imageio.imiter(path):
        yield from _grey(page)


def _require_file(path: str | Path) -> None:
    """Refuse a video or a picture that is not a regular file, which might block."""
    try:
        open_regular_file(path, max_bytes=_MAX_BYTES).close()
    except OSError as error:
        raise TrackError(str(error.strerror)) from None


def _check_size(shape: Sequence[int]) -> None:
    """Refuse a picture, of a stack or in colours or not, that would fill the memory."""
    rows, columns = shape[-3:-1] if shape[-1] <= _MAX_CHANNELS else shape[-2:]
    if rows * columns > _MAX_PIXELS:
        raise TrackError(f'a picture may have {_MAX_PIXELS} pixels, got {columns} x {rows}')


def _kind(path: str) -> str:
    if path.lower().endswith(_OTHER_VIDEOS):
        return 'video'
    return (mimetypes.guess_type(path)[0] or '').partition('/')[0]


def _grey(levels: Picture) -> Iterator[Picture]:
    """Yield the pictures of a stack, or the only one, without colours."""
    if levels.ndim == 2:
        yield levels
    elif levels.ndim == 3 and levels.shape[-1] <= _MAX_CHANNELS:
        yield levels[..., :3].mean(axis=-1)
    else:
        for item in levels:
            yield from _grey(item)


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sort `frame_2` before `frame_10`."""
    return [
        (int(part), '') if part.isdecimal() else (0, part)
        for part in re.split(r'(\d+)', path.name, flags=re.ASCII)
    ]


@dataclass(frozen=True, kw_only=True)
class SpaceTime:
    """Grey levels of a vertical line through the layer over time."""

    levels: Floats
    """Grey levels, shape (pictures, heights), from the lower to the upper end."""
    rate: float
    """Pictures per second. [Hz]"""
    scale: float
    """Size of a pixel. [m]"""

    @property
    def time(self) -> Floats:
        """Times of the pictures [s]."""
        return np.arange(self.levels.shape[0]) / self.rate

    def edges(self) -> tuple[Track, Track]:
        """
        Track the lowest and the highest edge of a layer along the line.

        Heights count from the lower end of the line. Raise TrackError for less than two edges.
        """
        from skimage.filters import threshold_otsu

        smooth = gaussian_filter1d(self.levels, _SMOOTHING, axis=1, mode='nearest')
        edges: list[Floats] = []
        for number, line in enumerate(smooth - threshold_otsu(smooth), 1):
            before = np.flatnonzero(np.diff(line > 0.0))
            crossings = before + line[before] / (line[before] - line[before + 1])
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
    Extract a vertical line from every picture.

    Parameters
    ----------
    pictures : iterable of ndarray, shape (rows, columns)
        Grey levels.
    column : int
        Column of the line, from the left. [px]
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
        part = picture[first:last + 1, column - _SIDE:column + _SIDE + 1]
        lines.append(part.astype(np.float64).mean(axis=1)[::-1])
    if not lines:
        raise TrackError('there is no picture')
    return SpaceTime(levels=np.array(lines), rate=rate, scale=scale)
