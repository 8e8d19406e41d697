# SPDX-License-Identifier: Apache-2.0
"""The node `rig`: plays a rig whose plate and projectile are measured, for trials without one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from soft_throw_ros.configuration.rig import RIG, to_twin
from soft_throw_ros.nodes import topics
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import Program, run
from soft_throw_ros.nodes.realtime import Clock, NodeClock, SystemClock, Ticker
from soft_throw_ros.nodes.twin import prepare_process, STOP_TIME
from soft_throw_ros.recording.cdr import JointStateEncoder
from soft_throw_ros.twin.prepared_rig import check_settings
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session

USAGE = 'usage: rig [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]'

_BLOCK = 4096  # random numbers that are drawn at a time


class Rig(Program):
    """
    A rig that throws by itself, as far as sensors tell.

    Parameters
    ----------
    arguments : sequence of str
        The command line, to say where a bad parameter stands.
    system_clock : Clock
        What measurements are due by, unless the node follows `/clock`.
    **kwargs
        As for `rclpy.node.Node`.

    Raises
    ------
    ParameterError
        In one line, if a parameter is refused.

    Notes
    -----
    Inside is the session of a twin with parameters of its own, which whoever watches the rig does
    not know. What it publishes are positions, with noise, at times which are not quite even.

    """

    def __init__(
        self,
        *,
        arguments: Sequence[str] = (),
        system_clock: Clock | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__('rig', **kwargs)
        self._system_clock = system_clock or SystemClock()
        self._random = np.random.default_rng(0)
        self._draws: Iterator[tuple[float, float, float]] = iter(())
        self._throws = 0
        self._is_worn = False
        try:
            self._publish = topics.MEASURED.at('/twin').publisher(self).publish
            self._encode = JointStateEncoder(topics.FRAME, topics.JOINTS, series=1).encode
            self.parameters = NodeParameters(
                self,
                RIG,
                self._on_changed,
                check=lambda settings: check_settings(to_twin(settings)),
                arguments=arguments,
            )
            self._played = to_twin(self.parameters.settings)
            self.session = Session(self._played)
            self._node_clock = NodeClock(self)
            self.ticker = Ticker(self.session, self._on_step, self._current_clock)
            self.create_timer(0.1, self._on_look)
        except BaseException:
            super().destroy_node()
            raise

    @property
    def exit_code(self) -> int | None:
        """1 if the ticks have come to an end by themselves."""
        return None if self.ticker.is_alive else 1

    def start(self) -> None:
        """Throw."""
        self.ticker.start()
        self.get_logger().info('ready')

    def destroy_node(self) -> None:
        """Stop, and let go of everything."""
        self.ticker.stop(STOP_TIME)
        self._node_clock.close()
        super().destroy_node()

    # in the thread of the ticks

    def _current_clock(self) -> Clock:
        return self._node_clock if self._node_clock.is_active else self._system_clock

    def _on_step(self, outputs: Outputs, due: int) -> None:
        """Publish what sensors tell."""
        self._throws = outputs.throw
        settings = self.parameters.settings
        late, plate_noise, projectile_noise = self._draw()
        late *= settings['jitter']
        noise = settings['noise']
        plate, projectile, plate_velocity, projectile_velocity = outputs.state[:4]
        measured = (
            plate + late * plate_velocity + noise * plate_noise,
            projectile + late * projectile_velocity + noise * projectile_noise,
        )
        self._publish(self._encode(due + round(1e9 * late), measured))

    def _draw(self) -> tuple[float, float, float]:
        """Return a number from -1 to 1, and two of the normal distribution."""
        drawn = next(self._draws, None)
        if drawn is None:
            even = self._random.uniform(-1.0, 1.0, _BLOCK)
            normal = self._random.standard_normal((2, _BLOCK))
            self._draws = zip(even.tolist(), *normal.tolist(), strict=True)
            drawn = next(self._draws)
        return drawn

    # in the executor's thread

    def _on_look(self) -> None:
        """Let the layer age when it is time to, and follow the time of day."""
        if isinstance(self._system_clock, SystemClock):
            self._system_clock.adjust()
        settings = self.parameters.settings
        if not self._is_worn and 0 < settings['wear.throws'] <= self._throws:
            self._is_worn = True
            worn = settings['layer.wave_speed'] * settings['wear.wave_speed']
            self.parameters.apply({'layer.wave_speed': worn})

    def _on_changed(self, changes: dict[str, Any]) -> None:
        before, self._played = self._played, to_twin(self.parameters.settings)
        self.session.change(
            {name: value for name, value in self._played.items() if value != before[name]}
        )
        for name, value in changes.items():
            self.get_logger().info(f'{name} is now {value}')


def main(args: list[str] | None = None) -> int:
    """
    Play a rig until SIGINT or SIGTERM.

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
    return run('rig', _make, args, usage=USAGE)


def _make(arguments: Sequence[str]) -> Rig:
    rig = Rig(arguments=arguments)  # which refuses parameters first
    try:
        prepare_process()
    except KeyboardInterrupt:
        rig.destroy_node()
        raise
    return rig
