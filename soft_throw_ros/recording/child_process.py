# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive this one."""

from __future__ import annotations

from collections.abc import Sequence
import os
import shutil
import subprocess
import sys

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


class ChildProcess:
    """
    A child process in a session of its own, so that Ctrl-C in a terminal does not reach it.

    The command is a program and its arguments.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._name = command[0]
        self._process: subprocess.Popen[bytes] | None = None
        if program := shutil.which(self._name):
            self._process = subprocess.Popen(
                bound_to_parent([program, *command[1:]]),
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )

    @property
    def error(self) -> str:
        """Why the process does not run; empty while it runs."""
        if self._process is None:
            return f'{self._name}: no such program'
        code = self._process.poll()
        return '' if code is None else f'it ended with exit code {code}'

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
