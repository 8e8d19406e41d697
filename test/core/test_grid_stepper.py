# SPDX-License-Identifier: Apache-2.0
"""Finite differences in real time."""

from dataclasses import replace
import math
import tracemalloc

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from soft_throw_ros.core import finite_difference, spring_mass
from soft_throw_ros.core import grid_stepper as module
from soft_throw_ros.core.graded_layer import GradedLayer
from soft_throw_ros.core.grid_stepper import (
    cells_per_layer,
    GridStepper,
    MAX_CELLS,
    warm_up,
)
from soft_throw_ros.core.method_of_steps import follow
from soft_throw_ros.core.models import ON_GRIDS
from soft_throw_ros.core.plate import peak_velocity_ratio, Sampled, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.stepping import (
    EventLimitError,
    HorizonError,
    PLATE_FORCE,
    PLATE_POSITION,
    PLATE_VELOCITY,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    TIME,
)

FREQUENCY = 63.2
LOSSY = Rig(layer=Layer(loss_tangent=0.1))
STACKED = Rig(
    layer=GradedLayer.stack(
        Layer(thickness=6e-3), Layer(thickness=4e-3, wave_speed=20.0, loss_tangent=0.1)
    )
)
CAPPED = Rig(
    layer=GradedLayer.stack(
        Layer(thickness=8e-3), Layer(thickness=1e-4, wave_speed=200.0, density=5000.0)
    )
)
CASES = {
    'uniform': (Rig(), 'finite_difference'),
    'lossy': (LOSSY, 'finite_difference'),
    'stacked': (STACKED, 'finite_difference'),
    'capped': (CAPPED, 'finite_difference'),
    'echoes': (Rig(layer=Layer(thickness=0.002), gravity=20.0), 'finite_difference'),
    'elastic': (Rig(), 'finite_difference_elastic'),
    'soft': (Rig(projectile=Projectile(youngs_modulus=1e6)), 'finite_difference_elastic'),
    'glued': (LOSSY, 'finite_difference_glued'),
    'spring': (LOSSY, 'spring_mass'),
}


def make_rig(mass_ratio, speed_ratio, damping_ratio=0.0, gravity=0.0, **layer):
    layer = Layer(thickness=7.8 / (speed_ratio * FREQUENCY), **layer)
    return Rig(
        engine=Engine(frequency=FREQUENCY, damping_ratio=damping_ratio),
        layer=layer,
        projectile=Projectile(mass=mass_ratio * layer.mass),
        gravity=gravity,
    )


def make_paper_rig(thickness, gravity=0.0, damping_ratio=0.0):
    return Rig(
        engine=Engine(damping_ratio=damping_ratio),
        layer=Layer(thickness=thickness),
        projectile=Projectile(mass=1300.0 * 16.3e-3 * math.pi * 6e-3**2, length=16.3e-3),
        gravity=gravity,
    )


def throw(rig, periods=4.0, **options):
    """Advance until the projectile has left, and return the stepper."""
    model = GridStepper(rig, **options)
    for quarter in range(1, round(4 * periods) + 1):
        if model.advance_to(0.25 * quarter / rig.engine.frequency):
            return model
    raise AssertionError('no release')


def is_feasible(rig, name):
    try:
        cells_per_layer(rig, name)
    except ValueError:
        return False
    return True


def observe(model):
    """Return all there is to see, as bits."""
    strain, velocity = np.empty((2, model.field_points))
    model.read_field(strain, velocity)
    numbers = [
        *model.state, *strain, *velocity, *model.peaks, *model.first_peaks, model.work,
        model.peak_work, model.stored_energy(), model.dissipated, model.highest_position,
        model.surface_position, model.peak_strain, model.first_peak_strain,
    ]  # fmt: skip
    return np.array(numbers).tobytes(), model.events(), model.in_contact, model.event_count


# Computed with 40-digit closed forms, checked by a second method: mu, kappa, zeta, te f, alpha
@pytest.mark.parametrize(
    ('mu', 'kappa', 'zeta', 'phase', 'alpha'),
    [
        (0.23423068535205, 8.2422098072057, 0.0, 0.3994399384513045, 4.123214640552163),
        (0.29513187784084, 9.2434758430532, 0.2, 0.3633656659293691, 4.185169858004478),
        (50.0, 60.0, 0.0, 0.4266129421799032, 3.037440451346464),
        (1.0, 1.0, 0.0, 1.4590473863951916, 0.25904598562307973),
        (0.01, 4.0, 0.064, 0.4928020665289209, 3.9990119588094664),
        (0.6345238095238095, 7.34629294755877, 0.064, 0.48150827831570486, 3.63734724564707),
    ],
)
def test_first_release_is_exact_to_1e_3_with_100_cells_and_converges(
    mu, kappa, zeta, phase, alpha
):
    rig = make_rig(mu, kappa, zeta)
    errors = []
    for cells in (100, 200, 400):
        release = throw(rig, cells=cells).events()[0]
        speed = release.velocity / rig.engine.speed_scale
        found = (speed / peak_velocity_ratio(zeta)) ** 2
        assert release.time * FREQUENCY == pytest.approx(phase, rel=1e-3)
        assert found == pytest.approx(alpha, rel=1e-3)
        errors.append([abs(release.time * FREQUENCY - phase), abs(found - alpha)])
    slopes = np.polyfit(np.log([100, 200, 400]), np.log(errors), 1)[0]
    assert (slopes < -1.8).all()


