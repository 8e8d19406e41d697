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
A watcher that ends all processes started by the tests, however the tests end.

PR_SET_PDEATHSIG would reach only direct children, and would also act when the starting thread
ends. Therefore a watcher process waits for the end of the tests, and then ends all processes that
have inherited the number of the tests in their environment.
"""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import select
import signal
import sys
import time

VARIABLE = 'SOFT_THROW_STARTED_BY_TESTS'
"""Environment variable with the process number of the tests, inherited by their children."""

GRACE_PERIOD = 5.0
"""Time between SIGTERM and SIGKILL. [s]"""


def watch_this_process() -> None:
    """End all processes that this process starts from now on when it ends."""
    own = str(os.getpid())
    if os.environ.get(VARIABLE) == own:
        return
    os.environ[VARIABLE] = own
    os.posix_spawn(
        sys.executable,
        [sys.executable, '-S', '-E', __file__, own],
        {name: value for name, value in os.environ.items() if name != VARIABLE},
        file_actions=[(os.POSIX_SPAWN_OPEN, fd, os.devnull, os.O_RDWR, 0) for fd in range(3)],
        setsid=True,  # Ctrl-C in a terminal must not reach the watcher
    )


def _watch(tests: int) -> None:
    """Wait for the end of the tests, then terminate their processes, and finally kill them."""
    if os.getppid() == tests:
        select.select([os.pidfd_open(tests)], [], [])
    for number in (signal.SIGTERM, signal.SIGKILL):
        deadline = time.monotonic() + GRACE_PERIOD
        while (strays := list(_started_by(tests))) and time.monotonic() < deadline:
            for pid in strays:
                _send(pid, number)
            time.sleep(0.1)


def _started_by(tests: int) -> Iterator[int]:
    mark = f'{VARIABLE}={tests}'.encode()
    for path in Path('/proc').glob('[0-9]*/environ'):
        try:
            if mark in path.read_bytes().split(b'\0'):
                yield int(path.parent.name)
        except OSError:  # already ended, or owned by another user
            continue


def _send(pid: int, number: int) -> None:
    try:
        os.kill(pid, number)
    except OSError:  # already ended
        return


if __name__ == '__main__':
    _watch(int(sys.argv[1]))
