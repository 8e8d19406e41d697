# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node `rig`: a simulated rig with measured plate and projectile, for tests without a rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np
from soft_throw_ros.configuration import Settings
from soft_throw_ros.configuration.interface import RIG_TOPICS
from soft_throw_ros.configuration.motions import PARAMETER as MOTION_FILE
from soft_throw_ros.configuration.node_tables import RIG, to_twin
from soft_throw_ros.configuration.twin import joint_names
from soft_throw_ros.nodes.conversions import msg_to_motion, msg_to_time
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run
from soft_throw_ros.nodes.realtime import RealTimeNode
from soft_throw_ros.nodes.topics import create_subscription, Publishers
from soft_throw_ros.simulated_rig.imperfect_rig import Deviations, Imperfections
from soft_throw_ros.simulated_rig.sensor_faults import chances_one_by_one, SensorFaults
from soft_throw_ros.twin.session import RequestRejected, Session
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint


class SimulatedRig(RealTimeNode):
    """
    A session of a twin with its own parameters, measured by faulty sensors.

    `Deviations` are effects that no model of the core has, such as a plate that rings. A
    trajectory replaces the motion of the engine; periodic throws and `Deviations` then stop.
    """

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('rig', **kwargs)
        self._chances = chances_one_by_one(np.random.default_rng(0))
        self._throws = self._start = 0  # number of throws, and step at which the last one began
        self._is_worn = False
        self._commanded: list[JointTrajectoryPoint] = []  # the last motion
        self._start_ns: int | None = None  # of the commanded motion, until it has begun
        self.parameters = NodeParameters(
            self,
            RIG,
            self._on_changed,
            check=lambda settings, before: self.prepare(to_twin(settings), before),
            arguments=arguments,
        )
        settings = self.parameters.settings
        self._joints = joint_names(settings)
        publishers = Publishers(self, RIG_TOPICS, self._joints)
        self.send = partial(publishers.send, RIG_TOPICS.measured_joint_states)
        self._played = self.parameters.checked.config.settings
        self._faults = _faults_of(SensorFaults, settings)
        self._deviations = self._next_deviations = self._find_deviations()
        self.attach_session(Session(self.parameters.checked))
        create_subscription(self, RIG_TOPICS.plate_trajectory, self._on_trajectory)

    # Tick thread

    def on_tick(self, due: int) -> None:
        """Start the commanded motion if it is due, advance, and publish what sensors measure."""
        if self._start_ns is not None and due >= self._start_ns:
            self._start_ns = None
            try:
                self.session.request_throw()
            except RequestRejected as refusal:
                self.get_logger().warning(f'a commanded motion is not played: {refusal}')
        outputs = self.session.advance()
        if outputs.throw != self._throws:
            self._throws, self._start = outputs.throw, outputs.step
            self._deviations = self._next_deviations
        time = outputs.step / self.session.rate
        plate, projectile, plate_velocity, projectile_velocity = outputs.state[:4]
        of_plate, of_projectile = self._deviation((outputs.step - self._start) / self.session.rate)
        sample = self._faults.measure(
            time,
            lambda moment: plate + of_plate + (moment - time) * plate_velocity,
            lambda moment: projectile + of_projectile + (moment - time) * projectile_velocity,
            next(self._chances),
        )
        if sample.is_received:
            self.send(due + round(1e9 * (sample.stamp - time)), (sample.plate, sample.projectile))

    def _deviation(self, since: float) -> tuple[float, float]:
        """Return the deviations of plate and projectile from the model [m] since a throw [s]."""
        deviations, period = self._deviations, self.parameters.settings['throw.period']
        is_before_next = period and deviations and since > period + deviations.start  # it rings
        if deviations is None or not (self._throws or is_before_next):
            return 0.0, 0.0
        return deviations.at(since - period if is_before_next else since)

    # Executor thread

    def on_second(self) -> None:
        """Apply the wear of the layer after its number of throws."""
        super().on_second()
        settings = self.parameters.settings
        if not self._is_worn and 0 < settings['wear.throws'] <= self._throws:
            self._is_worn = True
            worn = settings['layer.wave_speed'] * settings['wear.wave_speed']
            self.parameters.apply({'layer.wave_speed': worn})

    def _on_changed(self, _changes: Settings) -> None:
        settings = self.parameters.settings
        before, self._played = self._played, self.parameters.checked.config.settings
        self._faults = _faults_of(SensorFaults, settings)
        deviations = self._find_deviations()
        changes = {name: value for name, value in self._played.items() if value != before[name]}
        if not self._commanded:
            self.session.change(changes, self.parameters.checked)
            self._next_deviations = deviations  # in effect with the next throw, as the settings
        else:
            self.session.change(changes | {'throw.period': 0.0})

    def _on_trajectory(self, message: JointTrajectory) -> None:
        """Prepare a commanded motion, and start it at its stamp."""
        start_ns, now_ns = msg_to_time(message.header.stamp), self._current_clock().now()
        refusal = ''
        try:
            motion = msg_to_motion(message, self._joints[0])
        except ValueError as error:
            refusal = str(error)
        if start_ns < now_ns:
            late = f'{1e-6 * (now_ns - start_ns):.0f} ms'
            refusal = f'it started {late} ago; increase engine.command_lead of the twin'
        if refusal:
            self.get_logger().warning(f'a commanded motion is refused: {refusal}')
            return
        if message.points != self._commanded:
            self._commanded, self._next_deviations = message.points, None
            name = f'commanded motion of {start_ns} ns'
            changes = {'engine.motion': 'file', MOTION_FILE: name, 'throw.period': 0.0}
            self.session.change(changes, motion_of=lambda _path: motion)
            self.session.reset()  # otherwise the first throw would return to rest before it starts
        self._start_ns = start_ns

    def _find_deviations(self) -> Deviations | None:
        """Return the effect of the imperfections, computed in about 0.3 s; None without any."""
        faults = _faults_of(Imperfections, self.parameters.settings)
        return Deviations(self.parameters.checked.rig, faults) if faults.are_present else None


def _faults_of(kind: Any, settings: Settings) -> Any:
    """Make faults of a kind by the parameters with the names of its fields."""
    values = {name.removeprefix('faults.'): value for name, value in settings.items()}
    return kind(**{item.name: values[item.name] for item in fields(kind) if item.name in values})


main = partial(run, 'rig', SimulatedRig)
