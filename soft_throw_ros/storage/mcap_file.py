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
A finished MCAP file of a bag, read by the library `mcap`.

The order of messages is that of `BagReader`, because the readers of the library (1.6) are too slow
or keep too much: `SeekingReader` sorts messages with Python functions as comparisons, and in the
order of writing it keeps all messages of the file in memory.
"""

from __future__ import annotations

from collections.abc import Collection
from io import BytesIO
from pathlib import Path

from mcap import records as mcap
from mcap.data_stream import ReadDataStream
from mcap.reader import SeekingReader
from mcap.summary import Summary
from soft_throw_ros.storage.mcap_records import (
    check_end,
    DamageError,
    HEAD,
    KnownChannels,
    make_channels,
    make_message,
    MAX_RECORD,
    open_mcap,
    reason_of,
    unpack,
)
from soft_throw_ros.storage.message import BagError, Message


class UnfinishedError(BagError):
    """A file is damaged or unfinished; `recover` can copy its messages to a new bag."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(
            f'{path}: {reason}; write a new bag of all that can be read: soft-throw recover BAG'
        )


class McapFile:
    """
    A finished MCAP file.

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

    def __init__(self, path: Path, known: KnownChannels) -> None:
        self.path = path
        self._stream = open_mcap(path)
        try:
            check_end(self._stream)
            self._stream.seek(0)
            reader = SeekingReader(self._stream, record_size_limit=MAX_RECORD)
            self._read_index(reader.get_summary(), known)
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
        except Exception as error:  # as above
            reason = f'the chunk at {chunk.chunk_start_offset} is damaged, {reason_of(error)}'
            raise UnfinishedError(self.path, reason) from error

    def _read_index(self, summary: Summary | None, known: KnownChannels) -> None:
        """Take over the index; raise DamageError if a part is missing or a chunk is too large."""
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
        self._channels = make_channels(summary.channels, summary.schemas, known)
        self.counts = dict.fromkeys(self._channels.values(), 0)
        for number, count in statistics.channel_message_counts.items():
            if number not in self._channels:
                raise DamageError(f'nothing defines channel {number}')
            self.counts[self._channels[number]] += count
