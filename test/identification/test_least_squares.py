# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Least squares: values, errors, outliers and priors."""

from dataclasses import replace
import re

import numpy as np
import pytest
from scipy.optimize import curve_fit
from soft_throw_ros.identification.least_squares import (
    Estimate,
    fit_tracks,
    fit_warnings,
    FitError,
    FitModel,
)
from soft_throw_ros.identification.tracks import Track

TIME = np.linspace(0.0, 2.0, 200)
TRUTH, GUESS = np.array([1.5, 0.8]), np.array([1.0, 1.0])


def decay(time, size, rate):
    return size * np.exp(-rate * time)


def model_of(function, *names):
    """Return a model made of an arbitrary function of time and values."""
    free = np.full(len(names), np.inf)
    return FitModel(
        names=names, predict=lambda values: function(TIME, *values), low=-free, high=free
    )


MODEL = model_of(decay, 'size', 'rate')


def track(seed=0, *, noise=0.01, known=None, extra=0.0):
    scatter = noise * np.random.default_rng(seed).normal(size=TIME.size)
    heights = decay(TIME, *TRUTH) + extra * np.sin(9.0 * TIME)
    return Track(time=TIME, position=heights + scatter, known_noise=known)


@pytest.mark.parametrize('known', [None, 0.005, 0.01, 0.02])
def test_fit_agrees_with_curve_fit(known):
    data = track(known=known)
    fit = fit_tracks(MODEL, GUESS, [('decay', data)])
    noise = np.full(TIME.size, data.noise)
    values, covariance = curve_fit(
        decay, TIME, data.position, p0=GUESS, sigma=noise, absolute_sigma=True
    )
    covariance *= max(1.0, fit.reduced_chi2)
    assert fit.values == pytest.approx(values, rel=1e-6)
    assert fit.covariance == pytest.approx(covariance, rel=1e-4)
    assert fit.dof == 198


def test_a_slow_misfit_within_the_noise_enlarges_the_errors():
    plain, slow = (
        [fit_tracks(MODEL, TRUTH, [('decay', track(seed, extra=extra, known=0.01))])
         for seed in range(20)]
        for extra in (0.0, 0.007)
    )
    assert np.mean([fit.reduced_chi2 for fit in slow]) < 1.3
    assert np.mean([fit.errors for fit in slow]) > 1.4 * np.mean([fit.errors for fit in plain])


def test_fit_of_noise_alone_seldom_warns():
    fits = [fit_tracks(MODEL, TRUTH, [('decay', track(seed))]) for seed in range(300)]
    assert sum(bool(fit_warnings(fit)) for fit in fits) <= 1


@pytest.mark.parametrize('data', [track(extra=0.02), track(noise=0.02, known=0.01)])
def test_residuals_above_the_noise_are_reported(data):
    fit = fit_tracks(MODEL, TRUTH, [('decay', data)])
    assert fit.is_mismatch
    (mismatch,) = (text for text in fit_warnings(fit) if 'times the noise' in text)
    (ratio,) = re.findall(r'(\S+) times', mismatch)
    assert float(ratio) == pytest.approx(2.0, rel=0.4)


def test_inseparable_parameters_are_reported():
    def grown(time, size, rate, growth):
        return decay(time, size * (1.0 + 0.01 * time * growth), rate)

    model = model_of(grown, 'size', 'rate', 'growth')
    fit = fit_tracks(model, np.array([1.4, 0.7, 0.0]), [('decay', track())])
    (pair,) = fit_warnings(fit)
    assert pair.startswith('rate and growth')
    assert fit['growth'].error > 1.0
    # errors are correct nevertheless
    assert fit['rate'].value == pytest.approx(TRUTH[1], abs=4.0 * fit['rate'].error + 0.01)


def test_parameter_without_effect_has_infinite_error():
    model = model_of(lambda time, size, rate, idle: decay(time, size, rate), 'a', 'b', 'idle')
    fit = fit_tracks(model, np.array([1.4, 0.7, 0.3]), [('decay', track())])
    assert fit['idle'].error > 1e10
    assert fit['b'].error < 0.1


@pytest.mark.parametrize('indices', [[0], [1], [57, 58, 120], [199]])
def test_outliers_are_listed_and_hardly_matter(indices):
    clean = fit_tracks(MODEL, GUESS, [('decay', track())])
    position = track().position.copy()
    position[indices] += 0.5
    fit = fit_tracks(MODEL, GUESS, [('decay', Track(time=TIME, position=position))])
    times, deviations = zip(*fit.residuals[0].outliers, strict=True)
    assert list(times) == TIME[indices].tolist()
    assert deviations == pytest.approx(np.full(len(indices), 0.5), abs=0.05)
    assert np.abs((fit.values - clean.values) / clean.errors).max() < 1.5
    assert fit_warnings(fit) == []


def test_prior_counts_as_a_sample_and_its_contradiction_is_reported():
    known = Estimate(0.795, 3e-3)
    free = fit_tracks(MODEL, TRUTH, [('decay', track(known=0.01))])
    fit = fit_tracks(replace(MODEL, known={1: known}), TRUTH, [('decay', track(known=0.01))])
    weights = np.array([free['rate'].error, known.error]) ** -2.0
    mean = np.average([free['rate'].value, known.value], weights=weights)
    assert fit['rate'].value == pytest.approx(mean, abs=0.2 * known.error)
    assert fit['rate'].error == pytest.approx(weights.sum() ** -0.5, rel=0.05)
    assert fit.dof == free.dof + 1
    prior = Estimate(0.7, 3e-3)
    fit = fit_tracks(replace(MODEL, known={1: prior}), TRUTH, [('decay', track())])
    (contradiction,) = (text for text in fit_warnings(fit) if str(prior) in text)
    assert contradiction.startswith('rate is found')


def test_solver_that_stops_at_its_limit_is_reported():
    for limit in (1, 100):
        fit = fit_tracks(MODEL, GUESS, [('decay', track())], max_evaluations=limit)
        assert fit.is_converged is (limit > 1)
        assert any('limit' in text for text in fit_warnings(fit)) is (limit == 1)


def test_fit_with_too_few_samples_is_refused():
    many = model_of(lambda time, *values: time, *'abcdefghijklmn')
    with pytest.raises(FitError, match='12 samples are too few for 14 parameters: a, b'):
        fit_tracks(many, np.zeros(14), [('decay', track().between(0.0, 0.12))])
