# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The file `metadata.yaml` of a bag, as rosbag2 has it."""

from __future__ import annotations

from collections.abc import Mapping
import functools
from pathlib import Path
from typing import Any

from soft_throw_ros.storage.atomic_file import atomic_file
from soft_throw_ros.storage.regular_file import read_regular_file
import yaml

METADATA_FILE = 'metadata.yaml'

VERSION = 9
"""Version of the metadata format of ROS 2 Jazzy and later."""

_KEY = 'rosbag2_bagfile_information'

MAX_FILE_SIZE = 512 * 2**10
"""Largest size of the file [bytes]: 500 topics, or 16 twins and the files of a day, take half."""

_ERRORS = (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError)
"""Errors for texts that are no YAML, or do not have the expected values."""


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


def read_metadata(path: Path) -> tuple[str, str, list[str]]:
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
