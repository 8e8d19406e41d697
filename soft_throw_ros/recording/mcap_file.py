# SPDX-License-Identifier: Apache-2.0
"""One MCAP file of a bag: what is where in it, and its messages."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
import contextlib
from dataclasses import dataclass
import itertools
import operator
from pathlib import Path
import tempfile
from typing import Any, BinaryIO, NamedTuple
import zlib

from mcap import records as mcap
from mcap.opcode import Opcode
import numpy as np
from soft_throw_ros.recording import qos
from soft_throw_ros.recording.message import BagError, Channel, Message
from soft_throw_ros.recording.records import (
    DamageError,
    decompress,
    File,
    Found,
    Gap,
    HEAD,
    IndexSize,
    LIMIT,
    MAGIC,
    MESSAGE_HEAD,
    parse,
    scan,
    split,
    unpack,
    unpack_start,
)
import zstandard

LATEST = 2**63 - 1
"""The latest time that ROS knows. [ns]"""

Known = dict[tuple[Any, ...], Channel]
"""The channels of all files of a bag, by what they are."""

_CHUNK = bytes([Opcode.CHUNK])
_FOOTER_SIZE = HEAD.size + 20 + len(MAGIC)
_LONGEST_INDEX = 64 * 2**20  # that is read, and not scanned for [bytes]
_BARE_SIZE = 256 * 2**10  # of a block of messages that are in no chunk [bytes]
_OTHERS = {'sqlite3': b'SQLite format 3', 'ROS 1': b'#ROSBAG V'}
_ZSTD = b'\x28\xb5\x2f\xfd'


class Block(NamedTuple):
    """
    Messages that stand together.

    Parameters
    ----------
    offset, end : int
        Where. [bytes]
    first, last : int
        Their log times. [ns]
    numbers : frozenset of int
        Their channels; empty if that is not known.
    kind : {'chunk', 'cut', 'bare'}
        Whether they are in a chunk, in one whose end is missing, or in none.

    """

    offset: int
    end: int
    first: int
    last: int
    numbers: frozenset[int]
    kind: str = 'chunk'


@dataclass(frozen=True, kw_only=True)
class Selection:
    """
    Which messages are wanted.

    Parameters
    ----------
    topics : collection of str, optional
        Of which topics; of all by default.
    start, end : int
        From which log time on, and before which. [ns]

    """

    topics: Collection[str] | None = None
    start: int = 0
    end: int = LATEST + 1


class Channels:
    """
    The channels of a file or stream, by their numbers in it.

    Parameters
    ----------
    known : dict
        Channels that are the same as one in it become that one.

    """

    def __init__(self, known: Known) -> None:
        self._known = known
        self._schemas: dict[int, mcap.Schema] = {}
        self._records: dict[int, mcap.Channel] = {}
        self._checked: set[tuple[type, int]] = set()
        self._made: dict[int, Channel] = {}

    def add(self, record: mcap.Schema | mcap.Channel, *, is_checked: bool = False) -> None:
        """Take a definition; one that had a checksum wins over those that had none."""
        key = (type(record), record.id)
        if is_checked or key not in self._checked:
            if is_checked:
                self._checked.add(key)
            if isinstance(record, mcap.Schema):
                self._schemas[record.id] = record
            else:
                self._records[record.id] = record
            self._made.clear()

    def get(self, number: int) -> Channel | None:
        """
        Return a channel; None if it, or its schema, is not defined.

        Raises
        ------
        BagError
            If its messages are not those of ROS 2.

        """
        if number not in self._made and number in self._records:
            record = self._records[number]
            schema = self._schemas.get(record.schema_id)
            if record.message_encoding != 'cdr':
                raise BagError(
                    f'{record.topic} has messages in {record.message_encoding!r}, not in '
                    "'cdr' as those of ROS 2 are"
                )
            if schema is not None:
                self._made[number] = self._make(record, schema)
        return self._made.get(number)

    def all(self) -> dict[int, Channel]:
        """Return those that are defined."""
        found = {number: self.get(number) for number in self._records}
        return {number: channel for number, channel in found.items() if channel is not None}

    def _make(self, record: mcap.Channel, schema: mcap.Schema) -> Channel:
        try:
            profiles = qos.from_yaml(record.metadata.get('offered_qos_profiles'))
        except ValueError:
            profiles = ()  # recorders of others write what they like
        channel = Channel(
            topic=record.topic,
            type=schema.name,
            schema=schema.data.decode(errors='replace'),
            type_hash=record.metadata.get('topic_type_hash', ''),
            qos=profiles,
            schema_encoding=schema.encoding,
        )
        return self._known.setdefault(tuple(vars(channel).values()), channel)


class McapFile:
    """
    An MCAP file, ready to be read.

    Parameters
    ----------
    path : Path
        The file, which may be compressed as a whole.
    known : dict
        Channels of the files before it; its own are added.
    by_scan : bool
        Whether to look at all that is in the file, instead of believing the index at its end.
    has_compressed_messages : bool
        Whether each message is compressed by itself.

    Attributes
    ----------
    path : Path
        As given.
    blocks : list of Block
        Where messages are, as they follow each other.
    counts : dict of Channel to int
        How many messages there are.
    gaps : list of Gap
        What could not be read, as far as is known by now.

    Raises
    ------
    BagError
        If the file is none, or cannot be opened; the message names it.

    """

    def __init__(
        self,
        path: Path,
        known: Known,
        *,
        by_scan: bool = False,
        has_compressed_messages: bool = False,
    ) -> None:
        self.path = path
        self.blocks: list[Block] = []
        self.gaps: list[Gap] = []
        self._has_compressed_messages = has_compressed_messages
        self._known = known
        self._file = _open(path, is_lenient=by_scan)
        try:
            self._begin()
            if by_scan or not self._read_index():
                self._begin()
                self._scan()
            self.counts = self._counts_by_channel()
        except BagError as error:
            self._file.close()
            raise BagError(f'{path}: {error}') from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def metadata(self) -> Iterator[mcap.Metadata]:
        """Yield named texts."""
        for offset in self._metadata:
            record = self._record(offset)
            if isinstance(record, mcap.Metadata):
                yield record

    def attachments(self) -> Iterator[mcap.Attachment]:
        """Yield files that were written into this one."""
        for offset in self._attachments:
            record = self._record(offset)
            if isinstance(record, mcap.Attachment):
                yield record

    def select(self, selection: Selection) -> list[Block]:
        """List the blocks that may have messages which are wanted."""
        numbers = self._numbers(selection)
        return [
            block
            for block in self.blocks
            if block.first < selection.end
            and block.last >= selection.start
            and not (block.numbers and block.numbers.isdisjoint(numbers))
        ]

    def unpack(self, block: Block) -> bytes:
        """Return the records of a block; nothing if they are damaged."""
        if block.kind == 'bare':
            return self._file.read(block.offset, block.end - block.offset)
        if block.kind == 'cut':
            return self._unpack_start(block.offset)
        try:
            return self._unpack_chunk(block.offset)
        except DamageError as error:
            self._note(block.offset, block.end, error)
            return b''

    def messages(
        self, block: Block, data: bytes, selection: Selection, *, by_time: bool
    ) -> Iterator[Message]:
        """Yield those messages of a block that are wanted, from its records."""
        numbers = self._numbers(selection)
        times, positions = array('Q'), array('Q')
        try:
            for opcode, position, end in split(data):
                if opcode == Opcode.MESSAGE and end - position >= MESSAGE_HEAD.size:
                    _, _, number, _, log_time, publish_time = MESSAGE_HEAD.unpack_from(
                        data, position
                    )
                    if (
                        number in numbers
                        and selection.start <= log_time < selection.end
                        and publish_time <= LATEST
                    ):
                        times.append(log_time)
                        positions.append(position)
        except DamageError as error:
            if block.kind != 'cut':
                self._note(block.offset, block.end, error)
        is_sorted = all(map(operator.le, times, itertools.islice(times, 1, None)))
        order: Iterable[int] = positions
        if by_time and not is_sorted:
            order = np.array(positions)[np.argsort(np.array(times), kind='stable')].tolist()
        for position in order:
            _, length, number, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(
                data, position
            )
            body = data[position + MESSAGE_HEAD.size : position + HEAD.size + length]
            if self._has_compressed_messages:
                try:
                    body = _decompressed_message(body)
                except DamageError as error:
                    self._note(block.offset, block.end, error)
                    continue
            yield Message(numbers[number], body, log_time, publish_time, sequence)

    def messages_as_written(self) -> Iterator[Message]:
        """Yield all messages in the order in which they stand in the file."""
        for block in self.blocks:
            yield from self.messages(block, self.unpack(block), Selection(), by_time=False)

    def _begin(self) -> None:
        """Know nothing."""
        self.blocks.clear()
        self.gaps.clear()
        self._channels = Channels(self._known)
        self._counts: Counter[int] = Counter()
        self._metadata: list[int] = []
        self._attachments: list[int] = []
        self._noted: set[int] = set()
        self._is_chunk_lost = False

    def _numbers(self, selection: Selection) -> dict[int, Channel]:
        """Return the channels that are wanted."""
        return {
            number: channel
            for number, channel in self._channels.all().items()
            if selection.topics is None or channel.topic in selection.topics
        }

    def _counts_by_channel(self) -> dict[Channel, int]:
        channels = self._channels.all()
        counts = dict.fromkeys(channels.values(), 0)
        for number, count in self._counts.items():
            if number in channels:
                counts[channels[number]] += count
            else:
                reason = f'nothing defines channel {number}'
                self.gaps.append(Gap(self.path, 0, 0, reason, count))
        return counts

    def _record(self, offset: int) -> mcap.McapRecord | None:
        """Return the record at `offset`; None if it is damaged."""
        try:
            return self._file.record(offset).record
        except DamageError as error:
            self._note(offset, offset, error)
            return None

    def _note(self, offset: int, end: int, error: DamageError) -> None:
        """Remember what is damaged, once."""
        if offset not in self._noted:
            self._noted.add(offset)
            self.gaps.append(Gap(self.path, offset, end - offset, str(error)))

    def _read_index(self) -> bool:
        """Take over the index at the end; tell whether it is there and complete."""
        try:
            footer = self._file.record(self._file.size - _FOOTER_SIZE)
            if not isinstance(footer.record, mcap.Footer):
                return False
            start, checksum = footer.record.summary_start, footer.record.summary_crc
            if not 0 < start <= footer.offset or footer.offset - start > _LONGEST_INDEX:
                return False
            # The checksum is also that of the footer, up to where it stands itself
            data = self._file.read(start, footer.end - 4 - start)
            if checksum and checksum != zlib.crc32(data):
                return False
            return self._take_index(data[: footer.offset - start])
        except DamageError:
            return False

    def _take_index(self, data: bytes) -> bool:
        statistics: mcap.Statistics | None = None
        same: dict[frozenset[int], frozenset[int]] = {}  # there are many chunks
        for opcode, begin, end in split(data):
            match parse(opcode, data[begin + HEAD.size : end]):
                case mcap.Schema() | mcap.Channel() as definition:
                    self._channels.add(definition)
                case mcap.ChunkIndex() as chunk:
                    offset, length = chunk.chunk_start_offset, chunk.chunk_length
                    if self._file.head(offset) != (Opcode.CHUNK, offset + length):
                        return False
                    numbers = frozenset(chunk.message_index_offsets)
                    self.blocks.append(
                        Block(
                            offset,
                            offset + length,
                            chunk.message_start_time,
                            chunk.message_end_time,
                            same.setdefault(numbers, numbers),
                        )
                    )
                case mcap.MetadataIndex() as index:
                    self._metadata.append(index.offset)
                case mcap.AttachmentIndex() as index:
                    self._attachments.append(index.offset)
                case mcap.Statistics() as found:
                    statistics = found
        if statistics is None:
            return False
        self.blocks.sort()
        self._counts.update(statistics.channel_message_counts)
        return (
            self._channels.all().keys() >= self._counts.keys()
            and len(self.blocks) == statistics.chunk_count
            and bool(self.blocks or not statistics.message_count)
            and len(self._metadata) == statistics.metadata_count
            and len(self._attachments) == statistics.attachment_count
        )

    def _scan(self) -> None:
        """Look at every record of the file."""
        for item in scan(self._file):
            if isinstance(item, Found):
                self._add(item)
                continue
            self.gaps.append(item)
            if item.size and self._file.read(item.offset, 1) == _CHUNK:
                self._is_chunk_lost = True
                if item.offset + item.size == self._file.size:
                    data = self._unpack_start(item.offset)
                    count = self._add_block(data, item.offset, self._file.size, kind='cut')
                    reason = f'{item.reason}; {count} messages before that are read'
                    self.gaps[-1] = item._replace(reason=reason)

    def _add(self, found: Found) -> None:
        """Take over a record."""
        match found.record:
            case mcap.Chunk() as chunk:
                self._is_chunk_lost = False
                try:
                    data = unpack(chunk)
                except DamageError as error:
                    self._is_chunk_lost = True
                    self._note(found.offset, found.end, error)
                    return
                self._add_block(
                    data, found.offset, found.end, is_checked=bool(chunk.uncompressed_crc)
                )
            case IndexSize() as index:
                if self._is_chunk_lost:
                    gap = self.gaps[-1]
                    self.gaps[-1] = gap._replace(messages=gap.messages + index.count)
            case mcap.Message() as message:
                self._add_bare_message(message, found)
            case mcap.Metadata():
                self._metadata.append(found.offset)
            case mcap.Attachment():
                self._attachments.append(found.offset)
            case mcap.Schema() | mcap.Channel() as definition:
                self._channels.add(definition)

    def _add_block(
        self, data: bytes, offset: int, end: int, *, kind: str = 'chunk', is_checked: bool = False
    ) -> int:
        """Take over what is in a chunk; return how many messages that are."""
        counts: Counter[int] = Counter()
        first, last = LATEST, 0
        try:
            for opcode, begin, stop in split(data):
                if opcode == Opcode.MESSAGE and stop - begin >= MESSAGE_HEAD.size:
                    _, _, number, _, log_time, publish_time = MESSAGE_HEAD.unpack_from(data, begin)
                    if log_time <= LATEST >= publish_time:
                        counts[number] += 1
                        first, last = min(first, log_time), max(last, log_time)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    definition = parse(opcode, data[begin + HEAD.size : stop])
                    if isinstance(definition, mcap.Schema | mcap.Channel):
                        self._channels.add(definition, is_checked=is_checked)
        except DamageError as error:
            if kind != 'cut':
                self._note(offset, end, error)
        if counts:
            self.blocks.append(Block(offset, end, first, last, frozenset(counts), kind))
            self._counts.update(counts)
        return counts.total()

    def _add_bare_message(self, message: mcap.Message, found: Found) -> None:
        """Take over a message that is in no chunk, with those right before it."""
        time, number = message.log_time, message.channel_id
        if max(time, message.publish_time) > LATEST:
            self._note(found.offset, found.end, DamageError('a message has no valid times'))
            return
        self._counts[number] += 1
        block = Block(found.offset, found.end, time, time, frozenset([number]), 'bare')
        if self.blocks:
            last = self.blocks[-1]
            size = found.end - last.offset
            if last.kind == 'bare' and last.end == found.offset and size <= _BARE_SIZE:
                self.blocks.pop()
                block = Block(
                    last.offset,
                    found.end,
                    min(last.first, time),
                    max(last.last, time),
                    last.numbers | {number},
                    'bare',
                )
        self.blocks.append(block)

    def _unpack_chunk(self, offset: int) -> bytes:
        record = self._file.record(offset).record
        if not isinstance(record, mcap.Chunk):
            raise DamageError('no chunk is where the index says one')
        return unpack(record)

    def _unpack_start(self, offset: int) -> bytes:
        return unpack_start(self._file.read(offset + HEAD.size, LIMIT))


def _decompressed_message(data: bytes) -> bytes:
    try:
        size = zstandard.frame_content_size(data)
    except zstandard.ZstdError:
        size = -1
    if size < 0:
        raise DamageError('a message there is not compressed, as the others are')
    return decompress('zstd', data, size)


def _open(path: Path, *, is_lenient: bool) -> File:
    """Open an MCAP file, or say what is wrong with it; a damaged beginning is, unless lenient."""
    try:
        if path.exists() and not path.is_file():
            raise BagError(f'{path} is no file')
        with contextlib.ExitStack() as stack:
            stream: BinaryIO = stack.enter_context(path.open('rb'))
            begin = stream.read(16)
            if begin.startswith(_ZSTD):
                compressed = stream
                compressed.seek(0)
                stream = stack.enter_context(tempfile.TemporaryFile())
                _decompress_file(compressed, stream)
                stream.seek(0)
                begin = stream.read(16)
            _check_begin(path, begin, is_lenient=is_lenient)
            stack.pop_all()
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    except zstandard.ZstdError as error:
        raise BagError(f'{path} cannot be decompressed: {error}') from None
    return File(path, stream)


def _decompress_file(source: BinaryIO, target: BinaryIO) -> None:
    """Decompress what begins as MCAP does, or else only its beginning."""
    with zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True) as reader:
        begin = reader.read(16)
        target.write(begin)
        while begin.startswith(MAGIC) and (piece := reader.read(2**20)):
            target.write(piece)


def _check_begin(path: Path, begin: bytes, *, is_lenient: bool) -> None:
    if not begin.startswith(MAGIC):
        storage = next((name for name, magic in _OTHERS.items() if begin.startswith(magic)), '')
        if storage:
            raise BagError(f'{path} {no_mcap(storage)}')
        if not begin:
            raise BagError(f'{path} is empty')
        if not is_lenient:
            raise BagError(f'{path} is no MCAP file')


def no_mcap(storage: str) -> str:
    """Say what to do with a bag that is stored otherwise."""
    return (
        f'is a bag in {storage}, not in MCAP; convert it, as with rosbags: '
        'rosbags-convert --src BAG --dst NEW_BAG --dst-storage mcap'
    )
