# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The folder of a bag: its files, its `metadata.yaml` as rosbag2 has it, and its lock."""

from __future__ import annotations

from collections.abc import Mapping
import fcntl
import functools
import os
from pathlib import Path
from typing import Any

from soft_throw_ros.storage.atomic_file import atomic_file
from soft_throw_ros.storage.message import BagError
from soft_throw_ros.storage.regular_file import read_regular_file
import yaml

METADATA_FILE = 'metadata.yaml'

VERSION = 9
"""Version of the metadata format of ROS 2 Jazzy and later."""

_KEY = 'rosbag2_bagfile_information'

MAX_FILE_SIZE = 512 * 2**10
"""Largest size of the file [bytes]: 500 topics, or 16 twins and the files of a day, take half."""

NO_MCAP = (
    'is no bag in MCAP, or is compressed; convert it, as with rosbags: rosbags-convert --src BAG '
    '--dst NEW --dst-storage mcap'
)

_ERRORS = (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""Errors for texts that are no YAML, or do not have the expected values."""


class BagFolder:
    """
    The files of a bag: those of a folder, in their order, or one MCAP file.

    The files contain all data; `metadata.yaml` adds the ROS distribution, and names missing files.
    BagError is raised if there is no bag in MCAP; the message gives the remedy.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.distribution = ''
        self.files = [self.path]
        self.defects: list[str] = []  # files that are missing or empty
        if not self.path.is_dir():
            return
        self.distribution, compression, names = _read_metadata(self.path / METADATA_FILE)
        # `bag_2` before `bag_10`
        present = sorted(self.path.glob('*.mcap'), key=lambda path: (len(path.name), path.name))
        if not present or compression == 'message':
            raise BagError(f'{self.path} {NO_MCAP}')
        listed = [self.path / Path(name).name for name in names]
        self.defects = [f'{path}: the file is missing' for path in listed if path not in present]
        # A loss of power may leave empty files
        empty = [path for path in present if path.is_file() and not path.stat().st_size]
        self.defects += [f'{path}: the file is empty' for path in empty]
        self.files = [path for path in present if path not in empty] or present


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


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """Writes every value in full, since readers may refuse aliases."""

    def ignore_aliases(self, _data: object) -> bool:
        return True


def dump_yaml(data: object) -> str:
    """Write YAML."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False)
    return text


def write_metadata(path: Path, information: Mapping[str, object]) -> None:
    """Replace the file of a bag at once; OSError if that cannot be done."""
    with atomic_file(path) as unfinished:
        unfinished.write_text(dump_yaml({_KEY: information}), encoding='utf-8')


def _read_metadata(path: Path) -> tuple[str, str, list[str]]:
    """
    Read ROS distribution, mode of compression and files of a bag; all empty if that is impossible.

    (LibYAML would be faster, but many opening brackets make it overflow its stack.)
    """
    try:
        text = read_regular_file(path, max_bytes=MAX_FILE_SIZE).decode()
        information = yaml.safe_load(text)[_KEY]
        files = [str(name) for name in information['relative_file_paths']]
        names = 'ros_distro', 'compression_mode'
        distribution, mode = (str(information.get(name) or '') for name in names)
    except (OSError, *_ERRORS):
        return '', '', []
    return distribution, mode.lower(), files


def load_profiles(text: str) -> list[Any]:
    """Read a list in YAML; return an empty one if it is no list."""
    try:
        return list(yaml.safe_load(text) or [])
    except _ERRORS:
        return []


@functools.lru_cache(maxsize=1000)  # every file of a bag, and many channels, have the same
def profiles_of(text: str) -> list[dict[str, Any]]:
    """
    Read the quality of service of a channel; return an empty list if it is not as in version 9.

    >>> profiles_of('- {depth: 3, reliability: reliable}'), profiles_of('[{reliability: 1}]')
    ([{'depth': 3, 'reliability': 'reliable'}], [])

    """
    profiles = load_profiles(text)
    has_names = all(
        isinstance(profile, dict) and isinstance(profile.get('reliability'), str)
        for profile in profiles
    )
    return profiles if has_names else []
