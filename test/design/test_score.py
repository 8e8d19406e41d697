# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Objectives of a design, and the scores of layers."""

from dataclasses import replace
from functools import partial
import math

import numpy as np
import pytest
from reference.cases import exact_release
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.core.throw import rig_with, throw_many
from soft_throw_ros.design.maximise import Box, maximise
from soft_throw_ros.design.prediction import changes_of, predict, Uncertainties
from soft_throw_ros.design.score import Limits, peak, robust, Score, versatile
from twin_runs import complete_settings


def score_of(rig, objective, *limits):
    return float(Score(rig, objective, *limits)(rig.layer.thickness, rig.layer.wave_speed)[0])


def test_of_equally_good_layers_the_thinnest_is_chosen():
    def score(thickness, *_):
        distances = [np.abs(np.log(thickness / good)) for good in (3e-3, 12e-3)]
        return np.minimum(np.exp(0.005 - np.minimum(*distances)), 1.0)

    best = maximise(score, Box((1e-3, 2e-2), (10.0, 10.0)))
    assert (best.score, best.thickness) == (1.0, pytest.approx(3e-3, rel=0.006))


def test_versatile_is_the_worst_of_each_projectile_at_each_frequency():
    rig = Rig(gravity=0.0)
    masses, frequencies = (1e-3, 2.4e-3), (40.0, 63.2, 90.0)
    transfers = [
        exact_release(rig_with(rig, {'mass': mass, 'frequency': frequency})).energy_transfer
        for mass in masses
        for frequency in frequencies
    ]
    score = score_of(rig, partial(versatile, masses=masses, frequencies=frequencies))
    assert score == pytest.approx(min(transfers), rel=1e-9)


def test_robust_is_the_worst_case_of_random_errors():
    rig, uncertainties = Rig(gravity=0.0), Uncertainties()
    worst = score_of(rig, partial(robust, uncertainties=uncertainties))
    assert worst < score_of(rig, peak)
    errors = np.random.default_rng(1).uniform(-1.0, 1.0, (3000, 5))
    variants = uncertainties.variants(rig, errors)
    changes = changes_of(variants, rig.layer.thickness, rig.layer.wave_speed)
    assert throw_many(rig, changes).energy_transfer.min() > worst * (1.0 - 1e-3)


def test_scores_do_not_depend_on_other_computations():
    score = Score(Rig(), robust)
    thicknesses = np.linspace(2e-3, 40e-3, 60)
    together = score(thicknesses, 7.8)
    alone = [score_of(replace(Rig(), layer=Layer(thickness=thickness)), robust)
             for thickness in thicknesses[::7]]
    assert together[::7] == pytest.approx(alone, rel=1e-12)


@pytest.mark.parametrize('loss_tangent', [0.0, 0.1])
def test_layer_that_exceeds_a_limit_of_the_loads_has_no_score(loss_tangent):
    rig = Rig(layer=Layer(loss_tangent=loss_tangent), gravity=0.0)
    throw = predict(rig)
    for name in ('strain', 'acceleration'):
        load = getattr(throw, f'peak_{name}')
        for factor, score in ((1.001, throw.energy_transfer), (0.999, 0.0)):
            limits = Limits(**{f'max_{name}': factor * load})
            assert score_of(rig, peak, limits) == pytest.approx(score, rel=1e-9)


def test_limits_hold_for_every_throw_that_counts():
    rig = Rig()
    limits = Limits(max_acceleration=1.001 * predict(rig).peak_acceleration)
    for frequencies, is_within in (((40.0, 63.2), True), ((63.2, 90.0), False)):
        objective = partial(versatile, masses=(rig.projectile.mass,), frequencies=frequencies)
        assert (score_of(rig, objective, limits) > 0.0) is is_within
    assert score_of(rig, robust, limits) == 0.0


def test_settings_of_the_twin_set_the_limits_and_zero_sets_none():
    limits = {'thickness_min': 0.002, 'wave_speed_max': 30.0, 'max_acceleration': 500.0}
    settings = complete_settings(**{f'recommendation__{key}': limits[key] for key in limits})
    assert settings['recommendation.max_strain'] == 0.0
    assert Limits.from_settings(settings) == Limits(**limits)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda: Uncertainties(thickness=-1e-3), r'uncertainty\.thickness .* got -0\.001'),
        (lambda: Uncertainties(mass=1.0), r'uncertainty\.mass .* got 1\.0'),
        (lambda: Limits(thickness_min=0.06), 'thickness_min .* got 0.06 and 0.05'),
        (lambda: Limits(thickness_min=0.0), r'thickness_min .* got 0\.0'),
        (lambda: Limits(wave_speed_max=math.inf), 'wave_speed_max .* got inf'),
        (lambda: versatile(Rig(), masses=(1e-3,), frequencies=(0.0,)), r'frequencies .* 0\.0'),
        (lambda: Score(Rig(engine=Engine(frequency=0.1)), robust),
         r'uncertainty\.frequency .* 0\.1, got 0\.1'),
    ],
)
def test_bad_requests_are_refused_with_the_value(make, message):
    with pytest.raises(ValueError, match=message):
        make()
