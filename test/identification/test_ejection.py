# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The first release of a fitted rig, and its errors."""

from dataclasses import replace

import numpy as np
import pytest
from reference.method_of_steps import follow
from scipy.optimize import bisect
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.identification.ejection import (
    Ejection,
    ejection_of,
    GOOD_ENOUGH,
    judge,
    Release,
)
from soft_throw_ros.identification.fit_description import (
    DEFAULT_FREE,
    FitDescription,
    FIXED,
    IDEAL_BENCH,
    values_of,
)
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.rig_fit import fit_rig
from soft_throw_ros.identification.systematics import FLOORS

RESULTS = ('time', 'speed', 'peak_plate_speed', 'energy_transfer')


def truth_of(rig):
    throw = simulate(rig)
    names = ('ejection_time', 'ejection_speed', 'peak_plate_speed', 'energy_transfer')
    return np.array([getattr(throw, name) for name in names])


def pulls_of(ejection, truth):
    """Return the deviations of the results from the truth, in standard errors."""
    values, errors = np.transpose([getattr(ejection.first, name) for name in RESULTS])
    return (values - truth) / errors


def drawn_error(name, estimate):
    """Return the error of a result without the systematic error."""
    floor = FLOORS[f'ejection.{name}'].of(estimate.value)
    assert estimate.error >= floor > 0.0
    return np.sqrt(estimate.error**2 - floor**2)


def test_errors_of_the_ejection_are_correct(make_throw):
    truth = truth_of(Rig())
    pulls = []
    for seed in range(4):
        throw = make_throw(Rig(), rate=2000.0, duration=0.06, seed=seed)
        ejection = ejection_of(fit_rig([throw], Rig(), FitDescription(IDEAL_BENCH)))
        pulls.append(pulls_of(ejection, truth))
        assert ejection.first.energy_transfer.error < 0.01 * ejection.first.energy_transfer.value
        assert ejection.alternatives == ()
    assert np.abs(np.mean(pulls, axis=0)).max() < 1.3
    assert np.sqrt(np.mean(np.square(pulls), axis=0)).max() < 1.8


@pytest.fixture
def fitted(make_throw):
    """Return the fit of a rig with an error of its wave speed."""

    def fit(rig, *, error):
        found = fit_rig([make_throw(Rig(), rate=1000.0)], rig, FitDescription(IDEAL_BENCH))
        values = found.fit.values.copy()
        values[:4] = list(values_of(rig, DEFAULT_FREE).values())
        covariance = np.diag(np.full(values.size, 1e-20))
        covariance[3, 3] = error**2
        changed = replace(found.fit, values=values, covariance=covariance)
        return replace(found, fit=changed)

    return fit


def test_ejection_that_jumps_within_the_errors_is_reported(fitted):
    # Layers of 16.8 mm are left after 3 t_s if the wave is fast enough, and else before
    def is_late(wave_speed):
        rig = Rig(layer=Layer(wave_speed=wave_speed))
        (release,) = follow(rig, max_events=1).events
        return release.time > 3.0 * rig.crossing_time

    jump = bisect(lambda wave_speed: is_late(wave_speed) - 0.5, 5.0, 7.8, xtol=1e-6)
    near = ejection_of(fitted(Rig(layer=Layer(wave_speed=jump)), error=1e-3))
    far = ejection_of(fitted(Rig(layer=Layer(wave_speed=jump + 0.1)), error=1e-3))
    assert far.alternatives == ()
    (other,) = near.alternatives
    assert other.probability == pytest.approx(0.5, abs=0.1)
    early, late = sorted([near.first.time, other.time])
    assert abs(other.echoes) == 1
    assert (other.echoes > 0) == (other.time == late)
    for found, step in ((early, -1e-3), (late, 1e-3)):
        truth = truth_of(Rig(layer=Layer(wave_speed=jump + step)))[0]
        assert found.value == pytest.approx(truth, rel=0.02)
        assert drawn_error('time', found) < 0.05 * (late.value - early.value)


@pytest.mark.slow
@pytest.mark.parametrize('loss_tangent', [0.0, 0.03])
def test_error_of_the_ejection_follows_from_the_error_of_the_wave_speed(fitted, loss_tangent):
    def at(wave_speed):
        return Rig(layer=Layer(wave_speed=wave_speed, loss_tangent=loss_tangent))

    ejection = ejection_of(fitted(at(7.8), error=0.01)).first
    higher, lower = (ejection_of(fitted(at(7.8 + d), error=1e-9)).first for d in (0.01, -0.01))
    for name in ('time', 'speed', 'energy_transfer'):
        change = abs(getattr(higher, name).value - getattr(lower, name).value) / 2.0
        assert drawn_error(name, getattr(ejection, name)) == pytest.approx(change, rel=0.15)
    assert ejection.peak_plate_speed.value == pytest.approx(
        Underdamped.of(Rig().engine).peak_velocity
    )


def release_of(*, error=0.02, other=None):
    """Return a release with an energy transfer of 4, and possibly another one."""
    one = Estimate(1.0, 0.01)
    others = (Release(one, one, one, Estimate(other, 0.02), 1, 0.2),) if other else ()
    return Ejection(Release(one, one, one, Estimate(4.0, error)), others)


@pytest.fixture(scope='module')
def fits(make_throw):
    """Return the fits of one throw with unknown stiffening and with a linear layer."""
    throw = make_throw(Rig(), rate=2500.0, duration=0.06)
    linear = FitDescription({'layer.stiffening': FIXED})
    return fit_rig([throw], Rig()), fit_rig([throw], Rig(), linear)


def test_wave_speed_at_the_amplitude_is_better_known_than_at_rest(fits):
    unknown, linear = fits
    speed, at_rest = unknown.estimate('layer.wave_speed'), unknown.rest_wave_speed()
    assert speed.error < 0.8 * at_rest.error
    assert speed.value == pytest.approx(Rig().layer.wave_speed, abs=3.0 * speed.error)
    # A linear layer has the effective wave speed at all amplitudes
    same = linear.estimate('layer.wave_speed')
    assert speed.error == pytest.approx(same.error, rel=0.1)
    assert same.error == pytest.approx(linear.rest_wave_speed().error)


def test_verdict_needs_a_small_error_without_jump_and_warning(fits):
    found = fits[1]
    assert judge(found, release_of(error=3.9 * GOOD_ENOUGH)).is_good_enough
    assert judge(found, release_of(other=4.01)).is_good_enough
    assumed = replace(found.model.description, assumed=('projectile.mass',))
    unstated = replace(found, model=replace(found.model, description=assumed))
    mismatch, stopped = (
        replace(found, fit=replace(found.fit, **changes))
        for changes in ({'chi2': 4.0 * found.fit.chi2}, {'is_converged': False})
    )
    for fit, release in (
        (found, release_of(error=4.1 * GOOD_ENOUGH)), (found, release_of(other=3.5)),
        (found, None), (mismatch, release_of()), (stopped, release_of()), (unstated, release_of()),
    ):
        verdict = judge(fit, release)
        assert not verdict.is_good_enough
        assert verdict.reason
