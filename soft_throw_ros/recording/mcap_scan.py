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
A reader of all complete chunks of a damaged or unfinished MCAP file.

The readers of the library `mcap` stop at the first damage, and need the end of the file. This scan
goes from record to record, and continues after damage at the next complete chunk.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import contextlib
import mmap
from pathlib import Path
import re
from typing import NamedTuple
import zlib

from mcap import records as mcap
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.storage.mcap_records import (
    DamageError,
    Definitions,
    HEAD,
    RecordFile,
    Shared,
    size_of,
    unpack,
)
from soft_throw_ros.storage.message import BagError, Channel, Message

MAX_SEARCH = 4 * 2**30
"""Largest size of everything unpacked in search of the next whole chunk after damage. [bytes]"""

_WINDOW = 16 * 2**20
"""Size of the part of a file that is searched or summed at once. [bytes]"""

_CHUNK_HEAD = re.compile(
    rb'\x06(?=.{4}\0{4}.{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4}))', re.DOTALL
)
"""The beginning of a chunk: opcode, length, times, size, checksum and kind of compression."""

_HEAD_SIZE = 64
"""More than the beginning of a chunk takes. [bytes]"""

_SKIPPED = {
    *(Opcode.HEADER, Opcode.MESSAGE_INDEX, Opcode.DATA_END, Opcode.SUMMARY_OFFSET),
    *(Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX),
}
"""Records that have nothing to recover."""


class UnreadableRange(NamedTuple):
    """A part of a file that cannot be read."""

    path: Path
    offset: int  # [bytes]
    size: int  # 0 if only something is missing at the offset [bytes]
    reason: str
    messages: int = 0  # number of messages in the range, as far as is known

    def __str__(self) -> str:
        location = f'{self.size} bytes at {self.offset}: ' if self.size else ''
        count = f' ({self.messages} messages)' if self.messages else ''
        return f'{self.path}: {location}{self.reason}{count}'


class ScannedFile:
    """An MCAP file in any state; BagError is raised if it cannot be opened."""

    def __init__(self, path: Path, shared: Shared) -> None:
        self.metadata: list[mcap.Metadata] = []
        self.unreadable: list[UnreadableRange] = []  # all damage found so far
        self._path = path
        self._shared = shared
        self._definitions = Definitions(shared)
        self._attachments: list[tuple[int, int]] = []  # offsets of both ends
        self._searched = 0  # in search of whole chunks [bytes]
        self._next_chunk: dict[int, int] = {}  # after the damage at an offset
        self._file = RecordFile(path, is_lenient=True)
        try:
            self.channels = self._survey()  # those that have messages
        except BagError as error:
            self.close()
            raise BagError(f'{path}: {error}') from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def attachments(self) -> Iterator[mcap.Attachment]:
        """Yield the attached files that are whole."""
        for offset, end in self._attachments:
            try:
                record = self._file.record(offset)
            except DamageError as error:
                self._note(offset, end - offset, str(error))
            else:
                if isinstance(record, mcap.Attachment):
                    yield record

    def messages(self) -> Iterator[Message]:
        """Yield all messages that can be read, as they were written."""
        channels = self._definitions.channels
        for offset, end, records in self._records():
            for record in records:
                if isinstance(record, mcap.Message) and record.channel_id in channels:
                    try:
                        yield self._definitions.message(record)
                    except DamageError as error:
                        self._note(offset, end - offset, str(error))

    def _survey(self) -> tuple[Channel, ...]:
        """Read definitions, texts and offsets of attachments; return the channels in use."""
        counts: Counter[int] = Counter()
        promised = 0  # messages, by the end of the file
        statistics = 0
        for offset, end, records in self._records():
            for record in records:
                match record:
                    case mcap.Message():
                        counts[record.channel_id] += 1
                    case mcap.Schema() | mcap.Channel():
                        self._definitions.add(record)
                    case mcap.Metadata():
                        self._shared.keep(size_of(record))
                        self.metadata.append(record)
                    case mcap.Attachment():
                        self._attachments.append((offset, end))
                    case mcap.Statistics():
                        statistics = record.message_count
                    case mcap.Footer() if self._has_sound_end(record, offset):
                        promised = statistics
        channels = self._definitions.channels
        for number in counts.keys() - channels.keys():
            self._note(0, 0, f'nothing defines channel {number}', counts[number])
        missing = promised - counts.total()
        if missing > 0:
            self._note(self._file.size, 0, 'messages are missing that the end tells of', missing)
        return tuple(dict.fromkeys(channels[number] for number in counts if number in channels))

    def _has_sound_end(self, footer: mcap.Footer, offset: int) -> bool:
        """Return whether the checksum of the end is right, or there is none; note otherwise."""
        checksum, end = 0, offset + HEAD.size + 16
        for begin in range(min(footer.summary_start, offset), end, _WINDOW):
            data = self._file.read(begin, min(begin + _WINDOW, end))
            checksum = zlib.crc32(data, checksum)
        is_sound = footer.summary_crc in (0, checksum)
        if not is_sound:
            self._note(offset, 0, 'the checksum of the end is wrong')
        return is_sound

    def _records(self) -> Iterator[tuple[int, int, list[mcap.McapRecord]]]:
        """Yield the records of each chunk, or one in no chunk, with the offsets of both ends."""
        offset = len(MAGIC)
        opcode = 0
        while offset < self._file.size and opcode != Opcode.FOOTER:
            try:
                opcode, end = self._file.head(offset)
                records = self._read(opcode, offset)
            except DamageError as error:
                if offset not in self._next_chunk:
                    self._next_chunk[offset] = self._find_chunk(offset + 1)
                end = self._next_chunk[offset]
                self._note(offset, end - offset, str(error))
            else:
                yield offset, end, records
            offset = end
        if opcode != Opcode.FOOTER or self._file.read(offset, self._file.size) != MAGIC:
            self._note(self._file.size, 0, 'the file has no end')

    def _read(self, opcode: int, offset: int) -> list[mcap.McapRecord]:
        """Return the records of a chunk, or a record; none of kinds that are not recovered."""
        if opcode in _SKIPPED:
            return []
        if opcode == Opcode.ATTACHMENT:  # which is large, and read when it is copied
            return [mcap.Attachment(0, 0, '', '', b'')]
        record = self._file.record(offset)
        if isinstance(record, mcap.Chunk):
            return unpack(record)
        return [] if record is None else [record]

    def _find_chunk(self, start: int) -> int:
        """Return where the next chunk that is whole begins, or the file ends."""
        with mmap.mmap(self._file.stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for begin in range(start, self._file.size, _WINDOW):
                for match in _CHUNK_HEAD.finditer(data, begin, begin + _WINDOW + _HEAD_SIZE):
                    with contextlib.suppress(DamageError):
                        self._search(self._file.head(match.start())[1] - match.start())
                        if unpack(self._file.record(match.start())):
                            return match.start()
        return self._file.size

    def _search(self, size: int) -> None:
        self._searched += size
        if self._searched > MAX_SEARCH:
            raise BagError(f'more than {MAX_SEARCH} bytes look like chunks, but are none')

    def _note(self, offset: int, size: int, reason: str, messages: int = 0) -> None:
        """Add an unreadable range once."""
        unreadable = UnreadableRange(self._path, offset, size, reason, messages)
        if unreadable not in self.unreadable:
            self.unreadable.append(unreadable)
