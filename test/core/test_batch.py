# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Properties of throws in batches, for every method of computation."""

from functools import partial
import math

import numpy as np
import pytest
from soft_throw_ros.core import cell_stepper, wave_stepper
from soft_throw_ros.core.cell_stepper import MAX_CELLS
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.rig import Layer, Ratios


def by_closed_form(ratios, **options):
    return first_releases(**ratios.lossless, **options)


BY_CELLS = partial(cell_stepper.throw_batch, layer=Layer())
each_method = pytest.mark.parametrize(
    'throw', [by_closed_form, wave_stepper.throw_batch, partial(BY_CELLS, cells=16)]
)


@pytest.mark.parametrize(
    ('throw', 'count', 'others'),
    [
        (by_closed_form, 3 * 2048, {}),
        (wave_stepper.throw_batch, 3 * 64, {}),
        (BY_CELLS, 60, {'loss_tangent': 0.1}),
    ],
)
def test_no_bit_of_a_throw_depends_on_threads_or_on_other_throws(throw, count, others):
    random = np.random.default_rng(2)
    cases = {
        'mass_ratio': np.exp(random.uniform(-2.0, 2.0, count)),
        'speed_ratio': np.exp(random.uniform(0.0, 4.0, count)),
        'damping_ratio': random.uniform(0.0, 0.3, count),
        'gravity_ratio': random.uniform(0.0, 0.02, count),
    }
    together = throw(Ratios(**cases, **others), threads=1)
    shared = throw(Ratios(**cases, **others), threads=3)
    assert np.array(together).tobytes() == np.array(shared).tobytes()
    for i in range(0, count, count // 6):
        alone = throw(Ratios(**{name: values[i] for name, values in cases.items()}, **others))
        assert np.ravel(alone).tolist() == np.array(together)[:, i].tolist()


@each_method
def test_ratios_are_broadcast(throw):
    throws = throw(Ratios([[0.5], [1.0]], [5.0, 8.0, 12.0], 0.1))
    assert all(values.size == 6 for values in throws)
    single = throw(Ratios(1.0, 8.0, 0.1))
    assert throws[2].flat[4] == pytest.approx(single[2].item(), rel=1e-14)
    assert throw(Ratios([], []))[0].shape == (0,)
    with pytest.raises(ValueError, match='shape'):
        throw(Ratios([1.0, 2.0], [1.0, 2.0, 3.0]))


@each_method
def test_projectile_that_does_not_leave_is_nan(throw):
    throws = throw(Ratios(1.0, 5.0, gravity_ratio=np.array([0.0, 9.0])))
    assert np.isnan(throws).tolist() == [[False, True]] * len(throws)


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('mass_ratio', 0.0),
        ('mass_ratio', math.nan),
        ('speed_ratio', math.inf),
        ('damping_ratio', 1.0),
        ('damping_ratio', -0.25),
        ('gravity_ratio', -0.125),
        ('threads', 0),
        ('threads', 1.5),
    ],
)
@each_method
def test_bad_arguments_are_quoted(throw, name, value):
    ratios = {'mass_ratio': 1.0, 'speed_ratio': 5.0}
    options = {'threads': value} if name == 'threads' else {}
    if not options:
        ratios[name] = value
    with pytest.raises(ValueError, match=f'^{name} must be .* got {value!r}$'):
        throw(Ratios(**ratios), **options)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'loss_tangent': -0.1}, r'loss_tangent .* got -0\.1'),
        ({'cells': 7}, f'cells .* 8 to {MAX_CELLS}, got 7'),
        ({'cells': 64.0}, r'got 64\.0'),
    ],
)
def test_bad_arguments_of_cells_are_quoted(arguments, message):
    cells = arguments.pop('cells', None)
    with pytest.raises(ValueError, match=message):
        BY_CELLS(Ratios(1.0, 5.0, **arguments), cells=cells)
