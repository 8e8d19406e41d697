# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings of Rerun and their sinks: a file, a viewer, or viewers that connect."""

from __future__ import annotations

from collections.abc import Callable
import errno
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

from soft_throw_ros.recording import rerun_viewer
from soft_throw_ros.recording.rerun_viewer import HOST, listens, Viewer, ViewerError

if TYPE_CHECKING:
    import rerun as rr

PORT = 9876
"""Default port of the viewer."""

PROBE_TIME = 1.0
"""Time between two attempts to connect to a viewer. [s]"""

_SERVER_MEMORY = '256MB'


def new_stream() -> rr.RecordingStream:
    """Return a new recording without a sink."""
    import rerun as rr

    batches = rr.ChunkBatcherConfig.LOW_LATENCY()
    return rr.RecordingStream('soft_throw_ros', batcher_config=batches, send_properties=False)


def flush(stream: rr.RecordingStream, seconds: float) -> bool:
    """Send all waiting data; return whether that succeeded in time."""
    try:
        stream.flush(timeout_sec=seconds)
    except RuntimeError:
        return False
    return True


def save_to(stream: rr.RecordingStream, path: Path, *, is_live: bool) -> None:
    """Write a recording to a file from now on; raise OSError if that is not possible."""
    try:
        stream.save(path, write_footer=not is_live)  # a footer grows in memory with time
    except RuntimeError as error:
        raise OSError(str(error)) from None


def save_recording(stream: rr.RecordingStream, path: Path, draw: Callable[[], None]) -> None:
    """Draw a recording into a file; raise OSError if it is not written completely."""
    save_to(stream, path, is_live=False)
    draw()
    is_written = flush(stream, math.inf)
    stream.disconnect()
    if not is_written:
        raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))


def serve(stream: rr.RecordingStream, port: int) -> None:
    """Send a recording to viewers that connect, on this machine only."""
    import rerun as rr

    if listens(port):
        raise ValueError(f'port {port} of {HOST} is in use; choose another one')
    sink = rr.GrpcServerSink(bind_ip=HOST, port=port, server_memory_limit=_SERVER_MEMORY)
    stream.set_sinks(sink)


def check_viewer(port: int, instead: str) -> None:
    """Raise ViewerError if there is neither a viewer nor a screen; `instead` is the remedy."""
    if listens(port) or rerun_viewer.has_display():
        return
    raise ViewerError(
        'there is no screen for a window (DISPLAY and WAYLAND_DISPLAY are not set), and no viewer '
        f'at {HOST}:{port}; take {instead}, or start one where there is a screen: '
        f'{rerun_viewer.find_viewer()} --bind {HOST} --port {port}'
    )


def send_recording(stream: rr.RecordingStream, port: int, draw: Callable[[], None]) -> None:
    """
    Draw a recording into the running viewer, or into a new one that stays.

    Raise ViewerError if there is none, or it does not receive everything. The recording is still
    connected afterwards.
    """
    if not listens(port):
        Viewer(port, stays=True)
    connection = rerun_viewer.connect(port)
    if connection is None:
        raise ViewerError(f'no viewer listens at {HOST}:{port} any more')
    with connection:
        stream.connect_grpc(rerun_viewer.url_of(port))
        draw()
        while not flush(stream, PROBE_TIME):
            if not rerun_viewer.is_open(connection):
                raise ViewerError('the viewer was closed before it had everything')
