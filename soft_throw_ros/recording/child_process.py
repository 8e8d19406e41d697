# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive this one."""

from __future__ import annotations

from collections.abc import Sequence
import os
import sys

_BIND_TO_PARENT = (
    'import ctypes, os, sys; '
    'ctypes.CDLL(None).prctl(1, 9, 0, 0, 0); '  # PR_SET_PDEATHSIG, SIGKILL
    'os.getppid() == int(sys.argv[1]) and os.execv(sys.argv[2], sys.argv[2:])'
)


def bound_to_parent(command: Sequence[str]) -> list[str]:
    """
    Return a command that starts another one, which Linux kills however this process ends.

    The main thread must start it, since Linux watches the thread that starts a process.
    """
    return [sys.executable, '-I', '-S', '-c', _BIND_TO_PARENT, str(os.getpid()), *command]
