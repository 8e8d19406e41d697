# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of measured ratios with the stored ones."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
from pathlib import Path

STORED = Path(__file__).with_name('ratios.json')
"""File of the stored ratios."""

TOLERANCE = 1.3
"""Largest factor between a measured and a stored ratio. [-]"""

Ratios = Mapping[str, Mapping[str, float]]


def store(ratios: Ratios, path: Path = STORED) -> None:
    """Replace the stored ratios of the measured tables, and keep those of other tables."""
    stored = json.loads(path.read_text('utf-8')) if path.exists() else {}
    for table, measured in ratios.items():
        if measured:
            stored[table] = {name: float(f'{ratio:.3g}') for name, ratio in measured.items()}
    path.write_text(json.dumps(stored, indent=2, sort_keys=True) + '\n', 'utf-8')


def deviations(ratios: Ratios, path: Path = STORED) -> list[str]:
    """Return a line for every ratio that has changed too much, was not stored or not measured."""
    if not path.exists():
        return [f'{path} does not exist; create it by make bench ARGS=--store']
    stored = json.loads(path.read_text('utf-8'))
    lines = []
    for table, measured in ratios.items():
        if measured and table not in stored:
            lines.append(f'{table}: not stored; store it by make bench ARGS="{table} --store"')
        for name, before in stored.get(table, {}).items():
            now = measured.get(name)
            if now is None:
                lines.append(f'{table}, {name}: not measured, was {before:.3g}')
            elif not abs(math.log(now / before)) <= math.log(TOLERANCE):
                change = 100.0 * (now / before - 1.0)
                lines.append(f'{table}, {name}: {now:.3g}, was {before:.3g} ({change:+.0f} %)')
    return lines
