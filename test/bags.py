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
"""Bags that tests write: channels, messages and whole bags."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
import struct
from typing import Any

from soft_throw_ros.recording.bag_metadata import dump_yaml
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes

BEGIN = 1_700_000_000_000_000_000


def profiles(*given: dict[str, Any]) -> str:
    """Write profiles of quality of service, as they stand at a channel."""
    infinite = {'sec': 9223372036, 'nsec': 854775807}
    default = {
        'history': 'keep_last', 'depth': 10, 'reliability': 'reliable', 'durability': 'volatile',
        'deadline': infinite, 'lifespan': infinite, 'liveliness': 'automatic',
        'liveliness_lease_duration': infinite, 'avoid_ros_namespace_conventions': False,
    }
    return dump_yaml([{**default, **profile} for profile in given])


def channel(topic: str, kind: str = 'std_msgs/msg/String', **qos: Any) -> Channel:
    """Make the channel of a topic whose publisher offers `qos`."""
    schema = find_schema(kind, installed_prefixes())
    return Channel(
        topic=topic,
        type=kind,
        schema=schema.text,
        type_hash=schema.type_hash,
        qos=profiles(qos),
    )


def text(content: str) -> bytes:
    """Write a message of std_msgs/String."""
    data = content.encode() + b'\0'
    return b'\0\1\0\0' + struct.pack('<I', len(data)) + data


def write(path: Path, messages: Iterable[Message], chunk: int = 1000, **kwargs: Any) -> Path:
    """Write a bag with a chunk for so many messages."""
    with BagWriter(path, distribution='jazzy', **kwargs) as writer:
        for number, message in enumerate(messages):
            writer.write(message)
            if number % chunk == chunk - 1:
                writer.flush()
    return path
