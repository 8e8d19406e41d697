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
"""
The node `twin`: the throwing rig in real time.

The thread that ticks publishes what comes at every tick. All else is published by the executor's
thread; what other threads have for it waits in a queue.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
import threading
import time
from typing import Any

from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.configuration.interface import TWIN_SERVICES, TWIN_TOPICS
from soft_throw_ros.nodes.conversions import throw_result_to_msg
from soft_throw_ros.nodes.diagnostics import describe_namesakes, Diagnostics
from soft_throw_ros.nodes.measured import Measurement
from soft_throw_ros.nodes.parameters import NodeParameters, shown
from soft_throw_ros.nodes.process import run
from soft_throw_ros.nodes.realtime_node import RealTimeNode, STOP_TIMEOUT
from soft_throw_ros.nodes.recommendations import (
    matters,
    other_models_values,
    recommend_for,
    RecommendationFor,
    uncertainty_values,
)
from soft_throw_ros.nodes.topics import create_service, Publishers
from soft_throw_ros.nodes.worker import LatestOnlyWorker
from soft_throw_ros.twin.kernels import missing_parts
from soft_throw_ros.twin.prepared_rig import check_settings
from soft_throw_ros.twin.results import Outputs, ThrowResult
from soft_throw_ros.twin.session import RequestRejected, Session

_JOBS_AT_ONCE = 100  # of the executor
_COMPILING_POLL = 0.3  # looks whether kernels have been compiled [s]

RECOMMENDATION_INTERVAL = 0.3
"""Least time from one search for a better layer to the next, so that ticks do not feel it [s]."""


class Twin(RealTimeNode):
    """
    A throwing rig.

    Attributes
    ----------
    parameters : NodeParameters
        All settings.
    measurement : Measurement
        What is measured of a real rig.
    outgoing : Publishers
        All that it publishes.
    recommendation : RecommendationFor or None
        The present one; None while it is computed.

    Raises
    ------
    ParameterError
        In one line, if a parameter is refused.

    """

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('twin', **kwargs)
        self.recommendation: RecommendationFor | None = None
        self._jobs: deque[Callable[[], None]] = deque()
        self._wake = self.create_guard_condition(self._run_some_jobs)
        self._last_result: ThrowResult | None = None
        self._namesakes = 0
        self.parameters = NodeParameters(
            self,
            TWIN,
            self._on_changed,
            describe=self._describe_change,
            check=check_settings,
            arguments=arguments,
        )
        self.load_kernels(self.parameters.settings)
        self.outgoing = Publishers(self, TWIN_TOPICS)
        self._send_state = self.outgoing.sender(TWIN_TOPICS.joint_states)
        self._send_layer = self.outgoing.sender(TWIN_TOPICS.layer_joint_states)
        self._send_prediction = self.outgoing.sender(TWIN_TOPICS.predicted_joint_states)
        self._send_residual = self.outgoing.sender(TWIN_TOPICS.residual)
        session = Session(self.parameters.settings, on_entry=self.on_entry)
        self.measurement = Measurement(
            self,
            session,
            now=lambda: self._current_clock().now(),
            clock_limit=lambda: float(self.parameters.settings['measured.clock_limit']),
        )
        self.at_end(self.measurement.close)
        self.at_end(self._run_jobs)  # the last lines of the journal
        self.drive(session)
        self._diagnostics = Diagnostics(
            session, self.ticker, self.measurement, node_name=self.get_fully_qualified_name()
        )
        self._worker = LatestOnlyWorker(
            self._recommend, self._on_recommendation, interval=RECOMMENDATION_INTERVAL
        )
        self.at_end(self._worker.close, STOP_TIMEOUT)
        self._worker.submit(self.parameters.settings)
        create_service(self, TWIN_SERVICES.throw, self._on_throw)
        create_service(self, TWIN_SERVICES.reset, self._on_reset)
        create_service(self, TWIN_SERVICES.apply_recommendation, self._on_apply_recommendation)

    # in the thread of the ticks

    def on_tick(self, due: int) -> None:
        """Take what has been measured until now, and go a step on."""
        self.measurement.take()
        super().on_tick(due)

    def on_step(self, outputs: Outputs, due: int) -> None:
        """Publish what comes often, and leave the rest to the executor."""
        self._send_state(due, outputs.state)
        if outputs.layer is not None:
            self._send_layer(due, outputs.layer)
        prediction, residual = outputs.prediction, outputs.residual
        if prediction is not None:
            self.measurement.leads.append(prediction.lead_ns)
            self._send_prediction(prediction.stamp_ns, prediction[1:4])
        if residual is not None:
            self._send_residual(residual.stamp_ns, residual[1:])
        if outputs.phases or outputs.results or outputs.notices or outputs.throw_field is not None:
            self._run_in_executor(lambda: self._publish_outputs(outputs, due))

    # in any thread

    def _run_in_executor(self, job: Callable[[], None]) -> None:
        """Have the executor's thread do something, in the order of the calls."""
        self._jobs.append(job)
        if threading.current_thread() is threading.main_thread():
            self._run_some_jobs()
        else:
            self._wake.trigger()

    def on_entry(self, line: str) -> None:
        """Publish a line of the journal, soon."""
        self._run_in_executor(lambda: self.outgoing.send(TWIN_TOPICS.journal, line))

    def _on_recommendation(self, found: RecommendationFor) -> None:
        self._run_in_executor(lambda: self._publish_recommendation(found))

    # in the worker's thread

    def _recommend(self, settings: Settings, cancelled: Callable[[], bool]) -> RecommendationFor:
        """Recommend a layer once nothing has to be compiled for it any more."""
        while self.is_compiling and 'design' in missing_parts() and not cancelled():
            time.sleep(_COMPILING_POLL)
        return recommend_for(settings, cancelled)

    # in the executor's thread

    def _run_some_jobs(self) -> None:
        """Run what waits, but no more than lets signals and services have their turn."""
        for _ in range(_JOBS_AT_ONCE):
            if not self._jobs:
                return
            self._jobs.popleft()()
        self._wake.trigger()

    def _run_jobs(self) -> None:
        while self._jobs:
            self._jobs.popleft()()

    def _publish_outputs(self, outputs: Outputs, due: int) -> None:
        """Publish, and log, what a step gave besides the state."""
        send = self.outgoing.send
        for phase in outputs.phases:
            send(TWIN_TOPICS.phase, phase.value)
        if outputs.throw_field is not None:
            send(TWIN_TOPICS.throw_field, outputs.throw_field.strain)
        for result in outputs.results:
            self._publish_result(result, due)
        for notice in outputs.notices:
            self.get_logger().warning(notice)

    def _publish_result(self, result: ThrowResult, due: int) -> None:
        """Publish a result as one message, and what is plotted as numbers."""
        last, self._last_result = self._last_result, result
        send = self.outgoing.send
        settings = self.parameters.settings
        beside = {}
        if not self.is_compiling:  # whose kernels a process of its own compiles, and not this one
            beside = uncertainty_values(result.rig, settings)
            if not self.session.is_measured:
                beside |= other_models_values(result.rig, settings)
        status = throw_result_to_msg(result, self.get_fully_qualified_name(), beside)
        send(TWIN_TOPICS.throw_result, due, [status])
        if result.stage == 'release' and result.first is not None:
            send(TWIN_TOPICS.ejection_time, result.first.ejection_time)
            send(TWIN_TOPICS.ejection_speed, result.first.ejection_speed)
            send(TWIN_TOPICS.energy_transfer, result.first.energy_transfer)
            send(TWIN_TOPICS.peak_strain, result.peak_strain)
        if result.stage != 'predicted' or last is None or last.throw != result.throw:
            self._log_result(result)

    def _log_result(self, result: ThrowResult) -> None:
        """Log one line per throw, and what is wrong with it."""
        log, throw = self.get_logger(), f'throw {result.throw}'
        comparison = result.comparison
        if not result.is_valid:
            log.warning(result.describe())
        elif result.stage == 'predicted':
            if not result.is_ahead:
                log.warning(
                    f'{throw}: {result.describe_lead()}; a shorter measured.window or '
                    'measured.wait, and a higher rate.state, let it be known earlier'
                )
        elif result.stage == 'release' or result.first is None:
            log.info(result.describe())
        elif comparison and not comparison.is_within_threshold:
            log.warning(f'{throw}: {comparison.describe()}')

    def _publish_recommendation(self, found: RecommendationFor) -> None:
        """Publish a recommendation, unless it is for what the rig no longer is."""
        if not found.is_for(self.parameters.settings):
            return
        self.recommendation = found
        self.parameters.set_results(found.results())
        if found.best is None:
            self.get_logger().warning(found.describe())
        else:
            self.get_logger().info(found.describe())
            self.outgoing.send(TWIN_TOPICS.recommended_energy_transfer, found.best.energy_transfer)
        status = found.to_status(self.get_fully_qualified_name())
        now = self.get_clock().now().nanoseconds
        self.outgoing.send(TWIN_TOPICS.recommendation, now, [status])

    def _on_changed(self, changes: Settings) -> None:
        self.session.change(changes)
        if any(matters(name) for name in changes):
            self.recommendation = None
            self._worker.submit(self.parameters.settings)

    def _describe_change(self, name: str) -> str:
        """Say when a change takes effect."""
        return ', from the next throw or ~/reset on' if name in self.session.pending else ''

    def _on_throw(self) -> str:
        self.session.request_throw()
        topic = TWIN_TOPICS.throw_result.at(self.get_fully_qualified_name())
        return f'the result comes on {topic.name}'

    def _on_reset(self) -> str:
        self.session.reset()
        return 'the rig is being put back'

    def _on_apply_recommendation(self) -> str:
        found = self.recommendation
        if found is None:
            raise RequestRejected('the recommendation is being computed; ask again')
        if found.best is None:
            raise RequestRejected(found.describe())
        changes = found.changes()
        self.parameters.apply(changes)
        values = ', '.join(f'{name} {shown(value)}' for name, value in changes.items())
        return f'{values}, from the next throw or ~/reset on'

    def on_second(self) -> None:
        """Publish how well time is kept, and what is pending."""
        super().on_second()
        self._run_some_jobs()  # in case that a wake-up went astray
        self._look_for_namesakes()
        statuses = self._diagnostics.statuses(self._last_result, namesakes=self._namesakes)
        now = self.get_clock().now().nanoseconds
        self.outgoing.send(TWIN_TOPICS.diagnostics, now, statuses)

    def _look_for_namesakes(self) -> None:
        """Say it when other nodes publish under the name of this one, or do no more."""
        topic = TWIN_TOPICS.journal.at(self.get_fully_qualified_name()).name
        before, self._namesakes = self._namesakes, max(self.count_publishers(topic) - 1, 0)
        if self._namesakes > before:
            self.get_logger().error(describe_namesakes(self.get_fully_qualified_name()))
        elif before and not self._namesakes:
            self.get_logger().info('no other node has this name any more')


main = partial(run, 'twin', Twin)
