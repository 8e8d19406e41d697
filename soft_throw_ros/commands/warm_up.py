# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Compile the kernels once, in parts, so that nodes and commands start quickly.

numba caches compiled kernels on disk. Processes that start together would still compile the same
kernels, so each part has a lock: one process compiles the part, and the others load it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
import fcntl
import os
from pathlib import Path
import signal
import sys
import time
from types import ModuleType

from soft_throw_ros.commands.output import CommandParser, print_lines, run_command
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.core import cell_stepper, plate_kernels, wave_stepper
from soft_throw_ros.design.recommendation import solve_request
from soft_throw_ros.twin import plate_monitor, plate_observer, sample_buffer
from soft_throw_ros.twin.prepared_rig import prepare

_SOURCES = (  # of kernels
    *Path(str(wave_stepper.__file__)).parent.glob('*.py'),
    *Path(str(plate_observer.__file__)).parent.glob('*.py'),
)


def _step(stepper: ModuleType, loss_tangent: float) -> None:
    """Run the kernels of a stepper once, with a plate driven by the engine and a measured one."""
    prepare({**TWIN.defaults(), 'layer.loss_tangent': loss_tangent})
    stepper.warm_up()


PARTS: dict[str, Callable[[], object]] = {
    'travelling_wave': lambda: _step(wave_stepper, 0.0),
    'design': lambda: solve_request(TWIN.defaults()),
    'measured': lambda: [
        module.warm_up() for module in (sample_buffer, plate_monitor, plate_observer)
    ],
    'cells': lambda: _step(cell_stepper, 0.1),
}
"""Parts to compile, in order, each with a function that runs its kernels once."""


def main(args: list[str] | None = None) -> int:
    """Run the command; the exit code is 0."""
    parser = CommandParser(description='Compile all kernels, once for this installation.')
    return run_command(parser, _run, args)


def _run(_arguments: argparse.Namespace) -> int:
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        # Exit at once, because numba would print a long traceback; files on the disk are complete.
        signal.signal(signal_number, lambda number, _: os._exit(128 + number))
    for part in PARTS:
        begin = time.monotonic()
        load_kernels([part], say=lambda line: print_lines([line]))
        print_lines([f'{part}: ready, {time.monotonic() - begin:.1f} s'])
    return 0


def missing_parts() -> list[str]:
    """Return the names of the parts that are not compiled since the last change of the sources."""
    newest = max(path.stat().st_mtime for path in _SOURCES)
    return [
        part for part in PARTS
        if not (_mark(part).exists() and _mark(part).stat().st_mtime > newest)
    ]


def load_kernels(
    parts: Iterable[str] = tuple(PARTS), *, say: Callable[[str], object] = lambda _line: None
) -> None:
    """
    Load the kernels of parts, keys of `PARTS`; compile them if the cache does not contain them.

    `say` receives a line before a part is compiled, which takes some seconds.
    """
    missing = missing_parts()
    for part in parts:
        if part not in missing:
            PARTS[part]()
            continue
        mark = _mark(part)
        with mark.with_suffix('.lock').open('w') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                say(f'{part}: compiling kernels, which are cached for later runs')
            except BlockingIOError:
                say(f'{part}: waiting for another process that compiles the kernels')
                fcntl.flock(lock, fcntl.LOCK_EX)
            PARTS[part]()
            mark.write_bytes(b'.')  # as the end of a kernel, see `kernel_cache`


def _mark(part: str) -> Path:
    """
    Return the path of the file that marks a compiled part, in the directory of numba's cache.

    It has the suffix of numba's index files, so that clearing the cache deletes it as well.
    """
    folder = Path(str(plate_kernels.write_damped.stats.cache_path))
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f'{part}.{sys.implementation.cache_tag}.nbi'
