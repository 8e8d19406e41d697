# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Properties of throws in batches, for every method of computation."""

from functools import partial
import math

import numpy as np
import pytest
from soft_throw_ros.core import cell_stepper, closed_form, wave_stepper
from soft_throw_ros.core.batch import ThrowUnresolvedError
from soft_throw_ros.core.cell_stepper import MAX_CELLS

RELEASES = closed_form.first_releases
WAVES = wave_stepper.first_throws
CELLS = partial(cell_stepper.first_throws, cells=16)
first_throws = pytest.mark.parametrize('first_throws', [RELEASES, WAVES, CELLS])


def some_cases(count):
    """Draw ratios of all kinds."""
    random = np.random.default_rng(2)
    return {
        'mass_ratio': np.exp(random.uniform(-2.0, 2.0, count)),
        'speed_ratio': np.exp(random.uniform(0.0, 4.0, count)),
        'damping_ratio': random.uniform(0.0, 0.3, count),
        'gravity_ratio': random.uniform(0.0, 0.02, count),
    }


@pytest.mark.parametrize(
    ('first_throws', 'count', 'options'),
    [
        (RELEASES, 3 * 2048, {}),
        (WAVES, 3 * 64, {}),
        (cell_stepper.first_throws, 60, {'loss_tangent': 0.1, 'crossing_ratio': 0.02}),
        (cell_stepper.first_throws, 60, {'glued_to': 'projectile'}),
    ],
)
def test_no_bit_of_a_throw_depends_on_threads_or_on_other_throws(first_throws, count, options):
    cases = some_cases(count)
    together = first_throws(**cases, **options, threads=1)
    shared = first_throws(**cases, **options, threads=3)
    assert np.array(together).tobytes() == np.array(shared).tobytes()
    for i in range(0, count, count // 6):
        alone = first_throws(**{name: values[i] for name, values in cases.items()}, **options)
        assert np.array(alone).tolist() == np.array(together)[:, i].tolist()


@first_throws
def test_arguments_are_broadcast(first_throws):
    throws = first_throws(
        mass_ratio=[[0.5], [1.0]], speed_ratio=[5.0, 8.0, 12.0], damping_ratio=0.1
    )
    assert all(values.shape == (2, 3) for values in throws)
    throw = first_throws(mass_ratio=1.0, speed_ratio=8.0, damping_ratio=0.1)
    assert throws.energy_transfer[1, 1] == pytest.approx(throw.energy_transfer, rel=1e-14)
    assert first_throws(mass_ratio=[], speed_ratio=[]).speed.shape == (0,)
    with pytest.raises(ValueError, match='shape'):
        first_throws(mass_ratio=[1.0, 2.0], speed_ratio=[1.0, 2.0, 3.0])


@first_throws
def test_projectile_that_does_not_leave_raises_an_error_or_is_nan(first_throws):
    case = {'mass_ratio': 1.0, 'speed_ratio': 5.0, 'gravity_ratio': [0.0, 9.0]}
    with pytest.raises(ThrowUnresolvedError, match='gravity_ratio 9'):
        first_throws(**case)
    throws = first_throws(**case, unresolved='nan')
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
        ('unresolved', 'skip'),
        ('threads', 0),
        ('threads', 1.5),
    ],
)
@first_throws
def test_bad_arguments_are_quoted(first_throws, name, value):
    with pytest.raises(ValueError, match=f'^{name} must be .* got {value!r}$'):
        first_throws(**{'mass_ratio': 1.0, 'speed_ratio': 5.0, name: value})


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'loss_tangent': -0.1}, r'loss_tangent .* got -0\.1'),
        ({'crossing_ratio': [1.0, 40.0]}, r'crossing_ratio .* 32, got 40\.0'),
        ({'glued_to': 'both'}, "glued_to .* got 'both'"),
        ({'cells': 7}, f'cells .* 8 to {MAX_CELLS}, got 7'),
        ({'cells': 64.0}, r'got 64\.0'),
    ],
)
def test_bad_arguments_of_cells_are_quoted(arguments, message):
    with pytest.raises(ValueError, match=message):
        cell_stepper.first_throws(mass_ratio=1.0, speed_ratio=5.0, **arguments)
