# SPDX-License-Identifier: Apache-2.0
"""
Look at a bag in Rerun, or at an MCAP stream on standard input as it comes.

What comes live is shown by this process alone: whoever feeds it waits for neither it nor a viewer,
and it ends soon after its input does, whatever the viewer does.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
import contextlib
import itertools
import math
import os
from pathlib import Path
import queue
import re
import select
import signal
import socket
import sys
import tempfile
import threading
import time
from types import FrameType
from typing import Any, BinaryIO, NoReturn, TYPE_CHECKING

import numpy as np
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.travelling_wave import first_releases
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.digest import Floats, is_shown
from soft_throw_ros.recording.message import BagError, Message
from soft_throw_ros.recording.viewer import (
    connect,
    has_display,
    is_open,
    listens,
    Viewer,
    ViewerError,
)

if TYPE_CHECKING:
    from soft_throw_ros.recording import rerun_scene

PERIOD = 1.0 / 30.0
"""How often what has come is shown. [s]"""

FILE_PERIOD = 0.5
"""The same where nobody looks, and fewer pieces make a smaller file. [s]"""

PROBE_TIME = 1.0
"""How often it is looked for a viewer. [s]"""

EXIT_TIME = 0.7
"""After its input, or a signal, the process ends within this time. [s]"""

PATIENCE = 3.0
"""After this it is said why it takes so long. [s]"""

_BATCH = 5000
"""Messages of a bag that are drawn at once."""

_WAITING = 20_000
"""Messages that may wait to be shown; then no more are read, and it is for the sender to drop."""

_BREATH = 2e-3  # [s]

_INSTALL = "inspect needs Rerun: pip install 'soft_throw_ros[rerun]'"


class InspectError(Exception):
    """It cannot be done; the message says why, and `code` is the exit code."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


def main(args: list[str] | None = None) -> int:
    """
    Run the command.

    Parameters
    ----------
    args : list of str, optional
        Its arguments; those of the process by default.

    Returns
    -------
    int
        Exit code: 0; 1 if Rerun or its viewer are not there; 2 if there is no such bag, or none of
        a twin; 130 after Ctrl-C while a bag is read.

    Raises
    ------
    SystemExit
        With exit code 2 if an argument is refused, after a line that says which.

    """
    arguments = _parse(args)
    os.environ.setdefault('RUST_LOG', 'off')  # Rerun would say in its own words what we say
    try:
        if arguments.bag == '-':
            with _Watchdog(code=0, is_gentle=True) as watchdog:
                _show_stream(_import_scene(), arguments, watchdog)
        with _Watchdog(code=130):
            return _show_bag(_import_scene(), arguments)
    except InspectError as error:
        _say(str(error))
        return error.code
    except KeyboardInterrupt:
        return 130


def _parse(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument('bag', metavar='BAG', help='a bag, an .mcap file, or - for standard input')
    parser.add_argument(
        '--save', metavar='FILE.rrd', type=Path, help='write a recording of Rerun, show nothing'
    )
    parser.add_argument(
        '--screenshot', metavar='FILE.png', type=Path, help='write a picture, open no window'
    )
    parser.add_argument(
        '--size', metavar='WxH', type=_size, default=(1600, 1000), help='of it (default 1600x1000)'
    )
    parser.add_argument(
        '--sink',
        choices=('viewer', 'serve'),
        default='viewer',
        help='show it in a viewer, or to viewers that connect (default viewer)',
    )
    parser.add_argument(
        '--port', type=_port, default=9876, help='of either, on 127.0.0.1 (default 9876)'
    )
    arguments = parser.parse_args(args)
    if arguments.save and arguments.screenshot:
        parser.error('argument --screenshot: not allowed with argument --save')
    if arguments.bag == '-' and arguments.screenshot:
        parser.error('argument --screenshot: needs a bag, not a stream')
    for path in (arguments.save, arguments.screenshot):
        if path is not None and not path.absolute().parent.is_dir():
            parser.error(f'{path}: there is no folder {path.parent}')
    return arguments


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r'(\d+)x(\d+)', text)
    if match is None:
        raise argparse.ArgumentTypeError(f'must be as 1600x1000, got {text!r}')
    width, height = map(int, match.groups())
    if not (200 <= width <= 8000 and 200 <= height <= 8000):
        raise argparse.ArgumentTypeError(f'must be from 200 to 8000 each way, got {text!r}')
    return width, height


