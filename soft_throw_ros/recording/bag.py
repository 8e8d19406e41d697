# SPDX-License-Identifier: Apache-2.0
"""
Bags: folders as rosbag2 writes them, with messages in MCAP files; and MCAP streams through a pipe.

Messages stay the bytes that came (see `cdr`), and are written by the library `mcap`. What is read
may be cut off, damaged or somebody else's: the reader says what is wrong, and gives the rest.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
import contextlib
from dataclasses import dataclass, field
import fcntl
import heapq
import itertools
import operator
import os
from pathlib import Path
import re
import tempfile
import textwrap
from typing import Any, BinaryIO, NamedTuple
import zlib

from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer
import numpy as np
from soft_throw_ros import __version__
from soft_throw_ros.recording import qos as qualities
from soft_throw_ros.recording.qos import Qos
from soft_throw_ros.recording.records import (
    DamageError,
    decompress,
    File,
    Found,
    Gap,
    HEAD,
    LIMIT,
    MAGIC,
    MESSAGE,
    parse,
    scan,
    split,
    unpack,
    unpack_start,
)
import yaml
import zstandard

METADATA_VERSION = 9
"""Of `metadata.yaml`, as in ROS 2 Jazzy and later."""

CHUNK_SIZE = 256 * 2**10
"""How much is compressed at once, unless a single message is larger. [bytes]"""

COMPRESSIONS = {
    'none': CompressionType.NONE,
    'lz4': CompressionType.LZ4,
    'zstd': CompressionType.ZSTD,
}
"""What the chunks of a bag may be compressed by."""

_LIBRARY = f'soft_throw_ros {__version__}'
_PROFILE = 'ros2'
_NEVER = 2**63
_FOOTER_SIZE = HEAD.size + 20 + len(MAGIC)
_CHUNK = bytes([Opcode.CHUNK])
_ZSTD = b'\x28\xb5\x2f\xfd'
_SUFFIXES = ('.mcap', '.mcap.zstd')
_NUMBER = re.compile(r'(\d+)')
_LONGEST_METADATA = 16 * 2**20  # [bytes]
_NO_MCAP = 'is no MCAP file'
_NO_BAG = 'is no bag: there is no MCAP file in it'
_Loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
_ROSBAG2 = 'rosbag2'
_INFORMATION = 'rosbag2_bagfile_information'


class BagError(ValueError):
    """A bag cannot be read or written; the message names its path, and what would be right."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Channel:
    """
    A topic in a bag; two of them are the same if they are one object.

    Parameters
    ----------
    topic : str
        Its full name.
    type : str
        As `sensor_msgs/msg/JointState`.
    schema : str
        Definition of the type and all it depends on; `schemas.find_schema` finds it.
    type_hash : str
        `RIHS01_...`, or empty.
    qos : tuple of Qos
        What its publishers offered.
    schema_encoding : str
        How the schema is written; others than `ros2msg` are kept as they are.

    """

    topic: str
    type: str
    schema: str
    type_hash: str = ''
    qos: tuple[Qos, ...] = ()
    schema_encoding: str = 'ros2msg'


class Message(NamedTuple):
    """
    A message, as it came.

    Parameters
    ----------
    channel : Channel
        Where it belongs.
    data : bytes
        Serialised, CDR.
    log_time : int
        When it was received. [ns]
    publish_time : int
        When it was published. [ns]
    sequence : int
        Its number at the publisher; the lower 32 bits are kept.

    """

    channel: Channel
    data: bytes
    log_time: int
    publish_time: int
    sequence: int = 0


