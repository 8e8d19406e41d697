# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Optimal motions of the plate."""

from dataclasses import replace
import math

import numpy as np
import pytest
from soft_throw_ros.core.batch import SearchCancelledError, ThrowUnresolvedError
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate, throw_many
from soft_throw_ros.design.motion import design_motion, PlateLimits
from soft_throw_ros.design.prediction import Uncertainties
from soft_throw_ros.design.score import Limits

ENGINE, TIGHT = PlateLimits.of(Engine()), Limits(max_strain=1e-4)
KNOWN = [
    (0.278, 0.0, 5.85), (0.46, 0.25, 5.65), (0.60, 0.5, 5.35), (1.08, 1.5, 4.31),
    pytest.param(1.96, 2.0, 3.99, marks=pytest.mark.slow),
]
"""Mass ratio, crossings until the largest speed, and the largest known energy transfer."""


def unit_rig(mass_ratio):
    """Return a rig without gravity and loss whose layer defines the units."""
    return Rig(
        engine=Engine(frequency=0.2, amplitude=1.0, damping_ratio=0.0),
        layer=Layer(thickness=1.0, wave_speed=1.0, density=1.0, diameter=2.0 / math.sqrt(math.pi)),
        projectile=Projectile(mass=mass_ratio),
        gravity=0.0,
    )


def best_throw(rig, plate, **options):
    """Return the throw of the best motion, whose every limit it checks."""
    throw = simulate(design_motion(rig, plate, **options).rig)
    motion = throw.rig.engine.motion
    times = np.linspace(0.0, motion.end_time, 20001)
    assert np.abs(motion.velocity(times)).max() < plate.speed * (1.0 + 1e-9)
    assert np.abs(motion.states[:, 2]).max() < plate.acceleration * (1.0 + 1e-9)
    assert np.ptp(motion.position(times)) < plate.travel * (1.0 + 1e-9)
    assert len(throw.ejections) == 1
    return throw


@pytest.mark.parametrize(('mass_ratio', 'rise', 'alpha'), KNOWN)
def test_best_motion_agrees_with_the_known_optimum(mass_ratio, rise, alpha):
    limits = PlateLimits(speed=1.0, acceleration=1.0 / rise if rise else math.inf)
    throw = best_throw(unit_rig(mass_ratio), limits)
    assert throw.ejection_speed**2 == pytest.approx(alpha, rel=5e-3)


@pytest.mark.parametrize(
    'layer', [Layer(), pytest.param(Layer(loss_tangent=0.05), marks=pytest.mark.slow)]
)
def test_best_motion_beats_the_present_one_within_its_limits(layer):
    rig = Rig(layer=layer)
    throw = best_throw(rig, ENGINE)
    assert throw.ejection_speed > simulate(rig).ejection_speed
    np.testing.assert_array_equal(throw.rig.engine.motion.states[-1, 1:], 0.0)


GEL = Layer(stress_strain_law='neo_hookean', loss='constant', loss_tangent=0.1)
STACK = Layer.of_sheets((Layer(wave_speed=19.0, density=1350.0), Layer(thickness=4e-3)))


@pytest.mark.parametrize('layer', [GEL, STACK])
def test_reported_speeds_hold_for_the_stress_strain_law_of_the_layer(layer):
    design = design_motion(Rig(layer=layer, gravity=0.0))
    real = simulate(design.rig)
    assert design.rig.layer == layer
    assert design.ejection_speed == pytest.approx(real.ejection_speed, rel=1e-4)
    assert design.ejection_speed > design.now.ejection_speed * 1.01
    assert len(real.ejections) == 1
    assert replace(design, now=design).summary.startswith('keep your motion')


def test_limit_of_a_load_costs_speed():
    rig = Rig(gravity=0.0)
    free = best_throw(rig, ENGINE)
    loads = Limits(max_acceleration=0.8 * free.loads.acceleration)
    gentle = best_throw(rig, ENGINE, limits=loads)
    assert gentle.loads.acceleration <= 1.002 * loads.max_acceleration
    assert gentle.ejection_speed < free.ejection_speed


@pytest.mark.slow
def test_strain_is_limited_everywhere_at_the_least_cost_in_speed():
    """A programme with the strain at five heights and 7 % less travel gives 1.529 m/s."""
    throw = best_throw(Rig(), ENGINE, limits=Limits(max_strain=0.12))
    assert throw.ejection_speed > 1.529
    assert throw.loads.strain <= 0.12 * (1.0 + 2e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('engine', 'layer', 'mass'),
    [
        ((77.506, 2.7944e-3), (20.738e-3, 8.0269), 1.2504e-3),
        # three crossings before the release, the projectile hardly presses on the fastest layer
        ((62.8425, 2.1031e-3), (20.0169e-3, 6.53965), 0.748978e-3),
        # also with a pushing force at all knots
        ((56.0344, 2.84285e-3), (6.7818e-3, 11.5281), 0.437628e-3),
    ],
)
def test_best_motion_keeps_contact_within_the_uncertainties(engine, layer, mass):
    """Without the errors in mind, a wave that is 2 % faster throws with a sixth of the speed."""
    frequency, amplitude = engine
    thickness, wave_speed = layer
    rig = Rig(
        engine=Engine(frequency=frequency, amplitude=amplitude),
        layer=Layer(thickness=thickness, wave_speed=wave_speed), projectile=Projectile(mass=mass),
    )
    error = 0.02 * wave_speed
    design = design_motion(rig, uncertainties=Uncertainties(wave_speed=error))
    assert design.worst.ejection_speed > 0.93 * design.ejection_speed
    for factor in (0.98, 0.99, 1.0, 1.01, 1.02):
        layer = replace(rig.layer, wave_speed=factor * rig.layer.wave_speed)
        throw = simulate(replace(design.rig, layer=layer))
        assert throw.ejection_speed > 0.93 * design.ejection_speed


def test_worst_speed_is_that_of_the_thinnest_or_the_thickest_layer():
    errors = Uncertainties(
        wave_speed=0.0, thickness=0.02, mass=0.0, frequency=0.0, damping_ratio=0.0
    )
    design = design_motion(unit_rig(0.6), PlateLimits(speed=1.0), uncertainties=errors)
    speeds = throw_many(design.rig, {'thickness': np.array([0.98, 1.0, 1.02])}).ejection_speed
    assert design.worst.ejection_speed == pytest.approx(speeds.min(), rel=1e-9)


@pytest.mark.parametrize(
    ('call', 'error', 'message'),
    [
        (lambda: PlateLimits(speed=1.0, travel=-1.0), ValueError, 'travel .* got -1'),
        (lambda: design_motion(Rig(), cancelled=lambda: True), SearchCancelledError, 'cancelled'),
        # the weight alone exceeds the strain limit
        (lambda: design_motion(Rig(), limits=TIGHT), ThrowUnresolvedError, 'no motion'),
    ],
)
def test_impossible_requests_are_refused(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_present_rig_that_does_not_throw_is_no_number():
    rig, still = unit_rig(0.278), SampledMotion(np.array([0.0, 1.0]), np.zeros((2, 3)))
    rig = replace(rig, engine=replace(rig.engine, motion=still))
    design = design_motion(rig, PlateLimits(speed=1.0))
    assert design.now is None
