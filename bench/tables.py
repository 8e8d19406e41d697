# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of alternatives that are timed in turns, and the comparison with stored ratios."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import json
import math
from pathlib import Path
import time
import timeit
from typing import Any, NamedTuple

import numpy as np

TURNS = 7  # number of turns, so that other load on the machine affects all cases equally
STORED = Path(__file__).with_name('ratios.json')  # file of the stored ratios
TOLERANCE = 1.3  # largest factor between a measured and a stored ratio [-]

Ratios = Mapping[str, Mapping[str, float]]


class Case(NamedTuple):
    """One way to compute a result; a call processes `units` units (throws, seconds) at once."""

    name: str
    call: Callable[[], Any]
    units: float = 1.0
    error: Callable[[Any], float] | None = None  # error of the returned result
    goal: float | None = None  # longest time for a unit [us]


class Result(NamedTuple):
    """A measured table."""

    heads: list[str]
    rows: list[list[str | float | None]]  # title and numbers; None marks an empty cell
    ratios: dict[str, float]  # costs over the first case, nearly the same on all machines

    def lines(self) -> list[str]:
        """Return the table in Markdown."""
        lines = head(*self.heads)
        for title, *cells in self.rows:
            texts = ['-' if cell is None else f'{cell:.4g}' for cell in cells]
            lines.append(f'| {title} | {" | ".join(texts)} |')
        return [*lines, '']


def head(*cells: str) -> list[str]:
    """Return the head of a Markdown table."""
    return [f'| {" | ".join(cells)} |', '|---' * len(cells) + '|']


def measure(title: str, error_of: str, cases: list[Case]) -> Result:
    """Time cases in turns, the first of which is the reference of the ratios."""
    results = [case.call() for case in cases]  # compiles
    # Load on the machine hardly changes the smallest processor time.
    timers = [timeit.Timer(case.call, timer=time.process_time) for case in cases]
    counts = [timer.autorange()[0] for timer in timers]
    turns = [
        [timer.timeit(count) / count for timer, count in zip(timers, counts, strict=True)]
        for _ in range(TURNS)
    ]
    times = np.min(turns, axis=0) / [case.units for case in cases]
    heads = [title, f'error of {error_of}', 'processor time [us]', 'over first', 'goal [us]']
    rows = [
        [case.name, case.error and case.error(result), 1e6 * used, used / times[0], case.goal]
        for case, result, used in zip(cases, results, times, strict=True)
    ]
    ratios = {case.name: used / times[0] for case, used in zip(cases[1:], times[1:], strict=True)}
    return Result(heads, rows, ratios)


def store(ratios: Ratios, path: Path = STORED) -> None:
    """Replace the stored ratios of the measured tables, and keep those of other tables."""
    stored = json.loads(path.read_text('utf-8')) if path.exists() else {}
    for table, measured in ratios.items():
        stored[table] = {name: float(f'{ratio:.3g}') for name, ratio in measured.items()}
    path.write_text(json.dumps(stored, indent=2, sort_keys=True) + '\n', 'utf-8')


def deviations(ratios: Ratios, path: Path = STORED) -> list[str]:
    """Return a line for every ratio that has changed too much or is in one of both alone."""
    stored = json.loads(path.read_text('utf-8'))
    lines = []
    for table, measured in ratios.items():
        before = stored.get(table, {})
        for name in before.keys() | measured.keys():
            change = measured.get(name, math.inf) / before.get(name, math.inf)
            if not 1.0 / TOLERANCE <= change <= TOLERANCE:
                numbers = f'{measured.get(name)}, was {before.get(name)}'
                lines.append(f'{table}, {name}: {numbers}')
    return sorted(lines)
