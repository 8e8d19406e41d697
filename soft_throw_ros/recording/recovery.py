# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recovery of a bag that is cut off or damaged: a new bag of all before the first damage."""

from __future__ import annotations

from collections import Counter
import contextlib
from pathlib import Path
import shutil
from typing import NamedTuple

from mcap import records as mcap
from mcap.exceptions import EndOfFile
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.bag_folder import BagFolder, check_not_written
from soft_throw_ros.storage.bag_reader import open_mcap, read_records
from soft_throw_ros.storage.message import BagError, Message


class Recovery(NamedTuple):
    """The result of a recovery."""

    target: Path  # the new bag
    saved: Counter[str]  # numbers of recovered messages by topic
    omitted: tuple[str, ...]  # missing files, and ends of files from the first damage on


def recover(source: str | Path, target: str | Path) -> Recovery:
    """
    Write all before the first damage in each file of a bag, without attachments, into a new bag.

    BagError is raised, and there is no new bag, if nothing can be recovered, the bag is being
    written, or the new one exists or cannot be written.
    """
    source, target = Path(source), Path(target)
    check_not_written(source)
    if target.resolve().is_relative_to(source.resolve()):
        raise BagError(f'{target} is in the bag that is to be recovered, which is not changed')
    folder = BagFolder(source)
    saved, omitted = Counter[str](), [f'{path}: missing or empty' for path in folder.defects]
    writer = BagWriter(target, distribution=folder.distribution)
    with contextlib.ExitStack() as incomplete, writer:
        incomplete.callback(shutil.rmtree, target, ignore_errors=True)
        omitted += [end for path in folder.files if (end := _copy(path, writer))]
        for channel, count in writer.written.items():
            saved[channel.topic] += count
        if not saved:
            raise BagError(f'{omitted[0] if omitted else source}; there is no message to recover')
        writer.close()
        incomplete.pop_all()
    return Recovery(target, saved, tuple(omitted))


def _copy(path: Path, writer: BagWriter) -> str:
    """Copy a file up to its end or the first damage; return a description of the remainder."""
    end = 0  # of the last whole record
    with open_mcap(path) as stream:
        size = path.stat().st_size
        try:
            for item in read_records(stream):
                if isinstance(item, Message):
                    writer.write(item)
                elif isinstance(item, mcap.Metadata) and item.name != 'rosbag2':
                    writer.add_metadata(item.name, item.metadata)
                end = stream.tell()
        except BagError as error:
            raise BagError(f'{path}: {error}') from None
        except Exception as error:  # noqa: BLE001  damaged bytes may cause any
            if end < size:  # else only the end of the file is missing
                cut = 'the file is cut off' if isinstance(error, EndOfFile) else ''
                reason = cut or str(error) or type(error).__name__
                return f'{path}: the last {size - end} of {size} bytes, {reason:.200}'
    return ''
