# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The first release of a fitted rig, and its errors."""

from dataclasses import replace

import numpy as np
import pytest
from reference.method_of_steps import follow
from scipy.optimize import bisect
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.identification.ejection import (
    doubt,
    Ejection,
    ejection_of,
    GOOD_ENOUGH,
    Release,
)
from soft_throw_ros.identification.fit_description import (
    DEFAULT_FREE,
    FitDescription,
    IDEAL_BENCH,
    values_of,
)
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.rig_fit import fit_rig


def truth_of(rig):
    throw = simulate(rig)
    return [throw.ejection_time, throw.ejection_speed, throw.peak_plate_speed,
            throw.energy_transfer]


def test_first_release_is_right_within_its_errors(fits):
    pulls = []
    for rig, found in fits.values():
        first, others = ejection_of(found)
        deviations = [
            [abs(estimate.value - truth) / estimate.error
             for estimate, truth in zip(item[:4], truth_of(rig), strict=True)]
            for item in (first, *others)
        ]
        pulls += min(deviations, key=max)
        assert first.energy_transfer.error < 0.08 * first.energy_transfer.value
    assert max(pulls) < 2.5


@pytest.fixture
def fitted(make_throw):
    """Return the fit of a rig with an error of its wave speed."""

    def fit(rig, *, error):
        found = fit_rig([make_throw(Rig(), rate=1000.0)], rig, FitDescription(IDEAL_BENCH))
        own = found.fit.values[4:]
        values = np.array([*values_of(rig, DEFAULT_FREE).values(), *own])
        covariance = np.diag([1e-20, 1e-20, 1e-20, error**2, *np.full(own.size, 1e-20)])
        return replace(found, fit=replace(found.fit, values=values, covariance=covariance))

    return fit


def test_ejection_that_jumps_within_the_errors_is_reported(fitted):
    # Layers of 16.8 mm are left after 3 t_s if the wave is fast enough, and else before
    def is_late(wave_speed):
        rig = Rig(layer=Layer(wave_speed=wave_speed))
        (release,) = follow(rig, max_events=1).events
        return release.time > 3.0 * rig.crossing_time

    jump = bisect(lambda wave_speed: is_late(wave_speed) - 0.5, 5.0, 7.8, xtol=1e-6)
    near = ejection_of(fitted(Rig(layer=Layer(wave_speed=jump)), error=1e-3))
    far = ejection_of(fitted(Rig(layer=Layer(wave_speed=jump + 0.8)), error=1e-3))
    assert far.alternatives == ()
    (other,) = near.alternatives
    assert other.probability == pytest.approx(0.5, abs=0.1)
    early, late = sorted([near.first.time, other.time])
    assert other.echoes == (1 if other.time == late else -1)
    for found, step in ((early, -1e-3), (late, 1e-3)):
        truth, *_ = truth_of(Rig(layer=Layer(wave_speed=jump + step)))
        assert found.value == pytest.approx(truth, rel=0.02)


def release_of(*, error=0.02, other=None):
    """Return a release with an energy transfer of 4, and possibly another one."""
    one = Estimate(1.0, 0.01)
    others = (Release(one, one, one, Estimate(other, 0.02), 1, 0.2),) if other else ()
    return Ejection(Release(one, one, one, Estimate(4.0, error)), others)


def test_verdict_needs_a_small_error_without_jump_and_warning(fits):
    found = fits['usual', 5e-6][1]
    assert doubt(found, release_of(error=3.9 * GOOD_ENOUGH)) == ''
    assert doubt(found, release_of(other=4.01)) == ''
    assumed = replace(found.model.description, assumed=('projectile.mass',))
    unstated = replace(found, model=replace(found.model, description=assumed))
    quiet = tuple(
        replace(item, track=replace(item.track, known_noise=0.5 * item.track.noise))
        for item in found.fit.residuals
    )
    mismatch, stopped = (
        replace(found, fit=replace(found.fit, **changes))
        for changes in ({'residuals': quiet}, {'is_converged': False})
    )
    for fit, release in (
        (found, release_of(error=4.1 * GOOD_ENOUGH)), (found, release_of(other=3.5)),
        (found, None), (mismatch, release_of()), (stopped, release_of()), (unstated, release_of()),
    ):
        assert doubt(fit, release)
