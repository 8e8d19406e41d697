# SPDX-License-Identifier: Apache-2.0
"""What the twin says about itself, once a second (REP 107)."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from soft_throw_ros.nodes.conversions import status_to_msg
from soft_throw_ros.nodes.measured import Measurement
from soft_throw_ros.nodes.realtime import SECOND, Ticker
from soft_throw_ros.twin.results import ThrowResult
from soft_throw_ros.twin.session import Session

MAX_LATE_SHARE = 0.01
"""What share of the ticks may be late before it is a warning. [-]"""

MAX_COMPUTE_SHARE = 0.5
"""What share of the time may go into ticks before it is a warning. [-]"""


class Diagnostics:
    """Sums up a second of a session, its ticks and what is measured, at a time."""

    def __init__(
        self, session: Session, ticker: Ticker, measurement: Measurement, *, node_name: str
    ) -> None:
        self._session = session
        self._ticker = ticker
        self._measurement = measurement
        self._node_name = node_name
        self._compared: ThrowResult | None = None
        self._time = time.monotonic()
        self._ticks: Counter[str] = Counter()
        self._measured: Counter[str] = Counter()

    def statuses(self, result: ThrowResult | None) -> list[DiagnosticStatus]:
        """Return the statuses for the time since the last call; `result` is the last throw's."""
        if result is not None and result.stage == 'final' and result.comparison is not None:
            self._compared = result
        lateness, compute = self._ticker.statistics.take()
        ticks = Counter(self._ticker.statistics.counts())
        news, self._ticks = ticks - self._ticks, ticks
        statuses = [
            self._timing(lateness, ticks, news),
            self._load(compute, news),
            self._parameters(),
            self._layer(result),
        ]
        if self._session.is_measured:
            statuses += [self._measurements(), self._model()]
        return statuses

    def _timing(
        self, lateness: list[int], ticks: Counter[str], news: Counter[str]
    ) -> DiagnosticStatus:
        """Tell how late the ticks were."""
        late, skipped = news['ticks_late'], news['ticks_skipped']
        is_bad = skipped > 0 or late > MAX_LATE_SHARE * len(lateness)
        return self._status(
            'timing',
            f'{late} ticks late, {skipped} skipped' if is_bad else 'ticks are on time',
            warn=is_bad,
            **_percentiles('lateness', lateness),
            **ticks,
            scheduler=self._ticker.scheduler,
        )

    def _load(self, compute: list[int], news: Counter[str]) -> DiagnosticStatus:
        """Tell how much time the ticks take."""
        session, now = self._session, time.monotonic()
        passed, self._time = now - self._time, now
        share = sum(compute) / SECOND / passed
        return self._status(
            'load',
            f'{100.0 * share:.1f} % of the time goes into ticks',
            warn=share > MAX_COMPUTE_SHARE,
            **_percentiles('compute', compute),
            compute_part=share,
            real_time_factor=news['ticks'] * session.time_scale / (session.rate * passed),
            time_scale=session.time_scale,
            rate=session.rate,
        )

    def _parameters(self) -> DiagnosticStatus:
        """Tell which changes are pending."""
        pending = self._session.pending
        text = (
            f'{len(pending)} wait for the next throw or ~/reset' if pending else 'none is pending'
        )
        return self._status('parameters', text, warn=False, pending=len(pending), **pending)

    def _layer(self, result: ThrowResult | None) -> DiagnosticStatus:
        """Tell whether the layer stayed in its linear range in the last throw."""
        if result is None:
            return self._status('layer', 'nothing has been thrown yet')
        strain, limit = 100.0 * result.peak_strain, 100.0 * result.max_strain
        beyond = 'within' if result.is_linear else 'beyond'
        return self._status(
            'layer',
            f'strain of {strain:.1f} % in throw {result.throw}, {beyond} the linear {limit:.3g} %',
            warn=not result.is_linear,
            throw=result.throw,
            peak_strain=result.peak_strain,
            max_strain=result.max_strain,
        )

    def _measurements(self) -> DiagnosticStatus:
        """Tell how many measurements came, and how far ahead the projectile was known."""
        counts = self._measurement.count()
        news, self._measured = counts - self._measured, counts
        leads, self._measurement.leads = self._measurement.leads, []
        lead = min(leads) / SECOND if leads else math.nan
        clock = self._measurement.clock
        names = (
            'samples',
            'samples_out_of_order',
            'samples_jumped',
            'messages',
            'messages_lost',
            'samples_refused',
        )
        reasons = {name: count for name, count in news.items() if name.startswith('refused.')}
        is_bad = not news['samples'] or news['samples_refused'] or news['messages_lost']
        return self._status(
            'measurement',
            f'{news["samples"]} samples, {news["messages_lost"]} lost, '
            f'{news["samples_refused"]} refused'
            + (f'; {clock.problem}' if clock.problem else '')
            + (f'; the projectile is known {-1e3 * lead:.2f} ms too late' if lead <= 0.0 else ''),
            warn=bool(is_bad) or lead <= 0.0 or bool(clock.problem),
            at_rest=self._session.is_at_rest,
            **{name: news[name] for name in names},
            clock_offset=clock.offset_ns / SECOND,
            lead_min=lead,
            **reasons,
        )

    def _model(self) -> DiagnosticStatus:
        """Tell how well the model predicted the last throw."""
        result = self._compared
        if result is None or result.comparison is None:
            return self._status('model', 'no throw has been compared')
        comparison = result.comparison
        values = {name: item for name, item in asdict(comparison).items() if item is not None}
        return self._status(
            'model',
            f'throw {result.throw}: {comparison.describe()}',
            warn=not comparison.is_within_threshold,
            throw=result.throw,
            **values,
        )

    def _status(
        self, task: str, message: str, *, warn: bool = False, **values: Any
    ) -> DiagnosticStatus:
        return status_to_msg(self._node_name, task, message, values, warn=warn)


def _percentiles(name: str, values: list[int]) -> dict[str, float]:
    """Return median, 99th percentile and largest of nanoseconds, in seconds; zeros if none."""
    names = (f'{name}_{part}' for part in ('p50', 'p99', 'max'))
    found = np.percentile(values or [0], (50, 99, 100)) / SECOND
    return dict(zip(names, found.tolist(), strict=True))