def _port(text: str) -> int:
    if not text.isdecimal() or not 1024 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f'must be from 1024 to 65535, got {text!r}')
    return int(text)


def _import_scene() -> Any:
    """Import what needs Rerun, or say how to get it."""
    try:
        from soft_throw_ros.recording import rerun_scene
    except ModuleNotFoundError as error:
        if (error.name or '').partition('.')[0] not in ('rerun', 'rerun_bindings', 'pyarrow'):
            raise
        raise InspectError(_INSTALL, 1) from None
    return rerun_scene


def energy_transfer(rig: Rig, thickness: Floats, wave_speed: Floats) -> Floats:
    """
    Compute alpha of a rig with other layers, without loss.

    Parameters
    ----------
    rig : Rig
        All but thickness and wave speed of the layer stay.
    thickness, wave_speed : ndarray
        Broadcast against each other. [m], [m/s]

    Returns
    -------
    ndarray
        NaN where it cannot be told, or the projectile does not leave. [-]

    """
    layer_mass = rig.layer.density * rig.layer.section * thickness
    releases = first_releases(
        mass_ratio=rig.projectile.mass / layer_mass,
        speed_ratio=wave_speed / (thickness * rig.engine.frequency),
        damping_ratio=rig.engine.damping_ratio,
        gravity_ratio=rig.gravity_ratio,
        unresolved='nan',
    )
    return np.asarray(releases.energy_transfer)


def _show_bag(module: Any, arguments: argparse.Namespace) -> int:
    try:
        with BagReader(arguments.bag) as reader:
            _check_bag(reader)
            with ThreadPoolExecutor(1) as pool:
                use = 'picture' if arguments.screenshot else 'bag'
                name = reader.path.name
                scene = module.Scene(energy_transfer, pool, name=name, use=use)
                return _BagShow(module, scene, reader, arguments).run()
    except BagError as error:
        raise InspectError(str(error), 2) from None
    except ViewerError as error:
        raise InspectError(str(error), 1) from None


def _check_bag(reader: BagReader) -> None:
    if not any(is_shown(channel.topic, channel.type) for channel in reader.channels):
        topics = ', '.join(channel.topic for channel in reader.channels)
        raise InspectError(f'{reader.path}: nothing in it is of a twin, topics: {topics}', 2)


class _BagShow:
    """A bag, and where it is shown."""

    def __init__(
        self,
        module: Any,
        scene: rerun_scene.Scene,
        reader: BagReader,
        arguments: argparse.Namespace,
    ) -> None:
        self._module = module
        self._scene = scene
        self._reader = reader
        self._arguments = arguments
        self._stream = module.new_stream()

    def run(self) -> int:
        """Show it; return the exit code."""
        arguments = self._arguments
        if arguments.save:
            self._save(arguments.save)
        elif arguments.screenshot:
            with tempfile.TemporaryDirectory() as folder:
                recording = Path(folder) / 'scene.rrd'
                self._save(recording)
                picture = self._module.photograph(
                    recording, size=arguments.size, moment=self._scene.moment
                )
            _write(arguments.screenshot, picture)
        elif arguments.sink == 'serve':
            _serve(self._module, self._stream, arguments.port)
            self._draw()
            with contextlib.suppress(KeyboardInterrupt):
                while True:
                    signal.pause()
        else:
            self._show(arguments.port)
        return 0

    def _save(self, path: Path) -> None:
        _save(self._module, self._stream, path, is_live=False)
        self._draw()
        is_written = self._module.flush(self._stream, math.inf)
        self._stream.disconnect()
        if not is_written:
            raise InspectError(f'{path}: it could not be written', 2)

    def _show(self, port: int) -> None:
        """Show it in the viewer that is there, or in one that stays."""
        if not listens(port):
            if not has_display():
                raise InspectError(
                    'there is no screen for a window; use --save FILE.rrd or --screenshot '
                    f'FILE.png, or start a viewer that listens at 127.0.0.1:{port}',
                    1,
                )
            Viewer(port, '--hide-welcome-screen', '--expect-data-soon')
        connection = connect(port)
        if connection is None:
            raise InspectError(f'nobody listens at 127.0.0.1:{port} any more', 1)
        with connection:
            self._module.connect_to(self._stream, port)
            self._draw()
            while not self._module.flush(self._stream, PROBE_TIME):
                if not is_open(connection):
                    raise InspectError('the viewer was closed before it had everything', 1)
        if self._scene.moment is not None:
            self._module.go_to(self._stream, port, self._scene.moment)
        self._stream.disconnect()

    def _draw(self) -> None:
        """Draw the whole bag, and say what of it could not be read."""
        scene, path = self._scene, self._reader.path
        scene.connect(self._stream)
        with _notice():
            for batch in _batches(self._reader.messages()):
                scene.show(batch)
            scene.finish(is_waiting=True)
        if scene.is_empty:
            raise InspectError(f'{path}: nothing of a twin could be read{_damage(scene)}', 2)
        if self._reader.damage:
            _say(f'{self._reader.damage}; what there is is shown')
        if scene.digest.damaged:
            _say(f'{path}: {scene.digest.damaged} messages are left out{_damage(scene)}')


