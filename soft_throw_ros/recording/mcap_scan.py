# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A reader of all complete chunks of a damaged or unfinished MCAP file.

The readers of the library `mcap` stop at the first damage, and need the end of the file. This scan
goes from record to record, and continues after damage at the next complete chunk.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
import contextlib
from io import BytesIO
import mmap
import os
from pathlib import Path
import re
from typing import NamedTuple
import zlib

from mcap import records as mcap
from mcap.opcode import Opcode
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.storage.mcap_file import (
    check_end,
    DamageError,
    HEAD,
    make_channels,
    make_message,
    MAX_RECORD,
    open_mcap,
    reason_of,
    unpack,
)
from soft_throw_ros.storage.message import BagError, Message

_CHUNK_HEAD = re.compile(
    rb'\x06(?=.{4}\0{4}.{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4})(.{8}))', re.DOTALL
)
"""The beginning of a chunk: opcode, length, times, size, checksum, compression, size of data."""

_OPCODES = {*map(int, Opcode), *range(0x80, 0x100)}  # those from 0x80 on are private records

_RECOVERED = {
    *(Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA),
    *(Opcode.ATTACHMENT, Opcode.STATISTICS),
}
"""Records that are read; the others have nothing to recover."""


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
    """
    An MCAP file in any state; BagError is raised if it cannot be opened.

    Attributes
    ----------
    channels : tuple of Channel
        The channels that have messages.
    metadata : list of mcap.Metadata
        Named texts in their order.
    attachments : list of mcap.Attachment
        Attached files in their order.
    unreadable : list of UnreadableRange
        All damage found so far.

    """

    def __init__(self, path: Path) -> None:
        self.metadata: list[mcap.Metadata] = []
        self.attachments: list[mcap.Attachment] = []
        self.unreadable: list[UnreadableRange] = []
        self._path = path
        self._stream = open_mcap(path, is_lenient=True)
        self._size = os.fstat(self._stream.fileno()).st_size
        try:
            self._survey()
        except BagError as error:
            self.close()
            raise BagError(f'{path}: {error}') from None

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def messages(self) -> Iterator[Message]:
        """Yield all messages that can be read, as they were written."""
        for offset, end, records in self._records():
            for record in records:
                if isinstance(record, mcap.Message) and record.channel_id in self._channels:
                    try:
                        yield make_message(record, self._channels)
                    except DamageError as error:
                        self._note(offset, end - offset, str(error))

    def _survey(self) -> None:
        """Read definitions, texts and attachments, and count the messages."""
        schemas: dict[int, mcap.Schema] = {}
        channels: dict[int, mcap.Channel] = {}
        counts: Counter[int] = Counter()
        promised = 0  # messages, by the end of the file
        for _, _, records in self._records():
            for record in records:
                match record:
                    case mcap.Message():
                        counts[record.channel_id] += 1
                    case mcap.Schema():
                        schemas.setdefault(record.id, record)
                    case mcap.Channel():
                        channels.setdefault(record.id, record)
                    case mcap.Metadata():
                        self.metadata.append(record)
                    case mcap.Attachment():
                        self.attachments.append(record)
                    case mcap.Statistics():
                        promised = record.message_count
        try:
            check_end(self._stream)
        except DamageError as error:
            self._note(self._size, 0, f'the file has no sound end, {error}')
            promised = 0
        self._channels = make_channels(channels, schemas)
        for number in counts.keys() - self._channels.keys():
            self._note(0, 0, f'nothing defines channel {number}', counts[number])
        missing = promised - counts.total()
        if missing > 0:
            self._note(self._size, 0, 'messages are missing that the end tells of', missing)
        self.channels = tuple(
            dict.fromkeys(self._channels[number] for number in counts if number in self._channels)
        )

    def _records(self) -> Iterator[tuple[int, int, list[mcap.McapRecord]]]:
        """Yield the records of each chunk, or one in no chunk, with the offsets of both ends."""
        offset = len(MAGIC)
        opcode = 0
        while offset < self._size and opcode != Opcode.FOOTER:
            try:
                opcode, end = self._head(offset)
                records = self._read(opcode, offset, end)
            except DamageError as error:
                end = self._find_chunk(offset + 1)
                self._note(offset, end - offset, str(error))
            else:
                yield offset, end, records
            offset = end

    def _head(self, offset: int) -> tuple[int, int]:
        """Return the opcode of a record and the offset of its end; raise DamageError."""
        head = os.pread(self._stream.fileno(), HEAD.size, offset).ljust(HEAD.size, b'\0')
        opcode, length = HEAD.unpack(head)
        if opcode not in _OPCODES:
            raise DamageError(f'no record begins with {opcode:#04x}')
        if length > MAX_RECORD:
            raise DamageError(f'a record of {length} bytes, more than {MAX_RECORD}')
        if offset + HEAD.size + length > self._size:
            raise DamageError('it ends within a record')
        return opcode, offset + HEAD.size + length

    def _read(self, opcode: int, offset: int, end: int) -> list[mcap.McapRecord]:
        """Return a record, the records of a chunk, or none of kinds that are not recovered."""
        if opcode not in _RECOVERED:
            return []
        data = os.pread(self._stream.fileno(), end - offset, offset)
        checksum = int.from_bytes(data[-4:], 'little')
        if opcode == Opcode.ATTACHMENT and checksum not in (0, zlib.crc32(data[HEAD.size:-4])):
            self._note(offset, end - offset, 'the checksum of the attachment there is wrong')
            return []
        try:  # a stream of one record, so that no damaged length leads beyond the record
            record = next(StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records)
            return unpack(record) if isinstance(record, mcap.Chunk) else [record]
        except Exception as error:  # damaged bytes may cause any error in the library
            raise DamageError(f'the record there is damaged, {reason_of(error)}') from error

    def _find_chunk(self, start: int) -> int:
        """Return where the next chunk that is whole begins, or the file ends."""
        with mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for match in _CHUNK_HEAD.finditer(data, start):
                offset, size = match.start(), int.from_bytes(match[1], 'little')
                with contextlib.suppress(DamageError):
                    opcode, end = self._head(offset)
                    # Few other bytes have two sizes that agree, so that few are unpacked in vain
                    if match.end(1) + size == end and self._read(opcode, offset, end):
                        return offset
        return self._size

    def _note(self, offset: int, size: int, reason: str, messages: int = 0) -> None:
        """Add an unreadable range once."""
        unreadable = UnreadableRange(self._path, offset, size, reason, messages)
        if unreadable not in self.unreadable:
            self.unreadable.append(unreadable)
