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
"""Fitting a whole rig to throws."""

from dataclasses import replace
import re

import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import (
    ENGINE,
    FitDescription,
    HELD,
    PARAMETERS,
    USUAL,
    values_of,
)
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.least_squares import (
    Alternative,
    Fit,
    FitError,
    TrackResidual,
)
from soft_throw_ros.identification.plate_modes import Mode, PlateWithModes
from soft_throw_ros.identification.rig_fit import fit_rig
from soft_throw_ros.identification.throw_analysis import ejection_of
from soft_throw_ros.identification.tracks import ThrowTracks, Track
from soft_throw_ros.twin.imperfect_rig import Imperfections, throw

KNOWN = Rig(
    engine=Engine(frequency=10.0, amplitude=1.0, damping_ratio=0.5),  # nonsense, which is no guess
    layer=Layer(wave_speed=50.0),
)

EXACT = FitDescription(HELD)
"""Of a bench without any fault, where all is known exactly that is not usually found."""

# Least squares of the reference tracks, and Cramer-Rao bounds, by another program
REFERENCE = {
    'engine.frequency': (63.19137048111235, 0.01040214679247918),
    'engine.damping_ratio': (0.06409112828858043, 0.0001499256539475817),
    'engine.amplitude': (0.002000522379315976, 8.668036915683924e-07),
    'start_time': (0.020399559746852123, 2.864297503748516e-06),
    'layer.wave_speed': (7.7992031547331315, 0.007802020115142609),
}


def truth_of(rig, start=0.0153):
    return {'start_time': start, **values_of(rig, PARAMETERS)}


def pulls_of(fit, truth, names=PARAMETERS):
    """How many of its own errors a fit is from the truth."""
    return {
        name: (fit[name].value - truth[name]) / fit[name].error for name in names if name in fit
    }


def test_rig_fit_gives_the_reference_values(reference_throw):
    tracks = {
        body: replace(getattr(reference_throw, body), known_noise=2e-5)
        for body in ('plate', 'projectile')
    }
    throw = replace(reference_throw, **tracks)
    found = fit_rig(
        [throw],
        replace(KNOWN, gravity=0.0),
        FitDescription(HELD, 'absolute', 'centre'),
    )
    assert set(found.fit.names) == set(REFERENCE)
    for name, (value, error) in REFERENCE.items():
        assert found.fit[name].value == pytest.approx(value, abs=1e-2 * error)
        assert found.fit[name].error == pytest.approx(error, rel=5e-3)
    assert found.fit.chi2 == pytest.approx(1000.6256902061018, rel=1e-6)
    assert found.fit.dof == 995
    assert found.fit.warnings() == []


def test_many_throws_are_as_exact_as_they_should(make_throw):
    rig = Rig()
    throws = [
        make_throw(rig, rate=1500.0, duration=0.06, seed=seed, start=0.01 + 1e-4 * seed)
        for seed in range(4)
    ]
    one = fit_rig(throws[:1], KNOWN, EXACT).fit
    found = fit_rig(throws, KNOWN, EXACT)
    for name in USUAL:
        assert found.fit[name].error == pytest.approx(0.5 * one[name].error, rel=0.2)
    assert max(map(abs, pulls_of(found.fit, truth_of(rig)).values())) < 4.0
    for number in range(4):
        name = f'start_time[{number + 1}]'
        assert found.fit[name] == found.start_time(number)
        assert found.start_time(number).value == pytest.approx(
            0.01 + 1e-4 * number, abs=4.0 * found.fit[name].error
        )


