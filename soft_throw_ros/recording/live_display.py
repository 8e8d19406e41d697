# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Messages drawn into Rerun as they come, by a thread of its own.

Rerun blocks the thread that calls it for as long as its viewer hangs. The other threads of the
process go on meanwhile; messages beyond a limit are dropped and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
import queue
import socket
import threading
import time

import rerun as rr
from soft_throw_ros.recording import rerun_output as output
from soft_throw_ros.recording import rerun_viewer
from soft_throw_ros.recording.rerun_view import Scene
from soft_throw_ros.storage.message import Message

LIVE_PERIOD = 1.0 / 30.0
"""Time between two updates of a viewer. [s]"""

FILE_PERIOD = 0.5
"""Time between two updates of a file; longer times make a smaller file. [s]"""

EXIT_TIME = 0.7
"""Longest wait of `LiveDisplay.close` for a viewer. [s]"""

MAX_WAITING = 20_000
"""Number of messages that may wait to be drawn; further ones are dropped and counted."""


class LiveDisplay:
    """
    Draws messages into a sink: a `viewer`, viewers that connect (`serve`), or a `file`.

    Raises
    ------
    ValueError
        If the port is taken.
    OSError
        If the file cannot be written.

    """

    def __init__(self, sink: str, port: int, path: Path, log: Callable[[str], None]) -> None:
        self.dropped = 0  # number of messages that came too fast to be drawn
        self.scene = Scene('live', is_live=True)
        self._stream = output.new_stream()
        self._connection: _ViewerConnection | None = None
        self._is_file = sink == 'file'
        if sink == 'viewer':
            self._connection = _ViewerConnection(self.scene, self._stream, port, log)
        elif sink == 'serve':
            output.serve(self._stream, port)
            log(f'to see it: rerun {rerun_viewer.url_of(port)}')
        else:
            output.save_to(self._stream, path, is_live=True)
        if self._connection is None:
            self.scene.connect(self._stream)
        self._inbox: queue.Queue[Message] = queue.Queue(MAX_WAITING)
        self._is_closing = threading.Event()
        self._thread = threading.Thread(name='drawing', target=self._run, daemon=True)
        self._thread.start()

    def put(self, messages: Iterable[Message]) -> None:
        """Queue messages to be drawn; drop and count those beyond `MAX_WAITING`."""
        for message in messages:
            try:
                self._inbox.put_nowait(message)
            except queue.Full:
                self.dropped += 1

    def close(self) -> None:
        """Draw the waiting messages, for at most `EXIT_TIME` in a viewer, completely in a file."""
        self._is_closing.set()
        self._thread.join(None if self._is_file else EXIT_TIME)

    def _run(self) -> None:
        is_last = False
        while not is_last:
            is_last = self._is_closing.wait(FILE_PERIOD if self._is_file else LIVE_PERIOD)
            if self._connection is not None:
                self._connection.check()
            self.scene.show([self._inbox.get() for _ in range(self._inbox.qsize())])
        if output.flush(self._stream, EXIT_TIME):
            self._stream.disconnect()


class _ViewerConnection:
    """A stream to a viewer that comes and goes."""

    def __init__(
        self, scene: Scene, stream: rr.RecordingStream, port: int, log: Callable[[str], None]
    ) -> None:
        self._scene = scene
        self._stream = stream
        self._port = port
        self._log = log
        self._connection: socket.socket | None = None
        self._next_probe = 0.0  # by `time.monotonic` [s]
        if not rerun_viewer.listens(port):
            threading.Thread(target=self._start, name='viewer', daemon=True).start()

    def check(self) -> None:
        """Detach from a viewer that is gone, or connect to one that is there."""
        if self._connection is not None:
            if rerun_viewer.is_open(self._connection):
                return
            self._connection.close()
            self._connection = None
            self._scene.connect(None)
            self._log(f'the viewer at {rerun_viewer.HOST}:{self._port} has gone; waiting for one')
        if time.monotonic() < self._next_probe:
            return
        self._next_probe = time.monotonic() + output.PROBE_TIME
        self._connection = rerun_viewer.connect(self._port)
        if self._connection is not None:
            self._stream.connect_grpc(rerun_viewer.url_of(self._port))
            self._scene.connect(self._stream)
            self._log(f'connected to the viewer at {rerun_viewer.HOST}:{self._port}')

    def _start(self) -> None:
        """Start a viewer that stays when this process ends."""
        try:
            output.check_viewer(self._port, '-p sink:=file (rerun.sink:=file of a recorder)')
            rerun_viewer.Viewer(self._port, stays=True)
        except rerun_viewer.ViewerError as error:
            self._log(str(error))