class BagWriter:
    """
    Writes a bag, a new folder.

    A message is kept, whatever happens to this process, once `flush` has returned, which is to be
    called about once a second. If the disk is full, that is said by the call that notices it, and
    by all others until there is room again and `flush` can go on in a next file; only what came
    since the last `flush`, and meanwhile, is lost, and counted.

    Parameters
    ----------
    folder : path_like
        The bag; files in it are called alike. It must not exist.
    distribution : str
        Of ROS, as `jazzy`; may be empty.
    compression : {'zstd', 'lz4', 'none'}
        Of chunks.
    max_size : int
        A file that has grown beyond this is followed by a next one; 0 for never. [bytes]
    max_duration : float
        So is one whose messages span as much; 0 for never. [s]
    sync : bool
        Whether `flush` waits until the disk has it, so that it outlasts the machine too.

    Attributes
    ----------
    folder : Path
        The bag.
    counts, lost : dict of Channel to int
        How many messages are in the bag as of the last `flush`, and how many are not because of an
        error.

    Raises
    ------
    BagError
        If the folder exists or cannot be made, or an argument is wrong.

    Notes
    -----
    Every file is complete by itself: each has all channels, metadata and attachments so far.
    Channels stand twice in each, since a damaged chunk would otherwise make its messages useless.
    The folder is locked (`flock`) while it is written.

    """

    def __init__(
        self,
        folder: str | Path,
        *,
        distribution: str,
        compression: str = 'zstd',
        max_size: int = 0,
        max_duration: float = 0.0,
        sync: bool = False,
    ) -> None:
        self.folder = Path(folder)
        self.counts: dict[Channel, int] = {}
        self.lost: dict[Channel, int] = {}
        if compression not in COMPRESSIONS:
            choices = ', '.join(COMPRESSIONS)
            raise BagError(f'compression must be one of {choices}, got {compression!r}')
        for name, value in {'max_size': max_size, 'max_duration': max_duration}.items():
            if not 0 <= value < _NEVER:
                raise BagError(f'{name} must be finite and not negative, got {value!r}')
        self._distribution = distribution
        self._compression = COMPRESSIONS[compression]
        self._max_size = max_size or _NEVER
        self._max_duration = round(max_duration * 1e9) or _NEVER
        self._sync = sync
        self._files: list[_Span] = []
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: list[Attachment] = []
        self._failure = ''
        self._writer: Writer | None = None
        self._ids: dict[Channel, int] = {}  # of the file that is open; empty if there is none
        self._pending: dict[Channel, int] = {}  # messages that are not in the file yet
        self._room = CHUNK_SIZE
        self._first, self._last = _NEVER, 0  # log times of what is pending
        self._until = 0  # the log time from which on a next file is due
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f'{folder} exists; a bag is never overwritten') from None
        except OSError as error:
            raise BagError(f'{folder}: {error.strerror}') from None
        self._lock = _lock(self.folder)
        try:
            self._begin_file()
        except BagError:
            os.close(self._lock)
            with contextlib.suppress(OSError):
                self.folder.rmdir()
            raise

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def size(self) -> int:
        """How large all files are together, as of the last `flush`. [bytes]"""
        return sum(file.size for file in self._files)

    def write(self, message: Message) -> None:
        """
        Write a message.

        Raises
        ------
        BagError
            If it is lost, saying why; or if its times are none.

        """
        channel, data, log_time, publish_time, sequence = message
        if (log_time | publish_time) >> 63:
            raise BagError(
                f'{channel.topic}: times must be at least 0 and below 2**63 ns, '
                f'got {log_time} and {publish_time}'
            )
        size = len(data) + MESSAGE.size
        if size > self._room or log_time >= self._until or channel not in self._ids:
            self._prepare(channel, log_time, size)
        self._writer.add_message(  # type: ignore[union-attr]
            self._ids[channel], log_time, data, publish_time, sequence & 0xFFFFFFFF
        )
        self._room -= size
        self._pending[channel] += 1
        if log_time < self._first:
            self._first = log_time
        if log_time > self._last:
            self._last = log_time

    def add_channel(self, channel: Channel) -> None:
        """Have a channel in the bag, even if no message comes; `write` does it otherwise."""
        self.counts.setdefault(channel, 0)
        if channel not in self._ids:
            with self._guard():
                self._register(channel)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts; those given last by a name are repeated in files that follow."""
        self._metadata[name] = dict(values)
        with self._guard():
            self._open_writer().add_metadata(name, dict(values))

    def attach(self, name: str, data: bytes, media_type: str, *, time: int = 0) -> None:
        """Write a file into the bag; it is repeated in files that follow."""
        attachment = Attachment(time, time, name, media_type, data)
        self._attachments.append(attachment)
        with self._guard():
            self._add_attachment(attachment)

    def flush(self) -> None:
        """
        Have all that came kept whatever happens; after an error, try again.

        Raises
        ------
        BagError
            If that cannot be done (yet).

        """
        if self._writer is None and not self._is_closed:
            self._begin_file()
        self._open_writer()
        self._end_chunk()
        if self._sync:
            with self._guard():
                os.fsync(self._output.fileno())

    def split(self) -> None:
        """Go on in a next file, unless there is no message in this one."""
        self._open_writer()
        self._end_chunk()
        if self._files[-1].count:
            self._end_file()
            self._begin_file()

    def close(self) -> None:
        """
        Finish the bag; once it is closed, do nothing.

        Raises
        ------
        BagError
            If that fails, and nothing has failed before. The bag is closed all the same.

        """
        if self._is_closed:
            return
        try:
            if self._writer is not None:
                self._end_chunk()
                self._end_file()
        finally:
            if self._failure:
                with contextlib.suppress(OSError):
                    self._write_information()
            self._failure = f'{self.folder} is closed'
            os.close(self._lock)
            self._lock = -1

    @property
    def _is_closed(self) -> bool:
        return self._lock < 0

    def _open_writer(self) -> Writer:
        """Return the writer of the open file, or say why there is none."""
        if self._writer is None:
            raise BagError(self._failure)
        return self._writer

    def _prepare(self, channel: Channel, log_time: int, size: int) -> None:
        """Make that a message can be added."""
        try:
            self._open_writer()
            if self._until and log_time >= self._until:
                self.split()
            if size > self._room:
                self._end_chunk()
                if self._output.size >= self._max_size:
                    self.split()
            if not self._until:
                self._until = log_time + self._max_duration
            if channel not in self._ids:
                with self._guard():
                    self._register(channel)
        except BagError:
            self.lost[channel] = self.lost.get(channel, 0) + 1
            raise

    def _begin_file(self) -> None:
        """Open the next file, with all that it needs to be read alone."""
        path = self.folder / f'{self.folder.name}_{len(self._files)}.mcap'
        self._files.append(_Span(path.name))
        try:
            self._output = _Output(path)
            try:
                self._start_file()
            except BaseException:
                self._output.discard()
                raise
        except OSError as error:
            self._files.pop()
            self._failure = f'{path}: {error.strerror}'
            self._writer, self._ids = None, {}
            raise BagError(self._failure) from None

    def _start_file(self) -> None:
        writer = Writer(
            self._output,  # type: ignore[arg-type]  # has what a writer needs of a stream
            chunk_size=_NEVER,
            compression=self._compression,
        )
        writer.start(_PROFILE, _LIBRARY)
        writer.add_metadata(_ROSBAG2, {'serialized_metadata': self._information()})
        self._writer, self._ids, self._schemas = writer, {}, {}
        for name, values in self._metadata.items():
            writer.add_metadata(name, values)
        for attachment in self._attachments:
            self._add_attachment(attachment)
        for channel in self.counts:
            self._register(channel)
        self._write_information()
        self._keep()
        self._room, self._until = CHUNK_SIZE, 0

    def _register(self, channel: Channel) -> None:
        """Define a channel in the open file."""
        writer = self._open_writer()
        key = (channel.type, channel.schema, channel.schema_encoding)
        builder = RecordBuilder()
        if key not in self._schemas:
            schema = mcap.Schema(
                id=writer.register_schema(
                    channel.type, channel.schema_encoding, channel.schema.encode()
                ),
                name=channel.type,
                encoding=channel.schema_encoding,
                data=channel.schema.encode(),
            )
            schema.write(builder)
            self._schemas[key] = schema.id
        definition = _definition(channel, 0, self._schemas[key])
        definition.id = writer.register_channel(
            definition.topic,
            definition.message_encoding,
            definition.schema_id,
            definition.metadata,
        )
        definition.write(builder)
        self._output.write(builder.end())
        self._ids[channel] = definition.id
        self._pending[channel] = 0
        self.counts.setdefault(channel, 0)

    def _add_attachment(self, attachment: Attachment) -> None:
        self._open_writer().add_attachment(
            create_time=attachment.create_time,
            log_time=attachment.log_time,
            name=attachment.name,
            media_type=attachment.media_type,
            data=attachment.data,
        )

    def _end_chunk(self) -> None:
        """Hand what is pending to the system."""
        if self._first == _NEVER:
            return
        with self._guard():
            self._open_writer().flush()
        file = self._files[-1]
        file.first = min(file.first, self._first)
        file.last = max(file.last, self._last)
        for channel, count in self._pending.items():
            self.counts[channel] += count
            file.count += count
        self._keep()

    def _keep(self) -> None:
        """Begin a new chunk; what is in the file stays there."""
        self._output.keep()
        self._files[-1].size = self._output.size
        self._pending = dict.fromkeys(self._ids, 0)
        self._first, self._last = _NEVER, 0
        self._room = CHUNK_SIZE

    def _end_file(self) -> None:
        """Complete the open file, and the list of files."""
        writer = self._open_writer()
        with self._guard():
            writer.add_metadata(_ROSBAG2, {'serialized_metadata': self._information()})
            writer.finish()
            if self._sync:
                os.fsync(self._output.fileno())
            self._keep()
            self._output.close()
            self._writer, self._ids = None, {}
            self._write_information()

    @contextlib.contextmanager
    def _guard(self) -> Iterator[None]:
        """Give the open file up if the system refuses something."""
        try:
            yield
        except OSError as error:
            for channel, count in self._pending.items():
                if count:
                    self.lost[channel] = self.lost.get(channel, 0) + count
            self._failure = f'{self.folder / self._files[-1].name}: {error.strerror}'
            self._output.abandon()
            self._writer, self._ids, self._pending = None, {}, {}
            self._first, self._last = _NEVER, 0
            raise BagError(self._failure) from None

    def _information(self) -> str:
        """Return what rosbag2 wants to know, as YAML."""
        count = sum(file.count for file in self._files)
        first = min((file.first for file in self._files if file.count), default=_NEVER - 1)
        last = max((file.last for file in self._files if file.count), default=first)
        information = {
            'version': METADATA_VERSION,
            'storage_identifier': 'mcap',
            'duration': {'nanoseconds': last - first},
            'starting_time': {'nanoseconds_since_epoch': first},
            'message_count': count,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': channel.topic,
                        'type': channel.type,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': [profile.to_dict() for profile in channel.qos],
                        'type_description_hash': channel.type_hash,
                    },
                    'message_count': number,
                }
                for channel, number in self.counts.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [file.name for file in self._files],
            'files': [
                {
                    'path': file.name,
                    'starting_time': {
                        'nanoseconds_since_epoch': file.first if file.count else _NEVER - 1
                    },
                    'duration': {'nanoseconds': file.last - file.first if file.count else 0},
                    'message_count': file.count,
                }
                for file in self._files
            ],
            'custom_data': {},
            'ros_distro': self._distribution,
        }
        return yaml.dump(information, Dumper=_Dumper, sort_keys=False)

    def _write_information(self) -> None:
        """Replace `metadata.yaml` at once."""
        text = textwrap.indent(self._information(), '  ')
        path = self.folder / 'metadata.yaml'
        temporary = path.with_suffix('.yaml.tmp')
        with temporary.open('w', encoding='utf-8') as file:
            file.write(f'{_INFORMATION}:\n{text}')
            file.flush()
            if self._sync:
                os.fsync(file.fileno())
        temporary.replace(path)


@dataclass
class _Span:
    """A file of a bag, and the log times of its messages. [ns]"""

    name: str
    first: int = _NEVER
    last: int = 0
    count: int = 0
    size: int = 0


class _Dumper(yaml.SafeDumper):
    """Writes YAML without aliases, which other readers of bags may not know."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


