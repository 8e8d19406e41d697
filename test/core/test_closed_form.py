# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The exact first release, one and many."""

import math

from hypothesis import given
from hypothesis import strategies as st
import mpmath as mp
import numpy as np
import pytest
from reference.cases import EXACT, log_uniform
from soft_throw_ros.core.closed_form import first_releases, FirstRelease, spring_release
from soft_throw_ros.core.plate import peak_velocity_ratio

mp.mp.dps = 40


def speed_of_projectile(time, mass_ratio, speed_ratio, damping_ratio, derivative=0):
    """
    Compute V_m, or a derivative, of a projectile that never leaves the layer.

    Time is in crossings t_s, speed in velocity factors. The Laplace series has the terms
    2 e^{-(2 k + 1) s} r(s)^k V_p(s) / (1 + mu s). The result is the sum of their residues: at
    s = lambda, and at s = (eta - 1) / mu with eta = 0, a pole of order k + 1.
    """
    mu, turn, zeta = mp.mpf(mass_ratio), 2 * mp.pi / mp.mpf(speed_ratio), mp.mpf(damping_ratio)
    lam = turn * mp.mpc(-zeta, mp.sqrt(1 - zeta**2))
    below = 1 + lam * mu
    reflection = (lam * mu - 1) / below
    total = mp.mpf(0)
    for k in range(math.ceil((time - 1) / 2)):
        since = time - 2 * k - 1
        at_lambda = reflection**k / below * mp.exp(lam * since) * lam**derivative
        # coefficients of eta^0 to eta^k in (eta - 2)^k e^{eta since / mu} ((eta - 1) / mu)^d
        power = [mp.binomial(k, i) * mp.mpf(-2) ** (k - i) for i in range(k + 1)]
        wave = [mp.mpf(1)]
        for i in range(1, k + 1):
            wave.append(wave[-1] * since / (mu * i))
        series = [mp.fsum(power[i] * wave[n - i] for i in range(n + 1)) for n in range(k + 1)]
        for _ in range(derivative):
            series = [((series[n - 1] if n else 0) - series[n]) / mu for n in range(k + 1)]
        # coefficients of 1 / (eta - below)
        at_pole = -mp.fsum(series[n] / below ** (k - n + 1) for n in range(k + 1))
        total += 2 * (at_lambda + mp.exp(-since / mu) * at_pole).imag
    return total


def gravity_on(gravity_ratio, speed_ratio, damping_ratio):
    """Compute g in velocity factors per t_s."""
    return 2 * mp.pi * gravity_ratio * mp.sqrt(1 - mp.mpf(damping_ratio) ** 2) / speed_ratio


def assert_exact(release, *case, phase_error=0.0, alpha_error=1e-12):
    """Assert that a release agrees with the nearest exact release, by Newton's method."""
    *case, gravity_ratio = (*case, 0.0)[:4]
    _, speed_ratio, damping_ratio = case
    gravity = gravity_on(gravity_ratio, speed_ratio, damping_ratio)
    time = mp.mpf(release.ejection_phase) * speed_ratio
    for _ in range(2):
        acceleration = speed_of_projectile(time, *case, derivative=1) + gravity
        time -= acceleration / speed_of_projectile(time, *case, derivative=2)
    speed = speed_of_projectile(time, *case) / mp.sqrt(1 - mp.mpf(damping_ratio) ** 2)
    alpha = float((speed / peak_velocity_ratio(damping_ratio)) ** 2)
    phase = float(time / speed_ratio)
    assert release.ejection_phase == pytest.approx(phase, rel=phase_error, abs=1e-12)
    assert release.energy_transfer == pytest.approx(alpha, rel=alpha_error, abs=1e-12)


def random_cases(size, seed, gravity=0.0):
    """Draw cases over the whole range: four arrays."""
    draw = np.random.default_rng(seed)
    return (
        np.exp(draw.uniform(math.log(0.003), math.log(100.0), size)),
        np.exp(draw.uniform(math.log(0.15), math.log(120.0), size)),
        draw.uniform(0.0, 0.3, size) * draw.integers(0, 2, size),
        draw.uniform(0.0, gravity, size),
    )


RATIOS = ('mass_ratio', 'speed_ratio', 'damping_ratio', 'gravity_ratio')


def releases_of(*cases):
    return FirstRelease(*np.array(first_releases(**dict(zip(RATIOS, cases, strict=False)))))


@pytest.mark.parametrize('case', EXACT)
def test_release_is_exact(case):
    *ratios, phase, energy_transfer = case
    release = releases_of(*ratios)
    assert release.ejection_phase == pytest.approx(phase, rel=0.0, abs=1e-12)
    assert release.energy_transfer == pytest.approx(energy_transfer, rel=1e-12)


@pytest.mark.parametrize('gravity', [0.0, 0.3])
def test_releases_agree_with_the_laplace_series(gravity):
    cases = random_cases(40, seed=1, gravity=gravity)
    releases = releases_of(*cases)
    early = np.flatnonzero(releases.ejection_phase * cases[1] < 41.0)  # it costs its square
    assert early.size > 30
    for i in early:
        assert_exact(FirstRelease(*np.array(releases)[:, i]), *(float(case[i]) for case in cases))


