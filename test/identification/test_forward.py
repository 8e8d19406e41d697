# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of the projectile by the models of the twin, and its speed in flight."""

import re

import numpy as np
import pytest
from reference import method_of_steps
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.identification.flight import flight_speed
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.tracks import Track

CAUGHT_UP = Rig(layer=Layer(thickness=2e-3), engine=Engine(frequency=31.1), gravity=0.0)


@pytest.mark.parametrize('rig', [Rig(), CAUGHT_UP], ids=['usual', 'caught up'])
def test_trajectory_agrees_with_the_exact_model_at_times_in_any_order(rig):
    time = np.linspace(-0.01, 0.06, 300)
    exact = method_of_steps.follow(rig, until=0.06)
    path = ThrowSimulator().follow(rig, time[::-1])
    assert path.position[::-1] == pytest.approx(exact.projectile_position(time), abs=2e-7)
    assert path.velocity[::-1] == pytest.approx(exact.projectile_velocity(time), abs=5e-4)
    kinds = [[event.kind == 'release' for event in item.events] for item in (path, exact)]
    assert kinds[0] == kinds[1]


def test_landing_is_the_first_one_on_the_way_down():
    landing_time, exact = ThrowSimulator().landing_time, method_of_steps.follow(Rig())
    assert landing_time(Rig(), 0.5) == pytest.approx(exact.events[-1].time, abs=1e-5)
    assert landing_time(Rig(), 0.1) == np.inf
    assert landing_time(CAUGHT_UP, 0.5) == np.inf  # it never falls


def test_throw_beyond_the_time_budget_is_refused():
    slow = Rig(engine=Engine(frequency=0.2), layer=Layer(thickness=1e-3, wave_speed=50.0))
    with pytest.raises(FitError, match=re.escape('30 s of a layer')):
        ThrowSimulator().follow(slow, np.array([0.0, 30.0]))


def test_error_of_the_speed_agrees_with_its_scatter():
    time, random = np.linspace(0.0, 0.016, 40), np.random.default_rng(0)
    heights = 1.4 * time - 0.5 * 9.81 * time**2 + 2e-5 * random.normal(size=(200, time.size))
    tracks = [Track(time=time, position=height) for height in heights]
    values, errors = np.transpose([flight_speed(track, gravity=9.81) for track in tracks])
    scatter = np.std(values)
    assert abs(np.mean(values) - 1.4) < 3.0 * scatter / 200**0.5
    assert 0.8 * scatter < np.mean(errors) < 1.25 * scatter
