# SPDX-License-Identifier: Apache-2.0
"""
The node `twin`: the throwing rig in real time.

One thread asks the session for the steps that are due, and publishes what comes at every tick.
All else happens in the executor's thread: services, parameters, and what is published now and
then. What other threads have for it waits in a queue.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
import contextlib
import gc
import sys
import threading
from typing import Any

import numpy as np
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from soft_throw_ros.configuration import ParameterError, TWIN
from soft_throw_ros.design.uncertainty import PredictionUncertainty
from soft_throw_ros.nodes import topics
from soft_throw_ros.nodes.advice import Advice, advise, matters, uncertainty_of
from soft_throw_ros.nodes.conversions import statuses_to_msg, throw_result_to_msg
from soft_throw_ros.nodes.measured import MeasuredSteps
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import Program, run
from soft_throw_ros.nodes.realtime import Clock, NodeClock, SystemClock, Ticker
from soft_throw_ros.nodes.reports import Observer
from soft_throw_ros.nodes.worker import LatestWins
from soft_throw_ros.recording.cdr import ArrayEncoder, JointStateEncoder
from soft_throw_ros.twin.core_adapter import Event
from soft_throw_ros.twin.prepared_rig import (
    check_settings,
    FIELD_POINTS,
    THROW_FIELD_ROWS,
    warm_up,
)
from soft_throw_ros.twin.results import Outputs, ThrowResult
from soft_throw_ros.twin.session import RequestRejected, Session
from std_msgs.msg import String
from std_srvs.srv import Trigger

STOP_TIME = 0.3
"""Longest wait for a thread to end. [s]"""

NOTICE_TIME = 2.0
"""Kernels that take longer than this are being compiled, not loaded. [s]"""

USAGE = 'usage: twin [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]'


class Twin(Program):
    """
    A throwing rig.

    Parameters
    ----------
    arguments : sequence of str
        The command line, to say where a bad parameter stands.
    system_clock : Clock
        What steps are due by, unless the node follows `/clock`.
    **kwargs
        As for `rclpy.node.Node`.

    Attributes
    ----------
    session : Session
        What happens at which step.
    ticker : Ticker
        What asks for the steps: by itself once it is started.

    Raises
    ------
    ParameterError
        In one line, if a parameter is refused.

    """

    def __init__(
        self,
        *,
        arguments: Sequence[str] = (),
        system_clock: Clock | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__('twin', **kwargs)
        self._system_clock = system_clock or SystemClock()
        self._jobs: deque[Callable[[], None]] = deque()
        self._advice: Advice | None = None
        self._last_result: ThrowResult | None = None
        self._last_landed = 0
        try:
            self._make_publishers()
            self._make_rig(arguments)
            self._make_services()
        except BaseException:
            super().destroy_node()
            raise

    @property
    def exit_code(self) -> int | None:
        """1 if the ticks have come to an end by themselves."""
        return None if self.ticker.is_alive else 1

    def start(self) -> None:
        """Tick."""
        self.ticker.start()
        self.get_logger().info('ready')

    def destroy_node(self) -> None:
        """Stop the threads, publish what waits, and let go of everything."""
        self.ticker.stop(STOP_TIME)
        self.session.close()
        self._adviser.close(STOP_TIME)
        self._node_clock.close()
        self._do_jobs()
        self._steps.close()
        super().destroy_node()

    def _make_publishers(self) -> None:
        self._joint_states = topics.JOINT_STATES.publisher(self)
        self._strain = topics.STRAIN.publisher(self)
        self._velocity = topics.VELOCITY.publisher(self)
        self._throw_field = topics.THROW_FIELD.publisher(self)
        self._phase = topics.PHASE.publisher(self)
        self._throw_result = topics.THROW_RESULT.publisher(self)
        self._recommendation = topics.RECOMMENDATION.publisher(self)
        self._journal = topics.JOURNAL.publisher(self)
        self._predicted = topics.PREDICTED.publisher(self)
        self._residual = topics.RESIDUAL.publisher(self)
        self._diagnostics = topics.DIAGNOSTICS.publisher(self)
        self._encode_state = JointStateEncoder(topics.FRAME, topics.JOINTS).encode
        self._encode_prediction = JointStateEncoder(topics.FRAME, topics.PREDICTED_JOINTS).encode
        self._encode_residual = JointStateEncoder(topics.FRAME, topics.JOINTS, series=1).encode
        self._encode_field = ArrayEncoder({'y': FIELD_POINTS}).encode
        self._encode_throw_field = ArrayEncoder({'t': THROW_FIELD_ROWS, 'y': FIELD_POINTS}).encode

    def _make_rig(self, arguments: Sequence[str]) -> None:
        self._wake = self.create_guard_condition(self._do_jobs)
        self.parameters = NodeParameters(
            self, TWIN, self._on_changed, check=check_settings, arguments=arguments
        )
        self.session = Session(self.parameters.settings, on_entry=self._on_entry)
        self._node_clock = NodeClock(self)
        self._steps = MeasuredSteps(self, self.session)
        self.ticker = Ticker(self._steps, self._on_step, self._current_clock)
        self._adviser = LatestWins(advise, self._on_advice)
        self._adviser.submit(self.parameters.settings)

    def _make_services(self) -> None:
        self.create_service(Trigger, topics.THROW, self._on_throw)
        self.create_service(Trigger, topics.RESET, self._on_reset)
        self.create_service(Trigger, topics.APPLY_RECOMMENDATION, self._on_apply_recommendation)
        self._observer = Observer(
            self.session,
            self.ticker,
            self._steps,
            name=self.get_name(),
            hardware_id=self.get_fully_qualified_name(),
        )
        self.create_timer(1.0, self._on_second, clock=RosClock(clock_type=ClockType.STEADY_TIME))

    # in the thread of the ticks

    def _current_clock(self) -> Clock:
        return self._node_clock if self._node_clock.is_active else self._system_clock

    def _on_step(self, outputs: Outputs, due: int) -> None:
        """Publish what comes often, and leave the rest to the executor."""
        self._joint_states.publish(self._encode_state(due, outputs.state))
        if outputs.layer is not None:
            height = outputs.layer.height
            spacing = self.parameters.settings['layer.thickness'] / (FIELD_POINTS - 1)
            self._strain.publish(self._encode_field(np.gradient(height, spacing) - 1.0))
            self._velocity.publish(self._encode_field(outputs.layer.velocity))
        prediction, residual = outputs.prediction, outputs.residual
        if prediction is not None:
            self._predicted.publish(self._encode_prediction(prediction.stamp_ns, prediction[1:4]))
        if residual is not None:
            self._residual.publish(self._encode_residual(residual.stamp_ns, residual[1:]))
        if outputs.phases or outputs.results or outputs.notices or outputs.throw_field is not None:
            self._later(lambda: self._report(outputs, due))

    # in any thread

    def _later(self, job: Callable[[], None]) -> None:
        """Have the executor do something, in the order of the calls."""
        self._jobs.append(job)
        self._wake.trigger()

    def _on_entry(self, line: str) -> None:
        self._later(lambda: self._journal.publish(String(data=line)))

    def _on_advice(self, advice: Advice) -> None:
        self._later(lambda: self._take_advice(advice))

    # in the executor's thread

    def _do_jobs(self) -> None:
        while self._jobs:
            self._jobs.popleft()()

    def _report(self, outputs: Outputs, due: int) -> None:
        """Publish, and say, what a step gave besides the state."""
        for phase in outputs.phases:
            self._phase.publish(String(data=phase.value))
        if outputs.throw_field is not None:
            self._throw_field.publish(self._encode_throw_field(outputs.throw_field.strain))
        for event in outputs.events:
            self._tell_landing(outputs.throw, event)
        for result in outputs.results:
            self._last_result = result
            uncertainty = uncertainty_of(result.rig, self.parameters.settings)
            status = throw_result_to_msg(
                result,
                name=f'{self.get_name()}: throw',
                hardware_id=self.get_fully_qualified_name(),
                uncertainty=uncertainty,
            )
            self._throw_result.publish(statuses_to_msg(due, [status]))
            self._tell(result, uncertainty)
        for notice in outputs.notices:
            self.get_logger().warning(notice)

    def _tell(self, result: ThrowResult, uncertainty: PredictionUncertainty | None) -> None:
        """Say in the log what a throw gave, and what is wrong with it."""
        if not result.is_valid:
            self.get_logger().warning(result.describe())
        elif result.stage == 'predicted':
            self.get_logger().info(f'{result.describe()}; {result.describe_lead()}')
        elif result.stage == 'release' or result.first is None:
            self.get_logger().info(self._with_advice(result, uncertainty))
        if result.stage == 'predicted' and not result.is_ahead:
            self.get_logger().warning(
                f'throw {result.throw}: {result.describe_lead()}; a shorter measured.window or '
                'measured.wait, and a higher rate.state, let it be known earlier'
            )
        comparison = result.comparison
        if result.stage == 'final' and comparison and not comparison.is_within_threshold:
            self.get_logger().warning(f'throw {result.throw}: {comparison.describe()}')

    def _tell_landing(self, throw: int, event: Event) -> None:
        """Say in the log how a throw came down first; bounces are in its result."""
        if event.kind == 'landing' and throw != self._last_landed:
            self._last_landed = throw
            self.get_logger().info(
                f'throw {throw}: landed after {event.time:.3f} s at {-event.velocity:.3f} m/s'
            )

    def _on_changed(self, changes: dict[str, Any]) -> None:
        self.session.change(changes)
        pending = self.session.pending
        for name, value in changes.items():
            when = ', from the next throw or ~/reset on' if name in pending else ''
            self.get_logger().info(f'{name} is now {value}{when}')
        if any(matters(name) for name in changes):
            self._advice = None
            self._adviser.submit(self.parameters.settings)

    def _on_throw(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self.session.request_throw()
        except RequestRejected as refusal:
            response.message = str(refusal)
        else:
            response.success = True
            response.message = f'the result comes on {self._throw_result.topic_name}'
        return response

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.session.reset()
        response.success = True
        response.message = 'the rig is being put back'
        return response

    def _on_apply_recommendation(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        advice = self._advice
        if advice is None:
            response.message = 'the recommendation is being computed; ask again'
        elif advice.recommendation is None:
            response.message = f'there is no recommendation: {advice.reason}'
        else:
            changes = advice.changes()
            try:
                self.parameters.apply(changes)
            except ParameterError as error:
                response.message = str(error)
            else:
                response.success = True
                values = ', '.join(
                    f'{name} {value:g}' if isinstance(value, float) else f'{name} {value}'
                    for name, value in changes.items()
                )
                response.message = f'{values}, from the next throw or ~/reset on'
        return response

    def _take_advice(self, advice: Advice) -> None:
        """Publish a recommendation, unless it is for what the rig no longer is."""
        if not advice.is_for(self.parameters.settings):
            return
        self._advice = advice
        self.parameters.set_results(advice.results())
        if advice.recommendation is None:
            self.get_logger().warning(advice.sentence())
        status = advice.to_status(
            name=f'{self.get_name()}: recommendation',
            hardware_id=self.get_fully_qualified_name(),
        )
        now = self.get_clock().now().nanoseconds
        self._recommendation.publish(statuses_to_msg(now, [status]))

    def _with_advice(self, result: ThrowResult, uncertainty: PredictionUncertainty | None) -> str:
        """Say what a throw gave, how sure that is, and what the recommended layer would give."""
        sentence = result.describe()
        if uncertainty is not None and result.first is not None:
            sentence += f' (by the uncertainties of the rig {uncertainty.describe()})'
        advice = self._advice
        if advice is None or advice.recommendation is None or advice.rig != result.rig:
            return sentence
        return f'{sentence}; {advice.sentence()}'

    def _on_second(self) -> None:
        """Publish how well time is kept, and what waits."""
        self._do_jobs()  # in case that a wake-up went astray
        if isinstance(self._system_clock, SystemClock):
            self._system_clock.adjust()
        statuses = self._observer.statuses(self._last_result)
        now = self.get_clock().now().nanoseconds
        self._diagnostics.publish(statuses_to_msg(now, statuses))


def main(args: list[str] | None = None) -> int:
    """
    Run the twin until SIGINT or SIGTERM.

    Parameters
    ----------
    args : list of str, optional
        Those of the process by default.

    Returns
    -------
    int
        Exit code: 0 after a signal, 2 if an argument or a parameter is refused, 1 if the ticks
        have come to an end by themselves.

    """
    return run('twin', _make, args, usage=USAGE)


def _make(arguments: Sequence[str]) -> Twin:
    with _notice_of_compilation():
        twin = Twin(arguments=arguments)  # which refuses parameters first
        try:
            prepare_process()
        except KeyboardInterrupt:
            twin.destroy_node()
            raise
    return twin


def prepare_process() -> None:
    """Compile or load all kernels, and let nothing hold up the ticks."""
    warm_up()
    advise(TWIN.defaults())
    sys.setswitchinterval(1e-4)
    gc.collect()
    gc.freeze()


@contextlib.contextmanager
def _notice_of_compilation() -> Iterator[None]:
    """Say it if kernels have to be compiled."""
    notice = threading.Timer(
        NOTICE_TIME, print, ('twin: compiling, once; takes half a minute',), {'flush': True}
    )
    notice.daemon = True
    notice.start()
    try:
        yield
    finally:
        notice.cancel()
