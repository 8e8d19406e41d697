# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive this one, and that are restarted when they end."""

from __future__ import annotations

from collections.abc import Sequence
import math
import os
import shutil
import subprocess
import sys
import time

RESTART_TIME = 1.0
"""Shortest time from one start of a process to the next; doubles with every failure. [s]"""

STABLE_TIME = 30.0
"""Running time after which the end of a process no longer counts as a failed start. [s]"""

MAX_FAILURES = 5
"""Number of failures in a row after which a process is not started again."""

EXIT_TIMEOUT = 2.0
"""Longest wait for a process to end after SIGTERM. [s]"""

_BIND_TO_PARENT = (
    'import ctypes, os, sys; '
    'ctypes.CDLL(None).prctl(1, 9, 0, 0, 0); '  # PR_SET_PDEATHSIG, SIGKILL
    'os.getppid() == int(sys.argv[1]) and os.execv(sys.argv[2], sys.argv[2:])'
)


def bound_to_parent(command: Sequence[str]) -> list[str]:
    """
    Return a command that starts another one, which Linux kills when this process ends.

    That holds however this process ends. The main thread must start the command, since Linux
    watches the thread that starts a process. A command is a program and its arguments.
    """
    return [sys.executable, '-I', '-S', '-c', _BIND_TO_PARENT, str(os.getpid()), *command]


class RestartedProcess:
    """
    A child process that is started again when it ends.

    The wait before a start doubles with every process that ends soon after its own start. After
    `MAX_FAILURES` such processes in a row, no other process is started. The process has its own
    session, so that Ctrl-C in a terminal does not reach it.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self.starts = 0  # number of successful starts
        self.error = ''  # why it does not run; empty while it runs
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._started = -math.inf
        self._failures = 0  # in a row

    @property
    def failure(self) -> str:
        """Reason why it will not be started any more; empty while it may be."""
        if self._failures < MAX_FAILURES:
            return ''
        return f'{self.error}, {self._failures} times in a row'

    def check(self) -> None:
        """Start the process if that is due; call this function periodically, in one thread."""
        if self._process is not None:
            code = self._process.poll()
            if code is None:
                return
            self._process = None
            self._fail(f'it ended with exit code {code}')
        due = self._started + RESTART_TIME * 2**self._failures
        if self.failure or time.monotonic() < due:
            return
        self._started = time.monotonic()
        program = shutil.which(self._command[0])
        if program is None:
            self._fail(f'{self._command[0]}: no such program')
            return
        command = bound_to_parent([program, *self._command[1:]])
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, start_new_session=True
        )
        self.starts += 1
        self.error = ''

    def terminate(self) -> None:
        """Ask the process to end; `close` waits for the end."""
        if self._process is not None:
            self._process.terminate()

    def close(self) -> None:
        """End the process within `EXIT_TIMEOUT`."""
        if self._process is None:
            return
        self._process.terminate()
        try:
            self._process.wait(EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _fail(self, reason: str) -> None:
        """Count a failure; begin to count anew if the process was stable."""
        if time.monotonic() - self._started > STABLE_TIME:
            self._failures = 0
        self._failures += 1
        self.error = reason
