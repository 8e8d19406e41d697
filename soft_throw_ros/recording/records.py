# SPDX-License-Identifier: Apache-2.0
"""
The records of an MCAP file that may be cut off, damaged or hostile.

The records themselves are those of the library `mcap`. Its readers trust every length that a file
claims, so what finds records, and unpacks chunks, is here, and checks each of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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

LIMIT = 512 * 2**20
"""Of a record, and of what a chunk unpacks to; more is taken for damage. [bytes]"""

HEAD = struct.Struct('<BQ')
"""What every record begins with: its opcode, and the length of what follows."""

MESSAGE = struct.Struct('<BQHIQQ')
"""What a message record begins with: head, channel, sequence, log time, publish time."""

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

_PRIVATE = 0x80
"""From this opcode on, records are of whoever wrote them, and skipped."""

_HEAD_PATTERN = re.compile(rb'(?=[\x03-\x06\x09\x0c\x0f].{4}\x00{4})', re.DOTALL)
"""How a record begins that is worth looking for: one that is not only an index of others."""

_WINDOW = 2**20
"""How much is searched at once. [bytes]"""

_FOOTER_LENGTH = 20


class DamageError(ValueError):
    """Bytes are not the record that they should be; the message says why."""


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

    """

    path: Path
    offset: int
    size: int
    reason: str

    def __str__(self) -> str:
        return f'{self.path}: {self.size} bytes at {self.offset}: {self.reason}'


class Found(NamedTuple):
    """
    A record of a file.

    Parameters
    ----------
    opcode : int
        Its kind.
    offset, end : int
        Where it begins, and where the next one may. [bytes]
    body : bytes
        What follows its head.

    """

    opcode: int
    offset: int
    end: int
    body: bytes


class File:
    """
    A file that is read anywhere, by any number of readers.

    Parameters
    ----------
    path : Path
        What it is called in messages.
    stream : binary file
        Open for reading; belongs to this object from now on.

    """

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path = path
        self.size = os.fstat(stream.fileno()).st_size
        self._stream = stream

    def read(self, offset: int, size: int) -> bytes:
        """Return `size` bytes from `offset` on, or as many as there are."""
        data = os.pread(self._stream.fileno(), min(size, max(self.size - offset, 0)), offset)
        while 0 < len(data) < size and (
            more := os.pread(self._stream.fileno(), size - len(data), offset + len(data))
        ):
            data += more
        return data

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
        if opcode not in _TYPES and opcode < _PRIVATE:
            raise DamageError(f'no record begins with {opcode:#04x}')
        end = offset + HEAD.size + length
        if end > self.size:
            raise DamageError('the file ends within a record')
        return opcode, end

    def record(self, offset: int) -> Found:
        """Return the record at `offset`, or raise DamageError."""
        opcode, end = self.head(offset)
        begin = offset + HEAD.size
        if end - begin > LIMIT:
            raise DamageError(f'a record of {end - begin} bytes, more than the {LIMIT} allowed')
        return Found(opcode, offset, end, self.read(begin, end - begin))

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


class _ExactStream(ReadDataStream):
    """A stream that has what is asked for, or raises."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(opcode: int, body: bytes) -> McapRecord:
    """
    Make a record from its bytes.

    Raises
    ------
    DamageError
        If they are none.

    """
    kind = _TYPES[opcode]
    stream = _ExactStream(BytesIO(body))
    try:
        if kind is Message:
            return Message.read(stream, len(body))
        record: McapRecord = kind.read(stream)  # type: ignore[attr-defined]
    except (EndOfFile, UnicodeDecodeError):
        raise DamageError(f'a {kind.__name__} record is damaged') from None
    if kind is Chunk and stream.count != len(body):
        raise DamageError('a Chunk record has two different lengths')
    if kind is Attachment:
        (checksum,) = struct.unpack_from('<I', body, len(body) - 4)
        if checksum and checksum != zlib.crc32(body[:-4]):
            raise DamageError('the checksum of an attachment is wrong')
    return record


def unpack(chunk: Chunk) -> bytes:
    """
    Return the records of a chunk, as one piece.

    Raises
    ------
    DamageError
        If they are not what was packed, as far as length and checksum tell.

    """
    size = chunk.uncompressed_size
    if size > LIMIT:
        raise DamageError(f'a chunk of {size} bytes, more than the {LIMIT} that are read')
    try:
        data = decompress(chunk.compression, chunk.data, size)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamageError(f'a chunk cannot be unpacked: {error}') from None
    if len(data) != size:
        raise DamageError(f'a chunk of {size} bytes unpacks to {len(data)}')
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamageError('the checksum of a chunk is wrong')
    return data


def unpack_start(body: bytes) -> bytes:
    """Return what can be had of the chunk whose record is cut off, without a checksum."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        return b''.join(_pieces(chunk))
    except (EndOfFile, struct.error, ValueError, zstandard.ZstdError, RuntimeError):
        return b''


