# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Finished bags of this package and of other recorders, parsed by the library `mcap`."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
import contextlib
import functools
import heapq
import io
import itertools
import operator
import os
from pathlib import Path
import struct
import sys
import zlib

from mcap import records as mcap
from mcap.reader import SeekingReader
from mcap.stream_reader import breakup_chunk, StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.storage.bag_folder import BagFolder, check_not_written, NO_MCAP
from soft_throw_ros.storage.message import BagError, Channel, Message
from soft_throw_ros.storage.regular_file import open_regular_file

MAX_RECORD = 64 * 2**20
"""Largest size of a record, an unpacked chunk, an index, and a file without an index. [bytes]"""

_END = struct.Struct('<BQQQI8s')
"""End of a file: head of the footer, offsets of both parts of the index, checksum, magic bytes."""

_log_time = operator.attrgetter('log_time')

_unique_channel = functools.cache(Channel)  # the files of a bag repeat their channels


class UnfinishedError(BagError):
    """A file is damaged or unfinished; `recover` can copy its messages to a new bag."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(
            f'{path}: {reason}; write a new bag of all that can be read: soft-throw recover BAG'
        )


class _BoundedFile(io.BufferedReader):
    """A file that refuses to read more than `MAX_RECORD` at once, whatever its records claim."""

    def read(self, size: int | None = -1) -> bytes:
        _check_size(size or 0)
        return super().read(size)


def _check_size(size: int) -> None:
    """Raise ValueError for too large a size [bytes]."""
    if size > MAX_RECORD:
        raise ValueError(f'record, chunk, unindexed file of {size} bytes, more than {MAX_RECORD}')


def open_mcap(path: Path) -> io.BufferedReader:
    """Open an MCAP file; raise BagError if it cannot be opened, is empty or no MCAP file."""
    try:
        stream = _BoundedFile(open_regular_file(path, max_bytes=sys.maxsize).detach())
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    begin = stream.peek(len(MAGIC))
    if not begin.startswith(MAGIC):
        stream.close()
        raise BagError(f'{path} {NO_MCAP if begin else "is empty"}')
    return stream


def _make_channel(record: mcap.Channel, schemas: Mapping[int, mcap.Schema]) -> Channel:
    """Return a channel; raise BagError if it is not of ROS 2."""
    if record.message_encoding != 'cdr':
        raise BagError(f"{record.topic} has messages in {record.message_encoding!r}, not in 'cdr'")
    schema = schemas[record.schema_id]
    return _unique_channel(
        topic=record.topic, type=schema.name, schema=schema.data.decode(errors='replace'),
        type_hash=record.metadata.get('topic_type_hash', ''), schema_encoding=schema.encoding,
        qos=record.metadata.get('offered_qos_profiles', ''),
    )


def _make_message(record: mcap.Message, channels: Mapping[int, Channel]) -> Message:
    """Return a message; raise ValueError if its channel or its times are invalid."""
    if record.channel_id not in channels:
        raise ValueError(f'nothing defines channel {record.channel_id} of a message')
    times = record.log_time, record.publish_time
    return Message(channels[record.channel_id], record.data, *times, record.sequence).checked()


def read_records(stream: io.BufferedReader) -> Iterator[Message | mcap.McapRecord]:
    """
    Yield the messages and all other records of a file as they were written.

    Damaged bytes may cause any exception; BagError is raised if a channel is not of ROS 2.
    """
    schemas: dict[int, mcap.Schema] = {}
    channels: dict[int, Channel] = {}
    count = 0
    for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
        items = [record]
        if isinstance(record, mcap.Chunk):
            _check_size(record.uncompressed_size)
            items = breakup_chunk(record, validate_crc=True)
        for item in items:
            match item:
                case mcap.Schema():
                    schemas[item.id] = item
                case mcap.Channel() if item.schema_id in schemas:
                    channels[item.id] = _make_channel(item, schemas)
                case mcap.Message():
                    count += 1
                    yield _make_message(item, channels)
                    continue
                case mcap.Statistics() if item.message_count > count:
                    raise ValueError(f'{item.message_count - count} messages are missing')
            yield item


class _File:
    """A finished MCAP file; one without a complete index, as of `fastwrite`, is kept in memory."""

    def __init__(self, path: Path, stream: io.BufferedReader) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.span: tuple[int, int] | None = None  # log times of the first and last message [ns]
        self._messages: list[Message] = []  # without an index
        self._stream = stream
        try:
            self._reader = self._read_index()
            if self._reader is None:
                self._read_messages()
        except BagError as error:
            raise BagError(f'{path}: {error}') from None
        except Exception as error:  # damaged bytes may cause any error in the library
            raise UnfinishedError(path, f'the file has no sound end, {error!s:.150}') from error

    def messages(self, topics: Collection[str] | None, *, by_log_time: bool) -> Iterator[Message]:
        """Yield messages; raise UnfinishedError where a chunk is damaged."""
        if self._reader is None:
            found = [m for m in self._messages if topics is None or m.channel.topic in topics]
            yield from sorted(found, key=_log_time) if by_log_time else found
            return
        try:
            for _, _, record in self._reader.iter_messages(topics, log_time_order=by_log_time):
                yield _make_message(record, self.channels)
        except Exception as error:  # damaged bytes may cause any error in the library
            raise UnfinishedError(self.path, f'a chunk is damaged, {error!s:.150}') from error

    def _read_index(self) -> SeekingReader | None:
        """Return a reader by the index; None if that does not name all chunks and channels."""
        size = self._stream.seek(0, os.SEEK_END)
        self._stream.seek(max(size - _END.size, 0))
        end = self._stream.read(_END.size)
        if len(end) < _END.size or not end.endswith(MAGIC):
            raise ValueError('it was cut off or is being written')
        _, _, begin, _, checksum, _ = _END.unpack(end)
        self._stream.seek(begin)
        if begin and checksum not in (0, zlib.crc32(self._stream.read(size - begin - 12))):
            raise ValueError('the checksum of its index is wrong')
        self._stream.seek(0)
        reader = SeekingReader(self._stream, validate_crcs=True)
        summary = reader.get_summary()
        if summary is None or (statistics := summary.statistics) is None:
            return None
        counts = len(summary.chunk_indexes), len(summary.channels)
        if counts != (statistics.chunk_count, statistics.channel_count):
            return None
        if statistics.message_count and not summary.chunk_indexes:
            return None
        for chunk in summary.chunk_indexes:
            _check_size(max(chunk.chunk_length, chunk.uncompressed_size))
        for number, channel in summary.channels.items():
            if channel.schema_id in summary.schemas:
                self.channels[number] = _make_channel(channel, summary.schemas)
        if statistics.message_count:
            self.span = statistics.message_start_time, statistics.message_end_time
        return reader

    def _read_messages(self) -> None:
        """Read all messages of a file without an index."""
        _check_size(self._stream.seek(0, os.SEEK_END))
        self._stream.seek(0)
        items = read_records(self._stream)
        self._messages = [item for item in items if isinstance(item, Message)]
        self.channels = dict(enumerate({message.channel: 0 for message in self._messages}))
        if times := [message.log_time for message in self._messages]:
            self.span = min(times), max(times)


class BagReader(contextlib.AbstractContextManager['BagReader']):
    """
    A finished bag opened for reading: a folder with MCAP files, or one such file.

    UnfinishedError is raised if a file is damaged, missing or empty; BagError, if the bag is being
    written, or is none of ROS 2 in MCAP. The message gives the remedy.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        folder = BagFolder(path)
        if folder.defects:
            check_not_written(self.path)
            raise UnfinishedError(folder.defects[0], 'the file is missing or empty')
        with contextlib.ExitStack() as streams:
            try:
                self._files = [
                    _File(file, streams.enter_context(open_mcap(file))) for file in folder.files
                ]
            except UnfinishedError:
                check_not_written(self.path)
                raise
            self._streams = streams.pop_all()
        channels = (file.channels.values() for file in self._files)
        self.channels = tuple(dict.fromkeys(itertools.chain(*channels)))  # each one once
        self._spans = [file.span for file in self._files if file.span is not None]
        # Log times of the first and the last message; 0 if there is none [ns]
        self.start_time = min((first for first, _ in self._spans), default=0)
        self.end_time = max((last for _, last in self._spans), default=0)

    def __exit__(self, *_: object) -> None:
        self._streams.close()

    def messages(
        self, topics: Collection[str] | None = None, *, by_log_time: bool = True
    ) -> Iterator[Message]:
        """
        Yield messages of topics, those of equal times, or all, in the order of writing.

        UnfinishedError is raised where a chunk is damaged.
        """
        found = [file.messages(topics, by_log_time=by_log_time) for file in self._files]
        is_in_order = all(one[1] <= other[0] for one, other in itertools.pairwise(self._spans))
        if is_in_order or not by_log_time:  # a later file is not read before
            return itertools.chain(*found)
        return heapq.merge(*found, key=_log_time)
