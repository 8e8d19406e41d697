# SPDX-License-Identifier: Apache-2.0
"""The travelling wave through releases and landings, for any plate."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core.method_of_steps import follow
from soft_throw_ros.core.plate import Sampled, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.travelling_wave import first_release, ThrowUnresolvedError

FREQUENCY = 63.2


def make_rig(mass_ratio, speed_ratio, damping_ratio=0.0, gravity=0.0):
    layer = Layer(thickness=7.8 / (speed_ratio * FREQUENCY), wave_speed=7.8)
    return Rig(
        engine=Engine(frequency=FREQUENCY, damping_ratio=damping_ratio),
        layer=layer,
        projectile=Projectile(mass=mass_ratio * layer.mass),
        gravity=gravity,
    )


# Computed with 40-digit closed forms, checked by a second method; time in plate periods
@pytest.mark.parametrize(
    ('mu', 'kappa', 'events', 'first', 'alpha_first', 'last', 'alpha_last'),
    [
        (5.0, 1.5, 7, 1.1525105269970801, 0.03156194956881057, 5.030617046549641,
         0.19482040123175556),
        (5.2, 3.75, 9, 0.735523437717826, 0.15121568692598497, 4.787649106129323,
         0.3620335185142774),
        (3.0333, 2.5, 3, 0.8651147294875321, 0.1891200559290065, 2.002892429791799,
         0.4218872106128318),
    ],
)  # fmt: skip
def test_every_recontact_is_exact(mu, kappa, events, first, alpha_first, last, alpha_last):
    history = follow(make_rig(mu, kappa))
    assert len(history.events) == events
    peak = history.motion.peak_velocity
    for event, time, alpha in (
        (history.events[0], first, alpha_first),
        (history.events[-1], last, alpha_last),
    ):
        assert event.kind == 'release'
        assert event.time * FREQUENCY == pytest.approx(time, abs=1e-8)
        assert (event.velocity / peak) ** 2 == pytest.approx(alpha, rel=1e-8)


# Computed with 40-digit closed forms, checked by a second method; m, s, m/s
@pytest.mark.parametrize(
    ('thickness', 'release', 'speed', 'landing', 'landing_velocity'),
    [
        (0.002, 0.003928483601452469, 1.1177660177283313, 0.2316664157396481,
         -1.1163430965473666),
        (0.0056, 0.0057781780440564505, 1.3129434316774524, 0.27423609529097615,
         -1.3206287365148273),
        (0.0095, 0.007000759739240912, 1.3049844801863633, 0.2746008198772052,
         -1.320172109767066),
    ],
)  # fmt: skip
def test_first_release_and_landing_with_gravity_are_exact(
    thickness, release, speed, landing, landing_velocity
):
    layer = Layer(thickness=thickness)
    rig = Rig(layer=layer, projectile=Projectile(mass=1300.0 * 16.3e-3 * layer.section))
    first, second, third = follow(rig, max_events=3).events
    assert (first.kind, second.kind, third.kind) == ('release', 'landing', 'release')
    assert first.time == pytest.approx(release, abs=1e-11)
    assert first.velocity == pytest.approx(speed, rel=1e-9)
    assert second.time == pytest.approx(landing, abs=1e-10)
    assert second.velocity == pytest.approx(landing_velocity, rel=1e-9)
    assert third.time > second.time


def test_projectile_too_heavy_for_the_plate_is_never_released():
    assert follow(make_rig(7.389, 1.0, 0.25, gravity=9.81)).events == ()


def test_following_stops_by_itself_when_the_projectile_falls_back():
    events = follow(Rig()).events
    assert [event.kind for event in events] == ['release', 'landing']
    assert events[-1].velocity < 0.0


ratios = st.tuples(
    st.floats(np.log(0.003), np.log(100.0)).map(np.exp),
    st.floats(np.log(0.15), np.log(120.0)).map(np.exp),
    st.floats(0.0, 0.3),
)


@settings(max_examples=60, deadline=None)
@given(ratios, st.sampled_from([0.0, 9.81]))
def test_first_release_agrees_with_the_closed_form(case, gravity):
    mu, kappa, zeta = case
    rig = make_rig(mu, kappa, zeta, gravity)
    events = follow(rig, max_events=1, until=4.0 / FREQUENCY + 8.0 * rig.crossing_time).events
    try:
        exact = first_release(
            mass_ratio=rig.mass_ratio,
            speed_ratio=rig.speed_ratio,
            damping_ratio=zeta,
            gravity_ratio=rig.gravity_ratio,
        )
    except ThrowUnresolvedError:
        assert gravity > 0.0
        assert not events
        return
    if not events:
        assert exact.ejection_phase > 4.0
        return
    release = events[0]
    assert release.time * FREQUENCY == pytest.approx(exact.ejection_phase, abs=1e-9)
    assert release.velocity / rig.engine.speed_scale == pytest.approx(exact.speed, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(ratios, st.sampled_from([0.0, 9.81]), st.floats(0.1, 1.0))
def test_work_of_the_plate_is_kept_in_layer_and_projectile(case, gravity, part):
    rig = make_rig(*case, gravity)
    history = follow(rig, max_events=3, until=6.0 / FREQUENCY + 12.0 * rig.crossing_time)
    time = part * history.end_time
    kept = history.layer_energy(time) + history.projectile_energy(time)
    moved = rig.projectile.mass * history.motion.peak_velocity**2
    assert history.plate_work(time) == pytest.approx(kept, rel=1e-9, abs=1e-9 * moved)


@settings(max_examples=20, deadline=None)
@given(ratios, st.floats(0.1, 10.0))
def test_speed_scales_with_the_amplitude(case, factor):
    rig = make_rig(*case)
    larger = Rig(
        engine=Engine(
            frequency=FREQUENCY, amplitude=factor * 2e-3, damping_ratio=rig.engine.damping_ratio
        ),
        layer=rig.layer,
        projectile=rig.projectile,
        gravity=0.0,
    )
    one, other = (follow(each, max_events=1).events[0] for each in (rig, larger))
    assert other.velocity == pytest.approx(factor * one.velocity, rel=1e-9)
    assert other.time == pytest.approx(one.time, rel=1e-9)


def test_sampled_plate_gives_the_throw_of_the_plate_that_was_sampled():
    rig = Rig(layer=Layer(thickness=9.5e-3))
    exact = follow(rig, max_events=1).events[0]
    errors = []
    for count in (51, 101, 201):
        times = np.linspace(0.0, 0.02, count)
        plate = Sampled.from_positions(times, Underdamped.of(rig.engine).position(times))
        errors.append(abs(follow(rig, plate, max_events=1).events[0].time - exact.time))
    assert errors[-1] < 1e-8
    assert errors[0] > 10.0 * errors[-1]


def test_sampled_plate_may_start_late_and_ends_the_history():
    rig = Rig(layer=Layer(thickness=9.5e-3))
    times = np.linspace(0.0, 0.02, 201)
    positions = Underdamped.of(rig.engine).position(times)
    early = follow(rig, Sampled.from_positions(times, positions))
    late = follow(rig, Sampled.from_positions(times + 0.5, positions))
    assert late.events[0].time - 0.5 == pytest.approx(early.events[0].time, abs=1e-9)
    assert early.end_time == pytest.approx(0.02 + rig.crossing_time)


def test_force_on_the_projectile_is_its_weight_at_rest_and_nothing_in_flight():
    history = follow(Rig(), until=0.02)
    weight = history.rig.projectile.mass * history.rig.gravity
    release = history.events[0].time
    assert history.contact_force(1e-3) == pytest.approx(weight)
    assert history.contact_force(release) == pytest.approx(0.0, abs=1e-9 * weight)
    assert history.contact_force(release + 1e-3) == 0.0


def test_field_meets_plate_and_projectile_at_its_ends():
    history = follow(Rig(), max_events=1)
    times = np.linspace(0.0, history.end_time, 57)
    thickness = history.rig.layer.thickness
    plate = history.motion.velocity(times)
    np.testing.assert_allclose(history.velocity(0.0, times), plate, atol=1e-13)
    np.testing.assert_allclose(
        history.velocity(thickness, times), history.projectile_velocity(times), atol=1e-13
    )
    force = history.contact_force(times)
    stress = -history.strain(thickness, times) * history.rig.layer.youngs_modulus
    np.testing.assert_allclose(stress * history.rig.layer.section, force, atol=1e-12)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'until': -1.0}, r'until must be finite and positive, got -1\.0'),
        ({'max_events': 0}, 'max_events must be at least 1, got 0'),
        ({'rig': Rig(projectile=Projectile(mass=1e-10))}, r'too light .* at least 1e-07, got 7'),
        ({'rig': Rig(layer=Layer(loss_tangent=0.02))}, r'loss_tangent must be 0 .* got 0\.02'),
    ],
)
def test_what_cannot_be_followed_is_refused_with_the_value(arguments, message):
    with pytest.raises(ValueError, match=message):
        follow(arguments.pop('rig', Rig()), **arguments)


def test_questions_beyond_the_history_are_refused_with_the_value():
    history = follow(Rig(), max_events=1)
    with pytest.raises(ValueError, match=r'time 1 s is after 0\.007'):
        history.projectile_position(1.0)
    with pytest.raises(ValueError, match=r'depth must be in \[0, 0\.0168\] m, got 0\.02'):
        history.strain(0.02, 1e-3)
