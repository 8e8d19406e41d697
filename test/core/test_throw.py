# SPDX-License-Identifier: Apache-2.0
"""One throw with all that is asked of it."""

from dataclasses import replace
import math

import numpy as np
import pytest
from soft_throw_ros.core.models import MODELS
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
        ({'model': 'magic'}, "model must be one of travelling_wave, .*, got 'magic'"),
        ({'max_strain': 0.0}, r'max_strain .*got 0\.0'),
    ],
)
def test_bad_requests_are_refused_with_the_value(arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate(Rig(), **arguments)
    with pytest.raises(ValueError, match='points must be at least 2, got 1'):
        simulate(Rig(), max_events=1).fields([0.0], points=1)


GRIDS = ('finite_difference', 'finite_difference_elastic', 'finite_difference_glued')


@pytest.mark.parametrize('gravity', [0.0, 9.81])
def test_finite_differences_agree_with_the_exact_model_in_everything(gravity):
    rig = Rig(gravity=gravity)
    exact, found = simulate(rig), simulate(rig, model='finite_difference')
    for name in ('ejection_time', 'ejection_speed', 'energy_transfer', 'last_energy_transfer',
                 'peak_plate_speed', 'peak_contact_strain', 'peak_acceleration',
                 'peak_plate_force'):  # fmt: skip
        assert getattr(found, name) == pytest.approx(getattr(exact, name), rel=1e-4), name
    assert found.peak_strain.value == pytest.approx(exact.peak_strain.value, rel=1e-4)
    assert found.peak_strain.depth == pytest.approx(exact.peak_strain.depth, abs=1e-4)
    assert found.energies == pytest.approx(exact.energies, rel=1e-4)
    assert found.heat == exact.heat == 0.0
    assert found.recontacts == exact.recontacts
    assert found.apex_height == pytest.approx(exact.apex_height, rel=1e-4)
    assert len(found.events) == len(exact.events)
    for one, other in zip(found.events, exact.events, strict=True):
        assert (one.kind, one.time) == (other.kind, pytest.approx(other.time, rel=1e-4))
        assert one.position == pytest.approx(other.position, rel=1e-3)
    times = np.linspace(0.0, 0.9 * exact.history.end_time, 40)
    path, true_path = found.trajectory(times), exact.trajectory(times)
    for one, other in zip(path, true_path, strict=True):
        assert one == pytest.approx(other, abs=2e-3 * np.abs(other).max())
    fields = found.fields(times[:9], points=17)
    true_fields = exact.fields(times[:9], points=17)
    # a kink is a cell wide
    assert fields.strain == pytest.approx(true_fields.strain, abs=2e-3)
    assert fields.velocity == pytest.approx(true_fields.velocity, abs=2e-3)


@pytest.mark.parametrize('model', [*GRIDS, 'spring_mass'])
def test_work_is_energy_and_heat_in_every_model(model):
    rig = Rig(layer=Layer(loss_tangent=0.1))
    throw = simulate(rig, model=model)
    assert throw.model == model
    assert throw.heat > 0.01 * throw.energies.plate_work
    assert sum(throw.energies[1:]) + throw.heat == pytest.approx(
        throw.energies.plate_work, rel=1e-5
    )


def test_models_are_told_apart_by_what_they_model():
    rig = Rig()
    alpha = {model: simulate(rig, model=model).energy_transfer for model in MODELS}
    exact = alpha.pop('travelling_wave')
    assert alpha['finite_difference'] == pytest.approx(exact, rel=1e-4)
    assert alpha['finite_difference_elastic'] == pytest.approx(exact, rel=1e-4)
    assert alpha['spring_mass'] == pytest.approx(3.117, abs=1e-3)
    assert alpha['finite_difference_glued'] == pytest.approx(2.176, abs=1e-3)


def test_release_by_finite_differences_follows_last_after_recontacts():
    layer = Layer(thickness=7.8 / (2.5 * 63.2))
    rig = Rig(
        engine=Engine(damping_ratio=0.0),
        layer=layer,
        projectile=Projectile(mass=3.0333 * layer.mass),
        gravity=0.0,
    )
    throw = simulate(rig, model='finite_difference')
    # Computed with 40-digit closed forms, checked by a second method
    assert throw.recontacts == 1
    assert throw.energy_transfer == pytest.approx(0.1891200559290065, rel=1e-3)
    assert throw.last_energy_transfer == pytest.approx(0.4218872106128318, rel=1e-3)
    assert throw.last_release.time * 63.2 == pytest.approx(2.002892429791799, rel=1e-4)


@pytest.mark.parametrize('after', ['error', 'hold'])
def test_sampled_plate_that_begins_later_throws_later(after):
    times = np.linspace(0.0, 0.012, 121)
    plate = Sampled.from_positions(
        times + 3.0, Underdamped.of(Engine()).position(times), after=after
    )
    rig = Rig(layer=Layer(loss_tangent=0.05))
    throw = simulate(rig, plate, model='finite_difference', until=3.012)
    even = simulate(rig, model='finite_difference')
    assert throw.first_release.time == pytest.approx(3.0 + even.ejection_time, abs=1e-8)
    assert throw.ejection_time == pytest.approx(even.ejection_time, rel=1e-6)
    assert throw.history.end_time == pytest.approx(3.012, abs=1e-4)
    assert throw.trajectory([2.9]).projectile_velocity == 0.0


def test_history_by_finite_differences_ends_where_it_says():
    throw = simulate(Rig(), model='finite_difference', max_events=1, cells=64)
    end = throw.history.end_time
    assert end == throw.first_release.time
    for ask in (throw.trajectory, throw.fields):
        with pytest.raises(ValueError, match=r'after 0\.00764.* s, where this history ends'):
            ask([end + 1e-6])
    with pytest.raises(ValueError, match=r'depth must be in \[0, 0\.0168\] m, got 0\.02'):
        throw.history.strain(0.02, 0.0)
    assert simulate(Rig(), model='finite_difference', until=0.05).history.end_time == 0.05


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'model': 'finite_difference', 'cells': 0}, 'cells must be from 1 to .* got 0'),
        ({'model': 'finite_difference', 'step': 1.0}, r'step must be at most .* got 1 s'),
        ({'model': 'finite_difference', 'until': -1.0}, r'until must be .* got -1\.0'),
        ({'model': 'finite_difference', 'max_events': 0}, 'max_events must be .* got 0'),
        ({'cells': 100}, 'cells is for finite differences only, got 100'),
        ({'step': 1e-6}, 'step is for finite differences only, got 1e-06'),
    ],
)
def test_bad_grids_are_refused_with_the_value(arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate(Rig(), **arguments)


@pytest.mark.parametrize('model', GRIDS)
def test_unfinished_throw_by_finite_differences_is_named(model):
    with pytest.raises(ThrowUnfinishedError, match=r'not released by 0\.001 s'):
        simulate(Rig(), model=model, until=1e-3)
    held = Rig(engine=Engine(amplitude=1e-5))
    with pytest.raises(ThrowUnfinishedError, match='not released by'):
        simulate(replace(held, gravity=30.0), model=model, cells=32)
