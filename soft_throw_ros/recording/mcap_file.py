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
One MCAP file of a bag: which chunks it has, and what is in them.

Records are parsed by the library `mcap`. Its own readers stop at the first damage, and need the
end of the file, so that chunks are found here: by going from record to record.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator
import contextlib
from io import BytesIO
import mmap
import os
from pathlib import Path
import re
import struct
from typing import Any, BinaryIO, NamedTuple
import zlib

from mcap import records as mcap
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.stream_reader import breakup_chunk, StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.recording.cdr import decoder_of, MessageError
from soft_throw_ros.recording.message import BagError, Channel, LATEST, Message
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

_OTHERS = {
    b'SQLite format 3': 'is a bag in sqlite3, not in MCAP',
    b'#ROSBAG V': 'is a bag of ROS 1, not in MCAP',
    b'\x28\xb5\x2f\xfd': 'is compressed as a whole',
}
"""What files begin with that are no MCAP, and what they are."""

CONVERSION = 'convert it, as with rosbags: rosbags-convert --src BAG --dst NEW --dst-storage mcap'

_NAME = r'[A-Za-z]\w*'
_TYPE = re.compile(rf'{_NAME}/msg/{_NAME}', re.ASCII)
_TOPIC = re.compile(r'(/[A-Za-z_]\w*)+', re.ASCII)

_LIBRARY_ERRORS = (
    *(McapError, ValueError, LookupError, ArithmeticError, EOFError, MemoryError, TypeError),
    *(OSError, RuntimeError, struct.error, zstandard.ZstdError),
)
"""What the library raises, where damaged bytes lead it."""


class DamageError(ValueError):
    """Bytes are not what they should be; the message says why."""


class Gap(NamedTuple):
    """A part of a file that cannot be read."""

    path: Path  # The file
    # Where it begins, and how long it is; 0 if only something is missing there. [bytes]
    offset: int
    size: int
    reason: str  # What is wrong
    messages: int = 0  # How many messages are not read for it, as far as is known

    def __str__(self) -> str:
        place = f'{self.size} bytes at {self.offset}: ' if self.size else ''
        count = f' ({self.messages} messages)' if self.messages else ''
        return f'{self.path}: {place}{self.reason}{count}'


class Chunk(NamedTuple):
    """Where a chunk of messages is, the span of their log times, and their channels if known."""

    offset: int
    size: int
    first: int
    last: int
    channels: frozenset[int]


class Definitions:
    """
    The channels of a file or stream, by their numbers in it.

    `known` has the channels of all files of a bag, so that what is the same is one object. With
    `is_strict`, what has no checksum, and may be damaged, is left out where nobody could tell.

    Attributes
    ----------
    doubts : list of str
        What was left out of channels that are not.

    """

    def __init__(self, known: dict[tuple[object, ...], Channel], *, is_strict: bool) -> None:
        self._known = known
        self._is_strict = is_strict
        self._schemas: dict[int, tuple[mcap.Schema, bool]] = {}  # and whether it was checked
        self._records: dict[int, tuple[mcap.Channel, bool]] = {}
        self._channels: dict[int, Channel] = {}
        self.doubts: list[str] = []
        self._is_new = False  # whether there are records that these have not

    def add(self, record: mcap.Schema | mcap.Channel, *, is_checked: bool = True) -> None:
        """Take a definition; one that has no checksum only if there is no other."""
        records: dict[int, Any] = (
            self._schemas if isinstance(record, mcap.Schema) else self._records
        )
        if is_checked or record.id not in records:
            records[record.id] = record, is_checked
            self._is_new = True

    @property
    def channels(self) -> dict[int, Channel]:
        """Those that are defined; BagError if one is not of ROS 2."""
        if self._is_new:
            self._channels, self.doubts, self._is_new = {}, [], False
            for number, (record, is_checked) in self._records.items():
                schema, is_schema_checked = self._schemas.get(record.schema_id, (None, False))
                is_trusted = (is_checked and is_schema_checked) or not self._is_strict
                if schema is not None and (is_trusted or _is_sound(record, schema)):
                    self._channels[number] = self._make(record, schema, is_trusted=is_trusted)
        return self._channels

    def message(self, record: mcap.Message) -> Message:
        """Return a message, or raise DamageError."""
        channel = self.channels.get(record.channel_id)
        if channel is None:
            raise DamageError(f'nothing defines channel {record.channel_id} of a message')
        if (record.log_time | record.publish_time) > LATEST:
            raise DamageError('a message has no valid times')
        return Message(channel, record.data, record.log_time, record.publish_time, record.sequence)

    def _make(self, record: mcap.Channel, schema: mcap.Schema, *, is_trusted: bool) -> Channel:
        if record.message_encoding != 'cdr':
            raise BagError(
                f'{record.topic} has messages in {record.message_encoding!r}, not in '
                "'cdr' as those of ROS 2 are"
            )
        metadata = record.metadata if is_trusted else {}
        if not is_trusted and record.metadata:
            self.doubts.append(f'type hash and quality of service of {record.topic}')
        channel = Channel(
            topic=record.topic,
            type=schema.name,
            schema=schema.data.decode(errors='replace'),
            type_hash=metadata.get('topic_type_hash', ''),
            qos=metadata.get('offered_qos_profiles', ''),
            schema_encoding=schema.encoding,
        )
        return self._known.setdefault(tuple(vars(channel).values()), channel)


