# SPDX-License-Identifier: Apache-2.0
"""
The records of an MCAP file that may be cut off, damaged or hostile.

The records themselves are those of the library `mcap`. Its readers believe every length that a
file claims; so what finds records, and unpacks chunks, is here, and checks each of them.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from dataclasses import dataclass
from io import BytesIO
import os
from pathlib import Path
import re
import struct
from typing import BinaryIO, NamedTuple
import zlib

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC as MAGIC
import zstandard

LIMIT = 256 * 2**20
"""Of a message, attachment or chunk, unpacked too; more is taken for damage. [bytes]"""

_SMALL_LIMIT = 16 * 2**20
"""Of all other records. [bytes]"""

HEAD = struct.Struct('<BQ')
"""What a record begins with: its opcode, and the length of what follows."""

MESSAGE_HEAD = struct.Struct('<BQHIQQ')
"""What a message begins with: the same, and channel, sequence, log time and publish time."""

_TYPES: dict[int, type[McapRecord]] = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.DATA_END: DataEnd,
    Opcode.FOOTER: Footer,
    Opcode.HEADER: Header,
    Opcode.MESSAGE: Message,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SCHEMA: Schema,
    Opcode.STATISTICS: Statistics,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
}

_LARGE = (Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.CHUNK)

_INDEX_HEAD = struct.Struct('<HI')

_PRIVATE = 0x80
"""From this opcode on, records are of whoever wrote them, and skipped."""

_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)

_OUTSIDE = (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END)
"""With these, and in a file without chunks with those, reading can go on after damage."""

_CHUNK = bytes([Opcode.CHUNK])

_PIECE = 2**20
"""How much is searched or unpacked at once. [bytes]"""


class DamageError(ValueError):
    """Bytes are not what they should be; the message says why."""


class Gap(NamedTuple):
    """
    A part of a file that cannot be read.

    Parameters
    ----------
    path : Path
        The file.
    offset, size : int
        Where it begins, and how long it is. [bytes]
    reason : str
        What is wrong with it.
    messages : int
        How many messages were in it, as far as is known.

    """

    path: Path
    offset: int
    size: int
    reason: str
    messages: int = 0

    def __str__(self) -> str:
        place = f'{self.size} bytes at {self.offset}: ' if self.size else ''
        count = f' ({self.messages} messages)' if self.messages else ''
        return f'{self.path}: {place}{self.reason}{count}'


class Found(NamedTuple):
    """
    A record of a file.

    Parameters
    ----------
    record : McapRecord or None
        None if it is private to whoever wrote it.
    offset, end : int
        Where it begins, and where the next one does. [bytes]
    is_sure : bool
        Whether its contents confirm where it ends.

    """

    record: McapRecord | None
    offset: int
    end: int
    is_sure: bool


class File:
    """
    A file that is read anywhere, by any number of readers.

    Parameters
    ----------
    path : Path
        What it is called.
    stream : binary file
        Open for reading; from now on it belongs to this object.

    """

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path = path
        self.size = os.fstat(stream.fileno()).st_size
        self._stream = stream

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from `offset` on, or as many as there are; none before the file."""
        if offset < 0:
            return b''
        end = min(offset + size, self.size)
        pieces = []
        while offset < end and (piece := os.pread(self._stream.fileno(), end - offset, offset)):
            pieces.append(piece)
            offset += len(piece)
        return pieces[0] if len(pieces) == 1 else b''.join(pieces)

    def head(self, offset: int) -> tuple[int, int]:
        """
        Return the opcode of the record at `offset`, and where it ends.

        Raises
        ------
        DamageError
            If there is none, or not all of it.

        """
        head = self.read(offset, HEAD.size)
        if len(head) < HEAD.size:
            raise DamageError('the file ends within a record')
        opcode, length = HEAD.unpack(head)
        check_head(opcode, 0)
        end = offset + HEAD.size + length
        if end > self.size:
            raise DamageError('the file ends within a record')
        return opcode, end

    def record(self, offset: int) -> Found:
        """Return the record at `offset`, or raise DamageError."""
        opcode, end = self.head(offset)
        if opcode >= _PRIVATE:
            return Found(None, offset, end, is_sure=False)
        begin = offset + HEAD.size
        if opcode == Opcode.MESSAGE_INDEX:
            size = IndexSize.of(self.read(begin, _INDEX_HEAD.size), end - begin)
            return Found(size, offset, end, is_sure=True)
        check_head(opcode, end - begin)
        record, is_sure = _parse(opcode, self.read(begin, end - begin))
        return Found(record, offset, end, is_sure)


