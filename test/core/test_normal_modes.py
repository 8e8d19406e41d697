# SPDX-License-Identifier: Apache-2.0
"""Layers with internal loss against an exact value, finite differences, and layers without."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from soft_throw_ros.core import finite_difference, peak, travelling_wave
from soft_throw_ros.core.normal_modes import first_peaks, first_release, first_releases
from soft_throw_ros.core.travelling_wave import ThrowUnresolvedError

RIG = {'mass_ratio': 0.6345238095238095, 'speed_ratio': 7.34629294755877}


def test_release_is_exact():
    # computed with 40 digits and checked by a second method, to 8 digits
    release = first_release(**RIG, loss_tangent=0.05)
    assert release.ejection_phase == pytest.approx(0.46694752928793415, rel=1e-10)
    assert release.speed == pytest.approx(1.8077831318189745, rel=1e-10)
    assert release.energy_transfer == release.speed**2


@pytest.mark.parametrize('gravity_ratio', [0.0, 0.1])
def test_release_is_that_of_finite_differences(gravity_ratio):
    cases = {
        'mass_ratio': np.geomspace(0.02, 10.0, 6)[:, None, None],
        'speed_ratio': np.geomspace(2.0, 40.0, 6)[None, :, None],
        'loss_tangent': np.array([0.005, 0.05, 0.5]),
        'damping_ratio': 0.064,
        'gravity_ratio': gravity_ratio,
    }
    by_modes = first_releases(**cases, unresolved='nan')
    by_cells = finite_difference.first_releases(**cases, cells=96, unresolved='nan')
    early = by_modes.ejection_phase < 1.0  # later ones have more jumps to miss
    assert early.sum() > 80
    np.testing.assert_allclose(
        by_modes.energy_transfer[early], by_cells.energy_transfer[early], rtol=3e-4
    )
    np.testing.assert_allclose(
        by_modes.ejection_phase[early], by_cells.ejection_phase[early], rtol=3e-4
    )


@pytest.mark.parametrize(('mass_ratio', 'speed_ratio'), [(0.25, 8.5), (3.0, 20.0), (0.05, 5.7)])
def test_little_loss_is_a_small_perturbation_of_none(mass_ratio, speed_ratio):
    ratios = {'mass_ratio': mass_ratio, 'speed_ratio': speed_ratio, 'damping_ratio': 0.064}
    without = travelling_wave.first_release(**ratios).energy_transfer
    lost = [
        without - first_release(**ratios, loss_tangent=loss).energy_transfer
        for loss in (1e-4, 1e-5)
    ]
    assert 0.0 < lost[0] < 0.01
    assert lost[0] / lost[1] == pytest.approx(10.0, rel=0.1)


def test_peaks_with_little_loss_are_those_without():
    ratios = {'mass_ratio': 0.6, 'speed_ratio': 7.3, 'damping_ratio': 0.064, 'gravity_ratio': 0.03}
    lossy = first_peaks(**ratios, loss_tangent=1e-5)
    lossless = peak.first_peaks(**ratios)
    np.testing.assert_allclose(lossy[1:], lossless[1:], rtol=1e-3)
    np.testing.assert_allclose(lossy.release, lossless.release, rtol=3e-4)


@pytest.mark.parametrize(
    ('mass_ratio', 'speed_ratio', 'loss_tangent', 'gravity_ratio'),
    [(0.25, 8.5, 0.05, 0.0), (0.6, 7.3, 0.4, 0.1)],
)
def test_peaks_are_those_of_masses_and_springs(
    mass_ratio, speed_ratio, loss_tangent, gravity_ratio
):
    """Solve the same layer as a chain, whose error falls with the square of the cells."""
    omega = 2.0 * math.pi / speed_ratio
    viscosity = loss_tangent / omega
    release = first_release(
        mass_ratio=mass_ratio,
        speed_ratio=speed_ratio,
        loss_tangent=loss_tangent,
        gravity_ratio=gravity_ratio,
    )
    end = release.ejection_phase * speed_ratio
    found = []
    for cells in (30, 60):
        mass = np.full(cells, 1.0 / cells)
        mass[-1] = 0.5 / cells + mass_ratio

        def stress_of(time, u, v, cells=cells):
            height, speed = (1.0 - math.cos(omega * time)) / omega, math.sin(omega * time)
            return cells * (np.diff(u, prepend=height) + viscosity * np.diff(v, prepend=speed))

        def change(time, state, cells=cells, mass=mass, stress_of=stress_of):
            u, v, _ = np.split(state, (cells, 2 * cells))
            stress = stress_of(time, u, v)
            force = np.diff(stress, append=0.0)
            power = -stress[0] * math.sin(omega * time)
            return np.concatenate([v, force / mass, [power]])

        times = np.linspace(0.0, end, 2001)
        solution = solve_ivp(
            change, (0.0, end), np.zeros(2 * cells + 1), 'LSODA', times, rtol=1e-8, atol=1e-10
        )
        u, v, work = np.split(solution.y, (cells, 2 * cells))
        weight = gravity_ratio * omega * mass_ratio
        stress = np.array([stress_of(t, u[:, i], v[:, i]) for i, t in enumerate(times)]).T
        height = (1.0 - np.cos(omega * times)) / omega
        strain = cells * np.diff(u, axis=0, prepend=height[None]) - weight
        # cells have their values in the middle: half a cell further is the end
        to_plate = 1.5 * stress[0] - 0.5 * stress[1] - weight
        found.append([
            np.abs(strain).max(),
            np.abs(1.5 * strain[-1] - 0.5 * strain[-2]).max(),
            np.abs(np.gradient(v[-1], times)).max() / omega,
            np.abs(to_plate).max(),
            (work[0, -1] + weight * height[-1]) / mass_ratio,
        ])  # fmt: skip
    peaks = first_peaks(
        mass_ratio=mass_ratio,
        speed_ratio=speed_ratio,
        loss_tangent=loss_tangent,
        gravity_ratio=gravity_ratio,
    )
    names = ('strain', 'contact_strain', 'acceleration', 'plate_force', 'plate_work')
    expected = [getattr(peaks, name) for name in names]
    errors = np.abs(np.array(found) / expected - 1.0)
    assert errors[1].max() < 0.02
    assert (errors[1] < 0.75 * errors[0] + 1e-3).all()


def test_gravity_delays_the_release_and_is_the_deceleration_there():
    free = first_release(**RIG, loss_tangent=0.1)
    release = first_release(**RIG, loss_tangent=0.1, gravity_ratio=0.1)
    assert release.ejection_phase > free.ejection_phase
    assert release.speed < free.speed
    # between the two the projectile slows down, at first not at all and in the end by g
    slowed = free.speed - release.speed
    most = 0.1 * 2.0 * math.pi * (release.ejection_phase - free.ejection_phase)
    assert 0.4 * most < slowed < 0.6 * most


def test_strong_gravity_holds_the_projectile():
    with pytest.raises(ThrowUnresolvedError, match=r'gravity holds the projectile .* 5, loss'):
        first_release(**RIG, loss_tangent=0.1, damping_ratio=0.1, gravity_ratio=5.0)
    releases = first_releases(
        **RIG, loss_tangent=0.1, damping_ratio=0.1, gravity_ratio=[5.0, 0.1], unresolved='nan'
    )
    assert np.isnan(releases.speed).tolist() == [True, False]


def test_later_swing_releases_what_the_first_cannot():
    release = first_release(
        mass_ratio=1.2, speed_ratio=7.0, loss_tangent=0.01, damping_ratio=0.064, gravity_ratio=2.0
    )
    assert 1.0 < release.ejection_phase < 3.0
    assert release.energy_transfer > 8.0


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'loss_tangent': 0.0}, r'loss_tangent must be above 0 and finite, got 0\.0'),
        ({'mass_ratio': -1.0}, r'mass_ratio must be above 0 and finite, got -1\.0'),
        ({'damping_ratio': 1.0}, r'damping_ratio must be at least 0 and below 1, got 1\.0'),
        ({'speed_ratio': 'fast'}, "speed_ratio must be a number, got 'fast'"),
    ],
)
def test_bad_ratios_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        first_release(**{**RIG, 'loss_tangent': 0.1, **changes})


def test_bad_option_is_refused():
    with pytest.raises(ValueError, match="unresolved must be 'raise' or 'nan', got 'none'"):
        first_releases(**RIG, loss_tangent=0.1, unresolved='none')
