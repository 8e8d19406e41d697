# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The node `recorder`: records topics into a bag, and may start a viewer that shows them live.

One thread takes the received messages every few milliseconds; another one writes them.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
import contextlib
from datetime import datetime
from functools import partial
import json
import os
from pathlib import Path
import subprocess
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from soft_throw_ros.configuration import ParameterError, RECORDER, Settings
from soft_throw_ros.configuration.interface import RECORDER_SERVICES, RECORDER_TOPICS
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run, RunnableNode, start_child
from soft_throw_ros.nodes.raw_subscriptions import is_wanted, RawSubscriptions
from soft_throw_ros.nodes.topics import create_service, full_name, Publishers
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.writer_thread import WriterThread
from soft_throw_ros.twin.session import RequestRejected

_DISCOVERY_TIME = 0.2  # time between two searches for new topics [s]
_VIEWER_TIMEOUT = 2.0  # longest wait for the end of the viewer [s]
_DRAIN_TIME = 0.01  # time between two calls that take the received messages [s]
PUBLISHER_TIMEOUT = 2.0  # after which wanted topics without a publisher are reported [s]
SILENCE_LIMIT = 5  # time without messages from a process after which its topics are reported [s]
_PARTICIPANT = slice(12)  # part of the identifier of a publisher that names its process, in DDS
_MAX_NAMES = 2  # in a sentence


