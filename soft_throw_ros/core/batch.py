# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Many throws at once: threads, processors, cancellation, and the longest wait for a release."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
import contextlib
from contextvars import ContextVar
import math
import os

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Scales

Floats = NDArray[np.float64]

Cancelled = Callable[[], bool]
"""Called several times in a second of computing, by any thread; returns whether to give up."""

_MAX_PERIODS = 16.0
"""Longest wait of steppers for a release, in periods of plate or projectile. [-]"""

_MAX_CROSSINGS = 4096.0
"""Longest wait of steppers for a release, in crossings of the wave. [-]"""


_reserved: ContextVar[int] = ContextVar('_reserved', default=0)


class SearchCancelledError(RuntimeError):
    """The caller no longer needs the result."""


def check_cancelled(cancelled: Cancelled | None) -> None:
    """Raise SearchCancelledError if the search is cancelled."""
    if cancelled is not None and cancelled():
        raise SearchCancelledError('the search was cancelled')


class ThrowUnresolvedError(ValueError):
    """No release within the simulated time, or none with the promised accuracy."""


def longest_wait(scales: Scales) -> Floats:
    """Return the time until which steppers follow throws without a release [s]."""
    crossing, relaxation = scales.crossing_time, scales.relaxation_time
    own_period = 2.0 * math.pi * np.sqrt(crossing * relaxation)
    longest = np.maximum(2.0 * math.pi / scales.angular_frequency, own_period)
    return np.asarray(np.minimum(crossing + _MAX_PERIODS * longest, _MAX_CROSSINGS * crossing))


def in_threads(
    run: Callable[[int, int], None], *, count: int, per_thread: int, threads: int | None
) -> None:
    """
    Run a loop in fresh threads, because numba's thread pool is not re-entrant.

    Parameters
    ----------
    run : callable
        Computes throws, given the number of the first one and the stride to the next.
    count, per_thread : int
        Number of throws, and the fewest that are worth a thread.
    threads : int, optional
        Largest number of threads, by default `usable_processors`.

    Raises
    ------
    ValueError
        If `threads` is not a positive whole number or None.

    """
    if threads is not None and not (type(threads) is int and threads > 0):
        raise ValueError(f'threads must be a positive whole number or None, got {threads!r}')
    stride = max(1, min(threads or usable_processors(), count // per_thread))
    if stride == 1:
        run(0, 1)
        return
    with ThreadPoolExecutor(stride - 1) as pool:
        others = pool.map(lambda first: run(first, stride), range(1, stride))
        run(0, stride)
        list(others)  # raises the exceptions of the threads


def usable_processors() -> int:
    """
    Count the processors that the calling thread may use for threads of its own.

    Returns
    -------
    int
        The processors of the thread's affinity, less those of `leave_processors`; at least 1.

    """
    return max(1, len(os.sched_getaffinity(0)) - _reserved.get())


@contextlib.contextmanager
def leave_processors(count: int) -> Iterator[None]:
    """
    Leave processors to other threads of the process; also a decorator.

    Parameters
    ----------
    count : int
        Processors that `usable_processors` does not count in this context.

    """
    token = _reserved.set(count)
    try:
        yield
    finally:
        _reserved.reset(token)
