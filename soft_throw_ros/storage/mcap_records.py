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
Records of MCAP files, read one by one within limits.

The library `mcap` parses all records. The sizes and counts that it leaves unbounded are checked
here before it is called, because a bag may come from anybody.
"""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
import os
from pathlib import Path
import struct
import sys
from typing import Any, BinaryIO
import zlib

import lz4.frame
from mcap import records as mcap
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import breakup_chunk, StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message, OVERHEAD
from soft_throw_ros.storage.regular_file import open_regular_file
import zstandard

MAX_RECORD = 64 * 2**20
"""Largest size of a record, a message or an unpacked chunk. [bytes]"""

MAX_RECORDS = 250_000
"""Largest number of records in a chunk [-]: they take 100 MB."""

MAX_KEPT = 256 * 2**20
"""Largest size of everything that a reader keeps of a bag: definitions, index and such. [bytes]"""

MAX_ATTACHED = 128 * 2**20
"""Largest size of all attachments of a file. [bytes]"""

HEAD = struct.Struct('<BQ')
"""Head of a record: opcode and length."""

LIBRARY_ERRORS = (
    *(McapError, ValueError, LookupError, ArithmeticError, EOFError, MemoryError, TypeError),
    *(OSError, RuntimeError, struct.error, zstandard.ZstdError),
)
"""Exceptions that the libraries raise for damaged bytes."""

CONVERSION = 'convert it, as with rosbags: rosbags-convert --src BAG --dst NEW --dst-storage mcap'

_OPCODES = {*map(int, Opcode), *range(0x80, 0x100)}  # those from 0x80 on are private records

_OTHER_FORMATS = {
    b'SQLite format 3': 'is a bag in sqlite3, not in MCAP',
    b'#ROSBAG V': 'is a bag of ROS 1, not in MCAP',
    b'\x28\xb5\x2f\xfd': 'is compressed as a whole',
}
"""First bytes of files of other formats, with a description."""


class DamageError(ValueError):
    """Bytes are not a valid record; the message gives the reason."""


class Shared:
    """The channels of all files of a bag, and the memory that their readers keep."""

    def __init__(self) -> None:
        self._channels: dict[tuple[object, ...], Channel] = {}
        self._kept = 0  # [bytes]

    def unify(self, channel: Channel) -> Channel:
        """Return the first of all equal channels."""
        return self._channels.setdefault(tuple(vars(channel).values()), channel)

    def keep(self, size: int) -> None:
        """Add the size of an object [bytes]; raise BagError above `MAX_KEPT` in all."""
        self._kept += size + OVERHEAD
        if self._kept > MAX_KEPT:
            raise BagError(f'to read it takes more than {MAX_KEPT} bytes of memory')


class Definitions:
    """The channels of a file by their numbers in it."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._schemas: dict[int, mcap.Schema] = {}
        self._records: dict[int, mcap.Channel] = {}
        self._channels: dict[int, Channel] = {}

    def add(self, record: mcap.Schema | mcap.Channel) -> None:
        """Add a definition, unless there is one with the same number."""
        records: dict[int, Any] = (
            self._schemas if isinstance(record, mcap.Schema) else self._records
        )
        if record.id not in records:
            self._shared.keep(size_of(record))
            records[record.id] = record
            self._channels.clear()

    @property
    def channels(self) -> dict[int, Channel]:
        """The channels that have a schema; raise BagError if one is not of ROS 2."""
        if not self._channels:
            self._channels = {
                number: self._make(record, self._schemas[record.schema_id])
                for number, record in self._records.items()
                if record.schema_id in self._schemas
            }
        return self._channels

    def message(self, record: mcap.Message) -> Message:
        """Return a message, or raise DamageError."""
        channel = self.channels.get(record.channel_id)
        if channel is None:
            raise DamageError(f'nothing defines channel {record.channel_id} of a message')
        times = record.log_time, record.publish_time
        message = Message(channel, record.data, *times, record.sequence)
        if not message.has_valid_times:
            raise DamageError(f'a message has the times {times} ns, beyond {LATEST}')
        return message

    def _make(self, record: mcap.Channel, schema: mcap.Schema) -> Channel:
        if record.message_encoding != 'cdr':
            raise BagError(
                f'{record.topic} has messages in {record.message_encoding!r}, not in '
                "'cdr' as those of ROS 2 are"
            )
        return self._shared.unify(Channel(
            topic=record.topic,
            type=schema.name,
            schema=schema.data.decode(errors='replace'),
            type_hash=record.metadata.get('topic_type_hash', ''),
            qos=record.metadata.get('offered_qos_profiles', ''),
            schema_encoding=schema.encoding,
        ))


