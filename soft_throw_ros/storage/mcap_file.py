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
A finished MCAP file of a bag.

The library `mcap` parses all records. The index at the end of the file is checked before it is
used, because a bag may come from anybody.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
import struct
import zlib

from mcap import records as mcap
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.storage.mcap_records import (
    DamageError,
    Definitions,
    LIBRARY_ERRORS,
    MAX_RECORD,
    RecordFile,
    Shared,
    size_of,
    unpack,
)
from soft_throw_ros.storage.message import BagError, Channel, Message

MAX_INDEX = 15 * 2**20
"""Largest size of the index at the end of a file [bytes]: a day of a twin."""

_INDEX_MEMORY = 16
"""Memory that the parsed index takes at most, over its size in the file. [-]"""

_FOOTER = struct.Struct('<BQQQI')
"""The footer: its head, the offsets of summary and summary offsets, and the checksum."""


class UnfinishedError(BagError):
    """A file is damaged or unfinished; `recover` can copy its messages to a new bag."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(
            f'{path}: {reason}; write a new bag of all that can be read: soft-throw recover BAG'
        )


class McapFile:
    """
    A finished MCAP file.

    Raises
    ------
    UnfinishedError
        If the file has no sound index.
    BagError
        If it is no MCAP file of ROS 2.

    """

    def __init__(self, path: Path, shared: Shared) -> None:
        self.path = path
        self.chunks: list[mcap.ChunkIndex] = []  # in the order of the file
        self.metadata: list[mcap.Metadata] = []
        self._definitions = Definitions(shared)
        self._shared = shared
        self._file = RecordFile(path)
        try:
            self.counts = self._read_index()  # of the messages of each channel
        except BagError as error:
            self.close()
            raise BagError(f'{path}: {error}') from None
        except LIBRARY_ERRORS as error:
            self.close()
            raise UnfinishedError(path, f'the file has no sound end, {error!s:.200}') from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def chunks_with(self, topics: Collection[str] | None, span: range) -> list[mcap.ChunkIndex]:
        """Return the chunks that may have messages of topics and log times."""
        channels = self._definitions.channels
        wanted = {
            number for number, channel in channels.items()
            if topics is None or channel.topic in topics
        }
        return [
            chunk
            for chunk in self.chunks
            if chunk.message_start_time < span.stop
            and chunk.message_end_time >= span.start
            and (not chunk.message_index_offsets or wanted & chunk.message_index_offsets.keys())
        ]

    def read_chunk(self, chunk: mcap.ChunkIndex) -> list[Message]:
        """Return the messages of a chunk in their order; raise UnfinishedError for damage."""
        try:
            records = unpack(self._file.record(chunk.chunk_start_offset))
            return [
                self._definitions.message(record)
                for record in records if isinstance(record, mcap.Message)
            ]
        except DamageError as error:
            raise UnfinishedError(self.path, str(error)) from None

    def _read_index(self) -> dict[Channel, int]:
        """Read the index at the end of the file; return the number of messages by channel."""
        statistics: mcap.Statistics | None = None
        attachments = 0
        for record in self._index_records():
            match record:
                case mcap.Schema() | mcap.Channel():
                    self._definitions.add(record)
                case mcap.ChunkIndex():
                    self.chunks.append(record)
                case mcap.AttachmentIndex():
                    attachments += 1
                case mcap.MetadataIndex():
                    text = self._file.record(record.offset)
                    if not isinstance(text, mcap.Metadata):
                        raise DamageError(f'its index has no text at {record.offset}')
                    self._shared.keep(size_of(text))
                    self.metadata.append(text)
                case mcap.Statistics():
                    statistics = record
        if statistics is None:
            raise DamageError('its index has no statistics')
        self._check_chunks()
        present = len(self.chunks), len(self.metadata), attachments
        promised = statistics.chunk_count, statistics.metadata_count, statistics.attachment_count
        if promised != present:
            raise DamageError(f'its index has {present} chunks, texts and files, not {promised}')
        if statistics.message_count and not self.chunks:
            raise DamageError('its messages are not in chunks')
        return self._count_messages(statistics)

    def _index_records(self) -> Iterator[mcap.McapRecord]:
        """Yield the records of the index; raise DamageError if it is damaged or missing."""
        file = self._file
        footer = file.read(max(file.size - len(MAGIC) - _FOOTER.size, 0), file.size)
        if len(footer) < _FOOTER.size + len(MAGIC) or not footer.endswith(MAGIC):
            raise DamageError('it was cut off or is being written')
        _, _, begin, _, checksum = _FOOTER.unpack(footer[: -len(MAGIC)])
        size = file.size - begin
        if not begin or not 0 < size <= MAX_INDEX:
            raise DamageError(f'its index begins at {begin} of {file.size} bytes')
        content = file.read(begin, file.size)
        if checksum not in (0, zlib.crc32(memoryview(content)[: -len(MAGIC) - 4])):
            raise DamageError('the checksum of its index is wrong')
        self._shared.keep(_INDEX_MEMORY * size)
        yield from StreamReader(BytesIO(content), skip_magic=True, emit_chunks=True).records

    def _check_chunks(self) -> None:
        """Sort the chunks by offset; raise DamageError if two overlap or one is too large."""
        self.chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
        end = len(MAGIC)
        for chunk in self.chunks:
            if chunk.chunk_start_offset < end or chunk.uncompressed_size > MAX_RECORD:
                raise DamageError(f'the chunk at {chunk.chunk_start_offset} is out of bounds')
            end = chunk.chunk_start_offset + chunk.chunk_length

    def _count_messages(self, statistics: mcap.Statistics) -> dict[Channel, int]:
        channels = self._definitions.channels
        counts = dict.fromkeys(channels.values(), 0)
        for number, count in statistics.channel_message_counts.items():
            if number not in channels:
                raise DamageError(f'nothing defines channel {number}')
            counts[channels[number]] += count
        return counts
