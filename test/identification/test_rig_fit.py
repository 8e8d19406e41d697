# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fitting a whole rig to throws."""

from dataclasses import replace
import re

import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import (
    DEFAULT_FREE,
    ENGINE,
    FitDescription,
    FIXED,
    FREE,
    IDEAL_BENCH,
    LOSS,
    PARAMETERS,
    Treatment,
    values_of,
)
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.least_squares import fit_warnings, FitError
from soft_throw_ros.identification.rig_fit import fit_rig
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


def assert_true(found, rig, names=PARAMETERS):
    """Assert that fitted values are within 3.5 standard errors of the truth."""
    for name, truth in values_of(rig, names).items():
        if name in found.fit:
            value, error = found.fit[name]
            assert value == pytest.approx(truth, abs=3.5 * error), name


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
    tracks, _ = imperfect_throw(see, Rig(), imperfections, noise=5e-6)
    found, clean = fit_rig([tracks], Rig()), fits['usual', 5e-6][1]
    assert clean.growth < 1.5
    assert found.growth > 2.0 * clean.growth
    for name in DEFAULT_FREE:
        assert found.estimate(name).error > 1.5 * clean.estimate(name).error


def test_model_of_two_throws_has_right_derivatives_priors_and_cuts(make_model, make_throw):
    delay = 'projectile.delay'
    treatments = {
        'engine.amplitude': FREE._replace(is_per_throw=True),
        'layer.thickness': Treatment(True, error=1e-4),
        'projectile.mass': Treatment(True, error=0.02, is_relative=True),
        delay: Treatment(True, error=1e-4),
        'plate.drift': Treatment(True, error=0.02, is_per_throw=True),
    }
    throws = [make_throw(Rig(), rate=1000.0, duration=0.05, start=s) for s in (0.0102, 0.0113)]
    model = make_model(Rig(), throws, FitDescription({**IDEAL_BENCH, **treatments}))
    names, values = model.names, model.start()
    priors = model.fit(values, max_evaluations=1).known
    assert {names[index]: prior.error for index, prior in priors.items()} == {
        'layer.thickness': 1e-4, 'projectile.mass': 0.02 * Rig().projectile.mass, delay: 1e-4,
        'plate.drift[1]': 0.02, 'plate.drift[2]': 0.02,
    }
    values[[names.index(delay), names.index('plate.drift[1]')]] += [3e-5, 0.01]
    jacobian = model.jacobian(values)
    assert jacobian.shape == (model.predict(values).size, len(names))
    for index, name in enumerate(names):
        step = np.zeros_like(values)
        step[index] = 1e-5 if name.startswith(('start', delay)) else 1e-3
        if name.partition('[')[0] in PARAMETERS:
            step[index] *= values[index]
        slope = (model.predict(values + step) - model.predict(values - step)) / (2 * step[index])
        assert 0.02 * np.linalg.norm(slope) > np.linalg.norm(jacobian[:, index] - slope), name
    for number, cut in enumerate(model.cut_after(0.02).throws):
        assert cut.projectile.time[-1] <= model.start_of(number) + 0.02 < cut.plate.time[-1]
    assert model.cut_after(-1.0).projectiles == []


@pytest.mark.slow
def test_thickness_and_wave_speed_of_a_spring_are_indistinguishable(make_throw):
    # A thin light layer: L_s / c_s^2 is known to a percent, neither of the two is
    layer = Layer(thickness=2e-3, wave_speed=3.0)
    rig = Rig(layer=layer, projectile=Projectile(mass=0.02), gravity=0.0)
    known = replace(rig, layer=Layer(thickness=2.6e-3))
    description = FitDescription({**IDEAL_BENCH, 'layer.thickness': FREE})
    fit = fit_rig([make_throw(rig, rate=1000.0)], known, description).fit
    pairs = [text for text in fit_warnings(fit) if 'hardly separated' in text]
    assert any('layer.wave_speed and layer.thickness' in pair for pair in pairs)
    speed, thickness = fit['layer.wave_speed'], fit['layer.thickness']
    assert thickness.value / speed.value**2 == pytest.approx(2e-3 / 9.0, rel=0.02)
    assert thickness.error / thickness.value > 0.05


