# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recovery of a bag that is cut off or damaged: a new bag of all before the first damage."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
import shutil

from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.bag_lock import is_being_written
from soft_throw_ros.storage.bag_reader import BagFolder, unrepeated
from soft_throw_ros.storage.mcap_stream import McapStream, UnfinishedError
from soft_throw_ros.storage.message import BagError


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

    The messages keep their order, times and numbers; metadata and attachments come last. BagError
    is raised, and there is no new bag, if nothing can be recovered, the bag is being written, or
    the new one exists or cannot be written.
    """
    source, target = Path(source), Path(target)
    if is_being_written(source):
        raise BagError(f'{source} is being written; stop the recorder before')
    if target.resolve().is_relative_to(source.resolve()):
        raise BagError(f'{target} is in the bag that is to be recovered, which is not changed')
    folder = BagFolder(source)
    files = [McapStream(path) for path in folder.files]
    omitted = []
    writer = BagWriter(target, distribution=folder.distribution)
    try:
        with writer:
            for file in files:
                try:
                    for message in file.messages():
                        writer.write(message)
                except UnfinishedError as error:
                    if size := file.rest():  # else only the end of the file is missing
                        reason = error.__cause__ or error
                        rest = f'the last {size} of {file.path.stat().st_size} bytes'
                        omitted.append(f'{file.path}: {rest}, {reason!s:.200}')
            for text in unrepeated(file.metadata for file in files):
                writer.add_metadata(text.name, text.metadata)
            for item in unrepeated(file.attachments for file in files):
                writer.attach(item.name, item.data, item.media_type, time=item.log_time)
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        raise
    omitted += folder.defects
    saved = Counter[str]()
    for channel, count in writer.counts.items():
        saved[channel.topic] += count
    if not saved.total():
        shutil.rmtree(target, ignore_errors=True)
        raise BagError(f'{omitted[0] if omitted else source}; there is no message to recover')
    return Recovery(target=target, saved=dict(saved), omitted=tuple(omitted))