# Computed with 40-digit closed forms, checked by a second method
@pytest.mark.parametrize(
    ('thickness', 'phase', 'center', 'face'),
    [
        (0.002, 0.25234398637936983, 1.5146422569913178, 1.514621268422948),
        (0.0056, 0.3689758829724327, 1.809256199489624, 1.8092403238788732),
    ],
)
def test_elastic_projectile_is_exact_to_2e_5(thickness, phase, center, face):
    rig = make_paper_rig(thickness)
    model = throw(rig, model='finite_difference_elastic', cells=256)
    release = model.events()[0]
    unit = rig.engine.speed_scale
    assert release.time * FREQUENCY == pytest.approx(phase, rel=2e-5)
    assert release.velocity / unit == pytest.approx(center, rel=2e-5)
    model.reset()
    model.advance_to(release.time)
    assert model.state[PROJECTILE_VELOCITY] / unit == pytest.approx(face, rel=2e-5)


# Computed with 40-digit closed forms, checked by a second method; time in plate periods
@pytest.mark.parametrize(
    ('mu', 'kappa', 'events', 'first', 'alpha_first', 'last', 'alpha_last'),
    [
        (5.0, 1.5, 7, 1.1525105269970801, 0.03156194956881057, 5.030617046549641,
         0.19482040123175556),
        (3.0333, 2.5, 3, 0.8651147294875321, 0.1891200559290065, 2.002892429791799,
         0.4218872106128318),
    ],
)  # fmt: skip
def test_recontact_is_followed_to_the_last_release(
    mu, kappa, events, first, alpha_first, last, alpha_last
):
    rig = make_rig(mu, kappa)
    model = GridStepper(rig, cells=256)
    assert model.advance_to(60.0 / FREQUENCY) == events
    kinds = [event.kind for event in model.events()]
    assert kinds == ['release', 'landing'] * (events // 2) + ['release']
    for event, time, alpha in (
        (model.events()[0], first, alpha_first),
        (model.events()[-1], last, alpha_last),
    ):
        assert event.time * FREQUENCY == pytest.approx(time, abs=1e-5)
        assert (event.velocity / rig.engine.speed_scale) ** 2 == pytest.approx(alpha, abs=3e-5)


# Computed with 40-digit closed forms, checked by a second method; s, m/s
def test_gravity_delays_the_release_and_brings_the_projectile_back():
    model = GridStepper(make_paper_rig(0.0056, 9.81, 0.064), cells=256)
    model.advance_to(0.275)
    first, second = model.events()[:2]
    assert (first.kind, second.kind) == ('release', 'landing')
    assert first.time == pytest.approx(0.0057781780440564505, rel=1e-6)
    assert first.velocity == pytest.approx(1.3129434316774524, rel=1e-5)
    assert second.time == pytest.approx(0.27423609529097615, rel=2e-5)
    assert second.velocity == pytest.approx(-1.3206287365148273, rel=2e-5)


# Computed with 40-digit closed forms, checked by a second method
@pytest.mark.parametrize(
    ('thickness', 'largest', 'at_contact'),
    [
        (0.002, 0.20455695136726773, 0.1929978563882354),
        (0.0056, 0.18543981232911014, 0.15991912482862805),
    ],
)
def test_peaks_up_to_the_first_release_are_exact(thickness, largest, at_contact):
    rig = make_paper_rig(thickness)
    model = GridStepper(rig, cells=256)
    model.advance_to(0.05)
    peaks = model.first_peaks
    assert model.first_peak_strain == pytest.approx(largest, rel=1e-4)
    assert peaks.plate_strain == pytest.approx(largest, rel=1e-4)
    assert peaks.contact_strain == pytest.approx(at_contact, rel=1e-4)
    stiffness = rig.layer.youngs_modulus * rig.layer.section
    assert peaks.plate_force == pytest.approx(largest * stiffness, rel=1e-4)
    assert peaks.acceleration * rig.projectile.mass == pytest.approx(
        at_contact * stiffness, rel=1e-4
    )
    assert all(now >= then for now, then in zip(model.peaks, peaks, strict=True))


@pytest.mark.parametrize(('mu', 'kappa'), [(0.2342, 8.242), (5.2, 3.75)])
def test_every_event_is_of_second_order(mu, kappa):
    rig = make_rig(mu, kappa, gravity=20.0)
    history = follow(rig, max_events=6)
    cells = np.array([64, 96, 128, 192, 256, 384, 512])
    errors = []
    for count in cells:
        model = GridStepper(rig, cells=int(count))
        model.advance_to(history.end_time + 1e-4)
        pairs = list(zip(model.events(), history.events, strict=False))
        assert len(pairs) == 6
        assert all(ours.kind == exact.kind for ours, exact in pairs)
        errors.append([abs(ours.velocity - exact.velocity) for ours, exact in pairs])
    slopes = np.polyfit(np.log(cells), np.log(errors), 1)[0]
    assert (slopes < -1.6).all()


def test_state_and_events_agree_with_the_exact_history():
    rig = Rig(gravity=20.0)
    history = follow(rig, max_events=5)
    model = GridStepper(rig, cells=400)
    scale = rig.engine.speed_scale
    for time in np.sort(np.random.default_rng(5).uniform(0.0, history.end_time, 300)):
        model.advance_to(time)
        assert model.state[TIME] == time
        for index, exact, unit in (
            (PLATE_POSITION, history.motion.position(time), 1e-6 * scale / FREQUENCY),
            (PLATE_VELOCITY, history.motion.velocity(time), 1e-6 * scale),
            (PROJECTILE_POSITION, history.projectile_position(time), scale / FREQUENCY),
            (PROJECTILE_VELOCITY, history.projectile_velocity(time), scale),
        ):
            assert model.state[index] == pytest.approx(float(exact), abs=4e-4 * unit)
        assert model.surface_position == pytest.approx(
            float(history.top_position(time)), abs=2e-3 * scale / FREQUENCY
        )
        if time < 0.8 * history.events[1].time:  # landings send jumps of force
            for index, exact in (
                (PLATE_FORCE, history.plate_force(time)),
                (PROJECTILE_FORCE, history.contact_force(time)),
            ):
                unit = rig.layer.impedance * scale
                assert model.state[index] == pytest.approx(float(exact), abs=3e-3 * unit)
    assert model.event_count == sum(event.time <= time for event in history.events)


def test_field_agrees_with_the_exact_history_to_second_order():
    rig = make_rig(0.6345, 7.346)
    history = follow(rig, max_events=1)
    errors = []
    for cells in (50, 100, 200):
        model = GridStepper(rig, cells=cells, field_points=33)
        depths = np.linspace(0.0, rig.layer.thickness, 33)
        strain, velocity = np.empty((2, 33))
        worst = np.zeros(2)
        for time in np.linspace(0.0, 0.99 * history.end_time, 50):
            model.advance_to(time)
            model.read_field(strain, velocity)
            scale = rig.engine.speed_scale
            kink = abs(time % rig.crossing_time - depths / 7.8) < 0.06 * rig.crossing_time
            kink |= abs(time % rig.crossing_time + depths / 7.8 - rig.crossing_time) < (
                0.06 * rig.crossing_time
            )
            wrong = np.array(
                [
                    7.8 / scale * (strain - history.strain(depths, time)),
                    (velocity - history.velocity(depths, time)) / scale,
                ]
            )
            worst = np.maximum(worst, np.abs(wrong[:, ~kink]).max(axis=1, initial=0.0))
        errors.append(worst)
    assert (np.array(errors[-1]) < 1e-3).all()
    assert (np.polyfit(np.log([50, 100, 200]), np.log(errors), 1)[0] < -1.5).all()


def test_layer_of_constant_impedance_throws_as_a_uniform_one():
    """Waves are not reflected where density times modulus stays the same."""
    uniform = Rig()
    density, modulus = uniform.layer.density, uniform.layer.youngs_modulus

    def factor(y):
        return 1.0 + 60.0 * y

    # thick enough that a wave needs as long
    thickness = (math.exp(60.0 * uniform.layer.thickness) - 1.0) / 60.0
    layer = GradedLayer.sample(
        thickness=thickness,
        youngs_modulus=lambda y: modulus * factor(y),
        density=lambda y: density / factor(y),
        points=4001,
    )
    assert layer.crossing_time == pytest.approx(uniform.crossing_time, rel=1e-6)
    graded, even = (
        throw(replace(uniform, layer=one), cells=128) for one in (layer, uniform.layer)
    )
    assert graded.events()[0].time == pytest.approx(even.events()[0].time, rel=1e-5)
    assert graded.events()[0].velocity == pytest.approx(even.events()[0].velocity, rel=1e-5)


def test_graded_layer_converges_in_second_order_and_is_the_limit_of_stacks():
    thickness = 0.0168

    def modulus(y):
        return 3e4 * (1.0 + y / thickness) ** 2

    graded = Rig(
        layer=GradedLayer.sample(
            thickness=thickness, youngs_modulus=modulus, density=lambda y: 1000.0 - 2e4 * y
        )
    )
    cells = [32, 64, 128, 256]
    found = [throw(graded, cells=count).events()[0] for count in cells]
    finest = throw(graded, cells=1024).events()[0]
    errors = [[abs(a.time - finest.time), abs(a.velocity - finest.velocity)] for a in found]
    assert (np.polyfit(np.log(cells), np.log(errors), 1)[0] < -1.9).all()
    slabs = []
    for n in range(40):
        y = (n + 0.5) / 40.0 * thickness
        density = 1000.0 - 2e4 * y
        speed = math.sqrt(modulus(y) / density)
        slabs.append(Layer(thickness=thickness / 40.0, wave_speed=speed, density=density))
    stack = throw(replace(graded, layer=GradedLayer.stack(*slabs)), cells=800).events()[0]
    assert stack.time == pytest.approx(finest.time, rel=1e-4)
    assert stack.velocity == pytest.approx(finest.velocity, rel=1e-3)


def test_slabs_of_one_material_are_the_uniform_layer():
    slabs = [Layer(thickness=16.8e-3 / 4)] * 4
    stack = throw(Rig(layer=GradedLayer.stack(*slabs)), cells=128).events()[0]
    even = throw(Rig(), cells=128).events()[0]
    assert stack.time == pytest.approx(even.time, rel=1e-12)
    assert stack.velocity == pytest.approx(even.velocity, rel=1e-12)


def test_stiff_slab_between_two_layers_is_a_mass():
    """However stiff it is, the step stays; a slab twice as stiff moves all the same."""
    found = []
    for speed in (150.0, 300.0):
        cap = Layer(thickness=2e-4, wave_speed=speed, density=7800.0)
        layer = GradedLayer.stack(Layer(thickness=8e-3), cap, Layer(thickness=8e-3))
        model = throw(Rig(layer=layer), cells=200)
        assert model.grid.step > 1e-5
        found.append(model.events()[0])
    assert found[0].time == pytest.approx(found[1].time, rel=1e-3)
    assert found[0].velocity == pytest.approx(found[1].velocity, rel=1e-3)


def test_stiff_projectile_is_a_rigid_one():
    stiff = replace(Rig(), projectile=Projectile(youngs_modulus=1e12))
    elastic = throw(stiff, model='finite_difference_elastic', cells=128)
    rigid = throw(stiff, cells=128)
    assert elastic.events()[0].time == pytest.approx(rigid.events()[0].time, rel=1e-6)
    assert elastic.events()[0].velocity == pytest.approx(rigid.events()[0].velocity, rel=1e-6)
    for model in (elastic, rigid):  # back on the layer, and up again
        model.advance_to(0.32)
    assert elastic.event_count == rigid.event_count >= 3
    for one, other in zip(elastic.events(), rigid.events(), strict=True):
        assert one.kind == other.kind
        assert one.time == pytest.approx(other.time, rel=1e-4)
        assert one.velocity == pytest.approx(other.velocity, abs=2e-3)


@pytest.mark.parametrize('loss', [0.0, 0.05])
@pytest.mark.parametrize('model', ['finite_difference', 'finite_difference_elastic',
                                   'finite_difference_glued'])  # fmt: skip
@pytest.mark.parametrize('gravity', [0.0, 9.81])
def test_release_agrees_with_that_of_many_throws_at_once(loss, model, gravity):
    rig = make_rig(0.5, 7.0, 0.064, gravity, loss_tangent=loss)
    rig = replace(rig, projectile=replace(rig.projectile, youngs_modulus=1e7))
    release = throw(rig, model=model, cells=512).events()[0]
    expected = finite_difference.first_releases(
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        damping_ratio=0.064,
        gravity_ratio=rig.gravity_ratio,
        loss_tangent=loss,
        crossing_ratio=rig.crossing_ratio if 'elastic' in model else 0.0,
        glued_to='projectile' if 'glued' in model else 'plate',
        cells=256,
    )
    assert release.time * FREQUENCY == pytest.approx(expected.ejection_phase, rel=1e-4)
    assert release.velocity / rig.engine.speed_scale == pytest.approx(expected.speed, rel=2e-5)


def test_layer_without_mass_is_the_spring_of_the_appendix():
    for mass_ratio, speed_ratio in ((1.0, 5.0), (4.0, 20.0), (0.3, 9.0)):
        rig = make_rig(mass_ratio, speed_ratio)
        exact = spring_mass.first_release(
            frequency_ratio=rig.natural_frequency / rig.engine.frequency
        )
        release = throw(rig, model='spring_mass').events()[0]
        assert release.time * FREQUENCY == pytest.approx(exact.ejection_phase, abs=2e-5)
        speed = release.velocity / rig.engine.speed_scale
        assert speed == pytest.approx(exact.speed, abs=2e-5)


@pytest.mark.parametrize('loss', [0.0, 0.2])
def test_layer_without_mass_agrees_with_an_integrated_oscillator(loss):
    rig = make_rig(1.5, 6.0, 0.1, gravity=9.81, loss_tangent=loss)
    plate = Underdamped.of(rig.engine)
    mass, spring = rig.projectile.mass, rig.layer.stiffness
    dashpot = spring * loss / rig.engine.angular_frequency

    def force(time, state):
        stretch = state[0] - float(plate.position(time))
        rate = state[1] - float(plate.velocity(time))
        return mass * 9.81 - spring * stretch - dashpot * rate

    def released(time, state):
        return force(time, state) if time > 1e-5 else 1.0

    released.terminal, released.direction = True, -1.0
    done = solve_ivp(
        lambda time, state: [state[1], force(time, state) / mass - 9.81],
        (0.0, 0.05),
        [0.0, 0.0],
        'DOP853',
        events=released,
        rtol=1e-10,
        atol=1e-12,
    )
    release = throw(rig, model='spring_mass').events()[0]
    assert release.time == pytest.approx(done.t_events[0][0], rel=1e-5)
    assert release.velocity == pytest.approx(done.y_events[0][0][1], rel=1e-5)


def test_layer_on_the_projectile_takes_it_off_the_plate_and_back():
    rig = replace(LOSSY, gravity=9.81)
    model = GridStepper(rig, model='finite_difference_glued', cells=128)
    strain, velocity = np.empty((2, 64))
    model.advance_to(0.15)
    release = model.events()[0]
    assert model.event_count == 1
    # nothing holds it: no force on the plate, and the common centre of mass falls freely
    assert model.state[PLATE_FORCE] == 0.0
    model.read_field(strain, velocity)
    thrown = rig.layer.mass + rig.projectile.mass
    momentum = (
        rig.layer.mass * velocity.mean() + rig.projectile.mass * model.state[PROJECTILE_VELOCITY]
    )
    falling = release.velocity - 9.81 * (0.15 - release.time)
    assert momentum / thrown == pytest.approx(falling, rel=1e-3)
    # the layer's loss has calmed it: it hangs on the projectile without load
    assert abs(strain).max() < 1e-4
    model.advance_to(0.35)
    landing = model.events()[1]
    assert landing.kind == 'landing'
    assert landing.velocity == pytest.approx(
        release.velocity - 9.81 * (landing.time - release.time), rel=1e-4
    )
    assert model.peaks.plate_force > 0.0


@pytest.mark.parametrize('case', ['uniform', 'lossy', 'stacked', 'elastic', 'glued', 'spring'])
def test_work_of_the_plate_is_what_is_stored_and_what_is_lost(case):
    rig, name = CASES[case] if case != 'spring' else (Rig(), 'spring_mass')
    errors = []
    cells = [24, 48, 96] if name != 'spring_mass' else [1, 1, 1]
    steps = [None] * 3 if name != 'spring_mass' else [4e-5, 2e-5, 1e-5]
    for count, step in zip(cells, steps, strict=True):
        model = GridStepper(rig, model=name, cells=count, step=step)
        worst = 0.0
        for time in np.linspace(1e-3, 0.014, 90):
            model.advance_to(time)
            kept = model.stored_energy() + model.dissipated
            worst = max(worst, abs(kept - model.work) / model.peak_work)
        errors.append(worst)
    assert errors[-1] < 1e-3
    assert np.polyfit(np.log([1.0, 2.0, 4.0]), np.log(errors), 1)[0] < -1.6
    assert (model.dissipated > 0.0) is (rig.layer.loss_tangent > 0.0)


@pytest.mark.parametrize('case', ['uniform', 'capped', 'elastic', 'soft', 'glued'])
def test_energy_never_grows_in_endless_bouncing(case):
    rig, name = CASES[case]
    engine = replace(rig.engine, damping_ratio=0.5)
    model = GridStepper(replace(rig, engine=engine, gravity=30.0), model=name, cells=40)
    model.advance_to(0.1)  # the plate rests
    energy = model.stored_energy()
    for time in np.linspace(0.1, 1.0, 50):
        model.advance_to(time)
        assert model.stored_energy() < 1.01 * energy
    assert model.event_count > 10


def test_at_rest_nothing_moves():
    still = Sampled.from_velocities(np.linspace(0.0, 1.0, 9), np.zeros(9), after='hold')
    for case, (rig, name) in CASES.items():
        model = GridStepper(rig, still, model=name)
        strain, velocity = np.empty((2, 64))
        weight = rig.projectile.mass * rig.gravity
        load = weight + (rig.layer.mass * rig.gravity if 'glued' in name else 0.0)
        for time in np.linspace(0.0, 0.2, 10):
            assert model.advance_to(time) == 0
            model.read_field(strain, velocity)
            expected = [time, 0.0, model.rest_position, 0.0, 0.0, -load, weight]
            assert model.state.tolist() == pytest.approx(expected, rel=1e-14), case
            assert not velocity.any()
        spring = rig.layer.stiffness * rig.layer.thickness
        if rig.layer.is_uniform:
            assert strain[0] * spring == pytest.approx(-load, rel=1e-12)
            assert strain[-1] * spring == pytest.approx(-weight, rel=1e-12)
        own = 0.5 * (load - weight) / rig.layer.stiffness
        sag = rig.static_sag + own
        assert model.rest_position == pytest.approx(rig.layer.thickness - sag, rel=1e-12)
        assert model.stored_energy() == model.work == 0.0


@settings(max_examples=30)
@given(
    times=st.lists(st.floats(0.0, 0.35), min_size=1, max_size=40).map(sorted),
    case=st.sampled_from(sorted(CASES)),
)
def test_results_do_not_depend_on_the_times_asked_for(times, case):
    rig, name = CASES[case]
    often, once = (GridStepper(rig, model=name, cells=32) for _ in range(2))
    for time in times:
        often.advance_to(time)
    once.advance_to(times[-1])
    assert observe(often) == observe(once)


@pytest.mark.parametrize('case', sorted(CASES))
def test_reset_repeats_the_throw_bit_for_bit(case):
    rig, name = CASES[case]
    model = GridStepper(rig, model=name, cells=32)
    at_start = observe(model)
    model.advance_to(0.3)
    at_end = observe(model)
    assert at_end != at_start
    model.advance_to(0.3)
    assert observe(model) == at_end
    model.reset()
    assert observe(model) == at_start
    model.advance_to(0.3)
    assert observe(model) == at_end


def test_events_show_when_their_time_has_come():
    model = GridStepper(Rig(), cells=64)
    model.advance_to(0.02)
    (release,) = model.events()
    step = model.grid.step
    model.reset()
    assert model.advance_to(release.time - 1e-3 * step) == 0
    assert model.in_contact
    assert model.state[PROJECTILE_FORCE] == pytest.approx(0.0, abs=1e-4)
    assert model.advance_to(release.time) == 1
    assert not model.in_contact
    assert model.state[PROJECTILE_FORCE] == 0.0
    assert model.state[PROJECTILE_VELOCITY] == pytest.approx(release.velocity, rel=1e-4)


def test_sampled_field_has_the_rows_of_read_field():
    times = np.linspace(0.0, 0.02, 21)
    for case in ('lossy', 'glued', 'capped'):
        rig, name = CASES[case]
        out = np.empty((21, 33))
        GridStepper(rig, model=name, field_points=33).sample_field(times, out)
        model = GridStepper(rig, model=name, field_points=33)
        strain, velocity = np.empty((2, 33))
        for time, row in zip(times, out, strict=True):
            model.advance_to(time)
            model.read_field(strain, velocity)
            assert row.tobytes() == strain.tobytes()


@pytest.mark.parametrize('gravity', [0.0, 9.81])
def test_plate_that_falls_away_leaves_the_projectile_behind(gravity):
    rig = Rig(gravity=gravity)
    times = np.arange(3e-4, 0.03, 2e-4)
    motion = Sampled.from_positions(times, -Underdamped.of(rig.engine).position(times))
    history = follow(rig, motion, until=0.02)
    model = GridStepper(rig, motion, cells=400)
    model.advance_to(0.02)
    assert [event.kind for event in model.events()] == ['release', 'landing', 'release']
    for ours, exact in zip(model.events(), history.events, strict=True):
        assert ours.kind == exact.kind
        assert ours.time * FREQUENCY == pytest.approx(exact.time * FREQUENCY, abs=1e-3)
        assert ours.velocity == pytest.approx(exact.velocity, abs=1e-3)


@pytest.mark.parametrize('kind', ['positions', 'velocities'])
def test_sampled_and_fed_plates_agree_with_the_analytic_one(kind):
    exact = GridStepper(LOSSY, cells=64)
    exact.advance_to(0.02)
    plate = Underdamped.of(LOSSY.engine)
    times = np.arange(0.0, 0.03, 2e-4)
    values = plate.position(times) if kind == 'positions' else plate.velocity(times)
    sampled = GridStepper(LOSSY, getattr(Sampled, f'from_{kind}')(times, values), cells=64)
    sampled.advance_to(0.02)
    fed = GridStepper(LOSSY, 'measured', cells=64)
    for part in np.array_split(np.arange(times.size), 9):
        fed.feed(times[part], **{kind: values[part]})
        fed.advance_to(min(fed.horizon, 0.02))
    fed.advance_to(0.02)
    for model in (sampled, fed):
        assert model.state == pytest.approx(exact.state, rel=1e-3, abs=1e-6)
        assert model.events()[0].time == pytest.approx(exact.events()[0].time, rel=1e-4)
        assert model.events()[0].velocity == pytest.approx(exact.events()[0].velocity, rel=1e-4)


def test_feeding_in_other_portions_changes_no_bit():
    times = 0.0013 + np.arange(120) * 7.7e-4
    values = Underdamped.of(Engine()).position(times)
    models = []
    for parts in (1, 7, 60):
        model = GridStepper(LOSSY, 'measured', cells=32)
        for part in np.array_split(np.arange(times.size), parts):
            model.feed(times[part], positions=values[part])
            model.advance_to(min(model.horizon, 0.06))
        model.advance_to(0.06)
        models.append(observe(model))
    assert models[0] == models[1] == models[2]


def test_fed_plate_is_followed_to_the_last_whole_step():
    model = GridStepper(Rig(), 'measured', cells=64)
    assert model.horizon == 0.0
    times = np.arange(0.01, 0.02, 0.001)
    model.feed(times, velocities=np.ones(10))
    assert times[-3] - model.grid.step < model.horizon <= times[-3]
    model.advance_to(model.horizon)
    assert model.state[PLATE_VELOCITY] == pytest.approx(1.0, rel=1e-12)
    with pytest.raises(HorizonError, match=r'known until 0\.0169.* s, got 0\.017 s'):
        model.advance_to(0.017)
    model.reset()
    assert model.horizon == 0.0


@settings(max_examples=40)
@given(
    frequency=st.floats(1.0, 1000.0),
    amplitude=st.floats(math.log(1e-5), math.log(0.1)).map(math.exp),
    damping_ratio=st.floats(0.0, 0.99),
    thickness=st.floats(math.log(0.5e-3), math.log(0.1)).map(math.exp),
    wave_speed=st.floats(0.0, math.log(200.0)).map(math.exp),
    density=st.floats(50.0, 5000.0),
    loss=st.one_of(st.just(0.0), st.floats(math.log(1e-3), math.log(3.0)).map(math.exp)),
    mass=st.floats(math.log(1e-5), 0.0).map(math.exp),
    youngs_modulus=st.floats(math.log(1e6), math.log(1e12)).map(math.exp),
    gravity=st.sampled_from([0.0, 9.81, 30.0]),
    name=st.sampled_from(ON_GRIDS),
)
def test_whole_range_of_parameters_gives_finite_throws(
    frequency, amplitude, damping_ratio, thickness, wave_speed, density, loss, mass,
    youngs_modulus, gravity, name,
):  # fmt: skip
    rig = Rig(
        engine=Engine(frequency=frequency, amplitude=amplitude, damping_ratio=damping_ratio),
        layer=Layer(
            thickness=thickness, wave_speed=wave_speed, density=density, loss_tangent=loss
        ),
        projectile=Projectile(mass=mass, youngs_modulus=youngs_modulus),
        gravity=gravity,
    )
    if not is_feasible(rig, name):
        with pytest.raises(ValueError, match='feasible: '):
            GridStepper(rig, model=name)
        return
    model = GridStepper(rig, model=name)
    strain, velocity = np.empty((2, 64))
    highest, peaks = model.highest_position, model.peaks
    try:
        for time in np.linspace(0.0, min(3.0 / frequency, 2e4 * model.grid.step), 20):
            model.advance_to(time)
            model.read_field(strain, velocity)
            assert np.isfinite(model.state).all()
            assert np.isfinite(strain).all()
            assert np.isfinite(velocity).all()
            assert np.isfinite(model.stored_energy())
            assert model.stored_energy() < 1.5 * model.peak_work + 1e-12
            assert model.highest_position >= highest
            assert all(now >= then for now, then in zip(model.peaks, peaks, strict=True))
            highest, peaks = model.highest_position, model.peaks
    except EventLimitError:
        assert model.event_count > 100
    kinds = [event.kind for event in model.events()]
    assert kinds == (['release', 'landing'] * len(kinds))[: len(kinds)]
    times = [event.time for event in model.events()]
    assert times == sorted(times)


def test_advancing_allocates_nothing():
    model = GridStepper(Rig(layer=Layer(thickness=0.002, loss_tangent=0.02)))
    strain, velocity = np.empty((2, 64))
    times = np.linspace(0.0, 0.3, 500).tolist()
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
    assert model.event_count >= 2
    assert after - before < 1000
    assert peak - before < 4000  # numbers on their way


def test_endless_events_end_in_a_named_error():
    light = Projectile(mass=4e-4)
    rig = Rig(layer=Layer(thickness=5e-3), projectile=light, gravity=30.0)
    model = GridStepper(rig, cells=64)
    with pytest.raises(EventLimitError, match=r'more than 4096 .* before 60 s'):
        model.advance_to(60.0)
    with pytest.raises(EventLimitError):
        model.advance_to(60.0)
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
    model = GridStepper(Rig())
    with pytest.raises(ValueError, match=complaint):
        model.advance_to(time)
    assert model.advance_to(0.01) == 1


@pytest.mark.parametrize(
    ('arguments', 'complaint'),
    [
        ({'cells': 0}, f'cells must be from 1 to {MAX_CELLS}, got 0'),
        ({'cells': MAX_CELLS + 1}, f'got {MAX_CELLS + 1}'),
        ({'cells': 64.0}, r'cells must be a whole number, got 64\.0'),
        ({'cells': 64, 'step': 1e-3}, r'step must be at most 3\.36538e-05 s .* got 0\.001 s'),
        ({'field_points': 1}, 'field_points must be from 2 .* got 1'),
        ({'motion': 'harmonic'}, "got 'harmonic'"),
        ({'model': 'travelling_wave'}, "finite_difference, .* got 'travelling_wave'"),
    ],
)
def test_bad_arguments_are_quoted(arguments, complaint):
    with pytest.raises(ValueError, match=complaint):
        GridStepper(Rig(), **arguments)


@pytest.mark.parametrize(
    ('rig', 'complaint', 'better'),
    [
        (
            Rig(layer=Layer(thickness=0.5e-3, wave_speed=50.0)),
            r'thickness 0\.0005 m .* 50 m/s needs 4\.1e\+08 updates .* the limit is ',
            lambda number: Rig(layer=Layer(thickness=number, wave_speed=50.0)),
        ),
        (
            Rig(projectile=Projectile(mass=1e-6)),
            r'mass 1e-06 kg .* needs 7601 cells, the limit is ',
            lambda number: Rig(projectile=Projectile(mass=number)),
        ),
        (
            Rig(
                engine=Engine(frequency=1000.0),
                layer=Layer(thickness=0.1, wave_speed=1.0, diameter=1e-3),
            ),
            r'frequency 1000 Hz .* needs 8000 cells, the limit is ',
            lambda number: Rig(
                engine=Engine(frequency=number),
                layer=Layer(thickness=0.1, wave_speed=1.0, diameter=1e-3),
            ),
        ),
    ],
)
def test_rigs_beyond_real_time_are_refused_with_what_would_do(rig, complaint, better):
    with pytest.raises(ValueError, match=complaint) as refusal:
        cells_per_layer(rig)
    with pytest.raises(ValueError, match=complaint):
        GridStepper(rig)
    feasible = str(refusal.value).split('feasible: ')[1].split()[2]
    assert cells_per_layer(better(float(feasible))) <= MAX_CELLS


def test_projectile_too_slow_for_real_time_is_refused_with_what_would_do():
    rig = Rig(projectile=Projectile(youngs_modulus=1e4, length=0.1, mass=0.02))
    model = 'finite_difference_elastic'
    with pytest.raises(ValueError, match=r'youngs_modulus 10000 Pa needs 19\.\d times') as refusal:
        cells_per_layer(rig, model)
    feasible = float(str(refusal.value).split('feasible: ')[1].split()[2])
    better = replace(rig, projectile=replace(rig.projectile, youngs_modulus=feasible))
    assert GridStepper(better, model=model).grid.cells == cells_per_layer(better, model) == 64


def test_spring_too_fast_for_real_time_is_refused():
    rig = Rig(layer=Layer(wave_speed=200.0, diameter=0.2), projectile=Projectile(mass=1e-5))
    with pytest.raises(ValueError, match=r'swings at .* Hz .* updates per second'):
        GridStepper(rig, model='spring_mass')


def test_warm_up_leaves_nothing_to_compile():
    warm_up()
    compiled = {
        name: len(kernel.signatures)
        for name, kernel in vars(module).items()
        if hasattr(kernel, 'signatures')
    }
    for rig, name in CASES.values():
        model = GridStepper(rig, model=name)
        model.advance_to(0.3)
        model.read_field(*np.empty((2, 64)))
        model.sample_field([0.31], np.empty((1, 64)))
        model.stored_energy()
    assert {name: len(vars(module)[name].signatures) for name in compiled} == compiled