class McapFile:
    """
    An MCAP file: which chunks it has, and what is in them.

    Its end tells the channels and how many messages there are. If that is missing, damaged or not
    true, or `by_scan`, all chunks are unpacked for it.
    """

    def __init__(
        self, path: Path, known: dict[tuple[object, ...], Channel], *, by_scan: bool
    ) -> None:
        self.definitions = Definitions(known, is_strict=by_scan)
        self.gaps: list[Gap] = []
        self.chunks: list[Chunk] = []
        self.metadata: list[mcap.Metadata] = []
        self._path = path
        self._attachments: list[int] = []  # offsets
        self._unchunked: list[mcap.Message] = []
        self._counts: Counter[int] = Counter()  # of messages, by their channels
        self._told = 0  # how many messages there are, by the end of the file
        self._file = _open(path, is_lenient=by_scan)
        self._size = os.fstat(self._file.fileno()).st_size
        try:
            if not self._read_end() or by_scan:
                self._scan()
            self.counts = self._count_by_channel()
        except BagError as error:
            self.close()
            raise BagError(f'{path}: {error}') from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def attachments(self) -> Iterator[mcap.Attachment]:
        """Yield files that were written into this one."""
        for offset in self._attachments:
            try:
                record = self._record_at(offset)
            except DamageError as error:
                self._note(offset, self._head(offset)[1] - offset, str(error))
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
                    yield self.definitions.message(record)
        except DamageError as error:
            self._note(chunk.offset, chunk.size, str(error))

    def _numbers(self, topics: Collection[str] | None) -> set[int]:
        """Return the numbers of the channels that are wanted."""
        channels = self.definitions.channels.items()
        return {number for number, item in channels if topics is None or item.topic in topics}

    def _note(self, offset: int, size: int, reason: str, messages: int = 0) -> None:
        """Remember what cannot be read, once."""
        gap = Gap(self._path, offset, size, reason, messages)
        if gap not in self.gaps:
            self.gaps.append(gap)

    def _count_by_channel(self) -> dict[Channel, int]:
        """Name the channels of which there are so many messages."""
        channels = self.definitions.channels
        named = dict.fromkeys(channels.values(), 0)
        for number, count in self._counts.items():
            if number in channels:
                named[channels[number]] += count
            else:
                self._note(0, 0, f'nothing that can be trusted defines channel {number}', count)
        return named

    def _read(self, begin: int, end: int) -> bytes:
        return os.pread(self._file.fileno(), end - begin, begin)

    def _head(self, offset: int) -> tuple[int, int]:
        """Return the opcode of a record, and where it ends; DamageError if there is none."""
        head = self._read(offset, offset + _HEAD.size).ljust(_HEAD.size, b'\0')
        opcode, length = _HEAD.unpack(head)
        if opcode not in _OPCODES:
            raise DamageError(f'no record begins with {opcode:#04x}')
        if length > LARGEST_RECORD:
            raise DamageError(f'a record of {length} bytes, which is more than {LARGEST_RECORD}')
        if offset + _HEAD.size + length > self._size:
            raise DamageError('it ends within a record')
        return opcode, offset + _HEAD.size + length

    def _record_at(self, offset: int) -> mcap.McapRecord | None:
        """Return a record, None if it is of no known kind; DamageError if there is none."""
        opcode, end = self._head(offset)
        data = self._read(offset, end)
        checksum = int.from_bytes(data[-4:], 'little')
        is_attachment = opcode == Opcode.ATTACHMENT
        if is_attachment and checksum not in (0, zlib.crc32(data[_HEAD.size:-4])):
            raise DamageError('the checksum of the attachment there is wrong')
        if opcode >= 0x80:
            return None
        try:  # a stream of this one record, so that no length in it leads beyond its end
            return next(StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records)
        except (*_LIBRARY_ERRORS, StopIteration) as error:
            raise DamageError(f'the record there is damaged, {error!r:.100}') from None

    def _read_end(self) -> bool:
        """Read what the file says of itself at its end; tell whether that is sound and all."""
        found: dict[type, list[Any]] = defaultdict(list)  # records, by their types
        footer = self._read(max(self._size - len(MAGIC) - _FOOTER.size, 0), self._size)
        try:
            _, _, begin, _, checksum = _FOOTER.unpack(footer[: -len(MAGIC)])
            data = self._read(begin, begin + min(self._size - begin, LARGEST_RECORD))
            if not begin or checksum not in (0, zlib.crc32(data[: -len(MAGIC) - 4])):
                return False
            for record in StreamReader(BytesIO(data), skip_magic=True).records:
                found[type(record)].append(record)
            there = [self._record_at(index.offset) for index in found[mcap.MetadataIndex]]
        except _LIBRARY_ERRORS:
            return False
        for record in found[mcap.Schema] + found[mcap.Channel]:
            self.definitions.add(record, is_checked=bool(checksum))
        if not found[mcap.Statistics]:
            return False
        told: mcap.Statistics = found[mcap.Statistics][-1]
        self._told = told.message_count
        self._counts = Counter(told.channel_message_counts)
        self.metadata = [record for record in there if isinstance(record, mcap.Metadata)]
        self._attachments = [index.offset for index in found[mcap.AttachmentIndex]]
        self.chunks = sorted(
            Chunk(
                index.chunk_start_offset,
                index.chunk_length,
                index.message_start_time,
                index.message_end_time,
                frozenset(index.message_index_offsets),
            )
            for index in found[mcap.ChunkIndex]
        )
        return (
            (told.chunk_count, told.metadata_count, told.attachment_count)
            == (len(self.chunks), len(self.metadata), len(self._attachments))
            and bool(self.chunks or not told.message_count)
            and self.definitions.channels.keys() >= self._counts.keys()
        )

    def _scan(self) -> None:
        """Go from record to record, after damage from the next whole chunk on."""
        for found in (self.chunks, self.metadata, self._attachments, self._counts):
            found.clear()
        offset, opcode = len(MAGIC), 0
        while offset < self._size and opcode != Opcode.DATA_END:
            try:
                opcode, end = self._head(offset)
                self._take(opcode, offset, end)
            except DamageError as error:
                end = self._find_chunk(offset + 1)
                self._note(offset, end - offset, str(error))
            offset = end
        if opcode != Opcode.DATA_END or self._read(self._size - 8, self._size) != MAGIC:
            self._note(self._size, 0, 'the file has no end')
        self._add_chunk(_UNCHUNKED, 0, self._unchunked)
        missing = self._told - sum(self._counts.values())
        if missing > 0:
            self._note(self._size, 0, 'messages are missing that the end tells of', missing)

    def _take(self, opcode: int, offset: int, end: int) -> None:
        """Take over a record."""
        if opcode == Opcode.ATTACHMENT:
            self._attachments.append(offset)
        if opcode in (Opcode.ATTACHMENT, Opcode.HEADER, Opcode.MESSAGE_INDEX):
            return  # the latter has very many numbers, and nobody needs them
        match self._record_at(offset):
            case mcap.Chunk() as chunk:
                records = unpack(chunk)
                for record in records:
                    if isinstance(record, mcap.Schema | mcap.Channel):
                        self.definitions.add(record, is_checked=chunk.uncompressed_crc != 0)
                self._add_chunk(offset, end - offset, records)
            case mcap.Message() as record:
                self._unchunked.append(record)
            case mcap.Metadata() as record:
                self.metadata.append(record)
            case mcap.Schema() | mcap.Channel() as record:
                self.definitions.add(record, is_checked=False)

    def _add_chunk(self, offset: int, size: int, records: Iterable[mcap.McapRecord]) -> None:
        messages = [record for record in records if isinstance(record, mcap.Message)]
        counts = Counter(message.channel_id for message in messages)
        self._counts += counts
        if messages:
            times = [message.log_time for message in messages]
            self.chunks.append(Chunk(offset, size, min(times), max(times), frozenset(counts)))

    def _find_chunk(self, start: int) -> int:
        """Return where the next chunk that is whole begins, or the file ends."""
        with mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for match in _CHUNK_HEAD.finditer(data, start):
                with contextlib.suppress(DamageError):
                    if unpack(self._record_at(match.start())):
                        return match.start()
        return self._size


