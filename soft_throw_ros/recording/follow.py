# SPDX-License-Identifier: Apache-2.0
"""Bags that are being written, read as they grow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import BinaryIO

from mcap.records import Metadata
from soft_throw_ros.recording.bag_reader import read_stream
from soft_throw_ros.recording.bag_writer import is_being_written
from soft_throw_ros.recording.message import BagError, Message


def follow(folder: str | Path, wait: Callable[[], None]) -> Iterator[Message | Metadata]:
    """
    Yield messages and named texts of a bag, those to come too, until it is complete.

    Parameters
    ----------
    folder : path_like
        The bag. What is written by a `BagWriter` ends with it, however that ends; what somebody
        else writes, with the end of a file after which there is no next one.
    wait : callable
        Is called whenever there is nothing to read yet. If it raises, that ends it.

    Raises
    ------
    BagError
        If the folder is no bag; or if a file of it is damaged, or not complete though nobody
        writes it any more, after all that came before.

    """
    folder = Path(folder)
    paths = (folder / f'{folder.resolve().name}_{number}.mcap' for number in count())
    path = next(paths)
    if not path.is_file():
        raise BagError(f'{folder} is no bag that is written, there is no file {path.name} in it')
    was_locked = False
    for following in paths:
        with path.open('rb', buffering=0) as file:
            growing = _Growing(file, folder, following, wait, was_locked=was_locked)
            yield from read_stream(growing, str(path))  # type: ignore[arg-type]
            was_locked = growing.was_locked
        while not following.is_file():
            if not is_being_written(folder):
                if following.is_file():
                    break  # it came in between
                return
            wait()
        path = following


class _Growing:
    """A file whose end is reached only when nobody writes it any more."""

    def __init__(
        self,
        file: BinaryIO,
        folder: Path,
        following: Path,
        wait: Callable[[], None],
        *,
        was_locked: bool,
    ) -> None:
        self.was_locked = was_locked
        self._file = file
        self._folder = folder
        self._following = following
        self._wait = wait

    def read(self, size: int) -> bytes:
        """Read at least a byte, and nothing only at the end."""
        while True:
            is_locked = is_being_written(self._folder)
            is_over = self._following.is_file() or (self.was_locked and not is_locked)
            self.was_locked |= is_locked
            # Looked for after that, so that nothing is missed
            piece = self._file.read(size)
            if piece or is_over:
                return piece
            self._wait()
