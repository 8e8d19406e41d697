# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Write bags: folders as rosbag2 makes them, with messages in MCAP files.

Messages stay the bytes that came (see `cdr`); the files are written by the library `mcap`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
import math
import os
from pathlib import Path
import shutil
from typing import Any

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

PROFILE = 'ros2'
LIBRARY = f'soft_throw_ros {__version__}'


class BagWriter:
    """
    A new bag opened for writing.

    Chunks are written as they fill up, and the last one at `flush`. From then on their messages
    survive the end of this process, so call `flush` about once a second.

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
    wait_for_disk : callable
        Called with the reason if the disk does not take data; waits, and returns whether to try
        again. By default it returns False.
    saved_size : int
        Size of all data handed to the operating system. [bytes]
    is_abandoned : bool
        Whether the caller has given up waiting; all unsaved messages are lost.

    Raises
    ------
    BagError
        If the folder exists or cannot be made.

    Notes
    -----
    Every file can be read alone: it contains all channels, metadata and attachments so far.
    The folder is locked (`flock`) while it is written. After any other BagError the bag can only
    be closed.

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
        self.wait_for_disk: Callable[[str], bool] = lambda _reason: False
        self.saved_size = 0
        self.is_abandoned = False
        self._error = ''  # after which the bag can only be closed
        self._is_deleted = False
        self._files: list[_File] = []
        self._written: Counter[Channel] = Counter()  # accepted by `write`
        self._saved: Counter[Channel] = Counter()  # at the last flush
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
        try:
            self._begin_file()
        except BagError:
            self._close_files()
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
            If the bag is closed, or the disk does not take a chunk.
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
        if channel not in self._channels:
            self.add_channel(channel)
        file.add(message)
        self._written[channel] += 1

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
            self._finish_file()
            self._begin_file()

    def flush(self) -> None:
        """
        Hand all messages so far to the system, which keeps them if this process is killed.

        Raises
        ------
        BagError
            If the disk does not take them, or the file was deleted.

        """
        self._require_open()
        file = self._files[-1]
        file.writer.flush()
        self._mark_saved(file)
        self._is_deleted = not file.path.exists()
        if self._is_deleted:
            raise BagError(f'{file.path}: it was deleted while it was written')

    def close(self) -> None:
        """
        Finish the bag; if it is closed already, do nothing.

        Raises
        ------
        BagError
            If that fails. The bag is closed all the same, with all that was saved.

        """
        if self._lock < 0:
            return
        try:
            self.flush()
            self._finish_file()
            self._write_metadata()
        finally:
            self._is_deleted = not self._files[-1].path.exists()
            self._close_files()

    @property
    def counts(self) -> Counter[Channel]:
        """Numbers of messages in the bag at the last `flush`, by channel."""
        return Counter() if self._is_deleted else self._saved.copy()

    @property
    def lost(self) -> Counter[Channel]:
        """Numbers of messages in a deleted file or not saved before the end, by channel."""
        if self._is_deleted:
            return self._written.copy()
        is_over = self._lock < 0 or self.is_abandoned
        return self._written.copy() - self._saved if is_over else Counter()

    def _require_open(self) -> None:
        if self._lock < 0:
            raise BagError(f'{self.folder} is closed')
        if self._error:
            raise BagError(self._error)

    def _try(self, path: Path, act: Callable[..., Any], *args: object) -> Any:
        """Act on the disk, again and again as long as `wait_for_disk` returns True."""
        while True:
            try:
                return act(*args)
            except OSError as error:
                reason = f'{path}: {error.strerror}'
                if not self.wait_for_disk(reason):
                    self._error = reason
                    raise BagError(reason) from None

    def _save(self, file: _File, data: bytes) -> None:
        """Write data to a file, waiting for the disk."""
        rest = memoryview(data)
        while rest:
            count = self._try(file.path, os.write, file.descriptor, rest)
            self.saved_size += count
            rest = rest[count:]

    def _mark_saved(self, file: _File) -> None:
        """Note that all messages so far are written."""
        if self._sync:
            self._try(file.path, os.fsync, file.descriptor)
        self._saved = self._written.copy()
        file.saved_size = file.size

    def _add(self, kind: str, name: str, add: Callable[[Writer], None]) -> None:
        self._require_open()
        self._repeated[kind, name] = add
        add(self._files[-1].writer)

    def _begin_file(self) -> None:
        """Begin the next file, with all that it needs to be read alone."""
        path = self.folder / f'{self.folder.name}_{len(self._files)}.mcap'
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        file = _File(path, self._try(path, os.open, path, flags, 0o666), self._save)
        self._files.append(file)
        file.begin(self._compression)
        for add in self._repeated.values():
            add(file.writer)
        for channel in self._channels:
            file.define(channel)
        self._write_metadata()

    def _finish_file(self) -> None:
        """Write the end of the present file."""
        file = self._files[-1]
        information = {'serialized_metadata': dump_yaml(self._information())}
        file.writer.add_metadata('rosbag2', information)
        file.writer.finish()
        self._mark_saved(file)
        file.close()

    def _write_metadata(self) -> None:
        path = self.folder / METADATA_FILE
        self._try(path, write_metadata, path, self._information())
        if self._sync:
            self._try(self.folder, os.fsync, self._lock)  # that there are such files

    def _close_files(self) -> None:
        for file in self._files:
            file.close()
        os.close(self._lock)
        self._lock = -1

    def _information(self) -> dict[str, object]:
        """Return the metadata of the bag that rosbag2 expects as YAML."""
        first = min(file.first for file in self._files)
        last = max((file.last for file in self._files if file.count), default=first)
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
                    'message_count': self._written[channel],
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
    A file of a bag, the stream of its `Writer`, and its counts.

    Nothing is buffered here, so that the size of all written records is known.
    """

    writer: Writer

    def __init__(self, path: Path, descriptor: int, save: Callable[[_File, bytes], None]) -> None:
        self.path = path
        self.descriptor = descriptor
        self.size = self.saved_size = 0  # of the data passed to `write`, and at the last flush
        self.count = 0
        self.first, self.last = LATEST, 0  # log times [ns]
        self._save = save
        self._ids: dict[Channel, int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}

    def begin(self, compression: CompressionType) -> None:
        """Write the beginning."""
        self.writer = Writer(
            self,  # type: ignore[arg-type]  # all that a writer needs of a stream
            chunk_size=CHUNK_SIZE,
            compression=compression,
        )
        self.writer.start(PROFILE, LIBRARY)
        self.saved_size = self.size

    # as a stream

    def write(self, data: bytes) -> None:
        self._save(self, data)
        self.size += len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Do nothing, because nothing is buffered."""

    # as a file

    def define(self, channel: Channel) -> None:
        """Define a channel once."""
        if channel in self._ids:
            return
        kind, encoding, text = channel.type, channel.schema_encoding, channel.schema.encode()
        schema = self._schemas.get((kind, encoding, text))
        if schema is None:
            schema = self.writer.register_schema(kind, encoding, text)
            self._schemas[kind, encoding, text] = schema
        metadata = {'offered_qos_profiles': channel.qos, 'topic_type_hash': channel.type_hash}
        self._ids[channel] = self.writer.register_channel(channel.topic, 'cdr', schema, metadata)

    def add(self, message: Message) -> None:
        """Add a message of a channel that is defined."""
        channel, data, log_time, publish_time, sequence = message
        number = sequence & 0xFFFFFFFF
        self.writer.add_message(self._ids[channel], log_time, data, publish_time, number)
        self.count += 1
        self.first = min(self.first, log_time)
        self.last = max(self.last, log_time)

    def close(self) -> None:
        """Close the file, without the part of a record that may be at its end after an error."""
        if self.descriptor >= 0:
            if os.fstat(self.descriptor).st_size > self.saved_size:
                os.truncate(self.descriptor, self.saved_size)
            os.close(self.descriptor)
            self.descriptor = -1

    def to_dict(self) -> dict[str, object]:
        """Return the metadata of the file that rosbag2 expects."""
        return {
            'path': self.path.name,
            'starting_time': {'nanoseconds_since_epoch': self.first},
            'duration': {'nanoseconds': max(self.last - self.first, 0)},
            'message_count': self.count,
        }
