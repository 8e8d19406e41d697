# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Least squares: values, errors, outliers and priors."""

import re

import numpy as np
import pytest
from scipy.optimize import curve_fit
from soft_throw_ros.identification.least_squares import (
    Estimate,
    fit_tracks,
    fit_warnings,
    FitError,
)
from soft_throw_ros.identification.tracks import Track

TIME = np.linspace(0.0, 2.0, 200)
TRUTH, GUESS = np.array([1.5, 0.8]), np.array([1.0, 1.0])


def decay(time, size, rate):
    return size * np.exp(-rate * time)


def track(seed=0, *, noise=0.01, known=None, extra=0.0):
    scatter = noise * np.random.default_rng(seed).normal(size=TIME.size)
    heights = decay(TIME, *TRUTH) + extra * np.sin(9.0 * TIME)
    return Track(time=TIME, position=heights + scatter, known_noise=known)


def fit(data, start=TRUTH, *, function=decay, names=('size', 'rate'), **options):
    """Fit an arbitrary function of time and values to a track."""
    free = np.full(len(names), np.inf)
    return fit_tracks(
        lambda values: function(TIME, *values), np.array(start), [('decay', data)], names=names,
        bounds=(-free, free), **options,
    )


@pytest.mark.parametrize('known', [None, 0.005, 0.01, 0.02])
def test_fit_agrees_with_curve_fit(known):
    data = track(known=known)
    found = fit(data, GUESS)
    values, covariance = curve_fit(
        decay, TIME, data.position, p0=GUESS, sigma=np.full(TIME.size, data.noise),
        absolute_sigma=True,
    )
    assert found.values == pytest.approx(values, rel=1e-6)
    covariance *= max(1.0, found.reduced_chi2)
    assert found.covariance == pytest.approx(covariance, rel=1e-4)
    assert found.dof == 198


def test_noise_alone_seldom_warns_and_a_slow_misfit_within_it_enlarges_the_errors():
    plain = [fit(track(seed, known=0.01)) for seed in range(20)]
    slow = [fit(track(seed, extra=0.007, known=0.01)) for seed in range(20)]
    assert sum(bool(fit_warnings(fit(track(seed)))) for seed in range(300)) <= 1
    assert np.mean([found.reduced_chi2 for found in slow]) < 1.3
    errors = [np.mean([found.errors for found in fits]) for fits in (plain, slow)]
    assert errors[1] > 1.4 * errors[0]


@pytest.mark.parametrize('data', [track(extra=0.02), track(noise=0.02, known=0.01)])
def test_residuals_above_the_noise_are_reported(data):
    found = fit(data)
    assert found.is_mismatch
    (mismatch,) = (text for text in fit_warnings(found) if 'times the noise' in text)
    (ratio,) = re.findall(r'(\S+) times', mismatch)
    assert float(ratio) == pytest.approx(2.0, rel=0.4)


def test_parameters_that_cannot_be_separated_or_seen_are_reported():
    def grown(time, size, rate, growth, _idle):
        return decay(time, size * (1.0 + 0.01 * time * growth), rate)

    names = 'size', 'rate', 'growth', 'idle'
    found = fit(track(), [1.4, 0.7, 0.0, 0.3], function=grown, names=names)
    (pair,) = fit_warnings(found)
    assert pair.startswith('rate and growth')
    assert found['growth'].error > 1.0
    assert found['idle'].error > 1e10
    # errors are correct nevertheless
    assert found['rate'].value == pytest.approx(TRUTH[1], abs=4.0 * found['rate'].error + 0.01)


@pytest.mark.parametrize('indices', [[0], [1], [57, 58, 120], [199]])
def test_outliers_are_listed_and_hardly_matter(indices):
    clean, position = fit(track()), track().position.copy()
    position[indices] += 0.5
    found = fit(Track(time=TIME, position=position), GUESS)
    times, deviations = zip(*found.residuals[0].outliers, strict=True)
    assert list(times) == TIME[indices].tolist()
    assert deviations == pytest.approx(np.full(len(indices), 0.5), abs=0.05)
    assert np.abs((found.values - clean.values) / clean.errors).max() < 1.5
    assert fit_warnings(found) == []


def test_prior_counts_as_a_sample_and_its_contradiction_is_reported():
    known, other = Estimate(0.795, 3e-3), Estimate(0.7, 3e-3)
    free, found = fit(track(known=0.01)), fit(track(known=0.01), known={1: known})
    weights = np.array([free['rate'].error, known.error]) ** -2.0
    mean = np.average([free['rate'].value, known.value], weights=weights)
    assert found['rate'].value == pytest.approx(mean, abs=0.2 * known.error)
    assert found['rate'].error == pytest.approx(weights.sum() ** -0.5, rel=0.05)
    assert found.dof == free.dof + 1
    texts = fit_warnings(fit(track(), known={1: other}))
    (contradiction,) = (text for text in texts if str(other) in text)
    assert contradiction.startswith('rate is found')


@pytest.mark.parametrize('limit', [1, 100])
def test_solver_that_stops_at_its_limit_is_reported(limit):
    found = fit(track(), GUESS, max_evaluations=limit)
    assert found.is_converged is (limit > 1)
    assert any('limit' in text for text in fit_warnings(found)) is (limit == 1)


def test_fit_with_too_few_samples_is_refused():
    with pytest.raises(FitError, match='200 samples are too few for 201 parameters: a, a'):
        fit(track(), np.zeros(201), names=('a',) * 201)