def _batches(messages: Iterator[Message]) -> Iterator[list[Message]]:
    while batch := list(itertools.islice(messages, _BATCH)):
        yield batch


def _damage(scene: rerun_scene.Scene) -> str:
    return f', {scene.digest.damage}' if scene.digest.damage else ''


def _save(module: Any, stream: Any, path: Path, *, is_live: bool) -> None:
    try:
        module.save_to(stream, path, is_live=is_live)
    except OSError as error:
        raise InspectError(f'{path}: {error}', 2) from None


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise InspectError(f'{path}: {error.strerror}', 2) from None


def _serve(module: Any, stream: Any, port: int) -> None:
    if listens(port):
        raise InspectError(f'somebody listens at 127.0.0.1:{port} already; take another --port', 2)
    module.serve_at(stream, port)
    _say(f'to see it: rerun rerun+http://127.0.0.1:{port}/proxy')


def _show_stream(module: Any, arguments: argparse.Namespace, watchdog: _Watchdog) -> NoReturn:
    """Show what comes; the process ends here, since Rerun might wait for a viewer that hangs."""
    pool = ThreadPoolExecutor(1)
    scene = module.Scene(energy_transfer, pool, name='live', use='live')
    stream = module.new_stream()
    viewer = None
    if arguments.save:
        _save(module, stream, arguments.save, is_live=True)
        scene.connect(stream)
    else:
        watchdog.follow(sys.stdin.buffer.fileno())
        if arguments.sink == 'serve':
            _serve(module, stream, arguments.port)
            scene.connect(stream)
        else:
            viewer = _Viewer(module, scene, stream, arguments.port)
    inbox = _Inbox(sys.stdin.buffer)
    while not watchdog.is_told_to_end:
        if viewer is not None:
            viewer.check()
        scene.show(inbox.take())
        if inbox.is_over:
            break
        watchdog.wait(FILE_PERIOD if arguments.save else PERIOD)
    watchdog.count_down()
    if inbox.trouble:
        _say(inbox.trouble)
    scene.finish(is_waiting=False)
    if module.flush(stream, EXIT_TIME):
        stream.disconnect()
    os._exit(2 if inbox.trouble and scene.is_empty else 0)


class _Inbox:
    """Messages of a stream, read by a thread of their own."""

    def __init__(self, stream: BinaryIO) -> None:
        self.is_over = False
        self.trouble = ''
        self._stream = stream
        self._messages: queue.Queue[Message | None] = queue.Queue(_WAITING)
        threading.Thread(target=self._run, name='reader', daemon=True).start()

    def take(self) -> list[Message]:
        """Return what has come."""
        messages = []
        for _ in range(self._messages.qsize()):
            message = self._messages.get()
            if message is None:
                self.is_over = True
            else:
                messages.append(message)
        return messages

    def _run(self) -> None:
        try:
            for item in read_stream(self._stream, 'standard input'):
                if isinstance(item, Message):
                    self._messages.put(item)
        except BagError as error:
            self.trouble = str(error)
        self._messages.put(None)


