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
A finished MCAP file of a bag, read by the reader of the library `mcap`.

That reader believes the index at the end of a file, and unpacks chunks of any size. So the index
is checked before it is used, and every chunk before the library reads it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
import io
from pathlib import Path
import struct
import zlib

from mcap import records as mcap
from mcap.reader import SeekingReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.recording.mcap_records import (
    count_messages,
    DamageError,
    decompress,
    Definitions,
    HEAD,
    LIBRARY_ERRORS,
    MAX_RECORD,
    MAX_RECORDS,
    Memory,
    OVERHEAD,
    RecordFile,
    size_of,
)
from soft_throw_ros.recording.message import BagError, Channel, Message

MAX_INDEX = 15 * 2**20
"""Largest size of the index at the end of a file [bytes]: a day of a twin."""

_INDEX_MEMORY = 16
"""Memory that the parsed index takes at most, over its size in the file. [-]"""

_FOOTER = struct.Struct('<BQQQI')
"""The footer: its head, the offsets of summary and summary offsets, and the checksum."""

_INDEX_ENTRY = 16
"""Size of the entry of a message in the index of its chunk. [bytes]"""

_SMALLEST_MESSAGE = 31
"""Size of the record of a message without data. [bytes]"""


class UnfinishedError(BagError):
    """A file is damaged or unfinished; `recover` can copy its messages to a new bag."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(
            f'{path}: {reason}; write a new bag of all that can be read: soft-throw recover BAG'
        )


class McapFile:
    """
    A finished MCAP file.

    Parameters
    ----------
    path : Path
        The file.
    known : dict
        Channels of all files of the bag; equal channels become one object.
    memory : Memory
        Budget of the bag.

    Attributes
    ----------
    chunks : list of ChunkIndex
        Chunks of messages, in the order of the file.
    counts : dict of Channel to int
        Number of messages of each channel.
    metadata : list of Metadata
        Named texts.

    Raises
    ------
    UnfinishedError
        If the file has no sound index.
    BagError
        If it is no MCAP file of ROS 2.

    """

    def __init__(
        self, path: Path, known: dict[tuple[object, ...], Channel], memory: Memory
    ) -> None:
        self.path = path
        self._definitions = Definitions(known, memory)
        self._memory = memory
        self._file = RecordFile(path)
        self._stream = _CheckedStream(self._file)
        try:
            self._reader = SeekingReader(
                self._stream,  # type: ignore[arg-type]  # it has what the reader calls
                validate_crcs=True,
                record_size_limit=MAX_RECORD,
            )
            summary = self._read_summary()
            self.chunks = self._checked_chunks(summary)
            self.metadata = self._read_metadata(summary)
            self._attachments = [index.offset for index in summary.attachment_indexes]
            self.counts = self._checked_counts(summary)
        except BagError as error:
            self.close()
            raise BagError(f'{path}: {error}') from None
        except LIBRARY_ERRORS as error:
            self.close()
            raise UnfinishedError(path, f'the file has no sound end, {error!s:.200}') from None

    @property
    def start_time(self) -> int:
        """Log time of the first message; 0 if there is none [ns]."""
        return min((chunk.message_start_time for chunk in self.chunks), default=0)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def attachments(self) -> Iterator[mcap.Attachment]:
        """Yield the attached files; raise UnfinishedError if one is damaged."""
        for offset in self._attachments:
            try:
                record = self._file.record(offset)
            except DamageError as error:
                raise UnfinishedError(self.path, f'at {offset}: {error}') from None
            if isinstance(record, mcap.Attachment):
                yield record

    def messages(
        self, topics: Collection[str] | None, span: range, *, by_log_time: bool
    ) -> Iterator[Message]:
        """Yield messages of topics and times; raise UnfinishedError where the file is damaged."""
        items = self._reader.iter_messages(
            topics, starting_at=span.start, ending_before=span.stop, log_time_order=by_log_time
        )
        try:
            for _, _, record in items if span and self.chunks else ():
                yield self._definitions.message(record)
        except LIBRARY_ERRORS as error:
            raise UnfinishedError(self.path, f'{error!s:.200}') from None

    def _read_summary(self) -> Summary:
        """Read the index at the end of the file; raise DamageError if it is damaged or missing."""
        file = self._file
        footer = file.read(max(file.size - len(MAGIC) - _FOOTER.size, 0), file.size)
        if len(footer) < _FOOTER.size + len(MAGIC) or not footer.endswith(MAGIC):
            raise DamageError('it was cut off or is being written')
        _, _, begin, _, checksum = _FOOTER.unpack(footer[: -len(MAGIC)])
        size = file.size - begin
        if not begin or not 0 < size <= MAX_INDEX:
            raise DamageError(f'its index begins at {begin} of {file.size} bytes')
        content = memoryview(file.read(begin, file.size))[: -len(MAGIC) - 4]
        if checksum not in (0, zlib.crc32(content)):
            raise DamageError('the checksum of its index is wrong')
        self._memory.keep(_INDEX_MEMORY * size)
        summary = self._reader.get_summary()
        if summary is None or summary.statistics is None:
            raise DamageError('its index has no statistics')
        for schema in summary.schemas.values():
            self._definitions.add(schema)
        for channel in summary.channels.values():
            self._definitions.add(channel)
        return summary

    def _checked_chunks(self, summary: Summary) -> list[mcap.ChunkIndex]:
        chunks = sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
        end = len(MAGIC)
        for chunk in chunks:
            if chunk.chunk_start_offset < end or chunk.uncompressed_size > MAX_RECORD:
                raise DamageError(f'the chunk at {chunk.chunk_start_offset} is out of bounds')
            end = chunk.chunk_start_offset + chunk.chunk_length
            self._stream.chunks[chunk.chunk_start_offset + HEAD.size] = chunk
        return chunks

    def _checked_counts(self, summary: Summary) -> dict[Channel, int]:
        statistics, channels = summary.statistics, self._definitions.channels
        assert statistics is not None
        present = len(self.chunks), len(self.metadata), len(self._attachments)
        promised = statistics.chunk_count, statistics.metadata_count, statistics.attachment_count
        if promised != present:
            raise DamageError(f'its index has {present} chunks, texts and files, not {promised}')
        if statistics.message_count and not self.chunks:
            raise DamageError('its messages are not in chunks')
        counts = dict.fromkeys(channels.values(), 0)
        for number, count in statistics.channel_message_counts.items():
            if number not in channels:
                raise DamageError(f'nothing defines channel {number}')
            counts[channels[number]] += count
        return counts

    def _read_metadata(self, summary: Summary) -> list[mcap.Metadata]:
        records = [self._file.record(index.offset) for index in summary.metadata_indexes]
        texts = [record for record in records if isinstance(record, mcap.Metadata)]
        for text in texts:
            self._memory.keep(size_of(text))
        return texts


def memory_of(chunk: mcap.ChunkIndex) -> int:
    """Return the memory that the messages of a chunk take, by the index [bytes]."""
    return chunk.uncompressed_size + OVERHEAD * min(_message_count(chunk), MAX_RECORDS)


def _message_count(chunk: mcap.ChunkIndex) -> int:
    """Return the largest number of messages of a chunk, by the index."""
    if chunk.message_index_length:
        return chunk.message_index_length // _INDEX_ENTRY
    return chunk.uncompressed_size // _SMALLEST_MESSAGE


class _CheckedStream:
    """
    A file that checks a chunk before the reader of `mcap` reads the chunk.

    Attributes
    ----------
    chunks : dict of int to ChunkIndex
        Chunks by the offset that the reader seeks to, behind opcode and length.

    """

    def __init__(self, file: RecordFile) -> None:
        self.chunks: dict[int, mcap.ChunkIndex] = {}
        self._file = file
        self._offset = 0

    def seekable(self) -> bool:
        """Return true."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Seek to an offset; raise DamageError if a chunk there exceeds the limits."""
        self._offset = max(offset + (self._file.size if whence == io.SEEK_END else 0), 0)
        chunk = self.chunks.get(self._offset)
        if chunk is not None:
            self._check(chunk)
        return self._offset

    def read(self, size: int = -1) -> bytes:
        """Read at most as much as the file has."""
        end = self._file.size if size < 0 else min(self._offset + size, self._file.size)
        data = self._file.read(self._offset, max(end, self._offset))
        self._offset += len(data)
        return data

    def _check(self, chunk: mcap.ChunkIndex) -> None:
        """Raise DamageError if a chunk has more messages or bytes than the index says."""
        record = self._file.record(chunk.chunk_start_offset)
        place = f'the chunk at {chunk.chunk_start_offset}'
        size = chunk.uncompressed_size
        if not isinstance(record, mcap.Chunk) or record.uncompressed_size > size:
            raise DamageError(f'{place} is not the one of the index')
        if count_messages(decompress(record)) > _message_count(chunk):
            raise DamageError(f'{place} has more messages than the index says')