class Recording:
    """One recording from start to stop: subscriptions and bag."""

    def __init__(self, recorder: Node, settings: Settings) -> None:
        self._settings = settings
        self._wanted = [full_name(recorder, name) for name in settings['topics']]
        self._began = time.monotonic()
        self._received: list[Counter[bytes]] = []  # by process, of the last seconds
        self._reported: set[str] = set()  # problems
        self.silent_topics: list[str] = []  # of processes that are present
        self.subscriptions = RawSubscriptions(recorder, lambda t, _: is_wanted(t, self._wanted))
        self.writer = WriterThread(self._open_bag, capacity=settings['buffer'])
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(name='drain', target=self._run, daemon=True)
        self._thread.start()

    @property
    def bag(self) -> Path | None:
        """Folder of the bag; None if there is none yet."""
        return self.writer.bag.folder if self.writer.bag is not None else None

    def new_problems(self) -> Iterator[str]:
        """Yield new sentences on topics of which nothing comes; call this once a second."""
        self.silent_topics = self._find_silent_topics()
        topics = [item.channel.topic for item in self.subscriptions]
        absent = [name for name in self._wanted if not any(is_wanted(t, [name]) for t in topics)]
        problems = set()
        if self.silent_topics:
            problems.add(
                f'no message on {first_few(self.silent_topics)} for {SILENCE_LIMIT} s: if there '
                'should be, run publisher and recorder as one user (docs/twin.md), or restart '
                'the recorder'
            )
        if absent and time.monotonic() - self._began > PUBLISHER_TIMEOUT:
            problems.add(f'nothing is published yet on {", ".join(absent)}')
        yield from problems - self._reported
        self._reported |= problems

    def _find_silent_topics(self) -> list[str]:
        """
        Return the topics of processes of which nothing comes.

        Latched topics do not count, since they may be published only once, nor do topics of
        several processes, since ROS 2 Jazzy does not tell whose messages come.
        """
        topics: dict[bytes, list[str]] = defaultdict(list)
        received: Counter[bytes] = Counter()
        for item in self.subscriptions:
            processes = {publisher[_PARTICIPANT] for publisher in item.publishers}
            if len(processes) == 1 and item.profile.durability is DurabilityPolicy.VOLATILE:
                (process,) = processes
                topics[process].append(item.channel.topic)
                received[process] += item.received
        self._received = [*self._received[-SILENCE_LIMIT:], received]
        if len(self._received) <= SILENCE_LIMIT:
            return []
        earlier = self._received[0]
        silent = [process for process in topics if received[process] == earlier.get(process)]
        return [name for process in silent for name in topics[process]]

    def losses(self) -> Counter[str]:
        """Return the number of lost messages by topic: published, but not in the bag."""
        lost = Counter({item.channel.topic: item.lost for item in self.subscriptions})
        for channel, count in self.writer.lost().items():
            lost[channel.topic] += count
        return +lost

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
        counts = {'total': losses.total(), **losses}
        notes = {'losses': {topic: str(count) for topic, count in counts.items()}}
        self.writer.close(notes | ({'not recorded': refused} if refused else {}))

    def summary(self) -> str:
        """Return a sentence with the numbers of recorded and lost messages."""
        seconds, losses = time.monotonic() - self._began, self.losses()
        text = f'{self.subscriptions.received} messages in {seconds:.1f} s, {losses.total()} lost'
        if losses:
            counts = [f'{count} of {topic}' for topic, count in losses.most_common()]
            text += f', {first_few(counts)}'
        if self.bag is not None:
            text += f', in {self.bag}'
        text += self.missing
        if self.writer.error:
            text += f'; the end is missing: {self.writer.error}'
            if self._saved and self.bag is not None:
                text += f'; `soft-throw recover {self.bag}` writes a repaired bag'
        return text

    @property
    def missing(self) -> str:
        """Clauses on topics and publishers of which nothing is recorded; mostly empty."""
        refused, silent = list(self.subscriptions.refused), self.silent_topics
        text = f'; not recorded: {first_few(refused)}' if refused else ''
        return text + (f'; nothing comes on {first_few(silent)}' if silent else '')

    def _open_bag(self) -> BagWriter:
        settings = self._settings
        return BagWriter(
            bag_path(settings),
            distribution=os.environ.get('ROS_DISTRO', ''),
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
    now = datetime.now().astimezone()
    return folder / str(settings['name'] or f'{now:soft_throw_%Y_%m_%d-%H_%M_%S_%f}')


class Recorder(RunnableNode):
    """Node that records; its exit code is 1 after `close` if a recording has failed."""

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('recorder', **kwargs)
        self.recording: Recording | None = None  # the one under way
        self._viewer: subprocess.Popen[bytes] | None = None  # while it runs
        self.add_cleanup(self.close)
        self._has_failed = False
        self._last = 'nothing has been recorded yet'
        self.parameters = NodeParameters(self, RECORDER, arguments=arguments)
        self._outgoing = Publishers(self, RECORDER_TOPICS)
        create_service(self, RECORDER_SERVICES.start, self._on_start)
        create_service(self, RECORDER_SERVICES.stop, self._on_stop)
        self.create_steady_timer(_DISCOVERY_TIME, self._on_discovery)
        self.create_steady_timer(1.0, self._on_second)

    def start(self) -> None:
        """Start recording if the parameter `start` is true."""
        settings = self.parameters.settings
        if settings['start']:
            self.begin()
        else:
            self._report()
        if settings['rerun.sink'] != 'none':
            self._viewer = self._start_viewer(settings)
        self.get_logger().info('ready')

    def close(self) -> None:
        """Finish the recording under way, end the viewer, and set the exit code."""
        if self._viewer is not None:
            self._viewer.terminate()  # it ends while the bag is finished
        if self.recording is not None:
            with contextlib.suppress(RequestRejected):
                self.end()
        if self._viewer is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._viewer.wait(_VIEWER_TIMEOUT)
        if self._has_failed:
            self.exit_code = 1

    def begin(self) -> None:
        """Start a recording; ParameterError if the bag exists."""
        settings = self.parameters.settings
        if (path := bag_path(settings)).exists():
            raise ParameterError(
                f'{path} exists, and a bag is never overwritten; choose another name, or none, '
                f'got name {settings["name"]!r}'
            )
        self.recording = Recording(self, settings)
        self._on_discovery()
        self._report()
        error = self.recording.writer.error
        self.log(error or self._message(), is_error=bool(error))

    def end(self) -> str:
        """Finish the recording, and return its summary, or raise RequestRejected with it."""
        recording, self.recording = self.recording, None
        assert recording is not None
        recording.stop()
        self._last = recording.summary()
        self._report()
        self.log(self._last, is_error=recording.has_failed)
        if recording.has_failed:
            self._has_failed = True
            raise RequestRejected(self._last)
        return self._last

    def _start_viewer(self, settings: Settings) -> subprocess.Popen[bytes]:
        """Start a viewer of the same topics."""
        path = self.recording.bag if self.recording is not None else None
        parameters = {
            'topics': list(settings['topics']),
            'sink': settings['rerun.sink'],
            'file': f'{(path or bag_path(settings)).absolute()}.rrd',
        }
        rules = (f'{name}:={json.dumps(value)}' for name, value in parameters.items())
        words = (word for rule in rules for word in ('-p', rule))
        return start_child('viewer', '--ros-args', '-r', f'__ns:={self.get_namespace()}', *words)

    def _on_start(self) -> str:
        if self.recording is not None:
            raise RequestRejected(f'already {self._message()}; call ~/stop first')
        self.begin()
        return self._message()

    def _on_stop(self) -> str:
        if self.recording is None:
            raise RequestRejected(f'nothing is being recorded; {self._last}')
        return self.end()

    def _on_discovery(self) -> None:
        if self.recording is not None:
            self.recording.subscriptions.discover()

    def _on_second(self) -> None:
        """Publish the state of the recording, and log its problems."""
        if self._viewer is not None and self._viewer.poll() is not None:
            code, self._viewer = self._viewer.returncode, None
            self.get_logger().error(f'the viewer has ended with exit code {code}')
        if self.recording is not None:
            for problem in self.recording.new_problems():
                self.get_logger().warning(problem)
            if error := self.recording.writer.error:
                waiting, lost = self.recording.writer.waiting, self.recording.losses().total()
                self.get_logger().error(f'{error}; {waiting} messages wait, {lost} are lost')
        self._outgoing.report(RECORDER_TOPICS.diagnostics, self._statuses())

    def _report(self) -> None:
        """Publish whether the node records, also for late subscribers."""
        self._outgoing.report(RECORDER_TOPICS.status, self._statuses()[:1])

    def _message(self) -> str:
        """Return the state of the recorder as text."""
        recording = self.recording
        if recording is None:
            return f'stopped: {self._last}'
        return f'recording into {recording.bag}' if recording.bag else 'recording nothing'

    def _statuses(self) -> list[DiagnosticStatus]:
        recording, status = self.recording, self._outgoing.status
        if recording is None:
            return [status('bag', self._message(), {'is_recording': False})]
        values = {
            'is_recording': True,
            'bag': recording.bag or '',
            'messages': recording.subscriptions.received,
            'topics': len(list(recording.subscriptions)),
        }
        error, missing, losses = recording.writer.error, recording.missing, recording.losses()
        lost = losses.total()
        return [
            status('bag', error or self._message(), values, warn=bool(error)),
            status(
                'losses', f'{lost} messages lost{missing}', {'lost': lost, **losses},
                warn=bool(lost or missing),
            ),
        ]


main = partial(run, 'recorder', Recorder)
