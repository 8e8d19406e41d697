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
"""What the bench compares with is right, too: it converges to the exact release."""

import math

from bench import check, peers, race, sums
import numpy as np
import pytest
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate


@pytest.mark.parametrize(
    ('name', 'cells', 'error'),
    [
        ('rigid_numba', 25, 6e-4),
        ('rigid_numba', 200, 2e-5),
        ('rigid_numpy', 25, 6e-4),
        ('method_of_lines', 25, 1.5e-3),
    ],
)
def test_peer_converges_to_the_exact_release(name, cells, error):
    rig = Rig(gravity=0.0)
    release = getattr(peers, name)(peers.Case.of(rig), cells=cells)
    exact = simulate(rig, max_events=1)
    phase = exact.ejection_time * rig.engine.frequency
    assert release.ejection_phase == pytest.approx(phase, rel=error, abs=error)
    assert release.energy_transfer == pytest.approx(exact.energy_transfer, rel=error)


@pytest.mark.parametrize(('name', 'error'), [('cells', 1e-3), ('delay_line', 1e-5)])
def test_peer_of_a_second_has_gravity_and_goes_on(name, error):
    rig = Rig()
    case = peers.Case.of(rig)
    arguments = (case.mu, case.omega, case.zeta, case.gravity)
    if name == 'cells':
        released = peers.march_kernel(*arguments, 8, np.empty((400, 32)))
    else:
        released = peers.delay_line_kernel(*arguments, 200, 100.0)
    exact = simulate(rig, max_events=1).ejection_time / rig.crossing_time
    assert released == pytest.approx(exact, rel=error)


def test_cases_are_compared_with_the_first_and_list_their_error():
    cases = [
        race.Case('one', lambda: 1.0),
        race.Case(
            'two', lambda: sum(range(1000)), units=2.0, error=lambda found: found - 499500.0
        ),
    ]
    result = race.measure(
        race.Table('sums', 'sum', 'error', cases, left_out=('three (too slow)',))
    )
    first, second = result.rows
    assert (first[1], first[4], second[1]) == (None, 1.0, 0.0)
    assert result.ratios == {'two': second[4]}
    assert 'Left out: three (too slow).' in result.lines()


def test_ratio_that_changes_by_more_than_30_percent_is_said(tmp_path):
    path = tmp_path / 'ratios.json'
    assert 'not there' in check.deviations({}, path)[0]
    check.store({'sums': {'steady': 2.0, 'slow': 2.0, 'gone': 1.0}, 'maps': {'one': 5.0}}, path)
    check.store({'maps': {'one': 6.0}}, path)  # the others stay
    assert check.deviations({'maps': {'one': 6.0}}, path) == []
    found = check.deviations({'sums': {'steady': 1.6, 'slow': 2.7, 'new': 1.0}}, path)
    assert [line.partition(':')[0] for line in found] == ['sums, gone', 'sums, slow']


def test_library_that_does_not_install_or_is_wrong_is_left_out_with_the_reason():
    def missing(_case):
        raise ImportError('no such library')

    def wrong(_case):
        return lambda: peers.Release(0.6, 3.0)

    def right(_case):
        return lambda: sums.TRUE

    libraries = [('missing', missing), ('wrong', wrong), ('right', right)]
    found, left_out = sums._installed(libraries, peers.Case(1.0, 1.0))
    assert [case.name for case in found] == ['right']
    assert 'no such library' in left_out[0]
    assert 'off by 25 %' in left_out[1]


@pytest.mark.parametrize(('mu', 'rise', 'alpha'), [(0.46, 0.25, 5.65), (0.84, 1.0, 4.78)])
def test_driven_plate_throws_as_is_known(mu, rise, alpha):
    """A plate that goes up as fast as it may, without gravity."""
    args = (mu, 0.0, math.inf, np.array([1.0 / rise]), rise)
    speed = peers.driven_kernel(*args, 200)
    assert speed**2 == pytest.approx(alpha, rel=5e-3)
    assert peers.driven_kernel(mu, 0.0, 1.0, *args[3:], 200) == 0.0  # which takes more travel
