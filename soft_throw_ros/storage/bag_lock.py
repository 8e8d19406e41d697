# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The lock of a bag while it is written."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path


def is_being_written(path: str | Path) -> bool:
    """Return whether a `BagWriter`, in this or another process, writes the bag at a path."""
    folder = Path(path)
    try:
        folder = folder if folder.is_dir() else folder.parent
        os.close(lock_folder(folder, fcntl.LOCK_SH | fcntl.LOCK_NB))
    except BlockingIOError:
        return True
    except OSError:
        pass  # missing or unreadable; reading the bag raises a better error
    return False


def lock_folder(folder: Path, mode: int = fcntl.LOCK_EX) -> int:
    """Lock a folder; return the descriptor that holds the lock, where there are locks at all."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, mode)
    except BlockingIOError:
        os.close(descriptor)
        raise
    except OSError:
        pass  # a file system without locks
    return descriptor
