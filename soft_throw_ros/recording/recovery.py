# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recovery of a bag that is cut off or damaged: a new bag of all that can be read."""

from __future__ import annotations

from collections import Counter
from contextlib import closing, ExitStack
from dataclasses import dataclass
from pathlib import Path
import shutil

from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.mcap_scan import ScannedFile, UnreadableRange
from soft_throw_ros.storage.bag_lock import is_being_written
from soft_throw_ros.storage.bag_reader import BagFolder, unrepeated
from soft_throw_ros.storage.message import BagError

_BUFFER_SIZE = 2**20
"""Size of the unsaved messages above which they are saved. [bytes]"""


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """The result of a recovery."""

    target: Path  # the new bag
    saved: dict[str, int]  # numbers of recovered messages by topic
    defects: tuple[str, ...]  # files that are missing, empty or not readable
    unreadable: tuple[UnreadableRange, ...]  # parts of files that are not in the new bag

    @property
    def message_count(self) -> int:
        """Number of all messages that were saved."""
        return sum(self.saved.values())

    @property
    def skipped(self) -> tuple[UnreadableRange, ...]:
        """Return the unreadable parts that have content, without a missing end of a file."""
        return tuple(item for item in self.unreadable if item.size or item.messages)


def recover(source: str | Path, target: str | Path) -> Recovery:
    """
    Write all that can be read of a bag into a new one, which every reader opens.

    Every chunk that is whole is read, by its checksum if it has one. The messages keep their
    order, times and numbers; metadata and attachments come first; several files become one.

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
    with ExitStack() as stack:
        files = [stack.enter_context(closing(ScannedFile(path))) for path in folder.files]
        if not any(file.channels for file in files):
            damage = [*(item for file in files for item in file.unreadable), *folder.defects]
            raise BagError(f'{damage[0] if damage else source}; there is no message to recover')
        writer = BagWriter(target, distribution=folder.distribution)
        try:
            with writer:
                _copy(files, writer)
        except BaseException:
            shutil.rmtree(target, ignore_errors=True)
            raise
        saved = Counter[str]()
        for channel, count in writer.counts.items():
            saved[channel.topic] += count
        return Recovery(
            target=target,
            saved=dict(saved),
            defects=tuple(folder.defects),
            unreadable=tuple(item for file in files for item in file.unreadable),
        )


def _copy(files: list[ScannedFile], writer: BagWriter) -> None:
    """Write definitions, texts, attachments and messages of files into a bag."""
    for channel in dict.fromkeys(channel for file in files for channel in file.channels):
        writer.add_channel(channel)
    for text in unrepeated(file.metadata for file in files):
        writer.add_metadata(text.name, text.metadata)
    for item in unrepeated(file.attachments for file in files):
        writer.attach(item.name, item.data, item.media_type, time=item.log_time)
    for file in files:
        for message in file.messages():
            writer.write(message)
            if writer.unsaved > _BUFFER_SIZE:
                writer.flush()
