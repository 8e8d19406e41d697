# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
MCAP files and their records, which the library `mcap` parses.

No file may make it read or unpack more than `MAX_RECORD` at once.
"""

from __future__ import annotations

from collections.abc import Mapping
import functools
import io
from pathlib import Path
import sys

from mcap import records as mcap
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message
from soft_throw_ros.storage.regular_file import open_regular_file

MAX_RECORD = 64 * 2**20
"""Largest size of a record, of an unpacked chunk, and of the index of a file. [bytes]"""

CONVERSION = 'convert it, as with rosbags: rosbags-convert --src BAG --dst NEW --dst-storage mcap'

_OTHER_FORMATS = {
    b'SQLite format 3': f'is a bag in sqlite3, not in MCAP; {CONVERSION}',
    b'#ROSBAG V': f'is a bag of ROS 1, not in MCAP; {CONVERSION}',
    b'\x28\xb5\x2f\xfd': f'is compressed as a whole; {CONVERSION}',
    MAGIC: '',
}
"""First bytes of files, with the reason why they are refused."""

_unique_channel = functools.cache(Channel)
"""Return one object for all equal channels, since the files of a bag repeat them."""


class UnfinishedError(BagError):
    """A file is damaged or unfinished; `recover` can copy its messages to a new bag."""

    def __init__(self, path: Path, reason: object) -> None:
        text = f'{str(reason) or type(reason).__name__:.200}'
        super().__init__(
            f'{path}: {text}; write a new bag of all that can be read: soft-throw recover BAG'
        )


class _BoundedFile(io.BufferedReader):
    """A file that refuses to read more than `MAX_RECORD` at once, whatever its records claim."""

    def read(self, size: int | None = -1) -> bytes:
        check_size(size or 0)
        return super().read(size)


def check_size(size: int) -> None:
    """Raise ValueError if a record or chunk claims too large a size [bytes]."""
    if size > MAX_RECORD:
        raise ValueError(f'a record or chunk of {size} bytes, more than {MAX_RECORD}')


def open_mcap(path: Path) -> io.BufferedReader:
    """Open an MCAP file; raise BagError if it cannot be opened, is empty or no MCAP file."""
    try:
        with open_regular_file(path, max_bytes=sys.maxsize) as file:
            begin = file.read(16)
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    reasons = [why for magic, why in _OTHER_FORMATS.items() if begin.startswith(magic)]
    if reason := 'is empty' if not begin else (*reasons, 'is no MCAP file')[0]:
        raise BagError(f'{path} {reason}')
    return _BoundedFile(io.FileIO(path))


def make_channel(record: mcap.Channel, schemas: Mapping[int, mcap.Schema]) -> Channel:
    """Return a channel; raise BagError if it is not of ROS 2."""
    if record.message_encoding != 'cdr':
        raise BagError(
            f'{record.topic} has messages in {record.message_encoding!r}, not in '
            "'cdr' as those of ROS 2 are"
        )
    schema = schemas[record.schema_id]
    return _unique_channel(
        topic=record.topic,
        type=schema.name,
        schema=schema.data.decode(errors='replace'),
        type_hash=record.metadata.get('topic_type_hash', ''),
        qos=record.metadata.get('offered_qos_profiles', ''),
        schema_encoding=schema.encoding,
    )


def make_message(record: mcap.Message, channels: Mapping[int, Channel]) -> Message:
    """Return a message; raise ValueError if its channel or its times are invalid."""
    channel = channels.get(record.channel_id)
    if channel is None:
        raise ValueError(f'nothing defines channel {record.channel_id} of a message')
    times = record.log_time, record.publish_time
    message = Message(channel, record.data, *times, record.sequence)
    if not message.has_valid_times:
        raise ValueError(f'a message has the times {times} ns, beyond {LATEST}')
    return message
