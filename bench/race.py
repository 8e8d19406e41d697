# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Timing of alternatives in turns, so that other load on the machine affects all equally."""

from __future__ import annotations

from collections.abc import Callable
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
    """Longest time for a unit. [us]"""


class Result(NamedTuple):
    """A measured table."""

    heads: list[str]
    rows: list[list[str | float | None]]
    """Title and numbers of each row; None marks an empty cell."""
    ratios: dict[str, float]
    """Costs relative to the first case, which should be the same on all machines."""

    def lines(self) -> list[str]:
        """Return the table in Markdown."""
        lines = head(*self.heads)
        for title, *cells in self.rows:
            texts = ['-' if cell is None else f'{cell:.4g}' for cell in cells]
            lines.append(f'| {title} | {" | ".join(texts)} |')
        return [*lines, '']


def measure(title: str, error_of: str, cases: list[Case]) -> Result:
    """
    Time cases in turns, after a first call that compiles, and return their table.

    Parameters
    ----------
    title, error_of : str
        Heads of the columns of names and of errors.
    cases : list of Case
        The first one is the reference of the ratios.

    """
    counts = []
    for case in cases:
        case.call()
        counts.append(max(1, round(MIN_TURN / _time(case.call, 1)[0])))
    times: list[list[tuple[float, float]]] = [[] for _ in cases]
    for _ in range(REPETITIONS):
        for case, count, measured in zip(cases, counts, times, strict=True):
            if sum(wall for wall, _ in measured) * count < BUDGET:
                measured.append(_time(case.call, count))
    heads = [title, f'error of {error_of}', 'us', 'processor time over first', 'goal [us]']
    result = Result(heads, [], {})
    first = None
    for case, measured in zip(cases, times, strict=True):
        # Load on the machine hardly changes the smallest processor time
        wall, processor = (min(values) / case.units for values in zip(*measured, strict=True))
        ratio = processor / (first := first or processor)
        error = None if case.error is None else case.error(case.call())
        result.rows.append([case.name, error, 1e6 * wall, ratio, case.goal])
        if case is not cases[0]:
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
