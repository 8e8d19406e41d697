# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fitting a whole rig to throws."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.identification.fit_description import (
    DEFAULT_FREE,
    FitDescription,
    FIXED,
    FREE,
    IDEAL_BENCH,
    LOSS,
    PARAMETERS,
    values_of,
)
from soft_throw_ros.identification.least_squares import fit_warnings, FitError
from soft_throw_ros.identification.rig_fit import fit_rig
from soft_throw_ros.identification.rig_model import ThrowSimulator
from soft_throw_ros.identification.tracks import Track
from soft_throw_ros.simulated_rig.imperfect_rig import Imperfections, throw

FAR = Engine(frequency=10.0, amplitude=1.0, damping_ratio=0.5)
KNOWN = Rig(engine=FAR, layer=Layer(wave_speed=50.0))

# Least squares of the reference tracks, and Cramer-Rao bounds, by another program
REFERENCE = {
    'engine.frequency': (63.19137048111235, 0.01040214679247918),
    'engine.damping_ratio': (0.06409112828858043, 0.0001499256539475817),
    'engine.amplitude': (0.002000522379315976, 8.668036915683924e-07),
    'start_time': (0.020399559746852123, 2.864297503748516e-06),
    'layer.wave_speed': (7.7992031547331315, 0.007802020115142609),
}


def test_rig_fit_agrees_with_the_reference(reference_throw):
    tracks = reference_throw.apply(lambda track: replace(track, known_noise=2e-5))
    found = fit_rig([tracks], replace(KNOWN, gravity=0.0), FitDescription(IDEAL_BENCH)).fit
    for name, (value, error) in REFERENCE.items():
        assert found[name].value == pytest.approx(value, abs=2.0 * error)
        # The reference knows the heights at rest
        assert 0.95 * error < found[name].error < 2.5 * error
    assert found.chi2 == pytest.approx(1000.6, abs=8.0)
    assert found.dof == 993
    assert fit_warnings(found) == []


def test_values_of_rigs_are_found_within_their_errors_without_a_guess(fits):
    pulls = []
    for rig, found in fits.values():
        assert fit_warnings(found.fit) == []
        assert LOSS not in found.fit
        truth = values_of(rig, PARAMETERS)
        for name, (value, error) in found.estimates().items():
            pulls.append(abs(value - truth[name]) / error)
        speed, at_rest = found.estimate('layer.wave_speed'), found.rest_wave_speed()
        assert at_rest.value == speed.value
        assert 1.05 * speed.error < at_rest.error
        assert speed.error < 0.05 * rig.layer.wave_speed
        assert found.fit['plate_offset'].value == pytest.approx(-0.3, abs=1e-5)
        assert found.fit['start_time'].value == pytest.approx(0.0153, abs=3e-5)
    assert max(pulls) < 3.0
    assert np.mean(np.array(pulls) < 1.96) > 0.93


@pytest.mark.parametrize('imperfections', [
    Imperfections(ringing=0.02),
    pytest.param(Imperfections(second_mode=0.02), marks=pytest.mark.slow),
])
def test_other_motions_of_the_plate_enlarge_all_errors(see, fits, imperfections):
    thrown, time = throw(Rig(), imperfections, until=0.07, start=-0.016), np.arange(400) * 2e-4
    since = time - 0.0153
    tracks = see(time, thrown.plate(since), thrown.projectile(since), noise=5e-6)
    found, clean = fit_rig([tracks], Rig()), fits['usual', 5e-6][1]
    assert 1.1 < clean.growth < 1.5  # the noise may hide an oscillation
    assert found.growth > 2.0 * clean.growth
    for name in DEFAULT_FREE:
        assert found.estimate(name).error > 1.5 * clean.estimate(name).error


def followed(see, rig, *, rate=5000.0, **options):
    """Tracks of a throw by the model that is fitted."""
    time = np.arange(0.0, 0.08, 1.0 / rate)
    height = ThrowSimulator().follow(rig, time - 0.0153).height
    return see(time, Underdamped.of(rig.engine).position(time - 0.0153), height, **options)


@pytest.mark.parametrize(('layer', 'amplitude', 'description'), [
    ({}, 2e-3, {**IDEAL_BENCH, LOSS: FREE}),  # the loss may be zero
    pytest.param({'loss_tangent': 0.1}, 2e-3, {}, marks=pytest.mark.slow),
    pytest.param({'stress_strain_law': 'neo_hookean'}, 5e-3, {}, marks=pytest.mark.slow),
])
def test_loss_is_found_and_large_strain_is_fitted_if_stated(see, layer, amplitude, description):
    rig = Rig(engine=Engine(amplitude=amplitude), layer=Layer(**layer))
    known = replace(KNOWN, layer=replace(rig.layer, wave_speed=50.0, loss_tangent=0.0))
    found = fit_rig([followed(see, rig)], known, FitDescription(description))
    truth = values_of(rig, PARAMETERS)
    for name, (value, error) in found.estimates().items():
        assert value == pytest.approx(truth[name], abs=3.5 * error), name
    assert LOSS not in found.fit or found.fit[LOSS].error < 0.02
    assert (LOSS in found.fit) is (amplitude < 5e-3)
    assert not found.fit.is_mismatch
    assert fit_warnings(found.fit) == [] or not layer


@pytest.mark.parametrize(('noise', 'is_fitted'), [(1.2e-4, True), (1.5e-4, False)])
def test_loss_is_fitted_if_it_gains_six_more_than_the_logarithm_of_the_samples(
    see, noise, is_fitted
):
    tracks = [followed(see, Rig(layer=Layer(loss_tangent=0.02)), rate=1000.0, noise=noise)]
    known = {**IDEAL_BENCH, 'layer.wave_speed': FIXED}
    del known[LOSS]
    without, with_loss, chosen = (
        fit_rig(tracks, Rig(), FitDescription({**known, **loss})).fit
        for loss in ({LOSS: FIXED}, {LOSS: FREE}, {})
    )
    gain = without.chi2 - with_loss.chi2 - np.log(160)
    assert gain > 6.0 if is_fitted else gain < 6.0
    assert (LOSS in chosen) is is_fitted


def test_throws_have_separate_amplitudes(make_throw):
    amplitudes = (2.0e-3, 1.94e-3, 2.05e-3)
    found = fit_rig([
        make_throw(Rig(engine=Engine(amplitude=size)), rate=2000.0, duration=0.06, seed=number)
        for number, size in enumerate(amplitudes)
    ], KNOWN)
    assert not found.fit.is_mismatch
    mean = found.estimates()['engine.amplitude']
    assert mean.value == found.rig.engine.amplitude
    own = (found.fit[f'engine.amplitude[{number}]'] for number in (1, 2, 3))
    for truth, (value, error) in ((np.mean(amplitudes), mean), *zip(amplitudes, own, strict=True)):
        assert value == pytest.approx(truth, abs=4.0 * error)


def test_tracks_without_information_on_the_layer_are_refused(make_throw):
    seen = make_throw(Rig(), rate=500.0)
    scatter = 1e-5 * np.random.default_rng(1).normal(size=seen.plate.time.size)
    still = Track(time=seen.plate.time, position=scatter)
    for throws, value in (
        ([replace(seen, projectile=None)], 'layer.wave_speed cannot be found without'),
        ([], 'layer.wave_speed cannot be found without'),
        ([seen, replace(seen, name='still.csv', plate=still)], 'still.csv: the plate'),
    ):
        with pytest.raises(FitError, match=value):
            fit_rig(throws, KNOWN)
