# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Effects that the tracks hardly show, as part of the errors of a fit."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import (
    DEFAULTS,
    FitDescription,
    FIXED,
    IDEAL_BENCH,
    parse_treatments,
)
from soft_throw_ros.identification.rig_fit import fit_rig
from soft_throw_ros.identification.tracks import ThrowTracks, Track
from soft_throw_ros.identification.unseen import UnseenEffect

RIG = Rig(
    engine=Engine(frequency=63.2, damping_ratio=0.064, amplitude=1.2e-3),
    layer=Layer(thickness=16.8e-3, wave_speed=7.8),
    projectile=Projectile(mass=1.2e-3),
)


@pytest.fixture
def tracks(make_throw):
    return make_throw(RIG, duration=0.04)


def test_effect_changes_no_value_and_increases_errors(tracks):
    plain, stuck = (
        fit_rig([tracks], RIG, FitDescription({**IDEAL_BENCH, **parse_treatments(effect)})).fit
        for effect in ({}, {'projectile.sticking': '+- 5e-4'})
    )
    assert np.array_equal(plain.values, stuck.values)
    assert set(stuck.unseen) == {'projectile.sticking'}
    assert stuck['layer.wave_speed'].error > 1.05 * plain['layer.wave_speed'].error
    assert stuck.seen_covariance == pytest.approx(plain.covariance, rel=1e-9)
    budget = stuck.budget('layer.wave_speed')
    assert budget['noise'] == pytest.approx(plain['layer.wave_speed'].error, rel=1e-3)
    total = np.hypot(budget['noise'], budget['projectile.sticking'])
    assert total == pytest.approx(stuck['layer.wave_speed'].error, rel=1e-3)


def test_rounding_increases_errors_beyond_the_scatter(make_throw):
    tracks = make_throw(RIG, duration=0.04, noise=5e-6)

    def rounded(track):
        return replace(track, position=5e-5 * np.rint(track.position / 5e-5))

    smooth, rough = (
        fit_rig([each], RIG, FitDescription(IDEAL_BENCH)).fit
        for each in (tracks, tracks.apply(rounded))
    )
    assert 'rounding' not in smooth.unseen
    assert rough['plate_offset'].error > 5e-6  # all samples at rest have the same error
    assert abs(rough['plate_offset'].value) < 3.0 * rough['plate_offset'].error


def sizes_of(seen, products, **options):
    count = len(seen)
    effect = UnseenEffect('x', np.zeros((count, 0)), np.zeros(count), np.zeros(count), **options)
    return effect.sizes(np.array(seen), np.array(products))


def test_size_of_an_effect_agrees_with_its_posterior():
    assert sizes_of([0.0, 99.0], [0.0, 0.0]) == pytest.approx([1.0, 0.1])
    assert sizes_of([0.0, 99.0], [0.0, 200.0]) == pytest.approx([1.0, 2.0], rel=0.01)


@pytest.mark.parametrize(
    ('presence', 'other'),
    [('one pair', 0.0),  # a pair that the residuals show leaves nothing to the other
     ('any pair', 0.1 / 101**0.5)],  # the odds of the other pair are 1 to 100
)
def test_effect_that_the_residuals_show_excludes_or_spares_the_others(presence, other):
    unknown = sizes_of(np.zeros(4), np.zeros(4), presence=presence)
    assert unknown == pytest.approx(np.full(4, 0.5**0.5))
    sizes = sizes_of(np.full(4, 99.0), [100.0, 0.0, 0.0, 0.0], presence=presence)
    assert sizes == pytest.approx([1.0, 0.1, other, other], rel=0.01, abs=1e-4)


@pytest.mark.parametrize('is_ringing', [False, True])
def test_ringing_with_its_own_damping_increases_the_error_of_the_damping(is_ringing):
    """The residuals show it, although ringing with the damping of the plate explains nothing."""
    engine = Engine(frequency=60.0, damping_ratio=0.12, amplitude=1e-3)
    since = np.arange(0.0, 0.1, 1.0 / 5000.0) - 0.016
    noise = 3e-5 * np.random.default_rng(1).normal(size=since.size)
    angle = 2.0 * np.pi * engine.frequency * since
    ringing = is_ringing * 2e-5 * np.exp(-0.01 * angle) * np.cos(angle + 2.5)
    plate = Underdamped.of(engine).position(since) + ringing + noise
    throw = ThrowTracks(name='x', plate=Track(time=since + 0.016, position=plate), projectile=None)
    names = {'layer.wave_speed': FIXED, 'plate.ringing': DEFAULTS['plate.ringing']}
    description = FitDescription({**IDEAL_BENCH, **names})
    result = fit_rig([throw], replace(RIG, engine=engine), description)
    assert not result.added_terms
    estimate = result.fit['engine.damping_ratio']
    budget = result.fit.budget('engine.damping_ratio')
    deviation = abs(estimate.value - engine.damping_ratio)
    assert deviation < 2.0 * estimate.error
    if is_ringing:
        assert deviation > 4.0 * budget['noise']
    else:
        assert estimate.error < 1.2 * budget['noise']


@pytest.mark.parametrize('treatment', ['free', '1e-4', '+- 1 %', '+- 1e-4 per throw'])
def test_effect_is_not_fitted(treatment):
    with pytest.raises(ValueError, match=r'projectile\.sticking cannot be fitted'):
        parse_treatments({'projectile.sticking': treatment})


def test_effect_of_the_stress_law_excludes_a_change_of_wave_speed(tracks):
    stiffening = {'layer.stiffening': DEFAULTS['layer.stiffening']}
    description = FitDescription({**IDEAL_BENCH, **stiffening})
    found = fit_rig([tracks], RIG, description)
    (effect,) = found.effects
    assert effect.name == 'layer.stress_strain_law'
    model, values = found.model, found.fit.values
    faster = values.copy()
    faster[model.layout.indices_of('layer.wave_speed')] *= 1.0 + 1e-4
    slope = model.predict(faster) - model.predict(values)
    (column,) = effect.heights
    cosine = column @ slope / np.linalg.norm(column) / np.linalg.norm(slope)
    assert abs(cosine) < 0.1
    assert 1e-6 < np.abs(column).max() < 1e-3
