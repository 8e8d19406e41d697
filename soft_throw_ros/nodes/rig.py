# SPDX-License-Identifier: Apache-2.0
"""The node `rig`: plays a rig whose plate and projectile are measured, for trials without one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from soft_throw_ros.configuration.interface import RIG_TOPICS
from soft_throw_ros.configuration.rig import RIG, to_twin
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import run
from soft_throw_ros.nodes.realtime_node import COMPILING, RealTimeNode
from soft_throw_ros.nodes.topics import Publishers
from soft_throw_ros.twin.prepared_rig import check_settings
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session

_BLOCK = 4096  # random numbers that are drawn at a time


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
    not know. What it publishes are positions, with noise, at times which are not quite even.

    """

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('rig', **kwargs)
        self._draws = _draw(np.random.default_rng(0))
        self._throws = 0
        self._is_worn = False
        self.parameters = NodeParameters(
            self,
            RIG,
            self._on_changed,
            check=lambda settings: check_settings(to_twin(settings)),
            arguments=arguments,
        )
        self.send = Publishers(self, RIG_TOPICS).sender(RIG_TOPICS.measured_joint_states)
        self._played = to_twin(self.parameters.settings)
        self.drive(Session(self._played))

    # in the thread of the ticks

    def on_step(self, outputs: Outputs, due: int) -> None:
        """Publish what sensors tell."""
        self._throws = outputs.throw
        settings = self.parameters.settings
        late, plate_noise, projectile_noise = next(self._draws)
        late *= settings['jitter']
        noise = settings['noise']
        plate, projectile, plate_velocity, projectile_velocity = outputs.state[:4]
        measured = (
            plate + late * plate_velocity + noise * plate_noise,
            projectile + late * projectile_velocity + noise * projectile_noise,
        )
        self.send(due + round(1e9 * late), measured)

    # in the executor's thread

    def on_second(self) -> None:
        """Let the layer age when it is time to."""
        super().on_second()
        settings = self.parameters.settings
        if not self._is_worn and 0 < settings['wear.throws'] <= self._throws:
            self._is_worn = True
            worn = settings['layer.wave_speed'] * settings['wear.wave_speed']
            self.parameters.apply({'layer.wave_speed': worn})

    def _on_changed(self, _changes: dict[str, Any]) -> None:
        before, self._played = self._played, to_twin(self.parameters.settings)
        self.session.change(
            {name: value for name, value in self._played.items() if value != before[name]}
        )


def _draw(random: np.random.Generator) -> Iterator[tuple[float, float, float]]:
    """Yield a number from -1 to 1, and two of the normal distribution, again and again."""
    while True:
        even = random.uniform(-1.0, 1.0, _BLOCK)
        normal = random.standard_normal((2, _BLOCK))
        yield from zip(even.tolist(), *normal.tolist(), strict=True)


main = partial(run, 'rig', SimulatedRig, notice=COMPILING)
