# SPDX-License-Identifier: Apache-2.0
"""Many throws in threads: compiled kernels hold no lock of Python's."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import os


def in_threads(
    run: Callable[[int, int], None], *, count: int, per_thread: int, threads: int | None
) -> None:
    """
    Do the parts of a loop in threads.

    Threads are made anew each time, because numba's own may not be entered from two at a time.

    Parameters
    ----------
    run : callable
        Does what belongs to a part, given its number and how many there are.
    count : int
        How many throws there are.
    per_thread : int
        Fewer of them are done before a thread has started.
    threads : int, optional
        Largest number of threads, all cores if None.

    Raises
    ------
    ValueError
        If `threads` is not a positive whole number or None.

    """
    if threads is not None and not (type(threads) is int and threads > 0):
        raise ValueError(f'threads must be a positive whole number or None, got {threads!r}')
    parts = max(1, min(threads or os.cpu_count() or 1, count // per_thread))
    if parts == 1:
        run(0, 1)
        return
    with ThreadPoolExecutor(parts - 1) as pool:
        others = pool.map(lambda part: run(part, parts), range(1, parts))
        run(0, parts)
        list(others)  # raises what they raised
