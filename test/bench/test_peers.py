# SPDX-License-Identifier: Apache-2.0
"""What the bench compares with is right, too: it converges to the exact release."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate

ROOT = Path(__file__).parents[2]


@pytest.fixture
def peers(monkeypatch):
    """Import the peers, which are not installed with the package."""
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module('bench.peers')


@pytest.mark.parametrize(
    ('name', 'cells', 'error'),
    [
        ('rigid_numba', 25, 6e-4),
        ('rigid_numba', 200, 2e-5),
        ('rigid_numpy', 25, 6e-4),
        ('method_of_lines', 25, 1.5e-3),
        ('elastic_numba', 25, 1.5e-3),
        ('elastic_numba', 100, 1e-4),
    ],
)
def test_peer_converges_to_the_exact_release(peers, name, cells, error):
    rig = Rig(gravity=0.0)
    case, throw = peers.Case.of(rig), getattr(peers, name)
    if name == 'elastic_numba':
        release = throw(case, peers.Bar.of(rig, cells=cells, projectile_cells=2))
    else:
        release = throw(case, cells=cells)
    exact = simulate(rig, max_events=1)
    phase = exact.ejection_time * rig.engine.frequency
    assert release.ejection_phase == pytest.approx(phase, rel=error, abs=error)
    assert release.energy_transfer == pytest.approx(exact.energy_transfer, rel=error)


@pytest.mark.parametrize(('name', 'error'), [('cells', 1e-3), ('delay_line', 1e-5)])
def test_peer_of_a_second_has_gravity_and_goes_on(peers, name, error):
    rig = Rig()
    case = peers.Case.of(rig)
    arguments = (case.mu, case.omega, case.zeta, case.gravity)
    if name == 'cells':
        released = peers.march_kernel(*arguments, 8, np.empty((400, 32)))
    else:
        released = peers.delay_line_kernel(*arguments, 200, 100.0)
    exact = simulate(rig, max_events=1).ejection_time / rig.crossing_time
    assert released == pytest.approx(exact, rel=error)


def test_cases_are_compared_with_the_first_and_list_their_error(peers):
    race = importlib.import_module('bench.race')
    cases = [
        race.Case('one', lambda: 1.0),
        race.Case(
            'two', lambda: sum(range(1000)), units=2.0, error=lambda found: found - 499500.0
        ),
    ]
    *_, one, two = race.rows(race.Table('sums', 'sum', 'error', cases))
    assert one.split('|')[5].strip() == '1'
    assert two.split('|')[2].strip() == '0.0e+00'
