# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Many throws at once: their ratios, checked and broadcast, threads and cancellation."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.processors import usable_processors

Floats = NDArray[np.float64]

Cancelled = Callable[[], bool]
"""Called several times in a second of computing, by any thread; returns whether to give up."""

_RANGES = {
    'mass_ratio': 'positive', 'speed_ratio': 'positive', 'damping_ratio': 'in_unit_interval',
}
"""Ranges of ratios for `checks.require_all`; all others are not negative."""

_MAX_PERIODS = 16.0
"""Longest wait of steppers for a release, in periods of plate or projectile. [-]"""

_MAX_CROSSINGS = 4096.0
"""Longest wait of steppers for a release, in crossings of the wave. [-]"""


class SearchCancelledError(RuntimeError):
    """The caller no longer needs the result."""


def check_cancelled(cancelled: Cancelled | None) -> None:
    """Raise SearchCancelledError if the search is cancelled."""
    if cancelled is not None and cancelled():
        raise SearchCancelledError('the search was cancelled')


class ThrowUnresolvedError(ValueError):
    """No release within the simulated time, or none with the promised accuracy."""


def broadcast_ratios(**ratios: ArrayLike) -> tuple[Floats, tuple[int, ...]]:
    """
    Check fields of `rig.Ratios`; return a row for each, and their common shape.

    Raises
    ------
    ValueError
        If a ratio is out of range, or the shapes do not fit.

    """
    arrays = [
        checks.require_all(name, ratio, _RANGES.get(name, 'not_negative'))
        for name, ratio in ratios.items()
    ]
    rows = np.stack(np.broadcast_arrays(*arrays))
    return rows.reshape(len(arrays), -1), rows.shape[1:]


def longest_wait(mass_ratio: Floats, speed_ratio: Floats) -> Floats:
    """Return the time until which steppers follow throws without a release [crossings]."""
    longest = np.maximum(speed_ratio, 2.0 * math.pi * np.sqrt(mass_ratio))
    return np.minimum(1.0 + _MAX_PERIODS * longest, _MAX_CROSSINGS)


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
