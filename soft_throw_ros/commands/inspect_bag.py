# SPDX-License-Identifier: Apache-2.0
"""
Look at a bag in Rerun, or at an MCAP stream on standard input as it comes.

What comes live is shown by this process alone: whoever feeds it waits for neither it nor a viewer,
and it ends soon after its input does, whatever the viewer does.
"""

from __future__ import annotations

import argparse
import contextlib
from functools import partial
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

from soft_throw_ros.commands.output import naming, slow_notice
from soft_throw_ros.commands.rerun_output import (
    check_viewer,
    PORT,
    PROBE_TIME,
    save_recording,
    send_recording,
    WINDOW,
)
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.message import BagError, Message
from soft_throw_ros.recording.timeseries import find_throws, tells_throws, ThrowStart
from soft_throw_ros.recording.viewer import (
    connect,
    free_port,
    go_to,
    has_display,
    is_open,
    listens,
    url_of,
    Viewer,
    ViewerError,
)

if TYPE_CHECKING:
    import rerun as rr
    from soft_throw_ros.recording.rerun_view import Scene

LIVE_PERIOD = 1.0 / 30.0
"""How often what has come is shown. [s]"""

FILE_PERIOD = 0.5
"""The same where nobody looks, and fewer pieces make a smaller file. [s]"""

EXIT_TIME = 0.7
"""After its input, or a signal, the process ends within this time. [s]"""

_BATCH = 5000
"""Messages of a bag that are drawn at once."""

_MOST_WAITING = 20_000
"""Messages that may wait to be shown; then no more are read, and it is for the sender to drop."""

_FINAL_PAUSE = 2e-3
"""Between looks at the input once the end is near. [s]"""


def main(args: list[str] | None = None) -> int:
    """
    Run the command.

    Returns
    -------
    int
        Exit code: 0; 1 if Rerun or its viewer are not there; 2 if there is no such bag, or none of
        a twin; 130 after Ctrl-C while a bag is read.

    """
    arguments = _parse(args)
    os.environ.setdefault('RUST_LOG', 'off')  # Rerun would say in its own words what we say
    try:
        if arguments.bag == '-':
            with _Watchdog(code=0, is_gentle=True) as watchdog:
                _show_stream(arguments, watchdog)
        with _Watchdog(code=130):
            return _show_bag(arguments)
    except ModuleNotFoundError as error:
        if (error.name or '').partition('.')[0] not in ('rerun', 'rerun_bindings', 'pyarrow'):
            raise
        _say("inspect needs Rerun: pip install 'soft_throw_ros[rerun]'")
        return 1
    except ViewerError as error:
        _say(str(error))
        return 1
    except ValueError as error:
        _say(str(error))
        return 2
    except KeyboardInterrupt:
        return 130


def _parse(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    add = parser.add_argument
    add('bag', metavar='BAG', help='a bag, an .mcap file, or - for standard input')
    add('--save', metavar='FILE.rrd', type=Path, help='write a recording of Rerun, show nothing')
    add('--screenshot', metavar='FILE.png', type=Path, help='write a picture, open no window')
    add('--size', metavar='WxH', type=_size, default='1600x1000', help='of it (%(default)s)')
    add('--throw', metavar='N', type=int, help='show this throw (default the last whole one)')
    add(
        '--at', metavar='TIME', type=_time,
        help='show it at this time of the rig since the throw started, in seconds '
        '(default in the contact)',
    )  # fmt: skip
    add(
        '--sink', choices=('viewer', 'serve'), default='viewer',
        help='show it in a viewer, or to viewers that connect (default viewer)',
    )  # fmt: skip
    add('--port', type=_port, default=PORT, help='of either, on 127.0.0.1 (default %(default)s)')
    arguments = parser.parse_args(args)
    if arguments.save and arguments.screenshot:
        parser.error('argument --screenshot: not allowed with argument --save')
    for option in ('screenshot', 'throw', 'at'):
        if arguments.bag == '-' and getattr(arguments, option) is not None:
            parser.error(f'argument --{option}: needs a bag, not a stream')
    for path in (arguments.save, arguments.screenshot):
        if path is not None and not path.absolute().parent.is_dir():
            parser.error(f'{path}: there is no folder {path.parent}')
    return arguments


def _size(text: str) -> str:
    sides = re.fullmatch(r'(\d+)x(\d+)', text)
    if sides is None or not all(200 <= int(side) <= 8000 for side in sides.groups()):
        raise argparse.ArgumentTypeError(
            f'must be as 1600x1000, from 200 to 8000 each way, got {text!r}'
        )
    return text


def _port(text: str) -> int:
    if not text.isdecimal() or not 1024 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f'must be from 1024 to 65535, got {text!r}')
    return int(text)


