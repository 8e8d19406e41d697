# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Make a whole bag of what can be read of one that is cut off or damaged."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
import shutil

from soft_throw_ros.recording.bag_reader import BagReader, Gap
from soft_throw_ros.recording.bag_writer import BagWriter, is_being_written
from soft_throw_ros.recording.message import BagError

_BUFFER_SIZE = 2**20  # what waits is written when it has grown beyond this [bytes]


@dataclass(frozen=True, kw_only=True)
class Recovery:
    """What was recovered."""

    target: Path  # The new bag
    saved: dict[str, int]  # How many messages are in it, by topic
    gaps: tuple[Gap, ...]  # What of the old bag is not
    doubts: tuple[str, ...]  # What of its definitions is not, since it cannot be trusted

    @property
    def message_count(self) -> int:
        """How many messages were saved."""
        return sum(self.saved.values())

    @property
    def skipped(self) -> tuple[Gap, ...]:
        """Return the gaps that something was in, not only an end that is missing."""
        return tuple(gap for gap in self.gaps if gap.size or gap.messages)


def recover(source: str | Path, target: str | Path) -> Recovery:
    """
    Write what can be read of a bag into a new one, which every reader opens.

    Every chunk is taken that is whole, by its checksum if it has one. The messages keep their
    order, times and numbers; metadata and attachments come first; several files become one. Of
    definitions without a checksum, type hash and quality of service are left out; those that
    cannot be read are left out with their messages.

    Parameters
    ----------
    source : path_like
        A bag, whatever state it is in; it is not changed.
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
    with BagReader(source, by_scan=True) as reader:
        if not reader.message_count:
            raise BagError(f'{reader.damage or source}; there is no message to recover')
        writer = BagWriter(target, distribution=reader.distribution)
        try:
            with writer:
                for channel in reader.channels:
                    writer.add_channel(channel)
                for metadata in reader.metadata:
                    writer.add_metadata(metadata.name, metadata.metadata)
                for item in reader.attachments():
                    writer.attach(item.name, item.data, item.media_type, time=item.log_time)
                for message in reader.messages(by_log_time=False):
                    writer.write(message)
                    if writer.unsaved > _BUFFER_SIZE:
                        writer.flush()
        except BaseException:
            shutil.rmtree(target, ignore_errors=True)
            raise
        saved = Counter[str]()
        for channel, count in writer.counts.items():
            saved[channel.topic] += count
        return Recovery(
            target=target, saved=dict(saved), gaps=tuple(reader.gaps), doubts=tuple(reader.doubts)
        )
