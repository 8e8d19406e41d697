# SPDX-License-Identifier: Apache-2.0
"""The search against scans that are finer than any cliff or summit."""

import itertools
import math

import numpy as np
import pytest
from soft_throw_ros.core import normal_modes, peak, plate, swings, travelling_wave
from soft_throw_ros.design.search import (
    find_summit,
    LATEST,
    one_throw,
    Problem,
    releases,
    score,
)

FIXED = (1.0, 1.0)
UNRESOLVED = {'unresolved': 'nan'}


def make(mass_ratio, speed_ratio, damping_ratio=0.0, gravity_ratio=0.0, loss_tangent=0.0, **rest):
    """Make a problem, by default of the one throw."""
    throws = rest.pop('throws', one_throw(damping_ratio))
    return Problem(mass_ratio, speed_ratio, gravity_ratio, loss_tangent, throws, **rest)


def grid(thickness_factors, wave_speed_factors, columns, rows):
    """List layers between the factors."""
    thickness = np.geomspace(*thickness_factors, 1 if thickness_factors == FIXED else columns)
    wave_speed = np.geomspace(*wave_speed_factors, 1 if wave_speed_factors == FIXED else rows)
    return (axis.ravel() for axis in np.meshgrid(thickness, wave_speed, indexing='ij'))


def ratios_of(problem, row, thickness, wave_speed):
    """Return what decides one of the throws from layers."""
    mass, frequency, damping_ratio, more_thickness, more_speed = row
    thickness, wave_speed = thickness + more_thickness, wave_speed + more_speed
    return {
        'mass_ratio': problem.mass_ratio * mass / thickness,
        'speed_ratio': problem.speed_ratio * wave_speed / (thickness * frequency),
        'damping_ratio': damping_ratio,
        'gravity_ratio': problem.gravity_ratio / frequency**2,
    }


def speeds_of(problem, row, thickness, wave_speed):
    """Throw from layers; -1 is no throw."""
    ratios = ratios_of(problem, row, thickness, wave_speed)
    if problem.loss_tangent:
        release = normal_modes.first_releases(
            **ratios, loss_tangent=problem.loss_tangent, **UNRESOLVED
        )
        speed = np.where(release.ejection_phase < LATEST, release.speed, np.nan)
    elif problem.gravity_ratio:
        kernel = np.vectorize(swings.first_release_kernel)
        _, speed, _ = kernel(*(ratios[name] for name in ratios), LATEST)
    else:
        speed = travelling_wave.first_releases(**ratios, **UNRESOLVED).speed
    return np.nan_to_num(speed, nan=-1.0) / plate.peak_velocity_ratio(row[2])


def loads_of(problem, row, thickness, wave_speed):
    """Return strain, in A w / c_s of the given layer, and acceleration of a throw."""
    ratios = ratios_of(problem, row, thickness, wave_speed)
    if problem.loss_tangent:
        peaks = normal_modes.first_peaks(**ratios, loss_tangent=problem.loss_tangent)
    else:
        peaks = peak.first_peaks(**ratios)
    frequency, speed = row[1], wave_speed + row[4]
    return peaks.strain * frequency / speed, peaks.acceleration * frequency**2


def is_within(problem, thickness, wave_speed):
    """Tell whether the throws that are checked keep the limits."""
    if min(problem.strain, problem.acceleration) == math.inf:
        return True
    loads = [
        loads_of(problem, row, thickness, wave_speed) for row in problem.throws[: problem.checked]
    ]
    return all(
        strain <= problem.strain and acceleration <= problem.acceleration
        for strain, acceleration in loads
    )


def highest(problem, thickness_factors, wave_speed_factors, *, columns, rows):
    """Return the highest score of a grid of layers, -1 if there is none."""
    thickness, wave_speed = grid(thickness_factors, wave_speed_factors, columns, rows)
    speeds = [speeds_of(problem, row, thickness, wave_speed) for row in problem.throws]
    scores = np.quantile(speeds, problem.quantile, axis=0)
    for i in np.argsort(-scores):
        if scores[i] <= 0.0:
            break
        if is_within(problem, thickness[i], wave_speed[i]):
            return scores[i]
    return -1.0


def check(problem, thickness_factors, wave_speed_factors, *, columns=40, rows=100, line=1500):
    """Assert that no layer of a grid has 0.1 % more energy, and that the summit is one."""
    if FIXED in (thickness_factors, wave_speed_factors):
        columns = rows = line
    best = highest(problem, thickness_factors, wave_speed_factors, columns=columns, rows=rows)
    if best < 0.3:
        return  # see the notes of the module
    summit = find_summit(
        problem, thickness_factors=thickness_factors, wave_speed_factors=wave_speed_factors
    )
    assert summit.score**2 >= best**2 * (1.0 - 1e-3)
    place = summit.thickness_factor, summit.wave_speed_factor
    assert thickness_factors[0] <= place[0] <= thickness_factors[1]
    assert wave_speed_factors[0] <= place[1] <= wave_speed_factors[1]
    assert is_within(problem, *place) or math.isclose(place[0], 1.0)
    moved = tuple(np.array([factor]) for factor in place)
    speeds = [speeds_of(problem, row, *moved)[0] for row in problem.throws]
    assert np.quantile(speeds, problem.quantile) == pytest.approx(summit.score, rel=1e-9)


