# SPDX-License-Identifier: Apache-2.0
"""The travelling wave in real time."""

import math
import tracemalloc

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core import stepper as module
from soft_throw_ros.core.method_of_steps import follow
from soft_throw_ros.core.plate import peak_velocity_ratio, Sampled, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.stepper import Stepper, steps_per_crossing, warm_up
from soft_throw_ros.core.stepping import (
    EventLimitError,
    FeedFullError,
    HorizonError,
    PLATE_FORCE,
    PLATE_POSITION,
    PLATE_VELOCITY,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    TIME,
)
from soft_throw_ros.core.travelling_wave import first_release, ThrowUnresolvedError

FREQUENCY = 63.2


def make_rig(mass_ratio, speed_ratio, damping_ratio=0.0, gravity=0.0, amplitude=2e-3):
    layer = Layer(thickness=7.8 / (speed_ratio * FREQUENCY), wave_speed=7.8)
    return Rig(
        engine=Engine(frequency=FREQUENCY, damping_ratio=damping_ratio, amplitude=amplitude),
        layer=layer,
        projectile=Projectile(mass=mass_ratio * layer.mass),
        gravity=gravity,
    )


def make_paper_rig(thickness, gravity=9.81, damping_ratio=0.064, length=16.3e-3):
    return Rig(
        engine=Engine(frequency=FREQUENCY, amplitude=2e-3, damping_ratio=damping_ratio),
        layer=Layer(thickness=thickness),
        projectile=Projectile(mass=1300.0 * length * math.pi * 6e-3**2),
        gravity=gravity,
    )


def throw(rig, periods=12.0, **options):
    """Advance until the projectile has left, and return that release."""
    model = Stepper(rig, **options)
    for quarter in range(1, round(4 * periods) + 1):
        if model.advance_to(0.25 * quarter / rig.engine.frequency):
            return model.events()[0]
    raise AssertionError('no release')


def is_feasible(rig):
    try:
        steps_per_crossing(rig)
    except ValueError:
        return False
    return True


def observe(model):
    """Return all there is to see, as bits."""
    strain, velocity = np.empty((2, model.field_points))
    model.read_field(strain, velocity)
    numbers = [
        *model.state, *strain, *velocity, *model.peaks, *model.first_peaks, model.work,
        model.peak_work, model.stored_energy(), model.highest_position, model.surface_position,
    ]  # fmt: skip
    return np.array(numbers).tobytes(), model.events(), model.in_contact, model.event_count


# Computed with 40-digit closed forms, checked by a second method: mu, kappa, zeta, te f, alpha
@pytest.mark.parametrize(
    ('mu', 'kappa', 'zeta', 'phase', 'alpha'),
    [
        (0.23423068535205, 8.2422098072057, 0.0, 0.3994399384513045, 4.123214640552163),
        (0.25539654358484, 8.57592101835, 0.064, 0.3866752089467103, 4.1428974402270375),
        (0.29513187784084, 9.2434758430532, 0.2, 0.3633656659293691, 4.185169858004478),
        (0.32, 8.4, 0.0, 0.40509068548650023, 4.1101349744268205),
        (0.325, 8.375, 0.0, 0.4067066018914044, 4.108539651810315),
        (0.01, 0.2, 0.0, 5.298054795009286, 3.6462835911068816),
        (0.01, 9.0, 0.0, 0.33515423912780706, 3.893042670333522),
        (0.02, 7.91921471164, 0.0, 0.3788004377616592, 3.9989930540910823),
        (0.02, 7.92079871298, 0.0, 0.38180935858819204, 4.019621366767697),
        (0.01, 0.25, 0.0, 4.28907615997982, 3.7636806662064886),
        (50.0, 60.0, 0.0, 0.4266129421799032, 3.037440451346464),
        (0.05, 1.0, 0.0, 1.2980547950092867, 3.6462835911068816),
        (1.0, 1.0, 0.0, 1.4590473863951916, 0.25904598562307973),
        (10.0, 1.0, 0.0, 1.4950567137012314, 0.003857550297589455),
        (0.01, 4.0, 0.064, 0.4928020665289209, 3.9990119588094664),
        (0.01, 4.0, 0.2, 0.4749549179660803, 3.9990091315319924),
        (10.595, 61.70886075949366, 0.0, 0.2523422936190782, 2.2940927492481684),
        (0.6345238095238095, 7.34629294755877, 0.0, 0.4853576867943659, 3.661689320772207),
        (10.595, 61.70886075949366, 0.064, 0.24693846205383488, 2.4035890540886395),
        (0.6345238095238095, 7.34629294755877, 0.064, 0.48150827831570486, 3.63734724564707),
    ],
)
def test_first_release_is_exact_to_1e_6_at_the_default_step(mu, kappa, zeta, phase, alpha):
    rig = make_rig(mu, kappa, zeta)
    release = throw(rig)
    assert release.kind == 'release'
    assert release.time * FREQUENCY == pytest.approx(phase, abs=1e-6)
    speed = math.sqrt(alpha) * peak_velocity_ratio(zeta)
    assert release.velocity / rig.engine.speed_scale == pytest.approx(speed, abs=1e-6)


