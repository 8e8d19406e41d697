# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Processors that this process may use."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from contextvars import ContextVar
import functools
import math
import os
from pathlib import Path

_reserved: ContextVar[int] = ContextVar('_reserved', default=0)


def usable_processors() -> int:
    """
    Count the processors that the calling thread may use for threads of its own.

    Returns
    -------
    int
        The processors of the thread's affinity, at most the CPU quota of its control group rounded
        down, less those of `leave_processors`; at least 1.

    Notes
    -----
    A quota is read once per process. The operating system stops a process that exceeds its quota
    for tens of milliseconds, with all threads, including real-time ones.

    """
    allowed = min(len(os.sched_getaffinity(0)), cpu_quota())
    return max(1, int(allowed) - _reserved.get())


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


@functools.lru_cache(maxsize=1)
def cpu_quota(
    membership: Path = Path('/proc/self/cgroup'), root: Path = Path('/sys/fs/cgroup')
) -> float:
    """
    Return the smallest CPU quota of a control group and its ancestors, of version 1 or 2.

    Parameters
    ----------
    membership, root : Path
        The file that names the groups of the process, and the folder of the control groups.

    Returns
    -------
    float
        Processor time per time, infinite without a quota. [-]

    """
    quota = math.inf
    with contextlib.suppress(OSError):
        for line in membership.read_text().splitlines():
            _, controllers, group = line.split(':', 2)
            if controllers and 'cpu' not in controllers.split(','):
                continue
            mount = root / 'cpu' if controllers else root
            folder = mount / group.lstrip('/')
            for ancestor in (folder, *folder.parents):
                if ancestor.is_relative_to(mount):
                    quota = min(quota, _quota_of(ancestor))
    return quota


def _quota_of(folder: Path) -> float:
    """Return the CPU quota of a folder of the control groups, infinite if it has none."""
    try:
        if (file := folder / 'cpu.max').is_file():  # version 2
            limit, period = file.read_text().split()
        else:
            limit = (folder / 'cpu.cfs_quota_us').read_text()
            period = (folder / 'cpu.cfs_period_us').read_text()
        return float(limit) / float(period) if float(limit) > 0.0 else math.inf
    except (OSError, ValueError):  # no such file, or the quota 'max'
        return math.inf
