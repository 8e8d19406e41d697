# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measure the package against simpler methods and plain ROS nodes, and print Markdown tables.

The cases of one table run in turns on one machine, so their ratios can be compared between
machines. Errors are measured as well. A run of all parts takes a few minutes.
"""

from __future__ import annotations

import argparse
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
    """Run the requested parts, by default all; return 1 if ratios have changed."""
    tables = {make.__name__: make for make in sums.TABLES}
    parts = [*tables, *nodes.PARTS]
    parser = argparse.ArgumentParser(prog='python -m bench', description=__doc__)
    parser.add_argument('parts', nargs='*', metavar='PART', help=f'one of {", ".join(parts)}')
    parser.add_argument('--json', type=Path, metavar='FILE', help='also write the tables as JSON')
    parser.add_argument('--check', action='store_true', help='compare with bench/ratios.json')
    parser.add_argument('--store', action='store_true', help='update bench/ratios.json')
    arguments = parser.parse_args()
    names = arguments.parts or parts
    for name in names:
        if name not in parts:
            parser.error(f'unknown part {name!r}; choose from {", ".join(parts)}')
    print(_machine())
    results: dict[str, race.Result] = {}
    for name in names:
        if name in nodes.PARTS and importlib.util.find_spec('rclpy') is None:
            print(f'\n{name}: skipped, because rclpy is not installed.')
            continue
        load = os.getloadavg()[0]
        results[name] = race.measure(tables[name]()) if name in tables else nodes.PARTS[name]()
        print('', *results[name].lines(), sep='\n')
        print(f'Load before and after: {load:.1f}, {os.getloadavg()[0]:.1f}.', flush=True)
    if arguments.json is not None:
        document = {
            'machine': _machine(),
            'tables': {name: result._asdict() for name, result in results.items()},
        }
        arguments.json.write_text(json.dumps(document, indent=2) + '\n', 'utf-8')
    ratios = {name: result.ratios for name, result in results.items()}
    if arguments.store:
        check.store(ratios)
    changed = check.deviations(ratios) if arguments.check else []
    print(*changed, sep='\n', file=sys.stderr)
    return 1 if changed else 0


def _machine() -> str:
    """Return the processor and the versions of the numerical libraries."""
    lines = Path('/proc/cpuinfo').read_text('utf-8').splitlines()
    names = [line.partition(': ')[2] for line in lines if line.startswith('model name')]
    return (
        f'{(names or [platform.machine()])[0]}, {os.cpu_count()} cores; '
        f'Python {platform.python_version()}, numpy {np.__version__}, numba {nb.__version__}, '
        f'scipy {scipy.__version__}'
    )


if __name__ == '__main__':
    sys.exit(main())