class _Output:
    """A new file, which can go back to what is known to be in it."""

    def __init__(self, path: Path) -> None:
        self.size = 0
        self._kept = 0
        self._path = path
        self._file = path.open('xb', buffering=0)

    def write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]
        self.size += len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""

    def fileno(self) -> int:
        return self._file.fileno()

    def keep(self) -> None:
        """Stay with what is written so far, whatever happens."""
        self._kept = self.size

    def abandon(self) -> None:
        """Close the file, without the part of a record that may be at its end."""
        with contextlib.suppress(OSError):
            self._file.truncate(self._kept)
        with contextlib.suppress(OSError):
            self._file.close()

    def close(self) -> None:
        self._file.close()

    def discard(self) -> None:
        """Leave no file behind."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            self._path.unlink()


def _lock(folder: Path) -> int:
    """Lock a folder; return the descriptor that holds the lock."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise BagError(f'{folder}: is being written') from None
    except OSError:
        pass  # a file system without locks
    return descriptor


def is_being_written(path: str | Path) -> bool:
    """Tell whether a `BagWriter`, here or in another process, writes the bag that has a path."""
    folder = Path(path)
    if not folder.is_dir():
        folder = folder.parent
    try:
        os.close(_lock(folder))
    except BagError:
        return True
    except OSError:
        pass  # nothing there, or nothing that may be opened; what reads it will say so
    return False


