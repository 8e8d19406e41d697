# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Channels, messages and bags for tests."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import contextlib
from pathlib import Path
import struct
import time
from typing import Any

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader, NonSeekingReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes
from soft_throw_ros.storage.bag_metadata import dump_yaml
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import Channel, Message

BEGIN = 1_700_000_000_000_000_000
"""Time of the first message. [ns]"""


def profiles(*changes: dict[str, Any]) -> str:
    """Return YAML with a quality-of-service profile for each set of changes."""
    infinite = {'sec': 9223372036, 'nsec': 854775807}
    default = {
        'history': 'keep_last', 'depth': 10, 'reliability': 'reliable', 'durability': 'volatile',
        'deadline': infinite, 'lifespan': infinite, 'liveliness': 'automatic',
        'liveliness_lease_duration': infinite, 'avoid_ros_namespace_conventions': False,
    }
    return dump_yaml([{**default, **profile} for profile in changes])


def channel(topic: str, kind: str = 'std_msgs/msg/String', **qos: Any) -> Channel:
    """Return the channel of a topic whose publisher offers `qos`."""
    schema = find_schema(kind, installed_prefixes())
    return Channel(
        topic=topic,
        type=kind,
        schema=schema.text,
        type_hash=schema.type_hash,
        qos=profiles(qos),
    )


def text(content: str) -> bytes:
    """Return a serialized message of std_msgs/String."""
    data = content.encode() + b'\0'
    return b'\0\1\0\0' + struct.pack('<I', len(data)) + data


def saved(folder: Path) -> list[tuple[str, bytes, int, int, int]]:
    """Return topic, data, times [ns] and number of each message, as mcap reads an open bag."""
    rows = []
    for path in sorted(folder.glob('*.mcap')):
        with path.open('rb') as file, contextlib.suppress(EndOfFile, struct.error):
            reader = NonSeekingReader(file, validate_crcs=True)
            for _, channel, message in reader.iter_messages(log_time_order=False):
                times = message.log_time, message.publish_time
                rows.append((channel.topic, message.data, *times, message.sequence))
    return rows


def write(path: Path, messages: Iterable[Message], chunk: int = 1000, **kwargs: Any) -> Path:
    """Write a bag with a fixed number of messages per chunk."""
    with BagWriter(path, distribution='jazzy', **kwargs) as writer:
        for number, message in enumerate(messages):
            writer.write(message)
            if number % chunk == chunk - 1:
                writer.flush()
    return path


def notes(folder: Path) -> dict[str, dict[str, str]]:
    """Return the named texts in the last file of a bag, as mcap reads them."""
    with max(folder.glob('*.mcap')).open('rb') as file:
        return {item.name: item.metadata for item in make_reader(file).iter_metadata()}


PLAIN = Channel(topic='/plain', type='std_msgs/msg/String', schema='string data')


def plain(number: int, size: int = 100) -> Message:
    """Make a message that contains only its number, which is also its time."""
    return Message(PLAIN, number.to_bytes(8, 'little') + bytes(size - 8), *3 * [number])


def read(path: Path, *topics: str) -> list[tuple[str, bytes, int, int, int]]:
    """Return such rows of the messages of a finished bag, by time, as our reader has them."""
    with BagReader(path) as bag:
        return [(message.channel.topic, *message[1:]) for message in bag.messages(topics or None)]


def wait_until(done: Callable[[], bool], timeout: float = 60.0) -> None:
    """Wait for an effect of another thread or process."""
    deadline = time.monotonic() + timeout
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.01)