@settings(max_examples=150)
@given(
    mass_ratio=st.floats(math.log(0.003), math.log(100.0)).map(math.exp),
    speed_ratio=st.floats(math.log(0.15), math.log(120.0)).map(math.exp),
    damping_ratio=st.sampled_from([0.0, 0.064, 0.3]),
    gravity_ratio=st.sampled_from([0.0, 0.002, 0.03]),
)
def test_first_release_agrees_with_the_closed_form(
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio
):
    try:
        exact = first_release(
            mass_ratio=mass_ratio,
            speed_ratio=speed_ratio,
            damping_ratio=damping_ratio,
            gravity_ratio=gravity_ratio,
        )
    except ThrowUnresolvedError:
        return
    rig = make_rig(mass_ratio, speed_ratio, damping_ratio)
    gravity = gravity_ratio * rig.engine.speed_scale * rig.engine.angular_frequency
    rig = make_rig(mass_ratio, speed_ratio, damping_ratio, gravity)
    release = throw(rig, periods=exact.ejection_phase + 1.0)
    assert release.time * FREQUENCY == pytest.approx(exact.ejection_phase, abs=1e-6)
    assert release.velocity / rig.engine.speed_scale == pytest.approx(exact.speed, abs=1e-6)


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
def test_recontact_is_followed_to_the_last_release(
    mu, kappa, events, first, alpha_first, last, alpha_last
):
    rig = make_rig(mu, kappa)
    model = Stepper(rig)
    assert model.advance_to(60.0 / FREQUENCY) == events
    kinds = [event.kind for event in model.events()]
    assert kinds == ['release', 'landing'] * (events // 2) + ['release']
    for event, time, alpha in (
        (model.events()[0], first, alpha_first),
        (model.events()[-1], last, alpha_last),
    ):
        assert event.time * FREQUENCY == pytest.approx(time, abs=1e-8)
        assert (event.velocity / rig.engine.speed_scale) ** 2 == pytest.approx(alpha, abs=1e-7)


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
def test_gravity_delays_the_release_and_brings_the_projectile_back(
    thickness, release, speed, landing, landing_velocity
):
    model = Stepper(make_paper_rig(thickness))
    model.advance_to(0.275)
    first, second = model.events()[:2]
    assert (first.kind, second.kind) == ('release', 'landing')
    assert first.time == pytest.approx(release, rel=1e-9)
    assert first.velocity == pytest.approx(speed, rel=1e-9)
    assert second.time == pytest.approx(landing, rel=1e-9)
    assert second.velocity == pytest.approx(landing_velocity, rel=1e-9)


# Computed with 40-digit closed forms, checked by a second method
@pytest.mark.parametrize(
    ('thickness', 'largest', 'at_contact'),
    [
        (0.002, 0.20455695136726773, 0.1929978563882354),
        (0.0056, 0.18543981232911014, 0.15991912482862805),
    ],
)
def test_peaks_up_to_the_first_release_are_exact(thickness, largest, at_contact):
    rig = make_paper_rig(thickness, gravity=0.0, damping_ratio=0.0)
    model = Stepper(rig)
    model.advance_to(0.05)
    peaks = model.first_peaks
    assert peaks.plate_strain == pytest.approx(largest, rel=1e-7)
    assert peaks.contact_strain == pytest.approx(at_contact, rel=2e-5)  # a kink between points
    stiffness = rig.layer.youngs_modulus * rig.layer.section
    assert peaks.plate_force == pytest.approx(largest * stiffness, rel=1e-7)
    assert peaks.acceleration * rig.projectile.mass == pytest.approx(
        at_contact * stiffness, rel=2e-5
    )
    assert all(now >= then for now, then in zip(model.peaks, peaks, strict=True))


@pytest.mark.parametrize(('mu', 'kappa'), [(0.2342, 8.242), (5.2, 3.75)])
def test_every_event_is_of_fourth_order(mu, kappa):
    rig = make_rig(mu, kappa, gravity=20.0)
    history = follow(rig, max_events=6)
    steps = np.array([24, 48, 96, 192])
    errors = []
    for count in steps:
        model = Stepper(rig, steps=int(count))
        model.advance_to(history.end_time + 1e-4)
        pairs = list(zip(model.events(), history.events, strict=False))
        assert len(pairs) == 6
        assert all(ours.kind == exact.kind for ours, exact in pairs)
        errors.append([abs(ours.velocity - exact.velocity) for ours, exact in pairs])
    slopes = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert (slopes < -3.6).all()


@pytest.mark.parametrize(
    ('rig', 'events'),
    [
        (Rig(), 5),
        (make_paper_rig(0.0056), 3),
        (make_rig(10.6, 125.4, 0.064), 5),
        (make_rig(0.116, 10.0, 0.3, gravity=30.0), 3),
        (Rig(gravity=900.0), 6),
    ],
)
def test_state_and_events_agree_with_the_exact_history(rig, events):
    history = follow(rig, max_events=events, until=0.4)
    model = Stepper(rig)
    scale = rig.engine.speed_scale
    times = np.sort(np.random.default_rng(5).uniform(0.0, history.end_time, 300))
    for time in times:
        model.advance_to(time)
        assert model.state[TIME] == time
        for index, exact, unit in (
            (PLATE_POSITION, history.motion.position(time), 1e-6 * scale / FREQUENCY),
            (PLATE_VELOCITY, history.motion.velocity(time), 1e-6 * scale),
            (PROJECTILE_POSITION, history.projectile_position(time), scale / FREQUENCY),
            (PROJECTILE_VELOCITY, history.projectile_velocity(time), scale),
            (PLATE_FORCE, history.plate_force(time), rig.layer.impedance * scale),
            (PROJECTILE_FORCE, history.contact_force(time), rig.layer.impedance * scale),
        ):
            assert model.state[index] == pytest.approx(float(exact), abs=3e-5 * unit)
        assert model.surface_position == pytest.approx(
            float(history.top_position(time)), abs=1e-5 * scale / FREQUENCY
        )
    assert model.event_count == sum(event.time <= times[-1] for event in history.events)
    for ours, exact in zip(model.events(), history.events, strict=False):
        assert ours.kind == exact.kind
        # a long flight lands later by twice the error of the speed over gravity
        assert ours.time * FREQUENCY == pytest.approx(exact.time * FREQUENCY, abs=5e-6)
        assert ours.velocity / scale == pytest.approx(exact.velocity / scale, abs=5e-6)


def test_field_agrees_with_the_exact_history_but_for_the_step_of_a_jump():
    rig = make_rig(3.0333, 2.5)
    history = follow(rig, max_events=3)
    model = Stepper(rig, steps=512, field_points=33)
    scale = rig.engine.speed_scale
    depths = np.linspace(0.0, rig.layer.thickness, 33)
    strain, velocity = np.empty((2, 33))
    for time in np.linspace(0.0, history.end_time, 100):
        model.advance_to(time)
        model.read_field(strain, velocity)
        wrong = np.abs(velocity - history.velocity(depths, time)) > 1e-4 * scale
        error = rig.layer.wave_speed * np.abs(strain - history.strain(depths, time))
        wrong |= error > 1e-4 * scale
        assert np.count_nonzero(wrong) <= 1


@pytest.mark.parametrize('after', ['error', 'hold'])
@pytest.mark.parametrize('kind', ['positions', 'velocities'])
@pytest.mark.parametrize('gravity', [0.0, 9.81])
def test_sampled_plate_agrees_with_the_exact_history(kind, after, gravity):
    rig = Rig(gravity=gravity)
    plate = Underdamped.of(rig.engine)
    # Off the grid, with a jump of velocity when they end and held, or begin with velocities
    times = np.arange(1.7e-4, 0.0151 if after == 'hold' else 0.041, 2.5e-4)
    if kind == 'positions':
        motion = Sampled.from_positions(times + 0.001, plate.position(times), after=after)
    else:
        motion = Sampled.from_velocities(times + 0.001, plate.velocity(times), after=after)
    history = follow(rig, motion, until=0.04, max_events=10)
    model = Stepper(rig, motion)
    for time in np.linspace(0.0, min(history.end_time, model.horizon), 40):
        model.advance_to(time)
        assert model.state[PLATE_POSITION] == pytest.approx(
            float(motion.position(time)), abs=1e-15
        )
        assert model.state[PLATE_VELOCITY] == pytest.approx(
            float(motion.velocity(time)), abs=1e-12
        )
        assert model.state[PROJECTILE_VELOCITY] == pytest.approx(
            float(history.projectile_velocity(time)), abs=1e-5
        )
    assert [event.kind for event in model.events()] == [event.kind for event in history.events]
    for ours, exact in zip(model.events(), history.events, strict=True):
        assert ours.time * FREQUENCY == pytest.approx(exact.time * FREQUENCY, abs=1e-6)
    if after == 'error':
        with pytest.raises(HorizonError, match=r'known until 0\.0419.* s, got 0\.1 s'):
            model.advance_to(0.1)


@pytest.mark.parametrize('gravity', [0.0, 9.81])
def test_plate_that_falls_away_leaves_the_projectile_behind(gravity):
    rig = Rig(gravity=gravity)
    times = np.arange(3e-4, 0.03, 2e-4)
    motion = Sampled.from_positions(times, -Underdamped.of(rig.engine).position(times))
    history = follow(rig, motion, until=0.02)
    model = Stepper(rig, motion)
    model.advance_to(0.02)
    assert [event.kind for event in model.events()] == ['release', 'landing', 'release']
    for ours, exact in zip(model.events(), history.events, strict=True):
        assert ours.kind == exact.kind
        assert ours.time * FREQUENCY == pytest.approx(exact.time * FREQUENCY, abs=2e-5)
        assert ours.velocity == pytest.approx(exact.velocity, abs=1e-5)


@settings(max_examples=25)
@given(
    times=st.lists(st.floats(0.0, 0.45), min_size=1, max_size=60).map(sorted),
    case=st.sampled_from(['default', 'thin', 'echoes', 'light']),
)
def test_results_do_not_depend_on_the_times_asked_for(times, case):
    rig = {
        'default': Rig(),
        'thin': make_paper_rig(0.002),
        'echoes': make_rig(5.2, 3.75, gravity=20.0),
        'light': make_rig(0.02, 7.92, 0.3, gravity=30.0),
    }[case]
    often, once = Stepper(rig), Stepper(rig)
    for time in times:
        often.advance_to(time)
    once.advance_to(times[-1])
    assert observe(often) == observe(once)


def test_asking_twice_changes_nothing():
    model = Stepper(Rig())
    model.advance_to(0.0123)
    before = observe(model)
    model.advance_to(0.0123)
    assert observe(model) == before


def test_reset_repeats_the_throw_bit_for_bit():
    model = Stepper(make_paper_rig(0.0095))
    at_start = observe(model)
    model.advance_to(0.3)
    at_end = observe(model)
    model.reset()
    assert observe(model) == at_start
    model.advance_to(0.3)
    assert observe(model) == at_end


@pytest.mark.parametrize('gravity', [0.0, 9.81])
def test_at_rest_nothing_moves(gravity):
    rig = Rig(gravity=gravity)
    still = Sampled.from_velocities(np.linspace(0.0, 1.0, 9), np.zeros(9), after='hold')
    model = Stepper(rig, still)
    strain, velocity = np.empty((2, 64))
    weight = rig.projectile.mass * gravity
    for time in np.linspace(0.0, 3.0, 50):
        assert model.advance_to(time) == 0
        model.read_field(strain, velocity)
        assert model.state.tolist() == [
            time,
            0.0,
            rig.layer.thickness - rig.static_sag,
            0.0,
            0.0,
            -weight,
            weight,
        ]
        assert not velocity.any()
        assert (strain == strain[0]).all()
    static = weight / (rig.layer.youngs_modulus * rig.layer.section)
    assert strain[0] == pytest.approx(-static, rel=1e-12)
    assert model.stored_energy() == 0.0
    assert model.work == 0.0


def test_work_of_the_plate_is_energy_of_layer_and_projectile():
    rig = Rig()
    model = Stepper(rig)
    count = 24 * 2 * 64  # until 24 crossings, in flight since the third; kinks fall on points
    times = np.linspace(0.0, 24.0 * rig.crossing_time, count + 1)
    power = np.empty(count + 1)
    for n, time in enumerate(times):
        model.advance_to(time)
        power[n] = -model.state[PLATE_FORCE] * model.state[PLATE_VELOCITY]
    weights = np.ones(count + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    work = weights @ power * (times[1] / 3.0)
    # Simpson's rule is of second order where the kink of the release comes back
    assert model.stored_energy() == pytest.approx(work, rel=2e-6)
    assert model.work == pytest.approx(work, rel=5e-5)  # trapezoidal rule
    assert model.peak_work >= model.work
    exact = follow(rig, until=times[-1] + 1e-4).plate_work(times[-1])
    assert model.stored_energy() == pytest.approx(exact, rel=1e-8)


def test_energy_is_kept_through_landings():
    model = Stepper(make_rig(0.6345, 7.346, 0.3, gravity=9.81))
    model.advance_to(0.15)  # the plate rests
    energy = model.stored_energy()
    assert model.event_count == 1
    errors = []
    for time in np.linspace(0.2, 0.45, 2001):
        model.advance_to(time)
        errors.append(abs(model.stored_energy() / energy - 1.0))
    assert model.event_count >= 9
    assert np.median(errors) < 5e-7
    assert max(errors) < 2e-3  # beside a kink at the top, or in the step of a landing


def test_energy_stays_bounded_in_endless_bouncing():
    model = Stepper(make_paper_rig(0.002, damping_ratio=0.3))
    model.advance_to(0.5)
    energy = model.stored_energy()
    while model.event_count < 1500:
        model.advance_to(model.state[TIME] + 0.05)
        assert 0.8 * energy < model.stored_energy() < 1.05 * energy


@settings(max_examples=40)
@given(
    frequency=st.floats(1.0, 1000.0),
    amplitude=st.floats(math.log(1e-5), math.log(0.1)).map(math.exp),
    damping_ratio=st.floats(0.0, 0.99),
    thickness=st.floats(math.log(0.5e-3), math.log(0.1)).map(math.exp),
    wave_speed=st.floats(0.0, math.log(200.0)).map(math.exp),
    density=st.floats(50.0, 5000.0),
    diameter=st.floats(math.log(1e-3), math.log(0.2)).map(math.exp),
    mass=st.floats(math.log(1e-5), 0.0).map(math.exp),
    gravity=st.sampled_from([0.0, 9.81, 30.0]),
)
def test_whole_range_of_parameters_gives_finite_throws(
    frequency, amplitude, damping_ratio, thickness, wave_speed, density, diameter, mass, gravity
):
    rig = Rig(
        engine=Engine(frequency=frequency, amplitude=amplitude, damping_ratio=damping_ratio),
        layer=Layer(
            thickness=thickness, wave_speed=wave_speed, density=density, diameter=diameter
        ),
        projectile=Projectile(mass=mass),
        gravity=gravity,
    )
    if not is_feasible(rig):
        with pytest.raises(ValueError, match='feasible: '):
            Stepper(rig)
        return
    model = Stepper(rig)
    step = rig.crossing_time / model.steps
    strain, velocity = np.empty((2, 64))
    highest, peaks = model.highest_position, model.peaks
    try:
        for time in np.linspace(0.0, min(3.0 / frequency, 1e6 * step), 30):
            model.advance_to(time)
            model.read_field(strain, velocity)
            assert np.isfinite(model.state).all()
            assert np.isfinite(strain).all()
            assert np.isfinite(velocity).all()
            assert np.isfinite(model.stored_energy())
            assert model.state[PROJECTILE_POSITION] >= model.surface_position - 1e-9
            assert model.highest_position >= highest
            assert all(now >= then for now, then in zip(model.peaks, peaks, strict=True))
            highest, peaks = model.highest_position, model.peaks
    except EventLimitError:
        assert model.event_count > 100
    kinds = [event.kind for event in model.events()]
    assert kinds == (['release', 'landing'] * len(kinds))[: len(kinds)]
    times = [event.time for event in model.events()]
    assert times == sorted(times)
    assert all(time > rig.crossing_time for time in times)


def test_speeds_are_proportional_to_the_amplitude():
    small, large = (throw(make_rig(0.3, 8.0, 0.064, amplitude=size)) for size in (1e-3, 4e-3))
    assert large.time == pytest.approx(small.time, rel=1e-12)
    assert large.velocity == pytest.approx(4.0 * small.velocity, rel=1e-12)


def test_state_and_field_agree_at_plate_and_top():
    model = Stepper(Rig())
    strain, velocity = np.empty((2, 64))
    stiffness = model.rig.layer.youngs_modulus * model.rig.layer.section
    for time in np.linspace(0.0, 0.0075, 77):
        model.advance_to(time)
        model.read_field(strain, velocity)
        assert model.in_contact
        assert velocity[0] == pytest.approx(model.state[PLATE_VELOCITY], abs=1e-14)
        assert velocity[-1] == pytest.approx(model.state[PROJECTILE_VELOCITY], abs=1e-14)
        assert strain[0] * stiffness == pytest.approx(model.state[PLATE_FORCE], abs=1e-12)
        assert -strain[-1] * stiffness == pytest.approx(model.state[PROJECTILE_FORCE], abs=1e-12)


@pytest.mark.parametrize('points', [2, 64, 300])
def test_sampled_field_has_the_rows_of_read_field(points):
    times = np.linspace(0.0, 0.02, 21)
    out = np.empty((21, points))
    Stepper(Rig(), field_points=points).sample_field(times, out)
    model = Stepper(Rig(), field_points=points)
    strain, velocity = np.empty((2, points))
    for time, row in zip(times, out, strict=True):
        model.advance_to(time)
        model.read_field(strain, velocity)
        assert row.tobytes() == strain.tobytes()


def test_highest_position_is_the_apex_of_the_flight():
    model = Stepper(Rig())
    model.advance_to(0.25)  # on its way down
    release = model.events()[0]
    at_release = Stepper(Rig())
    at_release.advance_to(release.time)
    apex = at_release.state[PROJECTILE_POSITION] + 0.5 * release.velocity**2 / 9.81
    assert model.highest_position == pytest.approx(apex, rel=1e-12)
    assert model.state[PROJECTILE_POSITION] < apex


def test_highest_position_without_a_flight_is_that_of_the_top():
    model = Stepper(make_rig(0.6345, 7.346, 0.3, gravity=2000.0))
    positions = []
    for time in np.linspace(0.0, 0.1, 20_001):
        model.advance_to(time)
        positions.append(model.state[PROJECTILE_POSITION])
    assert model.event_count == 0
    assert model.highest_position == pytest.approx(max(positions), abs=1e-9)


def test_advancing_allocates_nothing():
    model = Stepper(make_paper_rig(0.002))
    strain, velocity = np.empty((2, 64))
    times = np.linspace(0.0, 0.6, 2000).tolist()
    model.read_field(strain, velocity)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for time in times:
            model.advance_to(time)
            model.read_field(strain, velocity)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert model.event_count >= 5
    assert after - before < 1000
    assert peak - before < 4000  # numbers on their way


def test_a_million_steps_at_once_are_the_same_as_a_thousand_a_thousand_times():
    rig = make_paper_rig(0.002)
    far, near = Stepper(rig), Stepper(rig)
    for count in range(1, 1001):
        near.advance_to(count * 1e-3)
    far.advance_to(1000 * 1e-3)
    assert observe(far) == observe(near)


def feed_in_parts(model, times, values, kind, parts, until):
    for part in np.array_split(np.arange(times.size), parts):
        model.feed(times[part], **{kind: values[part]})
        model.advance_to(min(model.horizon, until))
    model.advance_to(until)


@pytest.mark.parametrize('kind', ['positions', 'velocities'])
def test_feed_agrees_with_the_analytic_plate_to_fourth_order(kind):
    rig = Rig()
    plate = Underdamped.of(rig.engine)
    exact = Stepper(rig)
    exact.advance_to(0.02)
    errors = []
    for rate in (2000.0, 4000.0, 8000.0):
        times = np.arange(0.0, 0.03, 1.0 / rate)
        values = plate.position(times) if kind == 'positions' else plate.velocity(times)
        model = Stepper(rig, 'measured')
        feed_in_parts(model, times, values, kind, 20, 0.02)
        errors.append(np.abs(model.state - exact.state)[PLATE_POSITION:PLATE_FORCE].max())
        assert model.event_count == 1
        assert model.events()[0].time == pytest.approx(exact.events()[0].time, abs=1e-7)
    assert errors[-1] < 1e-6
    assert np.polyfit(np.log([1.0, 2.0, 4.0]), np.log(errors), 1)[0] < -3.6


@settings(max_examples=20)
@given(parts=st.integers(1, 60), kind=st.sampled_from(['positions', 'velocities']))
def test_feeding_in_other_portions_changes_no_bit(parts, kind):
    random = np.random.default_rng(3)
    times = 0.0013 + np.cumsum(random.uniform(5e-4, 1.5e-3, 120))
    plate = Underdamped.of(Engine())
    values = plate.position(times) if kind == 'positions' else plate.velocity(times)
    values += 1e-5 * random.standard_normal(times.size)
    whole, split = Stepper(Rig(), 'measured'), Stepper(Rig(), 'measured')
    feed_in_parts(whole, times, values, kind, 1, 0.1)
    feed_in_parts(split, times, values, kind, parts, 0.1)
    assert observe(whole) == observe(split)


def test_fed_plate_is_known_up_to_the_last_sample_but_two():
    model = Stepper(Rig(), 'measured')
    assert model.horizon == 0.0
    times = np.arange(0.01, 0.02, 0.001)
    model.feed(times[:4], velocities=np.ones(4))
    assert model.horizon == 0.01
    model.advance_to(0.01)
    assert model.state[PLATE_VELOCITY] == 0.0
    with pytest.raises(HorizonError, match=r'known until 0\.01 s, got 0\.011 s'):
        model.advance_to(0.011)
    model.feed(times[4:], velocities=np.ones(6))
    assert model.horizon == times[-3]
    model.advance_to(times[-3])
    assert model.state[PLATE_VELOCITY] == pytest.approx(1.0, rel=1e-12)
    assert model.state[PLATE_POSITION] == pytest.approx(times[-3] - 0.01, rel=1e-12)
    model.reset()
    assert model.horizon == 0.0
    model.feed([0.0, 1.0], positions=[5.0, 5.0])


def test_feed_takes_all_or_nothing():
    model = Stepper(Rig(), 'measured')
    times = np.arange(10) / 1024.0
    model.feed(times, positions=np.zeros(10))
    horizon = model.horizon
    for later, values, complaint in (
        ([0.011, 0.010], [0.0, 0.0], r'times must increase, got 0\.01 after 0\.011 at index 1'),
        ([9 / 1024, 0.1], [0.0, 0.0], r'times must increase, got 0\.0087.* after 0\.0087'),
        ([0.011, math.nan], [0.0, 0.0], 'times must be finite, got nan at index 1'),
        ([0.011, 0.012], [0.0, math.inf], 'positions must be finite, got inf at index 1'),
        ([0.011, 0.012], [0.0], r'of one length, got shapes \(2,\) and \(1,\)'),
    ):
        with pytest.raises(ValueError, match=complaint):
            model.feed(later, positions=values)
    with pytest.raises(ValueError, match='positions were fed before, got velocities'):
        model.feed([0.02], velocities=[0.0])
    with pytest.raises(ValueError, match='either positions or velocities'):
        model.feed([0.02])
    assert model.horizon == horizon
    with pytest.raises(FeedFullError, match='4096 ahead of advance_to, got 5000'):
        model.feed(1.0 + np.arange(5000) * 1e-3, positions=np.zeros(5000))
    assert model.horizon == horizon
    with pytest.raises(ValueError, match=r'times must not be negative, got -1\.0'):
        Stepper(Rig(), 'measured').feed([-1.0], positions=[0.0])
    with pytest.raises(ValueError, match="made with motion 'measured'"):
        Stepper(Rig()).feed([0.0], positions=[0.0])


def test_feed_goes_on_for_ever():
    model = Stepper(Rig(), 'measured')
    for first in range(0, 10_000, 1000):
        model.feed(np.arange(first, first + 1000) * 1e-3, velocities=np.zeros(1000))
        model.advance_to(model.horizon)
    assert model.state[TIME] == pytest.approx(9.997)
    assert model.state[PLATE_POSITION] == 0.0


def test_endless_events_end_in_a_named_error():
    light = Projectile(mass=4e-4)
    model = Stepper(Rig(layer=Layer(thickness=5e-3), projectile=light, gravity=30.0))
    with pytest.raises(EventLimitError, match=r'more than 4096 .* before 10 s'):
        model.advance_to(10.0)
    with pytest.raises(EventLimitError):
        model.advance_to(10.0)
    model.reset()
    assert model.advance_to(0.1) < 100


@pytest.mark.parametrize(
    ('time', 'complaint'),
    [
        (-1e-9, 'must not go backwards, got -1e-09 s after 0.0 s'),
        (math.nan, 'must be finite .* got nan s'),
        (math.inf, 'must be finite .* got inf s'),
    ],
)
def test_times_that_cannot_be_are_refused(time, complaint):
    model = Stepper(Rig())
    with pytest.raises(ValueError, match=complaint):
        model.advance_to(time)
    assert model.advance_to(0.01) == 1


@pytest.mark.parametrize(
    ('arguments', 'complaint'),
    [
        ({'steps': 15}, 'steps must be from 16 to 8192, got 15'),
        ({'steps': 8193}, 'got 8193'),
        ({'steps': 64.0}, r'steps must be a whole number, got 64\.0'),
        ({'field_points': 1}, 'field_points must be from 2 .* got 1'),
        ({'motion': 'harmonic'}, "got 'harmonic'"),
        ({'motion': 3.0}, r'got 3\.0'),
    ],
)
def test_bad_arguments_are_quoted(arguments, complaint):
    with pytest.raises(ValueError, match=complaint):
        Stepper(Rig(), **arguments)


def test_sampled_motion_before_the_start_is_refused():
    motion = Sampled.from_positions([-0.5, 0.0, 0.5, 1.0], np.zeros(4))
    with pytest.raises(ValueError, match=r'a first sample at -0\.5 s'):
        Stepper(Rig(), motion)


def test_arrays_that_do_not_fit_are_refused():
    model = Stepper(Rig())
    good = np.empty(64)
    for bad in (np.empty(63), np.empty(64, np.float32), np.empty(128)[::2], [0.0] * 64):
        with pytest.raises(ValueError, match=r'float64 array of shape \(64,\), got'):
            model.read_field(good, bad)
    with pytest.raises(ValueError, match=r'float64 array of shape \(3, 64\), got'):
        model.sample_field([0.0, 0.1, 0.2], np.empty((2, 64)))
    assert not model.state.flags.writeable


def test_internal_loss_is_refused_with_a_reason():
    rig = Rig(layer=Layer(loss_tangent=0.02))
    for make in (Stepper, steps_per_crossing):
        with pytest.raises(ValueError, match=r'loss_tangent must be 0 .* lossless, got 0\.02'):
            make(rig)


@pytest.mark.parametrize(
    ('rig', 'complaint', 'better'),
    [
        (
            Rig(layer=Layer(thickness=0.5e-3, wave_speed=200.0)),
            r'thickness 0\.0005 m .* 200 m/s .* 2\.56e\+07 steps per second, the limit is 2e\+07',
            lambda number: Rig(layer=Layer(thickness=number, wave_speed=200.0)),
        ),
        (
            Rig(projectile=Projectile(mass=1e-6)),
            r'mass 1e-06 kg .* needs 15201 steps .* limit is 8192',
            lambda number: Rig(projectile=Projectile(mass=number)),
        ),
        (
            Rig(
                engine=Engine(frequency=1000.0),
                layer=Layer(thickness=0.1, wave_speed=1.0, diameter=1e-3),
            ),
            r'frequency 1000 Hz .* needs 16000 steps .* limit is 8192',
            lambda number: Rig(
                engine=Engine(frequency=number),
                layer=Layer(thickness=0.1, wave_speed=1.0, diameter=1e-3),
            ),
        ),
    ],
)
def test_rigs_beyond_real_time_are_refused_with_what_would_do(rig, complaint, better):
    with pytest.raises(ValueError, match=complaint) as refusal:
        steps_per_crossing(rig)
    with pytest.raises(ValueError, match=complaint):
        Stepper(rig)
    feasible = str(refusal.value).split('feasible: ')[1].split()[2]
    assert steps_per_crossing(better(float(feasible))) <= module.MAX_STEPS


def test_default_steps_resolve_crossing_relaxation_and_period():
    assert steps_per_crossing(Rig()) == 64
    assert steps_per_crossing(make_rig(0.01, 10.0)) == pytest.approx(800, abs=1)
    assert steps_per_crossing(make_rig(1.0, 0.5)) == 320


def test_warm_up_leaves_nothing_to_compile():
    warm_up()
    compiled = {
        name: len(kernel.signatures)
        for name, kernel in vars(module).items()
        if hasattr(kernel, 'signatures')
    }
    model = Stepper(Rig())
    model.advance_to(0.3)
    model.read_field(*np.empty((2, 64)))
    model.sample_field([0.31], np.empty((1, 64)))
    model.stored_energy()
    assert {name: len(vars(module)[name].signatures) for name in compiled} == compiled
