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
"""The node `rig`: plays a rig whose plate and projectile are measured, for trials without one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.configuration.interface import RIG_TOPICS
from soft_throw_ros.configuration.rig import imperfections_of, RIG, sensor_faults_of, to_twin
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run
from soft_throw_ros.nodes.realtime_node import RealTimeNode
from soft_throw_ros.nodes.topics import Publishers
from soft_throw_ros.twin.imperfect_rig import Deviations, Imperfections
from soft_throw_ros.twin.prepared_rig import check_settings
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.sensor_faults import chances_one_by_one, SensorFaults
from soft_throw_ros.twin.session import Session


class SimulatedRig(RealTimeNode):
    """
    A rig that throws by itself, as far as sensors tell.

    Raises
    ------
    ParameterError
        In one line, if a parameter is refused.

    Notes
    -----
    Inside is the session of a twin with parameters of its own, which whoever watches the rig does
    not know. What it publishes are positions, as faulty sensors see them. What no model does, a
    layer that stiffens for one, is computed beforehand, and added to what the model does.

    """

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('rig', **kwargs)
        self._chances = chances_one_by_one(np.random.default_rng(0))
        self._throws = 0
        self._start = 0  # step at which the last throw began
        self._is_worn = False
        self.parameters = NodeParameters(
            self,
            RIG,
            self._on_changed,
            check=lambda settings: check_settings(to_twin(settings)),
            arguments=arguments,
        )
        self.send = Publishers(self, RIG_TOPICS).sender(RIG_TOPICS.measured_joint_states)
        settings = self.parameters.settings
        self._played = to_twin(settings)
        self.load_kernels(self._played)
        self._faults = SensorFaults(**sensor_faults_of(settings))
        self._deviations = self._next_deviations = self._find_deviations()
        self.drive(Session(self._played))

    # in the thread of the ticks

    def on_step(self, outputs: Outputs, due: int) -> None:
        """Publish what sensors tell."""
        if outputs.throw != self._throws:
            self._throws, self._start = outputs.throw, outputs.step
            self._deviations = self._next_deviations
        rate = self.session.rate
        time = outputs.step / rate
        off = self._off(outputs.step, rate)
        plate, projectile, plate_velocity, projectile_velocity = outputs.state[:4]
        sample = self._faults.measure(
            time,
            lambda seen: plate + off[0] + (seen - time) * plate_velocity,
            lambda seen: projectile + off[1] + (seen - time) * projectile_velocity,
            next(self._chances),
        )
        if sample.is_seen:
            self.send(due + round(1e9 * (sample.stamp - time)), (sample.plate, sample.projectile))

    def _off(self, step: int, rate: float) -> tuple[float, float]:
        """Tell how far plate and projectile are from where the model has them."""
        deviations = self._deviations
        if deviations is None:
            return 0.0, 0.0
        since = (step - self._start) / rate
        period = self.parameters.settings['throw.period']
        if period and since > period + deviations.start:  # the next throw is near
            since -= period
        elif not self._throws:
            return 0.0, 0.0
        return deviations.at(since)

    # in the executor's thread

    def on_second(self) -> None:
        """Let the layer age when it is time to."""
        super().on_second()
        settings = self.parameters.settings
        if not self._is_worn and 0 < settings['wear.throws'] <= self._throws:
            self._is_worn = True
            worn = settings['layer.wave_speed'] * settings['wear.wave_speed']
            self.parameters.apply({'layer.wave_speed': worn})

    def _on_changed(self, _changes: Settings) -> None:
        settings = self.parameters.settings
        before, self._played = self._played, to_twin(settings)
        self._faults = SensorFaults(**sensor_faults_of(settings))
        found = self._find_deviations()
        self.session.change(
            {name: value for name, value in self._played.items() if value != before[name]}
        )
        self._next_deviations = found  # with the next throw, as the rest

    def _find_deviations(self) -> Deviations | None:
        """Compute what imperfections change, which takes a tenth of a second, if there are any."""
        imperfections = Imperfections(**imperfections_of(self.parameters.settings))
        if not imperfections.are_there:
            return None
        return Deviations(rig_of(self._played), imperfections)


main = partial(run, 'rig', SimulatedRig)
