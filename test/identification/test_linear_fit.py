# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A fit as a linear problem."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    DEFAULTS,
    FitDescription,
    FREE,
    IDEAL_BENCH,
)
from soft_throw_ros.identification.linear_fit import LinearFit, profile_intervals

IDEAL = FitDescription(IDEAL_BENCH)
WITH_THICKNESS = FitDescription({**IDEAL_BENCH, 'layer.thickness': DEFAULTS['layer.thickness']})
SPEED = 'layer.wave_speed'


@pytest.fixture(scope='module')
def throw(make_throw):
    return make_throw(Rig(), rate=2000.0, duration=0.08)


def fitted(model):
    return model, model.fit(model.start())


def test_gain_of_a_further_parameter_is_the_fall_of_chi_squared_of_a_refit(make_model, throw):
    drifting = throw.plate.position + 5e-5 * throw.plate.time / throw.plate.duration
    drifting = replace(throw, plate=replace(throw.plate, position=drifting))
    model, fit = fitted(make_model(Rig(), [drifting], IDEAL))
    wider = replace(model, description=IDEAL.change({'plate.drift': FREE}))
    start = wider.start(fit)
    refit = wider.fit(start, noise=fit.noise)
    column = wider.jacobian(start)[:, wider.layout.indices_of('plate.drift')]
    gain, size = LinearFit(model, fit).gain(column)
    assert gain > 20.0
    assert gain == pytest.approx(fit.chi2 - refit.chi2, rel=0.01)
    assert np.sign(size) == np.sign(refit['plate.drift'].value)
    # The part that the fitted parameters explain gains nothing more
    explained = 1e-3 * model.jacobian(fit.values)[:, model.layout.indices_of(SPEED)]
    assert LinearFit(model, fit).gain(column + explained)[0] == pytest.approx(gain)


def test_adapt_gives_chi_squared_of_a_fit_of_the_others(make_model, throw):
    model, fit = fitted(make_model(Rig(), [throw], WITH_THICKNESS))
    index = model.layout.indices[SPEED][0]
    moved = fit.values.copy()
    moved[index] += 2.0 * fit.errors[index]
    values, chi2 = LinearFit(model, fit, [index]).adapt(moved)
    others = [name for name, _ in model.layout.groups if name != SPEED]
    exact = model.fit(moved, noise=fit.noise, only=others)
    assert values[index] == moved[index]
    assert exact.chi2 - fit.chi2 == pytest.approx(4.0, rel=0.2)
    assert chi2 == pytest.approx(exact.chi2, abs=0.2)
    shift = np.delete(values, index) - exact.values
    assert np.abs(shift / np.delete(fit.errors, index)).max() < 0.1


def test_profile_of_a_nearly_linear_parameter_is_1_96_errors_wide(make_model, make_throw):
    # So little noise that the bent valley of thickness and wave speed is straight
    throw = make_throw(Rig(), rate=2000.0, duration=0.08, noise=1e-6)
    description = FitDescription({**IDEAL_BENCH, 'layer.thickness': FREE})
    model, fit = fitted(make_model(Rig(), [throw], description))
    intervals = profile_intervals(model, fit)
    assert set(intervals) == {SPEED, 'layer.thickness'}
    for name, (low, high) in intervals.items():
        value, error = fit[name]
        assert (low - value) / error == pytest.approx(-1.96, rel=0.05)
        assert (high - value) / error == pytest.approx(1.96, rel=0.05)
