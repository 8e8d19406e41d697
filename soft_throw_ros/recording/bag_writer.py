# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Write bags: folders as rosbag2 makes them, with the received bytes in MCAP files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
import contextlib
import functools
import io
import math
import os
from pathlib import Path
import shutil
from typing import Any

from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from soft_throw_ros import __version__
from soft_throw_ros.storage import bag_folder
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message
from soft_throw_ros.storage.regular_file import atomic_file

CHUNK_SIZE = 256 * 2**10
"""A chunk that has grown beyond this is compressed and written. [bytes]"""

_CHUNK = bytes([Opcode.CHUNK])


class BagWriter(contextlib.AbstractContextManager['BagWriter']):
    """
    A new bag opened for writing; its folder must not exist, and is locked (`flock`) until `close`.

    Messages survive the end of this process after `flush`, which should be called once a second;
    with `sync` also a loss of power. Every file can be read alone. A new one is begun beyond
    `max_size` [bytes] or `max_duration` [s], if these are not 0.

    `wait_for_disk` is called with the reason if the disk does not take data, and returns whether
    to try again. After any BagError the bag can only be closed. `counts` are the numbers of
    messages in whole chunks on the disk.
    """

    def __init__(
        self, folder: str | Path, *, distribution: str, compression: str = 'zstd',
        max_size: int = 0, max_duration: float = 0.0, sync: bool = False,
    ) -> None:
        self.folder = Path(folder)
        self.wait_for_disk: Callable[[str], bool] = lambda _reason: False
        self.counts: Counter[Channel] = Counter()
        self.written: Counter[Channel] = Counter()  # all messages, also those of the open chunk
        self.saved_size = 0  # of all data handed to the operating system [bytes]
        self.compression = CompressionType[compression.upper()]
        self._distribution = distribution
        self._max_size = max_size or math.inf
        self._max_duration = round(max_duration * 1e9) or math.inf
        self._sync = sync
        self._error = ''  # why nothing more can be written
        self._files: list[_File] = []
        try:
            self.folder.mkdir(parents=True)
        except OSError as error:
            raise BagError(f'{folder}: {error.strerror}') from None
        # Only `check_not_written` can hold the lock of a new folder, and for a moment
        self._lock = bag_folder.lock_folder(self.folder)
        try:
            self._begin_file()
        except BagError:
            self._release()
            shutil.rmtree(self.folder, ignore_errors=True)
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, message: Message) -> None:
        """Write a message; BagError if the disk does not take it, ValueError for invalid times."""
        channel, data, log_time, publish_time, sequence = message.checked()
        file = self._file()
        if log_time - file.first >= self._max_duration or file.size > self._max_size:
            self.split()
            file = self._file()
        self.written[channel] += 1
        file.count += 1
        file.first, file.last = min(file.first, log_time), max(file.last, log_time)
        number = file.number_of(channel)
        file.writer.add_message(number, log_time, data, publish_time, sequence & 0xFFFFFFFF)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write named texts."""
        self._file().writer.add_metadata(name, dict(values))

    def split(self) -> None:
        """Continue in a new file, unless the present one is empty."""
        if self._file().count:
            self._finish_file()
            self._begin_file()

    def flush(self) -> None:
        """Hand all messages so far to the system; BagError if the disk does not take them."""
        file = self._file()
        file.writer.flush()
        if self._sync:
            self.insist(file.path, os.fsync, file)

    def close(self) -> None:
        """Finish the bag; BagError if that fails, and the bag is closed all the same."""
        if self._lock >= 0:
            try:
                self._finish_file()
                self._write_metadata()
            finally:
                self._release()

    def insist(self, path: Path, act: Callable[..., Any], *args: object) -> Any:
        """Act on the disk, again and again as long as `wait_for_disk` returns True."""
        while True:
            try:
                return act(*args)
            except OSError as error:
                reason = f'{path}: {error.strerror}'
                if not self.wait_for_disk(reason):
                    self._error = reason
                    raise BagError(reason) from None

    def _file(self) -> _File:
        """Return the present file; raise BagError if the bag is closed or has failed."""
        if self._error:
            raise BagError(self._error)
        return self._files[-1]

    def _begin_file(self) -> None:
        """Begin the next file, with all that it needs to be read alone."""
        path = self.folder / f'{self.folder.name}_{len(self._files)}.mcap'
        file = self.insist(path, _File, path, self)
        self._files.append(file)
        file.writer.start('ros2', f'soft_throw_ros {__version__}')
        for channel in self.written:
            file.number_of(channel)
        self._write_metadata()

    def _finish_file(self) -> None:
        """Write the last chunk and the end of the present file."""
        self.flush()
        information = {'serialized_metadata': bag_folder.dump_yaml(self._information())}
        self.add_metadata('rosbag2', information)
        self._files[-1].writer.finish()
        self.flush()
        self._files[-1].close()

    def _write_metadata(self) -> None:
        path = self.folder / bag_folder.METADATA_FILE
        text = bag_folder.dump_yaml({bag_folder.METADATA_KEY: self._information()})

        def replace() -> None:
            with atomic_file(path) as unfinished:
                unfinished.write_text(text, encoding='utf-8')

        self.insist(path, replace)
        if self._sync:
            self.insist(self.folder, os.fsync, self._lock)  # that there are such files

    def _release(self) -> None:
        for file in self._files[-1:]:
            file.close()
        os.close(self._lock)
        self._lock, self._error = -1, f'{self.folder} is closed'

    def _information(self) -> dict[str, object]:
        """Return the metadata of the bag that rosbag2 expects as YAML."""
        return {
            'version': 9,  # of ROS 2 Jazzy and later
            'storage_identifier': 'mcap',
            **_contents(self._files),
            'topics_with_message_count': [
                {'topic_metadata': _topic_metadata(channel), 'message_count': count}
                for channel, count in self.written.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [file.path.name for file in self._files],
            'files': [{'path': file.path.name, **_contents([file])} for file in self._files],
            'custom_data': {},
            'ros_distro': self._distribution,
        }


def _contents(files: Sequence[_File]) -> dict[str, object]:
    first = min(file.first for file in files)
    last = max((file.last for file in files if file.count), default=first)
    return {
        'starting_time': {'nanoseconds_since_epoch': first},
        'duration': {'nanoseconds': last - first},
        'message_count': sum(file.count for file in files),
    }


def _topic_metadata(channel: Channel) -> dict[str, object]:
    return {
        'name': channel.topic,
        'type': channel.type,
        'serialization_format': 'cdr',
        'offered_qos_profiles': [
            profile for profile in bag_folder.load_profiles(channel.qos)
            if isinstance(profile.get('reliability'), str)  # as in version 9
        ],
        'type_description_hash': channel.type_hash,
    }


class _File(io.BufferedWriter):
    """An MCAP file of the bag, and the stream of its `writer`, which buffers nothing."""

    def __init__(self, path: Path, bag: BagWriter) -> None:
        super().__init__(io.FileIO(path, 'x'))
        self.path = path
        self.count = 0  # of messages
        self.first, self.last = LATEST, 0  # log times of messages [ns]
        self.size = 0  # [bytes]
        self._bag = bag
        self.writer = Writer(self, chunk_size=CHUNK_SIZE, compression=bag.compression)
        self._schema = functools.cache(self.writer.register_schema)
        self.number_of = functools.cache(self._define)  # of a channel, defined at the first call

    def write(self, data: Any) -> int:
        """Write data, waiting for the disk."""
        rest = memoryview(data)
        while rest:
            count = self._bag.insist(self.path, self.raw.write, rest)
            self.size += count
            self._bag.saved_size += count
            rest = rest[count:]
        if data[:1] == _CHUNK:  # the library writes it at once, and its index later
            self._bag.counts = self._bag.written.copy()
        return len(data)

    def _define(self, channel: Channel) -> int:
        schema = self._schema(channel.type, channel.schema_encoding, channel.schema.encode())
        metadata = {'offered_qos_profiles': channel.qos, 'topic_type_hash': channel.type_hash}
        return self.writer.register_channel(channel.topic, 'cdr', schema, metadata)
