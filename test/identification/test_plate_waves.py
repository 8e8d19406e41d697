# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of a plate that rings."""

import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.identification.plate_waves import PlateWithWaves

STEP = Underdamped(frequency=63.2, damping_ratio=0.064, amplitude=2e-3)
MOTION = PlateWithWaves(STEP, (0.01, -0.02))


def test_velocity_is_the_derivative_of_the_position():
    time, step = np.array([-0.01, 0.003, 0.04]), 1e-7
    slope = (MOTION.position(time + step) - MOTION.position(time - step)) / (2.0 * step)
    assert MOTION.velocity(time) == pytest.approx(slope, rel=1e-5)


def test_sampled_motion_agrees_with_the_motion():
    sampled = MOTION.sampled(-0.01, 0.05)
    kept = (sampled.times >= -0.01) & (np.abs(sampled.times) > 1e-4)
    time, states = sampled.times[kept], sampled.states[kept]
    # The kept times begin after the lead-in during which the ringing grows
    assert states[:, 0] == pytest.approx(MOTION.position(time), abs=1e-12)
    assert states[:, 1] == pytest.approx(MOTION.velocity(time), abs=1e-9)
    assert sampled.states[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_step_without_waves_is_not_sampled():
    assert PlateWithWaves(STEP).sampled(0.0, 0.1) is None
