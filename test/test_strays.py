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
"""Killed tests leave no processes behind."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest

TESTS = """
from pathlib import Path
import subprocess, threading
import strays

strays.watch_this_process()

def test_of_processes(tmp_path):
    started = []
    def start(*command):
        started.append(subprocess.Popen(command))
    start('sh', '-c', 'sleep 300 & echo $! > %s/grandchild; wait' % tmp_path)
    start('sleep', '300')
    thread = threading.Thread(target=start, args=('sleep', '300'))
    thread.start()
    thread.join()
    while not (tmp_path / 'grandchild').exists() or not (tmp_path / 'grandchild').read_text():
        pass
    grandchild = int((tmp_path / 'grandchild').read_text())
    print(*(process.pid for process in started), grandchild, flush=True)
    assert [process.wait() for process in started]
"""
TIMEOUT = 60.0  # [s]


@pytest.mark.slow
def test_killed_tests_leave_no_processes(tmp_path) -> None:
    (tmp_path / 'test_it.py').write_text(TESTS)
    options = ('-c', '/dev/null', '-o', f'pythonpath={Path(__file__).parent}', '--rootdir')
    with subprocess.Popen(
        [sys.executable, '-m', 'pytest', '-qs', '-p', 'no:cacheprovider', *options, tmp_path],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
    ) as tests:
        line = ''
        while len(line.split()) != 4:
            line = next(tests.stdout)
        pids = [int(word) for word in line.split()]
        assert all(is_running(pid) for pid in pids)
        os.kill(pids[1], signal.SIGSTOP)  # a stopped process ignores SIGTERM
        tests.kill()
    deadline = time.monotonic() + TIMEOUT
    while any(map(is_running, pids)):
        assert time.monotonic() < deadline, [pid for pid in pids if is_running(pid)]
        time.sleep(0.05)


def is_running(pid: int) -> bool:
    try:
        stat = Path(f'/proc/{pid}/stat').read_text()
    except OSError:
        return False
    return stat.rpartition(')')[2].split()[0] != 'Z'  # a zombie has ended