@pytest.mark.parametrize(
    ('thickness', 'frequency', 'wave_speed', 'gravity'),
    [
        (2.0e-3, 31.1, 7.8, 0.0),  # caught up after the first release
        (5.6e-3, 63.2, 15.0, 9.81),
        (23.4e-3, 63.2, 4.0, 9.81),
        (29.1e-3, 31.1, 7.8, 0.0),
    ],
)
def test_wave_speed_is_found_without_a_guess(
    make_throw, thickness, frequency, wave_speed, gravity
):
    rig = Rig(
        engine=Engine(frequency=frequency),
        layer=Layer(thickness=thickness, wave_speed=wave_speed),
        gravity=gravity,
    )
    throw = make_throw(rig, rate=3000.0, duration=0.02 + 3.0 / frequency, zeros=(0.3, -0.2))
    known = replace(KNOWN, layer=Layer(thickness=thickness, wave_speed=50.0), gravity=gravity)
    found = fit_rig([throw], known, EXACT)
    assert max(map(abs, pulls_of(found.fit, truth_of(rig)).values())) < 4.0
    assert found.fit['layer.wave_speed'].error < 0.03 * wave_speed
    assert found.fit['plate_offset'].value == pytest.approx(-0.3, abs=1e-5)
    assert found.fit['projectile_offset'].value == pytest.approx(
        0.2 + thickness - rig.static_sag, abs=1e-5
    )


@pytest.mark.parametrize('reference', ['face', 'centre'])
@pytest.mark.parametrize('heights', ['common', 'absolute'])
def test_heights_from_one_zero_tell_the_thickness(make_throw, heights, reference):
    # Under its weight a projectile of 20 g sinks by 0.9 mm
    rig = Rig(projectile=Projectile(mass=0.02, length=0.05))
    assert rig.static_sag > 4e-4
    zero = 0.1 if heights == 'common' else 0.0
    up = 0.025 if reference == 'centre' else 0.0
    throw = make_throw(rig, rate=2000.0, duration=0.15, zeros=(zero, zero - up))
    known = replace(KNOWN, projectile=rig.projectile, layer=Layer(thickness=0.03))
    found = fit_rig(
        [throw], known, FitDescription({**HELD, 'layer.thickness': 'free'}, heights, reference)
    )
    assert max(map(abs, pulls_of(found.fit, truth_of(rig)).values())) < 4.0
    assert found.fit['layer.thickness'].error < 5e-5
    assert ('plate_offset' in found.fit) is (heights == 'common')


def test_thickness_and_wave_speed_of_a_spring_are_not_told_apart(make_throw):
    # A thin light layer: L_s / c_s^2 is known to a percent, neither of the two is
    rig = Rig(
        layer=Layer(thickness=2e-3, wave_speed=3.0),
        projectile=Projectile(mass=0.02),
        gravity=0.0,
    )
    throw = make_throw(rig, rate=1000.0, duration=0.1)
    known = replace(rig, layer=Layer(thickness=2.6e-3))
    found = fit_rig([throw], known, FitDescription({**HELD, 'layer.thickness': 'free'}))
    fit = found.fit
    for name, truth in (('layer.wave_speed', 3.0), ('layer.thickness', 2e-3)):
        low, high = found.intervals[name]
        assert low < truth < high
        # What the valley bends makes one side longer than the other
        assert high - low == pytest.approx(2.0 * 1.96 * fit[name].error, rel=0.5)
    (warning,) = [each for each in fit.warnings() if 'told apart' in each]
    assert 'layer.wave_speed and layer.thickness can hardly be told apart' in warning
    speed, thickness = fit['layer.wave_speed'], fit['layer.thickness']
    compliance = thickness.value / speed.value**2
    assert compliance == pytest.approx(2e-3 / 9.0, rel=0.02)
    assert thickness.error / thickness.value > 0.05
    held = fit_rig([throw], replace(known, layer=Layer(thickness=2e-3)), EXACT).fit
    assert held.warnings() == []
    assert held['layer.wave_speed'].error < 0.1 * speed.error


@pytest.mark.parametrize('loss_tangent', [0.0, 0.05])
def test_loss_is_found(loss_tangent):
    rig = Rig(layer=Layer(loss_tangent=loss_tangent))
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 0.06, 4e-4)
    since = time - 0.0153
    noise = 2e-5 * rng.normal(size=(2, time.size))
    throw = ThrowTracks(
        name='lossy',
        plate=Track(time=time, position=Underdamped.of(rig.engine).position(since) + noise[0]),
        projectile=Track(
            time=time, position=ThrowSimulator().follow(rig, since).position + noise[1]
        ),
    )
    found = fit_rig([throw], KNOWN, FitDescription({**HELD, 'layer.loss_tangent': 'free'}))
    assert max(map(abs, pulls_of(found.fit, truth_of(rig)).values())) < 4.0
    assert found.fit['layer.loss_tangent'].error < 0.01
    if loss_tangent:  # and is missed if it is not looked for
        assert any(
            'no white noise' in each for each in fit_rig([throw], KNOWN, EXACT).fit.warnings()
        )


