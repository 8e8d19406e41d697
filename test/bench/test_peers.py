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
        ('method_of_lines', 100, 1.5e-4),
    ],
)
def test_rigid_peer_converges_to_the_exact_release(peers, name, cells, error):
    rig = Rig(gravity=0.0)
    release = getattr(peers, name)(peers.Case.of(rig), cells=cells)
    assert_is_exact(release, rig, error)


@pytest.mark.parametrize(
    ('name', 'cells', 'error'),
    [('elastic_numba', 25, 1.5e-3), ('elastic_numba', 100, 1e-4), ('elastic_numpy', 25, 1.5e-3)],
)
def test_elastic_peer_converges_to_the_exact_release(peers, name, cells, error):
    rig = Rig(gravity=0.0)
    bar = peers.Bar.of(rig, cells=cells, projectile_cells=2)
    assert_is_exact(getattr(peers, name)(peers.Case.of(rig), bar), rig, error)


def test_march_with_gravity_agrees_in_numba_and_numpy(peers):
    rig = Rig()
    case = peers.Case.of(rig)
    strain = np.empty((40, 32))
    released = peers.march_kernel(case.mu, case.omega, case.zeta, case.gravity, 8, strain)
    march = peers.NumpyMarch(case, cells=32)
    for _ in range(320):
        march.step()
    exact = simulate(rig, max_events=1).ejection_time / rig.crossing_time
    assert released == pytest.approx(exact, rel=1e-3)
    assert march.releases[0][0] == pytest.approx(released, rel=1e-12)
    assert march.strain == pytest.approx(strain[-1], rel=1e-9)


def assert_is_exact(release, rig, error):
    exact = simulate(rig, max_events=1)
    phase = exact.ejection_time * rig.engine.frequency
    assert release.ejection_phase == pytest.approx(phase, rel=error, abs=error)
    assert release.energy_transfer == pytest.approx(exact.energy_transfer, rel=error)
