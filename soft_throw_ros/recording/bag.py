# SPDX-License-Identifier: Apache-2.0
"""
Bags: folders as rosbag2 writes them, with messages in MCAP files; and MCAP streams through a pipe.

Messages stay the bytes that came (see `cdr`), and are written by the library `mcap`. What is read
may be cut off, damaged or somebody else's: the reader says what is wrong, and gives the rest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
import contextlib
from dataclasses import dataclass
import fcntl
import heapq
import itertools
import os
from pathlib import Path
import re
import shutil
import textwrap
from typing import Any, BinaryIO
import zlib

from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer
from soft_throw_ros import __version__
from soft_throw_ros.recording import qos, yaml_text
from soft_throw_ros.recording.mcap_file import (
    Block,
    Channels,
    Known,
    LATEST,
    McapFile,
    no_mcap,
    Selection,
)
from soft_throw_ros.recording.message import BagError, Channel, Message
from soft_throw_ros.recording.records import (
    check_head,
    DamageError,
    Gap,
    HEAD,
    LIMIT,
    MAGIC,
    MESSAGE_HEAD,
    parse,
    split,
    unpack,
)

CHUNK_SIZE = 256 * 2**10
"""How much is compressed at once, unless a single message is larger. [bytes]"""

SPARE = 8 * 2**20
"""How much room a disk that was full must have before a next file is begun. [bytes]"""

_COMPRESSIONS = {
    'none': CompressionType.NONE,
    'lz4': CompressionType.LZ4,
    'zstd': CompressionType.ZSTD,
}

_LIBRARY = f'soft_throw_ros {__version__}'
_PROFILE = 'ros2'
_METADATA = 'metadata.yaml'
_INFORMATION = 'rosbag2_bagfile_information'  # its only key
_FILES = 'relative_file_paths'
_VERSION = 9  # its version, that of ROS 2 Jazzy and later
_ROSBAG2 = 'rosbag2'  # the MCAP metadata that say the same
_SUFFIXES = ('.mcap', '.mcap.zstd')
_NEVER = LATEST + 1


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
        if compression not in _COMPRESSIONS:
            choices = ', '.join(_COMPRESSIONS)
            raise BagError(f'compression must be one of {choices}, got {compression!r}')
        for name, value in {'max_size': max_size, 'max_duration': max_duration}.items():
            if not 0 <= value < _NEVER:
                raise BagError(f'{name} must be finite and not negative, got {value!r}')
        self._distribution = distribution
        self._compression = _COMPRESSIONS[compression]
        self._max_size = max_size or _NEVER
        self._max_duration = round(max_duration * 1e9) or _NEVER
        self._sync = sync
        self._files: list[_FileInformation] = []
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: list[Attachment] = []
        self._failure = ''
        # Of the open file; nothing if there is none
        self._writer: Writer | None = None
        self._ids: dict[Channel, int] = {}
        self._schemas: dict[tuple[str, str, str], int] = {}
        self._until = 0  # the log time from which on a next file is due; 0 if not known yet
        # Of the chunk that is being filled, message by message
        self._channels: list[Channel] = []
        self._times: list[int] = []
        self._room = CHUNK_SIZE
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f'{folder} exists, and a bag is never overwritten') from None
        except OSError as error:
            raise BagError(f'{folder}: {error.strerror}') from None
        # The folder is new: if somebody has it, then `is_being_written`, and only for a moment
        self._lock = _lock(self.folder, fcntl.LOCK_EX)
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
        size = len(data) + MESSAGE_HEAD.size
        number = self._ids.get(channel)
        if number is None or size > self._room or log_time >= self._until:
            number = self._prepare(channel, log_time, size)
        self._add_message(number, log_time, data, publish_time, sequence & 0xFFFFFFFF)
        self._room -= size
        self._channels.append(channel)
        self._times.append(log_time)

    def add_channel(self, channel: Channel) -> None:
        """Have a channel in the bag even if no message comes; `write` adds it otherwise."""
        self.counts.setdefault(channel, 0)
        if channel not in self._ids:
            with self._guard():
                self._define(channel)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts; the last ones of a name are repeated in files that follow."""
        self._metadata[name] = dict(values)
        with self._guard():
            self._open_writer().add_metadata(name, self._metadata[name])

    def attach(self, name: str, data: bytes, media_type: str, *, time: int = 0) -> None:
        """
        Write a file into the bag; it is repeated in files that follow.

        Parameters
        ----------
        name : str
            Of the file.
        data : bytes
            What is in it.
        media_type : str
            What kind of file it is, as `application/yaml`.
        time : int
            When it was attached. [ns]

        """
        self._attachments.append(Attachment(time, time, name, media_type, data))
        with self._guard():
            self._add_attachment(self._attachments[-1])

    def flush(self) -> None:
        """
        Have all that came kept whatever happens; after an error, try to go on in a next file.

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
        Finish the bag; if it is closed already, do nothing.

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

    def _prepare(self, channel: Channel, log_time: int, size: int) -> int:
        """Make that a message can be added; return the number of its channel."""
        try:
            self._open_writer()
            if size > self._room:
                self._end_chunk()
            if self._until and log_time >= self._until:
                self.split()
            if not self._until:
                self._until = log_time + self._max_duration
            self.add_channel(channel)
        except BagError:
            self.lost[channel] = self.lost.get(channel, 0) + 1
            raise
        return self._ids[channel]

    def _begin_file(self) -> None:
        """Open the next file, with all that it needs to be read alone."""
        path = self.folder / f'{self.folder.name}_{len(self._files)}.mcap'
        try:
            if self._failure and shutil.disk_usage(self.folder).free < SPARE:
                raise BagError(self._failure)
            self._output = _Output(path)
            self._files.append(_FileInformation(path.name))
            try:
                self._start_file()
            except OSError:
                self._files.pop()
                self._output.discard()
                raise
        except OSError as error:
            self._writer, self._ids = None, {}
            self._failure = f'{path}: {error.strerror}'
            raise BagError(self._failure) from None
        self._failure = ''

    def _start_file(self) -> None:
        self._writer = Writer(
            self._output,  # type: ignore[arg-type]  # all that a writer needs of a stream
            chunk_size=_NEVER,  # it is not for the writer to say when a chunk ends
            compression=self._compression,
        )
        self._add_message = self._writer.add_message
        self._ids, self._schemas, self._until = {}, {}, 0
        self._begin_chunk()
        self._writer.start(_PROFILE, _LIBRARY)
        for name, values in self._metadata.items():
            self._writer.add_metadata(name, values)
        for attachment in self._attachments:
            self._add_attachment(attachment)
        for channel in self.counts:
            self._define(channel)
        self._write_information()
        if self._sync:
            os.fsync(self._lock)  # that there is such a file
        self._keep()

    def _define(self, channel: Channel) -> None:
        """Define a channel: for its chunk, and once more outside of it."""
        writer = self._open_writer()
        schema = _schema(channel, 0)
        builder = RecordBuilder()
        key = (schema.name, schema.encoding, channel.schema)
        if key not in self._schemas:
            schema.id = writer.register_schema(schema.name, schema.encoding, schema.data)
            schema.write(builder)
            self._schemas[key] = schema.id
        record = _record(channel, 0, self._schemas[key])
        record.id = writer.register_channel(
            record.topic, record.message_encoding, record.schema_id, record.metadata
        )
        record.write(builder)
        self._room -= builder.count
        self._output.write(builder.end())
        self._ids[channel] = record.id

    def _add_attachment(self, attachment: Attachment) -> None:
        self._open_writer().add_attachment(**vars(attachment))

    def _end_chunk(self) -> None:
        """Hand what is pending to the system."""
        if not self._times:
            return
        with self._guard():
            self._open_writer().flush()
        file = self._files[-1]
        file.first = min(file.first, *self._times)
        file.last = max(file.last, *self._times)
        file.count += len(self._times)
        for channel, count in Counter(self._channels).items():
            self.counts[channel] += count
        if self._output.size > self._max_size:
            self._until = -1
        self._keep()
        self._begin_chunk()

    def _keep(self) -> None:
        """Have all that is in the file stay there."""
        self._output.keep()
        self._files[-1].size = self._output.size

    def _begin_chunk(self) -> None:
        self._channels.clear()
        self._times.clear()
        self._room = CHUNK_SIZE

    def _end_file(self) -> None:
        """Complete the open file, and what is said of it."""
        writer = self._open_writer()
        with self._guard():
            writer.add_metadata(_ROSBAG2, {'serialized_metadata': self._information()})
            writer.finish()
            if self._sync:
                os.fsync(self._output.fileno())
            self._keep()
            self._output.close()
            self._write_information()
        self._writer, self._ids = None, {}

    @contextlib.contextmanager
    def _guard(self) -> Iterator[None]:
        """Give the open file up if the system refuses something, and count what is lost."""
        try:
            yield
        except OSError as error:
            for channel, count in Counter(self._channels).items():
                self.lost[channel] = self.lost.get(channel, 0) + count
            self._failure = f'{self.folder / self._files[-1].name}: {error.strerror}'
            self._output.abandon()
            self._writer, self._ids = None, {}
            self._begin_chunk()
            raise BagError(self._failure) from None

    def _information(self) -> str:
        """Return what rosbag2 wants to know of a bag, as YAML."""
        files = [file for file in self._files if file.count]
        first = min((file.first for file in files), default=LATEST)
        last = max((file.last for file in files), default=first)
        information = {
            'version': _VERSION,
            'storage_identifier': 'mcap',
            'duration': {'nanoseconds': last - first},
            'starting_time': {'nanoseconds_since_epoch': first},
            'message_count': sum(file.count for file in files),
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': channel.topic,
                        'type': channel.type,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': [profile.to_dict() for profile in channel.qos],
                        'type_description_hash': channel.type_hash,
                    },
                    'message_count': count,
                }
                for channel, count in self.counts.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            _FILES: [file.name for file in self._files],
            'files': [file.to_dict() for file in self._files],
            'custom_data': {},
            'ros_distro': self._distribution,
        }
        return yaml_text.dump(information)

    def _write_information(self) -> None:
        """Replace `metadata.yaml` at once."""
        path = self.folder / _METADATA
        temporary = path.with_suffix('.yaml.tmp')
        try:
            with temporary.open('w', encoding='utf-8') as file:
                file.write(f'{_INFORMATION}:\n{textwrap.indent(self._information(), "  ")}')
                file.flush()
                if self._sync:
                    os.fsync(file.fileno())
            temporary.replace(path)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise


@dataclass
class _FileInformation:
    """A file of a bag: its size, and how many messages of which log times. [ns]"""

    name: str
    size: int = 0
    count: int = 0
    first: int = LATEST
    last: int = 0

    def to_dict(self) -> dict[str, Any]:
        return {
            'path': self.name,
            'starting_time': {'nanoseconds_since_epoch': self.first},
            'duration': {'nanoseconds': max(self.last - self.first, 0)},
            'message_count': self.count,
        }


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
        if not self._file.closed:
            with contextlib.suppress(OSError):
                self._file.truncate(self._kept)
            self.close()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()

    def discard(self) -> None:
        """Leave no file behind."""
        self.close()
        with contextlib.suppress(OSError):
            self._path.unlink()


def _lock(folder: Path, mode: int) -> int:
    """Lock a folder; return the descriptor that holds the lock, where there are locks at all."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, mode)
    except BlockingIOError:
        os.close(descriptor)
        raise
    except OSError:
        pass  # a file system without locks
    return descriptor


