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

_WANTED = ('ros_distro', 'storage_identifier', 'compression_mode')

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


def read_metadata(path: Path) -> dict[str, Any]:
    """
    Read the parts of the file of a bag that are needed to find and read the other files.

    ValueError is raised if there is none, it is too large, or it does not describe a bag. (LibYAML
    would be faster, but many opening brackets make it overflow its stack.)
    """
    try:
        text = read_regular_file(path, max_bytes=MAX_FILE_SIZE).decode()
        information = yaml.safe_load(text)[_KEY]
        result = {name: information[name] or '' for name in _WANTED if name in information}
        files = list(information['relative_file_paths'])
    except FileNotFoundError:
        raise ValueError('the file is missing') from None
    except OSError as error:
        raise ValueError(f'the file {error.strerror}') from None
    except _ERRORS as error:
        reason = str(error).partition('\n')[0]
        raise ValueError(f'the file does not describe a bag, {reason:.200}') from None
    if not all(isinstance(text, str) for text in (*files, *result.values())):
        raise ValueError('the file does not describe a bag, it has lists in place of texts')
    return {**result, 'relative_file_paths': files}


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

    Examples
    --------
    >>> profiles_of('- {depth: 3, reliability: reliable}')
    [{'depth': 3, 'reliability': 'reliable'}]
    >>> profiles_of('[{depth: 3, reliability: 1}]'), profiles_of('5')
    ([], [])

    """
    profiles = load_profiles(text)
    has_names = all(
        isinstance(profile, dict) and isinstance(profile.get('reliability'), str)
        for profile in profiles
    )
    return profiles if has_names else []
