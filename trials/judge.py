# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Results of `soft-throw identify` beside the true values of trials, and their table."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import contextlib
import ctypes
from dataclasses import dataclass
import io
import json
from pathlib import Path
import signal
import tempfile
import time
from typing import Any, NamedTuple
import zlib

import numpy as np
from soft_throw_ros.commands import identify
from trials.rows import ROWS_BY_NAME

FAR_OFF = 5.0  # deviation from which on a result is wrong [standard errors]
_INTERVAL = 1.96  # half width of a 95 % interval [standard errors]

_COLUMNS = {
    'c_s': ('layer.wave_speed', 'layer.rest_wave_speed'),
    'loss': ('layer.loss_tangent',),
    'A': ('engine.amplitude',),
    'f, zeta': ('engine.frequency', 'engine.damping_ratio'),
    't_e': ('ejection.time',),
    'V_e, alpha': ('ejection.speed', 'ejection.energy_transfer'),
}
"""Quantities whose intervals are counted in a column, by the head of the column."""

HEADS = ('row', 'rigs', 'refused', 'warned', 'silently wrong', 'all', *_COLUMNS)


class Deviation(NamedTuple):
    """A fitted value, its standard error, and the true value."""

    value: float
    error: float
    truth: float

    @property
    def errors(self) -> float:
        """Absolute deviation from the true value [standard errors]."""
        return abs(self.value - self.truth) / max(self.error, 1e-12 * abs(self.truth))


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The outcome of a trial."""

    row: str
    number: int
    refusal: str = ''  # error message of the command, if it refused
    warnings: tuple[str, ...] = ()
    results: Mapping[str, Deviation]  # by the names of the rows of the report
    seconds: float  # duration of the command [s]

    @property
    def is_silently_wrong(self) -> bool:
        """Whether a result is wrong although the command neither refused nor warned."""
        is_wrong = any(result.errors > FAR_OFF for result in self.results.values())
        return is_wrong and not self.refusal and not self.warnings


def judge(name: str, number: int, *, seed: int) -> Verdict:
    """Draw a trial of a row, identify it, and compare the results with the truth."""
    random = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
    trial = ROWS_BY_NAME[name].draw(random)
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder, f'{index + 1}.csv')) for index in range(len(trial.records))]
        for path, record in zip(files, trial.records, strict=True):
            np.savetxt(path, record, '%.9g', ',', header='t,plate,projectile', comments='')
        start = time.perf_counter()
        report, refusal = _identify([*trial.arguments, *files, '--json'])
        seconds = time.perf_counter() - start
    return Verdict(
        row=name,
        number=number,
        refusal=refusal.replace(folder, ''),
        warnings=tuple(report.get('warnings', ())),
        results=compare(report, trial.truth),
        seconds=seconds,
    )


def _identify(arguments: list[str]) -> tuple[dict[str, Any], str]:
    """Run the command in this process; return its JSON output and its error message."""
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            identify.main(arguments)
        except SystemExit:
            return {}, errors.getvalue().strip().splitlines()[-1]
    return json.loads(output.getvalue()), ''


def compare(report: dict[str, Any], truth: Mapping[str, float]) -> dict[str, Deviation]:
    """Return the deviations of the fitted parameters and of the nearest alternative release."""
    deviations: dict[str, Deviation] = {}
    for row in report.get('rows', ()):
        name = row['name']
        if name in truth and row['error'] is not None:
            found = Deviation(row['value'], row['error'], truth[name])
            known = deviations.get(name, found)
            deviations[name] = min(found, known, key=lambda item: item.errors)
    return deviations


def end_with_parent() -> None:
    """Let Linux kill this worker process when its parent has been killed."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)  # PR_SET_PDEATHSIG


def table_head() -> list[str]:
    """Return the head of the table of verdicts in Markdown."""
    return [f'| {" | ".join(HEADS)} |', '|---' + '|---:' * (len(HEADS) - 1) + '|']


def table_line(name: str, verdicts: Sequence[Verdict]) -> str:
    """Return the line of a row."""
    fitted = [verdict for verdict in verdicts if not verdict.refusal]
    names = {name for verdict in fitted for name in verdict.results}
    counts = (
        len(verdicts),
        len(verdicts) - len(fitted),
        sum(bool(verdict.warnings) for verdict in verdicts),
        sum(verdict.is_silently_wrong for verdict in verdicts),
    )
    shares = [_coverage(fitted, quantities) for quantities in (names, *_COLUMNS.values())]
    return f'| {" | ".join([name, *map(str, counts), *shares])} |'


def _coverage(verdicts: Sequence[Verdict], names: Collection[str]) -> str:
    """Return the fraction of 95 % intervals that contain the true value."""
    is_covered = [
        result.errors <= _INTERVAL
        for verdict in verdicts for name, result in verdict.results.items() if name in names
    ]
    return f'{100.0 * sum(is_covered) / len(is_covered):.0f} %' if is_covered else '-'


def summary(verdicts: Sequence[Verdict], clean: Collection[str]) -> str:
    """Compare the numbers of silently wrong trials and of false alarms with their goals."""
    silent = sum(verdict.is_silently_wrong for verdict in verdicts)
    alarms = [
        bool(verdict.refusal or verdict.warnings) for verdict in verdicts if verdict.row in clean
    ]
    return (
        f'{silent} of {len(verdicts)} are silently wrong (goal: 0), and {sum(alarms)} of '
        f'{len(alarms)} clean trials have a false alarm (goal: at most 2 %).'
    )
