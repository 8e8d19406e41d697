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
    Have a file appear, or replace another, once it is written as a whole.

    Parameters
    ----------
    path : Path
        Stays as it is if anything is raised within the context.

    Yields
    ------
    Path
        Where to write, instead.

    """
    beside = path.with_name(f'{path.name}.{os.getpid()}.tmp')
    try:
        yield beside
        with beside.open('rb+') as file:
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
