# SPDX-License-Identifier: Apache-2.0
"""The rig that is played, in this process; its clock is the test's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from soft_throw_ros.configuration.rig import to_twin
from soft_throw_ros.nodes import topics
from soft_throw_ros.nodes.rig import Rig
from soft_throw_ros.recording.cdr import decode_joint_states, JointStates
from soft_throw_ros.twin.session import Session

SECOND = 1_000_000_000
RATE = 5000
QUIET = ('-p', 'noise:=0.0', '-p', 'jitter:=0.0')


class GivenClock:
    """A clock that shows what it is told to."""

    epoch = 0
    max_catch_up = 1000 * SECOND
    tolerance = SECOND

    def __init__(self) -> None:
        self.time = SECOND

    def now(self) -> int:
        return self.time

    def wait_until(self, deadline: int) -> None:
        raise AssertionError(f'nobody waits in this test, but until {deadline}')


class Driven(Rig):
    """A rig that goes where the test sends it, and remembers what its sensors told."""

    def __init__(self, **kwargs: Any) -> None:
        self.clock = GivenClock()
        super().__init__(system_clock=self.clock, **kwargs)
        self.told: list[bytes] = []
        self._publish = self.told.append
        self.ticker.run_due()  # the first step

    def go(self, seconds: float) -> None:
        """Let so much time pass."""
        self.clock.time += round(seconds * SECOND)
        self.ticker.run_due()

    def measured(self) -> JointStates:
        """Return all that the sensors told."""
        return decode_joint_states(self.told)


@pytest.fixture
def start(ros: Any) -> Any:
    """Start a rig with ROS arguments."""
    return lambda *ros_args: ros.node(Driven, ros_args=ros_args)


def exact(rig: Driven, count: int) -> np.ndarray:
    """Return where plate and projectile are at so many steps."""
    session = Session(to_twin(rig.parameters.settings))
    return np.array([session.advance().state[:4] for _ in range(count)])


def test_perfect_sensors_tell_where_everything_is(start) -> None:
    rig = start(*QUIET)
    rig.go(1.5)
    measured = rig.measured()
    assert tuple(measured.names) == topics.JOINTS
    assert (np.diff(measured.stamps) == SECOND // RATE).all()
    assert np.ptp(measured.position[:, 1]) > 0.08  # it has thrown
    assert (measured.position == exact(rig, len(rig.told))[:, :2]).all()
    assert measured.velocity.size == 0


def test_sensors_are_as_bad_as_they_should_be(start) -> None:
    rig = start('-p', 'noise:=1e-4', '-p', 'jitter:=5e-5')
    rig.go(1.5)
    measured = rig.measured()
    states = exact(rig, len(rig.told))
    late = 1e-9 * (measured.stamps - measured.stamps[0]) - np.arange(len(states)) / RATE
    late -= 0.5 * (late.max() + late.min())
    assert np.abs(late).max() == pytest.approx(5e-5, rel=0.02)
    moved = states[:, :2] + late[:, None] * states[:, 2:]
    noise = measured.position - moved
    assert noise.std(axis=0) == pytest.approx([1e-4, 1e-4], rel=0.05)
    assert noise.mean(axis=0) == pytest.approx([0.0, 0.0], abs=1e-5)


def test_layer_ages_once_after_its_throws(start, ros) -> None:
    rig = start(
        *QUIET, '-p', 'wear.throws:=2', '-p', 'wear.wave_speed:=0.5', '-p', 'throw.period:=0.6'
    )
    rig.go(0.9)
    speed = rig.parameters.settings['layer.wave_speed']
    rig.go(1.0)
    ros.spin_until(lambda: rig.parameters.settings['layer.wave_speed'] != speed, 'wear')
    assert rig.parameters.settings['layer.wave_speed'] == 0.5 * speed
    rig.go(2.0)
    assert rig.session.pending == {}
    assert not rig.get_parameter('layer.wave_speed').value < 0.5 * speed


def test_rig_that_cannot_be_played_is_refused_with_the_number(start) -> None:
    with pytest.raises(ValueError, match='layer'):
        start('-p', 'layer.thickness:=0.0005', '-p', 'layer.wave_speed:=200.0')