def _definition(channel: Channel, channel_id: int, schema_id: int) -> mcap.Channel:
    return mcap.Channel(
        id=channel_id,
        topic=channel.topic,
        message_encoding='cdr',
        metadata={
            'offered_qos_profiles': qualities.to_yaml(channel.qos),
            'topic_type_hash': channel.type_hash,
        },
        schema_id=schema_id,
    )


class StreamWriter:
    """
    Makes an MCAP stream for a pipe: nothing is compressed, indexed or kept.

    Every method returns whole records. What comes from `start` goes first; what comes from
    `define` must arrive before messages of these channels; blocks of messages may be left out.

    Examples
    --------
    >>> from io import BytesIO
    >>> channel = Channel(topic='/phase', type='std_msgs/msg/String', schema='string data')
    >>> writer = StreamWriter()
    >>> stream = writer.start() + writer.define(channel)
    >>> stream += writer.block([Message(channel, b'0123', log_time=7, publish_time=7)])
    >>> [message.log_time for message in read_stream(BytesIO(stream))]
    [7]

    """

    def __init__(self) -> None:
        self._ids: dict[Channel, int] = {}
        self._builder = RecordBuilder()

    def start(self) -> bytes:
        """Begin a stream, for a first reader or the next one, with all channels so far."""
        self._builder.write(MAGIC)
        mcap.Header(profile=_PROFILE, library=_LIBRARY).write(self._builder)
        for channel, number in self._ids.items():
            self._write_definition(channel, number)
        return bytes(self._builder.end())

    def define(self, channel: Channel) -> bytes:
        """Define a channel; nothing if it has been."""
        if channel not in self._ids:
            self._ids[channel] = len(self._ids) + 1
            self._write_definition(channel, self._ids[channel])
        return bytes(self._builder.end())

    def block(self, messages: Iterable[Message]) -> bytes:
        """Write messages of channels that are defined."""
        for channel, data, log_time, publish_time, sequence in messages:
            mcap.Message(
                self._ids[channel], log_time, data, publish_time, sequence & 0xFFFFFFFF
            ).write(self._builder)
        return bytes(self._builder.end())

    def metadata(self, name: str, values: Mapping[str, str]) -> bytes:
        """Write named texts."""
        Metadata(name=name, metadata=dict(values)).write(self._builder)
        return bytes(self._builder.end())

    def end(self) -> bytes:
        """End the stream, as a file that has no index."""
        mcap.DataEnd(data_section_crc=0).write(self._builder)
        mcap.Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(self._builder)
        return bytes(self._builder.end()) + MAGIC

    def _write_definition(self, channel: Channel, number: int) -> None:
        mcap.Schema(
            id=number,
            name=channel.type,
            encoding=channel.schema_encoding,
            data=channel.schema.encode(),
        ).write(self._builder)
        _definition(channel, number, number).write(self._builder)


class _Channels:
    """The channels of a file, by their numbers in it."""

    def __init__(self, known: dict[tuple[Any, ...], Channel]) -> None:
        self._known = known  # in all files of a bag, by what they are
        self._schemas: dict[int, mcap.Schema] = {}
        self._records: dict[int, mcap.Channel] = {}
        self._checked: set[tuple[type, int]] = set()
        self._channels: dict[int, Channel] = {}

    def add(self, record: mcap.Schema | mcap.Channel, *, is_checked: bool) -> None:
        """Take a definition; one that had a checksum wins over one that had none."""
        key = (type(record), record.id)
        if key in self._checked and not is_checked:
            return
        if is_checked:
            self._checked.add(key)
        if isinstance(record, mcap.Schema):
            self._schemas[record.id] = record
        else:
            self._records[record.id] = record
        self._channels.clear()

    def get(self, number: int) -> Channel | None:
        """
        Return a channel, or None if there is none.

        Raises
        ------
        BagError
            If it is not one of ROS 2.

        """
        channel = self._channels.get(number)
        if channel is None and number in self._records:
            channel = self._make(self._records[number])
            if channel is not None:
                self._channels[number] = channel
        return channel

    def all(self) -> dict[int, Channel]:
        """Return all channels."""
        found = {number: self.get(number) for number in self._records}
        return {number: channel for number, channel in found.items() if channel is not None}

    def _make(self, record: mcap.Channel) -> Channel | None:
        if record.message_encoding != 'cdr':
            raise BagError(
                f'{record.topic} has messages in {record.message_encoding!r}; those of ROS 2 '
                "are in 'cdr'"
            )
        schema = self._schemas.get(record.schema_id)
        if schema is None:
            return None
        quality = record.metadata.get('offered_qos_profiles', '')
        try:
            profiles = qualities.from_yaml(quality)
        except ValueError:
            profiles = ()  # others write what they like
        channel = Channel(
            topic=record.topic,
            type=schema.name,
            schema=schema.data.decode(errors='replace'),
            type_hash=record.metadata.get('topic_type_hash', ''),
            qos=profiles,
            schema_encoding=schema.encoding,
        )
        return self._known.setdefault(tuple(vars(channel).values()), channel)


