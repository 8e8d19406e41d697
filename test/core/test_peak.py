# SPDX-License-Identifier: Apache-2.0
"""The largest strains, accelerations and forces of a throw, in closed form."""

import math

from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core.method_of_steps import follow
from soft_throw_ros.core.peak import first_peaks
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.travelling_wave import first_release, ThrowUnresolvedError

FREQUENCY = 63.2
WAVE_SPEED = 7.8

logarithms = st.floats(math.log(0.003), math.log(50.0))
damping_ratios = st.sampled_from([0.0, 0.064, 0.3])


def rig_with(mass_ratio, speed_ratio, damping_ratio=0.0, gravity_ratio=0.0):
    layer = Layer(thickness=WAVE_SPEED / (speed_ratio * FREQUENCY), wave_speed=WAVE_SPEED)
    engine = Engine(frequency=FREQUENCY, damping_ratio=damping_ratio)
    return Rig(
        engine=engine,
        layer=layer,
        projectile=Projectile(mass=mass_ratio * layer.mass),
        gravity=gravity_ratio * engine.speed_scale * engine.angular_frequency,
    )


# Computed with 40-digit closed forms, checked by a second method: rig at 63.2 Hz, A = 2 mm
@pytest.mark.parametrize(
    ('thickness', 'largest', 'at_contact'),
    [
        (0.002, 0.20455695136726773, 0.1929978563882354),
        (0.0056, 0.18543981232911014, 0.15991912482862805),
    ],
)
def test_peak_strain_is_exact(thickness, largest, at_contact):
    peaks = first_peaks(
        mass_ratio=1.3 * 16.3e-3 / thickness, speed_ratio=WAVE_SPEED / (thickness * FREQUENCY)
    )
    unit = 2e-3 * 2.0 * math.pi * FREQUENCY / WAVE_SPEED
    assert peaks.strain * unit == pytest.approx(largest, rel=1e-8)
    assert peaks.contact_strain * unit == pytest.approx(at_contact, rel=1e-8)


# Released in the first, second, third, seventh interval; transients of 0.003 crossings; a plate
# that swings six times in a crossing; released by a later swing, against gravity
@pytest.mark.parametrize(
    ('mass_ratio', 'speed_ratio', 'damping_ratio', 'gravity_ratio'),
    [
        (0.6, 7.3, 0.064, 0.031),
        (0.25, 3.0, 0.0, 0.0),
        (1.3, 14.4, 0.064, 0.03),
        (20.0, 22.0, 0.3, 0.0),
        (0.003, 7.3, 0.0, 0.0),
        (0.00548, 1.56, 0.0, 0.03),
        (0.0499, 38.4, 0.0, 0.03),
        (0.0234, 9.08, 0.3, 0.2),
        (15.7, 0.165, 0.064, 0.0),
        (0.606, 0.183, 0.0, 0.2),
    ],
)
def test_peaks_are_those_of_the_method_of_steps(
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio
):
    rig = rig_with(mass_ratio, speed_ratio, damping_ratio, gravity_ratio)
    peaks = first_peaks(
        mass_ratio=mass_ratio,
        speed_ratio=speed_ratio,
        damping_ratio=damping_ratio,
        gravity_ratio=gravity_ratio,
    )
    history = follow(rig, max_events=1)
    end = history.events[0].time
    unit = rig.engine.speed_scale / WAVE_SPEED
    depth = peaks.strain_height * rig.layer.thickness
    when = min(peaks.strain_phase / FREQUENCY, end)
    assert abs(history.strain(depth, when)) == pytest.approx(peaks.strain * unit, rel=1e-9)
    work = peaks.plate_work * rig.projectile.mass * rig.engine.speed_scale**2
    assert history.plate_work(end) == pytest.approx(work, rel=1e-9)

    # nowhere on a grid is more, and near a maximum of each there is as much
    times = np.linspace(0.0, end, 4001)
    for kink in np.arange(rig.crossing_time, end, rig.crossing_time):
        near = kink + np.linspace(0.0, 8.0, 401) * rig.relaxation_time
        times = np.append(times, near[near < end])
    depths = np.linspace(0.0, rig.layer.thickness, 41)
    strain = np.abs(history.strain(depths[:, None], times[None, :])) / unit
    acceleration = np.abs(history.contact_force(times) / rig.projectile.mass - rig.gravity)
    acceleration /= rig.engine.speed_scale * rig.engine.angular_frequency
    force = np.abs(history.plate_force(times)) / (rig.engine.speed_scale * rig.layer.impedance)
    for found, sampled, precision in (
        (peaks.strain, strain, 0.02),
        (peaks.contact_strain, strain[-1], 1e-4),
        (peaks.acceleration, acceleration, 1e-4),
        (peaks.plate_force, force, 1e-4),
    ):
        assert sampled.max() <= found * (1.0 + 1e-9)
        assert sampled.max() >= found * (1.0 - precision)


@settings(max_examples=200)
@given(mu=logarithms, kappa=logarithms, zeta=damping_ratios, gravity=st.floats(0.0, 0.1))
def test_peaks_keep_their_relations(mu, kappa, zeta, gravity):
    mu, kappa = math.exp(mu), max(math.exp(kappa), 0.15)
    arguments = {
        'mass_ratio': mu, 'speed_ratio': kappa, 'damping_ratio': zeta, 'gravity_ratio': gravity
    }  # fmt: skip
    try:
        peaks = first_peaks(**arguments)
    except ThrowUnresolvedError:
        assume(False)
    assert peaks.release == first_release(**arguments)
    assert peaks.strain >= max(peaks.contact_strain, peaks.plate_force) * (1.0 - 1e-12)
    assert 0.0 < peaks.strain_phase <= peaks.release.ejection_phase * (1.0 + 1e-12)
    assert 0.0 <= peaks.strain_height <= 1.0
    # Newton: what squeezes the top carries the weight and accelerates the projectile; it is
    # released in free fall
    relaxation = 2.0 * math.pi * mu / kappa  # w tau
    push = peaks.contact_strain / relaxation - gravity
    assert peaks.acceleration == pytest.approx(max(push, gravity), rel=1e-9, abs=1e-12)
    # the plate has to deliver at least what the projectile has
    assert peaks.plate_work > 0.5 * peaks.release.speed**2


@pytest.mark.parametrize(
    ('argument', 'value'),
    [
        ('mass_ratio', 0.0),
        ('speed_ratio', math.nan),
        ('damping_ratio', 1.0),
        ('gravity_ratio', -0.5),
    ],
)
def test_bad_ratios_are_refused_with_the_value(argument, value):
    with pytest.raises(ValueError, match=f'{argument} .*got {value}'):
        first_peaks(**{'mass_ratio': 0.3, 'speed_ratio': 8.0, argument: value})


def test_throw_that_gravity_holds_is_named():
    with pytest.raises(ThrowUnresolvedError, match='gravity_ratio 5'):
        first_peaks(mass_ratio=1.0, speed_ratio=5.0, damping_ratio=0.3, gravity_ratio=5.0)