class RecordFile:
    """
    A file whose records are read at given offsets, each within the limits of size.

    BagError is raised if it cannot be opened, is empty, or is in another format. If `is_lenient`,
    it may begin otherwise than an MCAP file.
    """

    def __init__(self, path: Path, *, is_lenient: bool = False) -> None:
        self.path = path
        self.stream = _open(path, is_lenient=is_lenient)
        self.size = os.fstat(self.stream.fileno()).st_size
        self._attached = 0  # size of the attachments that were read [bytes]

    def close(self) -> None:
        """Close the file."""
        self.stream.close()

    def read(self, begin: int, end: int) -> bytes:
        """Return the bytes between two offsets."""
        return os.pread(self.stream.fileno(), end - begin, begin)

    def head(self, offset: int) -> tuple[int, int]:
        """Return the opcode of a record and the offset of its end; raise DamageError."""
        head = self.read(offset, offset + HEAD.size).ljust(HEAD.size, b'\0')
        opcode, length = HEAD.unpack(head)
        if opcode not in _OPCODES:
            raise DamageError(f'no record begins with {opcode:#04x}')
        if length > MAX_RECORD:
            raise DamageError(f'a record of {length} bytes, which is more than {MAX_RECORD}')
        if offset + HEAD.size + length > self.size:
            raise DamageError('it ends within a record')
        return opcode, offset + HEAD.size + length

    def record(self, offset: int) -> mcap.McapRecord | None:
        """Return a record, None if it is a private one; raise DamageError if it is damaged."""
        opcode, end = self.head(offset)
        is_attachment = opcode == Opcode.ATTACHMENT
        self._attached += (end - offset) * is_attachment
        if is_attachment and self._attached > MAX_ATTACHED:
            raise DamageError(f'attachments have more than {MAX_ATTACHED} bytes')
        data = self.read(offset, end)
        checksum = int.from_bytes(data[-4:], 'little')
        if is_attachment and checksum not in (0, zlib.crc32(memoryview(data)[HEAD.size:-4])):
            raise DamageError('the checksum of the attachment there is wrong')
        if opcode >= 0x80:
            return None
        try:  # a stream of one record, so that no damaged length leads beyond the record
            return next(StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records)
        except (*LIBRARY_ERRORS, StopIteration) as error:
            raise DamageError(f'the record there is damaged, {error!r:.100}') from None


def unpack(chunk: mcap.McapRecord | None) -> list[mcap.McapRecord]:
    """Return the records of a chunk, or raise DamageError."""
    if not isinstance(chunk, mcap.Chunk):
        raise DamageError('there is no chunk')
    try:
        data = _decompress(chunk)
        _check_record_count(data)
        return breakup_chunk(replace(chunk, compression='', data=data), validate_crc=True)
    except DamageError:
        raise
    except LIBRARY_ERRORS as error:
        raise DamageError(f'the chunk there cannot be unpacked, {error!s:.100}') from None


def _decompress(chunk: mcap.Chunk) -> bytes:
    """Return the bytes of all records of a chunk; raise DamageError if it is beyond the limits."""
    size = chunk.uncompressed_size
    if chunk.compression and size > MAX_RECORD:
        raise DamageError(f'the chunk there claims {size} bytes, which is more than {MAX_RECORD}')
    if chunk.compression == '':
        data = chunk.data
    elif chunk.compression == 'zstd':
        claimed = zstandard.frame_content_size(chunk.data)
        if claimed not in (-1, size):
            raise DamageError(f'the chunk there claims {size} bytes, and its data {claimed}')
        data = zstandard.decompress(chunk.data, size)
    elif chunk.compression == 'lz4':
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, size + 1)
    else:
        raise DamageError(f'the chunk there is compressed by {chunk.compression!r:.40}')
    if len(data) != size:
        raise DamageError(f'the chunk there claims {size} bytes, and has {len(data)} or more')
    return data


def size_of(record: mcap.Schema | mcap.Channel | mcap.Metadata) -> int:
    """Return the size of a record in memory [bytes]."""
    if isinstance(record, mcap.Schema):
        return len(record.data) + len(record.name)
    return sum(len(key) + len(value) + OVERHEAD for key, value in record.metadata.items())


def _check_record_count(data: bytes) -> None:
    """Raise DamageError if the bytes of a chunk have more than `MAX_RECORDS` records."""
    count = offset = 0
    while offset + HEAD.size <= len(data):
        offset += HEAD.size + HEAD.unpack_from(data, offset)[1]
        count += 1
        if count > MAX_RECORDS:
            raise DamageError(f'the chunk there has more than {MAX_RECORDS} records')


def _open(path: Path, *, is_lenient: bool) -> BinaryIO:
    """Open an MCAP file; raise BagError for files of other formats."""
    try:
        stream = open_regular_file(path, max_bytes=sys.maxsize)
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    begin = stream.read(16)
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
