# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Definitions of message types, as a bag carries them: with all that they depend on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import json
import os
from pathlib import Path
import re
import sys

_TYPE = re.compile(r'([A-Za-z]\w*)/msg/([A-Za-z]\w*)')

_FIELD_TYPE = re.compile(
    r'^[ \t]*([A-Za-z]\w*(?:/[A-Za-z]\w*){0,2})(?:<=\d+)?(?:\[(?:<?=?\d+)?\])?[ \t]+[A-Za-z]',
    re.MULTILINE,
)


class SchemaError(Exception):
    """A message type has no definition in the searched folders, which the message names."""


def find_schema(type_name: str, prefixes: Iterable[str | Path]) -> tuple[str, str]:
    """
    Return the definition of a type such as `sensor_msgs/msg/JointState`; SchemaError if none.

    It is the `.msg` files of the type and of its components in MCAP's form `ros2msg`, and its
    hash, `RIHS01_...`. `prefixes` are folders of installed ROS packages, of which the first one
    with the type wins.
    """
    folders = [Path(prefix) / 'share' for prefix in prefixes]
    done = {type_name}

    def texts(name: str) -> Iterator[str]:
        path = _path_of(name, folders)
        text = path.read_text(encoding='utf-8')
        yield text
        for short in _dependencies(text, path.parts[-3]):
            full = '/msg/'.join(short.split('/'))
            if full not in done:
                done.add(full)
                yield f'\n{"=" * 80}\nMSG: {short}\n'
                yield from texts(full)

    try:
        text = ''.join(texts(type_name))
        description = _path_of(type_name, folders).with_suffix('.json')
        items = json.loads(description.read_text(encoding='utf-8'))['type_hashes']
        return text, {item['type_name']: str(item['hash_string']) for item in items}[type_name]
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise SchemaError(f'{type_name}: its definition cannot be read, {error!r:.200}') from None


def installed_prefixes() -> list[str]:
    """Return where packages of ROS are installed."""
    paths = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return [path for path in paths if path] + [sys.prefix]  # the latter with ROS from PyPI


def _dependencies(text: str, package: str) -> list[str]:
    """List the types that fields have, as `package/Type`, in the order that rosbag2 takes."""
    names = {name.replace('/msg/', '/') for name in _FIELD_TYPE.findall(text)}
    names -= {name for name in names if name.islower()}  # primitive types
    return sorted({name if '/' in name else f'{package}/{name}' for name in names})


def _path_of(type_name: str, folders: list[Path]) -> Path:
    match = _TYPE.fullmatch(type_name)
    if match is None:
        raise SchemaError(f'a message type is named as std_msgs/msg/String, got {type_name!r}')
    for folder in folders:
        path = folder / match[1] / 'msg' / f'{match[2]}.msg'
        if path.is_file():
            return path
    raise SchemaError(f'no definition of {type_name} in {", ".join(map(str, folders))}')