def test_what_comes_after_the_landing_does_not_matter(make_throw):
    rig = Rig()
    throw = make_throw(rig, rate=1000.0, duration=0.4)
    landed = throw.projectile.time > 0.0153 + 0.2875  # and in truth at 0.2906
    other = np.where(landed, 0.05, throw.projectile.position)
    spoilt = replace(throw, projectile=replace(throw.projectile, position=other, known_noise=2e-5))
    found = fit_rig([spoilt], KNOWN, EXACT)
    assert max(map(abs, pulls_of(found.fit, truth_of(rig)).values())) < 4.0
    assert 0.27 < found.throws[0].projectile.time[-1] < 0.0153 + 0.2875
    assert found.fit.warnings() == []


@pytest.mark.parametrize(('body', 'place'), [('plate', 60), ('projectile', 90)])
def test_sample_that_jumps_is_left_out(make_throw, body, place):
    throw = make_throw(Rig(), rate=2000.0, duration=0.08)
    clean = fit_rig([throw], KNOWN, EXACT)
    position = getattr(throw, body).position.copy()
    position[place] += 3e-3
    spoilt = replace(throw, **{body: replace(getattr(throw, body), position=position)})
    found = fit_rig([spoilt], KNOWN, EXACT)
    listed = {each.name: each.outliers for each in found.fit.residuals if each.outliers}
    assert list(listed) == [body]
    assert [each.time for each in listed[body]] == [throw.plate.time[place]]
    assert np.abs((found.fit.values - clean.fit.values) / clean.fit.errors).max() < 1.0
    assert found.fit.warnings() == []


def changed(throw, *, plate=None, projectile=None, time=None, kept=slice(None)):
    """Tracks with other heights or stamps, or of some samples only."""

    def track(old, position):
        position = old.position if position is None else position
        return Track(time=(old.time if time is None else time)[kept], position=position[kept])

    return replace(
        throw, plate=track(throw.plate, plate), projectile=track(throw.projectile, projectile)
    )


def drifting(throw, _):
    ramp = 0.02 * 2e-3 * throw.plate.time / throw.plate.duration
    heights = throw.plate.position + ramp, throw.projectile.position - ramp
    return changed(throw, plate=heights[0], projectile=heights[1])


def scaled(throw, _):
    return changed(throw, projectile=1.005 * throw.projectile.position)


def late(throw, _):
    return replace(throw, projectile=replace(throw.projectile, time=throw.projectile.time + 1e-4))


def jittering(throw, rng):
    time = throw.plate.time
    return changed(throw, time=time + 4e-5 * rng.uniform(-1.0, 1.0, time.size))


def missing(throw, rng):
    return changed(throw, kept=rng.uniform(size=throw.plate.time.size) > 0.03)


def with_outliers(throw, rng):
    heights = []
    for track in (throw.plate, throw.projectile):
        size = track.time.size
        sizes = rng.uniform(3e-4, 3e-3, size) * rng.choice([-1.0, 1.0], size)
        heights.append(track.position + sizes * (rng.uniform(size=size) < 0.005))
    return changed(throw, plate=heights[0], projectile=heights[1])


def rounded(throw, _):
    return changed(
        throw,
        plate=2e-5 * np.rint(throw.plate.position / 2e-5),
        projectile=2e-5 * np.rint(throw.projectile.position / 2e-5),
    )


@pytest.mark.parametrize(
    'fault', [drifting, scaled, late, jittering, missing, with_outliers, rounded]
)
def test_what_sensors_get_wrong_is_within_the_errors(make_throw, fault):
    rng = np.random.default_rng(1)
    throw = fault(make_throw(Rig(), zeros=(0.1, -0.2), noise=1.5e-5), rng)
    found = fit_rig([throw], Rig(layer=Layer(wave_speed=20.0)))
    names = (*USUAL, 'start_time')
    assert max(map(abs, pulls_of(found.fit, truth_of(Rig()), names).values())) < 3.5
    assert found.fit['engine.frequency'].error < 0.03
    assert found.fit.warnings() == []


