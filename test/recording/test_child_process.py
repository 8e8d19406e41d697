# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive this one, and that are restarted when they end."""

from __future__ import annotations

from itertools import pairwise
import os
from pathlib import Path
import signal
import subprocess
import sys
from test.recording.conftest import wait_until
import time
from typing import Any

import pytest
from soft_throw_ros.recording import child_process
from soft_throw_ros.recording.child_process import (
    bound_to_parent,
    MAX_FAILURES,
    RestartedProcess,
)


def test_child_of_another_process_does_not_start():
    command = bound_to_parent([sys.executable, '-c', 'print("started")'])
    command[command.index(str(os.getpid()))] = '1'
    assert subprocess.run(command, capture_output=True, check=True).stdout == b''


def sleeper(path: Path, *, is_deaf: bool = False) -> list[str]:
    """Return a command that writes its process id into a file and sleeps."""
    handler = 'SIG_IGN' if is_deaf else 'SIG_DFL'
    code = (
        f'import os, signal, time; signal.signal(signal.SIGTERM, signal.{handler}); '
        f'open({str(path)!r}, "w").write(str(os.getpid())); time.sleep(60)'
    )
    return [sys.executable, '-c', code]


def wait_for_pid(path: Path) -> int:
    wait_until(lambda: path.exists() and bool(path.read_text()))
    return int(path.read_text())


def test_killed_process_is_restarted(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(child_process, 'RESTART_TIME', 0.05)
    path = tmp_path / 'pid'
    process = RestartedProcess(sleeper(path))
    process.check()
    first = wait_for_pid(path)
    path.unlink()
    os.kill(first, signal.SIGKILL)

    def is_started_again() -> bool:
        process.check()
        return path.exists()

    wait_until(is_started_again)
    assert (process.starts, process.error, process.failure) == (2, '', '')
    assert wait_for_pid(path) != first
    process.close()


@pytest.mark.parametrize('is_deaf', [False, True])
def test_process_ends_in_bounded_time(
    tmp_path: Path, monkeypatch, is_deaf
) -> None:
    monkeypatch.setattr(child_process, 'EXIT_TIMEOUT', 0.2 if is_deaf else 10.0)
    process = RestartedProcess(sleeper(tmp_path / 'pid', is_deaf=is_deaf))
    process.close()  # before its first start
    process.check()
    pid = wait_for_pid(tmp_path / 'pid')
    process.terminate()
    begin = time.monotonic()
    process.close()
    assert time.monotonic() - begin < 9.0
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize(
    ('command', 'reason', 'starts'),
    [
        (['/no/such/program'], '/no/such/program: no such program', 0),
        (['false'], 'exit code 1', MAX_FAILURES),
    ],
)
def test_failing_program_is_restarted_with_growing_delays_and_given_up(
    monkeypatch, command, reason, starts
) -> None:
    times: list[float] = []
    start = child_process.subprocess.Popen

    def count(*arguments: Any, **kwargs: Any) -> Any:
        times.append(time.monotonic())
        return start(*arguments, **kwargs)

    monkeypatch.setattr(child_process, 'RESTART_TIME', 0.02)
    monkeypatch.setattr(child_process.subprocess, 'Popen', count)
    process = RestartedProcess(command)

    def is_given_up() -> bool:
        process.check()
        return bool(process.failure)

    wait_until(is_given_up)
    for _ in range(3):
        process.check()
    waits = [later - earlier for earlier, later in pairwise(times)]
    assert all(wait >= 0.02 * 2**number for number, wait in enumerate(waits, 1))
    assert process.starts == len(times) == starts
    assert reason in process.failure
    process.close()


def test_program_that_fails_after_a_long_run_is_restarted(monkeypatch) -> None:
    monkeypatch.setattr(child_process, 'RESTART_TIME', 0.0)
    monkeypatch.setattr(child_process, 'STABLE_TIME', -1.0)  # any process has run for longer
    process = RestartedProcess(['false'])

    def is_started_often() -> bool:
        process.check()
        return process.starts > 2 * MAX_FAILURES

    wait_until(is_started_often)
    assert not process.failure
    process.close()
