# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings of Rerun, their files and servers, and its viewer as a local process."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import errno
from functools import partial
from importlib import util
import math
import os
from pathlib import Path
import signal
import socket
import subprocess
import tempfile
import time
from typing import Any

from soft_throw_ros.recording.child_process import bound_to_parent

HOST = '127.0.0.1'
PORT = 9876  # default port of the viewer
_TIMEOUT = 60.0  # longest wait until the viewer listens, has a recording, or has drawn [s]
_POLL = 0.25  # time between two requests [s]
_SETTLE_TIME = 2.0  # in which axes move to a new time [s]
_SERVER_MEMORY = '256MB'
_OPTIONS = (
    '--memory-limit', '2GB', '--server-memory-limit', _SERVER_MEMORY,
    '--hide-welcome-screen', '--expect-data-soon',
)


class ViewerError(RuntimeError):
    """The viewer cannot be used; the message has the reason and the remedy."""


def new_stream(name: str) -> Any:
    """Return a new `RecordingStream` without a sink, whose layout is not that of another name."""
    import rerun as rr

    stream = rr.RecordingStream(f'soft_throw_ros {name}', send_properties=False)
    stream.send_recording_name(name)
    return stream


def save_to(stream: Any, path: Path, *, is_live: bool) -> None:
    """Write a recording to a file from now on; raise OSError if that is not possible."""
    try:
        stream.save(path, write_footer=not is_live)  # a footer grows in memory with time
    except RuntimeError as error:
        raise OSError(str(error)) from None


def finish(stream: Any, path: Path | str, seconds: float = math.inf) -> None:
    """Send all waiting data, and disconnect; raise OSError if that does not succeed in time."""
    try:
        stream.flush(timeout_sec=seconds)
    except RuntimeError:
        raise OSError(errno.EIO, os.strerror(errno.EIO), str(path)) from None
    stream.disconnect()


def serve(stream: Any, port: int) -> None:
    """Send a recording to viewers that connect, on this machine only."""
    import rerun as rr

    if listens(port):
        raise ValueError(f'port {port} of {HOST} is in use; choose another one')
    sink = rr.GrpcServerSink(bind_ip=HOST, port=port, server_memory_limit=_SERVER_MEMORY)
    stream.set_sinks(sink)


def find_viewer() -> Path:
    """Return the path of the program `rerun`; raise ViewerError if there is none."""
    package = util.find_spec('rerun_cli')
    if package is None or package.origin is None:
        raise ViewerError("Rerun has no viewer; pip install 'soft_throw_ros[rerun]'")
    return Path(package.origin).with_name('rerun')


def has_display() -> bool:
    """Return whether a window could be opened."""
    return any(os.environ.get(name) for name in ('WAYLAND_DISPLAY', 'WAYLAND_SOCKET', 'DISPLAY'))


def url_of(port: int) -> str:
    """Return the address of a viewer or server on a port of this machine."""
    return f'rerun+http://{HOST}:{port}/proxy'


def listens(port: int) -> bool:
    """Return whether a process listens on a port."""
    with contextlib.suppress(OSError), socket.create_connection((HOST, port), 0.2):
        return True
    return False


def free_port() -> int:
    """Return an unused port."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


class Viewer(contextlib.AbstractContextManager['Viewer']):
    """A viewer process of bounded memory for this machine; one that `stays` outlives this one."""

    def __init__(self, port: int, *options: str | Path, stays: bool = False) -> None:
        viewer = str(find_viewer())
        command = [viewer, '--bind', HOST, '--port', str(port), *_OPTIONS, *map(str, options)]
        self.port = port
        self._errors = tempfile.TemporaryFile('w+', errors='replace')  # noqa: SIM115
        self._process = subprocess.Popen(
            command if stays else bound_to_parent(command), start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._errors,
            # CI stops the statistics for the makers of Rerun; RUST_LOG, notices in the window
            env={'RUST_LOG': 'error', **os.environ, 'CI': '1'},
        )
        self.pid = self._process.pid  # of the process, and of its group

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._process.wait()
        self._errors.close()

    def wait(self) -> None:
        """Wait until it listens; raise ViewerError if it ends before."""
        _request(partial(listens, self.port), self)

    def client(self) -> Any:
        """Return a client after a first picture; raise ViewerError if the viewer cannot draw."""
        self.wait()
        client = _request(partial(_connect, self.port), self)
        # the viewer answers other requests before it can draw
        _request(partial(client.take_screenshot, max_size=64), self)
        return client

    def photograph(self, path: Path, timeline: str, seconds: float | None) -> bytes:
        """Return a picture (PNG) of a recording at a time [s]; raise ViewerError if that fails."""
        client = self.client()
        _open(client, path, timeline, seconds)
        time.sleep(_SETTLE_TIME)
        return bytes(_request(client.take_screenshot, self))

    def last_words(self) -> str | None:
        """Return the first line of its errors after it has ended; None while it runs."""
        if self._process.poll() is None:
            return None
        self._errors.seek(0)
        return self._errors.read().strip().partition('\n')[0] or 'it has ended'


def show(path: Path, port: int, timeline: str, seconds: float | None) -> None:
    """Open a recording in the viewer at a port; start one that stays if there is none."""
    if not listens(port):
        if not has_display():
            raise ViewerError(
                f'there is no screen for a window, and no viewer at {HOST}:{port}; take --save '
                'FILE.rrd or --screenshot FILE.png, or start one where there is a screen: '
                f'{find_viewer()} --bind {HOST} --port {port}'
            )
        Viewer(port, stays=True).wait()
    _open(_request(partial(_connect, port)), path, timeline, seconds)


def _connect(port: int) -> Any:
    from rerun.experimental import ViewerClient

    return ViewerClient.connect(url_of(port))


def _open(client: Any, path: Path, timeline: str, seconds: float | None) -> None:
    """Open a recording in a viewer, and move the cursor to a time of it [s]."""
    _request(partial(client.open, str(path)))
    _request(lambda: bool(client.get_state().recordings) and not client.get_state().loading)
    if seconds is not None:
        _request(partial(client.set_time, timeline, duration=seconds, play_state='paused'))


def _request(request: Callable[[], Any], viewer: Viewer | None = None) -> Any:
    """Repeat a request to a viewer while it times out or returns False."""
    reason, deadline = None, time.monotonic() + _TIMEOUT
    while reason is None and time.monotonic() < deadline:
        try:
            if (result := request()) is not False:
                return result
        except (RuntimeError, OSError) as error:
            reason = None if isinstance(error, TimeoutError) else str(error)
        time.sleep(_POLL)
        reason = (viewer and viewer.last_words()) or reason
    raise ViewerError(
        f'the viewer does not draw: {reason or "no answer"}; if there is no Vulkan, `apt install '
        'mesa-vulkan-drivers libvulkan1` installs a software renderer'
    )