def test_stamps_that_are_off_make_noise_where_bodies_are_fast(make_throw):
    throw = make_throw(Rig(), noise=1e-5)
    found = fit_rig([jittering(throw, np.random.default_rng(2))], Rig(), EXACT)
    residual = found.fit.residuals[1]
    assert residual.noise.min() == pytest.approx(1e-5, rel=0.2)
    assert residual.noise.max() == pytest.approx(1.4 * 4e-5 / 3**0.5, rel=0.25)


def test_second_mode_of_a_plate_is_seen_and_said():
    rig = Rig()
    since = np.arange(0.0, 0.1, 2e-4) - 0.0153
    plate = PlateWithModes(Underdamped.of(rig.engine), (0.0, 0.0, 0.0, 0.01), Mode(310.0, 0.02))
    path = ThrowSimulator().follow(rig, since, motion=plate)
    noise = 2e-5 * np.random.default_rng(3).normal(size=(2, since.size))
    throw = ThrowTracks(
        name='ringing',
        plate=Track(time=since + 0.0153, position=plate.position(since) + noise[0]),
        projectile=Track(time=since + 0.0153, position=path.position + noise[1]),
    )
    found = fit_rig([throw], rig)
    remark = found.remarks[0]
    assert 'a plate with a second mode explains' in remark
    frequency = found.fit['plate.mode_frequency']
    assert frequency.value == pytest.approx(310.0, abs=3.5 * frequency.error)
    assert found.fit.warnings() == []
    assert max(map(abs, pulls_of(found.fit, truth_of(rig), USUAL).values())) < 3.5


def imperfect_throw(imperfections, *, rig=None, seed=0, noise=2e-5):
    """Tracks of a throw by small cells, which share nothing with what is fitted."""
    thrown = throw(rig or Rig(), imperfections, until=0.07, start=-0.016, cells=128)
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 0.08, 2e-4)
    heights = thrown.plate(time - 0.0153), thrown.projectile(time - 0.0153)
    plate, projectile = (
        Track(time=time, position=each + noise * rng.normal(size=time.size)) for each in heights
    )
    return ThrowTracks(name='imperfect', plate=plate, projectile=projectile), thrown.changes[0]


def test_layer_that_sticks_is_in_the_error_of_the_ejection_time():
    tracks, release = imperfect_throw(Imperfections(sticking=2e-4))
    fit = fit_rig([tracks], Rig())
    assert fit.warnings() == []  # it may as well not stick
    found = ejection_of(fit)
    for estimate, truth in ((found.time, release.time), (found.speed, release.velocity)):
        assert estimate.value == pytest.approx(truth, abs=2.5 * estimate.error)
    held = ejection_of(fit_rig([tracks], Rig(), FitDescription({'projectile.sticking': 'held'})))
    assert held.time.error < found.time.error < 4e-4
    assert abs(held.time.value - release.time) > 5.0 * held.time.error  # it does matter


@pytest.mark.parametrize('phase', [0.5, 3.5])
def test_plate_that_rings_before_leads_to_no_other_minimum(phase):
    # So thin a layer that the projectile does not leave it before the throw
    rig = Rig(layer=Layer(thickness=8e-3))
    tracks, release = imperfect_throw(Imperfections(ringing=0.015, ringing_phase=phase), rig=rig)
    assert release.time > 0.0
    found = fit_rig([tracks], replace(KNOWN, layer=replace(rig.layer, wave_speed=50.0)))
    assert 'a plate that rings' in found.remarks[0]
    assert found.fit.warnings() == []
    assert max(map(abs, pulls_of(found.fit, truth_of(rig), USUAL).values())) < 3.5
    peak = found.peak_plate_speed(0)  # which averages go by, too
    truth = Underdamped.of(Rig().engine).peak_velocity
    assert peak.value == pytest.approx(truth, abs=3.5 * peak.error)
    assert ejection_of(found).speed.value == pytest.approx(release.velocity, rel=0.02)


