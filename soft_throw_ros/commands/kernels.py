# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Compile the kernels once, in parts.

numba caches compiled kernels on disk. Processes that start together would still compile the same
kernels, so each part has a lock: one process compiles the part, and the others load it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
import contextlib
import fcntl
from pathlib import Path
import sys
import threading
import time
from types import ModuleType

from soft_throw_ros.configuration import TWIN
from soft_throw_ros.core import cell_stepper, wave_stepper
from soft_throw_ros.design.requests import solve_request
from soft_throw_ros.twin import outlier_filter, plate_observer, sample_buffer
from soft_throw_ros.twin.prepared_rig import prepare

Say = Callable[[str], object]

_INTERVAL = 2.0  # from one line of progress to the next [s]
_SOURCES = (  # of kernels
    *Path(wave_stepper.__file__).parent.glob('*.py'),
    *Path(str(plate_observer.__file__)).parent.glob('*.py'),
)


def _step(stepper: ModuleType, **layer: float) -> None:
    """Run the kernels of a stepper once, with a plate driven by the engine and a measured one."""
    changes = {f'layer.{name}': value for name, value in layer.items()}
    prepare({**TWIN.defaults(), **changes})
    stepper.warm_up()


def _measure() -> None:
    """Run the kernels that process samples of a plate once."""
    for module in (outlier_filter, sample_buffer, plate_observer):
        module.warm_up()


PARTS: dict[str, Callable[[], object]] = {
    'travelling_wave': lambda: _step(wave_stepper),
    'design': lambda: solve_request(TWIN.defaults()),
    'measured': _measure,
    'cells': lambda: _step(cell_stepper, loss_tangent=0.1),
}
"""Parts to compile, in order, each with a function that runs its kernels once."""


def missing_parts() -> list[str]:
    """Return the names of the parts that are not compiled since the last change of the sources."""
    newest = max(path.stat().st_mtime for path in _SOURCES)
    return [part for part in PARTS if not _is_newer(_mark(part), newest)]


def load_kernels(parts: Iterable[str] = tuple(PARTS), *, say: Say = lambda _text: None) -> None:
    """
    Load the kernels of parts, keys of `PARTS`; compile them if the cache does not contain them.

    `say` is called every other second while a part is being compiled, from another thread.
    """
    missing = missing_parts()
    for part in parts:
        if part not in missing:
            PARTS[part]()
            continue
        with _locked(part, say), _reported(part, say):
            PARTS[part]()
            _mark(part).write_bytes(b'.')  # as the end of a kernel, see `kernel_cache`


@contextlib.contextmanager
def _reported(part: str, say: Say) -> Iterator[None]:
    """Report every other second that a part is being compiled within the context."""
    begin, is_over = time.monotonic(), threading.Event()

    def report() -> None:
        while not is_over.wait(_INTERVAL):
            elapsed = time.monotonic() - begin
            say(f'compiling {part} ({elapsed:.0f} s elapsed; cached for later runs)')

    threading.Thread(target=report, daemon=True).start()
    try:
        yield
    finally:
        is_over.set()


@contextlib.contextmanager
def _locked(part: str, say: Say) -> Iterator[None]:
    """Lock a part, so that no other process compiles it within the context."""
    with _mark(part).with_suffix('.lock').open('w') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(f'waiting for another process that compiles {part}')
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _mark(part: str) -> Path:
    """
    Return the path of the file that marks a compiled part, in the directory of numba's cache.

    It has the suffix of numba's index files, so that clearing the cache deletes it as well.
    """
    folder = Path(str(wave_stepper.prepare.stats.cache_path))
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f'{part}.{sys.implementation.cache_tag}.nbi'


def _is_newer(path: Path, moment: float) -> bool:
    try:
        return path.stat().st_mtime > moment
    except FileNotFoundError:
        return False
