# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Uncertainties of predictions."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.batch import SearchCancelledError, ThrowUnresolvedError
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.core.throw import rig_with, throw_many
from soft_throw_ros.design.prediction import (
    changes_of,
    COVERAGE,
    predict,
    prediction_uncertainty,
    Uncertainties,
)

NONE = Uncertainties(wave_speed=0.0, thickness=0.0, mass=0.0, frequency=0.0, damping_ratio=0.0)
NAMES = ('ejection_time', 'ejection_speed', 'energy_transfer')


def off(rig, **errors):
    """Return a rig with errors of its values; the error of the mass is relative."""
    values = {**vars(rig.engine), **vars(rig.layer), 'mass': rig.projectile.mass}
    errors['mass'] = rig.projectile.mass * errors.get('mass', 0.0)
    return rig_with(rig, {name: values[name] + error for name, error in errors.items()})


@pytest.mark.parametrize(
    ('loss_tangent', 'gravity', 'error'),
    [(0.0, 0.0, 1e-12), (0.0, 9.81, 1e-9), (0.05, 9.81, 2e-3)],
)
def test_zero_uncertainty_leaves_the_prediction_unchanged(loss_tangent, gravity, error):
    rig = Rig(layer=Layer(loss_tangent=loss_tangent), gravity=gravity)
    prediction, known = prediction_uncertainty(rig, NONE), predict(rig)
    assert not prediction.jumps
    assert prediction.stuck_fraction == 0.0
    for name in NAMES:
        interval = getattr(prediction, name)
        assert interval.low == interval.high == pytest.approx(getattr(known, name), rel=error)


@pytest.mark.parametrize(
    ('name', 'value'),
    [('wave_speed', 0.01), ('thickness', 1e-5), ('mass', 1e-3), ('frequency', 0.01),
     ('damping_ratio', 1e-3)],
)
def test_small_uncertainty_of_one_value_agrees_with_the_derivative(name, value):
    rig = Rig(gravity=0.0)
    prediction = prediction_uncertainty(rig, replace(NONE, **{name: value}))
    ends = [predict(off(rig, **{name: sign * COVERAGE * value})) for sign in (-1.0, 1.0)]
    for result in NAMES:
        low, high = sorted(getattr(end, result) for end in ends)
        assert getattr(prediction, result) == pytest.approx((low, high), abs=0.01 * (high - low))


def test_damping_within_the_uncertainties_is_not_negative():
    rig = Rig(engine=Engine(damping_ratio=0.0))
    low, high = prediction_uncertainty(rig).energy_transfer
    assert low < predict(rig).energy_transfer < high


def test_interval_has_its_nominal_share_of_random_throws():
    rig, uncertainties = Rig(), Uncertainties()
    prediction = prediction_uncertainty(rig, uncertainties)
    errors = np.random.default_rng(0).uniform(-1.0, 1.0, (2000, 5))
    variants = uncertainties.variants(rig, errors)
    throws = throw_many(rig, changes_of(variants, rig.layer.thickness, rig.layer.wave_speed))
    for name in NAMES:
        (low, high), values = getattr(prediction, name), getattr(throws, name)
        assert np.mean((low <= values) & (values <= high)) == pytest.approx(COVERAGE, abs=0.03)


def test_jump_within_the_uncertainties_is_seen_on_both_sides():
    """The release jumps from before three crossings to after them."""
    rig = Rig(layer=Layer(thickness=6.5e-3), gravity=0.0)

    thicknesses = np.linspace(1e-3, 30e-3, 2000)
    times = throw_many(rig, {'thickness': thicknesses}).ejection_time
    edge = int(np.argmax(np.abs(np.diff(times))))
    jump = abs(times[edge + 1] - times[edge])
    assert jump > 1e-4
    rig = replace(rig, layer=replace(rig.layer, thickness=float(thicknesses[edge])))
    prediction = prediction_uncertainty(rig, replace(NONE, thickness=2e-5))
    assert prediction.jumps
    assert prediction.ejection_time.high - prediction.ejection_time.low > 0.9 * jump
    assert str(prediction).endswith(', with a jump between')
    away = replace(rig, layer=replace(rig.layer, thickness=0.95 * rig.layer.thickness))
    assert not prediction_uncertainty(away, replace(NONE, thickness=2e-5)).jumps


def test_share_held_by_gravity_is_counted():
    rig = Rig(engine=Engine(frequency=9.0))
    prediction = prediction_uncertainty(rig, replace(NONE, frequency=6.0))
    assert 0.0 < prediction.stuck_fraction < 1.0
    assert 'no release in' in str(prediction)
    with pytest.raises(ThrowUnresolvedError, match='does not leave within the uncertainties'):
        prediction_uncertainty(Rig(engine=Engine(frequency=3.0)), NONE)


def test_uncertainty_ends_when_cancelled():
    with pytest.raises(SearchCancelledError):
        prediction_uncertainty(Rig(), cancelled=lambda: True)
