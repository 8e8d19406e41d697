# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node `recorder`: records topics into a bag, and may start a viewer that shows them live."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from functools import partial
import gc
import json
from pathlib import Path
import subprocess
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.configuration import ParameterError, RECORDER, Settings
from soft_throw_ros.configuration.interface import RECORDER_SERVICES, RECORDER_TOPICS
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run, RunnableNode
from soft_throw_ros.nodes.recording import bag_path, Recording
from soft_throw_ros.nodes.topics import create_service, Publishers
from soft_throw_ros.recording.child_process import bound_to_parent
from soft_throw_ros.twin.session import RequestRejected

_DISCOVERY_TIME = 0.2  # time between two searches for new topics [s]
_VIEWER_TIMEOUT = 2.0  # longest wait for the end of the viewer [s]


class Recorder(RunnableNode):
    """Node that records; its exit code is 1 after `close` if a recording has failed."""

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('recorder', **kwargs)
        self.recording: Recording | None = None  # the one under way
        self._viewer: subprocess.Popen[bytes] | None = None  # while it runs
        self.add_cleanup(self.close)
        self._has_failed = False
        self._last = 'nothing has been recorded yet'
        self._logged: set[str] = set()  # problems of the recording
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
        if self.parameters.settings['rerun.sink'] != 'none':
            self._viewer = self._start_viewer(self.parameters.settings)
        self.get_logger().info('ready')

    def close(self) -> None:
        """Finish the recording under way, end the viewer, and set the exit code."""
        viewer, self._viewer = self._viewer, None
        if viewer is not None:
            viewer.terminate()  # it ends while the bag is finished
        if self.recording is not None:
            self.end()
        if viewer is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                viewer.wait(_VIEWER_TIMEOUT)
        if self._has_failed:
            self.exit_code = 1

    def begin(self) -> None:
        """Start a recording; ParameterError if the bag exists."""
        _check(self.parameters.settings)
        self.recording = Recording(self, self.parameters.settings)
        self._logged = set()
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

    def _start_viewer(self, settings: Settings) -> subprocess.Popen[bytes]:
        """Start a viewer of the same topics, which never outlives this process."""
        path = self.recording.bag if self.recording is not None else None
        parameters = {
            'topics': list(settings['topics']),
            'sink': settings['rerun.sink'],
            'file': f'{(path or bag_path(settings)).absolute()}.rrd',
        }
        rules = [f'{name}:={json.dumps(value)}' for name, value in parameters.items()]
        command = [sys.executable, '-m', 'soft_throw_ros', 'viewer', '--ros-args']
        command += ['-r', f'__ns:={self.get_namespace()}']
        return subprocess.Popen(
            bound_to_parent([*command, *(word for rule in rules for word in ('-p', rule))]),
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C reaches only the recorder
        )

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
        if self._viewer is not None and self._viewer.poll() is not None:
            code, self._viewer = self._viewer.returncode, None
            self._log(f'the viewer has ended with exit code {code}', is_error=True)
        recording = self.recording
        if recording is not None:
            recording.watch_publishers()
            for problem in recording.problems():
                if problem not in self._logged:
                    self._logged.add(problem)
                    self.get_logger().warning(problem)
            if error := recording.writer.error:
                waiting, lost = recording.writer.waiting, sum(recording.losses().values())
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
        error, missing = recording.writer.error, recording.missing_sources
        losses = recording.losses()
        lost = sum(losses.values())
        text = f'{lost} messages lost{missing}'
        return [
            status('bag', error or self._message(), values, warn=bool(error)),
            status('losses', text, {'lost': lost, **losses}, warn=lost > 0 or bool(missing)),
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
