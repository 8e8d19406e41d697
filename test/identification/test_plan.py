# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Planned errors, compared with those of fits of simulated throws."""

from dataclasses import replace
import itertools
import re

import numpy as np
import pytest
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.identification.ejection import ejection_of
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    FitDescription,
    FIXED,
    FREE,
    IDEAL_BENCH,
    LAYER,
    parse_treatments,
    ThrowConditions,
    values_of,
)
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plan import (
    Condition,
    MeasurementSetup,
    ParameterInformation,
    Planner,
)
from soft_throw_ros.identification.rig_fit import fit_rig

RIG = Rig(
    engine=Engine(frequency=63.2, damping_ratio=0.064, amplitude=1.2e-3),
    layer=Layer(thickness=16.8e-3, wave_speed=7.8),
    projectile=Projectile(mass=1.2e-3),
)
SETUP = MeasurementSetup(rate=5000.0, noise=2e-5, duration=0.03)
THICKNESS_FREE = FitDescription({**IDEAL_BENCH, 'layer.thickness': FREE})
LIGHT, USUAL, HEAVY, SMALL = (
    Condition(mass, 16.8e-3, amplitude)
    for mass, amplitude in ((0.6e-3, 1.2e-3), (1.2e-3, 1.2e-3), (2.4e-3, 1.2e-3), (2.4e-3, 6e-4))
)


def test_planned_errors_agree_with_fits_of_throws_of_two_masses(make_throw):
    planner = Planner(RIG, (HEAVY, LIGHT), SETUP, THICKNESS_FREE)
    amplitude = {'engine.amplitude': FREE._replace(is_per_throw=True)}
    before = 0.25 / RIG.engine.frequency
    throws, masses, known, errors = [], {}, planner.start(), []
    for number, condition in enumerate(planner.conditions):
        rig, name = changed_rig(RIG, condition.values()), str(number)
        throw = make_throw(rig, start=before, duration=SETUP.duration + before, seed=number)
        throws.append(replace(throw, name=name))
        mass = {'projectile.mass': FIXED._replace(value=condition.mass)}
        masses[name] = ThrowConditions(mass, {})
        description = replace(THICKNESS_FREE.change(amplitude), throws=masses)
        fit = fit_rig(throws, RIG, description).fit
        known = known.after(planner.information[number])
        for parameter, truth in values_of(RIG, LAYER[:2]).items():
            assert fit[parameter].value == pytest.approx(truth, abs=4.0 * fit[parameter].error)
            assert known.errors()[parameter] == pytest.approx(fit[parameter].error, rel=0.15)
        errors.append(fit['layer.thickness'].error)
    assert errors[1] < 0.5 * errors[0]


def test_planned_errors_agree_with_a_fit(make_throw):
    setup = MeasurementSetup(rate=5000.0, noise=2e-5, duration=0.0475)
    planner = Planner(RIG, (USUAL,), setup, FitDescription())
    (planned,) = planner.rank(planner.start())
    throw = make_throw(RIG, start=0.25 / 63.2, duration=setup.duration + 0.25 / 63.2)
    fit = fit_rig([throw], RIG)
    alpha = ejection_of(fit).energy_transfer
    assert planned.energy_transfer_error == pytest.approx(alpha.error / alpha.value, rel=0.25)
    # both hold the loss unless the tracks show it
    expected = {name: fit.estimate(name).error for name in planned.errors if name in LAYER}
    assert expected == pytest.approx({name: planned.errors[name] for name in expected}, rel=0.1)
    assert 'layer.loss_tangent' not in planned.errors


def test_plan_after_a_throw_begins_with_the_errors_of_its_fit(make_throw):
    fit = fit_rig([make_throw(RIG, rate=2500.0, duration=0.06)], RIG)
    planner = Planner(RIG, (USUAL,), SETUP, FitDescription(), ParameterInformation.of_fit(fit))
    errors = planner.start().errors()
    for name in ('layer.wave_speed', 'layer.thickness', 'layer.stiffening', 'engine.frequency'):
        assert errors[name] == pytest.approx(fit.fit[name].error, rel=1e-6)


