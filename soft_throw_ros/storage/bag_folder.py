# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The folder of a bag: its files, its `metadata.yaml` as rosbag2 has it, and its lock."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import os
from pathlib import Path
from typing import Any

from soft_throw_ros.storage.message import BagError
from soft_throw_ros.storage.regular_file import read_regular_file
import yaml

METADATA_FILE = 'metadata.yaml'

METADATA_KEY = 'rosbag2_bagfile_information'

MAX_FILE_SIZE = 512 * 2**10
"""Largest size of the file [bytes]: 500 topics, or 16 twins and the files of a day, take half."""

NO_MCAP = (
    'is no bag in MCAP, or is compressed; convert it, as with rosbags: rosbags-convert --src BAG '
    '--dst NEW --dst-storage mcap'
)

_ERRORS = (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""Errors for texts that are no YAML, or do not have the expected values. (LibYAML would be faster,
but many opening brackets make it overflow its stack.)"""


class BagFolder:
    """The files of a bag: those of a folder, in order, or one MCAP file; BagError if none is."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.distribution = ''
        self.files = [self.path]
        self.defects: list[Path] = []  # files that are missing or empty
        if not self.path.is_dir():
            return
        mode, names = '', list[str]()
        with contextlib.suppress(OSError, *_ERRORS):
            text = read_regular_file(self.path / METADATA_FILE, max_bytes=MAX_FILE_SIZE).decode()
            information = yaml.safe_load(text)[METADATA_KEY]
            names = [Path(name).name for name in information['relative_file_paths']]
            mode = str(information.get('compression_mode')).lower()
            self.distribution = str(information.get('ros_distro') or '')
        # `bag_2` before `bag_10`
        present = sorted(self.path.glob('*.mcap'), key=lambda path: (len(path.name), path.name))
        if not present or mode == 'message':
            raise BagError(f'{self.path} {NO_MCAP}')
        sound = [path for path in present if path.is_file() and path.stat().st_size]
        self.files = sound or present
        listed = {self.path / name for name in names}
        self.defects = sorted(listed.union(present).difference(self.files))


def check_not_written(path: Path) -> None:
    """Raise BagError if a `BagWriter`, in this or another process, writes the bag at a path."""
    with contextlib.suppress(OSError):  # reading the bag raises a better error
        descriptor = os.open(path if path.is_dir() else path.parent, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BagError(f'{path} is being written; stop the recorder before') from None
        finally:
            os.close(descriptor)


def lock_folder(folder: Path) -> int:
    """Lock a folder; return the descriptor that holds the lock, where there are locks at all."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    with contextlib.suppress(OSError):  # a file system without locks
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    return descriptor


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """Writes every value in full, since readers may refuse aliases."""

    def ignore_aliases(self, _data: object) -> bool:
        return True


def dump_yaml(data: object) -> str:
    """Write YAML."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False)
    return text


@functools.lru_cache(maxsize=1000)  # every file of a bag, and many channels, have the same
def load_profiles(text: str) -> list[dict[str, Any]]:
    """
    Read the quality of service of a channel, a list in YAML; return an empty one if it is none.

    >>> load_profiles('- {depth: 3}'), load_profiles('[1]'), load_profiles('[')
    ([{'depth': 3}], [], [])

    """
    try:
        return [item for item in yaml.safe_load(text) or [] if isinstance(item, dict)]
    except _ERRORS:
        return []
