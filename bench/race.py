# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Timing of alternatives in turns, so that other load on the machine affects all equally."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import statistics
import time
from typing import Any, NamedTuple

REPETITIONS = 9
"""Number of turns."""

MIN_TURN = 2e-3
"""Shortest duration of a turn: faster calls are repeated within one turn. [s]"""

BUDGET = 3.0
"""Total time of one case; a case that has used it skips the remaining turns. [s]"""


class Case(NamedTuple):
    """One way to compute a result; a call processes `units` units (throws, seconds) at once."""

    name: str
    call: Callable[[], Any]
    units: float = 1.0
    error: Callable[[Any], float] | None = None
    """Error of the returned result."""
    goal: float | None = None
    """Required performance, in the unit of the table."""


class Table(NamedTuple):
    """Cases to compare; ratios are costs relative to the first case."""

    title: str
    unit: str
    error: str
    """Head of the column of errors."""
    cases: list[Case]
    is_factor: bool = False
    """Whether to print real-time factors (units per second) instead of us per unit."""


class Result(NamedTuple):
    """A measured table."""

    heads: list[str]
    rows: list[list[str | float | None]]
    """Title and numbers of each row; None marks an empty cell."""
    ratios: dict[str, float]
    """Costs relative to the first case, which should be the same on all machines."""

    @classmethod
    def under(cls, *heads: str) -> Result:
        """Return an empty table with these heads."""
        return cls(list(heads), [], {})

    def lines(self) -> list[str]:
        """Return the table in Markdown."""
        lines = head(*self.heads)
        for title, *cells in self.rows:
            texts = ['-' if cell is None else f'{cell:.4g}' for cell in cells]
            lines.append(f'| {title} | {" | ".join(texts)} |')
        return [*lines, '']


class Times(NamedTuple):
    """Duration and processor time of a call; load on the machine hardly changes the latter [s]."""

    shortest: float
    median: float
    processor: float


def race(calls: Mapping[str, Callable[[], Any]]) -> dict[str, Times]:
    """Time calls in turns, after a first call that compiles."""
    counts: dict[str, int] = {}
    for name, call in calls.items():
        call()
        counts[name] = max(1, round(MIN_TURN / _time(call, 1)[1]))
    measured: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    for _ in range(REPETITIONS):
        for name, call in calls.items():
            if sum(wall for wall, _ in measured[name]) * counts[name] < BUDGET:
                measured[name].append(_time(call, counts[name]))
    times = {}
    for name, pairs in measured.items():
        walls, processors = zip(*pairs, strict=True)
        times[name] = Times(min(walls), statistics.median(walls), min(processors))
    return times


def measure(table: Table) -> Result:
    """Measure the cases of a table."""
    times = race({case.name: case.call for case in table.cases})
    first = table.cases[0]
    base = times[first.name].processor / first.units
    kind = 'real-time factor' if table.is_factor else f'us per {table.unit}'
    result = Result.under(
        table.title, table.error, f'{kind}, best', 'median', 'processor time over first', 'goal'
    )
    for case in table.cases:
        costs = [seconds / case.units for seconds in times[case.name][:2]]
        numbers = [1.0 / cost if table.is_factor else 1e6 * cost for cost in costs]
        error = None if case.error is None else case.error(case.call())
        ratio = times[case.name].processor / case.units / base
        result.rows.append([case.name, error, *numbers, ratio, case.goal])
        if case is not first:
            result.ratios[case.name] = ratio
    return result


def head(*cells: str) -> list[str]:
    """Return the head of a Markdown table."""
    return [f'| {" | ".join(cells)} |', '|---' * len(cells) + '|']


def _time(call: Callable[[], Any], count: int) -> tuple[float, float]:
    """Return the mean duration and processor time of one call [s]."""
    start, used = time.perf_counter(), time.process_time()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count, (time.process_time() - used) / count
