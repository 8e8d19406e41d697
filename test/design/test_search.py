# SPDX-License-Identifier: Apache-2.0
"""The search against scans that are finer than any cliff or summit."""

import math

import numpy as np
import pytest
from soft_throw_ros.core.travelling_wave import first_release_kernel, MAX_INTERVALS
from soft_throw_ros.design.search import find_summit

FIXED = (1.0, 1.0)


def scan(ratios, thickness_factors, wave_speed_factors, *, line_points, columns, rows, least=0.0):
    """Return the largest speed of a grid of layers, from what is not slower without gravity."""
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio = ratios
    is_line = FIXED in (thickness_factors, wave_speed_factors)
    grids = [
        np.geomspace(*factors, 1 if factors == FIXED else line_points if is_line else points)
        for factors, points in ((thickness_factors, columns), (wave_speed_factors, rows))
    ]
    work = np.empty((2, MAX_INTERVALS))
    best = -1.0
    for thickness in grids[0].tolist():
        mu = mass_ratio / thickness
        for wave_speed in grids[1].tolist():
            kappa = speed_ratio * wave_speed / thickness
            _, speed, status = first_release_kernel(mu, kappa, damping_ratio, 0.0, work)
            if status == 0 and gravity_ratio > 0.0 and speed > max(least, best):
                _, speed, status = first_release_kernel(
                    mu, kappa, damping_ratio, gravity_ratio, work
                )
            if status == 0 and speed > best:
                best = speed
    return best


def random_limits(random, low, high):
    """Return two factors within bounds, at times the bounds."""
    if random.random() < 0.3:
        return low, high
    first, second = sorted(np.exp(random.uniform(math.log(low), math.log(high), 2)))
    return float(first), float(second)


def random_case(seed, *, gravity_ratio=0.0):
    """Return ratios and limits as of a rig of 1 to 50 mm and 1 to 50 m/s, at 5 to 300 Hz."""
    random = np.random.default_rng(seed)
    thickness, wave_speed = np.exp(random.uniform(np.log([1e-3, 1.0]), np.log([0.05, 50.0])))
    frequency = math.exp(random.uniform(math.log(5.0), math.log(300.0)))
    mass_ratio = math.exp(random.uniform(math.log(0.02), math.log(200.0)))
    damping_ratio = random.choice([0.0, 0.064, random.uniform(0.0, 0.9)])
    ratios = (mass_ratio, wave_speed / (thickness * frequency), damping_ratio, gravity_ratio)
    return (
        tuple(map(float, ratios)),
        random_limits(random, 0.5e-3 / thickness, 0.1 / thickness),
        random_limits(random, 1.0 / wave_speed, 200.0 / wave_speed),
    )


def find(ratios, thickness_factors, wave_speed_factors):
    names = ('mass_ratio', 'speed_ratio', 'damping_ratio', 'gravity_ratio')
    return find_summit(
        **dict(zip(names, ratios, strict=True)),
        thickness_factors=thickness_factors,
        wave_speed_factors=wave_speed_factors,
    )


def check_summit(ratios, thickness_factors, wave_speed_factors, best):
    """Assert that nothing in a scan is better by 0.1 %, and that the summit is what it says."""
    if best**2 < 0.1:
        return  # see the notes of the module
    summit = find(ratios, thickness_factors, wave_speed_factors)
    assert summit.speed**2 >= best**2 * (1.0 - 1e-3)
    assert thickness_factors[0] <= summit.thickness_factor <= thickness_factors[1]
    assert wave_speed_factors[0] <= summit.wave_speed_factor <= wave_speed_factors[1]
    _, speed, status = first_release_kernel(
        ratios[0] / summit.thickness_factor,
        ratios[1] * summit.wave_speed_factor / summit.thickness_factor,
        *ratios[2:],
        np.empty((2, MAX_INTERVALS)),
    )
    assert status == 0
    assert speed == pytest.approx(summit.speed, rel=1e-9)


@pytest.mark.parametrize('seed', range(40))
def test_summit_is_the_highest_of_a_line_and_of_a_rectangle(seed):
    ratios, thickness, wave_speed = random_case(seed)
    for limits in ((thickness, FIXED), (FIXED, wave_speed), (thickness, wave_speed)):
        best = scan(ratios, *limits, line_points=1500, columns=40, rows=100)
        check_summit(ratios, *limits, best)


def test_summit_is_not_a_lower_one_nearby():
    # two summits, 0.14 % apart, between columns
    ratios = (16.201349557777814, 46.31239233168267, 0.064, 0.0)
    limits = (1.2068060867246776, 11.244601462706031), (3.0844739364735827, 21.767146556157)
    best = scan(ratios, *limits, line_points=1, columns=150, rows=300)
    check_summit(ratios, *limits, best)


@pytest.mark.parametrize('gravity_ratio', [0.031, 0.13])
@pytest.mark.parametrize('seed', range(8))
def test_summit_is_the_highest_with_gravity_where_layers_throw_well(seed, gravity_ratio):
    """As the paper's engines have it."""
    random = np.random.default_rng(seed)
    ratios = (
        float(np.exp(random.uniform(-2.0, 1.0))), float(np.exp(random.uniform(1.0, 3.0))),
        0.064, gravity_ratio,
    )  # fmt: skip
    thickness, wave_speed = random_limits(random, 0.25, 4.0), random_limits(random, 0.25, 4.0)
    for limits in ((thickness, FIXED), (FIXED, wave_speed), (thickness, wave_speed)):
        best = scan(ratios, *limits, line_points=600, columns=30, rows=60, least=0.8)
        check_summit(ratios, *limits, best)


def test_cliff_within_the_limits_is_climbed_from_the_right_side():
    # released before three crossings the speed does not depend on the thickness; beyond a cliff
    # it is larger
    ratios = (1.0, 6.0, 0.3, 0.0)
    summit = find(ratios, (0.95, 1.2), FIXED)
    assert summit.speed >= scan(ratios, (0.95, 1.2), FIXED, line_points=4000, columns=1, rows=1)


def test_thinner_one_of_equal_layers_is_preferred():
    ratios = (0.1, 1.0, 0.0, 0.0)  # a plateau
    assert find(ratios, (0.8, 1.5), FIXED).thickness_factor == pytest.approx(0.8)
    assert find(ratios, (0.8, 1.5), (0.9, 1.1)) == pytest.approx(
        (0.8, 1.1, find(ratios, FIXED, (0.9, 1.1)).speed)
    )


def test_nothing_to_vary_gives_the_layer_itself():
    summit = find((0.6, 7.0, 0.0, 0.0), FIXED, FIXED)
    assert summit.thickness_factor == summit.wave_speed_factor == 1.0
    assert summit.speed > 1.0


def test_no_throw_at_all_is_not_a_number():
    assert math.isnan(find((1.0, 5.0, 0.3, 5.0), (0.9, 1.1), FIXED).speed)
    assert math.isnan(find((1e9, 1e6, 0.0, 0.0), (0.5, 2.0), (0.5, 2.0)).speed)
