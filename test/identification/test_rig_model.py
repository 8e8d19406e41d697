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
from soft_throw_ros.identification.least_squares import Estimate

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


@pytest.mark.parametrize(
    ('name', 'moved'),
    [('start_time[2]', [(1, 'plate'), (1, 'projectile')]),
     (DELAY, [(0, 'projectile'), (1, 'projectile')])],
)
def test_later_start_or_delay_moves_the_tracks_in_time(model, name, moved):
    shift = 2.3e-4
    values, start = changed(model, {name: shift}), model.start()
    for throw, body, track in model.series:
        late = model.trajectory(values, throw, body, track.time)
        earlier = track.time - shift * ((throw, body) in moved)
        same = model.trajectory(start, throw, body, earlier)
        assert late.height == pytest.approx(same.height, abs=1e-9)
        now = model.trajectory(start, throw, body, track.time)
        assert np.allclose(late.height, now.height) is ((throw, body) not in moved)


def test_priors_are_those_of_the_description_for_each_value(model):
    known = {model.layout.names[index]: prior for index, prior in model.known.items()}
    rig = Rig()
    assert known == {
        'layer.thickness': Estimate(rig.layer.thickness, 1e-4),
        'projectile.mass': Estimate(rig.projectile.mass, 0.02 * rig.projectile.mass),
        DELAY: Estimate(0.0, 1e-4),
        **{f'plate.drift[{throw}]': Estimate(0.0, 0.02) for throw in (1, 2)},
    }


def test_rig_has_the_mean_amplitude(model):
    values = changed(model, {'engine.amplitude[2]': 1e-4})
    first, second, both = (model.rig_of(values, throw) for throw in (0, 1, None))
    amplitudes = [rig.engine.amplitude for rig in (first, second)]
    assert amplitudes[1] > amplitudes[0] + 5e-5
    assert both.engine.amplitude == pytest.approx(np.mean(amplitudes))


def test_cut_leaves_out_late_samples_of_projectiles_alone(model, throws):
    cut = model.cut_after(0.02)
    for throw, before, plate in zip(cut.throws, throws, model.plates, strict=True):
        end = plate.start_time + 0.02
        assert np.array_equal(throw.plate.time, before.plate.time)
        kept = before.projectile.time[before.projectile.time <= end]
        assert np.array_equal(throw.projectile.time, kept)
    assert model.cut_after(-1.0).projectiles == []
