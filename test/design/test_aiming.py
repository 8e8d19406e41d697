# SPDX-License-Identifier: Apache-2.0
"""Aiming, against throws that are simulated afterwards."""

from dataclasses import replace
import math

import numpy as np
import pytest
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.graded_layer import GradedLayer
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.travelling_wave import ThrowUnresolvedError
from soft_throw_ros.design.aiming import aim, fly, Target
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.recommendation import predict

MATERIALS = library().materials
EXACT = 1e-5  # of what the stepper throws; it is off by 1e-6 of A omega at most


def some_rig(rng):
    """Draw a rig whose throws are not long compared with its waves, which take their time."""
    return Rig(
        engine=Engine(
            frequency=rng.uniform(50.0, 150.0), damping_ratio=float(rng.choice([0.0, 0.064, 0.3]))
        ),
        layer=Layer(thickness=rng.uniform(0.01, 0.03), wave_speed=rng.uniform(5.0, 12.0)),
        projectile=Projectile(mass=rng.uniform(3e-4, 4e-3)),
    )


def with_amplitude(rig, amplitude):
    return replace(rig, engine=replace(rig.engine, amplitude=amplitude))


def rise(throw):
    """Return how far a simulated throw rises above where the projectile rests."""
    rig = throw.rig
    return throw.apex_height - rig.layer.thickness + rig.static_sag


@pytest.mark.parametrize('seed', range(10))
def test_amplitude_for_a_height_reaches_it_when_simulated(seed):
    rng = np.random.default_rng(seed)
    rig, height = some_rig(rng), rng.uniform(0.02, 0.5)
    found = aim(rig, Target(height=height), limits=Limits(), max_amplitude=1.0)
    assert found.is_reached
    throw = simulate(with_amplitude(rig, found.amplitude))
    assert found.rig == throw.rig
    assert rise(throw) == pytest.approx(height, rel=EXACT)
    assert found.height == pytest.approx(height, rel=1e-6)
    assert found.speed == pytest.approx(throw.last_release.velocity, rel=EXACT)


@pytest.mark.parametrize('gravity', [0.0, 9.81])
@pytest.mark.parametrize('seed', range(5))
def test_amplitude_for_a_speed_reaches_it_when_simulated(seed, gravity):
    rng = np.random.default_rng(seed)
    rig, speed = replace(some_rig(rng), gravity=gravity), rng.uniform(0.5, 3.0)
    found = aim(rig, Target(speed=speed), max_amplitude=1.0)
    assert found.is_reached
    throw = simulate(found.rig)
    assert throw.last_release.velocity == pytest.approx(speed, rel=EXACT)
    assert found.height == (math.inf if gravity == 0.0 else pytest.approx(rise(throw), rel=EXACT))


@pytest.mark.parametrize('vary', ['thickness', 'wave_speed', 'both'])
@pytest.mark.parametrize('height', [0.05, 0.3])
def test_layer_and_amplitude_together_take_the_least_amplitude(vary, height):
    rig = Rig()
    found = aim(rig, Target(height=height), vary=vary)
    assert found.is_reached
    assert rise(simulate(found.rig)) == pytest.approx(height, rel=EXACT)
    layers = [
        replace(rig.layer, thickness=float(thickness), wave_speed=float(wave_speed))
        for thickness in (np.geomspace(1e-3, 50e-3, 12) if vary != 'wave_speed' else [0.0168])
        for wave_speed in (np.geomspace(1.0, 50.0, 12) if vary != 'thickness' else [7.8])
    ]
    needed = [
        aim(replace(rig, layer=layer), Target(height=height), max_amplitude=10.0).amplitude
        for layer in layers
    ]
    assert found.amplitude <= min(needed) * (1.0 + 1e-4)
    assert found.amplitude <= aim(rig, Target(height=height)).amplitude


def test_amplitude_is_the_smallest_even_where_later_swings_throw():
    """Under strong gravity what is reached jumps with the amplitude."""
    rig = Rig(engine=Engine(frequency=15.0))
    target = Target(height=0.03)
    found = aim(rig, target)
    assert found.height == pytest.approx(0.03, rel=1e-6)
    for amplitude in np.geomspace(1e-4, 0.999 * found.amplitude, 150):
        try:
            flight = fly(with_amplitude(rig, float(amplitude)))
        except ThrowUnresolvedError:
            continue
        assert flight.height < 0.03


@pytest.mark.parametrize('vary', ['amplitude', 'both', 'library'])
def test_limits_of_the_loads_are_kept(vary):
    rig, limits = Rig(), Limits(max_strain=0.08, max_acceleration=900.0)
    found = aim(rig, Target(height=0.1), vary=vary, limits=limits, materials=MATERIALS)
    loads = predict(found.rig)
    assert found.peak_strain == loads.peak_strain <= 0.08 * (1.0 + 1e-5)
    assert found.peak_acceleration == loads.peak_acceleration <= 900.0 * (1.0 + 1e-5)
    assert found.is_reached == (vary != 'amplitude')
    assert found.is_reached == (found.height == pytest.approx(0.1, rel=1e-6))


