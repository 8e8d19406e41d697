# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
One recording: topics on their way into a bag.

One thread takes the received messages every few milliseconds; another one writes them.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
import threading
import time

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from soft_throw_ros.configuration import Settings
from soft_throw_ros.nodes.raw_subscriptions import is_wanted, RawSubscription, RawSubscriptions
from soft_throw_ros.nodes.topics import full_name
from soft_throw_ros.nodes.transport import distribution
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.writer_thread import WriterThread

_DRAIN_TIME = 0.01  # time between two calls that take the received messages [s]

PUBLISHER_TIMEOUT = 2.0
"""Time after which wanted topics without a publisher are reported. [s]"""

SILENCE_LIMIT = 5
"""Time without messages after which topics are reported although they have publishers. [s]"""

_PARTICIPANT = slice(12)  # part of the identifier of a publisher that names its process, in DDS
_MAX_NAMES = 2  # in a sentence


class Recording:
    """One recording from start to stop: subscriptions and bag."""

    def __init__(self, recorder: Node, settings: Settings) -> None:
        self._settings = settings
        self._wanted = [full_name(recorder, name) for name in settings['topics']]
        self._began = time.monotonic()
        self._silences: dict[bytes, tuple[int, int]] = {}  # received messages and silent seconds
        self.silent_topics: list[str] = []  # of processes that are present
        self.subscriptions = RawSubscriptions(recorder, self._wanted)
        self.writer = WriterThread(self._open_bag, capacity=settings['buffer'])
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(name='drain', target=self._run, daemon=True)
        self._thread.start()

    @property
    def bag(self) -> Path | None:
        """Folder of the bag; None if there is none yet."""
        return self.writer.bag.folder if self.writer.bag is not None else None

    def watch_publishers(self) -> None:
        """
        Update `silent_topics`; call this once a second.

        A process is silent if nothing comes on any of its topics. Latched topics do not count,
        since they may be published only once, nor do topics of several processes, since ROS 2
        Jazzy does not tell whose messages come.
        """
        items_by_process: dict[bytes, list[RawSubscription]] = defaultdict(list)
        for item in self.subscriptions:
            processes = {publisher[_PARTICIPANT] for publisher in item.publishers}
            is_latched = item.profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
            if len(processes) == 1 and not is_latched:
                items_by_process[processes.pop()].append(item)
        self.silent_topics = []
        for process, items in items_by_process.items():
            received = sum(item.received for item in items)
            before, seconds = self._silences.get(process, (received, 0))
            seconds = seconds + 1 if received == before else 0
            self._silences[process] = received, seconds
            if seconds >= SILENCE_LIMIT:
                self.silent_topics += [item.channel.topic for item in items]

    def problems(self) -> Iterator[str]:
        """Yield sentences on topics of which nothing comes at present."""
        if self.silent_topics:
            yield (
                f'no message on {first_few(self.silent_topics)} for {SILENCE_LIMIT} s: if there '
                'should be, run publisher and recorder as one user (docs/twin.md), or restart '
                'the recorder'
            )
        topics = [item.channel.topic for item in self.subscriptions]
        absent = [name for name in self._wanted if not any(is_wanted(t, [name]) for t in topics)]
        if absent and time.monotonic() - self._began > PUBLISHER_TIMEOUT:
            yield f'nothing is published yet on {", ".join(absent)}'

    def losses(self) -> dict[str, int]:
        """Return the number of lost messages by topic: published, but not in the bag."""
        lost = Counter({item.channel.topic: item.lost for item in self.subscriptions})
        for channel, count in self.writer.lost().items():
            lost[channel.topic] += count
        return dict(sorted((+lost).items()))

    @property
    def has_failed(self) -> bool:
        """Whether, after `stop`, the bag has no end, or has none of the received messages."""
        return bool(self.writer.error) or 0 == self._saved < self.subscriptions.received

    @property
    def _saved(self) -> int:
        """Number of received messages that the writer has not lost."""
        return max(self.subscriptions.received - self.writer.lost().total(), 0)

    def stop(self) -> None:
        """Take the last messages, and finish the bag; see `writer.error` and `has_failed`."""
        self._is_stopping.set()
        self._thread.join()
        self.subscriptions.close()
        losses, refused = self.losses(), self.subscriptions.refused
        counts = {'total': sum(losses.values()), **losses}
        notes = {'losses': {topic: str(count) for topic, count in counts.items()}}
        self.writer.close(notes | ({'not recorded': refused} if refused else {}))

    def summary(self) -> str:
        """Return a sentence with the numbers of recorded and lost messages."""
        seconds = time.monotonic() - self._began
        losses = Counter(self.losses())
        text = f'{self.subscriptions.received} messages in {seconds:.1f} s, {losses.total()} lost'
        if losses:
            counts = [f'{count} of {topic}' for topic, count in losses.most_common()]
            text += f', {first_few(counts)}'
        if self.bag is not None:
            text += f', in {self.bag}'
        text += self.missing_sources
        if self.writer.error:
            text += f'; the end is missing: {self.writer.error}'
            if self._saved and self.bag is not None:
                text += f'; `soft-throw recover {self.bag}` writes a repaired bag'
        return text

    @property
    def missing_sources(self) -> str:
        """Clauses on topics and publishers of which nothing is recorded; mostly empty."""
        refused, silent = list(self.subscriptions.refused), self.silent_topics
        text = f'; not recorded: {first_few(refused)}' if refused else ''
        return text + (f'; nothing comes on {first_few(silent)}' if silent else '')

    def _open_bag(self) -> BagWriter:
        settings = self._settings
        return BagWriter(
            bag_path(settings),
            distribution=distribution(),
            compression=settings['compression'],
            max_size=settings['split.size'],
            max_duration=settings['split.duration'],
            sync=settings['sync'],
        )

    def _run(self) -> None:
        """Record messages until `stop` is called, and then once more."""
        is_last = False
        while not is_last:
            is_last = self._is_stopping.wait(_DRAIN_TIME)
            self.writer.put(self.subscriptions.drain())


def first_few(names: Sequence[str]) -> str:
    """Return the first names of a list, and the number of the others."""
    others = len(names) - _MAX_NAMES
    return ', '.join(names[:_MAX_NAMES]) + (f' and {others} more' if others > 0 else '')


def bag_path(settings: Settings) -> Path:
    """Return the folder of a bag that is opened now."""
    folder = Path(settings['folder']).expanduser()
    if settings['name']:
        return folder / str(settings['name'])
    name = f'{datetime.now().astimezone():soft_throw_%Y_%m_%d-%H_%M_%S}'
    names = [name, *(f'{name}_{number}' for number in range(2, 100))]
    return next((folder / name for name in names if not (folder / name).exists()), folder / name)
