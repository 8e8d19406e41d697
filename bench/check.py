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
"""Hold the ratios of a run against those that were stored."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
from pathlib import Path

STORED = Path(__file__).with_name('ratios.json')
ALLOWED = 1.3
"""By this factor a ratio may be larger or smaller. [-]"""

Ratios = Mapping[str, Mapping[str, float]]


def store(ratios: Ratios, path: Path = STORED) -> None:
    """Store ratios by table and name in place of those that are there for these tables."""
    stored = json.loads(path.read_text('utf-8')) if path.exists() else {}
    for table, found in ratios.items():
        if found:
            stored[table] = {name: float(f'{ratio:.3g}') for name, ratio in found.items()}
    path.write_text(json.dumps(stored, indent=2, sort_keys=True) + '\n', 'utf-8')


def deviations(ratios: Ratios, path: Path = STORED) -> list[str]:
    """Say which ratios are too far from those stored, and which are stored and not measured."""
    if not path.exists():
        return [f'{path} is not there yet; make bench ARGS=--store writes it']
    stored = json.loads(path.read_text('utf-8'))
    said = []
    for table, found in ratios.items():
        if found and table not in stored:
            said.append(f'{table}: not stored yet; make bench ARGS="{table} --store" does it')
        for name, before in stored.get(table, {}).items():
            now = found.get(name)
            if now is None:
                said.append(f'{table}, {name}: not measured, was {before:.3g}')
            elif not abs(math.log(now / before)) <= math.log(ALLOWED):
                change = 100.0 * (now / before - 1.0)
                said.append(f'{table}, {name}: {now:.3g}, was {before:.3g} ({change:+.0f} %)')
    return said
