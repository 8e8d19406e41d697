# SPDX-License-Identifier: Apache-2.0
"""
Compare with other ways to get the same numbers, in Markdown tables.

Trust the ratios: all that stands in one table ran in turns on one machine. Errors are measured,
too. It takes a few minutes. PART is one or more of one_throw, landscape, one_second,
recommendation, smoothing, twin, recorder and start.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
import importlib.util
import os
from pathlib import Path
import platform

import numba as nb
import numpy as np
import scipy

from bench import nodes, race, sums


def main() -> None:
    """Run the parts that are asked for, all by default."""
    of_sums: dict[str, Callable[[], list[str]]] = {
        name: partial(_rows, make) for name, make in sums.tables()
    }
    parts = {**of_sums, **nodes.PARTS}
    parser = argparse.ArgumentParser(prog='python -m bench', description=__doc__)
    parser.add_argument('parts', nargs='*', metavar='PART')
    chosen = parser.parse_args().parts or list(parts)
    for name in chosen:
        if name not in parts:
            parser.error(f'there is no part {name!r}; there are: {", ".join(parts)}')
    print(_machine())
    for name in chosen:
        before = os.getloadavg()[0]
        if name in nodes.PARTS and importlib.util.find_spec('rclpy') is None:
            lines = [f'{name}: left out, rclpy is not installed.']
        else:
            lines = parts[name]()
        print('', *lines, '', sep='\n')
        print(f'Load before and after: {before:.1f}, {os.getloadavg()[0]:.1f}.', flush=True)


def _rows(make: Callable[[], race.Table]) -> list[str]:
    return race.rows(make())


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
    main()
