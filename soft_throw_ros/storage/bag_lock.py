# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
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
