# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The choice of further parameters of a fit."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import FitDescription, FREE, IDEAL_BENCH
from soft_throw_ros.identification.model_choice import predicted_gain

IDEAL = FitDescription(IDEAL_BENCH)
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
    gain, size = predicted_gain(model, fit, column)
    assert gain > 20.0
    assert gain == pytest.approx(fit.chi2 - refit.chi2, rel=0.01)
    assert np.sign(size) == np.sign(refit['plate.drift'].value)
    # The part that the fitted parameters explain gains nothing more
    explained = 1e-3 * model.jacobian(fit.values)[:, model.layout.indices_of(SPEED)]
    assert predicted_gain(model, fit, column + explained)[0] == pytest.approx(gain)