@pytest.mark.parametrize(
    'case',
    [
        (1e-12, 3.0, 0.0), (1e-9, 9.0, 0.0), (1e-6, 9.0, 0.2), (1e6, 20.0, 0.0), (0.1, 1e-6, 0.0),
        (1e-12, 1e-6, 0.5), (0.3, 1e-3, 0.99),
        (45.6, 120.0, 0.3),  # the steady wave has an amplitude of 34, the largest promised
    ],
)
def test_release_is_exact_at_extremes(case):
    assert_exact(releases_of(*case), *case, phase_error=1e-12, alpha_error=1e-9)


def test_no_release_is_refused_in_the_promised_range():
    releases = releases_of(*random_cases(20_000, seed=6))
    assert np.isfinite(releases.ejection_phase).all()


@pytest.mark.parametrize(
    'case',
    [
        # G dips below 0 within a wave interval and is positive again at its end
        (0.3, 300.0, 0.0, 0.0), (0.55, 50.0, 0.0, 0.0), (0.6, 100.0, 0.2, 0.0),
        (1.25, 101.0, 0.0, 0.0), (2.15, 950.0, 0.0, 0.0),
        # before the plate stops, and the projectile would be caught again
        (0.005397489576859395, 0.2353127994849778, 0.20488508212590453, 1.1027562463539),
        # where Halley's method cycles
        (0.02535593739507207, 91.58088202703843, 0.0, 0.018855035546196983),
        # before it would leave again in the same interval
        (0.6085752514780604, 57.54677160673658, 0.0902315980117538, 0.89110037458255),
        (0.43907184514008996, 83.95559092286346, 0.0, 0.8890571708046072),
    ],
)
def test_release_is_the_first_one_and_exact(case):
    release, weight = releases_of(*case), gravity_on(case[3], case[1], case[2])
    assert_exact(release, *case)
    for time in np.linspace(1.0, release.ejection_phase * case[1], 200, endpoint=False)[1:]:
        assert speed_of_projectile(mp.mpf(time), *case[:3], derivative=1) > -weight


@given(
    log_uniform(0.003, 100.0), log_uniform(0.15, 120.0), st.floats(0.0, 0.3), st.floats(0.0, 10.0)
)
def test_gravity_delays_the_release(mass_ratio, speed_ratio, damping_ratio, gravity_ratio):
    free = releases_of(mass_ratio, speed_ratio, damping_ratio)
    assert 1.0 < free.ejection_phase * speed_ratio < math.inf
    assert 0.0 < free.energy_transfer < 5.0
    heavy = releases_of(mass_ratio, speed_ratio, damping_ratio, gravity_ratio)
    if not np.isnan(heavy.speed):
        assert heavy.ejection_phase >= free.ejection_phase * (1.0 - 1e-14)


def test_unresolved_releases_are_unknown_beside_a_known_one():
    cases = [
        (1.0, 5.0, 0.0, 0.0),  # known
        (1e6, 1e4, 0.0, 0.0), (1e300, 1e300, 0.0, 0.0), (1.0, 1e300, 0.0, 0.0),
        (1e8, 1.0, 0.0, 0.0), (1e200, 10.0, 0.0, 0.0), (100.0, 2000.0, 0.9, 0.0),  # rounding
        (1e6, 1e6, 0.0, 0.0),  # leaves after some 6000 crossings
        (1.0, 20.0, 0.0, 9.0),  # the plate never comes down faster than the projectile falls
    ]
    for values in releases_of(*np.transpose(cases)):
        assert np.isnan(values).tolist() == [False] + [True] * 8


@pytest.mark.parametrize('q', [0.2, 0.7, 0.999, 1.001, 1.62, 3.0, 9.0])
def test_spring_leaves_at_the_first_zero_of_its_force(q):
    """The motion is 1 - (q^2 cos t - cos q t) / (q^2 - 1), that of the plate 1 - cos t."""
    release = spring_release(frequency_ratio=q)
    t = 2.0 * math.pi * release.ejection_phase * np.linspace(0.0, 1.0, 101)[1:]
    force = (np.cos(t) - np.cos(q * t)) / (q**2 - 1.0)
    assert (force[:-1] > 0.0).all()
    assert force[-1] == pytest.approx(0.0, abs=1e-12)
    speed = (q**2 * np.sin(t[-1]) - q * np.sin(q * t[-1])) / (q**2 - 1.0)
    assert release.speed == pytest.approx(speed, rel=1e-9)
    assert release.energy_transfer == pytest.approx(speed**2, rel=1e-9)


def test_ratios_are_refused_with_the_value():
    for name, value in (('mass_ratio', 0.0), ('speed_ratio', np.inf), ('damping_ratio', 1.0)):
        with pytest.raises(ValueError, match=f'^{name} must be .* got {value!r}$'):
            first_releases(**{'mass_ratio': 1.0, 'speed_ratio': 5.0, name: value})
