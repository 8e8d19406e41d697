# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive this one."""

from __future__ import annotations

import os
import sys
import time

from bags import wait_until
import pytest
from soft_throw_ros.recording import child_process
from soft_throw_ros.recording.child_process import ChildProcess


@pytest.mark.parametrize('handler', ['SIG_IGN', 'SIG_DFL'])
def test_process_ends_in_bounded_time(tmp_path, monkeypatch, handler) -> None:
    monkeypatch.setattr(child_process, 'EXIT_TIMEOUT', 0.2 if handler == 'SIG_IGN' else 10.0)
    path = tmp_path / 'pid'
    code = (
        f'import os, signal, time; signal.signal(signal.SIGTERM, signal.{handler}); '
        f'open({str(path)!r}, "w").write(str(os.getpid())); time.sleep(60)'
    )
    process = ChildProcess([sys.executable, '-c', code])
    wait_until(lambda: path.exists() and bool(path.read_text()))
    assert process.error == ''
    process.terminate()
    begin = time.monotonic()
    process.close()
    assert time.monotonic() - begin < 9.0
    with pytest.raises(ProcessLookupError):
        os.kill(int(path.read_text()), 0)


@pytest.mark.parametrize(('command', 'reason'), [
    (['/no/such/program'], '/no/such/program: no such program'),
    (['false'], 'exit code 1'),
])
def test_failing_program_is_named(command, reason) -> None:
    process = ChildProcess(command)
    wait_until(lambda: bool(process.error))
    assert reason in process.error
    process.close()
