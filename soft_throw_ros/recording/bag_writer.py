# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Write bags: folders as rosbag2 makes them, with messages in MCAP files.

Messages stay the bytes that came (see `cdr`); the files are written by the library `mcap`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
import contextlib
import errno
from functools import partial
import math
import os
from pathlib import Path
import shutil
import zlib

from mcap.data_stream import RecordBuilder
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk
from mcap.records import Schema as SchemaRecord
from mcap.writer import CompressionType, Writer
from soft_throw_ros import __version__
from soft_throw_ros.storage.bag_lock import lock_folder
from soft_throw_ros.storage.bag_metadata import (
    dump_yaml,
    METADATA_FILE,
    profiles_of,
    VERSION,
    write_metadata,
)
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message

CHUNK_SIZE = 256 * 2**10
"""A chunk that has grown beyond this is compressed and written. [bytes]"""

WRITE_SIZE = 4 * 2**20
"""Largest part handed to the disk at once, so that its progress is seen. [bytes]"""

PROFILE = 'ros2'
LIBRARY = f'soft_throw_ros {__version__}'


class BagWriter:
    """
    A new bag opened for writing.

    Messages wait in memory until `flush` hands them to the operating system. From then on they
    survive the end of this process, so call `flush` about once a second. If the disk is full,
    `flush` raises an error, and the messages wait for the next call.

    Parameters
    ----------
    folder : path_like
        Path of the bag, which must not exist; its files begin with the same name.
    distribution : str
        Distribution of ROS, such as `jazzy`; may be empty.
    compression : {'zstd', 'lz4', 'none'}
        Compression of chunks.
    max_size : int
        Size of a file beyond which a new one is started; 0 for no limit. [bytes]
    max_duration : float
        Time span of a file beyond which a new one is started; 0 for no limit. [s]
    sync : bool
        Whether `flush` waits for the disk, so that the messages survive a loss of power too.

    Attributes
    ----------
    folder : Path
        The bag.
    is_abandoned : bool
        Whether the caller has given up waiting; all unsaved messages are lost.

    Raises
    ------
    BagError
        If the folder exists or cannot be made.

    Notes
    -----
    Every file can be read alone: it contains all channels, metadata and attachments so far.
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
        self._distribution = distribution
        self._compression = CompressionType[compression.upper()]
        self._max_size = max_size or math.inf
        self._max_duration = round(max_duration * 1e9) or math.inf
        self._sync = sync
        self.is_abandoned = False
        self._files: list[_File] = []
        self._described = 0  # how many files are in `metadata.yaml`
        self._channels: dict[Channel, None] = {}
        self._repeated: dict[tuple[str, str], Callable[[Writer], None]] = {}
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(f'{folder} exists, and a bag is never overwritten') from None
        except OSError as error:
            raise BagError(f'{folder}: {error.strerror}') from None
        # Only `is_being_written` can hold the lock of a new folder, and for a moment
        self._lock = lock_folder(self.folder)
        self._begin_file()
        try:
            self.flush()
        except BagError:
            self._files[-1].close()
            os.close(self._lock)
            shutil.rmtree(self.folder, ignore_errors=True)
            raise

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, message: Message) -> None:
        """
        Write a message, and with its channel's first one the channel.

        Raises
        ------
        BagError
            If the bag is closed.
        ValueError
            If a time is negative or too large for ROS.

        """
        channel, log_time = message.channel, message.log_time
        if not message.has_valid_times:
            raise ValueError(
                f'{channel.topic}: times must be at least 0 and below 2**63 ns, '
                f'got {log_time} and {message.publish_time}'
            )
        self._require_open()
        file = self._files[-1]
        if file.size > self._max_size or log_time - file.first >= self._max_duration:
            self.split()
            file = self._files[-1]
        if channel not in file.written:
            self.add_channel(channel)
        file.add(message)

    def add_channel(self, channel: Channel) -> None:
        """Add a channel to the bag, even if it never receives a message."""
        self._channels[channel] = None
        self._files[-1].define(channel)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts; later files repeat the last texts of each name."""
        add = partial(Writer.add_metadata, name=name, data=dict(values))
        self._add('metadata', name, add)

    def attach(self, name: str, data: bytes, media_type: str, *, time: int = 0) -> None:
        """
        Write an attachment into the bag, with a time [ns] and a type, such as `application/yaml`.

        Later files repeat the last one of each name.
        """
        add = partial(
            Writer.add_attachment,
            create_time=time,
            log_time=time,
            name=name,
            media_type=media_type,
            data=data,
        )
        self._add('attachment', name, add)

    def split(self) -> None:
        """Continue in a new file, unless the present one is empty."""
        self._require_open()
        if self._files[-1].count:
            self._files[-1].finish(self._information())
            self._begin_file()

    def flush(self) -> None:
        """
        Hand all messages so far to the system, which keeps them if this process is killed.

        Raises
        ------
        BagError
            If the disk does not take them (yet), or another program has changed the file.

        """
        self._require_open()
        self._files[-1].writer.flush()
        self._save()

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
        try:
            self.flush()
            self._files[-1].finish(self._information())
            self._described = 0
            self._save()
        finally:
            for file in self._files:
                file.close()
            os.close(self._lock)
            self._lock = -1

    @property
    def unsaved(self) -> int:
        """Size of the data not yet handed to the operating system [bytes]."""
        return sum(file.waiting for file in list(self._files))

    @property
    def counts(self) -> dict[Channel, int]:
        """Numbers of messages in the bag since the last `flush`, by channel."""
        files = [file for file in list(self._files) if not file.damage]
        return {channel: sum(file.kept.get(channel, 0) for file in files)
                for channel in list(self._channels)}

    @property
    def lost(self) -> Counter[Channel]:
        """Numbers of messages in damaged files or not saved before the end, by channel."""
        lost: Counter[Channel] = Counter()
        for file in list(self._files):
            if file.damage:
                lost.update(file.written.copy())
            elif self._is_closed or self.is_abandoned:
                lost.update(Counter(file.written) - Counter(file.kept))
        return lost

    @property
    def _is_closed(self) -> bool:
        return self._lock < 0

    def _require_open(self) -> None:
        if self._is_closed:
            raise BagError(f'{self.folder} is closed')

    def _add(self, kind: str, name: str, add: Callable[[Writer], None]) -> None:
        self._repeated[kind, name] = add
        add(self._files[-1].writer)

    def _begin_file(self) -> None:
        """Begin the next file, with all that it needs to be read alone."""
        path = self.folder / f'{self.folder.name}_{len(self._files)}.mcap'
        file = _File(path, self._compression)
        for add in self._repeated.values():
            add(file.writer)
        for channel in self._channels:
            file.define(channel)
        self._files.append(file)

    def _save(self) -> None:
        """Hand all waiting data to the operating system, and update the kept counts."""
        path = self.folder
        try:
            for file in self._files:
                path = file.path
                file.save(sync=self._sync)
            if self._described < len(self._files):
                path = self.folder / METADATA_FILE
                write_metadata(path, self._information())
                if self._sync:
                    os.fsync(self._lock)  # that there are such files
                self._described = len(self._files)
        except OSError as error:
            raise BagError(f'{path}: {error.strerror}') from None

    def _information(self) -> dict[str, object]:
        """Return the metadata of the bag that rosbag2 expects as YAML."""
        first = min(file.first for file in self._files)
        last = max((file.last for file in self._files if file.count), default=first)
        written = sum((Counter(file.written) for file in self._files), Counter())
        return {
            'version': VERSION,
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
                        'offered_qos_profiles': profiles_of(channel.qos),
                        'type_description_hash': channel.type_hash,
                    },
                    'message_count': written[channel],
                }
                for channel in self._channels
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [file.path.name for file in self._files],
            'files': [file.to_dict() for file in self._files],
            'custom_data': {},
            'ros_distro': self._distribution,
        }


