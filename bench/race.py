# SPDX-License-Identifier: Apache-2.0
"""
Let contenders run in turns, so that what else the machine does strikes all alike.

And what the tables of the results have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import statistics
import time
from typing import Any, NamedTuple

REPETITIONS = 9
SHORTEST = 2e-3  # a turn lasts at least as long: calls are repeated within it [s]
BUDGET = 3.0  # after this a contender sits out the turns that are left [s]


class Times(NamedTuple):
    """Of one call. [s]"""

    least: float
    median: float


def race(contenders: Mapping[str, Callable[[], Any]]) -> dict[str, Times]:
    """
    Time each contender, in turns.

    Parameters
    ----------
    contenders : mapping of str to callable
        What to call, by name. It is called once before it counts, and so is compiled.

    Returns
    -------
    dict of str to Times
        In the same order.

    """
    calls: dict[str, int] = {}
    for name, call in contenders.items():
        call()
        once = _time(call, 1)
        calls[name] = max(1, round(SHORTEST / once))
    seen: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(REPETITIONS):
        for name, call in contenders.items():
            if sum(seen[name]) * calls[name] < BUDGET:
                seen[name].append(_time(call, calls[name]))
    return {name: Times(min(times), statistics.median(times)) for name, times in seen.items()}


def head(*cells: str) -> list[str]:
    """Return the head of a Markdown table."""
    return [f'| {" | ".join(cells)} |', '|---' * len(cells) + '|']


def _time(call: Callable[[], Any], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count
