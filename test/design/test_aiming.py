# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Aiming, compared with simulations of the results."""

from dataclasses import replace
import math

import numpy as np
import pytest
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.material import LARGEST_STRAIN
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.throws import last_release, rig_with
from soft_throw_ros.design.aiming import aim, Target
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.prediction import predict

MATERIALS = library().materials
EXACT = 1e-4


def some_rig(random):
    """Draw a rig whose throws take few crossings of its waves, to save computing time."""
    return Rig(
        engine=Engine(
            frequency=random.uniform(50.0, 150.0),
            damping_ratio=float(random.choice([0.0, 0.064, 0.3])),
        ),
        layer=Layer(thickness=random.uniform(0.01, 0.03), wave_speed=random.uniform(8.0, 15.0)),
        projectile=Projectile(mass=random.uniform(3e-4, 4e-3)),
    )


def rise(throw):
    """Return the rise of a simulated throw above the resting projectile."""
    rig = throw.rig
    return throw.apex_height - rig.rest_height


@pytest.mark.parametrize(
    ('goal', 'between', 'gravity', 'seeds'),
    [
        ('height', (0.02, 0.15), 9.81, 4),
        ('speed', (0.5, 1.5), 9.81, 2),
        ('speed', (0.5, 1.5), 0.0, 2),
    ],
)
def test_amplitude_for_a_target_reaches_it_when_simulated(goal, between, gravity, seeds):
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        rig, value = replace(some_rig(random), gravity=gravity), random.uniform(*between)
        aimed = aim(rig, Target(**{goal: value}), max_amplitude=1.0)
        throw = simulate(rig_with(rig, {'amplitude': aimed.amplitude}))
        height = math.inf if gravity == 0.0 else pytest.approx(rise(throw), rel=EXACT)
        assert aimed.is_reached
        assert aimed.rig == throw.rig
        assert getattr(aimed, goal) == pytest.approx(value, rel=1e-6)
        assert aimed.height == height
        assert aimed.speed == pytest.approx(throw.last_release.velocity, rel=EXACT)


@pytest.mark.parametrize('vary', ['thickness', 'wave_speed', 'both'])
def test_layer_and_amplitude_together_need_the_least_amplitude(vary):
    rig, height = Rig(), 0.3
    aimed = aim(rig, Target(height=height), vary=vary)
    assert aimed.is_reached
    assert last_release(aimed.rig).height == pytest.approx(height, rel=1e-6)
    assert aimed.amplitude <= aim(rig, Target(height=height)).amplitude
    thicknesses = np.geomspace(1e-3, 50e-3, 12) if vary != 'wave_speed' else [0.0168]
    for thickness in thicknesses:
        for wave_speed in np.geomspace(1.0, 50.0, 12) if vary != 'thickness' else [7.8]:
            less = rig_with(rig, {
                'thickness': float(thickness), 'wave_speed': float(wave_speed),
                'amplitude': 0.999 * aimed.amplitude,
            })
            assert last_release(less).height < height


def test_amplitude_is_the_smallest_even_where_later_swings_throw():
    """Under strong gravity, the height is a discontinuous function of the amplitude."""
    rig = Rig(engine=Engine(frequency=15.0))
    aimed = aim(rig, Target(height=0.03))
    assert aimed.height == pytest.approx(0.03, rel=1e-6)
    for amplitude in np.geomspace(1e-4, 0.999 * aimed.amplitude, 40):
        try:
            flight = last_release(rig_with(rig, {'amplitude': float(amplitude)}))
        except ThrowUnresolvedError:
            continue
        assert flight.height < 0.03


@pytest.mark.parametrize('vary', ['amplitude', 'both', 'library'])
def test_limits_of_the_loads_are_kept(vary):
    few = {name: MATERIALS[name] for name in ('gelatin', 'sorbothane_30')}
    limits = Limits(max_strain=0.08, max_acceleration=900.0)
    aimed = aim(Rig(), Target(height=0.1), vary=vary, limits=limits, materials=few)
    assert aimed.peak_strain == predict(aimed.rig).peak_strain <= 0.08 * (1.0 + 1e-4)
    assert aimed.peak_acceleration <= 900.0 * (1.0 + 1e-4)
    assert aimed.is_reached == (aimed.height == pytest.approx(0.1, rel=1e-6))
    assert aimed.is_reached or vary != 'both'


def test_target_out_of_reach_gives_the_maximum_and_its_limit():
    rig, limits = Rig(), Limits(max_strain=0.15)
    aimed = aim(rig, Target(height=0.5), limits=limits)
    assert not aimed.is_reached
    assert aimed.limited_by == 'max_strain'
    assert aimed.peak_strain == pytest.approx(0.15, rel=1e-4)
    assert aim(rig, Target(height=0.5), vary='both', limits=limits).is_reached
    # a little less is within reach, and a little more is not
    less, more = (
        aim(rig, Target(height=factor * aimed.height), limits=limits) for factor in (0.999, 1.001)
    )
    assert (less.is_reached, more.is_reached) == (True, False)


@pytest.mark.parametrize('limits', [Limits(), Limits(max_strain=10.0)])
def test_layer_is_never_compressed_beyond_its_models(limits):
    assert aim(Rig(), Target(speed=4.0), limits=limits).is_reached
    aimed = aim(Rig(), Target(speed=25.0), limits=limits)
    assert not aimed.is_reached
    assert aimed.peak_strain <= LARGEST_STRAIN * (1.0 + 1e-4)
    assert aimed.limited_by == 'max_strain'


def test_library_layer_with_the_least_amplitude_is_chosen():
    few = {name: MATERIALS[name] for name in ('gelatin', 'sorbothane_30', 'ecoflex_00-30')}
    aimed = aim(Rig(), Target(height=0.2), vary='library', materials=few)
    assert aimed.is_reached
    assert aimed.layer.startswith(tuple(few))
    for name, material in few.items():
        other = aim(Rig(), Target(height=0.2), vary='library', materials={name: material})
        assert other.amplitude >= aimed.amplitude * (1.0 - 1e-6)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (Target, 'got neither'),
        (lambda: Target(height=1.0, speed=1.0), 'got both'),
        (lambda: Target(height=0.0), r'height .* got 0\.0'),
        (lambda: Target(speed=math.nan), 'speed .* got nan'),
        (lambda: aim(Rig(), Target(height=1.0), vary='mass'), "vary .* got 'mass'"),
        (lambda: aim(Rig(), Target(height=1.0), max_amplitude=0.0), r'max_amplitude .* got 0\.0'),
        (lambda: aim(Rig(gravity=0.0), Target(height=1.0)), 'got gravity 0'),
        (lambda: aim(Rig(), Target(height=1.0), vary='library'), 'no throw .* 1 m high'),
    ],
)
def test_bad_requests_are_refused_with_the_value(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_aim_with_a_lossy_layer_counts_its_last_release():
    rig = Rig(layer=Layer(loss_tangent=0.1))
    aimed = aim(rig, Target(height=0.1))
    throw = simulate(aimed.rig)
    assert rise(throw) == pytest.approx(0.1, rel=2e-3)
    assert aimed.amplitude > aim(Rig(), Target(height=0.1)).amplitude