def followed(see, rig, *, rate=5000.0, **options):
    """Tracks of a throw by the model that is fitted."""
    time = np.arange(0.0, 0.08, 1.0 / rate)
    height = ThrowSimulator().follow(rig, time - 0.0153).position
    return see(time, Underdamped.of(rig.engine).position(time - 0.0153), height, **options)


def imperfect_throw(see, rig, imperfections, **options):
    """Return tracks and the first release of a throw whose plate is imperfect."""
    thrown = throw(rig, imperfections, until=0.07, start=-0.016)
    time = np.arange(0.0, 0.08, 2e-4)
    since = time - 0.0153
    return see(time, thrown.plate(since), thrown.projectile(since), **options), thrown.events[0]


@pytest.mark.parametrize(
    ('loss', 'description'),
    [(0.0, {**IDEAL_BENCH, LOSS: FREE}), pytest.param(0.1, {}, marks=pytest.mark.slow)],
)
def test_loss_is_found_and_may_be_zero(see, loss, description):
    rig = Rig(layer=Layer(loss_tangent=loss))
    found = fit_rig([followed(see, rig)], KNOWN, FitDescription(description))
    assert_true(found, rig)
    assert found.fit['layer.loss_tangent'].error < 0.02
    assert fit_warnings(found.fit) == [] or loss == 0.0


@pytest.mark.parametrize(('noise', 'is_fitted'), [(1.2e-4, True), (1.5e-4, False)])
def test_loss_is_fitted_if_it_gains_six_more_than_the_logarithm_of_the_samples(
    see, noise, is_fitted
):
    tracks = [followed(see, Rig(layer=Layer(loss_tangent=0.02)), rate=1000.0, noise=noise)]
    described = {**IDEAL_BENCH, 'layer.wave_speed': FIXED}
    del described[LOSS]
    without, with_loss = (
        fit_rig(tracks, Rig(), FitDescription({**described, LOSS: treatment})).fit
        for treatment in (FIXED, FREE)
    )
    gain = without.chi2 - with_loss.chi2 - np.log(160)
    assert gain > 6.0 if is_fitted else gain < 6.0
    assert (LOSS in fit_rig(tracks, Rig(), FitDescription(described)).fit) is is_fitted


@pytest.mark.slow
def test_layer_of_large_strain_is_fitted_if_stated(see):
    rig = Rig(engine=Engine(amplitude=5e-3), layer=Layer(stress_strain_law='neo_hookean'))
    known = replace(KNOWN, layer=replace(rig.layer, wave_speed=50.0))
    found = fit_rig([followed(see, rig)], known)
    assert_true(found, rig, ENGINE)
    speed = found.estimate('layer.wave_speed')
    assert speed.value == pytest.approx(rig.layer.wave_speed, abs=3.5 * speed.error)
    assert not found.fit.is_mismatch


def test_throws_have_separate_amplitudes(make_throw):
    amplitudes = (2.0e-3, 1.94e-3, 2.05e-3)
    rigs = [Rig(engine=Engine(amplitude=amplitude)) for amplitude in amplitudes]
    found = fit_rig([
        make_throw(rig, rate=2000.0, duration=0.06, seed=n) for n, rig in enumerate(rigs)
    ], KNOWN)
    assert not found.fit.is_mismatch
    for number, truth in enumerate(amplitudes, 1):
        amplitude = found.fit[f'engine.amplitude[{number}]']
        assert amplitude.value == pytest.approx(truth, abs=4.0 * amplitude.error)
    mean = found.estimates()['engine.amplitude']
    assert mean.value == found.rig.engine.amplitude
    assert mean.value == pytest.approx(np.mean(amplitudes), abs=4.0 * mean.error)


def test_tracks_without_information_on_the_layer_are_refused(make_throw):
    seen = make_throw(Rig(), rate=500.0)
    scatter = 1e-5 * np.random.default_rng(1).normal(size=seen.plate.time.size)
    still = Track(time=seen.plate.time, position=scatter)
    for throws, value in (
        ([replace(seen, projectile=None)], 'layer.wave_speed cannot be found without'),
        ([seen, replace(seen, name='still.csv', plate=still)], 'still.csv: the plate'),
        ([], 'no throw'),
    ):
        with pytest.raises(FitError, match=re.escape(value)):
            fit_rig(throws, KNOWN)
