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
"""What the twin says about itself, once a second (REP 107)."""

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
from soft_throw_ros.twin.results import known_values, ThrowResult
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import SECOND

MAX_LATE_SHARE = 0.01
"""What share of the ticks may be late before it is a warning [-]."""

MAX_COMPUTE_SHARE = 0.5
"""What share of the time may go into ticks before it is a warning [-]."""


class Diagnostics:
    """Sums up a second of a session, its ticks and what is measured, at a time."""

    def __init__(
        self, session: Session, ticker: Ticker, measurement: Measurement, *, node_name: str
    ) -> None:
        self._session = session
        self._ticker = ticker
        self._measurement = measurement
        self._node_name = node_name
        self._status = partial(status_to_msg, node_name)
        self._compared: ThrowResult | None = None
        self._time = time.monotonic()
        self._ticks: Counter[str] = Counter()
        self._measured: Counter[str] = Counter()

    def statuses(
        self, result: ThrowResult | None, *, namesakes: int = 0
    ) -> list[DiagnosticStatus]:
        """
        Return the statuses for the time since the last call.

        `result` is the last throw's, and `namesakes` are nodes that publish under the same name.
        """
        if result is not None and result.stage == 'final' and result.comparison is not None:
            self._compared = result
        statuses = [
            *self._timing_and_load(),
            self._parameters(),
            self._layer(result),
            self._name(namesakes),
        ]
        if self._session.is_measured:
            statuses += [self._measurements(), self._model()]
        return statuses

    def _timing_and_load(self) -> list[DiagnosticStatus]:
        """Tell how late the ticks were, and how much time they take."""
        session, ticker, now = self._session, self._ticker, time.monotonic()
        times = ticker.take_times()
        lateness, compute = [late for late, _ in times], [taken for _, taken in times]
        passed, self._time = now - self._time, now
        ticks = ticker.counts.copy()
        news, self._ticks = ticks - self._ticks, ticks
        late, skipped = news['ticks_late'], news['ticks_skipped']
        is_bad = skipped > 0 or late > MAX_LATE_SHARE * len(lateness)
        text = f'{late} ticks late, {skipped} skipped' if is_bad else 'ticks are on time'
        if not news['ticks']:
            is_bad, text = True, f'no tick since the last status: {ticker.describe_standstill()}'
        share = sum(compute) / SECOND / passed
        load = {
            **_percentiles('compute', compute),
            'compute_part': share,
            'real_time_factor': news['ticks'] * session.time_scale / (session.rate * passed),
            'time_scale': session.time_scale,
            'rate': session.rate,
        }
        return [
            self._status(
                'timing',
                text,
                {**_percentiles('lateness', lateness), **ticks, 'scheduler': ticker.scheduler},
                warn=is_bad,
            ),
            self._status(
                'load',
                f'{100.0 * share:.1f} % of the time goes into ticks',
                load,
                warn=share > MAX_COMPUTE_SHARE,
            ),
        ]

    def _parameters(self) -> DiagnosticStatus:
        """Tell which changes are pending."""
        pending = self._session.pending
        text = f'{len(pending)} wait for the next throw or ~/reset'
        return self._status(
            'parameters',
            text if pending else 'none is pending',
            {'pending': len(pending), **pending},
        )

    def _layer(self, result: ThrowResult | None) -> DiagnosticStatus:
        """Tell whether the layer stayed in its linear range in the last throw."""
        if result is None:
            return self._status('layer', 'nothing has been thrown yet')
        strain, limit = 100.0 * result.peak_strain, 100.0 * result.max_strain
        beyond = 'within' if result.is_linear else 'beyond'
        return self._status(
            'layer',
            f'strain of {strain:.1f} % in throw {result.throw}, {beyond} the linear {limit:.3g} %',
            {name: getattr(result, name) for name in ('throw', 'peak_strain', 'max_strain')},
            warn=not result.is_linear,
        )

    def _name(self, namesakes: int) -> DiagnosticStatus:
        """Tell whether others publish under the same name, as if it were this one."""
        text = describe_namesakes(self._node_name) if namesakes else 'no other node has this name'
        return self._status('name', text, {'namesakes': namesakes}, warn=namesakes > 0)

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
            {
                'at_rest': self._session.is_at_rest,
                **{name: news[name] for name in names},
                'clock_offset': clock.offset_ns / SECOND,
                'lead_min': lead,
                **reasons,
            },
            warn=bool(is_bad) or lead <= 0.0 or bool(clock.problem),
        )

    def _model(self) -> DiagnosticStatus:
        """Tell how well the model predicted the last throw."""
        result = self._compared
        if result is None or result.comparison is None:
            return self._status('model', 'no throw has been compared')
        return self._status(
            'model',
            f'throw {result.throw}: {result.comparison.describe()}',
            {'throw': result.throw, **known_values(result.comparison)},
            warn=not result.comparison.is_within_threshold,
        )


def describe_namesakes(node_name: str) -> str:
    """Say that there are two nodes of a name, and what to do."""
    return (
        f'another node is named {node_name}, and both publish on the same topics: '
        'start one of them with -r __ns:=/NAMESPACE or -r __node:=NAME'
    )


def _percentiles(name: str, values: list[int]) -> dict[str, float]:
    """Return median, 99th percentile and largest of nanoseconds, in seconds; zeros if none."""
    names = (f'{name}_{part}' for part in ('p50', 'p99', 'max'))
    found = np.percentile(values or [0], (50, 99, 100)) / SECOND
    return dict(zip(names, found.tolist(), strict=True))
