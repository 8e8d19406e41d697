# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node `recorder`: records topics into a bag."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
import gc
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.configuration import ParameterError, RECORDER, Settings
from soft_throw_ros.configuration.interface import RECORDER_SERVICES, RECORDER_TOPICS
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run, RunnableNode
from soft_throw_ros.nodes.recording import bag_path, Recording
from soft_throw_ros.nodes.topics import create_service, Publishers
from soft_throw_ros.twin.session import RequestRejected

_DISCOVERY_TIME = 0.2  # time between two searches for new topics [s]


class Recorder(RunnableNode):
    """Node that records; its exit code is 1 after `close` if a recording has failed."""

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('recorder', **kwargs)
        self.recording: Recording | None = None  # the one under way
        self.add_cleanup(self.close)
        self._has_failed = False
        self._last = 'nothing has been recorded yet'
        self.parameters = NodeParameters(self, RECORDER, arguments=arguments)
        if self.parameters.settings['start']:
            _check(self.parameters.settings)
        self._outgoing = Publishers(self, RECORDER_TOPICS)
        create_service(self, RECORDER_SERVICES.start, self._on_start)
        create_service(self, RECORDER_SERVICES.stop, self._on_stop)
        self.create_steady_timer(_DISCOVERY_TIME, self._on_discovery)
        self.create_steady_timer(1.0, self._on_second)

    def start(self) -> None:
        """Start recording if the parameter `start` is true."""
        gc.collect()
        gc.freeze()
        if self.parameters.settings['start']:
            self.begin()
        else:
            self._report()
        self.get_logger().info('ready')

    def close(self) -> None:
        """Finish the recording under way, and set the exit code."""
        if self.recording is not None:
            self.end()
        if self._has_failed:
            self.exit_code = 1

    def begin(self) -> None:
        """Start a recording; ParameterError if the bag exists."""
        _check(self.parameters.settings)
        self.recording = Recording(self, self.parameters.settings)
        self._on_discovery()
        self._report()
        error = self.recording.writer.error
        self._log(error or self._message(), is_error=bool(error))

    def end(self) -> bool:
        """Finish the recording, and return whether it has failed."""
        recording, self.recording = self.recording, None
        assert recording is not None
        recording.stop()
        self._has_failed |= recording.has_failed
        self._last = recording.summary()
        self._report()
        self._log(self._last, is_error=recording.has_failed)
        return recording.has_failed

    def _log(self, text: str, *, is_error: bool) -> None:
        if is_error:
            self.get_logger().error(text)
        else:
            self.get_logger().info(text)

    def _on_start(self) -> str:
        if self.recording is not None:
            stop = RECORDER_SERVICES.stop.name
            raise RequestRejected(f'already {self._message()}; call {stop} first')
        self.begin()
        return self._message()

    def _on_stop(self) -> str:
        if self.recording is None:
            raise RequestRejected(f'nothing is being recorded; {self._last}')
        if self.end():
            raise RequestRejected(self._last)
        return self._last

    def _on_discovery(self) -> None:
        if self.recording is not None:
            self.recording.subscriptions.discover()

    def _on_second(self) -> None:
        """Publish the state of the recording, and log its problems."""
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


def _check(settings: Settings) -> None:
    """Raise ParameterError for a bag that cannot be created."""
    name, path = settings['name'], bag_path(settings)
    if name and (name != Path(name).name or name in ('.', '..')):
        raise ParameterError(f'the name of a bag must be that of a folder, got {name!r}', 'name')
    if path.exists():
        raise ParameterError(
            f'{path} exists, and a bag is never overwritten; choose another name, or none, '
            f'got name {name!r}',
            'name',
        )


main = partial(run, 'recorder', Recorder)
