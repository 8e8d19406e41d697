# SPDX-License-Identifier: Apache-2.0
"""Let cases run in turns, so that what else the machine does strikes all alike, and list them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import statistics
import time
from typing import Any, NamedTuple

REPETITIONS = 9
SHORTEST = 2e-3  # a turn lasts at least as long: calls are repeated within it [s]
BUDGET = 3.0  # after this a case sits out the turns that are left [s]


class Case(NamedTuple):
    """One way to get some numbers; one call does so many units (throws, seconds) of the table."""

    name: str
    call: Callable[[], Any]
    units: float = 1.0
    error: Callable[[Any], float] | None = None  # of what `call` returns
    goal: float | None = None  # that it is to reach, in the table's measure


class Table(NamedTuple):
    """Cases that are compared; the first is what the others are measured by."""

    title: str
    unit: str
    error: str  # what the errors are of
    cases: list[Case]
    is_factor: bool = False  # units per second, a real-time factor, not microseconds per unit


class Times(NamedTuple):
    """Of one call. [s]"""

    least: float
    median: float


def race(calls: Mapping[str, Callable[[], Any]]) -> dict[str, Times]:
    """Time calls, in turns; each is made once before it counts, and so is compiled."""
    counts: dict[str, int] = {}
    for name, call in calls.items():
        call()
        counts[name] = max(1, round(SHORTEST / _time(call, 1)))
    seen: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(REPETITIONS):
        for name, call in calls.items():
            if sum(seen[name]) * counts[name] < BUDGET:
                seen[name].append(_time(call, counts[name]))
    return {name: Times(min(times), statistics.median(times)) for name, times in seen.items()}


def rows(table: Table) -> list[str]:
    """Measure a table, and return the rows of it in Markdown, the head first."""
    times = race({case.name: case.call for case in table.cases})
    first = table.cases[0]
    base = times[first.name].least / first.units
    measure = 'real-time factor' if table.is_factor else f'us per {table.unit}'
    lines = head(table.title, table.error, f'{measure}, best', 'median', 'time over first', 'goal')
    for case in table.cases:
        least, median = (
            1e6 * part / case.units if not table.is_factor else case.units / part
            for part in times[case.name]
        )
        error = '-' if case.error is None else f'{case.error(case.call()):.1e}'
        goal = '-' if case.goal is None else f'{case.goal:g}'
        ratio = times[case.name].least / case.units / base
        lines.append(
            f'| {case.name} | {error} | {least:.4g} | {median:.4g} | {ratio:.3g} | {goal} |'
        )
    return lines


def head(*cells: str) -> list[str]:
    """Return the head of a Markdown table."""
    return [f'| {" | ".join(cells)} |', '|---' * len(cells) + '|']


def _time(call: Callable[[], Any], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count