def decompress(compression: str, data: bytes, size: int) -> bytes:
    """Decompress to `size` bytes, or to some others, but never to more than one beyond."""
    if compression == '':
        return data
    if compression == 'zstd':
        # What the frame claims would be believed
        claimed = zstandard.frame_content_size(data)
        if claimed not in (-1, size):
            raise DamageError(f'a chunk of {size} bytes claims to unpack to {claimed}')
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    if compression == 'lz4':
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    raise DamageError(f'a chunk is compressed by {compression!r}, not by zstd or lz4')


def _pieces(chunk: Chunk) -> Iterator[bytes]:
    """Decompress piece by piece, up to where the data end."""
    if chunk.compression == '':
        yield chunk.data
    elif chunk.compression == 'zstd':
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            yield from _up_to_limit(lambda: reader.read(_WINDOW))
    elif chunk.compression == 'lz4':
        decompressor = lz4.frame.LZ4FrameDecompressor()
        data = iter([chunk.data])
        yield from _up_to_limit(
            lambda: decompressor.decompress(next(data, b''), max_length=_WINDOW)
        )


def _up_to_limit(read: Callable[[], bytes]) -> Iterator[bytes]:
    for _ in range(LIMIT // _WINDOW):
        try:
            piece = read()
        except (zstandard.ZstdError, RuntimeError, EOFError):
            return
        if not piece:
            return
        yield piece


def split(data: bytes) -> Iterator[tuple[int, int, int]]:
    """
    Find the records in the data of a chunk.

    Yields
    ------
    opcode : int
        The kind of the record.
    offset, end : int
        Where it begins in `data`, and where the next one does.

    Raises
    ------
    DamageError
        At the end, if the last one is cut off.

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
        raise DamageError('a record in a chunk is cut off')


def scan(file: File) -> Iterator[Found | Gap]:
    """
    Find the records of a file one by one, up to its footer, and go on after what is damaged.

    Yields
    ------
    Found
        A record; the bodies of chunks are not looked into.
    Gap
        Something that is none.

    """
    scanner = _Scanner(file)
    offset = len(MAGIC) if file.read(0, len(MAGIC)) == MAGIC else 0
    found: Found | None = None
    while offset < file.size:
        try:
            found = scanner.record(offset)
        except DamageError as error:
            end = scanner.next_record(offset)
            yield Gap(file.path, offset, end - offset, str(error))
            offset, found = end, None
            continue
        yield found
        offset = found.end
        if found.opcode == Opcode.FOOTER:
            return
    if found is not None:
        yield Gap(file.path, file.size, 0, 'the file has no end')


class _Scanner:
    """Tells records from other bytes."""

    def __init__(self, file: File) -> None:
        self._file = file
        self._has_chunks = False

    def record(self, offset: int) -> Found:
        """Return the record at `offset`, or raise DamageError."""
        found = self._file.record(offset)
        self._has_chunks |= found.opcode == Opcode.CHUNK
        if found.opcode in _TYPES:
            parse(found.opcode, found.body)
        if found.opcode == Opcode.CHUNK:
            return found  # what is in it has a checksum
        if not self._may_begin(found.end):
            raise DamageError(f'no record follows one of {len(found.body)} bytes')
        return found

    def next_record(self, offset: int) -> int:
        """Return where the next record begins after a damaged one, or the end of the file."""
        try:
            _, end = self._file.head(offset)
            self.record(end)
        except DamageError:
            pass
        else:
            return end
        begin = offset + 1
        while begin < self._file.size:
            window = self._file.read(begin, _WINDOW + HEAD.size)
            for match in _HEAD_PATTERN.finditer(window):
                if self._is_sure(begin + match.start()):
                    return begin + match.start()
            begin += _WINDOW
        return self._file.size

    def _is_sure(self, offset: int) -> bool:
        try:
            opcode, end = self._file.head(offset)
            if not self._may_begin(end):
                return False
            if opcode == Opcode.MESSAGE:
                # In a file with chunks it is within one that is damaged
                return not self._has_chunks and end - offset >= MESSAGE.size
            record = parse(opcode, self._file.record(offset).body)
            if isinstance(record, Chunk):
                unpack(record)
        except DamageError:
            return False
        return True

    def _may_begin(self, offset: int) -> bool:
        """Tell whether a record may begin there, or the file ends."""
        head = self._file.read(offset, HEAD.size)
        if len(head) < HEAD.size:
            return True
        opcode, length = HEAD.unpack(head)
        return (opcode in _TYPES or opcode >= _PRIVATE) and length < 2**48 or head == MAGIC