def is_being_written(path: str | Path) -> bool:
    """Tell whether a `BagWriter`, here or in another process, writes the bag that has a path."""
    folder = Path(path)
    try:
        folder = folder if folder.is_dir() else folder.parent
        os.close(_lock(folder, fcntl.LOCK_SH | fcntl.LOCK_NB))
    except BlockingIOError:
        return True
    except OSError:
        pass  # nothing is there, or it may not be opened; whoever reads it will say so
    return False


def _schema(channel: Channel, number: int) -> mcap.Schema:
    return mcap.Schema(
        id=number,
        name=channel.type,
        encoding=channel.schema_encoding,
        data=channel.schema.encode(),
    )


def _record(channel: Channel, number: int, schema: int) -> mcap.Channel:
    return mcap.Channel(
        id=number,
        topic=channel.topic,
        message_encoding='cdr',
        metadata={
            'offered_qos_profiles': qos.to_yaml(channel.qos),
            'topic_type_hash': channel.type_hash,
        },
        schema_id=schema,
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
        _schema(channel, number).write(self._builder)
        _record(channel, number, number).write(self._builder)


class BagReader:
    """
    Reads a bag, ours or another recorder's, whole or damaged.

    Parameters
    ----------
    path : path_like
        A folder with `metadata.yaml`, or with MCAP files; or a single file, `.mcap` or
        `.mcap.zstd`.
    by_scan : bool
        Whether to look at all that is in the files first, instead of believing their indexes.

    Attributes
    ----------
    path : Path
        As given.
    files : list of McapFile
        In the order in which they were written.
    channels : tuple of Channel
        The topics; one object each, in all files.
    counts : dict of Channel to int
        How many messages there are.
    start_time, end_time : int
        Log times of the first and the last message; 0 if there is none. [ns]
    distribution : str
        Of ROS; empty if the bag does not say.

    Raises
    ------
    BagError
        If there is no bag of ROS 2 in MCAP; the message says what would be right.

    """

    def __init__(self, path: str | Path, *, by_scan: bool = False) -> None:
        self.path = Path(path)
        self.files: list[McapFile] = []
        self._gaps: list[Gap] = []
        self._unpacked = 0  # [bytes]
        information = self._read_information() if self.path.is_dir() else {}
        self.distribution = str(information.get('ros_distro') or '')
        mode = str(information.get('compression_mode') or '').lower()
        known: Known = {}
        try:
            for file in self._paths(information):
                self.files.append(
                    McapFile(
                        file, known, by_scan=by_scan, has_compressed_messages=mode == 'message'
                    )
                )
        except BagError:
            self.close()
            raise
        self.counts: dict[Channel, int] = {}
        for channel, count in itertools.chain(*(file.counts.items() for file in self.files)):
            self.counts[channel] = self.counts.get(channel, 0) + count
        self.channels = tuple(self.counts)
        blocks = [block for file in self.files for block in file.blocks]
        self.start_time = min((block.first for block in blocks), default=0)
        self.end_time = max((block.last for block in blocks), default=0)
        if self.gaps and is_being_written(self.path):
            self._gaps.append(Gap(self.path, 0, 0, 'the bag is being written'))

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        for file in self.files:
            file.close()

    @property
    def message_count(self) -> int:
        """How many messages there are."""
        return sum(self.counts.values())

    @property
    def gaps(self) -> list[Gap]:
        """What could not be read, as far as is known by now."""
        return self._gaps + [gap for file in self.files for gap in file.gaps]

    @property
    def damage(self) -> str:
        """What is wrong with the bag, in short, as far as is known by now; empty if nothing is."""
        gaps = self.gaps
        more = f'; and {len(gaps) - 1} more' if len(gaps) > 1 else ''
        return f'{gaps[0]}{more}' if gaps else ''

    @property
    def metadata(self) -> list[Metadata]:
        """Named texts as they follow each other, without those that a next file repeats."""
        found: list[Metadata] = []
        last: dict[str, Metadata] = {}
        for record in itertools.chain(*(file.metadata() for file in self.files)):
            if record.name != _ROSBAG2 and last.get(record.name) != record:
                last[record.name] = record
                found.append(record)
        return found

    def attachments(self) -> Iterator[Attachment]:
        """Yield files that were written into the bag, without those that a next one repeats."""
        seen = set()
        for record in itertools.chain(*(file.attachments() for file in self.files)):
            key = (record.name, len(record.data), zlib.crc32(record.data))
            if key not in seen:
                seen.add(key)
                yield record

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
        topics : str or collection of str, optional
            Of these only.
        start, end : int, optional
            From `start` on, and before `end`. [ns]

        Raises
        ------
        BagError
            If messages are so far from the order of time that sorting them would take too much
            memory.

        """
        selection = Selection(
            topics={topics} if isinstance(topics, str) else topics,
            start=0 if start is None else start,
            end=LATEST + 1 if end is None else end,
        )
        blocks = [(file, block) for file in self.files for block in file.select(selection)]
        streams = [
            self._sorted(number, file, block, selection)
            for number, (file, block) in enumerate(blocks)
        ]
        for *_, message in heapq.merge(*streams):
            if message is not None:
                yield message

    def _sorted(
        self, number: int, file: McapFile, block: Block, selection: Selection
    ) -> Iterator[tuple[int, int, int, Message | None]]:
        """Yield a sign that a block is due, and, if there is a next one, its messages."""
        yield block.first, number, -1, None
        data = file.unpack(block)
        if self._unpacked + len(data) > LIMIT and self._unpacked:
            raise BagError(
                f'{self.path}: its messages are too far from the order of time, there is more '
                f'than {LIMIT} bytes of them at once to sort; sort it before, as by `mcap sort`'
            )
        self._unpacked += len(data)
        try:
            messages = file.messages(block, data, selection, by_time=True)
            for place, message in enumerate(messages):
                yield message.log_time, number, place, message
        finally:
            self._unpacked -= len(data)

    def _read_information(self) -> dict[str, Any]:
        """Read `metadata.yaml`; what is not there is left to the files."""
        path = self.path / _METADATA
        try:
            with path.open(encoding='utf-8') as file:
                information = yaml_text.load(file.read(yaml_text.LONGEST + 1))[_INFORMATION]
        except FileNotFoundError:
            self._gaps.append(Gap(path, 0, 0, 'the file is missing'))
        except (OSError, ValueError, LookupError, TypeError) as error:
            self._gaps.append(Gap(path, 0, 0, f'the file cannot be read, {error}'))
        else:
            if isinstance(information, dict) and isinstance(information.get(_FILES), list):
                return information
            self._gaps.append(Gap(path, 0, 0, 'the file does not describe a bag'))
        return {}

    def _paths(self, information: Mapping[str, Any]) -> list[Path]:
        """List the files of the bag."""
        if not self.path.is_dir():
            return [self.path]
        storage = str(information.get('storage_identifier', 'mcap'))
        if storage != 'mcap':
            raise BagError(f'{self.path} {no_mcap(storage)}')
        listed = [self.path / Path(str(name)).name for name in information.get(_FILES, ())]
        missing = [path for path in listed if not path.is_file()]
        if listed and not missing:
            return listed
        self._gaps += [Gap(path, 0, 0, 'the file is missing') for path in missing]
        found = [path for path in self.path.iterdir() if path.name.endswith(_SUFFIXES)]
        if found:
            return sorted(found, key=_by_number)
        other = next(self.path.glob('*.db3'), None)
        reason = 'is no bag, there is no MCAP file in it' if other is None else no_mcap('sqlite3')
        raise BagError(f'{self.path} {reason}')


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sort `bag_2` before `bag_10`."""
    return [
        (int(part), '') if part.isdecimal() else (0, part)
        for part in re.split(r'(\d+)', path.name, flags=re.ASCII)
    ]


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
    channels = Channels({})
    try:
        if _read_exactly(stream, len(MAGIC)) != MAGIC:
            raise DamageError('it does not begin as MCAP does')
        while head := _read_exactly(stream, HEAD.size):
            if len(head) < HEAD.size:
                raise DamageError('it ends within a record')
            opcode, length = HEAD.unpack(head)
            check_head(opcode, length)
            body = _read_exactly(stream, length)
            if len(body) < length:
                raise DamageError('it ends within a record')
            if opcode == Opcode.FOOTER:
                return
            yield from _items(parse(opcode, body), channels)
    except ValueError as error:
        raise BagError(f'{name}: {error}') from None


def _items(record: mcap.McapRecord | None, channels: Channels) -> Iterator[Message | Metadata]:
    """Yield what is in a record."""
    match record:
        case mcap.Message():
            channel = channels.get(record.channel_id)
            if channel is None:
                raise DamageError(f'nothing defines channel {record.channel_id} of a message')
            if max(record.log_time, record.publish_time) > LATEST:
                raise DamageError('a message has no valid times')
            yield Message(
                channel, record.data, record.log_time, record.publish_time, record.sequence
            )
        case mcap.Schema() | mcap.Channel():
            channels.add(record)
        case Metadata():
            yield record
        case mcap.Chunk():
            data = unpack(record)
            for opcode, begin, end in split(data):
                if opcode != Opcode.CHUNK:
                    yield from _items(parse(opcode, data[begin + HEAD.size : end]), channels)


def _read_exactly(stream: BinaryIO, size: int) -> bytes:
    """Read as many bytes, piece by piece, or fewer at the end."""
    pieces = []
    while size and (piece := stream.read(min(size, 2**20))):
        pieces.append(piece)
        size -= len(piece)
    return pieces[0] if len(pieces) == 1 else b''.join(pieces)
