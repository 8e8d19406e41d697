# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The recommended layer and its description."""

from dataclasses import replace
from functools import partial
import itertools
import math

import numpy as np
import pytest
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.batch import SearchCancelledError
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import throw_many
from soft_throw_ros.design.prediction import stuck_fraction, Uncertainties
from soft_throw_ros.design.recommendation import (
    MAX_STUCK_FRACTION,
    predict,
    recommend,
    solve_request,
    TOLERATED_LOSS,
)
from soft_throw_ros.design.score import Limits, peak, robust, Score, versatile
from twin_runs import complete_settings

MATERIALS = library().materials
LOSSY = {'dragon': MATERIALS['dragon_skin_10']}
KINDS = ('peak', 'robust', 'versatile', 'limits', 'library')
SLOW = Limits(wave_speed_min=0.01, wave_speed_max=0.02)
NONE = Uncertainties(wave_speed=0.0, thickness=0.0, mass=0.0, frequency=0.0, damping_ratio=0.0)
FREE = Limits()
LOST = 1e-3
"""Fraction of the best score that a recommendation may lose."""


def requested(**request):
    """Return a call that solves a request of the twin."""
    names = {f'recommendation__{name}': value for name, value in request.items()}
    return partial(solve_request, complete_settings(**names))


def random_rig(random, *, loss_tangent=0.0):
    """Return a rig of the size of the paper's, with or without gravity."""
    return Rig(
        engine=Engine(
            frequency=random.uniform(15.0, 200.0),
            amplitude=random.uniform(1e-3, 4e-3),
            damping_ratio=random.uniform(0.0, 0.3),
        ),
        layer=Layer(
            thickness=random.uniform(2e-3, 0.04),
            wave_speed=random.uniform(4.0, 40.0),
            loss_tangent=loss_tangent,
        ),
        projectile=Projectile(mass=math.exp(random.uniform(math.log(2e-4), math.log(5e-3)))),
        gravity=random.choice([0.0, Rig.gravity]),
    )


def heavy_rig(gravity_ratio, mass=3.96e-3, damping_ratio=0.064):
    """Return a rig on earth with a ratio of gravity to the acceleration of its plate."""
    omega = math.sqrt(Rig.gravity / (2e-3 * gravity_ratio))
    engine = Engine(frequency=omega / (2.0 * math.pi), damping_ratio=damping_ratio)
    return Rig(engine=engine, projectile=Projectile(mass=mass))


def random_request(kind, random, *, loss_tangent=0.0):
    """Return a rig and a random request, as keyword arguments of `recommend`."""
    rig = random_rig(random, loss_tangent=loss_tangent)
    vary = 'library' if kind == 'library' else str(random.choice(['both', 'thickness']))
    limits = Limits(
        thickness_min=random.uniform(1e-3, 3e-3), thickness_max=random.uniform(0.01, 0.05),
        wave_speed_min=random.uniform(1.0, 4.0), wave_speed_max=random.uniform(15.0, 50.0),
    )
    objective = robust if kind == 'robust' else peak
    if kind == 'versatile':
        objective = partial(
            versatile,
            masses=tuple(rig.projectile.mass * random.uniform(0.5, 2.0, 2)),
            frequencies=tuple(rig.engine.frequency * random.uniform(0.7, 1.4, 2)),
        )
    elif kind == 'limits':
        vary = 'both'
        free = recommend(rig, limits=limits)
        load = str(random.choice(['strain', 'acceleration']))
        lower = random.uniform(0.93, 1.0) * getattr(free, f'peak_{load}')
        limits = replace(limits, **{f'max_{load}': lower})
    few = {name: MATERIALS[name] for name in ('gelatin_3pct', 'ecoflex_00-30', 'sorbothane_30')}
    return rig, {'vary': vary, 'objective': objective, 'limits': limits, 'materials': few}