class _Block(NamedTuple):
    """Messages that stand together in a file, and between which log times they are. [ns]"""

    offset: int
    end: int
    first: int
    last: int
    channels: frozenset[int]  # whose messages these may be; empty if that is not known
    kind: str = 'chunk'  # or 'cut', a chunk whose end is missing, or 'bare', in no chunk


@dataclass
class _Index:
    """What is where in a file."""

    file: File
    channels: _Channels
    blocks: list[_Block] = field(default_factory=list)
    metadata: list[int] = field(default_factory=list)
    attachments: list[int] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)


class BagReader:
    """
    Reads a bag, ours or another recorder's, whole or damaged.

    Parameters
    ----------
    path : path_like
        A folder with `metadata.yaml`, or with MCAP files; or a single `.mcap` or `.mcap.zstd`.
    by_scan : bool
        Whether to look at every record, and trust no index.

    Attributes
    ----------
    path : Path
        As given.
    channels : tuple of Channel
        Topics, in the order in which files have them; one object each, in all files.
    counts : dict of Channel to int
        How many messages they have.
    start_time, end_time : int
        Log times of the first and the last message; 0 if there is none. [ns]
    distribution : str
        Of ROS, if the bag says so.
    gaps : list of Gap
        What could not be read, as far as is known by now.

    Raises
    ------
    BagError
        If there is no bag of ROS 2 in MCAP; the message says what would be right.

    """

    def __init__(self, path: str | Path, *, by_scan: bool = False) -> None:
        self.path = Path(path)
        self.distribution = ''
        self.gaps: list[Gap] = []
        self._messages_are_compressed = False
        self._indexes: list[_Index] = []
        known: dict[tuple[Any, ...], Channel] = {}
        with contextlib.ExitStack() as stack:
            for name in self._files():
                file = _open(name, by_scan=by_scan)
                stack.callback(file.close)
                index = None if by_scan else _read_summary(file, _Channels(known))
                self._indexes.append(index or _scan(file, _Channels(known)))
            self.counts = self._count()
            self._stack = stack.pop_all()
        self.channels = tuple(self.counts)
        blocks = [block for index in self._indexes for block in index.blocks]
        self.start_time = min((block.first for block in blocks), default=0)
        self.end_time = max((block.last for block in blocks), default=0)

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._stack.close()

    @property
    def message_count(self) -> int:
        """How many messages there are."""
        return sum(self.counts.values())

    @property
    def damage(self) -> str:
        """What is wrong with the bag, as far as is known by now; empty if nothing is."""
        more = f', and {len(self.gaps) - 1} more' if len(self.gaps) > 1 else ''
        return f'{self.gaps[0]}{more}' if self.gaps else ''

    @property
    def metadata(self) -> list[Metadata]:
        """Named texts, as they follow each other; what a next file repeats is left out."""
        last: dict[str, Metadata] = {}
        found = []
        for index in self._indexes:
            for offset in index.metadata:
                record = self._parsed(index, offset)
                if isinstance(record, Metadata) and record.name != _ROSBAG2:
                    if last.get(record.name) != record:
                        found.append(record)
                    last[record.name] = record
        return found

    def attachments(self) -> Iterator[Attachment]:
        """Yield files that were written into the bag; what a next file repeats is left out."""
        seen = set()
        for index in self._indexes:
            for offset in index.attachments:
                record = self._parsed(index, offset)
                if isinstance(record, Attachment):
                    key = (record.name, len(record.data), zlib.crc32(record.data))
                    if key not in seen:
                        yield record
                    seen.add(key)

    def messages(
        self,
        topics: Collection[str] | str | None = None,
        start: int | None = None,
        end: int | None = None,
    ) -> Iterator[Message]:
        """
        Yield messages by their log times; those of equal times as the files have them.

        Parameters
        ----------
        topics : collection of str, optional
            Of these only.
        start, end : int, optional
            From `start` on, and before `end`. [ns]

        Raises
        ------
        BagError
            If the order of the files is so far from that of the times that sorting would take
            too much memory.

        """
        wanted = _Wanted(
            {topics} if isinstance(topics, str) else topics,
            0 if start is None else start,
            _NEVER if end is None else end,
        )
        streams = []
        for index in self._indexes:
            channels = wanted.channels(index)
            for block in index.blocks:
                if wanted.may_be_in(block, channels):
                    streams.append(self._in_order(len(streams), index, block, channels, wanted))
        for *_, message in heapq.merge(*streams):
            if message is not None:
                yield message

    def messages_as_written(self) -> Iterator[Message]:
        """Yield all messages as the files have them."""
        wanted = _Wanted(None, 0, _NEVER)
        for index in self._indexes:
            channels = wanted.channels(index)
            for block in index.blocks:
                data = self._data(index, block)
                for position in self._positions(index, block, data, channels, wanted)[1]:
                    yield self._message(data, position, channels)

    def _in_order(
        self,
        number: int,
        index: _Index,
        block: _Block,
        channels: dict[int, Channel],
        wanted: _Wanted,
    ) -> Iterator[tuple[int, int, int, Message | None]]:
        """Yield when a block begins, and, if there is a next one, its messages by time."""
        yield block.first, number, -1, None
        data = self._data(index, block)
        wanted.take(len(data), self.path)
        times, positions = self._positions(index, block, data, channels, wanted)
        order: Iterable[int] = range(len(times))
        if any(map(operator.gt, times, itertools.islice(times, 1, None))):
            order = np.argsort(np.frombuffer(times, np.uint64), kind='stable').tolist()
        for place in order:
            message = self._message(data, positions[place], channels)
            yield times[place], number, place, message
        wanted.give_back(len(data))

    def _positions(
        self,
        index: _Index,
        block: _Block,
        data: bytes,
        channels: dict[int, Channel],
        wanted: _Wanted,
    ) -> tuple[array[int], array[int]]:
        """Find the messages that are wanted; return their log times, and where they begin."""
        times, positions = array('Q'), array('Q')
        try:
            for opcode, position, end in split(data):
                if opcode == Opcode.MESSAGE and end - position >= MESSAGE.size:
                    _, _, number, _, log_time, _ = MESSAGE.unpack_from(data, position)
                    if number in channels and wanted.start <= log_time < wanted.end:
                        times.append(log_time)
                        positions.append(position)
        except DamageError as error:
            if block.kind != 'cut':
                self._note(index, block, error)
        return times, positions

    def _message(self, data: bytes, position: int, channels: dict[int, Channel]) -> Message:
        _, length, number, sequence, log_time, publish_time = MESSAGE.unpack_from(data, position)
        body = data[position + MESSAGE.size : position + HEAD.size + length]
        if self._messages_are_compressed:
            try:
                body = decompress('zstd', body, zstandard.frame_content_size(body))
            except (DamageError, zstandard.ZstdError) as error:
                raise BagError(f'{self.path}: a message cannot be unpacked, {error}') from None
        return Message(channels[number], body, log_time, publish_time, sequence)

    def _data(self, index: _Index, block: _Block) -> bytes:
        """Return the records of a block as one piece; nothing if they are damaged."""
        if block.kind == 'bare':
            return index.file.read(block.offset, block.end - block.offset)
        if block.kind == 'cut':
            begin = block.offset + HEAD.size
            return unpack_start(index.file.read(begin, min(block.end - begin, LIMIT)))
        record = self._parsed(index, block.offset)
        try:
            return unpack(record) if isinstance(record, mcap.Chunk) else b''
        except DamageError as error:
            self._note(index, block, error)
            return b''

    def _parsed(self, index: _Index, offset: int) -> mcap.McapRecord | None:
        try:
            found = index.file.record(offset)
            return parse(found.opcode, found.body)
        except DamageError as error:
            self._note(index, _Block(offset, offset, 0, 0, frozenset()), error)
            return None

    def _note(self, index: _Index, block: _Block, error: DamageError) -> None:
        """Remember what is damaged, once."""
        gap = Gap(index.file.path, block.offset, block.end - block.offset, str(error))
        if gap not in self.gaps:
            self.gaps.append(gap)

    def _count(self) -> dict[Channel, int]:
        counts: dict[Channel, int] = {}
        for index in self._indexes:
            self.gaps += index.gaps
            channels = index.channels.all()
            for channel in channels.values():
                counts.setdefault(channel, 0)
            for number, count in index.counts.items():
                if number in channels:
                    counts[channels[number]] += count
                else:
                    reason = f'{count} messages of a channel that nothing defines ({number})'
                    self.gaps.append(Gap(index.file.path, 0, 0, reason))
        return counts

    def _files(self) -> list[Path]:
        """List the files of the bag, and note what `metadata.yaml` says."""
        if not self.path.is_dir():
            return [self.path]
        information = self._information()
        self.distribution = str(information.get('ros_distro') or '')
        storage = information.get('storage_identifier', 'mcap')
        if storage != 'mcap':
            raise BagError(f'{self.path}: {_not_mcap(str(storage))}')
        self._messages_are_compressed = (
            str(information.get('compression_mode')).lower() == 'message'
        )
        names = information.get('relative_file_paths')
        names = names if isinstance(names, list) else []
        listed = [self.path / Path(str(name)).name for name in names]
        missing = [path for path in listed if not path.is_file()]
        self.gaps += [Gap(path, 0, 0, 'the file is missing') for path in missing]
        if listed and not missing:
            return listed
        found = [path for path in self.path.iterdir() if path.name.endswith(_SUFFIXES)]
        if not found:
            others = ''.join(path.suffix for path in self.path.glob('*.db3'))
            raise BagError(f'{self.path}: {_not_mcap("sqlite3") if others else _NO_BAG}')
        return sorted(found, key=_by_number)

    def _information(self) -> dict[str, Any]:
        path = self.path / 'metadata.yaml'
        try:
            with path.open('rb') as file:
                text = file.read(_LONGEST_METADATA)
            information = yaml.load(text, Loader=_Loader)[_INFORMATION]
            if not isinstance(information, dict):
                raise TypeError
        except FileNotFoundError:
            self.gaps.append(Gap(path, 0, 0, 'the file is missing'))
        except (OSError, yaml.YAMLError, TypeError, KeyError, ValueError, RecursionError):
            self.gaps.append(Gap(path, 0, 0, 'the file cannot be read'))
        else:
            return information
        return {}


