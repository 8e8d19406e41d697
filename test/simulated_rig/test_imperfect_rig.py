# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Throws of imperfect rigs, compared with independently known results."""

import math

import numpy as np
import pytest
from reference.method_of_steps import follow
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.simulated_rig.imperfect_rig import Deviations, Imperfections, throw

UNTIL = 0.05


def test_perfect_rig_throws_as_by_the_method_of_steps():
    for thickness in (6e-3, 16.8e-3):
        rig = Rig(layer=Layer(thickness=thickness))
        exact, thrown = follow(rig, until=UNTIL), throw(rig, until=UNTIL)
        time = np.linspace(0.0, UNTIL, 200)
        assert thrown.projectile(time) == pytest.approx(exact.projectile_position(time), abs=1e-7)
        assert thrown.changes[0].time == pytest.approx(exact.events[0].time, abs=2e-8)
        assert thrown.changes[0].velocity == pytest.approx(exact.events[0].velocity, abs=1e-5)


def test_error_falls_with_the_square_of_the_cells():
    rig = Rig(layer=Layer(loss_tangent=0.1))
    exact = simulate(rig, cells=1024, until=UNTIL).trajectory([0.04])
    errors = [
        abs(float(throw(rig, until=UNTIL, cells=cells).projectile(0.04)) - exact[3][0])
        for cells in (32, 64, 128)
    ]
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([2.0, 2.0], abs=0.2)


def test_layer_that_catches_up_is_in_contact():
    layer = Layer(thickness=6e-3, wave_speed=11.0)
    rig = Rig(
        engine=Engine(frequency=47.0, amplitude=1e-3),
        layer=layer,
        projectile=Projectile(mass=0.15 * layer.mass),
    )
    exact, changes = follow(rig, until=0.02).events, throw(rig, until=0.02).changes
    assert [event.kind for event in exact] == ['release', 'landing', 'release']
    assert [change.is_release for change in changes] == [True, False, True]
    assert [change.time for change in changes] == pytest.approx(
        [event.time for event in exact], abs=2e-6
    )
    assert changes[2].velocity == pytest.approx(exact[2].velocity, abs=1e-3)


@pytest.mark.parametrize(('quadratic', 'cubic'), [(-1.0, 0.0), (2.0, 0.0), (0.0, 20.0)])
def test_layer_that_stiffens_rests_at_the_root_of_its_law(quadratic, cubic):
    rig = Rig(gravity=300.0)
    law = Imperfections(stiffening=quadratic, cubic_stiffening=cubic)
    heights = throw(rig, law, start=-5e-3, until=0.001).projectile(np.linspace(-4e-3, 0.0, 9))
    assert np.ptp(heights) < 1e-9
    strain = 1.0 - heights[0] / rig.layer.thickness
    linear = rig.static_sag / rig.layer.thickness
    assert strain * (1.0 + quadratic * strain + cubic * strain**2) == pytest.approx(linear)


def test_sticking_delays_the_release_by_its_time():
    late, soon = throw(Rig(), Imperfections(sticking=2e-4), until=0.02), throw(Rig(), until=0.02)
    assert late.changes[0].time - soon.changes[0].time == pytest.approx(2e-4, abs=1e-9)
    assert late.changes[0].velocity < soon.changes[0].velocity


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
    extra = thrown.plate(later) - throw(
        rig, Imperfections(ringing=0.01), until=0.01, start=-0.02
    ).plate(later)
    assert np.abs(extra).max() == pytest.approx(0.02 * rig.engine.amplitude, rel=0.1)


def test_deviations_are_differences_of_two_throws_until_the_landing():
    imperfections = Imperfections(stiffening=1.0, ringing=0.005)
    rig = Rig(layer=Layer(thickness=8e-3))
    deviations = Deviations(rig, imperfections)
    pure = throw(rig, until=0.1)
    imperfect = throw(rig, imperfections, until=0.1, start=deviations.start)
    for since in (-0.02, 0.003, 0.0501):
        plate, projectile = deviations.at(since)
        assert plate == pytest.approx(imperfect.plate(since) - pure.plate(since), abs=1e-8)
        assert projectile == pytest.approx(
            imperfect.projectile(since) - pure.projectile(since), abs=3e-6
        )
    assert deviations.at(-1.0) == deviations.at(5.0) == (0.0, 0.0)
    assert math.hypot(*deviations.at(0.003)) > 1e-6


def test_plate_rings_with_its_own_damping():
    rig = Rig()
    ringing = Imperfections(ringing=0.01, ringing_damping_ratio=0.0)
    thrown = throw(rig, ringing, until=0.1, start=-0.02, cells=64)
    time = np.linspace(0.08, 0.1, 400)
    vibration = thrown.plate(time) - Underdamped.of(rig.engine).position(time)
    assert np.abs(vibration).max() == pytest.approx(0.01 * rig.engine.amplitude, rel=0.01)
