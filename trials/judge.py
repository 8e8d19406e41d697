# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the results of `soft-throw identify` with the true values of a trial."""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
from dataclasses import dataclass
import io
import json
import multiprocessing
import os
from pathlib import Path
import tempfile
import threading
import time
from typing import Any, NamedTuple
import zlib

import numpy as np
from soft_throw_ros.commands import identify
from trials.rows import ROWS_BY_NAME

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
    def wrong(self) -> list[str]:
        """Names of the results that are wrong."""
        return [name for name, result in self.results.items() if result.errors > FAR_OFF]

    @property
    def is_silently_wrong(self) -> bool:
        """Whether a result is wrong although the command neither refused nor warned."""
        return not self.refusal and not self.warnings and bool(self.wrong)


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
            lines = errors.getvalue().strip().splitlines()
            return {}, lines[-1] if lines else 'refused without a message'
    return json.loads(output.getvalue()), ''


def compare(report: dict[str, Any], truth: Mapping[str, float]) -> dict[str, Deviation]:
    """
    Return the deviations of all fitted parameters and of the first release.

    Near a jump of the ejection time the command reports the release one echo earlier or later as
    an alternative with its own value and error. The nearer one of the two counts.
    """
    deviations: dict[str, Deviation] = {}
    for row in report.get('rows', ()):
        name = row['name']
        if name in truth and row['error'] is not None:
            deviation = Deviation(row['value'], row['error'], truth[name])
            deviations[name] = min(
                deviation, deviations.get(name, deviation), key=lambda item: item.errors
            )
    return deviations


def end_with_parent() -> None:
    """End this worker process when its parent has been killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
