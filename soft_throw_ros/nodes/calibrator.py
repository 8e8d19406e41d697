# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The node `calibrator`: identifies the rig again when the twin's predictions are wrong.

The node collects the tracks of consecutive throws that the twin predicted wrongly, or that were
too noisy for it. A worker thread identifies the rig from them and sets the parameters of the twin.

After `motion_after` throws in a row that the twin predicted well, the node makes the twin command
the best motion of the plate, and measures the gain in ejection speed.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
import contextlib
from dataclasses import replace
from functools import partial
import math
import threading
import traceback
from types import MappingProxyType
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from soft_throw_ros.configuration import interface, Settings
from soft_throw_ros.configuration.interface import CALIBRATOR_TOPICS, TWIN_TOPICS
from soft_throw_ros.configuration.node_tables import CALIBRATOR, RIG
from soft_throw_ros.configuration.twin import joint_names
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import DEFAULT_FREE, FitDescription, FIXED
from soft_throw_ros.identification.flight import flight_speed, motion_delay
from soft_throw_ros.identification.least_squares import Estimate, fit_warnings
from soft_throw_ros.identification.rig_fit import fit_rig, RigFit
from soft_throw_ros.identification.tracks import ThrowTracks, Track, TrackError
from soft_throw_ros.nodes.conversions import msg_to_motion, msg_to_throw_result
from soft_throw_ros.nodes.measured import HeightReader, MAX_DATA_RATE
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run, RunnableNode, STOP_TIMEOUT
from soft_throw_ros.nodes.topics import create_subscription, full_name, Publishers
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.results import ThrowResult
from soft_throw_ros.twin.sample_buffer import Samples
from soft_throw_ros.twin.session import RequestRejected
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

_READ_PERIOD = 0.02  # between two reads of measurements [s]
_KEPT_READS = 500  # number of reads whose measurements are kept, ten seconds
_SET_BACK = SECOND  # smallest step backwards of the stamps when their clock is set [ns]
_BEFORE = 1.0  # length of the track before the throw, at rest [plate periods]
_AFTER = 6.5  # length of the track from the start of the throw on [plate periods]
_PAUSE = 0.5  # pause between two requests for the recommendation, which takes seconds [s]
_MAX_ATTEMPTS = 120  # number of requests for the recommendation, one minute in total
_ANSWER_TIMEOUT = 10.0  # longest wait for a service of another node [s]
_RELEASE_TIME_ERROR = 1e-4  # standard error of a release, by delays of the sensors [s]
_DESCRIPTION = FitDescription(
    dict.fromkeys(('layer.thickness', 'layer.diameter', 'projectile.mass'), FIXED)
)
_LAYER = tuple(entry.name for entry in RIG.entries if entry.group == 'layer')
_OF_COMMAND = ('engine.motion', 'engine.motion_file', 'recommendation.vary')


class MeasuredPositions(HeightReader):
    """The measured positions of two joints in the last seconds, by the clock of a twin."""

    def __init__(self, node: RunnableNode, twin: str, joints: tuple[str, str]) -> None:
        topic = TWIN_TOPICS.measured_joint_states.at(twin)
        super().__init__(node, topic, joints, Counter())
        self.clock_offset_ns = 0  # added to the stamps
        self._batches: deque[Samples] = deque(maxlen=_KEPT_READS)

    @property
    def newest_ns(self) -> float:
        """Time of the newest measurement, minus infinity without one [ns]."""
        return self._batches[-1].stamps[-1] + self.clock_offset_ns if self._batches else -math.inf

    def read_messages(self) -> None:
        """Read the messages that have arrived."""
        for samples in self.read(_READ_PERIOD * MAX_DATA_RATE):
            if self._batches and samples.stamps[-1] < self._batches[-1].stamps[-1] - _SET_BACK:
                self._batches.clear()
            self._batches.append(samples)

    def between(
        self, start_ns: int, end_ns: int, name: str = '', *, max_gap: float = math.inf
    ) -> ThrowTracks:
        """
        Return the tracks of a throw, over the time since `start_ns`.

        Raise TrackError if they are too short, or have no samples for longer than `max_gap` [s].
        """
        start_ns, end_ns = start_ns - self.clock_offset_ns, end_ns - self.clock_offset_ns
        if not self._batches or self._batches[0].stamps[0] > start_ns:
            raise TrackError('measurements of its start were not received')
        stamps, order = np.unique(
            np.concatenate([samples.stamps for samples in self._batches]), return_index=True
        )
        inside = (stamps >= start_ns) & (stamps <= end_ns)
        time = 1e-9 * (stamps[inside] - start_ns)
        gap = np.diff(time, prepend=0.0, append=1e-9 * (end_ns - start_ns)).max()
        if gap > max_gap:
            raise TrackError(f'no samples for {1e3 * gap:.3g} ms')
        heights = np.concatenate([samples.heights for samples in self._batches])[order][inside]
        plate, projectile = (
            Track(time=time[is_measured], position=column[is_measured])
            for column, is_measured in zip(heights.T, np.isfinite(heights).T, strict=True)
        )
        return ThrowTracks(name=name, plate=plate, projectile=projectile)


