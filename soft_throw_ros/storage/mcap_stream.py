# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
MCAP files that are read in the order of writing, up to their end or the first damage.

The library `mcap` parses all records. No file may make it read or unpack more than `MAX_RECORD`
at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import functools
import io
from pathlib import Path
import sys

from mcap import records as mcap
from mcap.stream_reader import breakup_chunk, StreamReader
from mcap.writer import MCAP0_MAGIC as MAGIC
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message
from soft_throw_ros.storage.regular_file import open_regular_file

MAX_RECORD = 64 * 2**20
"""Largest size of a record, of an unpacked chunk, and of the index of a file. [bytes]"""

CONVERSION = 'convert it, as with rosbags: rosbags-convert --src BAG --dst NEW --dst-storage mcap'

_OTHER_FORMATS = {
    b'SQLite format 3': f'is a bag in sqlite3, not in MCAP; {CONVERSION}',
    b'#ROSBAG V': f'is a bag of ROS 1, not in MCAP; {CONVERSION}',
    b'\x28\xb5\x2f\xfd': f'is compressed as a whole; {CONVERSION}',
    MAGIC: '',
}
"""First bytes of files, with the reason why they are refused."""

_unique_channel = functools.cache(Channel)
"""Return one object for all equal channels, since the files of a bag repeat them."""


class UnfinishedError(BagError):
    """A file is damaged or unfinished; `recover` can copy its messages to a new bag."""

    def __init__(self, path: Path, reason: object) -> None:
        text = f'{str(reason) or type(reason).__name__:.200}'
        super().__init__(
            f'{path}: {text}; write a new bag of all that can be read: soft-throw recover BAG'
        )


class _BoundedFile(io.BufferedReader):
    """A file that refuses to read more than `MAX_RECORD` at once, whatever its records claim."""

    def read(self, size: int | None = -1) -> bytes:
        check_size(size or 0)
        return super().read(size)


def check_size(size: int) -> None:
    """Raise ValueError if a record or chunk claims too large a size [bytes]."""
    if size > MAX_RECORD:
        raise ValueError(f'a record or chunk of {size} bytes, more than {MAX_RECORD}')


def open_mcap(path: Path) -> io.BufferedReader:
    """Open an MCAP file; raise BagError if it cannot be opened, is empty or no MCAP file."""
    try:
        with open_regular_file(path, max_bytes=sys.maxsize) as file:
            begin = file.read(16)
    except OSError as error:
        raise BagError(f'{path}: {error.strerror}') from None
    reasons = [why for magic, why in _OTHER_FORMATS.items() if begin.startswith(magic)]
    if reason := 'is empty' if not begin else (*reasons, 'is no MCAP file')[0]:
        raise BagError(f'{path} {reason}')
    return _BoundedFile(io.FileIO(path))


def make_channel(record: mcap.Channel, schemas: Mapping[int, mcap.Schema]) -> Channel:
    """Return a channel; raise BagError if it is not of ROS 2."""
    if record.message_encoding != 'cdr':
        raise BagError(
            f'{record.topic} has messages in {record.message_encoding!r}, not in '
            "'cdr' as those of ROS 2 are"
        )
    schema = schemas[record.schema_id]
    return _unique_channel(
        topic=record.topic,
        type=schema.name,
        schema=schema.data.decode(errors='replace'),
        type_hash=record.metadata.get('topic_type_hash', ''),
        qos=record.metadata.get('offered_qos_profiles', ''),
        schema_encoding=schema.encoding,
    )


def make_message(record: mcap.Message, channels: Mapping[int, Channel]) -> Message:
    """Return a message; raise ValueError if its channel or its times are invalid."""
    channel = channels.get(record.channel_id)
    if channel is None:
        raise ValueError(f'nothing defines channel {record.channel_id} of a message')
    times = record.log_time, record.publish_time
    message = Message(channel, record.data, *times, record.sequence)
    if not message.has_valid_times:
        raise ValueError(f'a message has the times {times} ns, beyond {LATEST}')
    return message


class McapStream:
    """
    An MCAP file, its index not used.

    Attributes
    ----------
    channels : dict of int to Channel
        Channels by their numbers, as far as the file was read.
    metadata, attachments : list
        Named texts and attached files, as far as the file was read.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.metadata: list[mcap.Metadata] = []
        self.attachments: list[mcap.Attachment] = []
        self._end = 0  # of the last whole record [bytes]

    def messages(self) -> Iterator[Message]:
        """Yield messages as written; raise UnfinishedError at the first damage."""
        with open_mcap(self.path) as stream:
            try:
                yield from self._read(stream)
            except BagError as error:
                raise BagError(f'{self.path}: {error}') from None
            except Exception as error:  # damaged bytes may cause any error in the library
                raise UnfinishedError(self.path, error) from error

    def rest(self) -> int:
        """Return the size of all from the first damage on [bytes]."""
        return self.path.stat().st_size - self._end

    def _read(self, stream: io.BufferedReader) -> Iterator[Message]:
        schemas: dict[int, mcap.Schema] = {}
        count = 0
        for record in self._records(stream):
            match record:
                case mcap.Schema():
                    schemas[record.id] = record
                case mcap.Channel() if record.schema_id in schemas:
                    self.channels[record.id] = make_channel(record, schemas)
                case mcap.Message():
                    count += 1
                    yield make_message(record, self.channels)
                case mcap.Metadata():
                    self.metadata.append(record)
                case mcap.Attachment():
                    self.attachments.append(record)
                case mcap.Statistics() if record.message_count > count:
                    missing = record.message_count - count
                    raise ValueError(f'{missing} messages are missing before the index')

    def _records(self, stream: io.BufferedReader) -> Iterator[mcap.McapRecord]:
        """Yield records, and in place of a chunk those in it."""
        reader = StreamReader(stream, emit_chunks=True, record_size_limit=MAX_RECORD)
        for record in reader.records:
            if isinstance(record, mcap.Chunk):
                check_size(record.uncompressed_size)
                yield from breakup_chunk(record, validate_crc=True)
            else:
                yield record
            self._end = stream.tell()
        self._end = stream.tell()
