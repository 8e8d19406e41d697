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
"""What `soft-throw identify` makes of a trial, and how far off that is."""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
from dataclasses import dataclass
import io
import json
import math
from pathlib import Path
import shlex
import tempfile
import time
from typing import Any, NamedTuple
import zlib

import numpy as np
from soft_throw_ros.commands import identify
from trials.bench import Trial
from trials.rows import ROWS_BY_NAME

AMBIGUOUS = ('may as well be', 'one echo of the wave earlier or later')
"""In warnings of clean tracks, too: there is a second solution within the errors."""

FAR_OFF = 5.0
"""Errors from which on a number is wrong."""

_INTERVAL = 1.96  # errors on either side that hold 95 %


class Deviation(NamedTuple):
    """Of a number that was found: what it is, and what it should be."""

    value: float
    error: float
    truth: float

    @property
    def errors(self) -> float:
        """How many errors it is off."""
        if self.error == math.inf:
            return 0.0
        return abs(self.value - self.truth) / max(self.error, 1e-12 * abs(self.truth))

    @property
    def is_held(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        return self.errors <= _INTERVAL


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What became of a trial."""

    row: str
    number: int
    refusal: str = ''
    """Why the command refused it; empty if it did not."""
    warnings: tuple[str, ...] = ()
    found: Mapping[str, Deviation]
    """Names are those of the twin; `ejection.*` is by the model, `averages.*` without one."""
    seconds: float
    """That it took."""

    @property
    def alarms(self) -> list[str]:
        """List what blames something, and does not only name what explains the tracks as well."""
        refusals = [self.refusal] if self.refusal else []
        found = [each for each in self.warnings if not any(word in each for word in AMBIGUOUS)]
        return refusals + found

    @property
    def wrong(self) -> list[str]:
        """List what is far off."""
        return [name for name, each in self.found.items() if each.errors > FAR_OFF]

    @property
    def is_silently_wrong(self) -> bool:
        """Whether something is far off without a word."""
        return not self.refusal and not self.warnings and bool(self.wrong)


def judge(name: str, number: int, *, seed: int, kept: str = '') -> Verdict:
    """
    Draw a trial of the row of that name, and have the command identify it.

    The same seed gives the same trials. Files and a command line are kept in a folder, if any.
    """
    random = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
    trial = ROWS_BY_NAME[name].draw(random)
    with contextlib.ExitStack() as stack:
        if kept:
            folder = Path(kept) / f'{"".join(c if c.isalnum() else "_" for c in name)}_{number}'
            folder.mkdir(parents=True, exist_ok=True)
        else:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        arguments = [*trial.arguments, *_write(trial, folder)]
        if kept:
            lines = [shlex.join(['soft-throw', 'identify', *arguments])]
            lines += [f'# {name} {value:.9g}' for name, value in trial.truth.items()]
            (folder / 'command.sh').write_text('\n'.join(lines) + '\n', encoding='utf-8')
        began = time.perf_counter()
        report, refusal = _identify([*arguments, '--json'])
        seconds = time.perf_counter() - began
    return Verdict(
        row=name,
        number=number,
        refusal=refusal.replace(str(folder), ''),
        warnings=tuple(report.get('warnings', ())),
        found=_compare(report, trial.truth),
        seconds=seconds,
    )


def _write(trial: Trial, folder: Path) -> list[str]:
    """Write the files, and return the arguments that name them."""
    arguments = []
    bodies = 'bottom,top' if trial.thicknesses else 'plate,projectile'
    for number, record in enumerate(trial.records):
        path = folder / f'{number + 1}.csv'
        np.savetxt(path, record, '%.9g', ',', header=f't,{bodies}', comments='')
        if trial.thicknesses:
            arguments += ['--free-layer', f'{trial.thicknesses[number]:.9g}']
        arguments.append(str(path))
    return arguments


def _identify(arguments: list[str]) -> tuple[dict[str, Any], str]:
    """Run the command in this process; return what it prints, and why it refuses."""
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            identify.main(arguments)
        except SystemExit:
            lines = errors.getvalue().strip().splitlines()
            return {}, lines[-1] if lines else 'without a word'
    return json.loads(output.getvalue()), ''


def _compare(report: dict[str, Any], truth: Mapping[str, float]) -> dict[str, Deviation]:
    """Compare all that was found with what is right."""
    throws = report.get('throws', [])
    averages = throws[0]['running_averages'] if len(throws) == 1 else None
    found = dict(report.get('found', {}))
    for how, results in (('ejection', report.get('ejection')), ('averages', averages)):
        found |= {f'{how}.{name}': value for name, value in (results or {}).items()}
    deviations = {}
    for name, value in found.items():
        if name in truth and value and value['value'] is not None:
            error = math.inf if value['error'] is None else value['error']
            deviations[name] = Deviation(value['value'], error, truth[name])
    return deviations
