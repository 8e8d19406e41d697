# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Forecast of a release by the fitted motion of the engine."""

from __future__ import annotations

import math

import numpy as np
import pytest
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Engine
from soft_throw_ros.core.stepper import TIME
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.twin.engine_fit import (
    AMPLITUDE,
    DAMPING,
    engine_states,
    EngineEstimate,
    FREQUENCY,
    START,
)
from soft_throw_ros.twin.engine_forecast import EngineForecaster
from soft_throw_ros.twin.prepared_rig import PreparedRig
from twin_runs import BEGIN, complete_settings, PLATE


@pytest.fixture(scope='module')
def forecaster() -> EngineForecaster:
    settings = complete_settings(engine__motion='measured')
    return PreparedRig.from_config(TwinConfig.from_settings(settings)).forecaster


def estimate(unknowns=0.0, covariance=0.0) -> EngineEstimate:
    return EngineEstimate(BEGIN, PLATE, unknowns * np.ones(5), covariance * np.eye(5))


def throw(engine: Engine) -> tuple[float, float]:
    """Return time and speed of a release by powers of the engine's values."""
    time = 0.6 / engine.frequency * math.exp(0.5 * engine.damping_ratio)
    return time, engine.amplitude**2 * engine.frequency**3 * math.exp(-engine.damping_ratio)


def test_changes_of_a_release_are_derivatives_even_without_damping(forecaster) -> None:
    engine = Engine(damping_ratio=0.0)
    ours = EngineForecaster.of(engine, throw, forecaster.stepper)
    time, _ = throw(engine)
    expected = {
        AMPLITUDE: (0.0, 2.0, 2.0),
        START: (1.0, 0.0, 0.0),
        FREQUENCY: (-time, 3.0, 4.0),
        DAMPING: (0.5 * time, -1.0, math.pi - 2.0),  # -pi / 2 of ln V_p, Eq. (D4)
    }
    for unknown, derivatives in expected.items():
        change = ours.change(estimate(1.0), estimate(1.0 + np.eye(5)[unknown]))
        assert change == pytest.approx(derivatives, rel=1e-2)


def test_standard_errors_follow_from_the_covariance(forecaster) -> None:
    gradient = np.array([[0.0, 5.0, 0, 0, 0], [3.0, 0, 4.0, 0, 0], [0, 0, 0, 1.0, -1.0]])
    ours = EngineForecaster(1.0, gradient, forecaster.stepper)
    assert ours.errors(estimate(covariance=4.0)) == pytest.approx(
        (10.0, 10.0, math.sqrt(8.0)), rel=1e-14
    )
    correlated = estimate()
    correlated.covariance[:] = 4.0
    assert ours.errors(correlated) == pytest.approx((10.0, 14.0, 0.0), rel=1e-14)


@pytest.mark.parametrize('lost', range(7))
def test_engine_or_neighbour_without_a_release_has_no_forecaster(forecaster, lost) -> None:
    releases = [(0.01, 1.0)] * 7  # two for each of three unknowns, and that of the engine
    releases[lost] = None
    assert EngineForecaster.of(Engine(), lambda _: releases.pop(0), forecaster.stepper) is None


def test_release_is_simulated_in_pieces_by_the_first_good_estimate(forecaster) -> None:
    exact, uncertain = simulate(forecaster.stepper.rig), estimate(covariance=1e-4)
    error, piece = 1.96 * forecaster.errors(uncertain).speed, exact.ejection_time / 4.5
    find_release = forecaster.find_release
    assert find_release(estimate(), max_error=0.0, duration=piece) is None
    forecaster.reset()
    assert find_release(uncertain, max_error=0.999 * error, duration=1.0) is None
    assert find_release(uncertain, max_error=1.001 * error, duration=piece) is None
    for k in (2, 3, 4):
        assert find_release(estimate(), max_error=0.0, duration=piece) is None
        assert forecaster.stepper.state[TIME] == pytest.approx(k * piece, rel=1e-12)
    used, release = find_release(estimate(), max_error=0.0, duration=piece)
    assert used is uncertain
    assert release.time == pytest.approx(exact.ejection_time, rel=1e-6)
    assert release.velocity == pytest.approx(exact.ejection_speed, rel=1e-6)


def test_states_of_the_engine_have_64_pieces_in_a_period() -> None:
    period = 1.0 / PLATE.frequency
    times, states = engine_states(PLATE, 0.0, period)
    np.testing.assert_allclose(times, period * np.arange(65) / 64, rtol=1e-14)
    fine = np.linspace(0.0, period, 1001)
    error = SampledMotion(times, states).position(fine) - PLATE.position(fine)
    assert np.abs(error).max() < 5e-11 * PLATE.amplitude
    later, _ = engine_states(PLATE, period, 1.5 * period)
    np.testing.assert_allclose(later, period * np.arange(65, 97) / 64, rtol=1e-14)
