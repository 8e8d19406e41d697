# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The one way to throws, against the models that it takes them from."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.closed_form import first_releases, ThrowUnresolvedError
from soft_throw_ros.core.plate import SampledMotion, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig, Stack
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.evaluate import (
    first_throws,
    highest_transfers,
    last_release,
    rig_with,
)

THICKNESS, SPEED = np.geomspace(5e-3, 0.05, 4)[:, None], np.array([5.0, 8.0, 15.0])
TIMES = np.arange(0.0, 0.05, 2e-4)
MOTION = SampledMotion.from_positions(TIMES, Underdamped.of(Engine()).position(TIMES))
STACK = Stack(sheets=(Layer(thickness=8e-3, loss_tangent=0.1), Layer(wave_speed=20.0)))
CHANGES = {
    'frequency': 50.0, 'amplitude': 1e-3, 'damping_ratio': 0.1, 'thickness': 0.01,
    'wave_speed': 12.0, 'density': 900.0, 'diameter': 0.015, 'loss_tangent': 0.2, 'mass': 3e-3,
    'gravity': 5.0,
}


@pytest.mark.parametrize(('gravity', 'error'), [(0.0, 1e-12), (0.05, 1e-9), (0.5, 1e-4)])
def test_first_throws_without_loss_are_those_of_the_closed_form(gravity, error):
    rig = Rig()
    unit = rig.engine.speed_scale * rig.engine.angular_frequency
    found = first_throws(
        rig, {'thickness': THICKNESS, 'wave_speed': SPEED, 'gravity': gravity * unit}
    )
    known = first_releases(
        mass_ratio=rig.mass_ratio * rig.layer.thickness / THICKNESS,
        speed_ratio=SPEED / (THICKNESS * rig.engine.frequency),
        damping_ratio=rig.engine.damping_ratio,
        gravity_ratio=gravity,
        unresolved='nan',
    )
    phase = found.ejection_time * rig.engine.frequency
    np.testing.assert_allclose(phase, known.ejection_phase, rtol=error)
    np.testing.assert_allclose(found.energy_transfer, known.energy_transfer, rtol=error)


@pytest.mark.parametrize(
    'rig',
    [
        Rig(),
        Rig(gravity=0.0),
        Rig(layer=Layer(loss_tangent=0.1)),
        Rig(layer=Layer(elasticity='neo_hookean', loss='constant', loss_tangent=0.1)),
        Rig(layer=STACK),
        Rig(engine=Engine(motion=MOTION)),
    ],
)
def test_release_and_loads_are_those_of_a_simulated_throw(rig):
    model = 'finite_difference' if rig.layer.needs_cells else 'travelling_wave'
    throw = simulate(rig, model=model, max_events=1)
    found = first_throws(rig, loads=True)
    known = (
        throw.ejection_time, throw.ejection_speed, throw.energy_transfer, throw.peak_strain,
        throw.peak_acceleration, throw.peak_plate_force, throw.energies.plate_work,
    )
    assert found == pytest.approx(known, rel=1e-3 if rig.layer.needs_cells else 1e-4)
    assert first_throws(rig)[:2] == found[:2]


def test_each_throw_is_the_same_alone_and_among_others():
    """Those with loss, with strong gravity, and neither need different methods."""
    rig = Rig(engine=Engine(damping_ratio=0.0))
    gravity = np.array([0.0, 0.5, 20.0, 0.0]) * rig.gravity / rig.gravity_ratio
    loss = np.array([0.0, 0.0, 0.0, 0.2])
    changes = {'thickness': THICKNESS, 'gravity': gravity, 'loss_tangent': loss}
    together = first_throws(rig, changes, threads=2).ejection_speed
    for i, thickness in enumerate(THICKNESS.ravel().tolist()):
        for j in range(gravity.size):
            one = {'thickness': thickness, 'gravity': gravity[j], 'loss_tangent': loss[j]}
            alone = first_throws(rig, one, threads=1)
            known = pytest.approx(together[i, j], nan_ok=True, rel=1e-13)
            assert float(alone.ejection_speed) == known
    assert np.isnan(together).all(axis=0).tolist() == [False, False, True, False]


def test_layer_that_an_error_takes_away_throws_nothing():
    found = first_throws(Rig(), {'thickness': np.array([-1e-3, 0.0, 0.0168])}, loads=True)
    assert np.isnan(found.energy_transfer).tolist() == [True, True, False]


@pytest.mark.parametrize(
    'rig', [Rig(), Rig(layer=STACK), Rig(engine=Engine(motion=MOTION))], ids=str
)
def test_changes_are_those_of_another_rig(rig):
    there = rig_with(rig, CHANGES)
    for name, value in CHANGES.items():
        part = next(each for each in (there.engine, there.layer, there.projectile, there)
                    if name in vars(each))
        assert getattr(part, name) == pytest.approx(value)
    assert there.layer.is_uniform is rig.layer.is_uniform
    model = 'finite_difference_elastic'
    found, known = first_throws(rig, CHANGES, model=model), first_throws(there, model=model)
    assert found[:3] == pytest.approx(known[:3], rel=1e-9)


@pytest.mark.parametrize('gravity', [0.0, 0.1])
def test_no_stiff_layer_gives_more_than_the_highest_transfer(gravity):
    random, rig = np.random.default_rng(1), Rig()
    mu = np.exp(random.uniform(np.log(0.01), np.log(30.0), 5000))
    kappa = 2.0 * np.pi * np.exp(random.uniform(0.0, 3.0, mu.size)) * np.sqrt(mu + 0.4)
    changes = {
        'mass': mu * rig.layer.mass,
        'wave_speed': kappa * rig.layer.thickness * rig.engine.frequency,
        'damping_ratio': random.choice([0.0, 0.064, 0.6], mu.size),
        'gravity': gravity * rig.engine.speed_scale * rig.engine.angular_frequency,
    }
    found = first_throws(rig, changes).energy_transfer
    highest = highest_transfers(rig, changes)
    assert np.all(found[np.isfinite(found)] <= highest[np.isfinite(found)])
    assert np.isfinite(highest).mean() > 0.9


@pytest.mark.parametrize(
    'rig', [Rig(), Rig(engine=Engine(frequency=31.1), layer=Layer(thickness=2e-3))]
)
def test_last_release_is_that_of_a_simulated_throw_after_recontacts(rig):
    throw, found = simulate(rig), last_release(rig)
    rest = rig.layer.thickness - rig.static_sag
    assert found == pytest.approx(
        (
            throw.last_release.time,
            throw.last_release.velocity,
            throw.last_release.position - rest,
            throw.apex_height - rest,
        ),
        rel=1e-4,
    )


def test_last_release_with_loss_is_by_cells():
    rig = Rig(layer=Layer(loss_tangent=0.1))
    assert last_release(rig) == last_release(rig, model='finite_difference')
    assert last_release(rig).speed < last_release(replace(rig, layer=Layer())).speed


def test_projectile_that_stays_on_the_layer_is_named():
    with pytest.raises(ThrowUnresolvedError):
        last_release(Rig(engine=Engine(frequency=1.0, amplitude=1e-3)))
