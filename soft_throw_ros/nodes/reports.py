# SPDX-License-Identifier: Apache-2.0
"""What the twin says about itself, once a second (REP 107)."""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.nodes.conversions import status_to_msg
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
    name : str
        Of the node, which the names of the statuses begin with.
    hardware_id : str
        Full name of the node.

    """

    def __init__(self, session: Session, ticker: Ticker, *, name: str, hardware_id: str) -> None:
        self._session = session
        self._ticker = ticker
        self._name = name
        self._hardware_id = hardware_id
        self._time = time.monotonic()
        self._ticks = self._late = self._skipped = 0

    def statuses(self, result: ThrowResult | None) -> list[DiagnosticStatus]:
        """Return the statuses for the time since the last call; `result` is the last throw's."""
        lateness, compute = self._ticker.account.take()
        return [
            self._deadlines(lateness),
            self._load(compute),
            self._parameters(),
            self._layer(result),
        ]

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

    def _status(self, task: str, message: str, *, warn: bool, **values: Any) -> DiagnosticStatus:
        return status_to_msg(
            f'{self._name}: {task}',
            hardware_id=self._hardware_id,
            message=message,
            values=values,
            level=DiagnosticStatus.WARN if warn else DiagnosticStatus.OK,
        )
