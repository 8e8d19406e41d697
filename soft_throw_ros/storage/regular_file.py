# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""User files: only regular ones of bounded size are read, and they are written as a whole."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import errno
import io
import os
from pathlib import Path
import stat


def open_regular_file(path: str | Path, *, max_bytes: int) -> io.BufferedReader:
    """
    Open a regular file for reading.

    OSError is raised if it cannot be opened, is larger than `max_bytes`, or is no regular file:
    FIFOs and devices may block or never end; they are refused at once, also behind links.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    status = os.fstat(descriptor)
    if stat.S_ISREG(status.st_mode) and status.st_size <= max_bytes:
        return os.fdopen(descriptor, 'rb')
    os.close(descriptor)
    if stat.S_ISREG(status.st_mode):
        raise OSError(errno.EFBIG, f'is larger than {max_bytes} bytes')
    raise OSError(errno.EINVAL, 'is not a regular file')


def read_regular_file(path: str | Path, *, max_bytes: int) -> bytes:
    """Return the contents of a regular file; arguments and errors as of `open_regular_file`."""
    with open_regular_file(path, max_bytes=max_bytes) as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:  # it has grown, or is one of /proc, which have no size
        raise OSError(errno.EFBIG, f'is larger than {max_bytes} bytes')
    return content


@contextlib.contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """
    Create or replace a file only after its content is complete.

    The context is a temporary file for the content; an exception leaves the file unchanged.
    """
    beside = path.parent / f'{path.name}.{os.getpid()}.tmp'
    try:
        yield beside
        with beside.open('rb+') as file:
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