class MeasuredThrow(NamedTuple):
    """A throw whose projectile was measured in flight."""

    speed: Estimate  # at the release, with the error by the scatter of the heights [m/s]
    peak_plate_speed: float  # [m/s]


class RemoteParameters:
    """The parameters of another node; RequestRejected is raised for each request that fails."""

    def __init__(self, node: Node, name: str) -> None:
        self._get = node.create_client(GetParameters, f'{name}/get_parameters')
        set_ = f'{name}/set_parameters_atomically'
        self._set = node.create_client(SetParametersAtomically, set_)

    def get(self, names: Sequence[str]) -> Settings:
        """Return parameters by their names."""
        values = call(self._get, GetParameters.Request(names=names)).values
        return dict(zip(names, map(parameter_value_to_python, values), strict=True))

    def set(self, values: Settings) -> None:  # noqa: A003
        """Set parameters together."""
        items = (Parameter(name, value=value) for name, value in values.items())
        parameters = [item.to_parameter_msg() for item in items]
        result = call(self._set, SetParametersAtomically.Request(parameters=parameters)).result
        if not result.successful:
            raise RequestRejected(f'{self._set.srv_name} rejects {values}: {result.reason}')


def call(client: Client, request: object) -> Any:
    """Call a service and wait for the answer; raise RequestRejected if it does not come."""
    response: Any = None
    if client.wait_for_service(_ANSWER_TIMEOUT):
        with contextlib.suppress(TimeoutError):  # of later versions than Jazzy
            response = client.call(request, _ANSWER_TIMEOUT)
    if response is None:
        raise RequestRejected(f'{client.srv_name} does not answer')
    return response