def assert_as_good_as_brute_force(
    rig, *, size, vary='both', objective=peak, limits=FREE, materials=None
):
    """Compare a recommendation with a grid, `size` both ways or 20 times as many on a line."""
    speeds = limits.box.wave_speed if vary == 'both' else (rig.layer.wave_speed,) * 2
    layers = [(rig.layer, speeds)]
    if vary == 'library':
        layers = [
            (replace(rig.layer, wave_speed=item.wave_speed, density=item.density,
                     loss_tangent=item.loss_tangent), (item.wave_speed,) * 2)
            for item in materials.values()
        ]
    brute = 0.0
    for layer, (low, high) in layers:
        score = Score(replace(rig, layer=layer), objective, limits)
        thicknesses = np.geomspace(*limits.box.thickness, size if low < high else 20 * size)
        for wave_speed in np.geomspace(low, high, size if low < high else 1):
            brute = max(brute, score(thicknesses, wave_speed).max())
    best = recommend(
        rig, vary=vary, objective=objective, limits=limits, materials=materials,
        uncertainties=NONE,
    )
    assert best.score >= (1.0 - LOST) * brute > 0.0
    assert best.peak_strain <= limits.max_strain * (1.0 + 1e-9)
    assert best.peak_acceleration <= limits.max_acceleration * (1.0 + 1e-9)


@pytest.mark.parametrize(('seed', 'gravity_ratio'), [(0, 0.0), (1, 0.0), (2, 0.1), (3, 0.8)])
def test_recommendation_for_a_random_rig_is_as_good_as_brute_force(seed, gravity_ratio):
    rig = random_rig(np.random.default_rng(seed))
    acceleration = rig.engine.speed_scale * rig.engine.angular_frequency
    rig = replace(rig, gravity=gravity_ratio * acceleration)
    assert_as_good_as_brute_force(rig, size=40 if gravity_ratio else 200)


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize(
    ('seed', 'loss_tangent', 'size'), [(0, 0.0, 90), (1, 0.0, 90), (3, 0.15, 20)]
)
def test_recommendation_is_as_good_as_brute_force(kind, seed, loss_tangent, size):
    random = np.random.default_rng([seed, 7, KINDS.index(kind)])
    rig, request = random_request(kind, random, loss_tangent=loss_tangent)
    assert_as_good_as_brute_force(rig, size=size, **request)


@pytest.mark.slow
@pytest.mark.parametrize(
    'values',
    [(0.35, 1.2e-3, 0.064), (0.57, 4.5e-4, 0.3), (1.404, 3.96e-3, 0.064), (2.663, 6.88e-4, 0.064)],
)
def test_recommendation_under_strong_gravity_is_as_good_as_brute_force(values):
    """Gravity holds the projectile through the first swing of the plate, and later ones throw."""
    limits = Limits(thickness_min=2e-3, thickness_max=50e-3, wave_speed_max=30.0)
    assert_as_good_as_brute_force(heavy_rig(*values), size=60, limits=limits)


@pytest.mark.parametrize('vary', ['thickness', 'wave_speed', 'both'])
@pytest.mark.parametrize('seed', range(3))
def test_recommended_layer_has_its_promised_energy_transfer(seed, vary):
    rig = random_rig(np.random.default_rng(seed))
    best = recommend(rig, vary=vary)
    prediction = predict(replace(rig, layer=best.rig.layer))
    assert all(value == getattr(best, name) for name, value in vars(prediction).items())
    assert best.score == best.energy_transfer
    assert best.thickness == rig.layer.thickness or vary != 'wave_speed'
    assert best.wave_speed == rig.layer.wave_speed or vary != 'thickness'
    assert best.gain >= 0.0  # the present layer is within the limits
    singles = (best.by_thickness.energy_transfer, best.by_wave_speed.energy_transfer)
    assert vary != 'both' or best.energy_transfer >= max(singles)
    again = recommend(best.rig, vary=vary)
    assert again.energy_transfer == pytest.approx(best.energy_transfer, rel=1e-5)


@pytest.mark.parametrize('loss_tangent', [0.0, 0.1])
def test_tolerances_end_at_the_tolerated_loss_of_energy(loss_tangent):
    best = recommend(Rig(layer=Layer(loss_tangent=loss_tangent)), vary='thickness')
    least = (1.0 - TOLERATED_LOSS) * best.score
    for name, tolerance in best.tolerances.items():
        ends = getattr(best, name) + tolerance * np.array([-1.0, 1.0, -1.02, 1.02])
        scores = throw_many(best.rig, {name: ends}).energy_transfer
        assert scores[:2].min() > least * (1.0 - 1e-3) > scores[2:].min() * (1.0 - 2e-3)


