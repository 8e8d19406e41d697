# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A finished MCAP file of a bag, and the functions that recovery shares with it.

The library `mcap` parses all records. Sizes that a file claims are compared with a limit before
the library reads or unpacks the data.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
import functools
from io import BytesIO
import os
from pathlib import Path
import struct
import sys
from typing import BinaryIO
import zlib

from mcap import records as mcap
from mcap.data_stream import ReadDataStream
from mcap.reader import SeekingReader
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
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

_unique_channel = functools.cache(Channel)
"""Return one object for all equal channels, since the files of a bag repeat them."""


class DamageError(ValueError):
    """Bytes are not a valid part of an MCAP file; the message gives the reason."""


class UnfinishedError(BagError):
    """A file is damaged or unfinished; `recover` can copy its messages to a new bag."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(
            f'{path}: {reason}; write a new bag of all that can be read: soft-throw recover BAG'
        )


def reason_of(error: Exception) -> str:
    """Return the text of an error, or its type if it has no text."""
    return f'{str(error) or type(error).__name__:.200}'


def open_mcap(path: Path) -> BinaryIO:
    """Open an MCAP file; raise BagError if it cannot be opened, is empty or no MCAP file."""
    try:
        stream = open_regular_file(path, max_bytes=sys.maxsize)
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    begin = stream.read(16)
    stream.seek(0)
    reason = '' if begin.startswith(MAGIC) else 'is no MCAP file'
    if not begin:
        reason = 'is empty'
    for magic, kind in _OTHER_FORMATS.items():
        if begin.startswith(magic):
            reason = f'{kind}; {CONVERSION}'
    if reason:
        stream.close()
        raise BagError(f'{path} {reason}')
    return stream


def _check_end(stream: BinaryIO) -> None:
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
    """Return the records of a chunk; the library raises errors of many kinds for damage."""
    if chunk.uncompressed_size > MAX_RECORD:
        raise DamageError(f'a chunk of {chunk.uncompressed_size} bytes, more than {MAX_RECORD}')
    return breakup_chunk(chunk, validate_crc=True)


def make_channels(
    records: Mapping[int, mcap.Channel], schemas: Mapping[int, mcap.Schema]
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
        channels[number] = _unique_channel(
            topic=record.topic,
            type=schema.name,
            schema=schema.data.decode(errors='replace'),
            type_hash=record.metadata.get('topic_type_hash', ''),
            qos=record.metadata.get('offered_qos_profiles', ''),
            schema_encoding=schema.encoding,
        )
    return channels


def make_message(record: mcap.Message, channels: Mapping[int, Channel]) -> Message:
    """Return a message; raise DamageError if its channel or its times are invalid."""
    channel = channels.get(record.channel_id)
    if channel is None:
        raise DamageError(f'nothing defines channel {record.channel_id} of a message')
    times = record.log_time, record.publish_time
    message = Message(channel, record.data, *times, record.sequence)
    if not message.has_valid_times:
        raise DamageError(f'a message has the times {times} ns, beyond {LATEST}')
    return message


class McapFile:
    """
    A finished MCAP file.

    `BagReader` puts the messages in order. The `SeekingReader` of mcap 1.6 takes 1.6 times as
    long, because it sorts by comparisons in Python; in the order of writing, it keeps all messages
    of a file in memory.

    Attributes
    ----------
    metadata : list of mcap.Metadata
        Named texts in their order.
    statistics : mcap.Statistics
        Numbers of messages, and the log times of the first and the last one. [ns]
    counts : dict of Channel to int
        Numbers of messages.

    Raises
    ------
    UnfinishedError
        If the file has no sound index.
    BagError
        If it is no MCAP file of ROS 2.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stream = open_mcap(path)
        try:
            _check_end(self._stream)
            self._stream.seek(0)
            reader = SeekingReader(self._stream, record_size_limit=MAX_RECORD)
            self._read_index(reader.get_summary())
            self.metadata = list(reader.iter_metadata())
        except BagError as error:
            self.close()
            raise BagError(f'{path}: {error}') from None
        except Exception as error:  # damaged bytes may cause any error in the library
            self.close()
            reason = f'the file has no sound end, {reason_of(error)}'
            raise UnfinishedError(path, reason) from error

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def chunks_with(self, topics: Collection[str] | None, span: range) -> list[mcap.ChunkIndex]:
        """Return the chunks that may have messages of topics and log times."""
        wanted = {
            number for number, channel in self._channels.items()
            if topics is None or channel.topic in topics
        }
        return [
            chunk
            for chunk in self._chunks
            if chunk.message_start_time < span.stop
            and chunk.message_end_time >= span.start
            and (not chunk.message_index_offsets or wanted & chunk.message_index_offsets.keys())
        ]

    def read_chunk(self, chunk: mcap.ChunkIndex) -> list[Message]:
        """Return the messages of a chunk in their order; raise UnfinishedError for damage."""
        try:
            self._stream.seek(chunk.chunk_start_offset + HEAD.size)
            data = self._stream.read(chunk.chunk_length - HEAD.size)
            return [
                make_message(record, self._channels)
                for record in unpack(mcap.Chunk.read(ReadDataStream(BytesIO(data))))
                if isinstance(record, mcap.Message)
            ]
        except Exception as error:  # damaged bytes may cause any error in the library
            reason = f'the chunk at {chunk.chunk_start_offset} is damaged, {reason_of(error)}'
            raise UnfinishedError(self.path, reason) from error

    def _read_index(self, summary: Summary | None) -> None:
        """Keep the index; raise DamageError if a part is missing or a chunk is too large."""
        if summary is None or summary.statistics is None:
            raise DamageError('its index has no statistics')
        self.statistics = statistics = summary.statistics
        present = len(summary.chunk_indexes), len(summary.metadata_indexes)
        promised = statistics.chunk_count, statistics.metadata_count
        if promised != present:
            raise DamageError(f'its index has {present} chunks and texts, not {promised}')
        if statistics.message_count and not summary.chunk_indexes:
            raise DamageError('its messages are not in chunks')
        self._chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
        for chunk in self._chunks:
            size = max(chunk.chunk_length, chunk.uncompressed_size)
            if size > MAX_RECORD:
                raise DamageError(f'it has a chunk of {size} bytes, more than {MAX_RECORD}')
        self._channels = make_channels(summary.channels, summary.schemas)
        self.counts = dict.fromkeys(self._channels.values(), 0)
        for number, count in statistics.channel_message_counts.items():
            if number not in self._channels:
                raise DamageError(f'nothing defines channel {number}')
            self.counts[self._channels[number]] += count
