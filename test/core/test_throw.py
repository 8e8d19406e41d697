# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One throw with all its requested results."""

import numpy as np
import pytest
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.stepper import Event
from soft_throw_ros.core.throw import ejections, simulate, ThrowUnfinishedError


def test_ejections_end_at_the_landing():
    events = [
        Event('release', 1.0, 0.01, 1.0),
        Event('recontact', 1.1, 0.02, 1.0),
        Event('release', 1.2, 0.03, 2.0),
        Event('landing', 2.0, 0.01, -2.0),
        Event('release', 2.1, 0.01, 1.0),
    ]
    assert ejections(events) == (events[0], events[2])
    assert ejections([]) == ()


def test_projectile_reaches_its_predicted_apex():
    throw = simulate(Rig())
    assert throw.events[-1].kind == 'landing'
    path = throw.trajectory(np.linspace(throw.ejection_time, throw.end_time, 2001))
    assert path.projectile_position.max() == pytest.approx(throw.apex_height, rel=1e-5)
    in_flight = path.time < throw.events[-1].time
    assert (path.projectile_position >= path.top_position - 1e-12)[in_flight].all()


def test_fields_match_their_axes():
    throw = simulate(Rig(), max_events=1)
    fields = throw.fields(np.linspace(0.0, throw.ejection_time, 101), points=65)
    assert fields.strain.shape == fields.velocity.shape == (101, 65)
    assert fields.depth[-1] == throw.rig.layer.thickness
    stiffness = throw.rig.layer.youngs_modulus * throw.rig.layer.section
    weight = throw.rig.projectile.mass * throw.rig.gravity
    assert fields.strain[0] == pytest.approx(-weight / stiffness)
    assert np.abs(fields.strain).max() == pytest.approx(throw.peak_strain, rel=1e-2)


@pytest.mark.parametrize(('amplitude', 'is_left'), [(1e-3, False), (3e-3, True)])
def test_throw_beyond_the_linear_range_is_flagged(amplitude, is_left):
    throw = simulate(Rig(engine=Engine(amplitude=amplitude)))
    assert throw.leaves_linear_range is is_left is (throw.peak_strain > 0.15)


@pytest.mark.parametrize(
    'rig',
    [
        Rig(gravity=0.0),
        Rig(
            engine=Engine(frequency=106.63, amplitude=3.986e-3, damping_ratio=0.1162),
            layer=Layer(thickness=0.01951, wave_speed=39.276, density=944.4, diameter=0.01237),
            projectile=Projectile(mass=0.006829),
        ),
        Rig(engine=Engine(amplitude=0.1, frequency=200.0), layer=Layer(wave_speed=200.0)),
    ],
)
def test_every_throw_ends(rig):
    assert simulate(rig, max_events=2).ejections
    assert simulate(rig).end_time > 0.0


def test_unfinished_throw_raises_an_error():
    with pytest.raises(ThrowUnfinishedError, match=r'0\.001'):
        simulate(Rig(), until=1e-3)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'until': -1.0}, r'until .*-1\.0'),
        ({'max_events': 0}, 'max_events .*0'),
        ({'cells': 64}, 'cells .*64'),
    ],
)
def test_bad_requests_are_refused_with_the_value(arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate(Rig(), **arguments)