def test_other_minimum_is_named_and_spanned():
    values = np.array([16.9, 1.0])
    residual = TrackResidual(
        name='a', track=Track(time=np.arange(20.0), position=np.zeros(20)), fitted=np.zeros(20),
        noise=np.ones(20),
    )  # fmt: skip
    fit = Fit(
        names=('layer.wave_speed', 'start_time'), values=values, covariance=np.diag([1e-4, 1e-4]),
        chi2=18.0, dof=18, residuals=(residual,),
    )  # fmt: skip
    found = fit.spanning([Alternative(np.array([17.1, 1.0]), 4.0)])
    assert 1.96 * found['layer.wave_speed'].error > 0.19
    assert found['start_time'] == fit['start_time']
    assert any('17.1' in warning for warning in found.warnings())


def test_loss_is_seen_without_being_asked_for():
    rig = Rig(layer=Layer(loss_tangent=0.05))
    since = np.arange(0.0, 0.07, 4e-4) - 0.0153
    noise = 2e-5 * np.random.default_rng(4).normal(size=(2, since.size))
    throw = ThrowTracks(
        name='lossy',
        plate=Track(
            time=since + 0.0153, position=Underdamped.of(rig.engine).position(since) + noise[0]
        ),
        projectile=Track(
            time=since + 0.0153, position=ThrowSimulator().follow(rig, since).position + noise[1]
        ),
    )
    description = FitDescription({**HELD, 'layer.loss_tangent': 'free if seen'})
    found = fit_rig([throw], Rig(), description)
    (remark,) = found.remarks
    assert 'a layer with loss explains these throws' in remark
    assert 'one without loss' in remark
    assert 'does not' in remark
    best = min(found.layers, key=lambda layer: layer.criterion)
    assert (best.name, best.criterion, best.is_fitted) == ('with loss', 0.0, True)
    assert best.chi2 == pytest.approx(found.fit.chi2)
    loss = found.estimates()['layer.loss_tangent']
    assert loss.value == pytest.approx(0.05, abs=3.5 * loss.error)


def followed(rig, *, name='followed', seed=0, noise=2e-5):
    """Tracks of a throw by the model that is fitted, with noise."""
    time = np.arange(0.0, 0.08, 2e-4)
    since = time - 0.0153
    heights = (
        Underdamped.of(rig.engine).position(since),
        ThrowSimulator().follow(rig, since).position,
    )
    rng = np.random.default_rng(seed)
    plate, projectile = (
        Track(time=time, position=each + noise * rng.normal(size=time.size)) for each in heights
    )
    return ThrowTracks(name=name, plate=plate, projectile=projectile)


def test_layer_of_large_strain_is_told_from_linear_ones():
    rig = Rig(engine=Engine(amplitude=5e-3), layer=Layer(elasticity='neo_hookean'))
    found = fit_rig([followed(rig)], KNOWN)
    assert found.rig.layer.elasticity == 'neo_hookean'
    assert max(map(abs, pulls_of(found.fit, truth_of(rig), ENGINE).values())) < 3.5
    speed = found.estimates()['layer.wave_speed']
    assert speed.value == pytest.approx(7.8, abs=3.5 * speed.error)
    assert found.fit.warnings() == []
    assert re.fullmatch(
        r'a layer of large strain explains these throws \(chi squared (0.9|1.0).*'
        r'; one .*without loss .* does not',
        found.remarks[-1],
    )
    best = min(found.layers, key=lambda layer: layer.criterion)
    assert (best.name, best.is_fitted) == ('of large strain', True)


def test_what_contradicts_what_is_known_is_said(make_throw):
    throw = make_throw(Rig())
    wrong = changed(throw, projectile=1.05 * throw.projectile.position)
    (warning,) = fit_rig([wrong], KNOWN).warnings()
    assert re.match(
        r'projectile\.scale is found 10\.\d errors from .* 1\.0000 \+- 0\.0050', warning
    )


def test_layer_that_is_linear_stays_so(make_throw):
    found = fit_rig([make_throw(Rig(engine=Engine(amplitude=5e-3)))], KNOWN)
    assert found.rig.layer.elasticity == 'linear'
    assert found.remarks[-1].startswith('a layer without loss explains these throws')


