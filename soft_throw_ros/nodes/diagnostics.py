# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostic statuses of the twin, once per second (REP 107)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
import time

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from soft_throw_ros.nodes.measured import Measurement
from soft_throw_ros.nodes.realtime import Ticker
from soft_throw_ros.nodes.texts import comparison_text
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.results import known_values, ThrowResult
from soft_throw_ros.twin.session import Session

_MAX_LATE_SHARE = 0.01  # fraction of late ticks above which the status is a warning [-]
_MAX_COMPUTE_SHARE = 0.5  # fraction of the time in ticks, likewise [-]


class Diagnostics:
    """Summary of a session, its ticks, its measurements and `compared` throws, once a second."""

    def __init__(
        self,
        session: Session,
        ticker: Ticker,
        measurement: Measurement,
        make_status: Callable[..., DiagnosticStatus],
    ) -> None:
        self._session = session
        self._ticker = ticker
        self._measurement = measurement
        self._status = make_status
        self.compared: ThrowResult | None = None  # the last one
        self._time = time.monotonic()
        self._ticks: Counter[str] = Counter()
        self._measured: Counter[str] = Counter()

    def statuses(self) -> list[DiagnosticStatus]:
        """Return the statuses for the time since the last call."""
        pending = self._session.pending
        text = f'{len(pending)} parameter changes wait for the next throw or ~/reset'
        statuses = [
            self._timing(),
            self._status('parameters', text, {'pending': len(pending), **pending}),
        ]
        if self._session.is_measured:
            statuses += [self._measurements(), self._model()]
        return statuses

    def _timing(self) -> DiagnosticStatus:
        """Return the status of the lateness and of the processor time of the ticks."""
        ticker, now = self._ticker, time.monotonic()
        times = np.array(ticker.take_times() or [(0, 0)]) / SECOND  # lateness and duration
        passed, self._time = now - self._time, now
        ticks = ticker.counts.copy()
        new, self._ticks = ticks - self._ticks, ticks
        late, skipped, share = new['ticks_late'], new['ticks_skipped'], times[:, 1].sum() / passed
        text = f'{late} ticks late, {skipped} skipped; {100.0 * share:.1f} % of the time'
        is_bad = skipped > 0 or late > _MAX_LATE_SHARE * len(times) or share > _MAX_COMPUTE_SHARE
        if not new['ticks']:
            is_bad = True
            text = 'no tick since the last status: no processor time, or /clock stands still'
        percentiles = np.percentile(times, (50, 99, 100), axis=0).T.ravel()
        names = [f'{of}_{nth}' for of in ('lateness', 'compute') for nth in ('p50', 'p99', 'max')]
        values = {
            **dict(zip(names, percentiles.tolist(), strict=True)),
            **ticks,
            'compute_part': share,
            'rate': self._session.rate,
            'scheduler': ticker.scheduler,
        }
        return self._status('timing', text, values, warn=is_bad)

    def _measurements(self) -> DiagnosticStatus:
        """Return the status of the received samples."""
        measurement, clock = self._measurement, self._measurement.clock
        counts = measurement.count()
        new = {name: count - self._measured[name] for name, count in counts.items()}
        self._measured = counts
        is_lossy = not new['samples'] or new['samples_refused'] or new['messages_lost']
        text = (
            f'{new["samples"]} samples, {new["messages_lost"]} lost, '
            f'{new["samples_refused"]} refused' + (clock.problem and f'; {clock.problem}')
        )
        values = {
            'at_rest': self._session.is_at_rest,
            **{name: count for name, count in new.items() if count or '.' not in name},
            'clock_offset': clock.offset_ns / SECOND,
            'age': measurement.age_ns / SECOND,
        }
        return self._status('measurement', text, values, warn=bool(is_lossy or clock.problem))

    def _model(self) -> DiagnosticStatus:
        """Return how well the model predicted the last throw."""
        result = self.compared
        if result is None or result.comparison is None:
            return self._status('model', 'no throw has been compared')
        return self._status(
            'model',
            f'throw {result.throw}: {comparison_text(result)}',
            {'throw': result.throw, **known_values(result.comparison)},
            warn=not result.comparison.is_within_threshold,
        )
