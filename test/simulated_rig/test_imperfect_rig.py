# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Throws of imperfect rigs, compared with independently known results."""

import math

import numpy as np
import pytest
from reference.method_of_steps import follow
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.core.stepper import CAPACITY
from soft_throw_ros.simulated_rig.imperfect_rig import Deviations, Imperfections, throw


def test_perfect_rig_throws_as_by_the_method_of_steps():
    rig = Rig(layer=Layer(thickness=6e-3))
    exact, thrown = follow(rig, until=0.05), throw(rig, until=0.05)
    time = np.linspace(0.0, 0.05, 200)
    assert thrown.projectile(time) == pytest.approx(exact.projectile_position(time), abs=2e-7)
    assert [event.kind for event in thrown.events] == [event.kind for event in exact.events]
    assert thrown.events[0].time == pytest.approx(exact.events[0].time, abs=2e-8)


def test_projectile_that_chatters_on_a_stiff_layer_stays():
    rig = Rig(engine=Engine(frequency=1.0), layer=Layer(wave_speed=73.0), gravity=0.0)
    thrown = throw(rig, until=0.2)
    assert len(thrown.events) >= CAPACITY
    assert thrown.projectile(0.2) == thrown.projectile(0.19)


def test_plate_rings_before_and_has_a_second_mode():
    rig = Rig(layer=Layer(thickness=4e-3))
    thrown = throw(rig, Imperfections(ringing=0.01, second_mode=0.02), until=0.02, start=-0.02)
    time = np.linspace(-0.02, 0.0, 200)
    before = thrown.plate(time) / rig.engine.amplitude
    assert np.abs(before).max() == pytest.approx(0.01, rel=0.1)
    assert thrown.projectile(time) - thrown.projectile(-0.02) == pytest.approx(
        rig.engine.amplitude * (before - before[0]), abs=4e-6
    )
    later = np.linspace(0.0, 0.02, 400)
    ringing = throw(rig, Imperfections(ringing=0.01), until=0.01, start=-0.02)
    extra = thrown.plate(later) - ringing.plate(later)
    assert np.abs(extra).max() == pytest.approx(0.02 * rig.engine.amplitude, rel=0.1)


def test_plate_rings_with_its_own_damping():
    rig, ringing = Rig(), Imperfections(ringing=0.01, ringing_damping_ratio=0.0)
    thrown = throw(rig, ringing, until=0.1, start=-0.02)
    time = np.linspace(0.08, 0.1, 400)
    vibration = thrown.plate(time) - Underdamped.of(rig.engine).position(time)
    assert np.abs(vibration).max() == pytest.approx(0.01 * rig.engine.amplitude, rel=0.01)


def test_deviations_are_differences_of_two_throws_until_the_landing():
    imperfections = Imperfections(ringing=0.005)
    rig = Rig(layer=Layer(thickness=8e-3))
    deviations = Deviations(rig, imperfections)
    pure = throw(rig, until=0.1)
    imperfect = throw(rig, imperfections, until=0.1, start=deviations.start)
    for since in (-0.02, 0.003, 0.0501):
        plate, projectile = deviations.at(since)
        assert plate == pytest.approx(imperfect.plate(since) - pure.plate(since), abs=1e-8)
        assert projectile == pytest.approx(
            imperfect.projectile(since) - pure.projectile(max(since, 0.0)), abs=3e-6
        )
    assert deviations.at(-1.0) == deviations.at(5.0) == (0.0, 0.0)
    assert math.hypot(*deviations.at(-0.05)) > 1e-6
