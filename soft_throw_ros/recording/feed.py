# SPDX-License-Identifier: Apache-2.0
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
import os
import subprocess
import threading
import time
from typing import NamedTuple

from soft_throw_ros.recording.bag import StreamWriter
from soft_throw_ros.recording.message import Channel, Message

PERIOD = 1.0 / 30.0
"""How often messages are sent. [s]"""

RESTART_TIME = 1.0
"""Wait before a process that has ended is started again. [s]"""

DRAIN_TIME = 0.3
"""How long, in the end, what waits may take to be sent. [s]"""

EXIT_TIME = 1.0
"""How long the process has to end, once its input has. [s]"""

_KEPT = 10
"""How many messages of a latched topic a new process gets, for what went before it."""

_PIPE = 2**20
"""Size of the pipe, where the system allows it. [bytes]"""


class _Block(NamedTuple):
    """A part of the stream; what has no messages is needed by all that follows."""

    data: bytes
    messages: int


class Feed:
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
    trouble : str
        Why it does not run; empty if it does.

    """

    def __init__(self, command: Sequence[str], *, capacity: int = 32 * 2**20) -> None:
        self.dropped = 0
        self.starts = 0
        self.trouble = ''
        self._command = command
        self._capacity = capacity
        self._incoming: deque[Message] = deque()
        self._latched: dict[Channel, deque[Message]] = {}
        self._stream = StreamWriter()
        self._blocks: deque[_Block] = deque()
        self._size = 0
        self._rest = memoryview(b'')  # of the block that is being sent
        self._process: subprocess.Popen[bytes] | None = None
        self._restart = 0.0
        self._is_closing = threading.Event()
        self._thread = threading.Thread(name='feed', target=self._run, daemon=True)
        self._thread.start()

    def put(self, messages: Iterable[Message]) -> None:
        """Have messages shown."""
        self._incoming.extend(messages)

    def close(self) -> None:
        """End the process, within `DRAIN_TIME` and `EXIT_TIME`."""
        self._is_closing.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._is_closing.wait(PERIOD):
            self._begin_if_due()
            self._take()
            self._send()
        self._take()
        deadline = time.monotonic() + DRAIN_TIME
        while self._send() and time.monotonic() < deadline:
            time.sleep(PERIOD)
        if self._process is not None:
            _end(self._process)

    def _begin_if_due(self) -> None:
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
            self.trouble = f'{self._command[0]}: {error.strerror}'
            return
        assert self._process.stdin is not None
        pipe = self._process.stdin.fileno()
        os.set_blocking(pipe, False)
        with contextlib.suppress(OSError):
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE)
        self.starts += 1
        self.trouble = ''
        self._forget()
        self._append(self._stream.start(), 0)
        for messages in self._latched.values():
            self._append(self._stream.block(messages), len(messages))

    def _take(self) -> None:
        """Make a block of what has come."""
        messages = [self._incoming.popleft() for _ in range(len(self._incoming))]
        if not messages:
            return
        for message in messages:
            channel = message.channel
            self._append(self._stream.define(channel), 0)
            if any(qos.durability == 'transient_local' for qos in channel.qos):
                self._latched.setdefault(channel, deque(maxlen=_KEPT)).append(message)
        self._append(self._stream.block(messages), len(messages))
        if self._process is None:
            self._forget()

    def _append(self, data: bytes, messages: int) -> None:
        """Have a block sent, and drop the oldest ones that messages are in if it is too much."""
        if not data:
            return
        self._blocks.append(_Block(data, messages))
        self._size += len(data)
        while self._size > self._capacity:
            oldest = next((block for block in self._blocks if block.messages), None)
            if oldest is None:
                return
            self._blocks.remove(oldest)
            self._size -= len(oldest.data)
            self.dropped += oldest.messages

    def _forget(self) -> None:
        """Drop all that waits."""
        self.dropped += sum(block.messages for block in self._blocks)
        self._blocks.clear()
        self._size = 0
        self._rest = memoryview(b'')

    def _send(self) -> bool:
        """Send what the pipe takes; tell whether something is left."""
        if self._process is None or self._process.stdin is None:
            return False
        pipe = self._process.stdin.fileno()
        try:
            while self._rest or self._blocks:
                if not self._rest:
                    block = self._blocks.popleft()
                    self._size -= len(block.data)
                    self._rest = memoryview(block.data)
                self._rest = self._rest[os.write(pipe, self._rest) :]
        except BlockingIOError:
            return True
        except OSError:
            _end(self._process)
            self.trouble = f'it ended with exit code {self._process.returncode}'
            self._process = None
        return False


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the input of a process, and, if that does not end it, the process."""
    assert process.stdin is not None
    with contextlib.suppress(OSError):
        process.stdin.close()
    try:
        process.wait(EXIT_TIME)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
