# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Identify random simulated rigs with known parameters and the faults of real measurements.

The steppers of the twin throw; faults of plate and sensors, which the fitted model lacks, are
added. The output is a Markdown table with a row per fault: the numbers of trials that were
refused, warned about, or silently wrong (a result off by more than 5 standard errors without a
warning), and the fractions of 95 % intervals that contain the true value. The same seed gives the
same table.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
import json
import multiprocessing
from pathlib import Path
import sys

from soft_throw_ros.commands.options import add_dask_option, open_map
from soft_throw_ros.core.batch import usable_processors
from trials.judge import end_with_parent, judge, summary, table_head, table_line, Verdict
from trials.rows import Row, ROWS


def main(args: list[str] | None = None) -> int:
    """Run the trials; return exit code 0."""
    parser = argparse.ArgumentParser(prog='python -m trials', description=__doc__)
    add = parser.add_argument
    add('--rigs', metavar='N', type=int, default=12, help='number of rigs per row (default 12)')
    add('--seed', metavar='N', type=int, default=0, help='seed of the random rigs (default 0)')
    add('--rows', metavar='TEXT', nargs='+', default=[''],
        help='only rows whose names contain one of these texts')
    add('--log', metavar='FILE', type=Path, help='write all verdicts to a file of JSON lines')
    add('--workers', metavar='N', type=int, default=usable_processors(),
        help='number of worker processes without --dask (default: one per processor)')
    add_dask_option(parser)
    arguments = parser.parse_args(args)
    if arguments.rigs < 1:
        parser.error(f'argument --rigs: must be at least 1, got {arguments.rigs}')
    rows = [row for row in ROWS if any(text in row.name for text in arguments.rows)]
    if not rows:
        parser.error(f'argument --rows: no row has any of {", ".join(arguments.rows)} in its name')
    if arguments.dask or arguments.workers == 1:
        with open_map(arguments.dask) as run_trials:
            verdicts = _run(rows, arguments, run_trials)
    else:
        spawn = multiprocessing.get_context('spawn')  # threads do not survive a fork
        with ProcessPoolExecutor(
            arguments.workers, mp_context=spawn, initializer=end_with_parent
        ) as workers:
            verdicts = _run(rows, arguments, workers.map)
    if arguments.log:
        lines = [json.dumps(asdict(verdict)) for verdict in verdicts]
        arguments.log.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    print('', summary(verdicts, [row.name for row in rows if row.is_clean]), sep='\n')
    return 0


def _run(
    rows: list[Row], arguments: argparse.Namespace, run_trials: Callable[..., Iterable[Verdict]]
) -> list[Verdict]:
    """Run the trials of all rows, and print each line of the table when it is complete."""
    verdicts: list[Verdict] = []
    names = [row.name for row in rows for _ in range(arguments.rigs)]
    numbers = [number for _ in rows for number in range(arguments.rigs)]
    results = iter(run_trials(partial(judge, seed=arguments.seed), names, numbers))
    print(*table_head(), sep='\n', flush=True)
    for row in rows:
        verdicts += (of_row := [next(results) for _ in range(arguments.rigs)])
        print(table_line(row.name, of_row), flush=True)
    return verdicts


if __name__ == '__main__':
    sys.exit(main())
