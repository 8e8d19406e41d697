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
from pathlib import Path
import re
from typing import Any, TypeVar

from mcap import records as mcap
from soft_throw_ros.storage.bag_lock import is_being_written
from soft_throw_ros.storage.bag_metadata import METADATA_FILE, read_metadata
from soft_throw_ros.storage.mcap_file import CONVERSION, McapFile, UnfinishedError
from soft_throw_ros.storage.message import BagError, Channel, Message

__all__ = ['BagReader', 'UnfinishedError']

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
        present = sorted(self.path.glob('*.mcap'), key=_by_number)
        listed = [self.path / Path(n).name for n in information.get('relative_file_paths', ())]
        missing = [path for path in listed if path not in present]
        self.defects += [f'{path}: the file is missing' for path in missing]
        if not present:
            raise BagError(f'{self.path} is no bag, it contains no MCAP file')
        # A loss of power may leave empty files, which are no reason to refuse the others
        empty = [path for path in present if path.is_file() and not path.stat().st_size]
        self.defects += [f'{path}: the file is empty' for path in empty]
        return [path for path in present if path not in empty] or present


class BagReader:
    """
    A finished bag opened for reading.

    Parameters
    ----------
    path : path_like
        A folder with MCAP files, or one such file.

    Attributes
    ----------
    path : Path
        Path of the bag, as passed to the reader.
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
        self._files: list[McapFile] = []
        try:
            for file_path in folder.files:
                self._files.append(McapFile(file_path))
        except BagError as error:
            self.close()
            if isinstance(error, UnfinishedError) and is_being_written(self.path):
                raise BagError(f'{self.path} is being written; stop the recorder before') from None
            raise
        self.counts: Counter[Channel] = Counter()
        for file in self._files:
            self.counts.update(file.counts)
        self.channels = tuple(self.counts)
        parts = [file.statistics for file in self._files if file.statistics.message_count]
        self.start_time = min((part.message_start_time for part in parts), default=0)
        self.end_time = max((part.message_end_time for part in parts), default=0)

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
        Yield messages by their log times, those of equal times as they were written.

        Parameters
        ----------
        topics : collection of str, optional
            Yield only messages of these topics.
        start, end : int, optional
            Yield only messages from `start` on and before `end`. [ns]
        by_log_time : bool
            Whether to sort the messages by log time; False keeps the order of writing.

        Raises
        ------
        UnfinishedError
            Where a chunk is damaged.

        """
        span = range(max(start or 0, 0), 2**64 if end is None else max(end, 0))
        chunks = [
            (number, file, chunk)
            for number, file in enumerate(self._files)
            for chunk in file.chunks_with(topics, span)
        ]
        if by_log_time:
            chunks.sort(key=lambda item: item[2].message_start_time)
        waiting: list[tuple[int, int, int, int, Message]] = []  # by time, and then as written
        for number, file, chunk in chunks:
            while waiting and waiting[0][0] < chunk.message_start_time:
                yield heapq.heappop(waiting)[-1]
            for index, message in enumerate(file.read_chunk(chunk)):
                is_wanted = topics is None or message.channel.topic in topics
                if not is_wanted or message.log_time not in span:
                    continue
                if by_log_time:
                    key = message.log_time, number, chunk.chunk_start_offset, index
                    heapq.heappush(waiting, (*key, message))
                else:
                    yield message
        while waiting:
            yield heapq.heappop(waiting)[-1]


def unrepeated(files: Iterable[Iterable[Named]]) -> list[Named]:
    """Return the records of files, without those of rosbag2 and those that a next file repeats."""
    records: list[Named] = []
    last: dict[str, Named] = {}
    for record in itertools.chain.from_iterable(files):
        if record.name != 'rosbag2' and last.get(record.name) != record:
            last[record.name] = record
            records.append(record)
    return records


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sort `bag_2` before `bag_10`."""
    return [
        (int(word), '') if word.isdecimal() else (0, word)
        for word in re.split(r'(\d+)', path.name, flags=re.ASCII)
    ]