@dataclass
class IndexSize(McapRecord):
    """How many messages of a channel are in the chunk before; a MessageIndex says where too."""

    channel_id: int
    count: int

    @classmethod
    def of(cls, body: bytes, length: int) -> IndexSize:
        """Make it from the beginning of a MessageIndex, or raise DamageError."""
        if len(body) == _INDEX_HEAD.size:
            channel_id, size = _INDEX_HEAD.unpack(body)
            if size == length - len(body):
                return cls(channel_id, size // 16)
        raise DamageError('the index there says two different lengths')


class _ExactStream(ReadDataStream):
    """A stream that has what is asked for, or raises."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def check_head(opcode: int, length: int) -> None:
    """Raise DamageError if no record begins so, or none can be so long."""
    if not (opcode in _TYPES or opcode >= _PRIVATE):
        raise DamageError(f'no record begins with {opcode:#04x}')
    limit = LIMIT if opcode in _LARGE else _SMALL_LIMIT
    if length > limit:
        raise DamageError(f'a record claims to have {length} bytes, more than {limit}')


def parse(opcode: int, body: bytes) -> McapRecord | None:
    """
    Make a record of what follows its head; None if it is private to whoever wrote it.

    Raises
    ------
    DamageError
        If it is none.

    """
    check_head(opcode, len(body))
    return _parse(opcode, body)[0] if opcode < _PRIVATE else None


def _parse(opcode: int, body: bytes) -> tuple[McapRecord, bool]:
    """Make a record, and tell whether its length agrees with what is in it."""
    kind = _TYPES[opcode]
    stream = _ExactStream(BytesIO(body))
    try:
        if kind is Message:
            return Message.read(stream, len(body)), False
        record: McapRecord = kind.read(stream)  # type: ignore[attr-defined]
    except (EndOfFile, OverflowError, UnicodeDecodeError):
        raise DamageError(f'the {kind.__name__} record there is damaged') from None
    is_sure = stream.count == len(body)
    if kind is Chunk and not is_sure:
        raise DamageError('the chunk there says two different lengths')
    if kind is Attachment:
        (checksum,) = struct.unpack_from('<I', body, len(body) - 4)
        if checksum and checksum != zlib.crc32(body[:-4]):
            raise DamageError('the checksum of the attachment there is wrong')
    return record, is_sure


def unpack(chunk: Chunk) -> bytes:
    """
    Return the records of a chunk, one after another.

    Raises
    ------
    DamageError
        If they are not what was packed, as far as length and checksum tell.

    """
    data = decompress(chunk.compression, chunk.data, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamageError('the checksum of the chunk there is wrong')
    return data


def decompress(compression: str, data: bytes, size: int) -> bytes:
    """
    Decompress `size` bytes.

    Raises
    ------
    DamageError
        If that is not what `data` give, or more than `LIMIT`.

    """
    check_head(Opcode.CHUNK, size)
    try:
        match compression:
            case '':
                unpacked = data
            case 'zstd':
                # What the frame claims to hold would be believed
                unpacked = b''
                if zstandard.frame_content_size(data) in (-1, size):
                    unpacked = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
            case 'lz4':
                decompressor = lz4.frame.LZ4FrameDecompressor()
                unpacked = decompressor.decompress(data, max_length=size + 1)
            case _:
                raise DamageError(f'compressed by {compression!r}, which is not zstd or lz4')
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        raise DamageError(f'cannot be decompressed: {error}') from None
    if len(unpacked) != size:
        raise DamageError(f'what is compressed there are not {size} bytes')
    return unpacked


def unpack_start(body: bytes) -> bytes:
    """Return what can be had of a chunk whose record is cut off, without a checksum."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    except (EndOfFile, OverflowError, struct.error, UnicodeDecodeError):
        return b''
    data = bytearray()
    with contextlib.suppress(zstandard.ZstdError, RuntimeError, EOFError):
        for piece in _pieces(chunk):
            data += piece
            if len(data) >= min(chunk.uncompressed_size, LIMIT):
                break
    return bytes(data)


def _pieces(chunk: Chunk) -> Iterator[bytes]:
    """Decompress a chunk little by little, as far as it goes."""
    match chunk.compression:
        case '':
            yield chunk.data
        case 'zstd':
            reader = zstandard.ZstdDecompressor().stream_reader(chunk.data)
            while piece := reader.read(_PIECE):
                yield piece
        case 'lz4':
            decompressor = lz4.frame.LZ4FrameDecompressor()
            data = chunk.data
            while piece := decompressor.decompress(data, max_length=_PIECE):
                yield piece
                data = b''


def split(data: bytes) -> Iterator[tuple[int, int, int]]:
    """
    Find the records that stand one after another.

    Yields
    ------
    opcode : int
        The kind of a record.
    offset, end : int
        Where it begins in `data`, and where the next one does.

    Raises
    ------
    DamageError
        In the end, if the last one is cut off.

    """
    offset, size = 0, len(data)
    while offset + HEAD.size <= size:
        opcode, length = HEAD.unpack_from(data, offset)
        end = offset + HEAD.size + length
        if end > size or not opcode:
            break
        yield opcode, offset, end
        offset = end
    if offset != size:
        raise DamageError('records end within one')


def scan(file: File) -> Iterator[Found | Gap]:
    """
    Find the records of a file one by one, up to its end, and go on after what is damaged.

    Chunks are not looked into, unless one is needed to go on with.

    Yields
    ------
    Found
        A record.
    Gap
        What is none. If the file has no end, one of these comes last.

    """
    scanner = _Scanner(file)
    offset = len(MAGIC) if file.read(0, len(MAGIC)) == MAGIC else 0
    is_whole = True
    while offset < file.size:
        try:
            found = scanner.record(offset)
        except DamageError as error:
            end = scanner.next_record(offset)
            yield Gap(file.path, offset, end - offset, str(error))
            offset, is_whole = end, False
            continue
        yield found
        offset, is_whole = found.end, True
        if isinstance(found.record, Footer) and file.read(offset, len(MAGIC)) == MAGIC:
            return
    if is_whole:
        yield Gap(file.path, file.size, 0, 'the file has no end')


class _Scanner:
    """Tells records from other bytes."""

    def __init__(self, file: File) -> None:
        self._file = file
        self._has_chunks = False

    def record(self, offset: int) -> Found:
        """Return the record at `offset`, where one should be, or raise DamageError."""
        self._has_chunks |= self._file.read(offset, 1) == _CHUNK
        found = self._file.record(offset)
        if not found.is_sure and not self._may_begin(found.end):
            raise DamageError('a record there is damaged, or the next one')
        return found

    def next_record(self, offset: int) -> int:
        """Return where a record begins after the damaged one at `offset`, or the file ends."""
        try:
            _, end = self._file.head(offset)
            self.record(end)
        except DamageError:
            return self._search(offset + 1)
        return end

    def _search(self, offset: int) -> int:
        """Return where a record certainly begins, or the file ends."""
        # In a file with chunks, what could be in one is in one that is damaged
        opcodes = bytes(_OUTSIDE if self._has_chunks else _OUTSIDE + _IN_CHUNKS)
        head = re.compile(b'[%s].{4}\0{4}' % opcodes, re.DOTALL)
        while offset < self._file.size:
            piece = self._file.read(offset, _PIECE + HEAD.size)
            position = 0
            while match := head.search(piece, position):
                if self._is_record(offset + match.start()):
                    return offset + match.start()
                position = match.start() + 1
            offset += _PIECE
        return self._file.size

    def _is_record(self, offset: int) -> bool:
        try:
            opcode, end = self._file.head(offset)
            if not self._may_begin(end):
                return False
            if opcode == Opcode.MESSAGE:
                return end - offset >= MESSAGE_HEAD.size
            found = self._file.record(offset)
            if isinstance(found.record, Chunk):
                unpack(found.record)
        except DamageError:
            return False
        return found.is_sure

    def _may_begin(self, offset: int) -> bool:
        """Tell whether a record may begin there, or the file ends."""
        head = self._file.read(offset, HEAD.size)
        if len(head) < HEAD.size:
            return True
        try:
            check_head(*HEAD.unpack(head))
        except DamageError:
            return False
        return True
