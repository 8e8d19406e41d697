# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Aiming, compared with simulations of the results."""

import math

import numpy as np
import pytest
from soft_throw_ros.core.batch import ThrowUnresolvedError
from soft_throw_ros.core.material import LARGEST_STRAIN
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import rig_with, simulate
from soft_throw_ros.design.aiming import aim
from soft_throw_ros.design.score import Limits


@pytest.mark.parametrize(
    ('goal', 'between', 'gravity', 'seeds'),
    [('height', (0.02, 0.15), 9.81, 4), ('speed', (0.5, 1.5), 9.81, 2),
     ('speed', (0.5, 1.5), 0.0, 2)],
)
def test_amplitude_for_a_target_reaches_it_when_simulated(goal, between, gravity, seeds):
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        frequency, damping_ratio = random.uniform(50.0, 150.0), random.choice([0.0, 0.064, 0.3])
        engine = Engine(frequency=frequency, damping_ratio=float(damping_ratio))
        layer = Layer(thickness=random.uniform(0.01, 0.03), wave_speed=random.uniform(8.0, 15.0))
        projectile = Projectile(mass=random.uniform(3e-4, 4e-3))
        rig = Rig(engine=engine, layer=layer, projectile=projectile, gravity=gravity)
        value = random.uniform(*between)
        aimed = aim(rig, **{goal: value})
        throw = simulate(rig_with(rig, {'amplitude': aimed.amplitude}))
        height = math.inf if gravity == 0.0 else throw.apex_height - rig.rest_height
        assert aimed.rig == throw.rig
        assert getattr(aimed, goal) == pytest.approx(value, rel=1e-6)
        assert aimed.height == pytest.approx(height, rel=1e-4)
        assert aimed.speed == pytest.approx(throw.last_release.velocity, rel=1e-4)


def test_amplitude_is_the_smallest_even_where_later_swings_throw():
    """Under strong gravity, the height is a discontinuous function of the amplitude."""
    rig = Rig(engine=Engine(frequency=15.0))
    aimed = aim(rig, height=0.03)
    assert aimed.height == pytest.approx(0.03, rel=1e-6)
    for amplitude in np.geomspace(1e-4, 0.999 * aimed.amplitude, 40):
        try:
            flight = simulate(rig_with(rig, {'amplitude': float(amplitude)}))
        except ThrowUnresolvedError:
            continue
        assert flight.flight_height < 0.03


@pytest.mark.parametrize(
    ('rig', 'target', 'limits', 'message'),
    [
        (Rig(), {}, {}, 'height None, speed None'),
        (Rig(), {'height': 0.0}, {}, r'target .* got 0\.0'),
        (Rig(gravity=0.0), {'height': 1.0}, {}, 'got gravity 0'),
        (Rig(), {'height': 0.2}, {'max_strain': 0.12}, r'0\.2 m .* strain of 0\.\d+, .* 0.12'),
        (Rig(), {'height': 0.2}, {'max_acceleration': 300.0}, 'acceleration of .* most 300'),
        (Rig(), {'speed': 25.0}, {}, f'strain of .* at most {LARGEST_STRAIN}'),
        (Rig(engine=Engine(frequency=3.0)), {'speed': 9.0}, {}, 'up to 0.1 m reaches 9 m/s'),
    ],
)
def test_impossible_request_is_refused_with_the_value(rig, target, limits, message):
    with pytest.raises(ValueError, match=message):
        aim(rig, **target, limits=Limits(**limits))


@pytest.mark.parametrize(
    'layer',
    [
        Layer(loss_tangent=0.1),
        Layer(stress_strain_law='neo_hookean'),
        Layer.of_sheets((Layer(wave_speed=19.0, density=1350.0), Layer(thickness=4e-3))),
    ],
)
def test_aim_with_any_layer_counts_its_last_release(layer):
    rig = Rig(layer=layer)
    throw = simulate(aim(rig, height=0.1).rig)
    assert throw.apex_height - rig.rest_height == pytest.approx(0.1, rel=2e-3)
