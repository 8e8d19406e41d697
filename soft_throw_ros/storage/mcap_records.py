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
"""
Parts of reading MCAP files that finished and damaged files have in common.

The library `mcap` parses all records. Sizes that a file claims are compared with a limit before
the library reads or unpacks the data.
"""

from __future__ import annotations

from collections.abc import Mapping
import os
from pathlib import Path
import struct
import sys
from typing import BinaryIO
import zlib

from mcap import records as mcap
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message
from soft_throw_ros.storage.regular_file import open_regular_file

MAX_RECORD = 64 * 2**20
"""Largest size of a record, of an unpacked chunk, and of the index of a file. [bytes]"""

HEAD = struct.Struct('<BQ')
"""Head of a record: opcode and length."""

_END = struct.Struct('<BQQQI8s')
"""End of a file: head of the footer, offsets of both parts of the index, checksum, magic bytes."""

CONVERSION = 'convert it, as with rosbags: rosbags-convert --src BAG --dst NEW --dst-storage mcap'

_OTHER_FORMATS = {
    b'SQLite format 3': 'is a bag in sqlite3, not in MCAP',
    b'#ROSBAG V': 'is a bag of ROS 1, not in MCAP',
    b'\x28\xb5\x2f\xfd': 'is compressed as a whole',
}
"""First bytes of files of other formats, with a description."""

KnownChannels = dict[tuple[object, ...], Channel]
"""One channel for all equal ones in the files of a bag, by its values."""


class DamageError(ValueError):
    """Bytes are not a valid part of an MCAP file; the message gives the reason."""


def reason_of(error: Exception) -> str:
    """Return the text of an error, or its type if it has no text."""
    return f'{str(error) or type(error).__name__:.200}'


def open_mcap(path: Path, *, is_lenient: bool = False) -> BinaryIO:
    """
    Open an MCAP file, which may have a damaged beginning if `is_lenient`.

    BagError is raised if the file cannot be opened, is empty, or has another format.
    """
    try:
        stream = open_regular_file(path, max_bytes=sys.maxsize)
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    begin = stream.read(16)
    stream.seek(0)
    reason = '' if begin.startswith(MAGIC) or is_lenient else 'is no MCAP file'
    if not begin:
        reason = 'is empty'
    for magic, kind in _OTHER_FORMATS.items():
        if begin.startswith(magic):
            reason = f'{kind}; {CONVERSION}'
    if reason:
        stream.close()
        raise BagError(f'{path} {reason}')
    return stream


def check_end(stream: BinaryIO) -> None:
    """Raise DamageError if a file has no complete end, or the checksum of its index is wrong."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - _END.size, 0))
    end = stream.read()
    if len(end) < _END.size or not end.endswith(MAGIC):
        raise DamageError('it was cut off or is being written')
    _, _, begin, _, checksum, _ = _END.unpack(end)
    if not begin or not 0 < size - begin <= MAX_RECORD:
        raise DamageError(f'its index begins at {begin} of {size} bytes')
    stream.seek(begin)
    index = stream.read()
    if checksum not in (0, zlib.crc32(memoryview(index)[: -len(MAGIC) - 4])):
        raise DamageError('the checksum of its index is wrong')


def unpack(chunk: mcap.Chunk) -> list[mcap.McapRecord]:
    """Return the records of a chunk; any error is raised if it is damaged."""
    if chunk.uncompressed_size > MAX_RECORD:
        raise DamageError(f'a chunk of {chunk.uncompressed_size} bytes, more than {MAX_RECORD}')
    return breakup_chunk(chunk, validate_crc=True)


def make_channels(
    records: Mapping[int, mcap.Channel], schemas: Mapping[int, mcap.Schema], known: KnownChannels
) -> dict[int, Channel]:
    """Return the channels of a file that have a schema; raise BagError if one is not of ROS 2."""
    channels = {}
    for number, record in records.items():
        schema = schemas.get(record.schema_id)
        if schema is None:
            continue
        if record.message_encoding != 'cdr':
            raise BagError(
                f'{record.topic} has messages in {record.message_encoding!r}, not in '
                "'cdr' as those of ROS 2 are"
            )
        channel = Channel(
            topic=record.topic,
            type=schema.name,
            schema=schema.data.decode(errors='replace'),
            type_hash=record.metadata.get('topic_type_hash', ''),
            qos=record.metadata.get('offered_qos_profiles', ''),
            schema_encoding=schema.encoding,
        )
        channels[number] = known.setdefault(tuple(vars(channel).values()), channel)
    return channels


def make_message(record: mcap.Message, channels: Mapping[int, Channel]) -> Message:
    """Return a message; raise DamageError if its channel is not defined or its times are none."""
    channel = channels.get(record.channel_id)
    if channel is None:
        raise DamageError(f'nothing defines channel {record.channel_id} of a message')
    times = record.log_time, record.publish_time
    message = Message(channel, record.data, *times, record.sequence)
    if not message.has_valid_times:
        raise DamageError(f'a message has the times {times} ns, beyond {LATEST}')
    return message
