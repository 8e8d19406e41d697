# SPDX-License-Identifier: Apache-2.0
"""
Compute many independent cases, block by block: here, or wherever an executor has its workers.

Which worker did what, in which order, and in how many calls with how many interruptions between
them never shows in the results.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from concurrent.futures import as_completed, Executor
import contextlib
import hashlib
import os
from pathlib import Path
import time
from types import TracebackType
from typing import final
import zipfile

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

Function = Callable[[Floats], Floats]
"""From cases of shape (inputs, n) to results of shape (outputs, n), column by column."""

Progress = Callable[[int], object]
"""Is told that so many more cases are done."""

_SAVE_PERIOD = 5.0  # no more than this is lost if the machine stops [s]


class CheckpointError(ValueError):
    """A checkpoint cannot be read, or is not one."""


@final
class Checkpoint:
    """
    Where a sweep leaves what is done, until the results are stored.

    It is a context: enter it, sweep, store the results, leave it. If all goes well nothing stays
    behind; after an interruption the next sweep for the same request goes on from there.

    Parameters
    ----------
    target : Path
        The file that will hold the results. The checkpoint lies beside it, and its name tells
        what for, so that different requests never mix.

    Attributes
    ----------
    path : Path or None
        Where it lies, known as soon as a sweep has begun.

    Raises
    ------
    CheckpointError
        By the sweep, if the file is damaged.

    """

    def __init__(self, target: Path) -> None:
        self._target = target
        self.path: Path | None = None

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None and self.path is not None:
            self.path.unlink(missing_ok=True)

    def load(
        self, request: str, cases: Floats, *, outputs: int, block: int
    ) -> tuple[Floats, Flags]:
        """Return the results so far, and which blocks of cases they are for."""
        digest = hashlib.sha256(f'{request}\n{cases.shape}, {outputs}, {block}\n'.encode())
        digest.update(np.ascontiguousarray(cases).tobytes())
        self.path = self._target.with_name(f'{self._target.name}.{digest.hexdigest()[:16]}.part')
        results = np.full((outputs, cases.shape[1]), np.nan)
        done = np.zeros(-(-cases.shape[1] // block), dtype=np.bool_)
        try:
            with self.path.open('rb') as raw, np.load(raw) as file:
                results[:], done[:] = file['results'], file['done']
        except FileNotFoundError:
            pass
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise CheckpointError(
                f'{self.path} should hold what is done, but cannot be read ({error}); '
                'delete it to begin again'
            ) from None
        return results, done

    def save(self, results: Floats, done: Flags) -> None:
        """Replace the file."""
        if self.path is None:
            raise RuntimeError('save comes after load')
        with whole_file(self.path) as path, path.open('wb') as file:
            np.savez(file, results=results, done=done)


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """
    Have a file appear, or replace another, once it is written as a whole.

    Parameters
    ----------
    path : Path
        Stays as it is if anything is raised within the context.

    Yields
    ------
    Path
        Where to write, instead.

    """
    beside = path.with_name(f'{path.name}.{os.getpid()}.tmp')
    try:
        yield beside
        with beside.open('rb+') as file:
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def sweep(
    function: Function,
    cases: Floats,
    *,
    outputs: int,
    block: int,
    executor: Executor | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    request: str = '',
) -> Floats:
    """
    Compute all cases.

    Parameters
    ----------
    function : callable
        From cases, shape (inputs, n), to results, shape (outputs, n). What a column becomes must
        not depend on the others. An executor with other processes has to be able to pickle it.
    cases : ndarray, shape (inputs, n)
        A column each.
    outputs : int
        Rows of the results.
    block : int
        Cases per call.
    executor : Executor, optional
        Who does the calls, several at a time; the caller, one after another, if not given.
    progress : callable, optional
        Called with the number of cases that have been done since the last time.
    checkpoint : Checkpoint, optional
        Where to look for what is done already, and to leave it: every few seconds, and at once
        when something breaks off the sweep.
    request : str
        What else the results depend on, by which the checkpoint is found again.

    Returns
    -------
    ndarray, shape (outputs, n)

    Raises
    ------
    CheckpointError
        If the checkpoint is damaged.
    Exception
        What `function` raises, or the executor.

    Examples
    --------
    >>> sweep(lambda cases: cases**2, np.array([[1.0, 2.0, 3.0]]), outputs=1, block=2)
    array([[1., 4., 9.]])

    """
    count = cases.shape[1]
    if checkpoint is None:
        results = np.full((outputs, count), np.nan)
        done = np.zeros(-(-count // block), dtype=np.bool_)
    else:
        results, done = checkpoint.load(request, cases, outputs=outputs, block=block)
    if progress is not None and done.any():
        progress(int(np.repeat(done, block)[:count].sum()))
    blocks = {
        int(index): cases[:, index * block : (index + 1) * block]
        for index in np.flatnonzero(~done)
    }
    saved, unsaved = time.monotonic(), False
    try:
        with contextlib.closing(_computed(function, blocks, executor)) as computed:
            for index, values in computed:
                results[:, index * block : (index + 1) * block] = values
                done[index] = unsaved = True
                if progress is not None:
                    progress(values.shape[1])
                if checkpoint is not None and time.monotonic() - saved > _SAVE_PERIOD:
                    checkpoint.save(results, done)
                    saved, unsaved = time.monotonic(), False
    except BaseException:
        if checkpoint is not None and unsaved:
            checkpoint.save(results, done)
        raise
    return results


def _computed(
    function: Function, blocks: dict[int, Floats], executor: Executor | None
) -> Generator[tuple[int, Floats], None, None]:
    """Compute blocks; give their numbers and results, in whatever order they come."""
    if executor is None:
        for index, block in blocks.items():
            yield index, function(block)
        return
    futures = {executor.submit(function, block): index for index, block in blocks.items()}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        for future in futures:
            future.cancel()
