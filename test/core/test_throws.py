# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Functions that compute many throws, compared with single throws."""

import itertools
import math

import numpy as np
import pytest
from soft_throw_ros.core.batch import SearchCancelledError
from soft_throw_ros.core.closed_form import first_releases, ThrowUnresolvedError
from soft_throw_ros.core.plate import SampledMotion, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.throws import last_release, RELEASED, rig_with, throw_many

THICKNESS, SPEED = np.geomspace(5e-3, 0.05, 4)[:, None], np.array([5.0, 8.0, 15.0])
TIMES = np.arange(0.0, 0.05, 2e-4)
MOTION = SampledMotion.from_positions(TIMES, Underdamped.of(Engine()).position(TIMES))
STACK = Layer.of_sheets((Layer(thickness=8e-3, loss_tangent=0.1), Layer(wave_speed=20.0)))
CHANGES = {
    'frequency': 50.0, 'amplitude': 1e-3, 'damping_ratio': 0.1, 'thickness': 0.01,
    'wave_speed': 12.0, 'density': 900.0, 'diameter': 0.015, 'loss_tangent': 0.2, 'mass': 3e-3,
    'gravity': 5.0,
}


@pytest.mark.parametrize(
    'rig',
    [
        Rig(),
        Rig(gravity=0.0),
        Rig(layer=Layer(loss_tangent=0.1)),
        Rig(layer=Layer(stress_strain_law='neo_hookean', loss='constant', loss_tangent=0.1)),
        Rig(layer=STACK),
        Rig(engine=Engine(motion=MOTION)),
    ],
)
def test_release_and_loads_agree_with_a_simulated_throw(rig):
    throw = simulate(rig, max_events=1)
    throws = throw_many(rig, loads=True)
    expected = (
        throw.ejection_time, throw.ejection_speed, throw.energy_transfer, throw.peak_strain,
        throw.loads.acceleration, throw.loads.plate_force, throw.energies.plate_work, RELEASED,
    )
    assert throws == pytest.approx(expected, rel=1e-3 if rig.layer.needs_cells else 1e-4)
    assert throw_many(rig)[:2] == throws[:2]


@pytest.mark.parametrize('start', [0.5, 10.0, -1.0])
@pytest.mark.parametrize('layer', [Layer(), Layer(wave_speed=60.0, loss_tangent=0.1)])
def test_times_count_from_the_start_of_the_motion(start, layer):
    now, later = (
        Rig(engine=Engine(motion=SampledMotion(MOTION.times + offset, MOTION.states)), layer=layer)
        for offset in (0.0, start)
    )
    expected = pytest.approx(simulate(now).ejection_time, rel=1e-9)
    assert simulate(later).ejection_time == last_release(later).time == expected
    assert float(throw_many(later).ejection_time) == pytest.approx(expected.expected, rel=1e-3)


def test_throw_does_not_depend_on_others_in_its_batch():
    """Rigs with loss, with strong gravity and with neither need different methods."""
    rig = Rig(engine=Engine(damping_ratio=0.0))
    gravity = np.array([0.0, 0.5, 20.0, 0.0]) * rig.gravity / rig.gravity_ratio
    loss = np.array([0.0, 0.0, 0.0, 0.2])
    changes = {'thickness': THICKNESS, 'gravity': gravity, 'loss_tangent': loss}
    together = throw_many(rig, changes, threads=2).ejection_speed
    for i, thickness in enumerate(THICKNESS.ravel().tolist()):
        for j in range(gravity.size):
            changes = {'thickness': thickness, 'gravity': gravity[j], 'loss_tangent': loss[j]}
            alone = throw_many(rig, changes, threads=1)
            expected = pytest.approx(together[i, j], nan_ok=True, rel=1e-13)
            assert float(alone.ejection_speed) == expected
    assert np.isnan(together).all(axis=0).tolist() == [False, False, True, False]


