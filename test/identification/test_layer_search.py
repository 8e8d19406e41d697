# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Search for the layer."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import FitDescription, FREE, IDEAL_BENCH
from soft_throw_ros.identification.layer_search import find_best_minimum, find_layers, MAX_EXCESS
from soft_throw_ros.identification.least_squares import Fit, fit_warnings

IDEAL = FitDescription(IDEAL_BENCH)
WITH_THICKNESS = {**IDEAL_BENCH, 'layer.thickness': FREE}

CHATTERING = Rig(layer=Layer(thickness=5.6e-3, wave_speed=40.0))
"""A rig with so stiff a layer that chi squared has a minimum at many wave speeds."""

LIGHT = Rig(
    engine=Engine(frequency=42.966, amplitude=2.522e-3, damping_ratio=0.1767),
    layer=Layer(thickness=9.819e-3, wave_speed=13.74, diameter=13.089e-3, density=1006.6),
    projectile=Projectile(mass=2.224e-4),
)
"""A rig whose projectile comes back soon; late heights have a minimum at many wave speeds."""


def with_layer(rig, **changes):
    return replace(rig, layer=replace(rig.layer, **changes))


def throw_of(make_throw, rig, **options):
    return make_throw(rig, rate=2000.0, duration=0.04, **options)


@pytest.mark.parametrize('rig', [Rig(), CHATTERING, LIGHT], ids=['soft', 'chattering', 'light'])
def test_first_candidate_on_exact_tracks_is_the_truth(make_model, make_throw, rig):
    throw = throw_of(make_throw, rig, noise=1e-6).apply(
        lambda track: replace(track, stamp_error=1e-5)  # unequal weights beside unknown zeros
    )
    found = find_layers(make_model(with_layer(rig, wave_speed=100.0), [throw], IDEAL))[0]
    assert found['layer.wave_speed'].value == pytest.approx(rig.layer.wave_speed, rel=2e-3)


@pytest.mark.parametrize(
    ('rig', 'thickness', 'guess', 'tolerance'),
    [
        (Rig(), 0.03, 0.04, 0.02),
        (with_layer(Rig(), wave_speed=15.0), 5.6e-3, 8.4e-3, 0.05),
        (with_layer(LIGHT, wave_speed=6.0), 0.02, 0.013, 0.05),
    ],
    ids=['soft', 'thin', 'light'],
)
def test_first_candidate_has_the_thickness_for_a_guess_that_is_a_third_off(
    make_model, make_throw, rig, thickness, guess, tolerance
):
    rig = with_layer(rig, thickness=thickness)
    throw = throw_of(make_throw, rig, noise=1e-6)
    known = with_layer(rig, wave_speed=50.0, thickness=guess)
    found = find_layers(make_model(known, [throw], FitDescription(WITH_THICKNESS)))[0]
    for name in ('thickness', 'wave_speed'):
        truth = getattr(rig.layer, name)
        assert found[f'layer.{name}'].value == pytest.approx(truth, rel=tolerance)


def candidate(speed):
    return Fit(
        names=('layer.wave_speed',), values=np.array([speed]), covariance=np.eye(1), chi2=1.0,
        dof=1, residuals=(),
    )


def fit_near(model, wave_speed):
    return model.fit(model.start({'layer.wave_speed': wave_speed}))


def test_best_minimum_is_found_from_a_wrong_echo(make_model, make_throw):
    model = make_model(CHATTERING, [throw_of(make_throw, CHATTERING)], IDEAL)
    right, wrong = fit_near(model, 40.0), fit_near(model, 22.4)
    assert wrong.chi2 > right.chi2 + MAX_EXCESS
    assert wrong['layer.wave_speed'].value < 25.0
    others = [candidate(22.0), candidate(41.0)]
    found = find_best_minimum(model, wrong, others)
    assert found.values == pytest.approx(right.values, rel=1e-4, abs=1e-7)
    assert found.alternatives == ()
    assert find_best_minimum(model, right, others[:1] * 2).chi2 == right.chi2


def test_minima_that_are_hardly_worse_increase_the_error(make_model, make_throw):
    model = make_model(CHATTERING, [throw_of(make_throw, CHATTERING, noise=2e-4)], IDEAL)
    fit = fit_near(model, 37.8)
    found = find_best_minimum(model, fit, [candidate(speed) for speed in (37.8, 22.4, 57.5)])
    speed, index = found['layer.wave_speed'], model.indices['layer.wave_speed'][0]
    far = [item.values[index] - speed.value for item in found.alternatives]
    assert len(far) == 2
    assert sum(f'{far[0] + speed.value:.5g}' in text for text in fit_warnings(found)) == 1
    assert all(0.0 <= item.excess < MAX_EXCESS for item in found.alternatives)
    own = fit['layer.wave_speed']
    assert speed.value == own.value
    assert speed.error == pytest.approx(np.linalg.norm([own.error, *(0.5 * np.array(far))]))