class Calibrator(RunnableNode):
    """A node that identifies the rig again when the twin's predictions are wrong."""

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('calibrator', **kwargs)
        self.parameters = NodeParameters(self, CALIBRATOR, arguments=arguments)
        settings = self.parameters.settings
        twin, rig = full_name(self, settings['twin']), settings['rig']
        self._joints = joint_names(settings)
        self._measured = MeasuredPositions(self, twin, self._joints)
        create_subscription(self, TWIN_TOPICS.throw_result.at(twin), self._on_results)
        self._command: JointTrajectory | None = None  # the last one
        create_subscription(self, TWIN_TOPICS.plate_trajectory.at(twin), self._on_command)
        self._twin = RemoteParameters(self, twin)
        self._rig = RemoteParameters(self, full_name(self, rig)) if rig else None
        apply = interface.resolve(interface.TWIN_SERVICES.apply_recommendation.name, twin)
        self._apply = self.create_client(Trigger, apply)
        self._outgoing = Publishers(self, CALIBRATOR_TOPICS)
        self._status = self._outgoing.status('identification', 'nothing has been identified yet')
        self._ended: ThrowResult | None = None  # the last throw, until it is used
        self._rig_of_throws: Rig | None = None  # of the collected throws
        self._mispredicted: list[ThrowTracks] = []  # in a row
        self._predicted: list[MeasuredThrow] = []  # in a row
        self._commanded: list[MeasuredThrow] | None = None  # until their gain is known
        self._worker = threading.Thread()  # alive during a task
        self._closing = threading.Event()
        self.add_cleanup(self._stop)
        self.create_steady_timer(_READ_PERIOD, self._read_measurements)
        self.create_steady_timer(1.0, self._publish_status)

    def _publish_status(self) -> None:
        self._outgoing.report(CALIBRATOR_TOPICS.diagnostics, [self._status])

    def _report(
        self, message: str, values: Settings = MappingProxyType({}), *, warn: bool = False
    ) -> None:
        """Publish a message, then log it: a user who has seen the line may end the node."""
        self._status = self._outgoing.status('identification', message, values, warn=warn)
        self._publish_status()
        if warn:
            self.get_logger().warning(message)
        else:
            self.get_logger().info(message)

    def _stop(self) -> None:
        self._closing.set()
        if self._worker.is_alive():
            self._worker.join(STOP_TIMEOUT)

    # Executor thread

    def _on_command(self, msg: JointTrajectory) -> None:
        self._command = msg

    def _on_results(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            try:
                result = msg_to_throw_result(status)
            except ValueError as error:
                self.get_logger().warning(f'a result cannot be used: {error}')
                continue
            if result.stage == 'final' and not self._worker.is_alive():
                self._ended = result
                if result.clock_offset_ns is not None:
                    self._measured.clock_offset_ns = result.clock_offset_ns

    def _read_measurements(self) -> None:
        """Read measurements, and use the last throw as soon as its track is complete."""
        self._measured.read_messages()
        if (result := self._ended) is None:
            return
        period_ns = 1e9 / result.rig.engine.frequency
        begin_ns = result.start_ns - round(_BEFORE * period_ns)
        end_ns = result.start_ns + round(_AFTER * period_ns)
        if self._measured.newest_ns < end_ns:
            return
        self._ended = None
        try:
            if self._commanded is None:
                self._on_measured_throw(result, begin_ns, end_ns)
            elif result.is_valid and result.accuracy is None:
                self._on_commanded_throw(self._commanded, result)
        except ValueError as error:  # of the tracks, or a command
            self.get_logger().warning(f'throw {result.throw} cannot be used: {error}')

    def _on_measured_throw(self, result: ThrowResult, begin_ns: int, end_ns: int) -> None:
        """Collect a throw; identify the rig, or command a motion, after enough of them."""
        comparison, settings = result.comparison, self.parameters.settings
        if result.clock_offset_ns is None or result.ended_by == 'gap':  # there is no whole track
            return
        if result.rig != self._rig_of_throws:  # one fit needs throws of one rig
            self._mispredicted, self._predicted = [], []
            self._rig_of_throws = result.rig
        if comparison is None or not comparison.is_within_threshold:
            self._predicted = []
            tracks = self._measured.between(begin_ns, end_ns, f'throw {result.throw}')
            self._mispredicted.append(tracks)
            if len(self._mispredicted) >= settings['throws']:
                self._submit(
                    partial(self._identify, self._mispredicted, result.rig),
                    f'the last {len(self._mispredicted)} throws deviated from the prediction, or '
                    'were too noisy for one; identifying the rig',
                )
                self._mispredicted = []
            return
        self._mispredicted = []
        if settings['motion_after'] and result.first is not None:
            self._predicted.append(self._measure_flight(result, result.first.release_ns))
            if len(self._predicted) >= settings['motion_after']:
                self._submit(
                    self._command_motion,
                    f'the last {len(self._predicted)} throws followed the prediction; designing '
                    'the motion of the plate',
                )

    def _on_commanded_throw(self, throws: list[MeasuredThrow], result: ThrowResult) -> None:
        """Measure a throw whose motion the twin commanded, and report the gain after some."""
        if result.first is None or self._command is None:
            return
        due_ns = result.start_ns + round(1e9 * result.first.ejection_time)  # of the release
        tracks = self._measured.between(result.start_ns, due_ns, max_gap=result.rig.crossing_time)
        motion = msg_to_motion(self._command, self._joints[0])
        delay_ns = round(1e9 * motion_delay(tracks.plate, motion))
        throws.append(self._measure_flight(result, due_ns + delay_ns))
        if len(throws) == self.parameters.settings['throws']:
            self._report(*describe_gain(self._predicted, throws, result.rig.gravity))
            self._predicted, self._commanded = [], None

    def _measure_flight(self, result: ThrowResult, release_ns: int) -> MeasuredThrow:
        """Measure a throw by its track from the release to the apex, or raise TrackError."""
        assert result.first is not None
        gravity, duration = result.rig.gravity, 1.0 / result.rig.engine.frequency
        if gravity:
            duration = min(duration, result.first.ejection_speed / gravity)
        end_ns = release_ns + round(1e9 * duration)
        tracks = self._measured.between(release_ns, end_ns, max_gap=result.rig.crossing_time)
        assert tracks.projectile is not None
        speed = flight_speed(tracks.projectile, gravity=gravity)
        return MeasuredThrow(speed, result.peak_plate_speed)

    def _submit(self, task: Callable[[], None], reason: str) -> None:
        self.get_logger().info(reason)
        self._worker = threading.Thread(target=self._run, args=(task,), daemon=True)
        self._worker.start()

    # Worker thread

    def _run(self, task: Callable[[], None]) -> None:
        """Run a task; log and publish the reason if it has changed nothing."""
        try:
            task()
        except Exception as error:  # noqa: BLE001  later throws must still be used
            if not isinstance(error, (RequestRejected, ValueError)):
                self.get_logger().error(traceback.format_exc())
            if not self._closing.is_set():
                self._report(f'nothing has been changed: {str(error) or repr(error)}', warn=True)
            self._predicted = []

    def _command_motion(self) -> None:
        """Make the twin command the best motion of the plate, or leave its parameters."""
        before = self._twin.get(_OF_COMMAND)
        try:
            self._twin.set({'recommendation.vary': 'motion'})
            applied = self._apply_recommendation()
            self._twin.set({'engine.command': True})
        except RequestRejected:
            self._twin.set(before)
            raise
        self.get_logger().info(f'commanded: {applied}')
        self._commanded = []

    def _identify(self, tracks: list[ThrowTracks], rig: Rig) -> None:
        """Identify the rig and apply the result."""
        (stamp_error,) = self._twin.get(['measured.stamp_error']).values()
        throws = [item.apply(partial(replace, stamp_error=stamp_error)) for item in tracks]
        self._apply_fit(fit_rig(throws, rig, _DESCRIPTION))

    def _apply_fit(self, rig_fit: RigFit) -> None:
        """Set the fitted parameters of the twin, and give the rig the recommended layer."""
        fit, warnings = rig_fit.fit, fit_warnings(rig_fit.fit)
        for warning in warnings:
            self.get_logger().warning(warning)
        if fit.is_mismatch:
            raise ValueError('no parameters of the model reproduce the motion of the projectile')
        if not fit.is_converged:
            raise ValueError('the fit stopped at its limit before it converged')
        values = {name: rig_fit.estimate(name) for name in DEFAULT_FREE}
        self._twin.set({name: each.value for name, each in values.items()})
        words = (f'{name} {each.value:.5g} +- {each.error:.1g}' for name, each in values.items())
        outliers = sum(len(residual.outliers) for residual in fit.residuals)
        texts = {f'warning {number}': text for number, text in enumerate(warnings, 1)}
        rows = {**rig_fit.estimates(), 'outliers': outliers, **texts}
        self._report(f'identified: {", ".join(words)}', rows, warn=bool(warnings))
        if self._rig is not None:
            before = self._twin.get(_LAYER)
            self.get_logger().info(f'recommended: {self._apply_recommendation()}')
            if changes := dict(self._twin.get(_LAYER).items() - before.items()):
                self._rig.set(changes)

    def _apply_recommendation(self) -> str:
        """Request that the twin applies its recommendation; return the answer of the service."""
        for _ in range(_MAX_ATTEMPTS):
            response = call(self._apply, Trigger.Request())
            if response.success:
                return str(response.message)
            if self._closing.wait(_PAUSE):
                break
        raise RequestRejected(f'{self._apply.srv_name}: {response.message}')


def describe_gain(
    by_engine: Sequence[MeasuredThrow], commanded: Sequence[MeasuredThrow], gravity: float
) -> tuple[str, dict[str, object]]:
    """
    Return the gain of the commanded motion as a sentence, and its values.

    The errors have the larger scatter, among or within throws, and the common errors.
    """
    values: dict[str, object] = {}
    for name, throws in (('engine', by_engine), ('commanded', commanded)):
        speeds, errors = np.transpose([throw.speed for throw in throws])
        scatter = float(max(np.sqrt(np.mean(errors**2)), speeds.std(ddof=int(speeds.size > 1))))
        error = math.hypot(scatter / math.sqrt(speeds.size), gravity * _RELEASE_TIME_ERROR)
        mean = float(speeds.mean())
        alpha = (mean / float(np.mean([throw.peak_plate_speed for throw in throws]))) ** 2
        values[f'{name}.ejection_speed'] = Estimate(mean, error)
        values[f'{name}.energy_transfer'] = Estimate(alpha, 2.0 * alpha * error / mean)
        values[f'{name}.throws'] = speeds.size
    gains = (
        f'{values[f"engine.{name}"]} -> {values[f"commanded.{name}"]}'
        for name in ('ejection_speed', 'energy_transfer')
    )
    text = 'measured gain by the commanded motion: ejection speed {} m/s, energy transfer {}'
    return text.format(*gains), values


main = partial(run, 'calibrator', Calibrator)
