# SPDX-License-Identifier: Apache-2.0
"""What the twin says about itself, once a second (REP 107)."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.nodes.conversions import status_to_msg
from soft_throw_ros.nodes.measured import Account, MeasuredSteps
from soft_throw_ros.nodes.realtime import percentiles, SECOND, Ticker
from soft_throw_ros.twin.results import ThrowResult
from soft_throw_ros.twin.session import Session

TOLERATED = 0.01
"""What part of the ticks may be late before it is called bad. [-]"""

BUSY = 0.5
"""What part of the time may go into ticks before it is called bad. [-]"""


class Observer:
    """
    Sum up a second at a time.

    Parameters
    ----------
    session : Session
        Whose steps are counted, and whose changes wait.
    ticker : Ticker
        What asks for the steps.
    steps : MeasuredSteps
        What the rig measures.
    name : str
        Of the node, which the names of the statuses begin with.
    hardware_id : str
        Full name of the node.

    """

    def __init__(
        self,
        session: Session,
        ticker: Ticker,
        steps: MeasuredSteps,
        *,
        name: str,
        hardware_id: str,
    ) -> None:
        self._session = session
        self._ticker = ticker
        self._steps = steps
        self._name = name
        self._hardware_id = hardware_id
        self._compared: ThrowResult | None = None
        self._time = time.monotonic()
        self._ticks = self._late = self._skipped = 0

    def statuses(self, result: ThrowResult | None) -> list[DiagnosticStatus]:
        """Return the statuses for the time since the last call; `result` is the last throw's."""
        if result is not None and result.stage == 'final' and result.comparison is not None:
            self._compared = result
        lateness, compute = self._ticker.account.take()
        statuses = [
            self._deadlines(lateness),
            self._load(compute),
            self._parameters(),
            self._layer(result),
        ]
        if self._session.is_measured:
            statuses += [self._measurement(self._steps.account()), self._model(self._compared)]
        return statuses

    def _deadlines(self, lateness: list[int]) -> DiagnosticStatus:
        account = self._ticker.account
        late, self._late = account.late - self._late, account.late
        skipped, self._skipped = account.skipped - self._skipped, account.skipped
        p50, p99, largest = percentiles(lateness)
        is_bad = skipped > 0 or late > TOLERATED * len(lateness)
        return self._status(
            'deadlines',
            f'{late} ticks late, {skipped} skipped' if is_bad else 'ticks are on time',
            warn=is_bad,
            lateness_p50=p50,
            lateness_p99=p99,
            lateness_max=largest,
            ticks=account.ticks,
            ticks_late=account.late,
            ticks_skipped=account.skipped,
            ticks_caught_up=account.caught_up,
            clock_jumps=account.jumps,
            scheduler=self._ticker.scheduler,
        )

    def _load(self, compute: list[int]) -> DiagnosticStatus:
        session, account = self._session, self._ticker.account
        ticks, self._ticks = account.ticks - self._ticks, account.ticks
        now = time.monotonic()
        passed, self._time = now - self._time, now
        p50, p99, largest = percentiles(compute)
        part = sum(compute) / SECOND / passed
        return self._status(
            'load',
            f'{100.0 * part:.1f} % of the time goes into ticks',
            warn=part > BUSY,
            compute_p50=p50,
            compute_p99=p99,
            compute_max=largest,
            compute_part=part,
            real_time_factor=ticks * session.time_scale / (session.rate * passed),
            time_scale=session.time_scale,
            rate=session.rate,
        )

    def _parameters(self) -> DiagnosticStatus:
        pending = self._session.pending
        return self._status(
            'parameters',
            f'{len(pending)} wait for the next throw or ~/reset' if pending else 'none is pending',
            warn=False,
            pending=len(pending),
            **pending,
        )

    def _layer(self, result: ThrowResult | None) -> DiagnosticStatus:
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

    def _measurement(self, account: Account) -> DiagnosticStatus:
        """Tell how what the rig measures has come, and what the projectile was known ahead."""
        refused = sum(account.refused.values())
        lead = min(account.leads) / SECOND if account.leads else math.nan
        message = f'{account.taken} samples'
        if not account.taken:
            message = 'nothing is measured'
        if refused or account.lost:
            reasons = ', '.join(f'{count} {reason}' for reason, count in account.refused.items())
            message += f', {account.lost} lost, {refused} refused' + (reasons and f': {reasons}')
        if lead <= 0.0:
            message += f'; the projectile is known {-1e3 * lead:.2f} ms too late'
        return self._status(
            'measurement',
            message,
            warn=not account.taken or refused > 0 or account.lost > 0 or lead <= 0.0,
            at_rest=self._session.is_at_rest,
            samples=account.taken,
            samples_out_of_order=account.disordered,
            messages=account.received,
            messages_lost=account.lost,
            samples_refused=refused,
            lead_min=lead,
            **{f'refused.{reason}': count for reason, count in account.refused.items()},
        )

    def _model(self, result: ThrowResult | None) -> DiagnosticStatus:
        """Tell how well the model went with the last throw."""
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
        return status_to_msg(
            f'{self._name}: {task}',
            hardware_id=self._hardware_id,
            message=message,
            values=values,
            level=DiagnosticStatus.WARN if warn else DiagnosticStatus.OK,
        )