def test_best_throw_is_the_largest_one_and_errors_fall_with_every_throw():
    planner = Planner(RIG, (SMALL, LIGHT, USUAL, HEAVY), SETUP, THICKNESS_FREE)
    chosen = list(itertools.islice(planner.choose(planner.start()), 6))
    assert chosen[0].condition == HEAVY == planner.rank(planner.start())[0].condition
    errors = [[each.errors['layer.wave_speed'], each.energy_transfer_error] for each in chosen]
    assert (np.diff(errors, axis=0) < 0.0).all()
    assert errors[-1][1] < 0.01


def test_earlier_measurements_count_like_a_throw():
    planner = Planner(RIG, (HEAVY,), SETUP, THICKNESS_FREE)
    (first,) = planner.rank(planner.start())
    after = planner.start().after(planner.information[0])
    again = Planner(RIG, (HEAVY,), SETUP, THICKNESS_FREE, after)
    assert again.start().errors()['layer.wave_speed'] == pytest.approx(
        first.errors['layer.wave_speed'], rel=0.01
    )


def test_mass_uncertainty_limits_wave_speed_and_thickness_of_many_throws():
    # Throws show t_s and tau alone, so that c_s and L_s are known no better than the mass
    known = parse_treatments({'layer.thickness': 'free', 'projectile.mass': '+- 5 %'})
    fit = FitDescription({**IDEAL_BENCH, **known})
    planner = Planner(RIG, (USUAL,), SETUP, fit)
    left = planner.start().after(1e6 * planner.information[0]).errors()
    assert left['layer.wave_speed'] / 7.8 == pytest.approx(0.05, rel=0.01)
    assert left['layer.thickness'] / 16.8e-3 == pytest.approx(0.05, rel=0.01)


def test_layers_of_one_material_share_its_wave_speed_but_not_their_thickness():
    thin = Condition(1.2e-3, 8e-3, 1.2e-3)
    planner = Planner(RIG, (thin, USUAL), SETUP, THICKNESS_FREE)
    assert set(planner.names) >= {'layer.wave_speed', 'layer.thickness', 'layer.thickness[0.008]'}
    errors = {each.condition: each.errors for each in planner.rank(planner.start())}
    assert errors[thin]['layer.thickness'] == pytest.approx(16.8e-3, rel=0.01)  # as before
    assert errors[USUAL]['layer.thickness'] < 2e-3
    assert errors[thin]['layer.thickness[0.008]'] < 1e-3


def test_bench_uncertainties_are_in_the_planned_errors():
    sure, doubtful = (
        Planner(RIG, (USUAL,), SETUP, fit)
        for fit in (FitDescription(IDEAL_BENCH), FitDescription())
    )
    errors = [next(each.choose(each.start())) for each in (sure, doubtful)]
    assert errors[1].errors['layer.wave_speed'] > 3.0 * errors[0].errors['layer.wave_speed']
    assert errors[1].energy_transfer_error > 2.0 * errors[0].energy_transfer_error


def test_empty_plan_is_refused():
    with pytest.raises(FitError, match='no throw to choose'):
        Planner(RIG, (), SETUP, THICKNESS_FREE)
    with pytest.raises(FitError, match=r'one of layer\.wave_speed, '):
        Planner(RIG, (USUAL,), SETUP, FitDescription({**IDEAL_BENCH, 'layer.wave_speed': FIXED}))
    with pytest.raises(FitError, match=re.escape('-0.001')):
        Planner(RIG, (Condition(-1e-3, 0.01, 1e-3),), SETUP, THICKNESS_FREE).start()
    with pytest.raises(ValueError, match=r'rate must be .*, got 0'):
        MeasurementSetup(rate=0.0)
