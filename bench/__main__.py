# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Measure the package against simpler methods and plain ROS nodes, and print Markdown tables.

The cases of one table run in turns on one machine, so their ratios can be compared between
machines. Errors are measured as well. A run of all parts takes two minutes.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import platform
import sys

from bench import nodes, sums, tables
import numba as nb
import numpy as np
import scipy

TABLES = (sums.throws, sums.real_time, sums.recommendation, nodes.twin, nodes.recorder)
PARTS = {function.__name__: function for function in TABLES}


def main() -> int:
    """Run the requested parts, by default all; return 1 if ratios have changed."""
    parser = argparse.ArgumentParser(prog='python -m bench', description=__doc__)
    parser.add_argument('parts', nargs='*', metavar='PART', help=f'one of {", ".join(PARTS)}')
    parser.add_argument('--check', action='store_true', help='compare with bench/ratios.json')
    parser.add_argument('--store', action='store_true', help='update bench/ratios.json')
    arguments = parser.parse_args()
    if unknown := set(arguments.parts) - PARTS.keys():
        parser.error(f'unknown part {unknown.pop()!r}; choose from {", ".join(PARTS)}')
    print(_machine())
    ratios = {}
    for name in arguments.parts or PARTS:
        load = os.getloadavg()[0]
        result = PARTS[name]()
        ratios[name] = result.ratios
        print('', *result.lines(), sep='\n')
        print(f'Load before and after: {load:.1f}, {os.getloadavg()[0]:.1f}.', flush=True)
    if arguments.store:
        tables.store(ratios)
    changed = tables.deviations(ratios) if arguments.check else []
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