class _Viewer:
    """A viewer that comes and goes."""

    def __init__(self, module: Any, scene: rerun_scene.Scene, stream: Any, port: int) -> None:
        self._module = module
        self._scene = scene
        self._stream = stream
        self._port = port
        self._connection: socket.socket | None = None
        self._next_time = -1.0
        if listens(port):
            return
        if has_display():
            threading.Thread(target=self._start, name='viewer', daemon=True).start()
        else:
            _say(f'no viewer at 127.0.0.1:{port} yet; `rerun --bind 127.0.0.1 --port {port}`')

    def _start(self) -> None:
        try:
            Viewer(self._port, '--hide-welcome-screen', '--expect-data-soon')
        except ViewerError as error:
            _say(str(error))

    def check(self) -> None:
        """Notice that it has gone or come, and show it what is there already."""
        if self._connection is not None:
            if is_open(self._connection):
                return
            self._connection.close()
            self._connection = None
            self._scene.connect(None)
            _say(f'the viewer at 127.0.0.1:{self._port} has gone; waiting for one')
        if time.monotonic() < self._next_time:
            return
        self._next_time = time.monotonic() + PROBE_TIME
        self._connection = connect(self._port)
        if self._connection is not None:
            self._module.connect_to(self._stream, self._port)
            self._scene.connect(self._stream)
            _say(f'connected to the viewer at 127.0.0.1:{self._port}')


class _Watchdog:
    """
    Ends the process in bounded time after a signal, or after the end of a pipe.

    A call of Rerun may wait for ever for a viewer that hangs, and no signal handler of Python runs
    until it returns. So the signal is written to a pipe as soon as it comes, and that is what a
    thread of its own waits for, which Rerun does not hold up.

    Parameters
    ----------
    code : int
        Exit code if it comes to that.
    is_gentle : bool
        Whether a signal does not interrupt what is being done.

    Attributes
    ----------
    is_told_to_end : bool
        Whether a signal has come that did not.

    """

    def __init__(self, *, code: int, is_gentle: bool = False) -> None:
        self.is_told_to_end = False
        self._code = code
        self._is_gentle = is_gentle
        self._has_ended = threading.Event()
        self._is_closed = threading.Event()

    def __enter__(self) -> _Watchdog:
        self._pipe = os.pipe()
        os.set_blocking(self._pipe[1], False)
        handler: Any = self._on_signal if self._is_gentle else signal.default_int_handler
        self._handlers = {
            number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)
        }
        self._wakeup = signal.set_wakeup_fd(self._pipe[1], warn_on_full_buffer=False)
        self._thread = threading.Thread(target=self._run, name='watchdog', daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(self._wakeup)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._is_closed.set()
        self.count_down()
        self._thread.join()
        for end in self._pipe:
            os.close(end)

    def follow(self, source: int) -> None:
        """Begin to count down when the other end of a pipe is closed."""
        threading.Thread(target=self._follow, args=(source,), name='follow', daemon=True).start()

    def count_down(self) -> None:
        """End the process in bounded time, whatever is still to be done."""
        os.write(self._pipe[1], b'.')

    def wait(self, seconds: float) -> None:
        """Sleep, or only take breath once the end is near."""
        if self._has_ended.wait(seconds):
            time.sleep(_BREATH)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.is_told_to_end = True

    def _follow(self, source: int) -> None:
        poll = select.poll()
        poll.register(source, 0)  # which is told all the same when the other end is closed
        poll.poll()
        self.count_down()

    def _run(self) -> None:
        os.read(self._pipe[0], 1)
        self._has_ended.set()
        if not self._is_closed.wait(EXIT_TIME):
            os._exit(self._code)


@contextlib.contextmanager
def _notice() -> Iterator[None]:
    """Say why it takes so long if it does."""
    text = 'reading; for the first time this takes half a minute longer, for compiling'
    notice = threading.Timer(PATIENCE, _say, (text,))
    notice.daemon = True
    notice.start()
    try:
        yield
    finally:
        notice.cancel()


def _say(text: str) -> None:
    print(f'inspect: {text}', file=sys.stderr, flush=True)
