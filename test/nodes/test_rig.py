# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The simulated rig in this process, on a clock set by the test."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from ros_nodes import GivenClock, rules
from soft_throw_ros.configuration.interface import RIG_TOPICS
from soft_throw_ros.configuration.node_tables import to_twin
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.rig import SimulatedRig
from soft_throw_ros.nodes.topics import Publishers
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.prepared_rig import prepare
from soft_throw_ros.twin.session import Session

RATE = 5000


class Driven(SimulatedRig):
    """A simulated rig on a clock set by the test, which keeps its stamps and positions."""

    def __init__(self, **kwargs: Any) -> None:
        self.clock = GivenClock()
        super().__init__(system_clock=self.clock, **kwargs)
        self.stamps: list[int] = []
        self.positions: list[tuple[float, float]] = []
        self.send = self._keep
        self.ticker.run_due()  # the first step

    def _keep(self, stamp_ns: int, positions: tuple[float, float]) -> None:
        self.stamps.append(stamp_ns)
        self.positions.append(positions)

    def go(self, seconds: float) -> None:
        self.clock.time += round(seconds * SECOND)
        self.ticker.run_due()


@pytest.fixture
def start(ros: Any) -> Any:
    quiet = {'noise': 0.0, 'jitter': 0.0}
    return lambda **values: ros.node(Driven, ros_args=rules(**{**quiet, **values}))


def test_perfect_sensors_measure_the_true_positions(start) -> None:
    rig = start()
    rig.go(1.5)
    assert set(np.diff(rig.stamps)) == {SECOND // RATE}
    assert np.ptp(rig.positions, axis=0)[1] > 0.08  # it has thrown
    session = Session(prepare(to_twin(rig.parameters.settings)))
    assert rig.positions == [session.advance().state[:2] for _ in rig.stamps]


def test_sensors_and_rig_have_the_faults_of_the_parameters(start) -> None:
    faults = {'faults__missing_rate': 0.1, 'faults__ringing': 0.02}
    rig = start(jitter=5e-5, throw__period=0.8, **faults)
    rig.go(1.5)
    assert len(rig.stamps) == pytest.approx(0.9 * 1.5 * RATE, rel=0.05)
    intervals = 1e-9 * RATE * (np.array(rig.stamps) - rig.stamps[0])
    assert np.ptp(intervals - np.round(intervals)) == pytest.approx(1e-4 * RATE, rel=0.02)
    session = Session(prepare(to_twin(rig.parameters.settings)))
    steps = [session.advance() for _ in range(round(1.5 * RATE))]
    begin = next(number for number, step in enumerate(steps) if step.throw)
    plate = [steps[number].state.plate_position for number in np.round(intervals).astype(int)]
    deviation = np.abs(np.array(rig.positions)[:, 0] - plate)
    assert deviation[intervals < begin].max() > 1e-5  # it rings before the throw


def test_layer_ages_once_after_its_throws(start, ros) -> None:
    rig = start(wear__throws=2, wear__wave_speed=0.5, throw__period=0.6)
    rig.go(0.9)
    speed = rig.parameters.settings['layer.wave_speed']
    rig.go(1.0)
    ros.spin_until(lambda: rig.parameters.settings['layer.wave_speed'] != speed, 'wear')
    rig.on_second()
    rig.go(2.0)
    assert rig.session.pending == {}
    assert rig.get_parameter('layer.wave_speed').value == 0.5 * speed


def test_motion_is_played_from_its_stamp_on_and_a_late_one_is_refused(ros, start) -> None:
    rig = start(throw__period=0.7)
    topic = replace(RIG_TOPICS.plate_trajectory, is_input=False)
    node, log = ros.node(RunnableNode, 'controller'), ros.listen_to(rig).log()
    publishers = Publishers(node, [topic])
    ros.spin_until(lambda: node.count_subscribers(topic.name) > 0, 'the rig')
    times = np.linspace(0.0, 0.06, 301)
    heights = 1e-3 * (1.0 - np.cos(2.0 * np.pi * times / 0.06)) * np.sin(40.0 * times)
    motion = SampledMotion.from_positions(times, heights)
    publishers.send(topic, rig.clock.time - SECOND, motion)
    ros.spin_until(lambda: any('1000 ms' in line for line in log), 'the refusal')
    start_ns = rig.clock.time + SECOND // 4
    publishers.send(topic, start_ns, motion)
    ros.spin_until(lambda: rig._start_ns is not None, 'the trajectory')
    rig.go(1.5)
    stamps, plate = np.array(rig.stamps), np.array(rig.positions)[:, 0]
    begin = stamps[stamps >= start_ns][0]
    since = 1e-9 * (stamps - begin)
    assert begin - start_ns < SECOND // RATE
    played = (since >= 0.0) & (since < 0.05)
    assert plate[played] == pytest.approx(motion.position(since[played]), abs=1e-9)
    assert rig.session.throws == 1  # no periodic throws
