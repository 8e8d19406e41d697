# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Commanded motions, as a joint_trajectory_controller with its default settings plays them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rclpy.duration import Duration
from scipy.interpolate import BPoly
from soft_throw_ros.configuration import motions
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.design.motion import design_motion, PlateLimits
from soft_throw_ros.nodes.conversions import msg_to_time

ENGINE = PlateLimits.of(Engine())
STROKE = PlateLimits(speed=0.4, acceleration=120.0, travel=2.01e-3)


def play(message: Any, arrival_ns: int, held: tuple[float, ...]) -> tuple[Any, Any]:
    """
    Return times [ns] and heights, velocities and accelerations of a controller.

    Quintics join the held state and the points; a trajectory that ends in motion is rejected.
    """
    start_ns = msg_to_time(message.header.stamp)
    stamps, states = [arrival_ns], [held]
    for point in message.points:
        stamps.append(start_ns + Duration.from_msg(point.time_from_start).nanoseconds)
        states.append((*point.positions, *point.velocities, *point.accelerations))
        assert not point.effort
    assert message.joint_names == ['plate']
    assert (np.diff(stamps) > 0).all()
    assert abs(states[-1][1]) <= np.finfo(np.float32).eps
    knots = 1e-9 * (np.array(stamps) - arrival_ns)
    height = BPoly.from_derivatives(knots, states)
    times = np.interp(np.linspace(0, knots.size - 1, 200 * knots.size), range(knots.size), knots)
    path = [height.derivative(order)(times) for order in range(3)]
    return arrival_ns + np.rint(1e9 * times), np.array(path)


STATES = np.array([[0.0, 0.0, 0.0], [2e-3, 0.0, 0.0], [0.0, 0.0, 0.0]])


@pytest.mark.parametrize(('motion_of', 'limits'), [
    (lambda: SampledMotion(np.array([0.0, 0.01, 0.03]), STATES), STROKE),
    pytest.param(
        lambda: design_motion(Rig(layer=Layer(thickness=5.6e-3))).motion, ENGINE,
        marks=pytest.mark.slow,
    ),
])
def test_commands_are_played_as_in_the_twin_and_within_limits(ros, write, motion_of, limits):
    twin = ros.start_twin(
        engine__motion_file=write(motions.to_csv(motion_of()), 'plate.csv'),
        engine__command='true', engine__command_lead=0.05, throw__period=0.5,
    )
    listener = ros.listen_to(twin)
    listener.listen(TWIN_TOPICS.plate_trajectory)
    held = (0.0, 0.0, 0.0)
    for number in (1, 2):
        shown = len(twin.outputs)
        twin.go(600)
        message = listener.hear(TWIN_TOPICS.plate_trajectory, number)[-1]
        (sent,) = (out.step for out in twin.outputs[shown:] if out.command is not None)
        arrival_ns = twin.session.due_ns(sent)
        assert msg_to_time(message.header.stamp) - arrival_ns == 50_000_000
        times, (height, *derivatives) = play(message, arrival_ns, held)
        for values, name in zip(derivatives, ('speed', 'acceleration'), strict=True):
            assert np.abs(values).max() <= getattr(limits, name) * (1.0 + 1e-6), name
        assert np.ptp(height) <= limits.travel * (1.0 + 1e-6)
        held = height[-1], *(values[-1] for values in derivatives)
        due = [twin.session.due_ns(out.step) for out in twin.outputs[shown:]]
        plate = [out.state.plate_position for out in twin.outputs[shown:]]
        assert plate == pytest.approx(np.interp(due, times, height), abs=1e-6)
