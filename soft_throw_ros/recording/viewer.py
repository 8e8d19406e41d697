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
"""The viewer of Rerun: found, started on this machine only, watched, and told what to show."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from functools import partial
from importlib import util
import os
from pathlib import Path
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from typing import NoReturn, TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient, ViewerState

Answer = TypeVar('Answer')

HOST = '127.0.0.1'

START_TIME = 20.0
"""Longest wait for a viewer to listen. [s]"""

_ANSWER_TIME = 60.0
"""Longest wait for it to load a recording, or to draw. [s]"""

_END_TIME = 5.0
"""Longest wait for a viewer that no longer answers to end. [s]"""

_POLL = 0.05  # [s]

_FRAME_PAUSE = 0.25
"""Between pictures that are compared. [s]"""

_MOST_PICTURES = 40

_CONNECT_TIME = 0.2  # [s]

_MEMORY = ('--memory-limit', '2GB', '--server-memory-limit', '256MB')

_NO_GRAPHICS = ('render context', 'adapter')
"""In what a viewer says last if it finds no Vulkan."""

_CLIENT_ERRORS = (RuntimeError, OSError)
"""Of a viewer that is gone, or too slow: OSError is ConnectionError and TimeoutError."""

_END_WITH_PARENT = (
    'import ctypes, os, sys; '
    'ctypes.CDLL(None).prctl(1, 9, 0, 0, 0); '  # PR_SET_PDEATHSIG, SIGKILL
    'os.getppid() == int(sys.argv[1]) and os.execv(sys.argv[2], sys.argv[2:])'
)
"""What becomes the program, and is killed by the kernel however its parent ends."""


class ViewerError(RuntimeError):
    """The viewer cannot be used; the message says why, and what would help."""


class NoGraphicsError(ViewerError):
    """The viewer finds nothing to draw with, which a machine without Vulkan lacks."""


def find_viewer() -> Path:
    """Return the program: that of `rerun-sdk`, or one on the PATH; ViewerError if none is."""
    package = util.find_spec('rerun_cli')
    if package is not None and package.origin is not None:
        path = Path(package.origin).with_name('rerun')
        if path.exists():
            return path
    found = shutil.which('rerun', path=f'{Path(sys.executable).parent}:{os.environ.get("PATH")}')
    if found is None:
        raise ViewerError("no program rerun is on the PATH; pip install 'soft_throw_ros[rerun]'")
    return Path(found)


def has_display() -> bool:
    """Tell whether a window could be opened."""
    return any(os.environ.get(name) for name in ('WAYLAND_DISPLAY', 'WAYLAND_SOCKET', 'DISPLAY'))


def url_of(port: int) -> str:
    """Return where a viewer that listens on a port is found."""
    return f'rerun+http://{HOST}:{port}/proxy'


def connect(port: int) -> socket.socket | None:
    """Return a connection to whoever listens on a port, which ends when that does; or None."""
    try:
        connection = socket.create_connection((HOST, port), _CONNECT_TIME)
    except OSError:
        return None
    connection.setblocking(False)
    return connection


def is_open(connection: socket.socket) -> bool:
    """Tell whether the other end is still there."""
    try:
        return bool(connection.recv(4096))
    except BlockingIOError:
        return True
    except OSError:
        return False


def listens(port: int) -> bool:
    """Tell whether somebody listens on a port."""
    with connect(port) or contextlib.nullcontext() as connection:
        return connection is not None


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


class Viewer:
    """
    A viewer, in a session of its own.

    It is bound to this machine, has limits on its memory, and sends no statistics to anybody.

    Parameters
    ----------
    port : int
        Where it is to listen.
    *options : str or path_like
        Of the program.
    stays : bool
        Whether it is there for a user, and stays when this process ends.

    Raises
    ------
    ViewerError
        If it ends by itself, or takes longer than `START_TIME` to listen.

    """

    def __init__(self, port: int, *options: str | Path, stays: bool = False) -> None:
        command = [find_viewer(), '--bind', HOST, '--port', str(port), *_MEMORY, *options]
        if not stays:
            parent = str(os.getpid())
            command = [sys.executable, '-I', '-S', '-c', _END_WITH_PARENT, parent, *command]
        self.port = port
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115
        # with CI Rerun sends no statistics to its makers; of notices it makes some in the window
        environment = {'RUST_LOG': 'error', **os.environ, 'CI': '1'}
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,
            env=environment,
        )
        deadline = time.monotonic() + START_TIME
        while not listens(port):
            self.check()
            if time.monotonic() > deadline:
                self.end()
                raise ViewerError(f'the viewer has not answered within {START_TIME:g} s')
            time.sleep(_POLL)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    @property
    def pid(self) -> int:
        """Return the number of the process, and of its group."""
        return self._process.pid

    def check(self) -> None:
        """Raise ViewerError if it has ended."""
        if self._process.poll() is not None:
            self._raise_reason()

    def client(self) -> ViewerClient:
        """Return a client, once it has drawn something; NoGraphicsError if it has nothing to."""
        from rerun.experimental import ViewerClient

        with self._explained_errors():
            client = ViewerClient.connect(url_of(self.port))
            # it answers other questions before it draws
            _ask(partial(client.take_screenshot, max_size=64))
        return client

    def photograph(self, timeline: str, seconds: float | None) -> bytes:
        """Return what it shows at a time of a timeline, as PNG; ViewerError if it cannot [s]."""
        client = self.client()
        with self._explained_errors():
            _ask(client.get_state, _has_loaded)
            if seconds is not None:
                client.set_time(timeline, duration=seconds, play_state='paused')
            picture = b''
            for _ in range(_MOST_PICTURES):  # until nothing moves any more, as axes do for a while
                before, picture = picture, _ask(client.take_screenshot)
                if picture == before:
                    break
                time.sleep(_FRAME_PAUSE)
            return picture

    def end(self) -> None:
        """End it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._errors.close()

    @contextlib.contextmanager
    def _explained_errors(self) -> Iterator[None]:
        """Raise ViewerError for errors of its client, with the reason if the viewer gives one."""
        try:
            yield
        except _CLIENT_ERRORS as error:
            # without graphics it closes its connections a moment before it ends
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_END_TIME)
                self._raise_reason()
            raise ViewerError(f'the viewer does not draw: {error}') from None

    def _raise_reason(self) -> NoReturn:
        """Raise ViewerError for a viewer that has ended, from what it said last."""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors='replace').strip().splitlines()
        self.end()
        if any(word in line for line in lines for word in _NO_GRAPHICS):
            raise NoGraphicsError(
                'the viewer finds no graphics; on Debian and Ubuntu `apt install '
                'mesa-vulkan-drivers libvulkan1` brings what it needs'
            )
        raise ViewerError(f'the viewer has ended: {lines[0] if lines else "it does not say why"}')


def go_to(port: int, recording: str, timeline: str, seconds: float | None) -> None:
    """Have a viewer show a time of a recording that was sent to it, if it can do that [s]."""
    from rerun.experimental import ViewerClient

    if seconds is None:
        return
    with contextlib.suppress(*_CLIENT_ERRORS):
        client = ViewerClient.connect(url_of(port))
        _ask(
            client.get_state,
            lambda state: any(each.store_id == recording for each in state.recordings),
        )
        client.set_time(timeline, duration=seconds, play_state='paused', recording=recording)


def _has_loaded(state: ViewerState) -> bool:
    return bool(state.recordings and state.views and not state.loading)


def _ask(
    question: Callable[[], Answer], is_enough: Callable[[Answer], bool] = lambda _: True
) -> Answer:
    """Ask a viewer until it answers what is enough; on a busy machine it may miss a deadline."""
    deadline = time.monotonic() + _ANSWER_TIME
    while True:
        try:
            answer = question()
            if is_enough(answer):
                return answer
        except TimeoutError:
            pass
        if time.monotonic() > deadline:
            raise TimeoutError(f'not within {_ANSWER_TIME:g} s')
        time.sleep(_FRAME_PAUSE)
