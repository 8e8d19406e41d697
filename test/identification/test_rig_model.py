# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The model of a fit: trajectories, derivatives, and the speed in flight."""

import numpy as np
import pytest
from reference import method_of_steps
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.identification.fit_description import (
    FitDescription,
    FREE,
    IDEAL_BENCH,
    PARAMETERS,
    Treatment,
)
from soft_throw_ros.identification.flight import flight_speed
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.rig_fit import fit_plates
from soft_throw_ros.identification.rig_model import ThrowSimulator
from soft_throw_ros.identification.tracks import Track

CAUGHT_UP = Rig(layer=Layer(thickness=2e-3), engine=Engine(frequency=31.1), gravity=0.0)


@pytest.mark.parametrize('rig', [Rig(), CAUGHT_UP], ids=['usual', 'caught up'])
def test_trajectory_agrees_with_the_exact_model_at_times_in_any_order(rig):
    time = np.linspace(-0.01, 0.06, 300)
    exact = method_of_steps.follow(rig, until=0.06)
    path = ThrowSimulator().follow(rig, time[::-1])
    assert path.height[::-1] == pytest.approx(exact.projectile_position(time), abs=2e-7)
    assert path.velocity[::-1] == pytest.approx(exact.projectile_velocity(time), abs=5e-4)
    kinds = [[event.kind == 'release' for event in item.events] for item in (path, exact)]
    assert kinds[0] == kinds[1]


def test_landing_is_the_first_one_on_the_way_down_and_slow_throws_are_refused():
    landing_time, exact = ThrowSimulator().landing_time, method_of_steps.follow(Rig())
    assert landing_time(Rig(), 0.5) == pytest.approx(exact.events[-1].time, abs=1e-5)
    assert landing_time(Rig(), 0.1) == np.inf
    assert landing_time(CAUGHT_UP, 0.5) == np.inf  # it never falls
    slow = Rig(engine=Engine(frequency=0.2), layer=Layer(thickness=1e-3, wave_speed=50.0))
    with pytest.raises(FitError, match='30 s of a layer'):  # beyond the time for a simulation
        landing_time(slow, 30.0)


def test_model_of_two_throws_has_right_derivatives_and_cuts(make_throw):
    delay = 'projectile.delay'
    description = FitDescription({
        **IDEAL_BENCH,
        'engine.amplitude': FREE._replace(is_per_throw=True),
        'layer.thickness': Treatment(True, error=1e-4),
        'projectile.mass': Treatment(True, error=0.02, is_relative=True),
        delay: Treatment(True, error=1e-4),
        'plate.drift': Treatment(True, error=0.02, is_per_throw=True),
    })
    throws = [make_throw(Rig(), rate=1000.0, duration=0.05, start=s) for s in (0.0102, 0.0113)]
    model = fit_plates(throws, Rig(), description, ThrowSimulator())
    names, values = model.names, model.start()
    values[[names.index(delay), names.index('plate.drift[1]')]] += [3e-5, 0.01]
    jacobian = model.jacobian(values)
    assert jacobian.shape == (model.predict(values).size, len(names))
    for index, name in enumerate(names):
        step = np.zeros_like(values)
        step[index] = 1e-5 if name.startswith(('start', delay)) else 1e-3
        if name.partition('[')[0] in PARAMETERS:
            step[index] *= values[index]
        slope = (model.predict(values + step) - model.predict(values - step)) / (2 * step[index])
        assert 0.02 * np.linalg.norm(slope) > np.linalg.norm(jacobian[:, index] - slope), name
    for number, cut in enumerate(model.cut_after(0.02).throws):
        assert cut.projectile.time[-1] <= model.start_of(number) + 0.02 < cut.plate.time[-1]
    assert model.cut_after(-1.0).projectiles == []


def test_error_of_the_speed_agrees_with_its_scatter():
    time, random = np.linspace(0.0, 0.016, 40), np.random.default_rng(0)
    heights = 1.4 * time - 0.5 * 9.81 * time**2 + 2e-5 * random.normal(size=(200, time.size))
    tracks = [Track(time=time, position=height) for height in heights]
    values, errors = np.transpose([flight_speed(track, gravity=9.81) for track in tracks])
    scatter = np.std(values)
    assert abs(np.mean(values) - 1.4) < 3.0 * scatter / 200**0.5
    assert 0.8 * scatter < np.mean(errors) < 1.25 * scatter