class _Wanted:
    """Which messages are read, and how much may be unpacked at once."""

    def __init__(self, topics: Collection[str] | None, start: int, end: int) -> None:
        self._topics = topics
        self.start = start
        self.end = end
        self._taken = 0

    def channels(self, index: _Index) -> dict[int, Channel]:
        return {
            number: channel
            for number, channel in index.channels.all().items()
            if self._topics is None or channel.topic in self._topics
        }

    def may_be_in(self, block: _Block, channels: Collection[int]) -> bool:
        return (
            block.first < self.end
            and block.last >= self.start
            and not (block.channels and block.channels.isdisjoint(channels))
        )

    def take(self, size: int, path: Path) -> None:
        self._taken += size
        if self._taken > size and self._taken > LIMIT:
            raise BagError(
                f'{path}: more than {LIMIT} bytes of chunks have the same log times, too many to '
                'sort; order the bag first (`mcap sort`)'
            )

    def give_back(self, size: int) -> None:
        self._taken -= size


def read_stream(stream: BinaryIO, name: str = 'the stream') -> Iterator[Message | Metadata]:
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
        Where the stream is no MCAP (any more), after all that came before; not if it ends after a
        whole record, for whoever writes it may be killed.

    """
    channels = _Channels({})
    try:
        if _read_exactly(stream, len(MAGIC)) != MAGIC:
            raise DamageError('it does not begin as MCAP does')
        while head := _read_exactly(stream, HEAD.size):
            opcode, length = HEAD.unpack(head)
            if length > LIMIT:
                raise DamageError(f'a record of {length} bytes, more than the {LIMIT} allowed')
            body = _read_exactly(stream, length)
            if len(body) < length:
                raise DamageError('it ends within a record')
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            yield from _items(opcode, body, channels)
    except DamageError as error:
        raise BagError(f'{name}: {error}') from None


def _items(
    opcode: int, body: bytes, channels: _Channels, *, is_inner: bool = False
) -> Iterator[Message | Metadata]:
    """Yield what is in a record of a stream."""
    if opcode == Opcode.MESSAGE:
        record = parse(opcode, body)
        channel = channels.get(record.channel_id)
        if channel is None:
            raise DamageError(f'a message of a channel that nothing defines ({record.channel_id})')
        yield Message(channel, record.data, record.log_time, record.publish_time, record.sequence)
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        channels.add(parse(opcode, body), is_checked=False)
    elif opcode == Opcode.METADATA:
        yield parse(opcode, body)
    elif opcode == Opcode.CHUNK and not is_inner:
        data = unpack(parse(opcode, body))
        for inner, begin, end in split(data):
            yield from _items(inner, data[begin + HEAD.size : end], channels, is_inner=True)


def _read_exactly(stream: BinaryIO, size: int) -> bytes:
    """Read as many bytes, piece by piece, or fewer at the end."""
    pieces = []
    while size and (piece := stream.read(min(size, 2**20))):
        pieces.append(piece)
        size -= len(piece)
    return pieces[0] if len(pieces) == 1 else b''.join(pieces)


def _open(path: Path, *, by_scan: bool) -> File:
    """Open an MCAP file, a compressed one too, or say what is wrong with it."""
    try:
        if not path.exists():
            raise BagError(f'{path}: no such file or folder')
        if not path.is_file():
            raise BagError(f'{path}: is no file')
        stream: BinaryIO = path.open('rb')
        begin = stream.read(16)
        if begin.startswith(_ZSTD):
            stream.seek(0)
            stream = _decompressed(stream)
            begin = stream.read(16)
        reason = _reason_against(begin)
        if reason and (not by_scan or reason != _NO_MCAP):
            stream.close()
            raise BagError(f'{path}: {reason}')
        return File(path, stream)
    except (OSError, zstandard.ZstdError) as error:
        raise BagError(f'{path}: {getattr(error, "strerror", None) or error}') from None


def _decompressed(stream: BinaryIO) -> BinaryIO:
    """Return a file with what another is compressed from."""
    target = tempfile.TemporaryFile()  # noqa: SIM115
    with zstandard.ZstdDecompressor().stream_reader(
        stream, read_across_frames=True, closefd=True
    ) as reader:
        while piece := reader.read(2**20):
            if not target.tell() and not piece.startswith(MAGIC):
                break
            target.write(piece)
    target.seek(0)
    return target


def _reason_against(begin: bytes) -> str:
    """Say why a file that begins so is no MCAP file; nothing if it is one."""
    if begin.startswith(MAGIC):
        return ''
    if not begin:
        return 'is empty; a recorder that was killed leaves at least a few bytes'
    if begin.startswith(b'SQLite format 3'):
        return _not_mcap('sqlite3')
    if begin.startswith(b'#ROSBAG'):
        return _not_mcap('ROS 1')
    return _NO_MCAP


def _not_mcap(storage: str) -> str:
    return (
        f'is a bag in {storage}, not in MCAP; rosbags can convert it: rosbags-convert --src BAG '
        '--dst NEW_BAG --dst-storage mcap'
    )


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sort `a_2` before `a_10`."""
    return [(int(text), '') if text.isdigit() else (0, text) for text in _NUMBER.split(path.name)]


