# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Many throws at once: batches, threads, processors, and cancellation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
import contextlib
from contextvars import ContextVar
import os

import numpy as np
from numpy.typing import NDArray

Cancelled = Callable[[], bool]
"""Called several times in a second of computing, by any thread; returns whether to give up."""

_reserved: ContextVar[int] = ContextVar('_reserved', default=0)


class SearchCancelledError(RuntimeError):
    """The caller no longer needs the result."""


class ThrowUnresolvedError(ValueError):
    """A throw without a release, or one that cannot be followed in time or accurately enough."""


def check_cancelled(cancelled: Cancelled | None) -> None:
    """Raise SearchCancelledError if the search is cancelled."""
    if cancelled is not None and cancelled():
        raise SearchCancelledError('the search was cancelled')


def run_batches(
    run: Callable[[NDArray[np.int64]], object], indices: NDArray[np.int64], *, size: int,
    cancelled: Cancelled | None = None,
) -> None:
    """
    Call a function with batches of at most `size` indices, on all `usable_processors`.

    The threads are fresh, because numba's thread pool is not re-entrant.
    """

    def run_batch(start: int) -> None:
        check_cancelled(cancelled)
        run(indices[start:start + size])

    starts = range(0, indices.size, size)
    workers = min(usable_processors(), len(starts))
    if workers > 1:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(run_batch, starts))  # raises the exceptions of the threads
    else:
        for start in starts:
            run_batch(start)


def usable_processors() -> int:
    """Count the processors of this thread's affinity less those of `leave_processors`, or 1."""
    return max(1, len(os.sched_getaffinity(0)) - _reserved.get())


@contextlib.contextmanager
def leave_processors(count: int) -> Iterator[None]:
    """Leave so many processors to other threads of the process; also a decorator."""
    token = _reserved.set(count)
    try:
        yield
    finally:
        _reserved.reset(token)
