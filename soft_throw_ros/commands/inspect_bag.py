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
"""
Look at a bag in Rerun, or at an MCAP stream on standard input as it comes.

What comes live is shown by this process alone: whoever feeds it waits for neither it nor a viewer,
and it ends soon after its input does, whatever the viewer does.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
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
from typing import NoReturn, TYPE_CHECKING

from soft_throw_ros.commands import rerun_output as output
from soft_throw_ros.commands.options import new_file, number_or_text
from soft_throw_ros.commands.output import naming, slow_notice
from soft_throw_ros.recording import viewer
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.message import BagError, Message
from soft_throw_ros.recording.timeseries import find_throws, tells_throws, ThrowStart

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
            _show_stream(arguments)
        with _ended_by_signals():
            _show_bag(arguments)
    except ModuleNotFoundError as error:
        if (error.name or '').partition('.')[0] not in ('rerun', 'rerun_bindings', 'pyarrow'):
            raise
        _say("inspect needs Rerun: pip install 'soft_throw_ros[rerun]'")
        return 1
    except viewer.ViewerError as error:
        _say(str(error))
        return 1
    except ValueError as error:
        _say(str(error))
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def _parse(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    add = parser.add_argument
    add('bag', metavar='BAG', help='a bag, an .mcap file, or - for standard input')
    files = parser.add_mutually_exclusive_group()
    files.add_argument(
        '--save', metavar='FILE.rrd', type=new_file(),
        help='write a recording of Rerun, show nothing',
    )
    files.add_argument(
        '--screenshot', metavar='FILE.png', type=new_file(),
        help='write a picture, open no window',
    )
    add('--size', metavar='WxH', type=_size, default='1600x1000', help='of it (%(default)s)')
    add('--throw', metavar='N', type=int, help='show this throw (default the last whole one)')
    add(
        '--at', metavar='TIME', type=_time,
        help='show it at this time of the rig since the throw started, in seconds '
        '(default in the contact)',
    )
    add(
        '--sink', choices=('viewer', 'serve'), default='viewer',
        help='show it in a viewer, or to viewers that connect (default viewer)',
    )
    add('--port', type=_port, default=output.PORT, help='of either, here (default %(default)s)')
    arguments = parser.parse_args(args)
    for option in ('screenshot', 'throw', 'at'):
        if arguments.bag == '-' and getattr(arguments, option) is not None:
            parser.error(f'argument --{option}: needs a bag, not a stream')
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
    seconds = number_or_text(text)
    if not isinstance(seconds, float) or not abs(seconds) <= 1e6:
        raise argparse.ArgumentTypeError(f'must be a number of seconds, got {text!r}')
    return seconds


# bags


def _show_bag(arguments: argparse.Namespace) -> None:
    """Show a bag in one of four ways."""
    from soft_throw_ros.recording.rerun_view import is_shown, Scene

    with BagReader(arguments.bag) as reader:
        if not any(is_shown(channel.topic, channel.type) for channel in reader.channels):
            topics = ', '.join(channel.topic for channel in reader.channels)
            raise ValueError(f'{reader.path}: nothing in it is of a twin, topics: {topics}')
        throw = _choose_throw(reader, arguments.throw)
        scene = Scene(reader.path.name, is_picture=bool(arguments.screenshot), throw=throw)
        stream = output.new_stream()
        draw = partial(_draw, scene, stream, reader)
        if arguments.save:
            with naming(arguments.save):
                output.save_recording(stream, arguments.save, draw)
        elif arguments.screenshot:
            with naming(arguments.screenshot), tempfile.TemporaryDirectory() as folder:
                recording = Path(folder) / 'scene.rrd'
                output.save_recording(stream, recording, draw)
                cursor = _cursor(scene, arguments.at)
                options = ('--headless', '--window-size', arguments.size, recording)
                with viewer.Viewer(viewer.free_port(), *options) as process:
                    picture = process.photograph(*cursor)
                arguments.screenshot.write_bytes(picture)
        elif arguments.sink == 'serve':
            _serve(stream, arguments.port)
            draw()
            with contextlib.suppress(KeyboardInterrupt):
                while True:
                    signal.pause()
        else:
            output.check_viewer(arguments.port, '--save FILE.rrd or --screenshot FILE.png')
            output.send_recording(stream, arguments.port, draw)
            viewer.go_to(arguments.port, output.store_of(stream), *_cursor(scene, arguments.at))
            stream.disconnect()


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
    path, damage = reader.path, f', {scene.damage}' if scene.damage else ''
    if scene.is_empty:
        raise ValueError(f'{path}: nothing of a twin could be read{damage}')
    if reader.damage:
        _say(f'{reader.damage}; what there is is shown')
    if scene.damaged:
        _say(f'{path}: {scene.damaged} messages are left out{damage}')


def _cursor(scene: Scene, at: float | None) -> tuple[str, float | None]:
    """Return timeline and time of the cursor, which is None without a throw [s]."""
    from soft_throw_ros.recording.rerun_canvas import THROW_TIME

    low, high = scene.span
    if at is not None and scene.moment is None:
        raise ValueError(f'--at is a time since a throw started, and the bag has none, got {at:g}')
    if at is not None and not low <= at <= high:
        raise ValueError(
            f'--at must be within what was recorded, from {low:.6g} to {high:.6g} s since the '
            f'throw started, got {at:g}'
        )
    return THROW_TIME, scene.moment if at is None else at


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """
    Interrupt by a signal, and end the process soon after it, whatever that waits for.

    A call of Rerun may wait for ever for a viewer that hangs, and no signal handler of Python runs
    until it returns. So the signal is written to a pipe as soon as it comes, for a thread that
    Rerun does not hold up.

    """
    source, target = os.pipe()
    os.set_blocking(target, False)
    handlers = {
        number: signal.signal(number, signal.default_int_handler)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    wakeup = signal.set_wakeup_fd(target, warn_on_full_buffer=False)

    def watch() -> None:
        with os.fdopen(source, 'rb', 0) as pipe:
            if pipe.read(1):
                time.sleep(EXIT_TIME)
                os._exit(130)

    threading.Thread(target=watch, name='watchdog', daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.close(target)


# streams


def _show_stream(arguments: argparse.Namespace) -> NoReturn:
    """
    Show what comes until input or a signal ends it; the process ends here.

    Another thread draws, since Rerun might wait for a viewer that hangs; this one reads, and hears
    signals.

    """
    from soft_throw_ros.recording.rerun_view import Scene

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    scene, stream = Scene('live', is_live=True), output.new_stream()
    connection = None
    if arguments.save:
        with naming(arguments.save):
            output.save_to(stream, arguments.save, is_live=True)
    elif arguments.sink == 'serve':
        _serve(stream, arguments.port)
    else:
        connection = _ViewerConnection(scene, stream, arguments.port)
    if connection is None:
        scene.connect(stream)
    inbox: queue.Queue[Message] = queue.Queue(_MOST_WAITING)
    is_over = threading.Event()

    def draw() -> None:
        is_last = False
        while not is_last:
            is_last = is_over.wait(FILE_PERIOD if arguments.save else LIVE_PERIOD)
            if connection is not None:
                connection.check()
            scene.show([inbox.get() for _ in range(inbox.qsize())])
        scene.finish(is_waiting=False)
        if output.flush(stream, EXIT_TIME):
            stream.disconnect()

    thread = threading.Thread(target=draw, name='drawing', daemon=True)
    thread.start()
    code, time_left = 0, None if arguments.save else EXIT_TIME  # a file takes all that has come
    try:
        for item in read_stream(sys.stdin.buffer, 'standard input'):
            if isinstance(item, Message):
                _hand_over(item, inbox)
    except BagError as error:
        _say(str(error))
        code = 2
    except KeyboardInterrupt:
        time_left = EXIT_TIME
    is_over.set()
    with contextlib.suppress(KeyboardInterrupt):  # one is enough
        thread.join(time_left)
    os._exit(code if scene.is_empty else 0)


def _hand_over(message: Message, inbox: queue.Queue[Message]) -> None:
    """Wait until a message can be shown, but no longer than there is somebody who sends more."""
    while True:
        try:
            return inbox.put(message, timeout=EXIT_TIME)
        except queue.Full:
            sender = select.poll()
            sender.register(sys.stdin.buffer.fileno(), 0)  # which tells when it is closed
            if sender.poll(0):
                raise KeyboardInterrupt from None


class _ViewerConnection:
    """A stream to a viewer that comes and goes."""

    def __init__(self, scene: Scene, stream: rr.RecordingStream, port: int) -> None:
        self._scene = scene
        self._stream = stream
        self._port = port
        self._connection: socket.socket | None = None
        self._next_probe = -math.inf
        if viewer.listens(port):
            return
        if viewer.has_display():
            threading.Thread(target=self._start, name='viewer', daemon=True).start()
        else:
            _say(output.no_screen(port, '--save FILE.rrd (rerun.sink:=file of a recorder)'))

    def _start(self) -> None:
        try:
            viewer.Viewer(self._port, *output.WINDOW, stays=True)
        except viewer.ViewerError as error:
            _say(str(error))

    def check(self) -> None:
        """Notice that it has gone or come, and show it what is there already."""
        if self._connection is not None:
            if viewer.is_open(self._connection):
                return
            self._connection.close()
            self._connection = None
            self._scene.connect(None)
            _say(f'the viewer at {viewer.HOST}:{self._port} has gone; waiting for one')
        if time.monotonic() < self._next_probe:
            return
        self._next_probe = time.monotonic() + output.PROBE_TIME
        self._connection = viewer.connect(self._port)
        if self._connection is not None:
            self._stream.connect_grpc(viewer.url_of(self._port))
            self._scene.connect(self._stream)
            _say(f'connected to the viewer at {viewer.HOST}:{self._port}')


def _serve(stream: rr.RecordingStream, port: int) -> None:
    output.serve(stream, port)
    _say(f'to see it: rerun {viewer.url_of(port)}')


def _say(text: str) -> None:
    print(f'inspect: {text}', file=sys.stderr, flush=True)
