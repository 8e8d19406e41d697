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
The node `calibrator`: keeps a twin true to its rig.

While the twin finds, throw after throw, that the projectile did something else than predicted,
the tracks of these throws are collected; from enough of them the rig is identified, and the twin
told. That takes seconds, and waits for the twin's answers, in a thread of its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
import threading
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.parameter import Parameter, parameter_value_to_python
from soft_throw_ros.configuration import Settings
from soft_throw_ros.configuration.interface import (
    CALIBRATOR_TOPICS,
    JOINTS,
    resolve,
    TWIN_SERVICES,
    TWIN_TOPICS,
)
from soft_throw_ros.configuration.rig import CALIBRATOR, RIG
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import FitDescription, USUAL
from soft_throw_ros.identification.rig_fit import fit_rig, RigFit
from soft_throw_ros.identification.tracks import ThrowTracks, Track, TrackError
from soft_throw_ros.nodes.conversions import msg_to_throw_result, status_to_msg
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run, RunnableNode
from soft_throw_ros.nodes.raw_subscriptions import RawSubscription
from soft_throw_ros.nodes.topics import create_subscription, full_name, Publishers
from soft_throw_ros.nodes.worker import LatestOnlyWorker
from soft_throw_ros.recording.cdr import decode_joint_states, MessageError
from soft_throw_ros.twin.results import ThrowResult
from std_srvs.srv import Trigger

Floats = NDArray[np.float64]

_DRAIN_PERIOD = 0.02  # between looks at what was measured [s]
_KEPT_NS = 10_000_000_000  # of what was measured
_BEFORE = 1.0  # plate periods of rest with which a track begins, ...
_AFTER = 6.0  # and for which it goes on after the release
_ANSWER_TIMEOUT = 10.0  # of other nodes [s]
_PAUSE = 0.5  # before the recommendation is asked for again, ...
_MAX_ATTEMPTS = 120  # so many times
_STOP_TIMEOUT = 0.3  # for the thread to end [s]
# The twin keeps what is not found here, and follows one amplitude with a linear layer
_HELD = ('layer.thickness', 'layer.diameter', 'layer.stiffening', 'projectile.mass')
_DESCRIPTION = FitDescription(dict.fromkeys(_HELD, 'held'))
_LAYER = tuple(entry.name for entry in RIG.entries if entry.group == 'layer')


class _Unanswered(Exception):
    """Another node refused something, or did not answer; the message says which, and what."""