class _File:
    """
    A file of a bag: its stream and its counts.

    The library `mcap` writes to this stream, which buffers in memory until `save`. So the library
    never fails halfway, and can continue after a full disk.
    """

    def __init__(self, path: Path, compression: CompressionType) -> None:
        self.path = path
        self.size = 0  # [bytes]
        self.count = 0
        self.first, self.last = LATEST, 0  # log times [ns]
        self.written: dict[Channel, int] = {}
        self.kept: dict[Channel, int] = {}  # handed to the operating system
        self.damage = ''  # by another program
        self._identity = (0, 0)  # device and inode
        self._cut = ''  # the damage, if it cannot be undone
        self._waiting = bytearray()
        self._kept_size = 0  # [bytes]
        self._descriptor = -1
        self._is_finished = False
        self._is_closed = False
        self._ids: dict[Channel, int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self.writer = Writer(
            self,  # type: ignore[arg-type]  # all that a writer needs of a stream
            chunk_size=CHUNK_SIZE,
            compression=compression,
        )
        self.writer.start(PROFILE, LIBRARY)

    # as a stream

    def write(self, data: bytes) -> None:
        self._waiting += data
        self.size += len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Do nothing; `save` writes the buffered data."""

    # as a file

    @property
    def waiting(self) -> int:
        """Size of the buffered data [bytes]."""
        return len(self._waiting)

    def define(self, channel: Channel) -> None:
        """
        Define a channel twice: in a chunk of its own, and in the chunk of its first messages.

        Otherwise a damaged chunk would make all later messages of the channel useless.
        """
        if channel in self._ids:
            return
        kind, encoding, text = channel.type, channel.schema_encoding, channel.schema.encode()
        schema = self._schemas.get((kind, encoding, text))
        if schema is None:
            schema = self.writer.register_schema(kind, encoding, text)
            self._schemas[kind, encoding, text] = schema
        metadata = {'offered_qos_profiles': channel.qos, 'topic_type_hash': channel.type_hash}
        number = self.writer.register_channel(channel.topic, 'cdr', schema, metadata)
        self._ids[channel] = number
        builder = RecordBuilder()
        SchemaRecord(schema, text, encoding, kind).write(builder)
        ChannelRecord(number, channel.topic, 'cdr', metadata, schema).write(builder)
        data = builder.end()
        Chunk(
            compression='',
            data=data,
            message_start_time=0,
            message_end_time=0,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        ).write(builder)
        self.write(builder.end())
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

    def finish(self, information: Mapping[str, object]) -> None:
        """Write the end."""
        self.writer.add_metadata('rosbag2', {'serialized_metadata': dump_yaml(information)})
        self.writer.finish()
        self._is_finished = True

    def save(self, *, sync: bool) -> None:
        """Hand all buffered bytes to the system; raise OSError if the file does not hold them."""
        if not self._is_closed and self._descriptor < 0:
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
            self._descriptor = os.open(self.path, flags, 0o666)
            status = os.fstat(self._descriptor)
            self._identity = status.st_dev, status.st_ino
        self.damage = self._find_damage()
        if not self._is_closed:
            written = self.written.copy()
            while self._waiting:
                del self._waiting[: os.write(self._descriptor, self._waiting[:WRITE_SIZE])]
            if sync:
                os.fsync(self._descriptor)
            self.kept, self._kept_size = written, self.size
        if self._is_finished:  # somebody may need the room
            self.close()
        elif self.damage:
            raise OSError(errno.EIO, self.damage)

    def _find_damage(self) -> str:
        """Return the damage that another program did to the file; empty if it is whole."""
        try:
            status = self.path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return 'it was deleted while it was written'
        if (status.st_dev, status.st_ino) != self._identity:
            return 'it was replaced by another file while it was written'
        written = self.size - self.waiting
        if status.st_size != written:
            self._cut = (
                f'it was changed to {status.st_size} bytes while it was written, and had {written}'
            )
        return self._cut  # which stays, though further messages make the file longer

    def close(self) -> None:
        """Close the file, without the part of a record that may be at its end after an error."""
        if self._descriptor >= 0 and not self._is_closed:
            with contextlib.suppress(OSError):
                if self._waiting:
                    os.truncate(self._descriptor, self._kept_size)
                os.close(self._descriptor)
        self._is_closed = True

    def to_dict(self) -> dict[str, object]:
        """Return the metadata of the file that rosbag2 expects."""
        return {
            'path': self.path.name,
            'starting_time': {'nanoseconds_since_epoch': self.first},
            'duration': {'nanoseconds': max(self.last - self.first, 0)},
            'message_count': self.count,
        }
