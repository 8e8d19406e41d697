# SPDX-License-Identifier: Apache-2.0
"""
Write bags: folders as rosbag2 makes them, with messages in MCAP files.

Messages stay the bytes that came (see `cdr`); the files are written by the library `mcap`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
import contextlib
import errno
import fcntl
import os
from pathlib import Path
import shutil
from typing import Any
import zlib

from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Chunk
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema as SchemaRecord
from mcap.writer import CompressionType, Writer
from soft_throw_ros import __version__
from soft_throw_ros.recording import qos
from soft_throw_ros.recording.message import BagError, Channel, LATEST, Message

CHUNK_SIZE = 256 * 2**10
"""A chunk that has grown beyond this is compressed and written. [bytes]"""

PROFILE = 'ros2'
LIBRARY = f'soft_throw_ros {__version__}'

METADATA_FILE = 'metadata.yaml'
METADATA_KEY = 'rosbag2_bagfile_information'
METADATA_VERSION = 9  # that of ROS 2 Jazzy and later

_COMPRESSIONS = {
    'none': CompressionType.NONE,
    'lz4': CompressionType.LZ4,
    'zstd': CompressionType.ZSTD,
}

_BUFFER_SIZE = 2**20  # what waits is written when it has grown beyond this [bytes]

_NEVER = LATEST + 1


class BagWriter:
    """
    Writes a bag, a new folder.

    A message is kept, whatever happens to this process, once `flush` has returned, which is to be
    called about once a second. If the disk is full, `write` refuses messages, and both say so,
    until `flush` finds room again and the file goes on; a message that was refused may be written
    again then.

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
        self._files: list[_File] = []  # the last one is open, unless a next one cannot be begun
        self._channels: dict[Channel, None] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: list[Attachment] = []
        self._is_deleted = False
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f'{folder} exists, and a bag is never overwritten') from None
        except OSError as error:
            raise BagError(f'{folder}: {error.strerror}') from None
        # The folder is new: if somebody has it, then `is_being_written`, and only for a moment
        self._lock = _lock(self.folder, fcntl.LOCK_EX)
        try:
            with self._guard():
                self._begin_file()
        except BagError:
            os.close(self._lock)
            shutil.rmtree(self.folder, ignore_errors=True)
            raise

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, message: Message) -> None:
        """
        Write a message.

        Raises
        ------
        BagError
            If it cannot be written now.
        ValueError
            If its times are none.

        """
        channel, _, log_time, publish_time, _ = message
        if (log_time | publish_time) >> 63:
            raise ValueError(
                f'{channel.topic}: times must be at least 0 and below 2**63 ns, '
                f'got {log_time} and {publish_time}'
            )
        file = self._files[-1]
        if file.output.needs_attention or log_time >= file.until or channel not in file.written:
            file = self._prepare(channel, log_time)
        file.add(message)

    def add_channel(self, channel: Channel) -> None:
        """Have a channel in the bag even if no message comes; `write` adds it otherwise."""
        self._channels[channel] = None
        if not self._files[-1].is_finished:
            self._files[-1].define(channel)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts; the last ones of a name are repeated in files that follow."""
        self._metadata[name] = dict(values)
        if not self._files[-1].is_finished:
            self._files[-1].writer.add_metadata(name, self._metadata[name])

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
        attachment = Attachment(time, time, name, media_type, data)
        self._attachments.append(attachment)
        if not self._files[-1].is_finished:
            self._files[-1].writer.add_attachment(**vars(attachment))

    def flush(self) -> None:
        """
        Have all that was written kept whatever happens.

        Raises
        ------
        BagError
            If that cannot be done (yet).

        """
        if self._is_closed:
            raise BagError(f'{self.folder} is closed')
        with self._guard():
            self._keep()
            if self._files[-1].is_finished:
                self._files[-1].output.close()
                self._begin_file()

    def split(self) -> None:
        """Go on in a next file, unless there is no message in this one."""
        self.flush()
        if self._files[-1].count:
            self._files[-1].finish(self._information())
            self.flush()

    def close(self) -> None:
        """
        Finish the bag; if it is closed already, do nothing.

        Raises
        ------
        BagError
            If that fails. The bag is closed all the same, with all that was kept.

        """
        if self._is_closed:
            return
        file = self._files[-1]
        try:
            with self._guard():
                self._keep()
                if not file.is_finished:
                    file.finish(self._information())
                    self._keep()
                file.output.close()
                self._write_information()
        finally:
            file.output.close()
            os.close(self._lock)
            self._lock = -1

    @property
    def counts(self) -> dict[Channel, int]:
        """How many messages are in the bag as of the last `flush`."""
        return {channel: sum(each.kept.get(channel, 0) for each in self._files)
                for channel in list(self._channels)}  # fmt: skip

    @property
    def lost(self) -> dict[Channel, int]:
        """How many messages were written in vain, because the bag was deleted, or closed so."""
        if not (self._is_closed or self._is_deleted):
            return {}
        written = sum((Counter(each.written) for each in self._files), Counter())
        return dict(written - Counter(self.counts))

    @property
    def _is_closed(self) -> bool:
        return self._lock < 0

    def _prepare(self, channel: Channel, log_time: int) -> _File:
        """Return a file that can take a message."""
        if self._is_closed:
            raise BagError(f'{self.folder} is closed')
        if self._files[-1].output.error is not None or self._files[-1].is_finished:
            self.flush()
        if self._files[-1].output.needs_attention or 0 < self._files[-1].until <= log_time:
            self.split()
        file = self._files[-1]
        file.until = file.until or log_time + self._max_duration
        self.add_channel(channel)
        return file

    def _begin_file(self) -> None:
        """Open the next file, with all that it needs to be read alone."""
        path = self.folder / f'{self.folder.name}_{len(self._files)}.mcap'
        file = _File(path, self._max_size, self._compression)
        for name, values in self._metadata.items():
            file.writer.add_metadata(name, values)
        for attachment in self._attachments:
            file.writer.add_attachment(**vars(attachment))
        for channel in self._channels:
            file.define(channel)
        self._files.append(file)
        try:
            file.output.keep(sync=self._sync)
            self._write_information()  # not before there is a file that can be read
            if self._sync:
                os.fsync(self._lock)  # that there are such files
        except OSError:
            self._files.pop()
            file.output.close()
            path.unlink(missing_ok=True)  # so that the next attempt can make it
            raise

    def _keep(self) -> None:
        """Hand what waits to the system, and note what is kept then."""
        file = self._files[-1]
        if not file.is_finished:
            file.writer.flush()
        file.output.keep(sync=self._sync)
        if not os.fstat(self._lock).st_nlink:
            for each in self._files:
                each.kept = {}
        if not file.output.exists:
            file.kept, self._is_deleted = {}, True
            raise FileNotFoundError(errno.ENOENT, 'it was deleted while it was written')
        file.kept = dict(file.written)

    @contextlib.contextmanager
    def _guard(self) -> Iterator[None]:
        """Say which file the system refuses something for."""
        try:
            yield
        except OSError as error:
            path = error.filename or self.folder / (self._files[-1].name if self._files else '')
            raise BagError(f'{path}: {error.strerror}') from None

    def _information(self) -> dict[str, Any]:
        """Return what rosbag2 wants to know of the bag, to write it as YAML."""
        first = min(file.first for file in self._files)
        last = max((file.last for file in self._files if file.count), default=first)
        return {
            'version': METADATA_VERSION,
            'storage_identifier': 'mcap',
            'duration': {'nanoseconds': last - first},
            'starting_time': {'nanoseconds_since_epoch': first},
            'message_count': sum(file.count for file in self._files),
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
            'relative_file_paths': [file.name for file in self._files],
            'files': [file.to_dict() for file in self._files],
            'custom_data': {},
            'ros_distro': self._distribution,
        }

    def _write_information(self) -> None:
        """Replace `metadata.yaml` at once."""
        path = self.folder / METADATA_FILE
        temporary = path.with_suffix('.yaml.tmp')
        try:
            with temporary.open('w', encoding='utf-8') as file:
                file.write(qos.dump_yaml({METADATA_KEY: self._information()}))
                file.flush()
                if self._sync:
                    os.fsync(file.fileno())
            temporary.replace(path)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise


class _File:
    """A file of a bag, complete by itself: how it is written, and what is in it."""

    def __init__(self, path: Path, max_size: int, compression: CompressionType) -> None:
        self.name = path.name
        self.count = 0
        self.first, self.last = LATEST, 0  # log times [ns]
        self.until = 0  # the log time from which on a next file is due; 0 if not known yet [ns]
        self.written: dict[Channel, int] = {}
        self.kept: dict[Channel, int] = {}  # of these, whatever happens
        self.is_finished = False
        self.output = _Output(path, max_size)
        self.writer = Writer(
            self.output,  # type: ignore[arg-type]  # all that a writer needs of a stream
            chunk_size=CHUNK_SIZE,
            compression=compression,
        )
        self.writer.start(PROFILE, LIBRARY)
        self._ids: dict[Channel, int] = {}
        self._schemas: dict[tuple[str, str, str], int] = {}

    def define(self, channel: Channel) -> None:
        """Define a channel: for the chunk of its messages, and before in one of its own."""
        if channel in self._ids:
            return
        builder = RecordBuilder()
        for record in register_channel(self.writer, channel, self._schemas):
            record.write(builder)
            self._ids[channel] = record.id
        data = builder.end()
        Chunk(
            compression='',
            data=data,
            message_start_time=0,
            message_end_time=0,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        ).write(builder)
        self.output.write(builder.end())
        self.written[channel] = 0

    def add(self, message: Message) -> None:
        """Add a message of a channel that is defined."""
        channel, data, log_time, publish_time, sequence = message
        number = sequence & 0xFFFFFFFF
        self.writer.add_message(self._ids[channel], log_time, data, publish_time, number)
        self.written[channel] += 1
        self.count += 1
        self.first = min(self.first, log_time)
        self.last = max(self.last, log_time)

    def finish(self, information: Mapping[str, Any]) -> None:
        """Write the end, which is kept with the next flush."""
        text = qos.dump_yaml(information)
        self.writer.add_metadata('rosbag2', {'serialized_metadata': text})
        self.writer.finish()
        self.is_finished = True

    def to_dict(self) -> dict[str, Any]:
        """Return what rosbag2 wants to know of it."""
        return {
            'path': self.name,
            'starting_time': {'nanoseconds_since_epoch': self.first},
            'duration': {'nanoseconds': max(self.last - self.first, 0)},
            'message_count': self.count,
        }


class _Output:
    """
    A new file; what the system refuses waits until it is flushed again.

    So the library that writes into it never fails halfway, and can go on after a full disk.
    """

    def __init__(self, path: Path, max_size: int) -> None:
        self.error: OSError | None = None
        self.needs_attention = False  # after an error, or beyond the size
        self._max_size = max_size
        self._size = 0
        self._kept = 0
        self._waiting = bytearray()
        self._file = path.open('xb', buffering=0)

    @property
    def exists(self) -> bool:
        """Whether the file is still in a folder."""
        return self._file.closed or os.fstat(self._file.fileno()).st_nlink > 0

    def write(self, data: bytes) -> None:
        self._waiting += data
        self._size += len(data)
        self.needs_attention = self.error is not None or self._size > self._max_size
        if len(self._waiting) > _BUFFER_SIZE and self.error is None:
            with contextlib.suppress(OSError):
                self.flush()

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        try:
            while self._waiting:
                del self._waiting[: self._file.write(self._waiting)]
        except OSError as error:
            self.error, self.needs_attention = error, True
            raise
        self.error, self.needs_attention = None, self._size > self._max_size

    def keep(self, *, sync: bool) -> None:
        """Flush, and stay with what is written so far, whatever happens."""
        self.flush()
        self._kept = self._size
        if sync and not self._file.closed:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file, without the part of a record that may be at its end after an error."""
        if not self._file.closed:
            with contextlib.suppress(OSError):
                if self._waiting:
                    self._file.truncate(self._kept)
                self._file.close()


def register_channel(
    writer: Writer, channel: Channel, schemas: dict[tuple[str, str, str], int]
) -> list[SchemaRecord | ChannelRecord]:
    """Define a channel, and its schema unless it is in `schemas`; return the records."""
    records: list[SchemaRecord | ChannelRecord] = []
    key = (channel.type, channel.schema_encoding, channel.schema)
    if key not in schemas:
        data = channel.schema.encode()
        schemas[key] = writer.register_schema(channel.type, channel.schema_encoding, data)
        records.append(SchemaRecord(schemas[key], data, channel.schema_encoding, channel.type))
    metadata = {
        'offered_qos_profiles': qos.to_yaml(channel.qos),
        'topic_type_hash': channel.type_hash,
    }
    number = writer.register_channel(channel.topic, 'cdr', schemas[key], metadata)
    records.append(ChannelRecord(number, channel.topic, 'cdr', metadata, schemas[key]))
    return records


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
