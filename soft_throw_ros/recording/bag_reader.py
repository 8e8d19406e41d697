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
"""Read bags: ours and those of other recorders, whole, still being written, or damaged."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
import heapq
import itertools
from pathlib import Path
import re
from typing import Any
import zlib

from mcap import records as mcap
from soft_throw_ros.recording.bag_metadata import METADATA_FILE, read_metadata
from soft_throw_ros.recording.bag_writer import is_being_written
from soft_throw_ros.recording.mcap_file import Chunk, CONVERSION, Gap, McapFile, read_stream
from soft_throw_ros.recording.message import BagError, Channel, LATEST, Message

__all__ = ['BagReader', 'Gap', 'read_stream']


class BagReader:
    """
    Reads a bag.

    Parameters
    ----------
    path : path_like
        A folder with MCAP files, or one such file.
    by_scan : bool
        Whether to look at every record first, instead of believing the ends of the files.

    Attributes
    ----------
    path : Path
        As given.
    channels : tuple of Channel
        The topics; one object each, in all files.
    counts : dict of Channel to int
        How many messages there are.
    start_time, end_time : int
        Log times of the first and the last message; 0 if there is none. [ns]
    distribution : str
        Of ROS; empty if the bag does not say.

    Raises
    ------
    BagError
        If there is no bag of ROS 2 in MCAP; the message says what would be right.

    Notes
    -----
    Of a file that was cut off, or is still being written, all whole chunks are read; of a damaged
    one also those after the damage. Messages that are in no chunk, as some recorders write them,
    are read up to the damage, and kept in memory.

    """

    def __init__(self, path: str | Path, *, by_scan: bool = False) -> None:
        self.path = Path(path)
        self._gaps: list[Gap] = []
        information = self._read_information() if self.path.is_dir() else {}
        self.distribution = str(information.get('ros_distro') or '')
        known: dict[tuple[object, ...], Channel] = {}
        self._files: list[McapFile] = []
        try:
            for file_path in self._paths(information):
                self._files.append(McapFile(file_path, known, by_scan=by_scan))
        except BagError:
            self.close()
            raise
        self.counts: dict[Channel, int] = {}
        for channel, count in itertools.chain(*(file.counts.items() for file in self._files)):
            self.counts[channel] = self.counts.get(channel, 0) + count
        self.channels = tuple(self.counts)
        chunks = [chunk for file in self._files for chunk in file.chunks]
        self.start_time = min((chunk.first for chunk in chunks), default=0)
        self.end_time = max((chunk.last for chunk in chunks), default=0)
        if self.gaps and is_being_written(self.path):
            self._gaps.append(Gap(self.path, 0, 0, 'the bag is being written'))

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    @property
    def message_count(self) -> int:
        """How many messages there are."""
        return sum(self.counts.values())

    @property
    def gaps(self) -> list[Gap]:
        """List what could not be read, as far as is known by now."""
        return self._gaps + [gap for file in self._files for gap in file.gaps]

    @property
    def damage(self) -> str:
        """Say what is wrong with the bag, in short, as far as is known by now, or nothing."""
        gaps = self.gaps
        more = f'; and {len(gaps) - 1} more' if len(gaps) > 1 else ''
        return f'{gaps[0]}{more}' if gaps else ''

    @property
    def doubts(self) -> list[str]:
        """List what is left out of the definitions of channels, since it cannot be trusted."""
        return list(dict.fromkeys(it for file in self._files for it in file.definitions.doubts))

    @property
    def metadata(self) -> list[mcap.Metadata]:
        """Named texts in their order, without those that a next file repeats."""
        found: list[mcap.Metadata] = []
        last: dict[str, mcap.Metadata] = {}
        for record in itertools.chain(*(file.metadata for file in self._files)):
            if record.name != 'rosbag2' and last.get(record.name) != record:
                last[record.name] = record
                found.append(record)
        return found

    def attachments(self) -> Iterator[mcap.Attachment]:
        """Yield files that were written into the bag, without those that a next one repeats."""
        seen = set()
        for record in itertools.chain(*(file.attachments() for file in self._files)):
            key = (record.name, len(record.data), zlib.crc32(record.data))
            if key not in seen:
                seen.add(key)
                yield record

    def messages(
        self,
        topics: Collection[str] | str | None = None,
        start: int | None = None,
        end: int | None = None,
        *,
        by_log_time: bool = True,
    ) -> Iterator[Message]:
        """
        Yield messages by their log times, those of equal times as they were written.

        Parameters
        ----------
        topics : str or collection of str, optional
            Of these only.
        start, end : int, optional
            From `start` on, and before `end`. [ns]
        by_log_time : bool
            False to yield them in the order in which they were written.

        """
        wanted = {topics} if isinstance(topics, str) else topics
        span = range(start or 0, LATEST + 1 if end is None else end)
        chunks = [
            (file, chunk) for file in self._files for chunk in file.chunks_with(wanted, span)
        ]
        if by_log_time:
            yield from _by_log_time(chunks, wanted, span)
        else:
            for file, chunk in chunks:
                yield from file.messages(chunk, wanted, span)

    def _read_information(self) -> dict[str, Any]:
        """Read `metadata.yaml`; what is not there is left to the files."""
        path = self.path / METADATA_FILE
        try:
            return read_metadata(path)
        except ValueError as error:
            self._gaps.append(Gap(path, 0, 0, str(error)))
            return {}

    def _paths(self, information: Mapping[str, Any]) -> list[Path]:
        """List the files of the bag."""
        if not self.path.is_dir():
            return [self.path]
        is_sqlite = any(self.path.glob('*.db3'))
        storage = str(information.get('storage_identifier', 'sqlite3' if is_sqlite else 'mcap'))
        if storage != 'mcap':
            raise BagError(f'{self.path} is a bag in {storage}, not in MCAP; {CONVERSION}')
        if str(information.get('compression_mode')).lower() in ('file', 'message'):
            raise BagError(f'{self.path} is a bag that rosbag2 has compressed; {CONVERSION}')
        found = sorted(self.path.glob('*.mcap'), key=_by_number)
        listed = [self.path / Path(n).name for n in information.get('relative_file_paths', ())]
        missing = [path for path in listed if path not in found]
        self._gaps += [Gap(path, 0, 0, 'the file is missing') for path in missing]
        if not found:
            raise BagError(f'{self.path} is no bag, there is no MCAP file in it')
        # What a machine leaves that loses its power is no reason to refuse the others
        empty = [path for path in found if path.is_file() and not path.stat().st_size]
        self._gaps += [Gap(path, 0, 0, 'the file is empty') for path in empty]
        return [path for path in found if path not in empty] or found


def _by_log_time(
    chunks: Iterable[tuple[McapFile, Chunk]], topics: Collection[str] | None, span: range
) -> Iterator[Message]:
    """Merge the messages of chunks; each is unpacked when its first message is due."""
    waiting = sorted(enumerate(chunks), key=lambda item: item[1][1].first, reverse=True)
    messages: list[tuple[int, int, int, Message]] = []
    while waiting or messages:
        while waiting and (not messages or waiting[-1][1][1].first <= messages[0][0]):
            number, (file, chunk) = waiting.pop()
            for place, message in enumerate(file.messages(chunk, topics, span)):
                heapq.heappush(messages, (message.log_time, number, place, message))
        if messages:
            yield heapq.heappop(messages)[-1]


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sort `bag_2` before `bag_10`."""
    return [
        (int(part), '') if part.isdecimal() else (0, part)
        for part in re.split(r'(\d+)', path.name, flags=re.ASCII)
    ]