def test_loss_that_nobody_told_is_found_beside_all_that_a_bench_may_add():
    rig = Rig(layer=Layer(loss_tangent=0.1))
    found = fit_rig([followed(rig)], KNOWN)
    assert max(map(abs, pulls_of(found.fit, truth_of(rig)).values())) < 3.5
    assert found.fit['layer.loss_tangent'].error < 0.02
    assert found.fit.warnings() == []


def test_throws_of_two_masses_tell_thickness_and_wave_speed_apart(make_throw):
    light, heavy = (Rig(projectile=Projectile(mass=mass)) for mass in (0.7e-3, 2.4e-3))
    throws = [
        replace(make_throw(rig, rate=2500.0, duration=0.07, seed=seed), name=name)
        for seed, (rig, name) in enumerate(((light, 'light'), (heavy, 'heavy')))
    ]
    parameters = {**HELD, 'layer.thickness': 'free'}
    masses = {'light': '0.7e-3', 'heavy': '2.4e-3'}
    conditions = {name: {'projectile.mass': mass} for name, mass in masses.items()}
    both = fit_rig(throws, light, FitDescription(parameters, throws=conditions))
    one = fit_rig(throws[:1], light, FitDescription(parameters))
    assert max(map(abs, pulls_of(both.fit, truth_of(light), PARAMETERS).values())) < 4.0
    assert both.fit['layer.thickness'].error < 0.5 * one.fit['layer.thickness'].error


def test_amplitude_of_each_throw_is_its_own(make_throw):
    amplitudes = (2.0e-3, 1.94e-3, 2.05e-3)
    throws = [
        make_throw(Rig(engine=Engine(amplitude=each)), rate=2000.0, duration=0.06, seed=seed)
        for seed, each in enumerate(amplitudes)
    ]
    assert fit_rig(throws, KNOWN, EXACT).fit.is_mismatch
    found = fit_rig(throws, KNOWN)
    assert not found.fit.is_mismatch
    for number, truth in enumerate(amplitudes, 1):
        amplitude = found.fit[f'engine.amplitude[{number}]']
        assert amplitude.value == pytest.approx(truth, abs=4.0 * amplitude.error)
    mean = found.estimates()['engine.amplitude']
    assert mean.value == found.rig.engine.amplitude
    assert mean.value == pytest.approx(np.mean(amplitudes), abs=4.0 * mean.error)


def test_error_of_a_mass_is_carried_into_the_wave_speed(make_throw):
    throw = make_throw(Rig(), rate=2000.0, duration=0.06)
    exact = fit_rig([throw], KNOWN, EXACT).fit
    found = fit_rig([throw], KNOWN, FitDescription({**HELD, 'projectile.mass': '+- 5 %'})).fit
    assert found['projectile.mass'].error < 0.06 * KNOWN.projectile.mass
    assert found['layer.wave_speed'].error > 2.0 * exact['layer.wave_speed'].error


def test_plate_alone_gives_the_engine(make_throw):
    throws = [
        replace(make_throw(Rig(), rate=2000.0, seed=seed), projectile=None) for seed in range(2)
    ]
    found = fit_rig(throws, KNOWN, FitDescription({**HELD, 'layer.wave_speed': 'held'}))
    assert set(found.fit.names) >= set(ENGINE)
    assert max(map(abs, pulls_of(found.fit, truth_of(Rig()), ENGINE).values())) < 4.0
    assert found.rig.layer == KNOWN.layer


def test_tracks_that_do_not_give_the_layer_are_refused(make_throw):
    throw = make_throw(Rig(), rate=500.0)
    rng = np.random.default_rng(1)
    still = replace(throw.plate, position=1e-5 * rng.normal(size=throw.plate.time.size))
    for throws, value in (
        ([], 'no throw'),
        ([replace(throw, projectile=None)], 'layer.wave_speed cannot be found without'),
        ([throw, replace(throw, name='still.csv', plate=still)], 'still.csv: the plate'),
    ):
        with pytest.raises(FitError, match=re.escape(value)):
            fit_rig(throws, KNOWN)
