# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Finished bags of this package and of other recorders, opened for reading.

The error for a damaged or unfinished bag names the command that recovers its messages (see
`recovery`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
import heapq
import itertools
import os
from pathlib import Path
import struct
from typing import Any, TypeVar
import zlib

from mcap import records as mcap
from mcap.reader import SeekingReader
from mcap.summary import Summary
from soft_throw_ros.storage.bag_lock import is_being_written
from soft_throw_ros.storage.bag_metadata import METADATA_FILE, read_metadata
from soft_throw_ros.storage.mcap_stream import (
    check_size,
    CONVERSION,
    MAGIC,
    make_channel,
    make_message,
    McapStream,
    open_mcap,
    UnfinishedError,
)
from soft_throw_ros.storage.message import BagError, Channel, Message

__all__ = ['BagReader', 'UnfinishedError']

MAX_UNINDEXED = 64 * 2**20
"""Largest size of a file without an index, whose messages are kept in memory. [bytes]"""

_END = struct.Struct('<BQQQI8s')
"""End of a file: head of the footer, offsets of both parts of the index, checksum, magic bytes."""

Named = TypeVar('Named', mcap.Metadata, mcap.Attachment)


class BagFolder:
    """
    The files of a bag: those of a folder, by its `metadata.yaml`, or one MCAP file.

    BagError is raised if there is no bag in MCAP; the message gives the remedy.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.defects: list[str] = []  # files that are missing, empty or not readable
        information = self._read_information() if self.path.is_dir() else {}
        self.distribution = str(information.get('ros_distro') or '')
        # In their order, without empty ones
        self.files = self._find_files(information) if self.path.is_dir() else [self.path]

    def _read_information(self) -> dict[str, Any]:
        """Read `metadata.yaml`; without it the files contain all required data."""
        path = self.path / METADATA_FILE
        try:
            return read_metadata(path)
        except ValueError as error:
            self.defects.append(f'{path}: {error}')
            return {}

    def _find_files(self, information: dict[str, Any]) -> list[Path]:
        is_sqlite = any(self.path.glob('*.db3'))
        storage = str(information.get('storage_identifier', 'sqlite3' if is_sqlite else 'mcap'))
        if storage != 'mcap':
            raise BagError(f'{self.path} is a bag in {storage}, not in MCAP; {CONVERSION}')
        if str(information.get('compression_mode')).lower() in ('file', 'message'):
            raise BagError(f'{self.path} is a bag that rosbag2 has compressed; {CONVERSION}')
        # `bag_2` before `bag_10`
        present = sorted(self.path.glob('*.mcap'), key=lambda path: (len(path.name), path.name))
        listed = [self.path / Path(n).name for n in information.get('relative_file_paths', ())]
        missing = [path for path in listed if path not in present]
        self.defects += [f'{path}: the file is missing' for path in missing]
        if not present:
            raise BagError(f'{self.path} is no bag, it contains no MCAP file')
        # A loss of power may leave empty files, which are no reason to refuse the others
        empty = [path for path in present if path.is_file() and not path.stat().st_size]
        self.defects += [f'{path}: the file is empty' for path in empty]
        return [path for path in present if path not in empty] or present


class _File:
    """A finished MCAP file; one without a complete index is read as a whole."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stream = open_mcap(path)
        self._messages: list[Message] | None = None  # by log time, if the file has no index
        self.counts: dict[Channel, int] = {}
        self.span: tuple[int, int] | None = None  # log times of the first and last message [ns]
        try:
            _check_end(self._stream)
            self._stream.seek(0)
            self._reader = SeekingReader(self._stream, validate_crcs=True)
            summary = self._reader.get_summary()
            if summary is not None and _is_complete(summary):
                self._read_index(summary)
            else:
                self._read_all()
        except UnfinishedError:
            self.close()
            raise
        except BagError as error:
            self.close()
            raise BagError(f'{path}: {error}') from None
        except Exception as error:  # damaged bytes may cause any error in the library
            self.close()
            raise UnfinishedError(path, f'the file has no sound end, {error!s:.150}') from error

    def close(self) -> None:
        self._stream.close()

    def messages(
        self, topics: Collection[str] | None, start: int, end: int, *, by_log_time: bool
    ) -> Iterator[Message]:
        """Yield messages; raise UnfinishedError where a chunk is damaged."""
        if self._messages is not None or not by_log_time:
            found = self._messages if by_log_time else McapStream(self.path).messages()
            for message in found or ():
                is_wanted = topics is None or message.channel.topic in topics
                if is_wanted and start <= message.log_time < end:
                    yield message
            return
        try:
            for _, _, record in self._reader.iter_messages(
                topics, starting_at=min(start, end), ending_before=end
            ):
                yield make_message(record, self._channels)
        except Exception as error:  # damaged bytes may cause any error in the library
            raise UnfinishedError(self.path, f'a chunk is damaged, {error!s:.150}') from error

    def _read_index(self, summary: Summary) -> None:
        statistics = summary.statistics
        assert statistics is not None
        for chunk in summary.chunk_indexes:
            check_size(max(chunk.chunk_length, chunk.uncompressed_size))
        self._channels = {
            number: make_channel(channel, summary.schemas)
            for number, channel in summary.channels.items() if channel.schema_id in summary.schemas
        }
        self.counts = dict.fromkeys(self._channels.values(), 0)
        for number, count in statistics.channel_message_counts.items():
            if number not in self._channels:
                raise ValueError(f'nothing defines channel {number}')
            self.counts[self._channels[number]] += count
        if statistics.message_count:
            self.span = statistics.message_start_time, statistics.message_end_time
        self.metadata = list(self._reader.iter_metadata())

    def _read_all(self) -> None:
        size = self.path.stat().st_size
        if size > MAX_UNINDEXED:
            raise ValueError(f'it has no index, and {size} bytes are more than {MAX_UNINDEXED}')
        stream = McapStream(self.path)
        self._messages = sorted(stream.messages(), key=lambda message: message.log_time)
        self.counts = dict.fromkeys(stream.channels.values(), 0)
        self.counts.update(Counter(message.channel for message in self._messages))
        if self._messages:
            self.span = self._messages[0].log_time, self._messages[-1].log_time
        self.metadata = stream.metadata


def _check_end(stream: Any) -> None:
    """Raise ValueError if a file has no complete end, or the checksum of its index is wrong."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - _END.size, 0))
    end = stream.read(_END.size)
    if len(end) < _END.size or not end.endswith(MAGIC):
        raise ValueError('it was cut off or is being written')
    _, _, begin, _, checksum, _ = _END.unpack(end)
    if begin:
        stream.seek(begin)
        index = stream.read(size - begin - len(MAGIC) - 4)
        if checksum not in (0, zlib.crc32(index)):
            raise ValueError('the checksum of its index is wrong')


def _is_complete(summary: Summary) -> bool:
    """Return whether an index names all chunks and texts, and all messages are in chunks."""
    statistics = summary.statistics
    return statistics is not None and (
        (statistics.chunk_count, statistics.metadata_count)
        == (len(summary.chunk_indexes), len(summary.metadata_indexes))
        and bool(summary.chunk_indexes or not statistics.message_count)
        and len(summary.channels) == statistics.channel_count
    )


class BagReader:
    """
    A finished bag opened for reading: a folder with MCAP files, or one such file.

    Attributes
    ----------
    channels : tuple of Channel
        The topics; all files share one object for each.
    counts : Counter of Channel
        Numbers of messages.
    start_time, end_time : int
        Log times of the first and the last message; 0 if there is none. [ns]
    distribution : str
        ROS distribution; empty if the bag does not name one.
    damage : str
        Files that are missing or not readable, in short; empty if there are none.

    Raises
    ------
    UnfinishedError
        If a file is damaged, was not finished, or is being written.
    BagError
        If there is no bag of ROS 2 in MCAP; the message gives the remedy.

    """

    def __init__(self, path: str | Path) -> None:
        folder = BagFolder(path)
        self.path = folder.path
        self.distribution = folder.distribution
        more = f'; and {len(folder.defects) - 1} more' if len(folder.defects) > 1 else ''
        self.damage = f'{folder.defects[0]}{more}' if folder.defects else ''
        self._files: list[_File] = []
        try:
            for file_path in folder.files:
                self._files.append(_File(file_path))
        except BagError as error:
            self.close()
            if isinstance(error, UnfinishedError) and is_being_written(self.path):
                raise BagError(f'{self.path} is being written; stop the recorder before') from None
            raise
        self.counts: Counter[Channel] = Counter()
        for file in self._files:
            self.counts.update(file.counts)
        self.channels = tuple(self.counts)
        spans = [file.span for file in self._files if file.span is not None]
        self.start_time = min((first for first, _ in spans), default=0)
        self.end_time = max((last for _, last in spans), default=0)

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    @property
    def metadata(self) -> list[mcap.Metadata]:
        """Named texts in their order, without those that a next file repeats."""
        return unrepeated(file.metadata for file in self._files)

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        end: int | None = None,
        *,
        by_log_time: bool = True,
    ) -> Iterator[Message]:
        """
        Yield messages of topics, from `start` on and before `end` [ns].

        They come by log time, those of equal times as they were written, or all as they were
        written. UnfinishedError is raised where a chunk is damaged.
        """
        first, last = max(start or 0, 0), 2**64 if end is None else max(end, 0)
        found = [
            file.messages(topics, first, last, by_log_time=by_log_time) for file in self._files
        ]
        spans = [file.span for file in self._files if file.span is not None]
        is_in_order = all(one[1] <= other[0] for one, other in itertools.pairwise(spans))
        if is_in_order or not by_log_time:  # a later file is not read before
            return itertools.chain(*found)
        return heapq.merge(*found, key=lambda message: message.log_time)


def unrepeated(files: Iterable[Iterable[Named]]) -> list[Named]:
    """Return the records of files, without those of rosbag2 and those that a next file repeats."""
    records: list[Named] = []
    last: dict[str, Named] = {}
    for record in itertools.chain.from_iterable(files):
        if record.name != 'rosbag2' and last.get(record.name) != record:
            last[record.name] = record
            records.append(record)
    return records
