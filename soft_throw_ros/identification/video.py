# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Videos and their pictures in grey levels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import logging
import mimetypes
from pathlib import Path
import re

import numpy as np
from soft_throw_ros.identification.spots import Picture
from soft_throw_ros.identification.tracks import TrackError
from soft_throw_ros.storage.regular_file import open_regular_file

_MAX_BYTES = 1 << 40  # size of a video or a picture; its pictures are bounded one by one
_MAX_CHANNELS = 4  # largest number of channels of a picture; a stack has more
_MAX_PIXELS = 2**24  # largest size of a picture [pixels]: twice that of high-speed cameras
_OTHER_VIDEOS = ('.cine', '.mxf', '.y4m')  # suffixes of videos that `mimetypes` does not know
_DEEP = re.compile(r'(?:9|1[0-6])(?:le|be)?$')  # pixel formats with more than 8 bits


def is_video(path: str | Path) -> bool:
    """Return whether a path is a folder or has the suffix of a video or picture."""
    return Path(path).is_dir() or _kind(path) in ('video', 'image')


def read_pictures(path: str) -> Iterator[Picture]:
    """
    Read the pictures of a video or a stack, or of a folder in the order of their numbers.

    Yield grey levels of shape (rows, columns), of all bits that the file has. Raise TrackError if
    the pictures cannot be read, or none exists.
    """
    files = [Path(path)]
    if not files[0].exists():
        raise TrackError('No such file or directory')
    if files[0].is_dir():
        pictures = (item for item in files[0].iterdir() if _kind(item) == 'image')
        files = sorted(pictures, key=_by_number)
    if not files or not is_video(files[0]):
        raise TrackError('must be a video or a folder of pictures')
    try:
        for file in files:
            yield from _read_pages(file) if _kind(file) == 'image' else _read_video(file)
    except TrackError:
        raise
    except Exception as error:  # noqa: BLE001  whatever damaged bytes lead the libraries to
        reason = ' '.join((getattr(error, 'strerror', None) or str(error) or repr(error)).split())
        raise TrackError(f'cannot be read by FFmpeg or Pillow: {reason}') from None


def _read_video(path: Path) -> Iterator[Picture]:
    """Read the pictures of a video, turned as players show them."""
    import av
    from imageio import v3 as imageio

    _require_file(path)
    with imageio.imopen(path, 'r', plugin='pyav') as video:
        depth = str(video.metadata().get('video_format', ''))
        # Phantom's pictures are upside down in memory, which PyAV does not notice unless they
        # are converted, if only to bytes in another order
        _check_size(video.properties(format='gray').shape)
        deep = 'gray16be' if path.suffix.lower() == '.cine' else 'gray16le'
        pixels = deep if _DEEP.search(depth) or deep == 'gray16be' else 'gray'
        with av.open(str(path)) as container:
            first = next(container.decode(video=0), None)
            quarters = 0 if first is None else round(first.rotation / 90.0)
        for picture in video.iter(format=pixels):
            yield from _grey(np.rot90(picture, quarters))


def _read_pages(path: Path) -> Iterator[Picture]:
    """Read a picture, or a stack page by page, if a page is no larger than it can be."""
    from imageio import v3 as imageio

    logging.getLogger('tifffile').setLevel(logging.CRITICAL)  # a damaged file is one line
    _require_file(path)
    _check_size(imageio.improps(path).shape)
    for page in imageio.imiter(path):
        yield from _grey(page)


def _require_file(path: Path) -> None:
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


def _kind(path: str | Path) -> str:
    if str(path).lower().endswith(_OTHER_VIDEOS):
        return 'video'
    return (mimetypes.guess_type(path)[0] or '').partition('/')[0]


def _grey(levels: Picture) -> Iterator[Picture]:
    """Yield the pictures of a stack, or the only one, without colours."""
    if levels.ndim > 2 and levels.shape[-1] <= _MAX_CHANNELS:
        levels = levels[..., :3].mean(axis=-1).astype(levels.dtype)
    yield from levels.reshape(-1, *levels.shape[-2:])


def _by_number(path: Path) -> list[str | int]:
    """Sort `frame_2` before `frame_10`."""
    parts = re.split(r'(\d+)', path.name)
    return [int(part) if part.isdecimal() else part for part in parts]
