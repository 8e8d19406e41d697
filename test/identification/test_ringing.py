# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Periods and the wave speed from layers that ring."""

import numpy as np
import pytest
from soft_throw_ros.identification.least_squares import Estimate, FitError
from soft_throw_ros.identification.ringing import fit_period, fit_wave_speed
from soft_throw_ros.identification.tracks import Track, TrackError


def ends_of(thickness, *, rate, loss_time, noise, seed):
    """
    Return tracks of both ends of a layer that was squeezed evenly and let go at time 0.

    By many modes of the wave equation with Kelvin-Voigt loss, each from rest, on a moving plate.
    """
    period, rng = 2.0 * thickness / 7.8, np.random.default_rng(seed)
    time = np.arange(-2.0 * period, 12.0 * period, 1.0 / rate)
    bottom, after = 1e-3 * np.sin(200.0 * time), np.maximum(time, 0.0)
    top = bottom + thickness
    for n in range(1, 80, 2):
        omega = n * 2.0 * np.pi / period
        growth = np.roots([1.0, loss_time * omega**2, omega**2]).astype(complex)
        growth[0] += 1e-6j * omega * (growth[0] == growth[1])
        first, second = growth
        shape = second * np.exp(first * after) - first * np.exp(second * after)
        top = top - 1e-3 * 8.0 / (np.pi * n) ** 2 * (shape / (second - first)).real
    scatter = noise / np.sqrt(2.0) * rng.normal(size=(2, time.size))
    return [Track(time=time, position=end) for end in (bottom + scatter[0], top + scatter[1])]


@pytest.mark.parametrize(('thickness', 'loss_time', 'rate', 'noise', 'count'), [
    (5.6e-3, 1e-4, 1e4, 5e-6, 3),
    (9.5e-3, 2e-5, 1e4, 5e-6, 3),
    (29.1e-3, 0.0, 1e4, 5e-6, 3),
    (16.8e-3, 5e-5, 2e3, 3e-5, 40),
])
def test_periods_and_their_errors_are_correct(thickness, loss_time, rate, noise, count):
    # The tracks contain all modes; the fit has two
    pulls, period = [], 2.0 * thickness / 7.8
    for seed in range(count):
        bottom, top = ends_of(thickness, rate=rate, loss_time=loss_time, noise=noise, seed=seed)
        top.position[7] += 0.01  # an outlier
        found = fit_period(bottom, top)
        pulls.append((found.value - period) / found.error)
        assert found.error < 4e-3 * period or noise > 1e-5
    assert np.abs(pulls).max() < 3.0
    if count == 40:
        assert abs(np.mean(pulls)) < 0.6
        assert np.std(pulls) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize(('position', 'message'), [
    (lambda t: 1e-6 * np.random.default_rng(2).normal(size=t.size), 'ring'),
    (lambda t: np.where(t < 0.098, 0.01, 0.02), 'seen ringing in'),
])
def test_layer_that_does_not_ring_is_refused(position, message):
    time = np.arange(0.0, 0.1, 1e-4)
    rest = Track(time=time, position=np.zeros_like(time))
    with pytest.raises(FitError, match=message):
        fit_period(rest, Track(time=time, position=position(time)))
    with pytest.raises(TrackError, match='at least 12'):
        fit_period(rest, Track(time=time + 3e-5, position=position(time)))


def test_errors_of_the_wave_speed_are_correct():
    rng = np.random.default_rng(7)
    thicknesses = np.array([5.6e-3, 9.5e-3, 16.8e-3, 23.4e-3, 29.1e-3])
    pulls, probabilities = [], []
    for _ in range(400):
        true = thicknesses + 1e-4 * rng.normal(size=5)
        periods = [Estimate(2.0 * t / 7.8 + 1e-5 * rng.normal(), 1e-5) for t in true.tolist()]
        speed, probability = fit_wave_speed(thicknesses.tolist(), periods, thickness_error=1e-4)
        pulls.append((speed.value - 7.8) / speed.error)
        probabilities.append(probability)
    assert abs(np.mean(pulls)) < 0.15
    assert 0.75 < np.std(pulls) < 1.05  # not above, since a large scatter makes errors larger
    assert np.mean(probabilities) == pytest.approx(0.5, abs=0.06)
