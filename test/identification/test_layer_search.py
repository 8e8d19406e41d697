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
from soft_throw_ros.identification.rig_fit import fit_plates
from soft_throw_ros.identification.rig_model import ThrowSimulator

IDEAL = FitDescription(IDEAL_BENCH)
WITH_THICKNESS = IDEAL.change({'layer.thickness': FREE})

# So stiff a layer that chi squared has a minimum at many wave speeds
CHATTERING = Rig(layer=Layer(thickness=5.6e-3, wave_speed=40.0))
LIGHT = Rig(  # comes back soon; late heights have a minimum at many wave speeds
    engine=Engine(frequency=42.966, amplitude=2.522e-3, damping_ratio=0.1767),
    layer=Layer(thickness=9.819e-3, wave_speed=13.74, diameter=13.089e-3, density=1006.6),
    projectile=Projectile(mass=2.224e-4),
)


def with_layer(rig, **changes):
    return replace(rig, layer=replace(rig.layer, **changes))


@pytest.fixture
def model_of(make_throw):
    """Return a function that makes the model of a throw of a rig, around another rig."""

    def model_of(rig, known, description, *, noise=2e-5, stamp_error=0.0):
        throw = make_throw(rig, rate=2000.0, duration=0.04, noise=noise)
        throw = throw.apply(lambda track: replace(track, stamp_error=stamp_error))
        return fit_plates([throw], known, description, ThrowSimulator())

    return model_of


@pytest.mark.parametrize(('rig', 'guess', 'tolerance'), [
    (Rig(), None, 2e-3),
    (CHATTERING, None, 2e-3),
    (LIGHT, None, 2e-3),
    (with_layer(Rig(), thickness=0.03), 0.04, 0.02),
    (with_layer(Rig(), thickness=5.6e-3, wave_speed=15.0), 8.4e-3, 0.05),
    (with_layer(LIGHT, thickness=0.02, wave_speed=6.0), 0.013, 0.05),
])
def test_first_candidate_on_exact_tracks_is_the_truth(model_of, rig, guess, tolerance):
    known = with_layer(rig, wave_speed=100.0, thickness=guess or rig.layer.thickness)
    description = WITH_THICKNESS if guess else IDEAL  # a guess of the thickness is a third off
    # the error of stamps gives unequal weights beside unknown zeros
    model = model_of(rig, known, description, noise=1e-6, stamp_error=0.0 if guess else 1e-5)
    found = find_layers(model)[0]
    for name in found.names:
        if name.startswith('layer'):
            truth = getattr(rig.layer, name.partition('.')[2])
            assert found[name].value == pytest.approx(truth, rel=tolerance)


def fit_near(model, wave_speed):
    return model.fit(model.start({'layer.wave_speed': wave_speed}))


def at(*speeds):
    """Return candidates for other minima."""
    options = {'covariance': np.eye(1), 'chi2': 1.0, 'dof': 1, 'residuals': ()}
    return [Fit(names=('layer.wave_speed',), values=np.array([v]), **options) for v in speeds]


def test_best_minimum_is_found_from_a_wrong_echo(model_of):
    model = model_of(CHATTERING, CHATTERING, IDEAL)
    right, wrong = fit_near(model, 40.0), fit_near(model, 22.4)
    assert wrong.chi2 > right.chi2 + MAX_EXCESS
    assert wrong['layer.wave_speed'].value < 25.0
    found = find_best_minimum(model, wrong, at(22.0, 41.0))
    assert found.values == pytest.approx(right.values, rel=1e-4, abs=1e-7)
    assert found.alternatives == ()
    assert find_best_minimum(model, right, at(22.0, 22.0)).chi2 == right.chi2


def test_minima_that_are_hardly_worse_increase_the_error(model_of):
    model = model_of(CHATTERING, CHATTERING, IDEAL, noise=2e-4)
    fit = fit_near(model, 37.8)
    found = find_best_minimum(model, fit, at(37.8, 22.4, 57.5))
    speed, index = found['layer.wave_speed'], model.indices['layer.wave_speed'][0]
    far = [item.values[index] - speed.value for item in found.alternatives]
    assert len(far) == 2
    assert sum(f'{far[0] + speed.value:.5g}' in text for text in fit_warnings(found)) == 1
    assert all(0.0 <= item.excess < MAX_EXCESS for item in found.alternatives)
    own = fit['layer.wave_speed']
    assert speed.value == own.value
    assert speed.error == pytest.approx(np.linalg.norm([own.error, *(0.5 * np.array(far))]))
