# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compilation of each kernel once, by the first process."""

import fcntl
from functools import partial
import os
import subprocess
import sys

from numba.core import event
import pytest
from soft_throw_ros.commands.warm_up import are_compiled, load_kernels
from twin_runs import Run

LOAD = """
from soft_throw_ros.commands import warm_up
warm_up._run_kernels = warm_up.sample_buffer.warm_up  # few kernels
warm_up.load_kernels(say=print)
"""


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_kernels_are_compiled_once_and_reported(tmp_path):
    warm_up = partial(
        subprocess.Popen, [sys.executable, '-u', '-c', LOAD], stdout=subprocess.PIPE, text=True,
        env=os.environ | {'NUMBA_CACHE_DIR': str(tmp_path / 'cache')},
    )
    assert 'cached for later runs' in warm_up().communicate()[0]
    assert warm_up().communicate()[0] == ''
    (mark,) = (tmp_path / 'cache').rglob('all.*.nbi')
    mark.unlink()
    with mark.with_suffix('.lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with warm_up() as waiting:
            assert 'another process that compiles' in waiting.stdout.readline()
            fcntl.flock(lock, fcntl.LOCK_UN)
    assert waiting.returncode == 0
    assert mark.exists()


def test_warm_up_leaves_nothing_to_compile_or_load():
    load_kernels()
    assert are_compiled()
    with event.install_recorder('numba:compiler_lock') as recorder:
        for loss in (0.0, 0.1):
            run = Run(throw__period=0.3, layer__loss_tangent=loss)
            run.go(700)
        run = Run(engine__motion='measured')
        run.measure()
    assert run.session.throws == 1
    assert recorder.buffer == []
