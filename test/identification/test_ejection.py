# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The first release of a fitted rig, and its errors."""

from dataclasses import replace

import numpy as np
import pytest
from reference.method_of_steps import follow
from scipy.optimize import bisect
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.identification.ejection import doubt, GOOD_ENOUGH, Release, releases_of
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.systematics import FLOORS


def truth_of(rig):
    throw = simulate(rig)
    return [throw.ejection_time, throw.ejection_speed, throw.peak_plate_speed,
            throw.energy_transfer]


def test_first_release_is_right_within_its_errors(fits):
    pulls = []
    for rig, found in fits.values():
        releases = releases_of(found)
        deviations = [
            [abs(estimate.value - truth) / estimate.error
             for estimate, truth in zip(item[:4], truth_of(rig), strict=True)]
            for item in releases
        ]
        pulls += min(deviations, key=max)
        for name in ('time', 'speed', 'energy_transfer'):
            value, error = getattr(releases[0], name)
            assert error >= found.growth * FLOORS[f'ejection.{name}'].of(value)
        assert releases[0].energy_transfer.error < 0.08 * releases[0].energy_transfer.value
    assert max(pulls) < 2.5


def test_ejection_that_jumps_within_the_errors_is_reported(fits):
    _, found = fits['usual', 5e-6]
    (index,) = found.model.indices_of('layer.wave_speed')

    def fitted(wave_speed):
        values, covariance = found.fit.values.copy(), np.zeros_like(found.fit.covariance)
        values[index], covariance[index, index] = wave_speed, 1e-6
        return replace(found, fit=replace(found.fit, values=values, covariance=covariance))

    def is_late(wave_speed):  # layers are left after 3 t_s if the wave is fast enough, or before
        rig = fitted(wave_speed).rig
        (release,) = follow(rig, max_events=1).events
        return release.time > 3.0 * rig.crossing_time

    jump = bisect(lambda wave_speed: is_late(wave_speed) - 0.5, 5.0, 7.8, xtol=1e-6)
    near, other = releases_of(fitted(jump))
    assert len(releases_of(fitted(jump + 0.8))) == 1
    assert other.probability == pytest.approx(0.5, abs=0.1)
    early, late = sorted([near.time, other.time])
    assert other.echoes == (1 if other.time == late else -1)
    for estimate, step in ((early, -1e-3), (late, 1e-3)):
        truth, *_ = truth_of(fitted(jump + step).rig)
        assert estimate.value == pytest.approx(truth, rel=0.02)


def with_energy_transfer(*values, error=0.02):
    """Return releases with energy transfers."""
    one = Estimate(1.0, 0.01)
    return [Release(one, one, one, Estimate(value, error)) for value in values]


def test_verdict_needs_a_small_error_without_jump_and_warning(fits):
    _, found = fits['usual', 5e-6]
    release = with_energy_transfer(4.0)
    assert doubt(found, with_energy_transfer(4.0, error=3.9 * GOOD_ENOUGH)) == ''
    assert doubt(found, with_energy_transfer(4.0, 4.01)) == ''
    assumed = replace(found.model.description, assumed=('projectile.mass',))
    quiet = tuple(
        replace(item, track=replace(item.track, known_noise=0.5 * item.track.noise))
        for item in found.fit.residuals
    )
    for result, releases in (
        (found, with_energy_transfer(4.0, error=4.1 * GOOD_ENOUGH)),
        (found, with_energy_transfer(4.0, 3.5)),
        (found, []),
        (replace(found, fit=replace(found.fit, residuals=quiet)), release),
        (replace(found, fit=replace(found.fit, is_converged=False)), release),
        (replace(found, model=replace(found.model, description=assumed)), release),
    ):
        assert doubt(result, releases)