def _read_summary(file: File, channels: _Channels) -> _Index | None:
    """Read the index at the end of a file; None if it is not there, or not complete."""
    index = _Index(file, channels)
    statistics, chunks, summary_start = None, [], 0
    try:
        footer = file.record(file.size - _FOOTER_SIZE)
        record = parse(footer.opcode, footer.body)
        if isinstance(record, mcap.Footer):
            summary_start = record.summary_start
        size = footer.offset - summary_start
        if not summary_start or not 0 < size <= LIMIT:
            return None
        data = file.read(summary_start, file.size - len(MAGIC) - summary_start)
        if record.summary_crc and record.summary_crc != zlib.crc32(data[:-4]):
            return None
        for opcode, begin, end in split(data[:size]):
            record = parse(opcode, data[begin + HEAD.size : end])
            if isinstance(record, mcap.Schema | mcap.Channel):
                channels.add(record, is_checked=True)
            elif isinstance(record, mcap.ChunkIndex):
                chunks.append(record)
            elif isinstance(record, mcap.MetadataIndex):
                index.metadata.append(record.offset)
            elif isinstance(record, mcap.AttachmentIndex):
                index.attachments.append(record.offset)
            elif isinstance(record, mcap.Statistics):
                statistics = record
    except DamageError:
        return None
    index.blocks = [
        _Block(
            chunk.chunk_start_offset,
            chunk.chunk_start_offset + chunk.chunk_length,
            chunk.message_start_time,
            chunk.message_end_time,
            frozenset(chunk.message_index_offsets),
        )
        for chunk in sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)
    ]
    if (
        statistics is None
        or (statistics.message_count and not chunks)
        or statistics.chunk_count != len(chunks)
        or statistics.metadata_count != len(index.metadata)
        or statistics.attachment_count != len(index.attachments)
        or not channels.all().keys() >= statistics.channel_message_counts.keys()
    ):
        return None
    index.counts = statistics.channel_message_counts
    return index


