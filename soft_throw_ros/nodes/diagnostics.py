# SPDX-License-Identifier: Apache-2.0
"""What the twin says about itself, once a second (REP 107)."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.nodes.conversions import status_to_msg
from soft_throw_ros.nodes.measured import MeasuredSteps
from soft_throw_ros.nodes.realtime import percentiles, SECOND, Ticker
from soft_throw_ros.twin.results import ThrowResult
from soft_throw_ros.twin.session import Session

MAX_LATE_SHARE = 0.01
"""What share of the ticks may be late before it is a warning. [-]"""

MAX_COMPUTE_SHARE = 0.5
"""What share of the time may go into ticks before it is a warning. [-]"""


class DiagnosticsPublisher:
    """
    Sums up a second at a time.

    Parameters
    ----------
    session : Session
        Whose steps are counted, and whose changes are pending.
    ticker : Ticker
        What asks for the steps.
    steps : MeasuredSteps
        What the rig measures.
    node_name : str
        Full name of the node, which the names of the statuses begin with.

    """

    def __init__(
        self, session: Session, ticker: Ticker, steps: MeasuredSteps, *, node_name: str
    ) -> None:
        self._session = session
        self._ticker = ticker
        self._steps = steps
        self._node_name = node_name
        self._compared: ThrowResult | None = None
        self._time = time.monotonic()
        self._ticks = self._late = self._skipped = 0

    def statuses(self, result: ThrowResult | None) -> list[DiagnosticStatus]:
        """Return the statuses for the time since the last call; `result` is the last throw's."""
        if result is not None and result.stage == 'final' and result.comparison is not None:
            self._compared = result
        lateness, compute = self._ticker.statistics.take()
        statuses = [
            self._timing(lateness),
            self._load(compute),
            self._parameters(),
            self._layer(result),
        ]
        if self._session.is_measured:
            statuses += [self._measurement(), self._model()]
        return statuses

    def _timing(self, lateness: list[int]) -> DiagnosticStatus:
        """Tell how late the ticks were."""
        statistics = self._ticker.statistics
        late, self._late = statistics.late - self._late, statistics.late
        skipped, self._skipped = statistics.skipped - self._skipped, statistics.skipped
        p50, p99, largest = percentiles(lateness)
        is_bad = skipped > 0 or late > MAX_LATE_SHARE * len(lateness)
        return self._status(
            'timing',
            f'{late} ticks late, {skipped} skipped' if is_bad else 'ticks are on time',
            warn=is_bad,
            lateness_p50=p50,
            lateness_p99=p99,
            lateness_max=largest,
            ticks=statistics.ticks,
            ticks_late=statistics.late,
            ticks_skipped=statistics.skipped,
            ticks_caught_up=statistics.caught_up,
            clock_jumps=statistics.jumps,
            scheduler=self._ticker.scheduler,
        )

    def _load(self, compute: list[int]) -> DiagnosticStatus:
        """Tell how much time the ticks take."""
        session, statistics = self._session, self._ticker.statistics
        ticks, self._ticks = statistics.ticks - self._ticks, statistics.ticks
        now = time.monotonic()
        passed, self._time = now - self._time, now
        p50, p99, largest = percentiles(compute)
        share = sum(compute) / SECOND / passed
        return self._status(
            'load',
            f'{100.0 * share:.1f} % of the time goes into ticks',
            warn=share > MAX_COMPUTE_SHARE,
            compute_p50=p50,
            compute_p99=p99,
            compute_max=largest,
            compute_part=share,
            real_time_factor=ticks * session.time_scale / (session.rate * passed),
            time_scale=session.time_scale,
            rate=session.rate,
        )

    def _parameters(self) -> DiagnosticStatus:
        """Tell which changes are pending."""
        pending = self._session.pending
        return self._status(
            'parameters',
            f'{len(pending)} wait for the next throw or ~/reset' if pending else 'none is pending',
            warn=False,
            pending=len(pending),
            **pending,
        )

    def _layer(self, result: ThrowResult | None) -> DiagnosticStatus:
        """Tell whether the layer stayed in its linear range in the last throw."""
        if result is None:
            return self._status('layer', 'nothing has been thrown yet', warn=False)
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

    def _measurement(self) -> DiagnosticStatus:
        """Tell how many measurements came, and how far ahead the projectile was known."""
        statistics = self._steps.take_statistics()
        refused = sum(statistics.refused.values())
        lead = min(statistics.leads) / SECOND if statistics.leads else math.nan
        message = f'{statistics.taken} samples' if statistics.taken else 'nothing is measured'
        if refused or statistics.lost:
            reasons = ', '.join(f'{count} {why}' for why, count in statistics.refused.items())
            message += f', {statistics.lost} lost, {refused} refused'
            message += f': {reasons}' if reasons else ''
        if lead <= 0.0:
            message += f'; the projectile is known {-1e3 * lead:.2f} ms too late'
        return self._status(
            'measurement',
            message,
            warn=not statistics.taken or refused > 0 or statistics.lost > 0 or lead <= 0.0,
            at_rest=self._session.is_at_rest,
            samples=statistics.taken,
            samples_out_of_order=statistics.disordered,
            messages=statistics.received,
            messages_lost=statistics.lost,
            samples_refused=refused,
            lead_min=lead,
            **{f'refused.{reason}': count for reason, count in statistics.refused.items()},
        )

    def _model(self) -> DiagnosticStatus:
        """Tell how well the model predicted the last throw."""
        result = self._compared
        if result is None or result.comparison is None:
            return self._status('model', 'no throw has been compared', warn=False)
        comparison = result.comparison
        values = {
            name: value
            for name, value in dataclasses.asdict(comparison).items()
            if value is not None
        }
        return self._status(
            'model',
            f'throw {result.throw}: {comparison.describe()}',
            warn=not comparison.is_within_threshold,
            throw=result.throw,
            **values,
        )

    def _status(self, task: str, message: str, *, warn: bool, **values: Any) -> DiagnosticStatus:
        level = DiagnosticStatus.WARN if warn else DiagnosticStatus.OK
        return status_to_msg(self._node_name, task, message, values, level=level)
