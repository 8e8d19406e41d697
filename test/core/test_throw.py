# SPDX-License-Identifier: Apache-2.0
"""One throw with all that is asked of it."""

import math

import numpy as np
import pytest
from soft_throw_ros.core.peak import first_peaks
from soft_throw_ros.core.plate import Sampled, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate, ThrowUnfinishedError


# Computed with 40-digit closed forms, checked by a second method
@pytest.mark.parametrize(
    ('thickness', 'largest', 'at_contact'),
    [
        (0.002, 0.20455695136726773, 0.1929978563882354),
        (0.0056, 0.18543981232911014, 0.15991912482862805),
    ],
)
def test_peak_strain_is_exact(thickness, largest, at_contact):
    layer = Layer(thickness=thickness)
    rig = Rig(
        engine=Engine(damping_ratio=0.0),
        layer=layer,
        projectile=Projectile(mass=1300.0 * 16.3e-3 * layer.section),
        gravity=0.0,
    )
    throw = simulate(rig, max_events=1)
    assert throw.peak_strain.value == pytest.approx(largest, rel=1e-8)
    assert throw.peak_contact_strain == pytest.approx(at_contact, rel=1e-8)
    where = throw.peak_strain
    assert abs(throw.history.strain(where.depth, where.time)) == pytest.approx(where.value)
    assert throw.leaves_linear_range


@pytest.mark.parametrize(
    ('mass_ratio', 'speed_ratio', 'gravity'),
    [(0.0054, 1.834, 0.0), (0.0116, 3.516, 9.81), (0.05, 0.5, 0.0), (11.0, 11.8, 9.81)],
)
def test_peaks_agree_with_the_closed_form(mass_ratio, speed_ratio, gravity):
    layer = Layer(thickness=7.8 / (speed_ratio * 63.2))
    rig = Rig(layer=layer, projectile=Projectile(mass=mass_ratio * layer.mass), gravity=gravity)
    throw = simulate(rig, max_events=1)
    closed = first_peaks(
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        damping_ratio=rig.engine.damping_ratio,
        gravity_ratio=rig.gravity_ratio,
    )
    speed = rig.engine.speed_scale
    impact = speed / layer.wave_speed
    assert throw.peak_strain.value == pytest.approx(closed.strain * impact, rel=1e-6)
    assert throw.peak_contact_strain == pytest.approx(closed.contact_strain * impact, rel=1e-8)
    assert throw.peak_acceleration == pytest.approx(
        closed.acceleration * speed * rig.engine.angular_frequency, rel=1e-8
    )
    assert throw.peak_plate_force == pytest.approx(
        closed.plate_force * speed * layer.impedance, rel=1e-8
    )


def test_throw_within_the_linear_range_is_not_flagged():
    throw = simulate(Rig(engine=Engine(amplitude=1e-3)))
    assert throw.peak_strain.value < 0.1
    assert not throw.leaves_linear_range
    assert simulate(throw.rig, max_strain=0.01).leaves_linear_range


def test_energies_add_up_at_the_release():
    plate_work, layer, projectile = simulate(Rig()).energies
    assert plate_work == pytest.approx(layer + projectile, rel=1e-9)
    assert projectile > 0.0


def test_projectile_reaches_the_apex_that_is_announced():
    throw = simulate(Rig())
    times = np.linspace(throw.first_release.time, throw.history.end_time, 20001)
    path = throw.trajectory(times)
    assert path.projectile_position.max() == pytest.approx(throw.apex_height, rel=1e-6)
    assert (path.projectile_position >= path.top_position - 1e-12).all()


def test_fields_are_those_of_the_history_on_their_axes():
    throw = simulate(Rig(), max_events=1)
    fields = throw.fields(np.linspace(0.0, throw.ejection_time, 11), points=5)
    assert fields.strain.shape == fields.velocity.shape == (11, 5)
    assert fields.strain[7, 3] == throw.history.strain(fields.depth[3], fields.time[7])
    static = (
        -throw.rig.projectile.mass
        * 9.81
        / (throw.rig.layer.youngs_modulus * throw.rig.layer.section)
    )
    assert fields.strain[0, 2] == pytest.approx(static)


def test_ejection_time_counts_from_the_start_of_a_sampled_plate():
    times = np.linspace(0.0, 0.02, 201)
    plate = Sampled.from_positions(times + 3.0, Underdamped.of(Engine()).position(times))
    assert simulate(Rig(), plate).ejection_time == pytest.approx(
        simulate(Rig()).ejection_time, abs=1e-8
    )


def test_throw_without_gravity_has_no_apex():
    assert math.isinf(simulate(Rig(gravity=0.0)).apex_height)


def test_unfinished_throw_is_named():
    with pytest.raises(ThrowUnfinishedError, match=r'not released by 0\.00215'):
        simulate(Rig(), until=1e-3)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'model': 'magic'}, "model must be one of travelling_wave, got 'magic'"),
        ({'max_strain': 0.0}, r'max_strain .*got 0\.0'),
    ],
)
def test_bad_requests_are_refused_with_the_value(arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate(Rig(), **arguments)
    with pytest.raises(ValueError, match='points must be at least 2, got 1'):
        simulate(Rig(), max_events=1).fields([0.0], points=1)