def test_search_follows_a_ridge_between_two_throws():
    rig = Rig(
        engine=Engine(frequency=77.47, amplitude=1.4936e-3, damping_ratio=0.16538),
        layer=Layer(density=1085.97, diameter=13.654e-3),
        projectile=Projectile(mass=2.08736e-3),
        gravity=0.0,
    )
    limits = Limits(
        thickness_min=2.419e-3, thickness_max=24.29e-3, wave_speed_min=1.603, wave_speed_max=32.19
    )
    for gravity, mass in itertools.product((0.0, 9.81), (1.5e-3, 2.08736e-3, 3e-3)):
        rig = replace(rig, gravity=gravity)
        objective = partial(versatile, masses=[mass], frequencies=(52.222, 67.143, 122.727))
        best = recommend(rig, objective=objective, limits=limits)
        # layers all along a line of nearly equal kappa
        thickness = np.geomspace(0.7 * best.thickness, limits.thickness_max, 60)
        kappa = best.wave_speed / best.thickness * np.linspace(0.93, 1.07, 281)[:, None]
        inside = (thickness * kappa <= limits.wave_speed_max).ravel()
        layers = np.broadcast_arrays(thickness, thickness * kappa)
        along = Score(rig, objective)(*(item.ravel()[inside] for item in layers))
        assert best.score >= (1.0 - LOST) * along.max()


@pytest.mark.parametrize(
    'gravity_ratio', [0.4, *(pytest.param(x, marks=pytest.mark.slow) for x in (0.95, 1.404))]
)
def test_limit_that_is_not_active_does_not_change_the_answer(gravity_ratio):
    rig = heavy_rig(gravity_ratio)
    limited = recommend(rig, limits=Limits(max_strain=10.0), uncertainties=NONE)
    assert limited.score == pytest.approx(recommend(rig, uncertainties=NONE).score, rel=1e-6)


def test_present_layer_beyond_a_limit_is_what_the_gain_counts_from():
    best = recommend(Rig(), vary='thickness', limits=Limits(max_strain=0.115))
    assert best.now_score == predict(Rig()).energy_transfer > best.score
    assert 'because the present layer exceeds the limits' in best.summary


@pytest.mark.slow
def test_layer_that_may_hold_the_projectile_is_not_preferred():
    rig = heavy_rig(1.404)
    free, safe = (recommend(rig, uncertainties=item) for item in (NONE, Uncertainties()))
    assert stuck_fraction(free.rig, Uncertainties()) > MAX_STUCK_FRACTION >= safe.stuck_fraction
    assert safe.now_score < safe.score < free.score


def test_library_gives_no_ideal_material_and_the_present_layer_if_it_has_no_better_one():
    best = recommend(Rig(), vary='library', materials=LOSSY)
    assert (best.rig, best.layer, best.gain) == (Rig(), '', 0.0)
    names = ('gelatin', 'ecoflex_00-30')
    rig = Rig(layer=Layer(thickness=1e-3))
    best = recommend(rig, vary='library', materials={name: MATERIALS[name] for name in names})
    assert MATERIALS['gelatin'].is_ideal
    assert [item.layer for item in best.candidates] == [best.layer] == ['ecoflex_00-30']


@pytest.mark.parametrize(
    ('call', 'message'),
    [
        (partial(recommend, vary='density'), "vary .* got 'density'"),
        (partial(recommend, vary='wave_speed', limits=SLOW), 'speed_max=0.02'),
        (partial(recommend, vary='library', limits=Limits(wave_speed_max=2.0), materials=LOSSY),
         'from the library .*wave_speed_max=2.0'),
        (requested(vary='motion', objective='robust'), "vary 'motion' .* got 'robust'"),
        (requested(objective='aim', target_height=0.0), 'either a height or a speed'),
    ],
)
def test_impossible_request_is_refused_with_a_reason(call, message):
    with pytest.raises(ValueError, match=message):
        call(rig=Rig())


@pytest.mark.parametrize('name', ['peak', 'robust', 'versatile', 'aim'])
@pytest.mark.parametrize('batches', [0, 3])
def test_search_ends_when_cancelled_between_batches(name, batches):
    answers = iter([False] * batches + [True])
    with pytest.raises(SearchCancelledError):
        requested(objective=name)(cancelled=lambda: next(answers))
    assert not list(answers)
