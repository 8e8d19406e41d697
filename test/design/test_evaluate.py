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
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.evaluate import (
    first_throws,
    highest_transfers,
    last_release,
    Ratios,
    SearchCancelledError,
)

MU, KAPPA = np.geomspace(0.1, 2.0, 4)[:, None], np.array([4.0, 8.0, 15.0])


@pytest.mark.parametrize(('gravity', 'error'), [(0.0, 1e-12), (0.05, 1e-9), (0.5, 1e-4)])
def test_first_throws_without_loss_are_those_of_the_closed_form(gravity, error):
    found = first_throws(Ratios(MU, KAPPA, 0.064, gravity))
    known = first_releases(
        mass_ratio=MU,
        speed_ratio=KAPPA,
        damping_ratio=0.064,
        gravity_ratio=gravity,
        unresolved='nan',
    )
    np.testing.assert_allclose(found.ejection_phase, known.ejection_phase, rtol=error)
    np.testing.assert_allclose(found.energy_transfer, known.energy_transfer, rtol=error)


@pytest.mark.parametrize('loss_tangent', [0.0, 0.1])
@pytest.mark.parametrize('gravity', [0.0, 9.81])
def test_release_and_loads_are_those_of_a_simulated_throw(loss_tangent, gravity):
    rig = Rig(layer=Layer(loss_tangent=loss_tangent), gravity=gravity)
    model = 'finite_difference' if loss_tangent else 'travelling_wave'
    throw = simulate(rig, model=model, max_events=1)
    ratios = Ratios(rig.mass_ratio, rig.speed_ratio, 0.064, rig.gravity_ratio, loss_tangent)
    found = first_throws(ratios, loads=True)
    speed, omega = rig.engine.speed_scale, rig.engine.angular_frequency
    known = {
        'ejection_phase': throw.ejection_time * rig.engine.frequency,
        'speed': throw.ejection_speed / speed,
        'energy_transfer': throw.energy_transfer,
        'peak_acceleration': throw.peak_acceleration / (speed * omega),
        'peak_plate_force': throw.peak_plate_force / (speed * rig.layer.impedance),
        'plate_work': throw.energies.plate_work / (rig.projectile.mass * speed**2),
    }
    for name, value in known.items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-3 if loss_tangent else 1e-4)
    alone = first_throws(ratios)
    assert (alone.ejection_phase, alone.speed) == (found.ejection_phase, found.speed)


def test_each_throw_is_the_same_alone_and_among_others():
    """Those with loss, with strong gravity, and neither need different methods."""
    gravity, loss = np.array([0.0, 0.5, 20.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.2])
    together = first_throws(Ratios(MU, 8.0, 0.0, gravity, loss), threads=2)
    for i in range(MU.size):
        for j in range(gravity.size):
            alone = first_throws(Ratios(MU[i], 8.0, 0.0, gravity[j], loss[j]), threads=1)
            assert together.speed[i, j] == pytest.approx(alone.speed[0], nan_ok=True, rel=1e-13)
    assert np.isnan(together.speed).all(axis=0).tolist() == [False, False, True, False]


def test_layer_that_an_error_takes_away_throws_nothing():
    found = first_throws(Ratios.of(Rig(), thickness=np.array([-1e-3, 0.0, 0.0168])), loads=True)
    assert np.isnan(found.energy_transfer).tolist() == [True, True, False]


def test_ratios_are_those_of_a_rig_with_these_values():
    rig = Rig(
        engine=Engine(frequency=40.0, amplitude=1e-3, damping_ratio=0.1),
        layer=Layer(thickness=0.01, wave_speed=12.0, density=900.0, loss_tangent=0.2),
        projectile=Projectile(mass=3e-3),
        gravity=5.0,
    )
    names = ('frequency', 'amplitude', 'damping_ratio', 'thickness', 'wave_speed', 'density',
             'loss_tangent')  # fmt: skip
    values = {**vars(rig.engine), **vars(rig.layer)}
    changes = {name: values[name] for name in names}
    found = Ratios.of(Rig(), **changes, mass=3e-3, gravity=5.0)
    expected = Ratios(
        rig.mass_ratio, rig.speed_ratio, 0.1, rig.gravity_ratio, 0.2, rig.crossing_ratio
    )
    assert found == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize('gravity', [0.0, 0.1])
def test_no_stiff_layer_gives_more_than_the_highest_transfer(gravity):
    random = np.random.default_rng(1)
    mu = np.exp(random.uniform(np.log(0.01), np.log(30.0), 5000))
    kappa = 2.0 * np.pi * np.exp(random.uniform(0.0, 3.0, mu.size)) * np.sqrt(mu + 0.4)
    ratios = Ratios(mu, kappa, random.choice([0.0, 0.064, 0.6], mu.size), gravity)
    found, highest = first_throws(ratios).energy_transfer, highest_transfers(ratios)
    assert np.all(found[np.isfinite(found)] <= highest[np.isfinite(found)])
    assert np.isfinite(highest).mean() > 0.9


def test_search_is_given_up_between_batches():
    asked = []

    def cancelled():
        asked.append(True)
        return len(asked) > 2

    with pytest.raises(SearchCancelledError):
        first_throws(Ratios(np.full(1 << 18, 0.3), 8.0), cancelled=cancelled)
    assert len(asked) == 3


@pytest.mark.parametrize(
    'rig',
    [
        Rig(),
        Rig(gravity=0.0),
        Rig(engine=Engine(frequency=31.1), layer=Layer(thickness=2e-3)),  # caught again
    ],
)
def test_last_release_is_that_of_a_simulated_throw(rig):
    throw = simulate(rig)
    found = last_release(rig)
    assert found.time == pytest.approx(throw.last_release.time, rel=1e-4)
    assert found.speed == pytest.approx(throw.last_release.velocity, rel=1e-4)
    rest = rig.layer.thickness - rig.static_sag
    assert found.rise == pytest.approx(throw.last_release.position - rest, rel=1e-4)
    assert found.height == pytest.approx(throw.apex_height - rest, rel=1e-4)


def test_last_release_with_loss_is_by_cells():
    rig = Rig(layer=Layer(loss_tangent=0.1))
    lossless = last_release(replace(rig, layer=Layer()))
    found = last_release(rig)
    assert found == last_release(rig, model='finite_difference')
    assert found.speed < lossless.speed


def test_projectile_that_stays_on_the_layer_is_named():
    with pytest.raises(ThrowUnresolvedError):
        last_release(Rig(engine=Engine(frequency=1.0, amplitude=1e-3)))