def test_target_out_of_reach_gives_the_most_and_says_what_would_reach_it():
    rig, limits = Rig(), Limits(max_strain=0.15)
    found = aim(rig, Target(height=0.5), limits=limits)
    assert not found.is_reached
    assert found.peak_strain == pytest.approx(0.15, rel=1e-6)
    free = aim(rig, Target(height=0.5))
    assert (
        f'it takes a strain of {1e2 * free.peak_strain:.3g} % instead of at most 15 %' in found.why
    )
    assert f'the most is {found.height:.4g} m high' in found.why
    other = aim(rig, Target(height=0.5), vary='both', limits=limits)
    assert other.is_reached
    layer = f'{1e3 * other.thickness:.4g} mm and {other.wave_speed:.4g} m/s would do it'
    assert layer in found.why
    # a little less is within reach
    less = aim(rig, Target(height=0.999 * found.height), limits=limits)
    assert less.is_reached
    assert not aim(rig, Target(height=1.001 * found.height), limits=limits).is_reached


def test_most_within_the_limits_is_not_less_than_that_of_any_layer():
    rig = Rig()
    limits = Limits(max_strain=0.05, thickness_max=0.02)
    target = Target(height=5.0)
    found = aim(rig, target, vary='both', limits=limits, max_amplitude=5e-3)
    assert not found.is_reached
    assert 'would do it' not in found.why
    for thickness in np.geomspace(1e-3, 0.02, 8):
        for wave_speed in np.geomspace(1.0, 50.0, 8):
            layer = replace(rig.layer, thickness=float(thickness), wave_speed=float(wave_speed))
            try:
                other = aim(replace(rig, layer=layer), target, limits=limits, max_amplitude=5e-3)
            except ThrowUnresolvedError:  # held by gravity before the limits are reached
                continue
            assert other.height <= found.height * (1.0 + 1e-3)


def test_amplitude_beyond_that_of_the_plate_is_named():
    found = aim(Rig(), Target(speed=3.0), max_amplitude=3e-3)
    assert not found.is_reached
    assert found.amplitude == 3e-3
    assert re_words('an amplitude of', 'mm instead of at most 3 mm', found.why)


def re_words(*words_and_text):
    """Tell whether words follow one another in a text."""
    *words, text = words_and_text
    places = [text.find(word) for word in words]
    return -1 not in places and places == sorted(places)


def test_layer_with_loss_is_aimed_with_at_its_first_release():
    rig = Rig(layer=Layer(loss_tangent=0.1))
    found = aim(rig, Target(height=0.1))
    throw = simulate(found.rig, model='finite_difference', cells=128)
    assert throw.recontacts == 0
    assert rise(throw) == pytest.approx(0.1, rel=2e-3)
    assert found.amplitude > aim(Rig(), Target(height=0.1)).amplitude


def test_layer_of_the_library_is_picked_by_the_least_amplitude():
    rig = Rig()
    found = aim(rig, Target(height=0.2), vary='library', materials=MATERIALS)
    assert found.is_reached
    assert fly(found.rig).height == pytest.approx(0.2, rel=1e-6)
    for material in MATERIALS.values():
        other = aim(rig, Target(height=0.2), vary='library', materials={material.name: material})
        assert other.amplitude >= found.amplitude * (1.0 - 1e-6)
    assert found.layer
    assert found.layer in found.why


def test_flight_goes_on_after_the_projectile_was_caught_again():
    rig = Rig(engine=Engine(frequency=31.1), layer=Layer(thickness=2e-3))
    throw = simulate(rig)
    flight = fly(rig)
    assert throw.recontacts > 0
    assert flight.speed == pytest.approx(throw.last_release.velocity, rel=EXACT)
    assert flight.height == pytest.approx(rise(throw), rel=EXACT)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({}, 'either a height or a speed must be given as target, got neither'),
        ({'height': 1.0, 'speed': 1.0}, 'got both'),
        ({'height': 0.0}, r'height must be finite and positive, got 0\.0'),
        ({'speed': math.nan}, 'speed must be finite, got nan'),
    ],
)
def test_bad_targets_are_refused_with_the_value(arguments, message):
    with pytest.raises(ValueError, match=message):
        Target(**arguments)


@pytest.mark.parametrize(
    ('rig', 'arguments', 'message'),
    [
        (Rig(), {'vary': 'mass'}, "vary must be one of amplitude, .*library, got 'mass'"),
        (Rig(), {'max_amplitude': 0.0}, r'max_amplitude must be finite and positive, got 0\.0'),
        (Rig(gravity=0.0), {}, 'a height needs gravity, got gravity 0'),
        (Rig(layer=GradedLayer.stack(Layer(), Layer(wave_speed=20.0))), {},
         r'only layers of one material are aimed with, got GradedLayer\('),
        (Rig(), {'vary': 'library'}, r'nothing is thrown within the limits, let alone 1 m high'),
    ],
)  # fmt: skip
def test_bad_requests_are_refused_with_the_value(rig, arguments, message):
    with pytest.raises(ValueError, match=message):
        aim(rig, Target(height=1.0), **arguments)


def test_values_are_what_is_one_value():
    found = aim(Rig(), Target(height=0.1))
    values = found.values()
    assert values['amplitude'] == found.amplitude
    assert values['target_height'] == 0.1
    assert 'target_speed' not in values
    assert all(isinstance(value, (bool, float, str)) for value in values.values())