def between(random, low, high):
    """Draw a number, evenly in its logarithm."""
    return math.exp(random.uniform(math.log(low), math.log(high)))


def limits_between(random, low, high):
    """Draw two factors within bounds, at times the bounds."""
    if random.random() < 0.3:
        return low, high
    first, second = sorted(between(random, low, high) for _ in range(2))
    return first, second


def off(random, damping_ratio, count=24):
    """Draw throws that are a little off."""
    sizes = [0.01, 0.0016, 0.003, 0.006, 0.038]
    throws = one_throw(damping_ratio) + random.uniform(-1.0, 1.0, (count, 5)) * sizes
    throws[0] = one_throw(damping_ratio)
    throws[:, 2] = np.abs(throws[:, 2])
    return throws


@pytest.mark.parametrize('seed', range(40))
def test_summit_is_the_highest_of_a_line_and_of_a_rectangle(seed):
    """As of rigs of 1 to 50 mm and 1 to 50 m/s, at 5 to 300 Hz."""
    random = np.random.default_rng(seed)
    thickness, wave_speed = between(random, 1e-3, 0.05), between(random, 1.0, 50.0)
    speed_ratio = wave_speed / (thickness * between(random, 5.0, 300.0))
    damping_ratio = float(random.choice([0.0, 0.064, random.uniform(0.0, 0.9)]))
    problem = make(between(random, 0.02, 200.0), speed_ratio, damping_ratio)
    thick = limits_between(random, 0.5e-3 / thickness, 0.1 / thickness)
    fast = limits_between(random, 1.0 / wave_speed, 200.0 / wave_speed)
    for limits in ((thick, FIXED), (FIXED, fast), (thick, fast)):
        check(problem, *limits)


def test_summit_is_not_a_lower_one_nearby():
    # two summits, 0.14 % apart, between columns
    problem = make(16.201349557777814, 46.31239233168267, 0.064)
    limits = (1.2068060867246776, 11.244601462706031), (3.0844739364735827, 21.767146556157)
    check(problem, *limits, columns=150, rows=300)


CASES = {
    'gravity': lambda random: {'gravity_ratio': float(random.choice([0.031, 0.13]))},
    'strong gravity': lambda random: {'gravity_ratio': between(random, 0.2, 3.0)},
    'loss': lambda random: {'loss_tangent': between(random, 0.003, 0.5), 'gravity_ratio': 0.031},
    'limits': lambda random: {
        'checked': 1, 'strain': random.uniform(0.3, 1.5), 'acceleration': random.uniform(1.0, 3.0)
    },
    'limits and loss': lambda random: {
        'checked': 1, 'strain': random.uniform(0.3, 1.5), 'loss_tangent': 0.1
    },
    'worst case': lambda random: {'throws': off(random, 0.064)},
    'quantile': lambda random: {'throws': off(random, 0.064), 'quantile': 0.05},
    'worst case with loss': lambda random: {'throws': off(random, 0.064, 8), 'loss_tangent': 0.05},
    'several throws': lambda random: {
        'throws': np.array([
            (mass, frequency, 0.064, 0.0, 0.0)
            for mass, frequency in itertools.product((1.0, random.uniform(1.2, 4.0)), (1.0, 0.5))
        ])
    },
}  # fmt: skip


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('kind', CASES)
def test_summit_is_the_highest_whatever_is_asked(kind, seed):
    random = np.random.default_rng(seed)
    speed_ratio = between(random, 3.0, 30.0)
    mass_ratio = between(random, 0.1, 3.0)
    problem = make(mass_ratio, speed_ratio, 0.064, **CASES[kind](random))
    size = {'columns': 15, 'rows': 40} if 'gravity' in kind or 'loss' in kind else {}
    check(problem, limits_between(random, 0.2, 4.0), limits_between(random, 0.3, 3.0), **size)


