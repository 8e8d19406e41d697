# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Compile the kernels once, so that nodes and commands start quickly.

numba caches compiled kernels on disk. Processes that start together would still compile the same
kernels, so there is a lock: one process compiles the kernels, and the others load them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import fcntl
import os
from pathlib import Path
import signal
import sys
import time

import numpy as np
from soft_throw_ros.commands.output import CommandParser, print_lines, run_command
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.core import stepper
from soft_throw_ros.core.throw import throw_many
from soft_throw_ros.design.recommendation import solve_request
from soft_throw_ros.twin import plate_monitor, plate_observer, sample_buffer
from soft_throw_ros.twin.prepared_rig import prepare

_SOURCES = (  # of kernels
    *Path(str(stepper.__file__)).parent.glob('*.py'),
    *Path(str(plate_observer.__file__)).parent.glob('*.py'),
)


def main(args: list[str] | None = None) -> int:
    """Run the command; the exit code is 0."""
    parser = CommandParser(description='Compile all kernels, once for this installation.')
    return run_command(parser, _run, args)


def _run(_arguments: argparse.Namespace) -> int:
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        # Exit at once, because numba would print a long traceback; files on the disk are complete.
        signal.signal(signal_number, lambda number, _: os._exit(128 + number))
    begin = time.monotonic()
    load_kernels(say=lambda line: print_lines([line]))
    print_lines([f'the kernels are ready, {time.monotonic() - begin:.1f} s'])
    return 0


def are_compiled() -> bool:
    """Return whether the kernels are compiled since the last change of the sources."""
    newest = max(path.stat().st_mtime for path in _SOURCES)
    return _mark().exists() and _mark().stat().st_mtime > newest


def load_kernels(*, say: Callable[[str], object] = lambda _line: None) -> None:
    """
    Load all kernels; compile them if the cache does not contain them.

    `say` receives a line before the kernels are compiled, which takes a minute.
    """
    if are_compiled():
        _run_kernels()
        return
    with _mark().with_suffix('.lock').open('w') as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            say('compiling the kernels, which are cached for later runs')
        except BlockingIOError:
            say('waiting for another process that compiles the kernels')
            fcntl.flock(lock, fcntl.LOCK_EX)
        _run_kernels()
        _mark().write_bytes(b'.')  # as the end of a kernel, see `kernel_cache`


def _run_kernels() -> None:
    """Run all kernels once: of throws with and without loss, of a design, of a measured plate."""
    for loss_tangent in (0.0, 0.1):
        settings = {**TWIN.defaults(), 'layer.loss_tangent': loss_tangent}
        throw_many(prepare(settings).rig, loads=True)
        measured = prepare({**settings, 'engine.motion': 'measured'})
        if measured.ahead:
            measured.ahead[0].sync_from(measured.stepper, np.empty(0), np.empty((0, 3)))
    solve_request(TWIN.defaults())
    for module in (sample_buffer, plate_monitor, plate_observer):
        module.warm_up()


def _mark() -> Path:
    """
    Return the path of the file that marks compiled kernels, in the directory of numba's cache.

    It has the suffix of numba's index files, so that clearing the cache deletes it as well.
    """
    folder = Path(str(stepper.write_damped.stats.cache_path))
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f'all.{sys.implementation.cache_tag}.nbi'
