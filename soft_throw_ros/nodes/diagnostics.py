# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Diagnostic statuses of the twin, once per second (REP 107)."""

from __future__ import annotations

from collections import Counter
from functools import partial
import math
import time

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from soft_throw_ros.nodes.conversions import status_to_msg
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
        self, session: Session, ticker: Ticker, measurement: Measurement, *, node_name: str
    ) -> None:
        self._session = session
        self._ticker = ticker
        self._measurement = measurement
        self._node_name = node_name
        self._status = partial(status_to_msg, node_name)
        self.compared: ThrowResult | None = None  # the last one
        self._time = time.monotonic()
        self._ticks: Counter[str] = Counter()
        self._measured: Counter[str] = Counter()

    def statuses(
        self, result: ThrowResult | None, *, duplicate_nodes: int = 0
    ) -> list[DiagnosticStatus]:
        """
        Return the statuses for the time since the last call.

        `result` is that of the last throw; `duplicate_nodes` other nodes have the same name.
        """
        pending = self._session.pending
        statuses = [
            *self._timing_and_load(),
            self._status(
                'parameters',
                f'{len(pending)} parameter changes wait for the next throw or ~/reset',
                {'pending': len(pending), **pending},
            ),
            self._layer(result),
            self._status(
                'name',
                duplicate_name_warning(self._node_name) if duplicate_nodes else 'unique',
                {'duplicate_nodes': duplicate_nodes},
                warn=duplicate_nodes > 0,
            ),
        ]
        if self._session.is_measured:
            statuses += [self._measurements(), self._model()]
        return statuses

    def _timing_and_load(self) -> list[DiagnosticStatus]:
        """Return the statuses of the lateness and of the processor time of the ticks."""
        session, ticker, now = self._session, self._ticker, time.monotonic()
        times = ticker.take_times()
        lateness, compute = [late for late, _ in times], [duration for _, duration in times]
        passed, self._time = now - self._time, now
        ticks = ticker.counts.copy()
        new, self._ticks = ticks - self._ticks, ticks
        late, skipped = new['ticks_late'], new['ticks_skipped']
        is_bad = skipped > 0 or late > _MAX_LATE_SHARE * len(lateness)
        text = f'{late} ticks late, {skipped} skipped'
        if not new['ticks']:
            is_bad, text = True, f'no tick since the last status: {ticker.stall_reason()}'
        share = sum(compute) / SECOND / passed
        load = {
            **_percentiles('compute', compute),
            'compute_part': share,
            'real_time_factor': new['ticks'] * session.time_scale / (session.rate * passed),
            'time_scale': session.time_scale,
            'rate': session.rate,
        }
        timing = {**_percentiles('lateness', lateness), **ticks, 'scheduler': ticker.scheduler}
        is_loaded = share > _MAX_COMPUTE_SHARE
        return [
            self._status('timing', text, timing, warn=is_bad),
            self._status('load', f'{100.0 * share:.1f} % of the time', load, warn=is_loaded),
        ]

    def _layer(self, result: ThrowResult | None) -> DiagnosticStatus:
        """Return whether the strain of the last throw stayed within the linear range."""
        if result is None:
            return self._status('layer', 'no throw yet')
        return self._status(
            'layer',
            f'strain of {100.0 * result.peak_strain:.1f} % in throw {result.throw}, the linear '
            f'range ends at {100.0 * result.max_strain:.3g} %',
            {name: getattr(result, name) for name in ('throw', 'peak_strain', 'max_strain')},
            warn=not result.is_linear,
        )

    def _measurements(self) -> DiagnosticStatus:
        """Return the status of the received samples and of the prediction lead."""
        measurement, clock = self._measurement, self._measurement.clock
        counts = measurement.count()
        new = {name: count - self._measured[name] for name, count in counts.items()}
        self._measured = counts
        leads, measurement.leads = measurement.leads, []
        lead = min(leads) / SECOND if leads else math.nan
        is_lossy = not new['samples'] or new['samples_refused'] or new['messages_lost']
        problems = [clock.problem] if clock.problem else []
        if lead <= 0.0:
            problems.append(f'prediction {-1e3 * lead:.2f} ms behind the tick')
        text = (
            f'{new["samples"]} samples, {new["messages_lost"]} lost, '
            f'{new["samples_refused"]} refused'
        )
        values = {
            'at_rest': self._session.is_at_rest,
            **{name: count for name, count in new.items() if count or '.' not in name},
            'clock_offset': clock.offset_ns / SECOND,
            'age': measurement.age_ns / SECOND,
            'lead_min': lead,
        }
        is_bad = bool(is_lossy or problems)
        return self._status('measurement', '; '.join([text, *problems]), values, warn=is_bad)

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


def duplicate_name_warning(node_name: str) -> str:
    """Return the warning that another node has the same name, with the remedy."""
    return (
        f'another node is named {node_name}, and both publish on the same topics: '
        'start one of them with -r __ns:=/NAMESPACE or -r __node:=NAME'
    )


def _percentiles(name: str, values: list[int]) -> dict[str, float]:
    """Return median, 99th percentile and maximum of times [ns], in seconds; zeros if none."""
    names = (f'{name}_{statistic}' for statistic in ('p50', 'p99', 'max'))
    percentiles = np.percentile(values or [0], (50, 99, 100)) / SECOND
    return dict(zip(names, percentiles.tolist(), strict=True))
