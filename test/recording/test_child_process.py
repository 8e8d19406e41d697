# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive this one."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
from test.recording.conftest import wait_until
import time

import pytest
from soft_throw_ros.recording import child_process
from soft_throw_ros.recording.child_process import bound_to_parent, ChildProcess


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


@pytest.mark.parametrize('is_deaf', [False, True])
def test_process_ends_in_bounded_time(
    tmp_path: Path, monkeypatch, is_deaf
) -> None:
    monkeypatch.setattr(child_process, 'EXIT_TIMEOUT', 0.2 if is_deaf else 10.0)
    process = ChildProcess(sleeper(tmp_path / 'pid', is_deaf=is_deaf))
    pid = wait_for_pid(tmp_path / 'pid')
    assert process.error == ''
    process.terminate()
    begin = time.monotonic()
    process.close()
    assert time.monotonic() - begin < 9.0
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize(('command', 'reason'), [
    (['/no/such/program'], '/no/such/program: no such program'),
    (['false'], 'exit code 1'),
])
def test_failing_program_is_named(command, reason) -> None:
    process = ChildProcess(command)
    wait_until(lambda: bool(process.error))
    assert reason in process.error
    process.terminate()
    process.close()
