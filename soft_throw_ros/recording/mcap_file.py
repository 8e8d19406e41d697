# SPDX-License-Identifier: Apache-2.0
"""
One MCAP file of a bag: which chunks it has, and what is in them.

Records are parsed by the library `mcap`. Its own readers stop at the first damage, and take a
whole file into memory if its index is missing, so chunks are found and read one by one here, and
those that are damaged are left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
import contextlib
from io import BytesIO
import mmap
import os
from pathlib import Path
import re
import struct
import tempfile
from typing import BinaryIO, NamedTuple
import zlib

from mcap import records as mcap
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.stream_reader import breakup_chunk, CRCValidationError, StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.recording import qos
from soft_throw_ros.recording.message import BagError, Channel, LATEST, Message
import zstandard

LARGEST_RECORD = 256 * 2**20
"""A record that claims to be larger is taken for damaged. [bytes]"""

_HEAD = struct.Struct('<BQ')  # of a record: opcode and length

_FOOTER = struct.Struct('<BQQQI')  # its head, where summary and offsets begin, and the checksum

_OPCODES = {int(opcode) for opcode in Opcode}

_FIRST_PRIVATE_OPCODE = 0x80

_CHUNK_HEAD = re.compile(
    rb'\x06(?=.{4}\0{4}.{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0{4}))', re.DOTALL
)
"""The beginning of a chunk: opcode, length, times, size, checksum and kind of compression."""

_BARE = -1  # instead of the offset of a chunk, for messages that are in none

_TYPE_HASH = re.compile('RIHS01_[0-9a-f]{64}')

_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'

_OTHERS = {b'SQLite format 3': 'sqlite3', b'#ROSBAG V': 'ROS 1'}

Known = dict[tuple[object, ...], Channel]


_LIBRARY_ERRORS = (
    *(McapError, ValueError, LookupError, ArithmeticError, EOFError, MemoryError, TypeError),
    *(OSError, RuntimeError, struct.error, zstandard.ZstdError),
)
"""What the library raises, where damaged bytes lead it."""


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
        Where it begins, and how long it is; 0 if only something is missing there. [bytes]
    reason : str
        What is wrong.
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


class Chunk(NamedTuple):
    """Where a chunk of messages is, the span of their log times, and their channels if known."""

    offset: int
    first: int
    last: int
    channels: frozenset[int]


class Definitions:
    """
    The channels of a file or stream, by their numbers in it.

    `known` has the channels of all files of a bag, so that what is the same is one object.
    """

    def __init__(self, known: Known) -> None:
        self._known = known
        self._schemas: dict[int, mcap.Schema] = {}
        self._records: dict[int, mcap.Channel] = {}
        self._channels: dict[int, Channel | None] = {}

    def add(self, record: mcap.Schema | mcap.Channel, *, has_checksum: bool = True) -> None:
        """Take a definition; one without a checksum only if there is none yet."""
        if isinstance(record, mcap.Schema):
            if has_checksum or record.id not in self._schemas:
                self._schemas[record.id] = record
        elif has_checksum or record.id not in self._records:
            self._records[record.id] = record
        self._channels.clear()

    def get(self, number: int) -> Channel | None:
        """
        Return a channel; None if it, or its schema, is not defined.

        Raises
        ------
        BagError
            If its messages are not those of ROS 2.

        """
        if number not in self._channels:
            record = self._records.get(number)
            schema = self._schemas.get(record.schema_id) if record is not None else None
            self._channels[number] = self._make(record, schema) if record and schema else None
        return self._channels[number]

    def all(self) -> dict[int, Channel]:
        """Return those that are defined."""
        found = {number: self.get(number) for number in self._records}
        return {number: channel for number, channel in found.items() if channel is not None}

    def message(self, record: mcap.Message) -> Message:
        """Return a message, or raise DamageError."""
        channel = self.get(record.channel_id)
        if channel is None:
            raise DamageError(f'nothing defines channel {record.channel_id} of a message')
        if (record.log_time | record.publish_time) > LATEST:
            raise DamageError('a message has no valid times')
        return Message(channel, record.data, record.log_time, record.publish_time, record.sequence)

    def _make(self, record: mcap.Channel, schema: mcap.Schema) -> Channel:
        if record.message_encoding != 'cdr':
            raise BagError(
                f'{record.topic} has messages in {record.message_encoding!r}, not in '
                "'cdr' as those of ROS 2 are"
            )
        try:
            profiles = qos.from_yaml(record.metadata.get('offered_qos_profiles'))
        except ValueError:
            profiles = ()  # recorders of others write what they like
        type_hash = record.metadata.get('topic_type_hash', '')
        channel = Channel(
            topic=record.topic,
            type=schema.name,
            schema=schema.data.decode(errors='replace'),
            type_hash=type_hash if _TYPE_HASH.fullmatch(type_hash) else '',
            qos=profiles,
            schema_encoding=schema.encoding,
        )
        return self._known.setdefault(tuple(vars(channel).values()), channel)


class McapFile:
    """
    An MCAP file: which chunks it has, and what is in them.

    Chunks are found by the summary at its end or, if that is missing, damaged or not to be
    believed, by looking at all records.
    """

    def __init__(
        self, path: Path, known: Known, *, by_scan: bool, has_compressed_messages: bool
    ) -> None:
        self.gaps: list[Gap] = []
        self.chunks: list[Chunk] = []
        self.metadata: list[mcap.Metadata] = []
        self._path = path
        self._has_compressed_messages = has_compressed_messages
        self._attachments: list[int] = []  # offsets
        self._bare: list[mcap.Message] = []  # messages that are in no chunk
        self._definitions = Definitions(known)
        self._stream = _open(path, is_lenient=by_scan)
        self._size = os.fstat(self._stream.fileno()).st_size
        try:
            counts = None if by_scan else self._read_summary()
            self.counts = self._by_channel(self._scan() if counts is None else counts)
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
                self._note(offset, 0, str(error))
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
        for record in self._bare if chunk.offset == _BARE else self._records_at(chunk.offset):
            if (
                isinstance(record, mcap.Message)
                and record.channel_id in numbers
                and span.start <= record.log_time < span.stop
            ):
                try:
                    message = self._definitions.message(record)
                    if self._has_compressed_messages:
                        message = message._replace(data=_decompress(message.data))
                except DamageError as error:
                    self._note(chunk.offset, 0, str(error))
                else:
                    yield message

    def _numbers(self, topics: Collection[str] | None) -> set[int]:
        """Return the numbers of the channels that are wanted."""
        channels = self._definitions.all().items()
        return {number for number, item in channels if topics is None or item.topic in topics}

    def _by_channel(self, counts: Mapping[int, int]) -> dict[Channel, int]:
        """Name the channels of which there are so many messages."""
        channels = self._definitions.all()
        named = dict.fromkeys(channels.values(), 0)
        for number, count in counts.items():
            if number in channels:
                named[channels[number]] += count
            else:
                self._note(0, 0, f'nothing defines channel {number}', count)
        return named

    def _note(self, offset: int, size: int, reason: str, messages: int = 0) -> None:
        """Remember what cannot be read, once."""
        gap = Gap(self._path, offset, size, reason, messages)
        if gap not in self.gaps:
            self.gaps.append(gap)

    def _record_at(self, offset: int) -> mcap.McapRecord | None:
        self._stream.seek(offset)
        try:
            return read_record(self._stream)
        except EOFError:
            raise DamageError('the index leads beyond the end of the file') from None

    def _records_at(self, offset: int) -> list[mcap.McapRecord]:
        """Return the records of a chunk; none if it is damaged."""
        try:
            return unpack(self._record_at(offset))
        except DamageError as error:
            self._note(offset, self._stream.tell() - offset, str(error))
            return []

    def _read_summary(self) -> Mapping[int, int] | None:
        """Return the counts of messages; None if the summary is not what it should be."""
        try:
            self._stream.seek(0)
            reader = SeekingReader(self._stream, record_size_limit=LARGEST_RECORD)
            summary = reader.get_summary()
            metadata = list(reader.iter_metadata())
        except _LIBRARY_ERRORS:
            return None
        if summary is None or summary.statistics is None or not self._has_sound_summary():
            return None
        statistics = summary.statistics
        for schema in summary.schemas.values():
            self._definitions.add(schema)
        for channel in summary.channels.values():
            self._definitions.add(channel)
        is_complete = (
            self._definitions.all().keys() >= statistics.channel_message_counts.keys()
            and len(summary.chunk_indexes) == statistics.chunk_count
            and bool(summary.chunk_indexes or not statistics.message_count)
            and len(summary.attachment_indexes) == statistics.attachment_count
            and len(metadata) == statistics.metadata_count
        )
        if not is_complete:
            return None
        self.metadata = metadata
        self._attachments = [index.offset for index in summary.attachment_indexes]
        self.chunks = sorted(
            Chunk(
                index.chunk_start_offset,
                index.message_start_time,
                index.message_end_time,
                frozenset(index.message_index_offsets),
            )
            for index in summary.chunk_indexes
        )
        return statistics.channel_message_counts

    def _has_sound_summary(self) -> bool:
        """Tell whether the checksum of the summary is right, or there is none."""
        self._stream.seek(-_FOOTER.size - len(MAGIC), os.SEEK_END)
        footer = self._stream.read(_FOOTER.size)
        _, _, start, _, checksum = _FOOTER.unpack(footer)
        self._stream.seek(start)
        data = self._stream.read(self._size - len(MAGIC) - 4 - start)
        return not checksum or checksum == zlib.crc32(data)

    def _scan(self) -> Mapping[int, int]:
        """Look at all records, those after damage from the next chunk on; count the messages."""
        counts: Counter[int] = Counter()
        sound_end = len(MAGIC)  # of the last chunk that is not damaged
        is_complete = is_chunk_lost = False
        self._stream.seek(sound_end)
        while True:
            offset = self._stream.tell()
            try:
                record = read_record(self._stream)
            except EOFError:
                self._note(offset, 0, 'the file has no end')
                break
            except DamageError as error:
                if is_complete:
                    self._note(offset, 0, f'in the index, {error}')
                    break
                end = self._find_chunk(sound_end)
                self._note(min(offset, end), end - min(offset, end), str(error))
                if end == self._size:
                    break
                self._stream.seek(end)
                continue
            match record:
                case mcap.Chunk():
                    end = self._stream.tell()
                    try:
                        counts += self._add_chunk(offset, record)
                        sound_end, is_chunk_lost = end, False
                    except DamageError as error:
                        self._note(offset, end - offset, str(error))
                        is_chunk_lost = True
                case mcap.MessageIndex() if is_chunk_lost:
                    gap = self.gaps[-1]
                    self.gaps[-1] = gap._replace(messages=gap.messages + len(record.records))
                case mcap.Message():
                    self._bare.append(record)
                case mcap.Metadata():
                    self.metadata.append(record)
                case mcap.Attachment():
                    self._attachments.append(offset)
                case mcap.Schema() | mcap.Channel():
                    self._definitions.add(record, has_checksum=False)
                case mcap.DataEnd():
                    is_complete = True
                case mcap.Footer():
                    if read_exactly(self._stream, len(MAGIC)) != MAGIC:
                        self._note(self._size, 0, 'the file has no end')
                    break
        return counts + self._add_messages(_BARE, self._bare)

    def _add_chunk(self, offset: int, chunk: mcap.Chunk) -> Counter[int]:
        """Take over what a chunk has; return how many messages of which channels."""
        records = unpack(chunk)
        for record in records:
            if isinstance(record, mcap.Schema | mcap.Channel):
                self._definitions.add(record)
        return self._add_messages(offset, records)

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
                with contextlib.suppress(DamageError, EOFError):
                    if unpack(self._record_at(match.start())):
                        return match.start()
        return self._size


def read_record(stream: BinaryIO) -> mcap.McapRecord | None:
    """
    Read the next record; None for one that is private to whoever wrote it.

    Raises
    ------
    EOFError
        If the stream ends before it.
    DamageError
        If it is none, or not all of it is there.

    """
    head = read_exactly(stream, _HEAD.size)
    if not head:
        raise EOFError
    if len(head) < _HEAD.size:
        raise DamageError('it ends within a record')
    opcode, length = _HEAD.unpack(head)
    if not (opcode in _OPCODES or opcode >= _FIRST_PRIVATE_OPCODE):
        raise DamageError(f'no record begins with {opcode:#04x}')
    if length > LARGEST_RECORD:
        raise DamageError(f'a record claims to have {length} bytes, more than {LARGEST_RECORD}')
    body = read_exactly(stream, length)
    if len(body) < length:
        raise DamageError('it ends within a record')
    if opcode >= _FIRST_PRIVATE_OPCODE:
        return None
    if opcode == Opcode.ATTACHMENT and zlib.crc32(body[:-4]) != int.from_bytes(
        body[-4:], 'little'
    ):
        raise DamageError('the checksum of the attachment there is wrong')
    try:
        # A stream of this one record, so that no length in it leads beyond its end
        records = StreamReader(BytesIO(head + body), skip_magic=True, emit_chunks=True).records
        return next(records)
    except _LIBRARY_ERRORS as error:
        raise DamageError(f'the record there is damaged, {error!r}') from error


def check_magic(begin: bytes) -> None:
    """Raise DamageError if bytes are not those that every MCAP begins with."""
    if not begin.startswith(MAGIC):
        raise DamageError('it does not begin as MCAP does')


def read_exactly(stream: BinaryIO, size: int) -> bytes:
    """Read as many bytes, piece by piece, or fewer at the end."""
    pieces = []
    while size and (piece := stream.read(min(size, 2**20))):
        pieces.append(piece)
        size -= len(piece)
    return pieces[0] if len(pieces) == 1 else b''.join(pieces)


def unpack(chunk: mcap.McapRecord | None) -> list[mcap.McapRecord]:
    """
    Return the records of a chunk.

    Raises
    ------
    DamageError
        If it is none, or damaged.

    """
    if not isinstance(chunk, mcap.Chunk):
        raise DamageError('there is no chunk')
    try:
        return breakup_chunk(chunk, validate_crc=True)
    except CRCValidationError:
        raise DamageError('the checksum of the chunk there is wrong') from None
    except _LIBRARY_ERRORS as error:
        raise DamageError(f'the chunk there cannot be unpacked, {error!r}') from None


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
    for magic, storage in _OTHERS.items():
        if begin.startswith(magic):
            reason = not_mcap(storage)
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


def not_mcap(storage: str) -> str:
    """Say what to do with a bag that is stored otherwise."""
    return (
        f'is a bag in {storage}, not in MCAP; convert it, as with rosbags: '
        'rosbags-convert --src BAG --dst NEW_BAG --dst-storage mcap'
    )
