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
"""
Record topics into a bag, and show them live in Rerun.

One thread takes what has come, every few milliseconds; another writes it; a third sends it to the
process that shows it. The executor has the services, and looks for topics that appear.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
import gc
from pathlib import Path
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from soft_throw_ros.configuration import files, ParameterError, RECORDER, Settings, TWIN
from soft_throw_ros.configuration.interface import (
    find_topic,
    RECORDER_SERVICES,
    RECORDER_TOPICS,
    TWIN_TOPICS,
)
from soft_throw_ros.nodes.conversions import status_to_msg
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run, RunnableNode
from soft_throw_ros.nodes.raw_subscriptions import is_wanted, RawSubscriptions
from soft_throw_ros.nodes.topics import create_service, full_name, Publishers
from soft_throw_ros.nodes.transport import distribution
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.cdr import decode, MessageError
from soft_throw_ros.recording.live_stream import LiveStream
from soft_throw_ros.recording.message import Message
from soft_throw_ros.recording.writer_thread import WriterThread
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.session import RequestRejected

DRAIN_TIME = 0.01
"""How often messages are taken. [s]"""

PUBLISHER_TIMEOUT = 2.0
"""After this it is said what is wanted and published by nobody. [s]"""

DISCOVERY_TIME = 0.2
"""How often it is looked for new topics. [s]"""


class Recording:
    """
    From start to stop: what is taken, where it goes, and what became of it.

    Attributes
    ----------
    subscriptions : RawSubscriptions
        What is taken.
    writer : WriterThread or None
        Where it is written.
    live_stream : LiveStream or None
        Where it is shown.

    """

    def __init__(self, recorder: Node, settings: Settings) -> None:
        self._wanted = [full_name(recorder, name) for name in settings['topics']]
        self._is_silence_told = False
        self.subscriptions = RawSubscriptions(recorder, self._wanted)
        self.writer: WriterThread | None = None
        self.live_stream: LiveStream | None = None
        self._settings = settings
        self._began = time.monotonic()
        self._twins: dict[str, object] = {}
        if settings['storage'] == 'mcap':
            self.writer = WriterThread(self._open_bag, capacity=settings['buffer'])
            text = files.render(settings, table=RECORDER, title='How this was recorded.')
            self._attach(self.writer, 'recorder.yaml', text)
        if settings['rerun.sink'] != 'none':
            self.live_stream = LiveStream(self._inspect_command())
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(name='drain', target=self._run, daemon=True)
        self._thread.start()

    @property
    def bag(self) -> Path | None:
        """Where the bag is; None if there is none, or none yet."""
        written = self.writer.bag if self.writer is not None else None
        return written.folder if written is not None else None

    @property
    def error(self) -> str:
        """Why nothing is written at present; empty if all is well."""
        return self.writer.error if self.writer is not None else ''

    @property
    def is_alive(self) -> bool:
        """Whether the threads do what they should; a defect may have ended one."""
        return self._thread.is_alive() and (self.writer is None or self.writer.is_alive)

    @property
    def received(self) -> int:
        """How many messages came."""
        return sum(item.received for item in self.subscriptions)

    def take_silent(self) -> list[str]:
        """Return, once and after a while, what is wanted and published by nobody."""
        if self._is_silence_told or time.monotonic() - self._began < PUBLISHER_TIMEOUT:
            return []
        self._is_silence_told = True
        topics = [item.channel.topic for item in self.subscriptions]
        return [name for name in self._wanted if not any(is_wanted(t, [name]) for t in topics)]

    def losses(self) -> dict[str, int]:
        """Return how many messages of which topics were published and are not in the bag."""
        lost = Counter({item.channel.topic: item.lost for item in self.subscriptions})
        if self.writer is not None:
            for channel, count in self.writer.lost().items():
                lost[channel.topic] += count
        return dict(sorted((+lost).items()))

    def earlier(self) -> dict[str, int]:
        """Return how many messages of which topics were published before we joined."""
        counts = Counter({item.channel.topic: item.earlier for item in self.subscriptions})
        return dict(sorted((+counts).items()))

    @property
    def has_failed(self) -> bool:
        """Whether, after the stop, the bag has no end, or nothing of what came is in it."""
        lost = sum(self.writer.lost().values()) if self.writer is not None else 0
        return bool(self.error) or 0 < self.received <= lost

    def stop(self) -> None:
        """Take what has come, and bring bag and viewer to an end; see `error` and `has_failed`."""
        self._is_stopping.set()
        self._thread.join()
        self.subscriptions.close()
        if self.writer is not None:
            losses = self.losses()
            self._note(self.writer, 'losses', {'total': sum(losses.values()), **losses})
            if earlier := self.earlier():
                self._note(self.writer, 'published before recording', earlier)
            self.writer.close()
        if self.live_stream is not None:
            self.live_stream.close()

    def summary(self) -> str:
        """Say what was recorded, and what was not."""
        seconds = time.monotonic() - self._began
        losses = self.losses()
        text = f'{self.received} messages in {seconds:.1f} s, {sum(losses.values())} lost'
        text += ''.join(f', {count} of {topic}' for topic, count in losses.items())
        if self.bag is not None:
            text += f', in {self.bag}'
        if earlier := self.earlier():
            text += f'; joined late, after {sum(earlier.values())} messages'
            text += ''.join(f', {count} of {topic}' for topic, count in earlier.items())
        if self.error:
            text += f'; the end is missing: {self.error}'
            if self.bag is not None and self.bag.exists():
                text += f'; `soft-throw recover {self.bag}` makes a whole bag of it'
        if self.live_stream is not None and self.live_stream.dropped:
            text += f'; {self.live_stream.dropped} not shown'
        return text

    def _open_bag(self) -> BagWriter:
        settings = self._settings
        return BagWriter(
            _path(settings),
            distribution=distribution(),
            compression=settings['compression'],
            max_size=settings['split.size'],
            max_duration=settings['split.duration'],
            sync=settings['sync'],
        )

    def _run(self) -> None:
        """Take what has come, until told to stop, and then once more."""
        while not self._is_stopping.wait(DRAIN_TIME):
            self._take()
        self._take()

    def _take(self) -> None:
        messages = self.subscriptions.drain()
        if not messages:
            return
        if self.live_stream is not None:
            self.live_stream.put(messages)
        if self.writer is not None:
            self.writer.put(messages)
            for message in messages:
                if message.channel.type == TWIN_TOPICS.journal.type:
                    self._read_journal(self.writer, message)

    def _read_journal(self, writer: WriterThread, message: Message) -> None:
        """Write down what a twin tells of itself, at first and on change."""
        channel = message.channel
        found = find_topic(channel.topic, channel.type)
        if found is None or found.topic != TWIN_TOPICS.journal:
            return
        try:
            entry = journal.decode(decode(channel.type, channel.schema, message.data).data)
            settings, versions = journal.checked_settings(entry, 'settings'), entry['versions']
        except (MessageError, journal.JournalError, KeyError):
            return  # an entry that has none, or somebody else's topic
        node = found.node
        if node not in self._twins:
            name = f'{node.strip("/").replace("/", "_")}.yaml'
            text = files.render(settings, table=TWIN, title=f'The parameters of {node}.')
            self._attach(writer, name, text)
        if self._twins.get(node) != (settings, versions):
            self._twins[node] = settings, versions
            self._note(writer, f'parameters of {node}', settings)
            self._note(writer, f'versions of {node}', versions)

    @staticmethod
    def _attach(writer: WriterThread, name: str, text: str) -> None:
        """Put a file of parameters into the bag."""
        data, now = text.encode(), time.time_ns()
        writer.call(lambda bag: bag.attach(name, data, 'application/yaml', time=now))

    @staticmethod
    def _note(writer: WriterThread, name: str, values: Mapping[str, object]) -> None:
        """Put named values into the bag."""
        texts = {key: str(value) for key, value in values.items()}
        writer.call(lambda bag: bag.add_metadata(name, texts))

    def _inspect_command(self) -> list[str]:
        """Return what shows the stream."""
        settings = self._settings
        python = settings['rerun.python'] or sys.executable
        command = [python, '-m', 'soft_throw_ros', 'inspect', '-']
        if settings['rerun.sink'] == 'file':
            path = _path(settings) if self.bag is None else self.bag / self.bag.name
            return [*command, '--save', f'{path}.rrd']
        return [*command, '--sink', settings['rerun.sink'], '--port', str(settings['rerun.port'])]


class Recorder(RunnableNode):
    """
    What records.

    Attributes
    ----------
    recording : Recording or None
        None while it is stopped.

    Raises
    ------
    ParameterError
        In one line, if a parameter is refused, or the bag that is named is there already.

    """

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('recorder', **kwargs)
        self.recording: Recording | None = None
        self.at_end(self.close)
        self._has_failed = False
        self._last = 'nothing has been recorded yet'
        when = ', when recording is started again'
        self.parameters = NodeParameters(
            self,
            RECORDER,
            describe=lambda _name: when if self.recording is not None else '',
            arguments=arguments,
        )
        if self.parameters.settings['start']:
            _check(self.parameters.settings)
        self._outgoing = Publishers(self, RECORDER_TOPICS)
        create_service(self, RECORDER_SERVICES.start, self._on_start)
        create_service(self, RECORDER_SERVICES.stop, self._on_stop)
        self.call_every(DISCOVERY_TIME, self._on_discovery)
        self.call_every(1.0, self._on_second)

    @property
    def exit_code(self) -> int | None:
        """1 if recording has come to an end by itself, or failed."""
        is_alive = self.recording is None or self.recording.is_alive
        return 1 if self._has_failed or not is_alive else None

    def start(self) -> None:
        """Record, if that is wanted from the beginning."""
        gc.collect()
        gc.freeze()
        if self.parameters.settings['start']:
            self.begin()
        else:
            self._report()
        self.get_logger().info('ready')

    def close(self) -> None:
        """Finish what is being recorded."""
        if self.recording is not None:
            self._has_failed = self.end()

    def begin(self) -> None:
        """
        Record.

        Raises
        ------
        ParameterError
            If there would be nothing to do, or the bag that is named is there already.

        """
        _check(self.parameters.settings)
        self.recording = Recording(self, self.parameters.settings)
        self._on_discovery()
        self._report()
        if self.recording.error:
            self.get_logger().error(self.recording.error)
        else:
            self.get_logger().info(self._message())

    def end(self) -> bool:
        """Record no more, and tell whether that was in vain."""
        recording, self.recording = self.recording, None
        assert recording is not None
        recording.stop()
        self._last = recording.summary()
        self._report()
        if recording.has_failed:
            self.get_logger().error(self._last)
        else:
            self.get_logger().info(self._last)
        return recording.has_failed

    def _on_start(self) -> str:
        if self.recording is not None:
            stop = RECORDER_SERVICES.stop.name
            raise RequestRejected(f'already {self._message()}; call {stop} first')
        self.begin()
        return self._message()

    def _on_stop(self) -> str:
        if self.recording is None:
            raise RequestRejected(f'nothing is being recorded; {self._last}')
        self.end()
        return self._last

    def _on_discovery(self) -> None:
        recording = self.recording
        if recording is not None:
            for topic in recording.subscriptions.discover():
                reason = recording.subscriptions.refused[topic]
                self.get_logger().warning(f'{topic} is not recorded: {reason}')

    def _on_second(self) -> None:
        """Publish how recording goes, and say what is wrong."""
        now = self.get_clock().now().nanoseconds
        self._outgoing.send(RECORDER_TOPICS.diagnostics, now, self._statuses())
        recording = self.recording
        if recording is None:
            return
        if silent := recording.take_silent():
            self.get_logger().warning(f'nothing is published yet on {", ".join(silent)}')
        if recording.writer is not None and recording.error:
            lost = sum(recording.losses().values())
            self.get_logger().error(
                f'{recording.error}; {recording.writer.waiting} messages wait, {lost} are lost'
            )

    def _report(self) -> None:
        """Publish whether it records; late subscribers get it too."""
        now = self.get_clock().now().nanoseconds
        self._outgoing.send(RECORDER_TOPICS.status, now, self._statuses()[:1])

    def _message(self) -> str:
        """Say what is going on."""
        recording = self.recording
        if recording is None:
            return f'stopped: {self._last}'
        if recording.writer is None:
            return 'showing only'
        return f'recording into {recording.bag}' if recording.bag else 'recording nothing'

    def _statuses(self) -> list[DiagnosticStatus]:
        recording = self.recording
        status = partial(status_to_msg, self.get_fully_qualified_name())
        if recording is None:
            return [status('bag', self._message(), {'is_recording': False})]
        values = {
            'is_recording': True,
            'bag': recording.bag or '',
            'messages': recording.received,
            'topics': len(list(recording.subscriptions)),
        }
        message, error = self._message(), recording.error
        losses = recording.losses()
        lost = sum(losses.values())
        statuses = [
            status('bag', error or message, values, warn=bool(error)),
            status('losses', f'{lost} messages lost', {'lost': lost, **losses}, warn=lost > 0),
        ]
        stream = recording.live_stream
        if stream is not None:
            message = stream.error or f'{stream.dropped} messages not shown'
            values = {'dropped': stream.dropped, 'starts': stream.starts}
            is_bad = bool(stream.error or stream.dropped)
            statuses.append(status('viewer', message, values, warn=is_bad))
        return statuses


def _check(settings: Settings) -> None:
    """Refuse settings with which nothing can be recorded."""
    for error in RECORDER.contradictions(settings):
        raise error
    name = settings['name']
    if name and (name != Path(name).name or name in ('.', '..')):
        raise ParameterError(f'the name of a bag must be that of a folder, got {name!r}', 'name')
    if settings['storage'] == 'mcap' and name and _path(settings).exists():
        raise ParameterError(
            f'{_path(settings)} exists, and a bag is never overwritten; choose another name, '
            f'or none, got name {settings["name"]!r}',
            'name',
        )


def _path(settings: Settings) -> Path:
    """Return where a bag goes that is opened now."""
    name = settings['name'] or f'{datetime.now().astimezone():soft_throw_%Y_%m_%d-%H_%M_%S}'
    folder = Path(settings['folder']).expanduser()
    if settings['name']:
        return folder / name
    names = [name, *(f'{name}_{number}' for number in range(2, 100))]
    return next((folder / name for name in names if not (folder / name).exists()), folder / name)


main = partial(run, 'recorder', Recorder)
