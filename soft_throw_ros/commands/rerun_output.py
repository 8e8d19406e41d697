# SPDX-License-Identifier: Apache-2.0
"""Recordings of Rerun that are whole when they are handed over: to a file, or to a viewer."""

from __future__ import annotations

from collections.abc import Callable
import errno
import math
import os
from pathlib import Path
import time
from typing import TYPE_CHECKING

from soft_throw_ros.recording.viewer import (
    connect,
    has_display,
    HOST,
    is_open,
    listens,
    Viewer,
    ViewerError,
)

if TYPE_CHECKING:
    import rerun as rr

PORT = 9876
"""Where a viewer is, or will be, if nothing else is said."""

PROBE_TIME = 1.0
"""How often it is looked whether a viewer is there. [s]"""

WINDOW = ('--hide-welcome-screen', '--expect-data-soon')
"""Options of a viewer with a window."""


def save_recording(stream: rr.RecordingStream, path: Path, draw: Callable[[], None]) -> None:
    """Write what is drawn into a file; raise OSError if that cannot be done."""
    from soft_throw_ros.recording import rerun_canvas

    rerun_canvas.save_to(stream, path, is_live=False)
    draw()
    is_written = rerun_canvas.flush(stream, math.inf)
    stream.disconnect()
    if not is_written:
        raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))


def check_viewer(port: int, instead: str) -> None:
    """Raise ViewerError if there is neither a viewer nor a screen; say what to do instead."""
    if not listens(port) and not has_display():
        raise ViewerError(
            f'there is no screen for a window; take {instead}, or start a viewer that listens at '
            f'{HOST}:{port}'
        )


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
    from soft_throw_ros.recording import rerun_canvas

    if not listens(port):
        Viewer(port, *WINDOW, stays=True)
    connection = connect(port)
    if connection is None:
        raise ViewerError(f'nobody listens at {HOST}:{port} any more')
    with connection:
        rerun_canvas.connect_to(stream, port)
        draw()
        deadline = time.monotonic() + within
        while not rerun_canvas.flush(stream, PROBE_TIME):
            if not is_open(connection):
                raise ViewerError('the viewer was closed before it had everything')
            if time.monotonic() > deadline:
                raise ViewerError(f'the viewer at {HOST}:{port} does not take it')
