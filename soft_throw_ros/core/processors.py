# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Processors that this process may use."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from contextvars import ContextVar
import os

_reserved: ContextVar[int] = ContextVar('_reserved', default=0)


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
