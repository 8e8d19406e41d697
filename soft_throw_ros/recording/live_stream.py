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
Show messages as they come, by another process that reads them as an MCAP stream from a pipe.

Whatever becomes of that process and its viewer, nobody here waits for it: the pipe does not block,
and of what waits for it the oldest goes first.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
import contextlib
import fcntl
from io import BytesIO
import os
import subprocess
import threading
import time

from mcap.writer import IndexType, Writer
from soft_throw_ros.recording.bag_writer import LIBRARY, PROFILE, register_channel
from soft_throw_ros.recording.message import Channel, Message

SEND_PERIOD = 1.0 / 30.0
"""How often messages are sent. [s]"""

RESTART_TIME = 1.0
"""Wait before a process that has ended is started again. [s]"""

DRAIN_TIMEOUT = 0.3
"""How long, in the end, what waits may take to be sent. [s]"""

EXIT_TIMEOUT = 1.0
"""How long the process has to end, once its input has. [s]"""

_LATCHED_DEPTH = 10  # messages of a latched topic that a new process gets, if they went before it

_PIPE_SIZE = 2**20  # where the system allows it [bytes]


class StreamWriter:
    """
    Makes an MCAP stream for a pipe: nothing is compressed, indexed or kept.

    Examples
    --------
    >>> from io import BytesIO
    >>> from soft_throw_ros.recording.bag_reader import read_stream
    >>> channel = Channel(topic='/phase', type='std_msgs/msg/String', schema='string data')
    >>> stream = StreamWriter().write([Message(channel, b'0123', log_time=7, publish_time=7)])
    >>> [message.log_time for message in read_stream(BytesIO(stream))]
    [7]

    """

    def __init__(self) -> None:
        self._ids: dict[Channel, int] = {}
        self._schemas: dict[tuple[str, str, str], int] = {}
        self._output = BytesIO()
        self._writer = Writer(
            self._output,
            index_types=IndexType.NONE,
            repeat_channels=False,
            repeat_schemas=False,
            use_chunking=False,
            use_statistics=False,
            use_summary_offsets=False,
        )
        self._writer.start(PROFILE, LIBRARY)

    def write(self, messages: Iterable[Message]) -> bytes:
        """Return the records of messages, after what a reader needs before these."""
        for channel, data, log_time, publish_time, sequence in messages:
            if channel not in self._ids:
                *_, record = register_channel(self._writer, channel, self._schemas)
                self._ids[channel] = record.id
            self._writer.add_message(
                self._ids[channel], log_time, data, publish_time, sequence & 0xFFFFFFFF
            )
        self._writer.flush()
        stream = self._output.getvalue()
        self._output.seek(0)
        self._output.truncate()
        return stream


class LiveStream:
    """
    A process that shows messages, and is started again if it ends.

    Parameters
    ----------
    command : sequence of str
        What to start; it reads MCAP from its standard input, and ends when that does.
    capacity : int
        How much may wait for it. [bytes]

    Attributes
    ----------
    dropped : int
        How many messages it did not get.
    starts : int
        How often it was started.
    error : str
        Why it does not run; empty if it does.

    """

    def __init__(self, command: Sequence[str], *, capacity: int = 32 * 2**20) -> None:
        self.dropped = 0
        self.starts = 0
        self.error = ''
        self._command = command
        self._capacity = capacity
        self._incoming: deque[Message] = deque()
        self._waiting: deque[Message] = deque()
        self._size = 0  # of these [bytes]
        self._latched: dict[Channel, deque[Message]] = {}
        self._stream = StreamWriter()
        self._rest = memoryview(b'')  # of what is being sent
        self._process: subprocess.Popen[bytes] | None = None
        self._restart = 0.0
        self._is_closing = threading.Event()
        self._thread = threading.Thread(name='live stream', target=self._run, daemon=True)
        self._thread.start()

    def put(self, messages: Iterable[Message]) -> None:
        """Have messages shown."""
        self._incoming.extend(messages)

    def close(self) -> None:
        """End the process, within `DRAIN_TIMEOUT` and `EXIT_TIMEOUT`."""
        self._is_closing.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._is_closing.wait(SEND_PERIOD):
            self._start_if_due()
            self._take_messages()
            self._send()
        self._take_messages()
        deadline = time.monotonic() + DRAIN_TIMEOUT
        while self._send() and time.monotonic() < deadline:
            time.sleep(SEND_PERIOD)
        if self._process is not None:
            _end(self._process)

    def _start_if_due(self) -> None:
        """Start the process if there is none, and begin the stream anew for it."""
        if self._process is not None or time.monotonic() < self._restart:
            return
        self._restart = time.monotonic() + RESTART_TIME
        try:
            # in a session of its own: Ctrl-C is for us, and its end follows from ours
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, start_new_session=True
            )
        except OSError as error:
            self.error = f'{self._command[0]}: {error.strerror}'
            return
        assert self._process.stdin is not None
        pipe = self._process.stdin.fileno()
        os.set_blocking(pipe, False)
        with contextlib.suppress(OSError):
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_SIZE)
        self.starts += 1
        self.error = ''
        self._stream, self._rest = StreamWriter(), memoryview(b'')
        self._drop_beyond(0)
        for messages in self._latched.values():
            self._wait(messages)

    def _take_messages(self) -> None:
        """Take what has come; if it is too much, the oldest that wait are dropped."""
        messages = [self._incoming.popleft() for _ in range(len(self._incoming))]
        for message in messages:
            if message.channel.is_latched:
                kept = self._latched.setdefault(message.channel, deque(maxlen=_LATCHED_DEPTH))
                kept.append(message)
        self._wait(messages)
        self._drop_beyond(0 if self._process is None else self._capacity)

    def _wait(self, messages: Iterable[Message]) -> None:
        for message in messages:
            self._waiting.append(message)
            self._size += len(message.data)

    def _next(self) -> Message:
        message = self._waiting.popleft()
        self._size -= len(message.data)
        return message

    def _drop_beyond(self, size: int) -> None:
        """Drop the oldest that wait, until the rest is not larger than that [bytes]."""
        while self._waiting and (self._size > size or not size):
            self._next()
            self.dropped += 1

    def _send(self) -> bool:
        """Send what the pipe takes; tell whether something is left."""
        if self._process is None or self._process.stdin is None:
            return False
        pipe = self._process.stdin.fileno()
        try:
            while self._rest or self._waiting:
                if not self._rest:
                    end = self._size - _PIPE_SIZE
                    block = [self._next()]
                    while self._waiting and self._size > end:
                        block.append(self._next())
                    self._rest = memoryview(self._stream.write(block))
                self._rest = self._rest[os.write(pipe, self._rest):]
        except BlockingIOError:
            return True
        except OSError:
            _end(self._process)
            self.error = f'it ended with exit code {self._process.returncode}'
            self._process = None
        return False


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the input of a process, and, if that does not end it, the process."""
    assert process.stdin is not None
    with contextlib.suppress(OSError):
        process.stdin.close()
    try:
        process.wait(EXIT_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
