# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Stop of a process while it waits.

A process that is stopped or killed while it takes a message from shared memory keeps the lock of
its queue: Fast DDS then blocks all senders for up to ten seconds, and drops their messages
(docs/record.md). A test of anything else must not meet this case by chance.
"""

import os
from pathlib import Path
import signal
import time

_FUTEX = '202'
"""Number of the system call on x86-64. [-]"""

_WAITING = {0, 9}
"""Operations of the system call that wait, FUTEX_WAIT and FUTEX_WAIT_BITSET. [-]"""


def stop(pid: int, timeout: float = 20.0) -> None:
    """Send SIGSTOP at a time at which all threads of the process wait in a system call."""
    deadline = time.monotonic() + timeout
    while True:
        os.kill(pid, signal.SIGSTOP)
        tasks = list(Path(f'/proc/{pid}/task').iterdir())
        while not all(_is_stopped(task) for task in tasks):
            time.sleep(1e-4)
        if all(_is_waiting(task) for task in tasks):
            return
        assert time.monotonic() < deadline, f'process {pid} never waits'
        os.kill(pid, signal.SIGCONT)
        time.sleep(1e-3)


def _is_stopped(task: Path) -> bool:
    return (task / 'stat').read_text().rpartition(') ')[2].startswith('T')


def _is_waiting(task: Path) -> bool:
    """Return whether a stopped thread is in a system call that waits."""
    call, *arguments = (task / 'syscall').read_text().split()
    if call == _FUTEX:
        return int(arguments[1], 16) & 0x7F in _WAITING
    return call != '-1'
