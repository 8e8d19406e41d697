# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Preparations for a throw, for both models."""

from __future__ import annotations

import numpy as np
import pytest
from soft_throw_ros.configuration import rig_of
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.twin.prepared_rig import prepare
from twin_runs import complete_settings, stroke


@pytest.mark.parametrize(
    'request_',
    [{}, {'layer__loss_tangent': 0.05}, {'layer__stress_strain_law': 'neo_hookean'}],
    ids=' '.join,
)
def test_throw_field_and_energies_agree_with_the_throw(request_) -> None:
    values = complete_settings(**request_)
    prepared = prepare(values)
    field, stepper, throw = prepared.throw_field, prepared.stepper, simulate(rig_of(values))
    spacing = prepared.rig.layer.thickness / 63
    for row in (0, 77, 199):
        stepper.reset()
        stepper.advance_to(field.times[row])
        layer = stepper.read_layer()
        rise = 0.5 * (field.strain[row, 1:] + field.strain[row, :-1])
        np.testing.assert_allclose(np.diff(layer[0]) / spacing - 1.0, rise, atol=2e-3)
    time, work, projectile, layer, total = field.energies.T
    assert (time[0], work[0]) == (0.0, 0.0)
    np.testing.assert_allclose([projectile[0], total[0]], 0.0, atol=1e-9)
    np.testing.assert_allclose(projectile + layer, total, rtol=1e-12, atol=1e-15)
    assert time[-1] < throw.ejection_time < time[-1] + 1.01 * time[1]
    assert work[-1] == pytest.approx(throw.plate_work, rel=0.05)
    assert total[-1] == pytest.approx(throw.plate_work - throw.heat, rel=0.05)
    if throw.heat == 0.0:
        np.testing.assert_allclose(total, work, atol=1e-3 * work.max())


def test_window_too_long_for_the_plate_is_refused_with_both_values() -> None:
    values = complete_settings(engine__motion='measured', measured__smoothing_window=4e-3)
    with pytest.raises(ValueError, match=r'0\.003165.* 0\.004'):
        prepare(values)
    prepare({**values, 'engine.motion': 'underdamped'})


def test_rate_too_high_for_a_measured_throw_is_refused_with_a_lower_rate() -> None:
    request = {'layer__thickness': 1e-3, 'layer__wave_speed': 100.0, 'rate__state': 5000.0}
    values = complete_settings(engine__motion='measured', **request)
    with pytest.raises(ValueError, match='5000 Hz') as error:
        prepare(values)
    feasible = float(str(error.value).rpartition('rate.state of ')[2].split()[0])
    assert 1000.0 < feasible < 5000.0
    prepare({**values, 'rate.state': feasible})
    prepare({**values, 'engine.motion': 'underdamped'})


@pytest.mark.parametrize(
    ('text', 'request_', 'word'),
    [
        (stroke(acceleration=1e-3), {}, 'first .* 0.001 m/s2'),
        (stroke(3, velocity=1e-6), {}, 'last .* 1e-06 m/s'),
        (stroke(3, acceleration=-5.0), {}, 'last .* -5 m/s2'),
        (stroke(3, z=1e-6), {}, 'last height is 1e-06 m'),
        (stroke(3, t=0.81), {}, '0.8 s.* 0.81 s'),
        (stroke(), {'throw__period': 0.058}, '0.0435 s.* 0.045 s'),
        (stroke(), {'time_scale': 0.5}, '0.5'),
        (stroke(), {'engine__motion': 'measured'}, "'measured'"),
        (stroke(), {'engine__motion': 'harmonic'}, "'harmonic'"),
    ],
)
def test_motion_that_no_controller_may_play_is_not_commanded(write, text, request_, word) -> None:
    path = write(text, 'plate.csv')
    values = complete_settings(engine__motion_file=str(path), **request_)
    prepare(values)
    with pytest.raises(ValueError, match=f'engine.command needs .*{word}'):
        prepare({**values, 'engine.command': True})
