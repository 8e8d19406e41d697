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
"""How the projectile left, by running averages and by the model."""

from dataclasses import replace

import numpy as np
import pytest
from reference.method_of_steps import follow
from scipy.optimize import bisect
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.identification.fit_description import FitDescription, HELD, USUAL, values_of
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.rig_fit import fit_rig
from soft_throw_ros.identification.throw_analysis import analyse_throw, ejection_of

RESULTS = ('time', 'speed', 'peak_plate_speed', 'energy_transfer')


def truth_of(rig):
    throw = simulate(rig)
    names = ('ejection_time', 'ejection_speed', 'peak_plate_speed', 'energy_transfer')
    return np.array([getattr(throw, name) for name in names])


def pulls_of(ejection, truth):
    """How many of their own errors the results are from the truth."""
    values, errors = np.transpose([getattr(ejection, name) for name in RESULTS])
    return (values - truth) / errors


@pytest.mark.parametrize(
    ('thickness', 'gravity', 'noise'),
    [(16.8e-3, 9.81, 2e-5), (29.1e-3, 0.0, 2e-5), (5.6e-3, 9.81, 5e-6)],
)
def test_running_averages_err_by_what_they_say(make_throw, thickness, gravity, noise):
    rig = Rig(layer=Layer(thickness=thickness), gravity=gravity)
    pulls = []
    for seed in range(8):
        throw = make_throw(rig, duration=0.08, noise=noise, seed=seed)
        ejection = analyse_throw(throw, gravity=gravity)
        pulls.append(pulls_of(ejection, truth_of(rig)))
        assert ejection.speed.error < 0.01 * ejection.speed.value
        assert ejection.peak_plate_speed.error < 0.01 * ejection.peak_plate_speed.value
        assert ejection.time.error < 0.15 * ejection.time.value
    # bias is part of the error, and so is not averaged away
    assert np.abs(np.mean(pulls, axis=0)).max() < 1.3
    assert np.sqrt(np.mean(np.square(pulls), axis=0)).max() < 1.6


def test_running_averages_pass_over_the_landing(make_throw):
    throw = make_throw(Rig(), duration=0.4)
    assert np.abs(pulls_of(analyse_throw(throw, gravity=9.81), truth_of(Rig()))).max() < 3.0


@pytest.mark.parametrize('noise', [3e-4, 1e-3])
def test_running_averages_do_not_determine_what_is_lost_in_noise(make_throw, noise):
    for seed in range(3):
        with pytest.raises(FitError, match='not determined by running averages'):
            analyse_throw(make_throw(Rig(), duration=0.08, noise=noise, seed=seed), gravity=9.81)


def test_running_averages_see_the_last_release_if_the_layer_catches_up(make_throw):
    layer = Layer(thickness=6e-3, wave_speed=11.0)
    engine = Engine(frequency=47.0, amplitude=3e-3)
    rig = Rig(engine=engine, layer=layer, projectile=Projectile(mass=0.15 * layer.mass))
    throw = simulate(rig, until=0.03)
    assert throw.last_release.velocity > 1.4 * throw.first_release.velocity
    found = analyse_throw(make_throw(rig, duration=0.07, noise=5e-6), gravity=9.81)
    assert found.time.value == pytest.approx(throw.last_release.time, abs=3.0 * found.time.error)
    last_speed = throw.last_release.velocity
    assert found.speed.value == pytest.approx(last_speed, abs=3.0 * found.speed.error)


def test_running_averages_say_what_is_missing(make_throw):
    throw = make_throw(Rig(), duration=0.08)
    with pytest.raises(FitError, match='made: there is no track of the projectile'):
        analyse_throw(replace(throw, projectile=None), gravity=9.81)
    with pytest.raises(FitError, match=r'made: the projectile is seen flying at \d moments'):
        analyse_throw(throw.between(0.0, 0.025), gravity=9.81)
    with pytest.raises(FitError, match='at least 20 samples per plate period'):
        analyse_throw(make_throw(Rig(), duration=0.2, rate=400.0), gravity=9.81)


def test_model_errs_by_what_it_says(make_throw):
    truth = truth_of(Rig())
    pulls = []
    for seed in range(4):
        throw = make_throw(Rig(), rate=2000.0, duration=0.06, seed=seed)
        ejection = ejection_of(fit_rig([throw], Rig(), FitDescription(HELD)))
        pulls.append(pulls_of(ejection, truth))
        assert ejection.energy_transfer.error < 0.01
        assert not ejection.is_near_jump
    assert np.abs(np.mean(pulls, axis=0)).max() < 1.3
    assert np.sqrt(np.mean(np.square(pulls), axis=0)).max() < 1.8


@pytest.fixture
def fitted(make_throw):
    """Make a fit that has found a rig, and its wave speed with an error."""

    def fit(rig, *, error):
        found = fit_rig([make_throw(Rig(), rate=1000.0)], rig, FitDescription(HELD))
        values = found.fit.values.copy()
        values[:4] = list(values_of(rig, USUAL).values())
        covariance = np.diag(np.full(values.size, 1e-20))
        covariance[3, 3] = error**2
        changed = replace(found.fit, values=values, covariance=covariance)
        return replace(found, rig=rig, fit=changed)

    return fit


def test_ejection_that_jumps_within_the_errors_is_told(fitted):
    # Layers of 16.8 mm are left after 3 t_s if the wave is fast enough, and else before
    def is_late(wave_speed):
        rig = Rig(layer=Layer(wave_speed=wave_speed))
        (release,) = follow(rig, max_events=1).events
        return release.time > 3.0 * rig.crossing_time

    jump = bisect(lambda wave_speed: is_late(wave_speed) - 0.5, 5.0, 7.8, xtol=1e-6)
    near = ejection_of(fitted(Rig(layer=Layer(wave_speed=jump)), error=1e-3))
    far = ejection_of(fitted(Rig(layer=Layer(wave_speed=jump + 0.1)), error=1e-3))
    assert near.is_near_jump
    assert not far.is_near_jump
    assert near.time.error > 20.0 * far.time.error


@pytest.mark.parametrize('loss_tangent', [0.0, 0.03])
def test_error_of_the_ejection_follows_from_that_of_the_wave_speed(fitted, loss_tangent):
    def at(wave_speed):
        return Rig(layer=Layer(wave_speed=wave_speed, loss_tangent=loss_tangent))

    ejection = ejection_of(fitted(at(7.8), error=0.01))
    higher, lower = (ejection_of(fitted(at(7.8 + d), error=1e-9)) for d in (0.01, -0.01))
    for name in ('time', 'speed', 'energy_transfer'):
        change = abs(getattr(higher, name).value - getattr(lower, name).value) / 2.0
        assert getattr(ejection, name).error == pytest.approx(change, rel=0.15)
    assert ejection.peak_plate_speed.value == pytest.approx(
        Underdamped.of(Rig().engine).peak_velocity
    )