@pytest.mark.parametrize('seed', range(4))
def test_largest_amplitude_within_the_limits_counts_if_it_is_free(seed):
    random = np.random.default_rng(seed)
    strain, acceleration = random.uniform(0.3, 1.5), random.uniform(1.0, 3.0)
    problem = make(
        between(random, 0.1, 3.0), between(random, 3.0, 30.0), 0.064,
        checked=1, strain=strain, acceleration=acceleration, cap=2.0,
    )  # fmt: skip

    def speed(thickness, wave_speed):
        """Compute what the layer gives at the largest amplitude, in parts of the cap."""
        layer = np.array([thickness]), np.array([wave_speed])
        loads = loads_of(problem, problem.throws[0], thickness, wave_speed)
        allowed = min(strain / loads[0], acceleration / loads[1], 2.0)
        return speeds_of(problem, problem.throws[0], *layer)[0] * allowed / 2.0

    best = max(speed(*layer) for layer in zip(*grid((0.3, 3.0), (0.3, 3.0), 15, 30), strict=True))
    summit = find_summit(problem, thickness_factors=(0.3, 3.0), wave_speed_factors=(0.3, 3.0))
    assert summit.score >= best * (1.0 - 5e-4)
    assert summit.score == pytest.approx(speed(*summit[:2]), rel=1e-6)


def test_limits_of_the_amplitude_that_is_needed_hold():
    """The same layer at an amplitude that gives half the speed is strained half as much."""
    free = find_summit(make(0.6, 7.0, 0.064), thickness_factors=(0.5, 3.0))
    layer = free.thickness_factor, 1.0
    speed = releases(make(0.6 / layer[0], 7.0 / layer[0], 0.064))[1][0]
    strain = loads_of(make(0.6, 7.0), one_throw(0.064)[0], *layer)[0]
    asked = make(0.6, 7.0, 0.064, checked=1, strain=0.5001 * strain, target=0.5 * speed)
    assert find_summit(asked, thickness_factors=(0.5, 3.0)) == pytest.approx(free, rel=1e-6)
    asked = asked._replace(strain=0.499 * strain)
    assert find_summit(asked, thickness_factors=(0.5, 3.0)).score < free.score * (1.0 - 1e-5)


def test_cliff_within_the_limits_is_climbed_from_the_right_side():
    # released before three crossings the speed does not depend on the thickness; beyond a cliff
    # it is larger
    problem = make(1.0, 6.0, 0.3)
    summit = find_summit(problem, thickness_factors=(0.95, 1.2))
    assert summit.score >= highest(problem, (0.95, 1.2), FIXED, columns=4000, rows=1)


def test_thinner_one_of_equal_layers_is_preferred():
    problem = make(0.1, 1.0)  # a plateau
    line = find_summit(problem, thickness_factors=(0.8, 1.5))
    assert line.thickness_factor == pytest.approx(0.8)
    best = find_summit(problem, wave_speed_factors=(0.9, 1.1)).score
    both = find_summit(problem, thickness_factors=(0.8, 1.5), wave_speed_factors=(0.9, 1.1))
    assert both == pytest.approx((0.8, 1.1, best))


def test_nothing_to_vary_gives_the_layer_itself():
    problem = make(0.6, 7.0)
    summit = find_summit(problem)
    assert summit.thickness_factor == summit.wave_speed_factor == 1.0
    assert summit.score == score(problem) > 1.0


def test_releases_are_in_the_units_of_the_given_throw():
    throws = np.array([(1.0, 1.0, 0.064, 0.0, 0.0), (1.0, 0.5, 0.064, 0.0, 0.0)])
    phases, speeds, relative = releases(make(0.6, 7.0, throws=throws))
    for i, frequency in enumerate((1.0, 0.5)):
        release = travelling_wave.first_release(
            mass_ratio=0.6, speed_ratio=7.0 / frequency, damping_ratio=0.064
        )
        assert phases[i] * frequency == pytest.approx(release.ejection_phase, rel=1e-12)
        assert speeds[i] / frequency == pytest.approx(release.speed, rel=1e-12)
        assert relative[i] ** 2 == pytest.approx(release.energy_transfer, rel=1e-12)


def test_throw_that_does_not_leave_is_none_in_releases_and_the_worst_in_the_score():
    throws = np.array([(1.0, 1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, -1.0, 0.0)])
    problem = make(0.6, 7.0, throws=throws)
    phases, speeds, relative = releases(problem)
    assert np.isnan(phases).tolist() == np.isnan(speeds).tolist() == [False, True]
    assert relative[1] == score(problem) == -1.0


def test_no_throw_at_all_is_not_a_number():
    held = make(1.0, 5.0, 0.3, 5.0)
    assert math.isnan(find_summit(held, thickness_factors=(0.9, 1.1)).score)
    slow = make(1e9, 1e6)
    for limits in ({}, {'thickness_factors': (0.5, 2.0), 'wave_speed_factors': (0.5, 2.0)}):
        assert math.isnan(find_summit(slow, **limits).score)


def test_limits_that_nothing_keeps_leave_nothing():
    problem = make(0.6, 7.0, 0.064, checked=1, strain=1e-3)
    assert math.isnan(find_summit(problem, thickness_factors=(0.5, 2.0)).score)
