# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Wave speed and loss from layers that ring."""

import numpy as np
import pytest
from soft_throw_ros.identification.least_squares import Estimate, FitError
from soft_throw_ros.identification.ringing import (
    change_of_length,
    fit_loss_tangent,
    fit_ringing,
    fit_wave_speed,
)
from soft_throw_ros.identification.tracks import Track, TrackError


def squeezed(thickness, wave_speed, loss_time, time, *, squeeze=1e-3, modes=40):
    """
    Length of a free bar that was squeezed evenly and let go at time 0.

    By all modes of the wave equation with Kelvin-Voigt loss, each from rest.
    """
    length = np.full(time.shape, thickness)
    after = np.maximum(time, 0.0)
    for n in range(1, 2 * modes, 2):
        omega = n * np.pi * wave_speed / thickness
        growth = np.roots([1.0, loss_time * omega**2, omega**2]).astype(complex)
        growth[0] += 1e-6j * omega * (growth[0] == growth[1])
        first, second = growth
        shape = (second * np.exp(first * after) - first * np.exp(second * after)) / (
            second - first
        )
        length = length - squeeze * 8.0 / (np.pi * n) ** 2 * shape.real
    return length


def track_of(thickness, *, rate=10000.0, wave_speed=7.8, loss_time=1e-5, noise=5e-6, seed=0):
    period = 2.0 * thickness / wave_speed
    time = np.arange(-2.0 * period, 12.0 * period, 1.0 / rate)
    scatter = noise * np.random.default_rng(seed).normal(size=time.size)
    return Track(time=time, position=squeezed(thickness, wave_speed, loss_time, time) + scatter)


@pytest.mark.parametrize('thickness', [5.6e-3, 9.5e-3, 29.1e-3])
@pytest.mark.parametrize('loss_time', [0.0, 2e-5, 1e-4])
def test_period_and_loss_of_a_bar_are_found(thickness, loss_time):
    # The track contains all modes; the fit has two
    found = fit_ringing(track_of(thickness, loss_time=loss_time))
    period = 2.0 * thickness / 7.8
    loss = 2.0 * np.pi / period * loss_time
    assert found.period.value == pytest.approx(period, abs=3.0 * found.period.error)
    assert found.period.error < 4e-3 * period
    assert found.loss_tangent.value == pytest.approx(loss, abs=3.0 * found.loss_tangent.error)
    assert found.loss_tangent.error < 0.01
    assert found.start_time == pytest.approx(0.0, abs=0.2 * period)


def test_ringing_is_unbiased_and_its_errors_are_correct():
    truth = np.array([2.0 * 16.8e-3 / 7.8, 5e-5 * np.pi * 7.8 / 16.8e-3])
    pulls = []
    for seed in range(40):
        found = fit_ringing(track_of(16.8e-3, rate=2000.0, noise=3e-5, loss_time=5e-5, seed=seed))
        values, errors = np.transpose([found.period, found.loss_tangent])
        pulls.append((values - truth) / errors)
    assert np.abs(np.mean(pulls, axis=0)).max() < 0.6
    assert np.std(pulls, axis=0) == pytest.approx(np.ones(2), abs=0.35)


@pytest.mark.parametrize(
    ('position', 'message'),
    [
        (lambda t: 1e-6 * np.random.default_rng(2).normal(size=t.size), 'does not ring|not seen'),
        (lambda t: np.where(t < 0.098, 0.01, 0.02), 'not seen ringing'),
    ],
)
def test_layer_that_does_not_ring_is_refused(position, message):
    time = np.arange(0.0, 0.1, 1e-4)
    with pytest.raises(FitError, match=message):
        fit_ringing(Track(time=time, position=position(time)))


def test_change_of_length_is_measured_where_both_ends_are_seen():
    time = np.arange(40) * 1e-3
    bottom = Track(time=time[:30], position=time[:30], known_noise=3e-6)
    top = Track(time=time[10:], position=0.02 + 3.0 * time[10:], known_noise=4e-6)
    length = change_of_length(bottom, top)
    assert length.time == pytest.approx(time[10:30])
    assert length.position == pytest.approx(0.02 + 2.0 * time[10:30])
    assert length.noise == pytest.approx(5e-6)
    with pytest.raises(TrackError, match='both ends of the layer are seen at 0 moments'):
        change_of_length(bottom, Track(time=time + 1e-4, position=time))


def test_errors_of_the_wave_speed_are_correct():
    rng = np.random.default_rng(7)
    thicknesses = np.array([5.6e-3, 9.5e-3, 16.8e-3, 23.4e-3, 29.1e-3])
    pulls, agreements = [], []
    for _ in range(400):
        true = thicknesses + 1e-4 * rng.normal(size=5)
        periods = [Estimate(2.0 * t / 7.8 + 1e-5 * rng.normal(), 1e-5) for t in true.tolist()]
        found = fit_wave_speed(thicknesses.tolist(), periods, thickness_error=1e-4)
        pulls.append((found.value.value - 7.8) / found.value.error)
        agreements.append(found.agreement)
    assert abs(np.mean(pulls)) < 0.15
    assert 0.75 < np.std(pulls) < 1.05  # not above, since a large scatter makes errors larger
    assert np.mean(agreements) == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize(('factor', 'agrees'), [(1.0, True), (1.5, False)])
def test_losses_agree_for_layers_of_one_material(factor, agrees):
    ringings = [
        fit_ringing(track_of(thickness, loss_time=loss_time, seed=seed))
        for seed, (thickness, loss_time) in enumerate([(9.5e-3, 1e-4), (16.8e-3, factor * 1e-4)])
    ]
    found = fit_loss_tangent(ringings, frequency=63.2)
    assert (found.agreement > 1e-4) == agrees
    truths = 2.0 * np.pi * 63.2 * 1e-4 * np.array([1.0, factor])
    assert np.abs(truths - found.value.value).max() < 3.0 * found.value.error


def test_loss_without_a_layer_is_refused():
    with pytest.raises(ValueError, match='none'):
        fit_loss_tangent([], frequency=63.2)
