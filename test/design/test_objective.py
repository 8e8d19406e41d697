# SPDX-License-Identifier: Apache-2.0
"""What is asked of a layer, in numbers."""

from dataclasses import replace
import math

import numpy as np
import pytest
from soft_throw_ros.core.rig import Engine, Projectile, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.objective import Limits, Peak, problem_of, Robust, Versatile
from soft_throw_ros.design.search import releases, score
from soft_throw_ros.design.uncertainty import Uncertainties


def test_peak_is_the_energy_of_the_throw():
    rig = Rig()
    assert score(problem_of(rig, Peak(), Limits())) ** 2 == pytest.approx(
        simulate(rig).energy_transfer, rel=1e-5
    )


def test_versatile_throws_each_projectile_at_each_frequency():
    rig = Rig(gravity=0.0)
    masses, frequencies = (1e-3, 2.4e-3), (40.0, 63.2, 90.0)
    problem = problem_of(rig, Versatile(masses=masses, frequencies=frequencies), Limits())
    transfers = [
        simulate(
            replace(
                rig,
                engine=replace(rig.engine, frequency=frequency),
                projectile=Projectile(mass=mass),
            )
        ).energy_transfer
        for mass in masses
        for frequency in frequencies
    ]
    assert releases(problem)[2] ** 2 == pytest.approx(transfers, rel=1e-10)
    assert score(problem) ** 2 == pytest.approx(min(transfers), rel=1e-10)
    assert problem.checked == 6


def test_robust_is_the_worst_of_all_corners_and_of_many_points_between():
    rig, uncertainties = Rig(gravity=0.0), Uncertainties()
    problem = problem_of(rig, Robust(uncertainties=uncertainties), Limits())
    assert problem.throws[0].tolist() == [1.0, 1.0, 0.064, 0.0, 0.0]
    assert problem.checked == 1
    corners = {tuple(np.sign(row)) for row in problem.throws[1:33] - problem.throws[0]}
    assert len(corners) == 32
    sizes = np.abs(problem.throws - problem.throws[0]).max(axis=0)
    expected = [0.01, 0.1 / 63.2, 0.003, 0.1 / 16.8, 0.3 / 7.8]
    assert sizes == pytest.approx(expected, rel=1e-9)
    worst = score(problem) ** 2
    assert worst < score(problem_of(rig, Peak(), Limits())) ** 2
    random = np.random.default_rng(1)
    many = uncertainties.throws(rig, random.uniform(-1.0, 1.0, (3000, 5)))
    assert releases(problem._replace(throws=many))[2].min() ** 2 > worst * (1.0 - 1e-3)


def test_quantile_is_that_of_random_throws():
    rig, uncertainties = Rig(gravity=0.0), Uncertainties()
    problem = problem_of(rig, Robust(uncertainties=uncertainties, quantile=0.05), Limits())
    random = np.random.default_rng(2)
    many = uncertainties.throws(rig, random.uniform(-1.0, 1.0, (3000, 5)))
    transfers = releases(problem._replace(throws=many))[2] ** 2
    assert np.mean(transfers < score(problem) ** 2) == pytest.approx(0.05, abs=0.02)


def test_limits_are_in_the_units_of_the_throw():
    rig = Rig(gravity=0.0)
    throw = simulate(rig)
    strain, acceleration = throw.peak_strain.value, throw.peak_acceleration
    limits = Limits(max_strain=strain, max_acceleration=acceleration)
    problem = problem_of(rig, Peak(), limits, target_speed=2.0)
    scale = rig.engine.speed_scale
    assert problem.strain * scale / rig.layer.wave_speed == pytest.approx(strain)
    assert problem.acceleration * scale * rig.engine.angular_frequency == pytest.approx(
        acceleration
    )
    assert problem.target * scale == pytest.approx(2.0)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda: Limits(thickness_min=0.06),
         'thickness_min must be below thickness_max, got 0.06 and 0.05'),
        (lambda: Limits(wave_speed_max=1.0),
         'wave_speed_min must be below wave_speed_max, got 1 and 1'),
        (lambda: Limits(thickness_min=0.0),
         r'thickness_min must be finite and positive, got 0\.0'),
        (lambda: Limits(wave_speed_max=math.inf), 'wave_speed_max must be finite.*, got inf'),
        (lambda: Limits(max_strain=-0.1), r'max_strain must be finite and positive, got -0\.1'),
        (lambda: Robust(quantile=1.0), r'quantile must be .*, got 1\.0'),
        (lambda: Versatile(masses=(), frequencies=(60.0,)), 'masses must be at least one number'),
        (lambda: Versatile(masses=(1e-3,), frequencies=(0.0,)),
         r'frequencies must be finite and positive, got 0\.0'),
        (lambda: problem_of(Rig(engine=Engine(frequency=0.1)), Robust(), Limits()),
         r'uncertainty\.frequency must be below the frequency itself, 0\.1, got 0\.1'),
    ],
)  # fmt: skip
def test_bad_requests_are_refused_with_the_value(make, message):
    with pytest.raises(ValueError, match=message):
        make()
