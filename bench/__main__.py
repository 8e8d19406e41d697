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
Compare with other ways to get the same numbers, in Markdown tables.

Trust the ratios: all that stands in one table ran in turns on one machine. Errors are measured,
too. It takes a few minutes. What requirements/bench.txt names is compared with if it is installed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import importlib.util
import json
import os
from pathlib import Path
import platform
import sys

from bench import check, nodes, race, sums
import numba as nb
import numpy as np
import scipy


def main() -> int:
    """Run the parts that are asked for, all by default; return 1 if ratios have changed."""
    of_sums = {make.__name__: make for make in sums.TABLES}
    parts = [*of_sums, *nodes.PARTS]
    parser = argparse.ArgumentParser(prog='python -m bench', description=__doc__)
    parser.add_argument('parts', nargs='*', metavar='PART', help=f'one of {", ".join(parts)}')
    parser.add_argument('--json', type=Path, metavar='FILE', help='and write it there as JSON')
    parser.add_argument('--check', action='store_true', help='compare with bench/ratios.json')
    parser.add_argument('--store', action='store_true', help='write bench/ratios.json anew')
    arguments = parser.parse_args()
    chosen = arguments.parts or parts
    for name in chosen:
        if name not in parts:
            parser.error(f'there is no part {name!r}; there are: {", ".join(parts)}')
    print(_machine())
    results: dict[str, race.Result] = {}
    for name in chosen:
        before = os.getloadavg()[0]
        if name in nodes.PARTS and importlib.util.find_spec('rclpy') is None:
            print(f'\n{name}: left out, rclpy is not installed.')
            continue
        results[name] = _run(nodes.PARTS[name] if name in nodes.PARTS else of_sums[name])
        print('', *results[name].lines(), sep='\n')
        print(f'Load before and after: {before:.1f}, {os.getloadavg()[0]:.1f}.', flush=True)
    if arguments.json is not None:
        tables = {name: result._asdict() for name, result in results.items()}
        text = json.dumps({'machine': _machine(), 'tables': tables}, indent=2)
        arguments.json.write_text(text + '\n', 'utf-8')
    ratios = {name: result.ratios for name, result in results.items()}
    if arguments.store:
        check.store(ratios)
    said = check.deviations(ratios) if arguments.check else []
    print(*said, sep='\n', file=sys.stderr)
    return 1 if said else 0


def _run(make: Callable[[], race.Table | race.Result]) -> race.Result:
    """Measure a part."""
    made = make()
    return race.measure(made) if isinstance(made, race.Table) else made


def _machine() -> str:
    """Say where this runs."""
    lines = Path('/proc/cpuinfo').read_text('utf-8').splitlines()
    names = [line.partition(': ')[2] for line in lines if line.startswith('model name')]
    return (
        f'{(names or [platform.machine()])[0]}, {os.cpu_count()} cores; '
        f'Python {platform.python_version()}, numpy {np.__version__}, numba {nb.__version__}, '
        f'scipy {scipy.__version__}'
    )


if __name__ == '__main__':
    sys.exit(main())
