# SPDX-License-Identifier: Apache-2.0
"""First releases by finite differences."""

import pytest
from soft_throw_ros.core.finite_difference import first_releases
from soft_throw_ros.core.travelling_wave import ThrowUnresolvedError


# Computed with 40-digit closed forms, checked by a second method: mu, kappa, zeta, te f, alpha
@pytest.mark.parametrize(
    ('mu', 'kappa', 'zeta', 'phase', 'alpha'),
    [
        (0.23423068535205, 8.2422098072057, 0.0, 0.3994399384513045, 4.123214640552163),
        (0.29513187784084, 9.2434758430532, 0.2, 0.3633656659293691, 4.185169858004478),
        (50.0, 60.0, 0.0, 0.4266129421799032, 3.037440451346464),
        (0.6345238095238095, 7.34629294755877, 0.064, 0.48150827831570486, 3.63734724564707),
    ],
)
def test_first_release_is_exact_to_1e_3_with_100_cells(mu, kappa, zeta, phase, alpha):
    release = first_releases(mass_ratio=mu, speed_ratio=kappa, damping_ratio=zeta, cells=100)
    assert release.ejection_phase == pytest.approx(phase, rel=1e-3)
    assert release.energy_transfer == pytest.approx(alpha, rel=1e-3)


def test_internal_loss_is_exact_to_1e_4():
    release = first_releases(
        mass_ratio=0.6345238095238095, speed_ratio=7.34629294755877, loss_tangent=0.05
    )
    assert release.ejection_phase == pytest.approx(0.46694752928793415, rel=1e-4)
    assert release.speed == pytest.approx(1.8077831318189745, rel=1e-4)


# The paper's rig with an elastic projectile: mu, kappa, t_r / t_s, te f, V of the centre of mass
@pytest.mark.parametrize(
    ('mu', 'kappa', 'crossing', 'phase', 'speed'),
    [
        (10.595, 61.70886075949366, 0.0382008, 0.25234398637936983, 1.5146422569913178),
        (3.7839286, 22.0388788427, 0.01364315, 0.3689758829724327, 1.809256199489624),
    ],
)
def test_elastic_projectile_is_exact_to_2e_5(mu, kappa, crossing, phase, speed):
    release = first_releases(mass_ratio=mu, speed_ratio=kappa, crossing_ratio=crossing)
    assert release.ejection_phase == pytest.approx(phase, rel=2e-5)
    assert release.speed == pytest.approx(speed, rel=2e-5)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'mass_ratio': 0.0}, r'mass_ratio must be above 0 and finite, got 0\.0'),
        ({'loss_tangent': -0.1}, r'loss_tangent must be at least 0 and finite, got -0\.1'),
        ({'crossing_ratio': -1.0}, r'crossing_ratio must be .* got -1\.0'),
        ({'cells': 7}, 'cells must be a whole number from 8 to 4096, got 7'),
        ({'unresolved': 'skip'}, "unresolved must be 'raise' or 'nan', got 'skip'"),
        ({'threads': 0}, 'threads must be .* got 0'),
    ],
)
def test_bad_arguments_are_quoted(arguments, message):
    with pytest.raises(ValueError, match=message):
        first_releases(**{'mass_ratio': 1.0, 'speed_ratio': 5.0, **arguments})


def test_projectile_that_does_not_leave_is_named():
    with pytest.raises(ThrowUnresolvedError, match=r'within 400 crossings .* gravity_ratio 9,'):
        first_releases(mass_ratio=1.0, speed_ratio=5.0, gravity_ratio=9.0, cells=8)
