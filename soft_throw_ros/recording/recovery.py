# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recovery of a bag that is cut off or damaged: a new bag of all before the first damage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
import os
from pathlib import Path
import shutil
from typing import BinaryIO

from mcap import records as mcap
from mcap.stream_reader import StreamReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.bag_lock import is_being_written
from soft_throw_ros.storage.bag_reader import BagFolder, unrepeated
from soft_throw_ros.storage.mcap_file import (
    DamageError,
    make_channels,
    make_message,
    MAX_RECORD,
    open_mcap,
    reason_of,
    unpack,
)
from soft_throw_ros.storage.message import BagError, Channel, Message


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """The result of a recovery."""

    target: Path  # the new bag
    saved: dict[str, int]  # numbers of recovered messages by topic
    omitted: tuple[str, ...]  # missing files, and ends of files from the first damage on

    @property
    def message_count(self) -> int:
        """Number of all messages that were saved."""
        return sum(self.saved.values())


def recover(source: str | Path, target: str | Path) -> Recovery:
    """
    Write all before the first damage in each file of a bag into a new bag of one file.

    The messages keep their order, times and numbers; metadata and attachments come last.

    Parameters
    ----------
    source : path_like
        A bag in any state; it is not changed.
    target : path_like
        The new bag. It must not exist.

    Raises
    ------
    BagError
        If nothing can be recovered, the bag is being written, or the new one cannot be; then
        there is no new one.

    """
    source, target = Path(source), Path(target)
    if is_being_written(source):
        raise BagError(f'{source} is being written; stop the recorder before')
    if target.resolve().is_relative_to(source.resolve()):
        raise BagError(f'{target} is in the bag that is to be recovered, which is not changed')
    folder = BagFolder(source)
    files = [_File(path) for path in folder.files]
    writer = BagWriter(target, distribution=folder.distribution)
    try:
        with writer:
            for file in files:
                for message in file.messages():
                    writer.write(message)
            for text in unrepeated(file.metadata for file in files):
                writer.add_metadata(text.name, text.metadata)
            for item in unrepeated(file.attachments for file in files):
                writer.attach(item.name, item.data, item.media_type, time=item.log_time)
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        raise
    omitted = (*(file.damage for file in files if file.damage), *folder.defects)
    saved = Counter[str]()
    for channel, count in writer.counts.items():
        saved[channel.topic] += count
    if not saved.total():
        shutil.rmtree(target, ignore_errors=True)
        raise BagError(f'{omitted[0] if omitted else source}; there is no message to recover')
    return Recovery(target=target, saved=dict(saved), omitted=omitted)


class _File:
    """A file of a damaged bag, its texts and attached files, and its damage."""

    def __init__(self, path: Path) -> None:
        self.metadata: list[mcap.Metadata] = []
        self.attachments: list[mcap.Attachment] = []
        self.damage = ''
        self._path = path
        self._end = 0  # of the last whole record [bytes]

    def messages(self) -> Iterator[Message]:
        """Yield all messages before the first damage."""
        with open_mcap(self._path) as stream:
            size = os.fstat(stream.fileno()).st_size
            try:
                yield from self._read(stream)
            except BagError as error:
                raise BagError(f'{self._path}: {error}') from None
            except Exception as error:  # noqa: BLE001  damage may cause any error in the library
                if self._end < size:  # else only the end of the file is missing
                    rest = f'the last {size - self._end} of {size} bytes'
                    self.damage = f'{self._path}: {rest}, {reason_of(error)}'

    def _read(self, stream: BinaryIO) -> Iterator[Message]:
        schemas: dict[int, mcap.Schema] = {}
        channels: dict[int, Channel] = {}
        count = 0
        reader = StreamReader(stream, emit_chunks=True, record_size_limit=MAX_RECORD)
        for record in _without_chunks(reader.records):
            match record:
                case mcap.Schema():
                    schemas[record.id] = record
                case mcap.Channel():
                    channels |= make_channels({record.id: record}, schemas)
                case mcap.Message():
                    count += 1
                    yield make_message(record, channels)
                case mcap.Metadata():
                    self.metadata.append(record)
                case mcap.Attachment():
                    self.attachments.append(record)
                case mcap.Statistics() if record.message_count > count:
                    missing = record.message_count - count
                    raise DamageError(f'{missing} messages are missing before the index')
            self._end = stream.tell()


def _without_chunks(records: Iterator[mcap.McapRecord]) -> Iterator[mcap.McapRecord]:
    """Yield records, and those in chunks in place of the chunks."""
    for record in records:
        if isinstance(record, mcap.Chunk):
            yield from unpack(record)
        else:
            yield record
