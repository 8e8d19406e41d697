# SPDX-License-Identifier: Apache-2.0
"""Releases in steps against the closed form."""

import numpy as np
import pytest
from soft_throw_ros.core.swings import first_release_kernel
from soft_throw_ros.core.travelling_wave import first_releases

LATEST = 3.0


def ratios(seed, size):
    random = np.random.default_rng(seed)
    return np.exp(random.uniform(-4.0, 3.0, size)), np.exp(random.uniform(-0.5, 3.5, size))


@pytest.mark.parametrize('damping_ratio', [0.0, 0.064, 0.3])
@pytest.mark.parametrize('gravity_ratio', [0.0, 0.03, 0.3])
def test_releases_are_those_of_the_closed_form(damping_ratio, gravity_ratio):
    mu, kappa = ratios(3, 150)
    exact = first_releases(
        mass_ratio=mu, speed_ratio=kappa, damping_ratio=damping_ratio,
        gravity_ratio=gravity_ratio, unresolved='nan',
    )  # fmt: skip
    is_early = exact.ejection_phase < LATEST + 1.0 / kappa
    assert is_early.sum() > 80
    for i in range(mu.size):
        phase, speed, status = first_release_kernel(
            mu[i], kappa[i], damping_ratio, gravity_ratio, LATEST
        )
        assert (status == 0) == is_early[i]
        if status == 0:
            assert phase == pytest.approx(exact.ejection_phase[i], abs=1e-4)
            assert speed == pytest.approx(exact.speed[i], abs=1e-4)


def test_later_swing_is_found():
    exact = first_releases(
        mass_ratio=0.3874933704385987, speed_ratio=5.93813594176589, damping_ratio=0.064,
        gravity_ratio=3.0,
    )  # fmt: skip
    phase, speed, status = first_release_kernel(
        0.3874933704385987, 5.93813594176589, 0.064, 3.0, LATEST
    )
    assert status == 0
    assert phase == pytest.approx(exact.ejection_phase, rel=1e-3)
    assert speed == pytest.approx(exact.speed, rel=1e-3)
    assert speed > 3.0


def test_what_gravity_holds_is_followed_no_longer_than_asked():
    phase, speed, status = first_release_kernel(0.6, 8.0, 0.3, 5.0, LATEST)
    assert status == 1
    assert phase == pytest.approx(LATEST + 1.0 / 8.0)
    assert np.isnan(speed)