def _scan(file: File, channels: _Channels) -> _Index:
    """Make an index by looking at every record of a file."""
    index = _Index(file, channels)
    for item in scan(file):
        if isinstance(item, Found):
            _add(index, item)
            continue
        index.gaps.append(item)
        if item.offset + item.size == file.size and file.read(item.offset, 1) == _CHUNK:
            begin = item.offset + HEAD.size
            data = unpack_start(file.read(begin, min(item.size, LIMIT)))
            _add_block(index, data, item.offset, file.size, kind='cut')
    return index


def _add(index: _Index, found: Found) -> None:
    """Add a record to an index."""
    try:
        if found.opcode == Opcode.CHUNK:
            chunk = parse(found.opcode, found.body)
            data = unpack(chunk)
            checked = bool(chunk.uncompressed_crc)
            _add_block(index, data, found.offset, found.end, kind='chunk', is_checked=checked)
        elif found.opcode == Opcode.MESSAGE:
            _add_bare_message(index, found)
        elif found.opcode == Opcode.METADATA:
            index.metadata.append(found.offset)
        elif found.opcode == Opcode.ATTACHMENT:
            index.attachments.append(found.offset)
        elif found.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            index.channels.add(parse(found.opcode, found.body), is_checked=False)
    except DamageError as error:
        size = found.end - found.offset
        index.gaps.append(Gap(index.file.path, found.offset, size, str(error)))


def _add_bare_message(index: _Index, found: Found) -> None:
    """Add a message that is in no chunk, to those right before it if there are some."""
    message = parse(found.opcode, found.body)
    index.counts[message.channel_id] = index.counts.get(message.channel_id, 0) + 1
    time, number = message.log_time, message.channel_id
    block = _Block(found.offset, found.end, time, time, frozenset([number]), 'bare')
    if index.blocks:
        last = index.blocks[-1]
        if last.kind == 'bare' and last.end == found.offset < last.offset + CHUNK_SIZE:
            block = _Block(
                last.offset,
                found.end,
                min(last.first, time),
                max(last.last, time),
                last.channels | {number},
                'bare',
            )
            index.blocks.pop()
    index.blocks.append(block)


def _add_block(
    index: _Index, data: bytes, offset: int, end: int, *, kind: str, is_checked: bool = False
) -> None:
    """Add the messages of a chunk to an index."""
    counts: Counter[int] = Counter()
    first, last = _NEVER, 0
    try:
        for opcode, begin, stop in split(data):
            if opcode == Opcode.MESSAGE and stop - begin >= MESSAGE.size:
                _, _, number, _, log_time, _ = MESSAGE.unpack_from(data, begin)
                counts[number] += 1
                first, last = min(first, log_time), max(last, log_time)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                record = parse(opcode, data[begin + HEAD.size : stop])
                index.channels.add(record, is_checked=is_checked)
    except DamageError as error:
        if kind != 'cut':
            index.gaps.append(Gap(index.file.path, offset, end - offset, str(error)))
    if counts:
        index.blocks.append(_Block(offset, end, first, last, frozenset(counts), kind))
        for number, count in counts.items():
            index.counts[number] = index.counts.get(number, 0) + count