def test_light_projectiles_under_strong_gravity_agree_with_the_closed_form():
    """They may leave and be caught again between two steps of the waves."""
    random = np.random.default_rng(4)
    mu, kappa = np.exp(random.uniform(np.log([[4e-4], [20.0]]), np.log([[2e-3], [80.0]]), (2, 60)))
    gravity = random.uniform(0.3, 1.5, 60)
    exact = first_releases(mass_ratio=mu, speed_ratio=kappa, gravity_ratio=gravity)
    engine = Engine(frequency=1.0, amplitude=0.25 / math.pi**2, damping_ratio=0.0)
    throws = throw_many(
        Rig(engine=engine), {
            'thickness': 1.0 / kappa, 'wave_speed': 1.0, 'gravity': gravity,
            'mass': mu * Layer(thickness=1.0).mass / kappa,
        }, loads=True,
    )
    is_released = ~np.isnan(exact.ejection_phase)
    assert is_released.sum() > 30
    assert throws.ejection_time[is_released] == pytest.approx(exact.ejection_phase[is_released])
    assert np.isfinite(throws.plate_work[is_released]).all()


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('colour', 1.0), ('loss_tangent', np.nan), ('loss_tangent', -0.1), ('diameter', -0.012),
        ('thickness', np.nan), ('frequency', 0.0), ('damping_ratio', 1.0), ('mass', np.inf),
    ],
)
@pytest.mark.parametrize('rig', [Rig(), Rig(engine=Engine(motion=MOTION))], ids=['step', 'file'])
def test_bad_changes_are_refused_by_name(rig, name, value):
    with pytest.raises(ValueError, match=name):
        throw_many(rig, {name: np.array([value])})


@pytest.mark.parametrize(
    ('compute', 'loss'), [(throw_many, 1e-3), (last_release, 1e-3), (last_release, 0.0)]
)
def test_single_throw_looks_at_the_flag_several_times(compute, loss):
    """A stiff layer takes many cells or steps."""
    layer = Layer(wave_speed=100.0, loss_tangent=loss)
    rig = Rig(engine=Engine(frequency=3.0), layer=layer, gravity=0.0)
    calls = itertools.count()
    with pytest.raises(SearchCancelledError):
        compute(rig, cancelled=lambda: next(calls) > 0)


def test_layer_with_zero_thickness_throws_nothing():
    throws = throw_many(Rig(), {'thickness': np.array([-1e-3, 0.0, 0.0168])}, loads=True)
    assert np.isnan(throws.energy_transfer).tolist() == [True, True, False]


@pytest.mark.parametrize(
    'rig', [Rig(), Rig(layer=STACK), Rig(engine=Engine(motion=MOTION))], ids=str
)
def test_changes_agree_with_another_rig(rig):
    changed = rig_with(rig, CHANGES)
    for name, value in CHANGES.items():
        components = changed.engine, changed.layer, changed.projectile, changed
        component = next(item for item in components if name in vars(item))
        assert getattr(component, name) == pytest.approx(value)
    assert len(changed.layer.parts) == len(rig.layer.parts)
    throws, expected = throw_many(rig, CHANGES), throw_many(changed)
    assert throws[:3] == pytest.approx(expected[:3], rel=1e-9)


@pytest.mark.parametrize(
    'rigs',
    [
        [Rig(), Rig(gravity=5.0), Rig(layer=Layer(thickness=0.01, loss_tangent=0.1))],
        [rig_with(Rig(engine=Engine(motion=MOTION)), {'frequency': f}) for f in (50.0, 70.0)],
    ],
    ids=['engine', 'motions'],
)
def test_different_rigs_agree_with_changes_of_one_rig(rigs):
    together = np.transpose(throw_many(rigs, loads=True))
    for throw, rig in zip(together, rigs, strict=True):
        assert throw == pytest.approx(np.array(throw_many(rig, loads=True)), rel=1e-12)


def test_rigs_that_differ_in_more_than_values_are_refused():
    strained = Rig(layer=Layer(stress_strain_law='neo_hookean'))
    with pytest.raises(ValueError, match='got 2 kinds'):
        throw_many([Rig(), strained])
    with pytest.raises(ValueError, match='got 0 kinds'):
        throw_many([])


def test_projectile_that_stays_on_the_layer_raises_an_error():
    with pytest.raises(ThrowUnresolvedError):
        last_release(Rig(engine=Engine(frequency=1.0, amplitude=1e-3)))
