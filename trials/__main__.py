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
"""
Identify random rigs whose truth is known, with all that goes wrong on a bench.

They are simulated by something else than what is fitted: small cells with large strain. Out comes
a Markdown table: how many are refused, warned about, or silently wrong (more than 5 errors off
without a word), and how many 95 % intervals hold the truth. The same seed gives the same table.
"""

from __future__ import annotations

import argparse
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
import json
import os
from pathlib import Path
import sys

from soft_throw_ros.commands.options import add_executor_options, open_executor
from trials import table
from trials.judge import judge, Verdict
from trials.rows import Row, ROWS


def main(args: list[str] | None = None) -> int:
    """Run the trials; return exit code 0."""
    parser = argparse.ArgumentParser(prog='python -m trials', description=__doc__)
    parser.add_argument(
        '--rigs', metavar='N', type=int, default=12, help='in each row (default 12)'
    )
    parser.add_argument('--seed', metavar='N', type=int, default=0)
    parser.add_argument(
        '--rows', metavar='TEXT', nargs='+', default=[''],
        help='only rows whose names contain one of these',
    )
    parser.add_argument('--list', action='store_true', help='say what rows there are, and end')
    parser.add_argument(
        '--log', metavar='FILE', type=Path, help='write all verdicts into it (JSON lines)'
    )
    parser.add_argument(
        '--keep',
        metavar='FOLDER',
        default='',
        help='keep tracks, and command lines for them, there',
    )
    add_executor_options(parser)
    parser.set_defaults(workers=os.cpu_count())
    arguments = parser.parse_args(args)
    if arguments.rigs < 1:
        parser.error(f'argument --rigs: must be at least 1, got {arguments.rigs}')
    rows = [row for row in ROWS if any(text in row.name for text in arguments.rows)]
    if not rows:
        parser.error(f'argument --rows: no row has any of {", ".join(arguments.rows)} in its name')
    if arguments.list:
        print(*(row.name for row in rows), sep='\n')
        return 0
    with open_executor(arguments) as executor:
        verdicts = _run(rows, arguments, executor)
    if arguments.log:
        lines = [json.dumps(asdict(verdict)) for verdict in verdicts]
        arguments.log.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    print('', *table.summary(verdicts, [row.name for row in rows if row.is_clean]), sep='\n')
    return 0


def _run(
    rows: list[Row], arguments: argparse.Namespace, executor: Executor | None
) -> list[Verdict]:
    """Go through all rows, and print the table line by line."""
    verdicts = []
    names = [row.name for row in rows for _ in range(arguments.rigs)]
    numbers = [number for _ in rows for number in range(arguments.rigs)]
    work = partial(judge, seed=arguments.seed, kept=arguments.keep)
    spread = map if executor is None else executor.map
    results = iter(spread(work, names, numbers))
    print(*table.header(), sep='\n', flush=True)
    for row in rows:
        found = [next(results) for _ in range(arguments.rigs)]
        print(table.line(row.name, found), flush=True)
        verdicts += found
    return verdicts


if __name__ == '__main__':
    sys.exit(main())