class Calibrator(RunnableNode):
    """
    Identifies a rig anew when its twin is no longer true to it.

    Raises
    ------
    ParameterError
        In one line, if a parameter is refused.

    """

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('calibrator', **kwargs)
        self.parameters = NodeParameters(self, CALIBRATOR, arguments=arguments)
        settings = self.parameters.settings
        self._twin = full_name(self, settings['twin'])
        self._rig = full_name(self, settings['rig']) if settings['rig'] else ''
        self._measured = _Measured(self, self._twin)
        self.at_end(self._measured.close)
        create_subscription(self, TWIN_TOPICS.throw_result.at(self._twin), self._on_results)
        self._get = self.create_client(GetParameters, f'{self._twin}/get_parameters')
        self._set = {
            node: self.create_client(SetParametersAtomically, f'{node}/set_parameters_atomically')
            for node in (self._twin, self._rig)
            if node
        }
        self._apply = self.create_client(
            Trigger, resolve(TWIN_SERVICES.apply_recommendation.name, self._twin)
        )
        self.create_timer(_DRAIN_PERIOD, self._measured.take)
        self._outgoing = Publishers(self, CALIBRATOR_TOPICS)
        self._status = status_to_msg(
            self.get_fully_qualified_name(), 'identification', 'nothing has been identified yet'
        )
        self.create_timer(1.0, self._publish_status)
        self._mispredicted: list[ThrowTracks] = []
        self._rig_of_mispredicted: Rig | None = None
        self._is_busy = False
        self._closing = threading.Event()
        self._worker = LatestOnlyWorker(self._identify, self._on_identified)
        self.at_end(self._worker.close, _STOP_TIMEOUT)
        self.at_end(self._closing.set)

    def start(self) -> None:
        """Watch."""
        self.get_logger().info('ready')

    # in the executor's thread

    def _on_results(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            result = msg_to_throw_result(status)
            if result.stage == 'final':
                self._on_final(result)

    def _on_final(self, result: ThrowResult) -> None:
        """Collect a throw which the twin is not true to."""
        release, accuracy, comparison = result.first, result.accuracy, result.comparison
        if release is None or accuracy is None or comparison is None:
            return
        if self._is_busy or not result.is_valid:
            return
        if comparison.is_within_threshold or result.rig != self._rig_of_mispredicted:
            self._mispredicted.clear()  # what is identified together has to be of one rig
            self._rig_of_mispredicted = result.rig
        if comparison.is_within_threshold:
            return
        self._measured.take()
        period_ns = 1e9 / result.rig.engine.frequency
        begin_ns = accuracy.release_ns - round(1e9 * release.ejection_time + _BEFORE * period_ns)
        end_ns = accuracy.release_ns + round(_AFTER * period_ns)
        try:
            tracks = self._measured.between(begin_ns, end_ns, name=f'throw {result.throw}')
        except TrackError as error:
            self.get_logger().warning(f'throw {result.throw} is of no use: {error}')
            return
        self._mispredicted.append(tracks)
        if len(self._mispredicted) >= self.parameters.settings['throws']:
            self.get_logger().info(
                f'the last {len(self._mispredicted)} throws were not what the twin predicted, by '
                f'{1e3 * comparison.position_rms:.3g} mm rms in the last one; identifying'
            )
            self._is_busy = True
            self._worker.submit((self._mispredicted, result.rig))
            self._mispredicted = []

    def _publish_status(self) -> None:
        now = self.get_clock().now().nanoseconds
        self._outgoing.send(CALIBRATOR_TOPICS.diagnostics, now, [self._status])

    # in the thread of the work

    def _identify(
        self, task: tuple[list[ThrowTracks], Rig], _cancelled: Callable[[], bool]
    ) -> None:
        """Identify, and tell the twin."""
        tracks, rig = task
        try:
            self._apply_fit(fit_rig(tracks, rig, _DESCRIPTION))
        except (_Unanswered, ValueError) as error:
            if not self._closing.is_set():
                message = f'nothing has been changed: {error}'
                self.get_logger().warning(message)
                self._say(message, warn=True)

    def _on_identified(self, _answer: None) -> None:
        self._is_busy = False

    def _apply_fit(self, found: RigFit) -> None:
        """Give the twin what was found, and the rig the layer that it then recommends."""
        for warning in found.fit.warnings():
            self.get_logger().warning(warning)
        if found.fit.is_mismatch:
            raise ValueError('no parameters of the model make it do what the projectile does')
        values = {name: found.estimate(name) for name in USUAL}
        self._set_parameters(self._twin, {name: value.value for name, value in values.items()})
        words = (
            f'{name} {value.value:.5g} +- {value.error:.1g}' for name, value in values.items()
        )
        message = f'identified: {", ".join(words)}'
        self.get_logger().info(message)
        self._say(message, found)
        if self._rig:
            before = self._layer()
            self.get_logger().info(f'recommended: {self._apply_recommendation()}')
            after = self._layer()
            changes = {name: after[name] for name in after if after[name] != before[name]}
            if changes:
                self._set_parameters(self._rig, changes)

    def _say(self, message: str, found: RigFit | None = None, *, warn: bool = False) -> None:
        """Have diagnostics say what an identification came to: all that was fitted, and doubts."""
        values: dict[str, object] = {}
        if found is not None:
            values = {name: str(value) for name, value in found.estimates().items()}
            values['outliers'] = sum(len(each.outliers) for each in found.fit.residuals)
            doubts = found.fit.warnings()
            values |= {f'warning {number}': text for number, text in enumerate(doubts, 1)}
            warn = bool(doubts)
        name = self.get_fully_qualified_name()
        self._status = status_to_msg(name, 'identification', message, values, warn=warn)

    def _layer(self) -> Settings:
        """Return the twin's layer, as it is to be."""
        response = self._call(self._get, GetParameters.Request(names=_LAYER))
        values = map(parameter_value_to_python, response.values)
        return dict(zip(_LAYER, values, strict=True))

    def _apply_recommendation(self) -> str:
        """Have the twin take over the layer it recommends, and return what that is."""
        for _ in range(_MAX_ATTEMPTS):
            response = self._call(self._apply, Trigger.Request())
            if response.success:
                return str(response.message)
            if self._closing.wait(_PAUSE):
                break
        raise _Unanswered(f'{self._apply.srv_name}: {response.message}')

    def _set_parameters(self, node: str, values: Settings) -> None:
        request = SetParametersAtomically.Request(
            parameters=[
                Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
            ]
        )
        result = self._call(self._set[node], request).result
        if not result.successful:
            raise _Unanswered(f'{node} refuses {values}: {result.reason}')

    def _call(self, client: Client, request: object) -> Any:
        """Call a service, and wait for the answer, which the executor gets."""
        if not client.wait_for_service(_ANSWER_TIMEOUT):
            raise _Unanswered(f'{client.srv_name} is not there')
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(_ANSWER_TIMEOUT):
            client.remove_pending_request(future)
            raise _Unanswered(f'{client.srv_name} does not answer')
        return future.result()


class _Measured:
    """What was measured lately."""

    def __init__(self, node: RunnableNode, twin: str) -> None:
        self._log = node.get_logger()
        topic = TWIN_TOPICS.measured_joint_states.at(twin)
        self._subscription = RawSubscription.of(node, topic)
        self._parts: deque[tuple[NDArray[np.int64], Floats]] = deque()

    def take(self) -> None:
        """Take what has come; it is to be called often."""
        datas = [message.data for message in self._subscription.drain()]
        if not datas:
            return
        try:
            states = decode_joint_states(datas)
            columns = [states.names.index(joint) for joint in JOINTS]
        except (MessageError, ValueError) as error:
            self._log.warning(
                f'{len(datas)} messages are no positions of plate and projectile: {error}',
                throttle_duration_sec=1.0,
            )
            return
        self._parts.append((states.stamps, states.position[:, columns]))
        while self._parts[0][0][-1] < states.stamps[-1] - _KEPT_NS:
            self._parts.popleft()

    def between(self, start_ns: int, end_ns: int, *, name: str) -> ThrowTracks:
        """Return the tracks of a throw, over the time since `start_ns`, or raise TrackError."""
        if not self._parts or self._parts[0][0][0] > start_ns:
            raise TrackError('not all of it was measured, or not heard of')
        stamps = np.concatenate([part[0] for part in self._parts])
        positions = np.concatenate([part[1] for part in self._parts])
        stamps, order = np.unique(stamps, return_index=True)
        inside = (stamps >= start_ns) & (stamps <= end_ns)
        time = 1e-9 * (stamps[inside] - start_ns)
        plate, projectile = positions[order][inside].T
        return ThrowTracks(
            name=name,
            plate=Track(time=time, position=plate),
            projectile=Track(time=time, position=projectile),
        )

    def close(self) -> None:
        """Unsubscribe."""
        self._subscription.close()


main = partial(run, 'calibrator', Calibrator)
