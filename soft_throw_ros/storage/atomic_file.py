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

    Parameters
    ----------
    path : Path
        File to create or replace; an exception within the context leaves the file unchanged.

    Yields
    ------
    Path
        Temporary file for the content.

    """
    beside = path.parent / f'{path.name}.{os.getpid()}.tmp'
    try:
        yield beside
        with beside.open('rb+') as file:
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
