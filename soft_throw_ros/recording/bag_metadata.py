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
"""The file `metadata.yaml` of a bag, as rosbag2 has it."""

from __future__ import annotations

from collections.abc import Mapping
import functools
from pathlib import Path
from typing import Any

from soft_throw_ros.configuration.atomic_file import atomic_file
import yaml

METADATA_FILE = 'metadata.yaml'

VERSION = 9
"""That of ROS 2 Jazzy and later."""

_KEY = 'rosbag2_bagfile_information'

_DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)  # faster where it is there


def dump_yaml(data: object) -> str:
    """Write YAML."""
    text: str = yaml.dump(data, Dumper=_DUMPER, sort_keys=False)
    return text


def write_metadata(path: Path, information: Mapping[str, object]) -> None:
    """Replace the file of a bag at once; OSError if that cannot be done."""
    with atomic_file(path) as unfinished:
        unfinished.write_text(dump_yaml({_KEY: information}), encoding='utf-8')


def read_metadata(path: Path) -> dict[str, Any]:
    """
    Read the file of a bag.

    Raises
    ------
    ValueError
        If there is none, or it does not describe a bag.

    Notes
    -----
    LibYAML would be faster, but many an opening bracket makes it overflow its stack.

    """
    try:
        information = yaml.safe_load(path.read_text(encoding='utf-8'))[_KEY]
        files = [str(name) for name in information['relative_file_paths']]
    except FileNotFoundError:
        raise ValueError('the file is missing') from None
    # PyYAML raises what comes its way if, say, a text is tagged as a number
    except (yaml.YAMLError, OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        reason = str(error).partition('\n')[0]
        raise ValueError(f'the file does not describe a bag, {reason}') from None
    return {**information, 'relative_file_paths': files}


@functools.lru_cache(maxsize=1000)  # every file of a bag, and many channels, have the same
def profiles_of(text: str) -> list[dict[str, Any]]:
    """
    Read the quality of service that stands at a channel; nothing if it is not as in version 9.

    Examples
    --------
    >>> profiles_of('- {depth: 3, reliability: reliable}')
    [{'depth': 3, 'reliability': 'reliable'}]
    >>> profiles_of('[{depth: 3, reliability: 1}]'), profiles_of('5')
    ([], [])

    """
    try:
        profiles = yaml.safe_load(text) or []
        are_named = all(isinstance(profile['reliability'], str) for profile in profiles)
    except (yaml.YAMLError, ValueError, LookupError, TypeError, RecursionError):
        return []
    return list(profiles) if are_named else []
