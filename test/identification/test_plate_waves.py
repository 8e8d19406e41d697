# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of a plate that rings or has a second mode."""

import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.identification.plate_waves import Mode, PlateWithWaves

STEP = Underdamped(frequency=63.2, damping_ratio=0.064, amplitude=2e-3)
MODE = Mode(310.0, 0.02, rise=0.01, sine=0.02)
MOTIONS = [
    PlateWithWaves(STEP, (0.01, -0.02)),
    PlateWithWaves(STEP, (0.01, -0.02), ringing_damping=0.0),
    PlateWithWaves(STEP, mode=MODE),
    PlateWithWaves(STEP, (0.01, 0.0), mode=MODE),
]


@pytest.mark.parametrize('motion', MOTIONS)
def test_velocity_is_the_derivative_of_the_position(motion):
    time, step = np.array([-0.01, 0.003, 0.04]), 1e-7
    slope = (motion.position(time + step) - motion.position(time - step)) / (2.0 * step)
    assert motion.velocity(time) == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize('motion', MOTIONS)
def test_sampled_motion_agrees_with_the_motion(motion):
    sampled = motion.sampled(-0.01, 0.05)
    kept = (sampled.times >= -0.01) & (np.abs(sampled.times) > 1e-4)
    time, states = sampled.times[kept], sampled.states[kept]
    # The kept times begin after the lead-in during which the waves grow
    assert states[:, 0] == pytest.approx(motion.position(time), abs=1e-12)
    assert states[:, 1] == pytest.approx(motion.velocity(time), abs=1e-9)
    assert sampled.states[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_ringing_decays_with_its_own_damping():
    time = np.array([5.0 / STEP.frequency])
    sizes = []
    for damping in (0.0, None):
        motion = PlateWithWaves(STEP, (0.01, 0.0), ringing_damping=damping)
        sizes.append(float((motion.position(time) - STEP.position(time))[0]))
    assert sizes[0] == pytest.approx(2e-5, rel=1e-3)
    assert abs(sizes[1]) < 0.2 * sizes[0]


def test_step_without_waves_is_not_sampled():
    assert PlateWithWaves(STEP).sampled(0.0, 0.1) is None
