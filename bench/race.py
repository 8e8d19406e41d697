# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
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
    left_out: tuple[str, ...] = ()
    close: Callable[[], None] = lambda: None  # when it has been measured


class Result(NamedTuple):
    """
    A table that was measured.

    Attributes
    ----------
    heads : list of str
        Of the columns.
    rows : list of list
        A title, and numbers; None where there is none.
    ratios : dict of str to float
        Of costs within this run, which are to stay as they are.
    left_out : tuple of str
        What is not compared with, and why.

    """

    heads: list[str]
    rows: list[list[str | float | None]]
    ratios: dict[str, float]
    left_out: tuple[str, ...] = ()

    @classmethod
    def under(cls, *heads: str) -> Result:
        """Begin a table with these heads."""
        return cls(list(heads), [], {})

    def lines(self) -> list[str]:
        """Write it in Markdown."""
        lines = head(*self.heads)
        for title, *cells in self.rows:
            texts = ['-' if cell is None else f'{cell:.4g}' for cell in cells]
            lines.append(f'| {title} | {" | ".join(texts)} |')
        return [*lines, '', *(f'Left out: {reason}.' for reason in self.left_out)]


class Times(NamedTuple):
    """Of one call: by the clock, and of processor time, which a busy machine hardly raises [s]."""

    least: float
    median: float
    processor: float


def race(calls: Mapping[str, Callable[[], Any]]) -> dict[str, Times]:
    """Time calls, in turns; each is made once before it counts, and so is compiled."""
    counts: dict[str, int] = {}
    for name, call in calls.items():
        call()
        counts[name] = max(1, round(SHORTEST / _time(call, 1)[1]))
    seen: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    for _ in range(REPETITIONS):
        for name, call in calls.items():
            if sum(wall for wall, _ in seen[name]) * counts[name] < BUDGET:
                seen[name].append(_time(call, counts[name]))
    times = {}
    for name, pairs in seen.items():
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
    )._replace(left_out=table.left_out)
    for case in table.cases:
        shown = [
            1e6 * part / case.units if not table.is_factor else case.units / part
            for part in times[case.name][:2]
        ]
        error = None if case.error is None else case.error(case.call())
        ratio = times[case.name].processor / case.units / base
        result.rows.append([case.name, error, *shown, ratio, case.goal])
        if case is not first:
            result.ratios[case.name] = ratio
    table.close()
    return result


def head(*cells: str) -> list[str]:
    """Return the head of a Markdown table."""
    return [f'| {" | ".join(cells)} |', '|---' * len(cells) + '|']


def _time(call: Callable[[], Any], count: int) -> tuple[float, float]:
    """Return what one call takes by the clock, and of processor time [s]."""
    start, used = time.perf_counter(), time.process_time()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count, (time.process_time() - used) / count
