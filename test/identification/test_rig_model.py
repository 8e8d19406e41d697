# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The model of a fit."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    FitDescription,
    FREE,
    IDEAL_BENCH,
    PARAMETERS,
    Treatment,
)

TREATMENTS = {
    'engine.amplitude': FREE._replace(is_per_throw=True),
    'layer.thickness': Treatment(True, error=1e-4),
    'projectile.mass': Treatment(True, error=0.02, is_relative=True),
    'projectile.delay': Treatment(True, error=1e-4),
    'plate.drift': Treatment(True, error=0.02, is_per_throw=True),
}
DELAY = 'projectile.delay'


@pytest.fixture(scope='module')
def throws(make_throw):
    options = {'rate': 1000.0, 'duration': 0.05}
    first, second = (make_throw(Rig(), start=start, **options) for start in (0.0102, 0.0113))
    return [replace(first, name='a'), replace(second, name='b')]


@pytest.fixture(scope='module')
def model(make_model, throws):
    description = FitDescription({**IDEAL_BENCH, **TREATMENTS})
    return make_model(Rig(), throws, description)


def changed(model, changes):
    """Return start values with some of them changed, by their names."""
    values = model.start()
    for name, change in changes.items():
        values[model.layout.names.index(name)] += change
    return values


def test_derivatives_agree_with_differences_of_predictions(model):
    values = changed(model, {DELAY: 3e-5, 'plate.drift[1]': 0.01})
    jacobian = model.jacobian(values)
    assert jacobian.shape == (model.predict(values).size, len(model.layout.names))
    for index, name in enumerate(model.layout.names):
        step = np.zeros_like(values)
        step[index] = 1e-5 if name.startswith(('start', DELAY)) else 1e-3
        if name.partition('[')[0] in PARAMETERS:
            step[index] *= values[index]
        slope = (model.predict(values + step) - model.predict(values - step)) / (2 * step[index])
        assert np.linalg.norm(slope) > 0.0
        deviation = np.linalg.norm(jacobian[:, index] - slope)
        assert deviation < 0.02 * np.linalg.norm(slope), name
