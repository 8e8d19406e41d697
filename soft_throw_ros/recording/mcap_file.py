# SPDX-License-Identifier: Apache-2.0
"""
One MCAP file of a bag: which chunks it has, and what is in them.

Records are parsed by the library `mcap`. Its own readers stop at the first damage, so that the
whole chunks after it are found here.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
import contextlib
from io import BytesIO
import mmap
import os
from pathlib import Path
import re
import struct
import tempfile
from typing import Any, BinaryIO, NamedTuple
import zlib

from mcap import records as mcap
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import breakup_chunk, CRCValidationError, StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.recording.definitions import DamageError, Definitions, Known
from soft_throw_ros.recording.message import BagError, Channel, Message
import zstandard

LARGEST_RECORD = 256 * 2**20
"""A record, or a message, that claims to be larger is taken for damaged. [bytes]"""

_HEAD = struct.Struct('<BQ')  # of a record: opcode and length
_FOOTER = struct.Struct('<BQQQI')  # its head, where summary and offsets begin, and the checksum
_OPCODES = {*map(int, Opcode), *range(0x80, 0x100)}  # those from 0x80 on are anybody's own

_CHUNK_HEAD = re.compile(
    rb'\x06(?=.{4}\0{4}.{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4}))', re.DOTALL
)
"""The beginning of a chunk: opcode, length, times, size, checksum and kind of compression."""


_UNCHUNKED = -1  # instead of the offset of a chunk, for messages that are in none

_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'

_OTHERS = {b'SQLite format 3': 'in sqlite3', b'#ROSBAG V': 'of ROS 1'}

_LIBRARY_ERRORS = (
    *(McapError, ValueError, LookupError, ArithmeticError, EOFError, MemoryError, TypeError),
    *(OSError, RuntimeError, struct.error, zstandard.ZstdError),
)
"""What the library raises, where damaged bytes lead it."""


class Gap(NamedTuple):
    """A part of a file that cannot be read."""

    path: Path  # The file
    # Where it begins, and how long it is; 0 if only something is missing there. [bytes]
    offset: int
    size: int
    reason: str  # What is wrong
    messages: int = 0  # How many messages were in it, as far as is known

    def __str__(self) -> str:
        place = f'{self.size} bytes at {self.offset}: ' if self.size else ''
        count = f' ({self.messages} messages)' if self.messages else ''
        return f'{self.path}: {place}{self.reason}{count}'


class Chunk(NamedTuple):
    """Where a chunk of messages is, the span of their log times, and their channels if known."""

    offset: int
    first: int
    last: int
    channels: frozenset[int]


class McapFile:
    """
    An MCAP file: which chunks it has, and what is in them.

    Chunks are found by the summary at its end or, if that is missing, damaged or not complete, by
    looking at all records.
    """

    def __init__(
        self, path: Path, known: Known, *, by_scan: bool, has_compressed_messages: bool
    ) -> None:
        self.gaps: list[Gap] = []
        self.chunks: list[Chunk] = []
        self.metadata: list[mcap.Metadata] = []
        self.definitions = Definitions(known)
        self._path = path
        self._has_compressed_messages = has_compressed_messages
        self._attachments: list[int] = []  # offsets
        self._unchunked: list[mcap.Message] = []
        self._stream = _open(path, is_lenient=by_scan)
        self._size = os.fstat(self._stream.fileno()).st_size
        try:
            counts = self._read_summary()
            if counts is None or by_scan:
                counts = self._scan()
            self.counts = self._by_channel(counts)
        except BagError as error:
            self.close()
            raise BagError(f'{path}: {error}') from None

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def attachments(self) -> Iterator[mcap.Attachment]:
        """Yield files that were written into this one."""
        for offset in self._attachments:
            try:
                record = self._record_at(offset)
            except DamageError as error:
                self._note(offset, self._stream.tell() - offset, str(error))
            else:
                if isinstance(record, mcap.Attachment):
                    yield record

    def chunks_with(self, topics: Collection[str] | None, span: range) -> Iterator[Chunk]:
        """Yield the chunks that may have messages of the topics and of times in the span."""
        numbers = self._numbers(topics)
        for chunk in self.chunks:
            is_in_span = chunk.first < span.stop and chunk.last >= span.start
            if is_in_span and not (chunk.channels and chunk.channels.isdisjoint(numbers)):
                yield chunk

    def messages(
        self, chunk: Chunk, topics: Collection[str] | None, span: range
    ) -> Iterator[Message]:
        """Yield the messages of a chunk that are wanted; none if it is damaged."""
        numbers = self._numbers(topics)
        try:
            is_chunk = chunk.offset != _UNCHUNKED
            records = unpack(self._record_at(chunk.offset)) if is_chunk else self._unchunked
            for record in records:
                if (
                    isinstance(record, mcap.Message)
                    and record.channel_id in numbers
                    and span.start <= record.log_time < span.stop
                ):
                    message = self.definitions.message(record)
                    if self._has_compressed_messages:
                        message = message._replace(data=_decompress(message.data))
                    yield message
        except DamageError as error:
            self._note(chunk.offset, self._stream.tell() - chunk.offset, str(error))

    def _numbers(self, topics: Collection[str] | None) -> set[int]:
        """Return the numbers of the channels that are wanted."""
        channels = self.definitions.all().items()
        return {number for number, item in channels if topics is None or item.topic in topics}

    def _by_channel(self, counts: Mapping[int, int]) -> dict[Channel, int]:
        """Name the channels of which there are so many messages."""
        channels = self.definitions.all()
        named = dict.fromkeys(channels.values(), 0)
        for number, count in counts.items():
            if number in channels:
                named[channels[number]] += count
            else:
                self._note(0, 0, f'nothing that can be trusted defines channel {number}', count)
        return named

    def _note(self, offset: int, size: int, reason: str, messages: int = 0) -> None:
        """Remember what cannot be read, once."""
        gap = Gap(self._path, offset, size, reason, messages)
        if gap not in self.gaps:
            self.gaps.append(gap)

    def _record_at(self, offset: int) -> mcap.McapRecord | None:
        self._stream.seek(offset)
        return next(read_records(self._stream), None)

    def _read_summary(self) -> Mapping[int, int] | None:
        """Return the counts of messages; None if the summary is not what it should be."""
        found: dict[type, list[Any]] = defaultdict(list)  # records, by their types
        try:
            self._stream.seek(-_FOOTER.size - len(MAGIC), os.SEEK_END)
            _, _, start, _, checksum = _FOOTER.unpack(self._stream.read(_FOOTER.size))
            self._stream.seek(start)
            data = self._stream.read(min(self._size - len(MAGIC) - start, LARGEST_RECORD))
            if not start or checksum not in (0, zlib.crc32(data[:-4])):
                return None
            for record in read_records(BytesIO(data)):
                found[type(record)].append(record)
            there = (self._record_at(index.offset) for index in found[mcap.MetadataIndex])
            metadata = [record for record in there if isinstance(record, mcap.Metadata)]
        except (OSError, ValueError, struct.error):
            return None
        for record in found[mcap.Schema] + found[mcap.Channel]:
            self.definitions.add(record, is_checked=bool(checksum))
        if not found[mcap.Statistics]:
            return None
        statistics, chunks = found[mcap.Statistics][-1], found[mcap.ChunkIndex]
        is_complete = (
            {each.id for each in found[mcap.Channel]} >= statistics.channel_message_counts.keys()
            and len(chunks) == statistics.chunk_count
            and bool(chunks or not statistics.message_count)
            and len(found[mcap.AttachmentIndex]) == statistics.attachment_count
            and len(metadata) == statistics.metadata_count
        )
        if not is_complete:
            return None
        self.metadata = metadata
        self._attachments = [index.offset for index in found[mcap.AttachmentIndex]]
        self.chunks = sorted(
            Chunk(
                index.chunk_start_offset,
                index.message_start_time,
                index.message_end_time,
                frozenset(index.message_index_offsets),
            )
            for index in chunks
        )
        return dict(statistics.channel_message_counts)

    def _scan(self) -> Mapping[int, int]:
        """Look at all records, those after damage from the next chunk on; count the messages."""
        self.chunks, self.metadata, self._attachments = [], [], []
        counts: Counter[int] = Counter()
        offset = sound_end = len(MAGIC)  # of the last record, and the last chunk without damage
        is_complete = is_chunk_lost = False
        while offset < self._size and not is_complete:
            self._stream.seek(offset)
            try:
                for record in read_records(self._stream):
                    begin, offset = offset, self._stream.tell()
                    is_complete = isinstance(record, mcap.DataEnd)
                    if is_complete:
                        break
                    if isinstance(record, mcap.Chunk):
                        found = self._take_chunk(begin, record)
                        is_chunk_lost = found is None
                        if found is not None:
                            sound_end = offset
                            counts += found
                    elif isinstance(record, mcap.MessageIndex) and is_chunk_lost:
                        gap = self.gaps[-1]
                        self.gaps[-1] = gap._replace(messages=gap.messages + len(record.records))
                    else:
                        self._take(begin, record)
            except DamageError as error:
                begin, offset = offset, self._find_chunk(sound_end)
                sound_end = offset + 1  # so that no chunk is found twice
                if offset != begin:
                    self._note(min(begin, offset), max(offset - begin, 0), str(error))
        if not is_complete or not self._has_end():
            self._note(self._size, 0, 'the file has no end')
        return counts + self._add_messages(_UNCHUNKED, self._unchunked)

    def _has_end(self) -> bool:
        self._stream.seek(-len(MAGIC), os.SEEK_END)
        return self._stream.read() == MAGIC

    def _take_chunk(self, offset: int, chunk: mcap.Chunk) -> Counter[int] | None:
        """Take over a chunk; return how many messages of which channels, None if it is damaged."""
        records: list[mcap.McapRecord] = []
        is_sound = False
        try:
            records, is_sound = unpack(chunk), True
        except DamageError as error:
            self._note(offset, self._stream.tell() - offset, str(error))
            with contextlib.suppress(*_LIBRARY_ERRORS):  # a definition is better than none
                records = breakup_chunk(chunk)
        for record in records:
            if isinstance(record, mcap.Schema | mcap.Channel):
                self.definitions.add(record, is_checked=is_sound and chunk.uncompressed_crc != 0)
        return self._add_messages(offset, records) if is_sound else None

    def _take(self, offset: int, record: mcap.McapRecord) -> None:
        """Take over a record that is in no chunk."""
        match record:
            case mcap.Message():
                self._unchunked.append(record)
            case mcap.Metadata():
                self.metadata.append(record)
            case mcap.Attachment():
                self._attachments.append(offset)
            case mcap.Schema() | mcap.Channel():
                self.definitions.add(record, is_checked=False)

    def _add_messages(self, offset: int, records: Iterable[mcap.McapRecord]) -> Counter[int]:
        messages = [record for record in records if isinstance(record, mcap.Message)]
        counts = Counter(message.channel_id for message in messages)
        if messages:
            times = [message.log_time for message in messages]
            self.chunks.append(Chunk(offset, min(times), max(times), frozenset(counts)))
        return counts

    def _find_chunk(self, start: int) -> int:
        """Return where the next chunk that is whole begins, or the file ends."""
        with mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for match in _CHUNK_HEAD.finditer(data, start):
                with contextlib.suppress(DamageError):
                    if unpack(self._record_at(match.start())):
                        return match.start()
        return self._size


def read_records(stream: BinaryIO) -> Iterator[mcap.McapRecord]:
    """Yield the records of a stream, chunks as they are; DamageError where that cannot go on."""
    while head := stream.read(_HEAD.size):
        opcode, length = _HEAD.unpack(head.ljust(_HEAD.size, b'\0'))
        if opcode not in _OPCODES:
            raise DamageError(f'no record begins with {opcode:#04x}')
        if length > LARGEST_RECORD:
            raise DamageError(f'a record of {length} bytes, which is more than {LARGEST_RECORD}')
        body = stream.read(length)
        if len(head) + len(body) < _HEAD.size + length:
            raise DamageError('it ends within a record')
        checksum = int.from_bytes(body[-4:], 'little')
        if opcode == Opcode.ATTACHMENT and checksum not in (0, zlib.crc32(body[:-4])):
            raise DamageError('the checksum of the attachment there is wrong')
        try:  # a stream of this one record, so that no length in it leads beyond its end
            records = StreamReader(BytesIO(head + body), skip_magic=True, emit_chunks=True).records
            record = next(records, None) if opcode < 0x80 else None
        except _LIBRARY_ERRORS as error:
            raise DamageError(f'the record there is damaged, {error!r:.100}') from None
        if record is not None:
            yield record
        if opcode == Opcode.FOOTER:
            return


def unpack(chunk: mcap.McapRecord | None) -> list[mcap.McapRecord]:
    """Return the records of a chunk, or raise DamageError."""
    if not isinstance(chunk, mcap.Chunk):
        raise DamageError('there is no chunk')
    try:
        return breakup_chunk(chunk, validate_crc=True)
    except CRCValidationError:
        raise DamageError('the checksum of the chunk there is wrong') from None
    except _LIBRARY_ERRORS as error:
        raise DamageError(f'the chunk there cannot be unpacked, {error!r:.100}') from None


def _decompress(data: bytes) -> bytes:
    """Decompress a message that was compressed by itself."""
    try:
        return zstandard.decompress(data, LARGEST_RECORD)
    except zstandard.ZstdError as error:
        raise DamageError(f'a message cannot be decompressed, {error}') from None


def _open(path: Path, *, is_lenient: bool) -> BinaryIO:
    """Open an MCAP file, or say what is wrong with it; a damaged beginning is, unless lenient."""
    if path.exists() and not path.is_file():
        raise BagError(f'{path} is no file')
    try:
        stream: BinaryIO = path.open('rb')
        if stream.read(len(_ZSTD_MAGIC)) == _ZSTD_MAGIC:
            stream = _decompressed(stream)
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    except zstandard.ZstdError as error:
        raise BagError(f'{path} cannot be decompressed: {error}') from None
    stream.seek(0)
    begin = stream.read(16)
    reason = '' if begin.startswith(MAGIC) or is_lenient else 'is no MCAP file'
    if not begin:
        reason = 'is empty'
    for magic, kind in _OTHERS.items():
        if begin.startswith(magic):
            reason = not_mcap(kind)
    if reason:
        stream.close()
        raise BagError(f'{path} {reason}')
    return stream


def _decompressed(stream: BinaryIO) -> BinaryIO:
    """Return a temporary file with what another one has compressed in it, and close that."""
    with stream, contextlib.ExitStack() as stack:
        whole = stack.enter_context(tempfile.TemporaryFile())
        stream.seek(0)
        zstandard.ZstdDecompressor().copy_stream(stream, whole)
        stack.pop_all()
    return whole


def not_mcap(kind: str) -> str:
    """Say what to do with a bag that is stored otherwise."""
    return (
        f'is a bag {kind}, not in MCAP; convert it, as with rosbags: '
        'rosbags-convert --src BAG --dst NEW_BAG --dst-storage mcap'
    )