def _time(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not abs(seconds) <= 1e6:
        raise argparse.ArgumentTypeError(f'must be a number of seconds, got {text!r}')
    return seconds


# bags


def _show_bag(arguments: argparse.Namespace) -> int:
    """Show a bag in one of four ways; return the exit code."""
    from soft_throw_ros.recording import rerun_canvas
    from soft_throw_ros.recording.rerun_view import is_shown, Scene

    with BagReader(arguments.bag) as reader:
        if not any(is_shown(channel.topic, channel.type) for channel in reader.channels):
            topics = ', '.join(channel.topic for channel in reader.channels)
            raise ValueError(f'{reader.path}: nothing in it is of a twin, topics: {topics}')
        throw = _choose_throw(reader, arguments.throw)
        scene = Scene(reader.path.name, is_picture=bool(arguments.screenshot), throw=throw)
        stream = rerun_canvas.new_stream()
        draw = partial(_draw, scene, stream, reader)
        if arguments.save:
            with naming(arguments.save):
                save_recording(stream, arguments.save, draw)
        elif arguments.screenshot:
            with naming(arguments.screenshot), tempfile.TemporaryDirectory() as folder:
                recording = Path(folder) / 'scene.rrd'
                save_recording(stream, recording, draw)
                options = ('--headless', '--window-size', arguments.size, recording)
                with Viewer(free_port(), *options) as viewer:
                    cursor = _cursor(scene, arguments)
                    picture = viewer.photograph(rerun_canvas.THROW_TIME, cursor)
                arguments.screenshot.write_bytes(picture)
        elif arguments.sink == 'serve':
            _serve(stream, arguments.port)
            draw()
            with contextlib.suppress(KeyboardInterrupt):
                while True:
                    signal.pause()
        else:
            _send_bag(stream, scene, reader, arguments)
    return 0


def _choose_throw(reader: BagReader, number: int | None) -> ThrowStart | None:
    """Find the throw to show; None if the bag has none, and none is asked for."""
    topics = [each.topic for each in reader.channels if tells_throws(each.topic, each.type)]
    found = find_throws(reader.messages(topics)) if topics else {}
    throws = next((throws for throws in found.values() if throws), [])  # of the view in front
    chosen = [throw for throw in throws if number in (None, throw.number)]
    if number is not None and not chosen:
        known = f'{throws[0].number} to {throws[-1].number}' if throws else 'none'
        raise ValueError(f'{reader.path}: it has no throw {number}, of throws {known}')
    whole = [throw for throw in chosen if throw.has_field] or chosen
    return whole[-1] if whole else None


def _draw(scene: Scene, stream: rr.RecordingStream, reader: BagReader) -> None:
    """Draw a whole bag, and say what of it could not be read."""
    scene.connect(stream)
    with slow_notice('inspect'):
        messages = reader.messages()
        while batch := list(itertools.islice(messages, _BATCH)):
            scene.show(batch)
        scene.finish(is_waiting=True)
    path = reader.path
    damage = f', {scene.damage}' if scene.damage else ''
    if scene.is_empty:
        raise ValueError(f'{path}: nothing of a twin could be read{damage}')
    if reader.damage:
        _say(f'{reader.damage}; what there is is shown')
    if scene.damaged:
        _say(f'{path}: {scene.damaged} messages are left out{damage}')


def _cursor(scene: Scene, arguments: argparse.Namespace) -> float | None:
    """Return when in the throw the cursor is, in time of the rig; None without a throw. [s]"""
    at: float | None = arguments.at
    return scene.moment if scene.moment is None or at is None else at


def _send_bag(
    stream: rr.RecordingStream, scene: Scene, reader: BagReader, arguments: argparse.Namespace
) -> None:
    """Show a bag in the viewer that is there, or in one that stays, at the throw's time."""
    from soft_throw_ros.recording import rerun_canvas

    check_viewer(arguments.port, '--save FILE.rrd or --screenshot FILE.png')
    send_recording(stream, arguments.port, partial(_draw, scene, stream, reader))
    cursor = _cursor(scene, arguments)
    if cursor is not None:
        recording = f'Recording:{rerun_canvas.APPLICATION}:{stream.get_recording_id()}'
        go_to(arguments.port, recording, rerun_canvas.THROW_TIME, cursor)
    stream.disconnect()


def _serve(stream: rr.RecordingStream, port: int) -> None:
    from soft_throw_ros.recording import rerun_canvas

    if listens(port):
        raise ValueError(f'somebody listens at 127.0.0.1:{port} already; take another --port')
    rerun_canvas.serve_at(stream, port)
    _say(f'to see it: rerun {url_of(port)}')


# streams


def _show_stream(arguments: argparse.Namespace, watchdog: _Watchdog) -> NoReturn:
    """Show what comes; the process ends here, since Rerun might wait for a viewer that hangs."""
    from soft_throw_ros.recording import rerun_canvas
    from soft_throw_ros.recording.rerun_view import Scene

    scene, stream = Scene('live', is_live=True), rerun_canvas.new_stream()
    viewer = None
    if not arguments.save:
        watchdog.watch_pipe(sys.stdin.buffer.fileno())
    if arguments.save or arguments.sink == 'serve':
        if arguments.save:
            with naming(arguments.save):
                rerun_canvas.save_to(stream, arguments.save, is_live=True)
        else:
            _serve(stream, arguments.port)
        scene.connect(stream)
    else:
        viewer = _ViewerConnection(scene, stream, arguments.port)
    inbox = _Inbox(sys.stdin.buffer)
    while not watchdog.is_told_to_end:
        if viewer is not None:
            viewer.check()
        scene.show(inbox.take())
        if inbox.is_over:
            break
        watchdog.wait(FILE_PERIOD if arguments.save else LIVE_PERIOD)
    watchdog.count_down()
    if inbox.error:
        _say(inbox.error)
    scene.finish(is_waiting=False)
    if rerun_canvas.flush(stream, EXIT_TIME):
        stream.disconnect()
    os._exit(2 if inbox.error and scene.is_empty else 0)


class _Inbox:
    """Messages of a stream, read by a thread of their own."""

    def __init__(self, stream: BinaryIO) -> None:
        self.is_over = False
        self.error = ''
        self._stream = stream
        self._messages: queue.Queue[Message | None] = queue.Queue(_MOST_WAITING)
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
            self.error = str(error)
        self._messages.put(None)


class _ViewerConnection:
    """A stream to a viewer that comes and goes."""

    def __init__(self, scene: Scene, stream: rr.RecordingStream, port: int) -> None:
        self._scene = scene
        self._stream = stream
        self._port = port
        self._connection: socket.socket | None = None
        self._next_probe = -math.inf
        if listens(port):
            return
        if has_display():
            threading.Thread(target=self._start, name='viewer', daemon=True).start()
        else:
            _say(f'no viewer at 127.0.0.1:{port} yet; `rerun --bind 127.0.0.1 --port {port}`')

    def _start(self) -> None:
        try:
            Viewer(self._port, *WINDOW, stays=True)
        except ViewerError as error:
            _say(str(error))

    def check(self) -> None:
        """Notice that it has gone or come, and show it what is there already."""
        from soft_throw_ros.recording import rerun_canvas

        if self._connection is not None:
            if is_open(self._connection):
                return
            self._connection.close()
            self._connection = None
            self._scene.connect(None)
            _say(f'the viewer at 127.0.0.1:{self._port} has gone; waiting for one')
        if time.monotonic() < self._next_probe:
            return
        self._next_probe = time.monotonic() + PROBE_TIME
        self._connection = connect(self._port)
        if self._connection is not None:
            rerun_canvas.connect_to(self._stream, self._port)
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
        Whether a signal only sets `is_told_to_end`, and interrupts nothing.

    """

    def __init__(self, *, code: int, is_gentle: bool = False) -> None:
        self.is_told_to_end = False
        self._code = code
        self._is_gentle = is_gentle
        self._is_ending = threading.Event()
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

    def watch_pipe(self, source: int) -> None:
        """Begin to count down when the other end of a pipe is closed."""
        threading.Thread(target=self._await_end, args=(source,), name='input', daemon=True).start()

    def count_down(self) -> None:
        """End the process in bounded time, whatever is still to be done."""
        os.write(self._pipe[1], b'.')

    def wait(self, seconds: float) -> None:
        """Sleep, or only for a moment once the end is near."""
        if self._is_ending.wait(seconds):
            time.sleep(_FINAL_PAUSE)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self.is_told_to_end = True

    def _await_end(self, source: int) -> None:
        poll = select.poll()
        poll.register(source, 0)  # which is told all the same when the other end is closed
        poll.poll()
        self.count_down()

    def _run(self) -> None:
        os.read(self._pipe[0], 1)
        self._is_ending.set()
        if not self._is_closed.wait(EXIT_TIME):
            os._exit(self._code)


def _say(text: str) -> None:
    print(f'inspect: {text}', file=sys.stderr, flush=True)
