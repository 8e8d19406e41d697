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
"""Recordings of Rerun, and where they go: to a file, to a viewer, or to those that connect."""

from __future__ import annotations

from collections.abc import Callable
import errno
import math
import os
from pathlib import Path
import time
from typing import TYPE_CHECKING

from soft_throw_ros.recording import viewer
from soft_throw_ros.recording.viewer import HOST, listens, Viewer, ViewerError

if TYPE_CHECKING:
    import rerun as rr

PORT = 9876
"""Where a viewer is, or will be, if nothing else is said."""

PROBE_TIME = 1.0
"""How often it is looked whether a viewer is there. [s]"""

WINDOW = ('--hide-welcome-screen', '--expect-data-soon')
"""Options of a viewer with a window."""

_APPLICATION = 'soft_throw_ros'
"""What Rerun knows the recordings by."""

_SERVER_MEMORY = '256MB'


def new_stream() -> rr.RecordingStream:
    """Begin a recording, which goes nowhere yet."""
    import rerun as rr

    batches = rr.ChunkBatcherConfig.LOW_LATENCY()
    return rr.RecordingStream(_APPLICATION, batcher_config=batches, send_properties=False)


def store_of(stream: rr.RecordingStream) -> str:
    """Return what a viewer calls a recording."""
    return f'Recording:{_APPLICATION}:{stream.get_recording_id()}'


def flush(stream: rr.RecordingStream, seconds: float) -> bool:
    """Send what waits, and tell whether it went."""
    try:
        stream.flush(timeout_sec=seconds)
    except RuntimeError:
        return False
    return True


def save_to(stream: rr.RecordingStream, path: Path, *, is_live: bool) -> None:
    """Have a recording written to a file; raise OSError if that cannot be done."""
    try:
        stream.save(path, write_footer=not is_live)  # whose size grows with time, in memory
    except RuntimeError as error:
        raise OSError(str(error)) from None


def save_recording(stream: rr.RecordingStream, path: Path, draw: Callable[[], None]) -> None:
    """Write what is drawn into a file, whole; raise OSError if that cannot be done."""
    save_to(stream, path, is_live=False)
    draw()
    is_written = flush(stream, math.inf)
    stream.disconnect()
    if not is_written:
        raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))


def serve(stream: rr.RecordingStream, port: int) -> None:
    """Have a recording sent to viewers that connect, on this machine only."""
    import rerun as rr

    if listens(port):
        raise ValueError(f'somebody listens at {HOST}:{port} already; take another --port')
    sink = rr.GrpcServerSink(bind_ip=HOST, port=port, server_memory_limit=_SERVER_MEMORY)
    stream.set_sinks(sink)


def no_screen(port: int, instead: str) -> str:
    """Say that there is neither a screen nor a viewer, and what to do."""
    return (
        'there is no screen for a window (DISPLAY and WAYLAND_DISPLAY are not set), and no viewer '
        f'at {HOST}:{port}; take {instead}, or start one where there is a screen: '
        f'{viewer.find_viewer()} --bind {HOST} --port {port}'
    )


def check_viewer(port: int, instead: str) -> None:
    """Raise ViewerError if there is neither a viewer nor a screen; say what to do instead."""
    if not listens(port) and not viewer.has_display():
        raise ViewerError(no_screen(port, instead))


def send_recording(
    stream: rr.RecordingStream, port: int, draw: Callable[[], None], *, within: float = math.inf
) -> None:
    """
    Show what is drawn in the viewer that is there, or in one that stays.

    Parameters
    ----------
    stream : RecordingStream
        Is still connected afterwards.
    port : int
        Of the viewer.
    draw : callable
        Draws into `stream`.
    within : float
        Longest wait for the viewer to take it. [s]

    Raises
    ------
    ViewerError
        If there is no viewer, or it does not take all.

    """
    if not listens(port):
        Viewer(port, *WINDOW, stays=True)
    connection = viewer.connect(port)
    if connection is None:
        raise ViewerError(f'nobody listens at {HOST}:{port} any more')
    with connection:
        stream.connect_grpc(viewer.url_of(port))
        draw()
        deadline = time.monotonic() + within
        while not flush(stream, PROBE_TIME):
            if not viewer.is_open(connection):
                raise ViewerError('the viewer was closed before it had everything')
            if time.monotonic() > deadline:
                raise ViewerError(f'the viewer at {HOST}:{port} does not take it')
