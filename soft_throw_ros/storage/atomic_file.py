# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Files that are there as a whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import os
from pathlib import Path


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
