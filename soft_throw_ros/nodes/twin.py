# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The node `twin`: the throwing rig in real time.

The tick thread publishes the messages of every tick. The executor's thread publishes all other
messages; other threads hand them over through a queue.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from functools import partial
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.configuration.interface import TWIN_SERVICES, TWIN_TOPICS
from soft_throw_ros.configuration.twin import joint_names
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.nodes import conversions, recommendations
from soft_throw_ros.nodes.measured import Measurement
from soft_throw_ros.nodes.parameters import NodeParameters, shown
from soft_throw_ros.nodes.process import run, STOP_TIMEOUT
from soft_throw_ros.nodes.realtime import RealTimeNode
from soft_throw_ros.nodes.topics import create_service, Publishers
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.results import known_values, Outputs, Phase, ThrowResult
from soft_throw_ros.twin.session import RequestRejected, Session

_LINE_INTERVAL_NS = 9_900_000_000  # between two log lines about throws without a warning [ns]
_WARNING_PERIOD = 10.0  # between two lines about the same fault [s]
_MAX_LATE_SHARE = 0.01  # fraction of late ticks above which the timing is a warning [-]
_MAX_COMPUTE_SHARE = 0.5  # fraction of the time in ticks, likewise [-]


class Twin(RealTimeNode):
    """The twin of a throwing rig."""

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('twin', **kwargs)
        # None while it is computed
        self.recommendation: recommendations.RecommendationState | None = None
        self._jobs: deque[Callable[[], None]] = deque()
        self._wake = self.create_guard_condition(self._run_jobs)
        self._throw = 0  # number of the throw of the last result
        self._last_line_ns = -_LINE_INTERVAL_NS
        self._rig_beyond_range: tuple[Rig, float] | None = None
        self._compared: ThrowResult | None = None  # the last one
        self._status_time = time.monotonic()
        self._status_ticks: Counter[str] = Counter()
        self.parameters = NodeParameters(
            self, TWIN, self._on_changed, check=self.prepare, arguments=arguments
        )
        self._joints = joint_names(self.parameters.settings)
        self.outgoing = Publishers(self, TWIN_TOPICS, self._joints)
        self._serialize_command()
        on_entry = partial(self._run_in_executor, self.outgoing.send, TWIN_TOPICS.journal)
        session = Session(self.parameters.checked, on_entry=on_entry)
        self.measurement = Measurement(
            self, session, self._joints, now=lambda: self._current_clock().now()
        )
        self.add_cleanup(self._run_jobs)  # the last lines of the journal
        self.attach_session(session)
        publish = partial(self._run_in_executor, self._publish_recommendation)
        self.recommender = recommendations.Recommender(publish)
        self.add_cleanup(self.recommender.close, STOP_TIMEOUT)
        self.recommender.submit(self.parameters.checked.config)
        create_service(self, TWIN_SERVICES.throw, self._on_throw)
        create_service(self, TWIN_SERVICES.reset, self._on_reset)
        create_service(self, TWIN_SERVICES.apply_recommendation, self._on_apply_recommendation)

    # Tick thread

    def on_tick(self, due: int) -> None:
        """Read the samples that have arrived, and advance by one step."""
        self.measurement.read_messages()
        self.on_step(self.session.advance(), due)

    def on_step(self, outputs: Outputs, due: int) -> None:
        """Publish the messages of every tick, and hand the others over to the executor."""
        send = self.outgoing.send
        send(TWIN_TOPICS.joint_states, due, outputs.state)
        if outputs.layer is not None:
            send(TWIN_TOPICS.layer_joint_states, due, outputs.layer)
        prediction, residual = outputs.prediction, outputs.residual
        if prediction is not None:
            send(TWIN_TOPICS.predicted_joint_states, prediction.stamp_ns, prediction[1:])
        if residual is not None:
            send(TWIN_TOPICS.residual, residual.stamp_ns, residual[1:])
        if outputs.command is not None:
            send(TWIN_TOPICS.plate_trajectory, *outputs.command)
        if outputs.phases or outputs.results or outputs.throw_field is not None:
            self._run_in_executor(self._publish_outputs, outputs, due)

    # Any thread

    def _run_in_executor(self, job: Callable[..., None], *args: object) -> None:
        """Call a function in the executor's thread, in the order of these requests."""
        self._jobs.append(partial(job, *args))
        self._wake.trigger()

    # Executor thread

    def _run_jobs(self) -> None:
        """Run the waiting jobs, a few per throw."""
        while self._jobs:
            self._jobs.popleft()()

    def _publish_outputs(self, outputs: Outputs, due: int) -> None:
        """Publish and log the outputs of a step other than the state."""
        send = self.outgoing.send
        for phase, stamp_ns in outputs.phases:
            send(TWIN_TOPICS.phase_change, stamp_ns, (float([*Phase].index(phase)),))
        if outputs.phases:
            send(TWIN_TOPICS.phase, outputs.phases[-1].phase.value)
        if outputs.throw_field is not None:
            field = outputs.throw_field()
            send(TWIN_TOPICS.throw_field, field.start_ns, field.points)
            send(TWIN_TOPICS.throw_energies, field.start_ns, field.energies)
        for result in outputs.results:
            self._publish_result(result, due)

    def _publish_result(self, result: ThrowResult, due: int) -> None:
        """Publish a result as one message, and the numbers of its first release, or NaN."""
        is_first, self._throw = result.throw != self._throw, result.throw
        send = self.outgoing.send
        rig, uncertainty = self.recommender.uncertainty
        beside = uncertainty if rig == result.rig else {}
        name = self.get_fully_qualified_name()
        status = conversions.throw_result_to_msg(result, name, beside)
        send(TWIN_TOPICS.throw_result, result.stamp(due), [status])
        first = result.first
        is_ejection = result.stage == 'release' or (result.stage == 'final' and first is None)
        if is_ejection:
            for name in ('ejection_time', 'ejection_speed', 'energy_transfer'):
                send(getattr(TWIN_TOPICS, name), getattr(first, name, math.nan))
        if result.stage == 'final' and result.comparison is not None:
            self._compared = result
        if warning := self._warning_of(result, is_first=is_first):
            self.get_logger().warning(warning)
        elif is_ejection:
            self._log_throw(result, due)

    def _warning_of(self, result: ThrowResult, *, is_first: bool) -> str:
        """Return a warning of an invalid, late or mispredicted throw or a large strain, if any."""
        rig = result.rig, result.max_strain
        if not result.is_valid:
            return conversions.throw_text(result)
        if result.stage == 'predicted' and is_first and (result.lead or 0.0) <= 0.0:
            age = self.measurement.age_ns / SECOND
            is_late = age > self.parameters.settings['measured.smoothing_window'] / 4.0
            late = f'predicted {-1e3 * (result.lead or 0.0):.2f} ms after the release'
            return f'throw {result.throw} is {late}; ' + (
                f'samples arrive {1e3 * age:.1f} ms after their stamps'
                if is_late
                else 'for an earlier prediction decrease measured.smoothing_window or '
                'measured.latency, or increase rate.state'
            )
        if result.stage != 'predicted' and not result.is_linear and rig != self._rig_beyond_range:
            self._rig_beyond_range = rig
            return conversions.throw_text(result)
        if result.stage != 'final' or not result.comparison:
            return ''
        is_good = result.comparison.is_within_threshold
        return '' if is_good else f'throw {result.throw}: {conversions.comparison_text(result)}'

    def _log_throw(self, result: ThrowResult, due: int) -> None:
        """Log a throw; one in ten seconds at level INFO, with a summary since the start."""
        text = conversions.throw_text(result)
        if due - self._last_line_ns < _LINE_INTERVAL_NS:
            self.get_logger().debug(text)
            return
        if result.throw > 1:
            skipped = self.ticker.counts['ticks_skipped']
            text += f'; {result.throw} throws, {skipped} ticks skipped since the start'
        self._last_line_ns = due
        self.get_logger().info(text)

    def _publish_recommendation(self, recommended: recommendations.RecommendationState) -> None:
        """Publish a recommendation, unless another one has been requested since."""
        if recommended.config is not self.recommender.request:
            return
        self.recommendation = recommended
        self.parameters.set_results(recommended.results())
        status = recommended.to_status(self.get_fully_qualified_name())
        self.outgoing.report(TWIN_TOPICS.recommendation, [status])
        self.log(status.message, is_error=recommended.best is None)

    def _serialize_command(self) -> None:
        """Serialize the motion of a commanded plate in advance, which is too slow for a tick."""
        config = self.parameters.checked.config
        motion = config.rig.engine.motion
        if config.command_lead is not None and motion is not None:
            conversions.encode_command(0, motion, self._joints[0], self.outgoing.frame)

    def _on_changed(self, changes: Settings) -> None:
        self._serialize_command()
        self.session.change(changes, self.parameters.checked)
        if any(recommendations.affects_recommendation(name) for name in changes):
            self.recommendation = None
            self.recommender.submit(self.parameters.checked.config)

    def _on_throw(self) -> str:
        return f'throw {self.session.request_throw()}: its result follows on ~/throw_result'

    def _on_reset(self) -> str:
        self.session.reset()
        return 'resetting the rig'

    def _on_apply_recommendation(self) -> str:
        if self.recommendation is None:
            raise RequestRejected('the recommendation is being computed; ask again')
        changes = self.recommendation.changes()
        if not changes:
            return 'the present layer is the best one and stays'
        self.parameters.apply(changes)
        values = ', '.join(f'{name} {shown(value)}' for name, value in changes.items())
        return f'{values}, from the next throw or ~/reset on'

    def on_second(self) -> None:
        """Publish the diagnostics."""
        super().on_second()
        self._run_jobs()  # in case a wake-up was lost
        if fault := self.session.diagnose_sensor():
            self.get_logger().warning(fault, throttle_duration_sec=_WARNING_PERIOD)
        name = self.get_fully_qualified_name()
        if self.count_publishers(TWIN_TOPICS.journal.at(name).name) > 1:
            self.get_logger().error(
                f'another node is named {name}, and both publish on the same topics: start one of '
                'them with -r __ns:=/NAMESPACE or -r __node:=NAME',
                throttle_duration_sec=_WARNING_PERIOD,
            )
        self.outgoing.report(TWIN_TOPICS.diagnostics, self._statuses())

    # Diagnostics, once per second (REP 107)

    def _statuses(self) -> list[DiagnosticStatus]:
        """Return the statuses for the time since the last call."""
        pending = self.session.pending
        text = f'{len(pending)} parameter changes wait for the next throw or ~/reset'
        statuses = [
            self._timing(),
            self.outgoing.status('parameters', text, {'pending': len(pending), **pending}),
        ]
        if self.session.is_measured:
            text, values, is_bad = self.measurement.status()
            statuses.append(self.outgoing.status('measurement', text, values, warn=is_bad))
        result = self._compared if self.session.is_measured else None
        if result is not None:
            assert result.comparison is not None
            statuses.append(self.outgoing.status(
                'model', f'throw {result.throw}: {conversions.comparison_text(result)}',
                {'throw': result.throw, **known_values(result.comparison)},
                warn=not result.comparison.is_within_threshold,
            ))
        return statuses

    def _timing(self) -> DiagnosticStatus:
        """Return the status of the lateness and of the processor time of the ticks."""
        times = np.array(self.ticker.take_times() or [(0, 0)]) / SECOND  # lateness and duration
        now, ticks = time.monotonic(), self.ticker.counts.copy()
        passed, new = now - self._status_time, ticks - self._status_ticks
        self._status_time, self._status_ticks = now, ticks
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
            'rate': self.session.rate,
            'scheduler': self.ticker.scheduler,
        }
        return self.outgoing.status('timing', text, values, warn=is_bad)


main = partial(run, 'twin', Twin)
