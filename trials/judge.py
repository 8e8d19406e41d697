# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the results of `soft-throw identify` with the true values of a trial."""

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
from soft_throw_ros.commands import free_layers, identify
from trials.bench import Trial
from trials.rows import ROWS_BY_NAME

AMBIGUOUS = ('may as well be',)
"""Parts of warnings about a second solution within the errors; clean tracks may have one, too."""

FAR_OFF = 5.0
"""Deviation from which on a result is wrong. [standard errors]"""

_INTERVAL = 1.96
"""Half width of a 95 % interval. [standard errors]"""


class Deviation(NamedTuple):
    """A fitted value, its standard error, and the true value."""

    value: float
    error: float
    truth: float

    @property
    def errors(self) -> float:
        """Absolute deviation from the true value [standard errors]."""
        if self.error == math.inf:
            return 0.0
        return abs(self.value - self.truth) / max(self.error, 1e-12 * abs(self.truth))

    @property
    def is_covered(self) -> bool:
        """Whether the 95 % interval contains the true value."""
        return self.errors <= _INTERVAL


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The outcome of a trial."""

    row: str
    number: int
    refusal: str = ''
    """Error message of the command; empty if the fit succeeded."""
    warnings: tuple[str, ...] = ()
    results: Mapping[str, Deviation]
    """Deviations by the parameter names of the twin; `ejection.*` is the first release."""
    seconds: float
    """Duration of the command [s]."""

    @property
    def alarms(self) -> list[str]:
        """Refusal and warnings, except those about a second solution within the errors."""
        refusals = [self.refusal] if self.refusal else []
        return refusals + [
            warning
            for warning in self.warnings
            if not any(text in warning for text in AMBIGUOUS)
        ]

    @property
    def wrong(self) -> list[str]:
        """Names of the results that are wrong."""
        return [name for name, result in self.results.items() if result.errors > FAR_OFF]

    @property
    def is_silently_wrong(self) -> bool:
        """Whether a result is wrong although the command neither refused nor warned."""
        return not self.refusal and not self.warnings and bool(self.wrong)


def judge(name: str, number: int, *, seed: int, folder: str = '') -> Verdict:
    """
    Draw a trial of a row, identify it by the command, and compare the results with the truth.

    The same seed gives the same trials. With `folder`, the files and the command line are saved
    in a new folder inside it.
    """
    random = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
    trial = ROWS_BY_NAME[name].draw(random)
    with contextlib.ExitStack() as stack:
        if folder:
            path = Path(folder) / f'{"".join(c if c.isalnum() else "_" for c in name)}_{number}'
            path.mkdir(parents=True, exist_ok=True)
        else:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        arguments = [*trial.arguments, *_write(trial, path)]
        if folder:
            command = 'free_layers' if trial.thicknesses else 'identify'
            lines = [shlex.join(['soft-throw', command, *arguments])]
            lines += [f'# {key} {value:.9g}' for key, value in trial.truth.items()]
            (path / 'command.sh').write_text('\n'.join(lines) + '\n', encoding='utf-8')
        start = time.perf_counter()
        report, refusal = _identify(trial, [*arguments, '--json'])
        seconds = time.perf_counter() - start
    return Verdict(
        row=name,
        number=number,
        refusal=refusal.replace(str(path), ''),
        warnings=tuple(report.get('warnings', ())),
        results=compare(report, trial.truth),
        seconds=seconds,
    )


def _write(trial: Trial, folder: Path) -> list[str]:
    """Write the tracks to files; return the arguments of the command that name these files."""
    arguments = []
    bodies = 'bottom,top' if trial.thicknesses else 'plate,projectile'
    for number, record in enumerate(trial.records):
        path = folder / f'{number + 1}.csv'
        np.savetxt(path, record, '%.9g', ',', header=f't,{bodies}', comments='')
        if trial.thicknesses:
            arguments.append(f'{trial.thicknesses[number]:.9g}')
        arguments.append(str(path))
    return arguments


def _identify(trial: Trial, arguments: list[str]) -> tuple[dict[str, Any], str]:
    """Run the command in this process; return its JSON output and its error message."""
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            (free_layers if trial.thicknesses else identify).main(arguments)
        except SystemExit:
            lines = errors.getvalue().strip().splitlines()
            return {}, lines[-1] if lines else 'refused without a message'
    return json.loads(output.getvalue()), ''


def compare(report: dict[str, Any], truth: Mapping[str, float]) -> dict[str, Deviation]:
    """
    Return the deviations of all fitted parameters and of the first release.

    Near a jump of the ejection time the command reports the release one echo earlier or later as
    an alternative with its own value and error. The nearer one of the two counts.
    """
    results = {name: [value] for name, value in report.get('found', {}).items()}
    ejection = report.get('ejection') or {}
    for name in truth:
        group, _, key = name.partition('.')
        if group == 'ejection' and key in ejection:
            releases = [ejection, *ejection.get('alternatives', ())]
            results[name] = [release[key] for release in releases if key in release]
    deviations = {}
    for name, values in results.items():
        if name not in truth:
            continue
        candidates = [
            Deviation(
                value['value'],
                math.inf if value['error'] is None else value['error'],
                truth[name],
            )
            for value in values
            if value and value['value'] is not None
        ]
        if candidates:
            deviations[name] = min(candidates, key=lambda deviation: deviation.errors)
    return deviations