def read_stream(stream: BinaryIO, name: str = 'the stream') -> Iterator[Message | mcap.Metadata]:
    """
    Yield messages and named texts of an MCAP stream, as they arrive.

    Parameters
    ----------
    stream : binary file
        May be a pipe.
    name : str
        What it is called in messages.

    Raises
    ------
    BagError
        Where the stream is no MCAP (any more), after all that came before; not where it ends,
        since a writer may be killed.

    """
    definitions = Definitions({}, is_strict=False)
    records = StreamReader(stream, validate_crcs=True, record_size_limit=LARGEST_RECORD).records
    try:
        for record in records:
            match record:
                case mcap.Message():
                    yield definitions.message(record)
                case mcap.Schema() | mcap.Channel():
                    definitions.add(record)
                case mcap.Metadata():
                    yield record
    except EndOfFile:
        return
    except _LIBRARY_ERRORS as error:
        raise BagError(f'{name}: it is damaged, {error!s:.200}') from None


def unpack(chunk: mcap.McapRecord | None) -> list[mcap.McapRecord]:
    """Return the records of a chunk, or raise DamageError."""
    if not isinstance(chunk, mcap.Chunk):
        raise DamageError('there is no chunk')
    try:
        return breakup_chunk(chunk, validate_crc=True)
    except _LIBRARY_ERRORS as error:
        raise DamageError(f'the chunk there cannot be unpacked, {error!s:.100}') from None


def _is_sound(record: mcap.Channel, schema: mcap.Schema) -> bool:
    """Tell whether others could read a definition that has no checksum."""
    if not (_TOPIC.fullmatch(record.topic) and _TYPE.fullmatch(schema.name)):
        return False
    if schema.encoding == 'ros2idl':
        return True
    try:
        decoder_of(schema.name, schema.data.decode())
    except (MessageError, UnicodeDecodeError):
        return False
    return schema.encoding == 'ros2msg'


def _open(path: Path, *, is_lenient: bool) -> BinaryIO:
    """Open an MCAP file, or say what is wrong with it; a damaged beginning is, unless lenient."""
    if path.exists() and not path.is_file():
        raise BagError(f'{path} is no file')
    try:
        stream = path.open('rb')
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    begin = stream.read(16)
    reason = '' if begin.startswith(MAGIC) or is_lenient else 'is no MCAP file'
    if not begin:
        reason = 'is empty'
    for magic, kind in _OTHERS.items():
        if begin.startswith(magic):
            reason = f'{kind}; {CONVERSION}'
    if reason:
        stream.close()
        raise BagError(f'{path} {reason}')
    return stream
