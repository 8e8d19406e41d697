# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Travelling waves by a delay line, against closed forms and the method of steps."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from reference.cases import exact_release, FREQUENCY, log_uniform, make_rig, order, released
from reference.method_of_steps import follow
from scipy.integrate import trapezoid
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import PLATE_POSITION, PROJECTILE_POSITION, PROJECTILE_VELOCITY
from soft_throw_ros.core.wave_stepper import WaveStepper


@settings(max_examples=60)
@given(
    mass_ratio=log_uniform(0.003, 100.0),
    speed_ratio=log_uniform(0.15, 120.0),
    damping_ratio=st.sampled_from([0.0, 0.064, 0.3]),
    gravity_ratio=st.sampled_from([0.0, 0.002, 0.03]),
)
def test_first_release_agrees_with_the_closed_form(
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio
):
    rig = make_rig(mass_ratio, speed_ratio, damping_ratio, gravity_ratio)
    exact = exact_release(rig)
    if np.isnan(exact.speed):
        return
    release = released(WaveStepper(rig), exact.ejection_phase + 1.0).events()[0]
    assert release.time * FREQUENCY == pytest.approx(exact.ejection_phase, abs=1e-6)
    assert release.velocity / rig.engine.speed_scale == pytest.approx(exact.speed, abs=1e-6)


# Re-contacts in the regions where they are (slow waves; thin stiff layers), and bounces under
# gravity: mass ratio, speed ratio, damping ratio, gravity ratio
BOUNCES = [
    (5.0, 1.5, 0.0, 0.0), (5.2, 3.75, 0.0, 0.0), (3.0333, 2.5, 0.0, 0.0), (4.99, 1.15, 0.0, 0.0),
    (0.108, 73.5, 0.064, 0.0), (0.367, 4.4, 0.0, 0.2), (3.453, 1.6, 0.0, 0.05),
    (0.2342, 8.242, 0.0, 0.3), (2.0, 40.0, 0.064, 0.3), (10.0, 150.0, 0.064, 0.5),
]
# Releases at the echo of a landing, whose time is known to a step
ECHOES = [
    (1.2963, 4.6965, 0.0, 0.2608), (3.146, 28.5364, 0.0, 0.1392), (0.576, 6.0597, 0.0943, 0.1774),
]


@pytest.mark.parametrize('ratios', BOUNCES + ECHOES)
def test_later_events_agree_with_the_method_of_steps(ratios):
    rig = make_rig(*ratios)
    history = follow(rig, max_events=5, until=8.0 / FREQUENCY)
    assert len(history.events) >= 3
    assert error_of_events(rig, history) < (5e-3 if ratios in ECHOES else 1e-3)


def error_of_events(rig, history):
    """Return the largest error of t f, z/A and V/(A omega) of the events."""
    model = WaveStepper(rig)
    model.advance_to(history.end_time + 0.01 / FREQUENCY)  # an event may come later than exactly
    exact = [event[1:] for event in history.events]
    events = [event[1:] for event in model.events()[:len(exact)]]
    units = 1.0 / FREQUENCY, rig.engine.amplitude, rig.engine.speed_scale
    return (np.abs(np.subtract(events, exact)) / units).max()


def error_of_loads(rig, history):
    """Return the largest relative error of the loads at both ends, and of the plate's work."""
    end = history.events[0].time * (1.0 - 1e-9)
    times = np.linspace(0.0, end, 4001)
    on_plate, on_projectile = history.plate_force(times), history.contact_force(times)
    exact = (
        abs(on_plate).max(), (on_projectile / rig.projectile.mass - rig.gravity).max(),
        trapezoid(-on_plate * history.motion.velocity(times), times),
    )
    model = released(WaveStepper(rig))
    computed = model.loads.plate_force, model.loads.acceleration, model.plate_work
    return np.abs(np.array(computed) / exact - 1.0).max()


def test_five_events_and_loads_of_most_random_rigs_are_exact_to_1e_3():
    random = np.random.default_rng(11)
    errors = []
    for _ in range(30):
        mu, kappa = np.exp(random.uniform(np.log([0.05, 0.7]), np.log([20.0, 60.0])))
        rig = make_rig(mu, kappa, random.uniform(0.0, 0.2), random.uniform(0.0, 0.3))
        try:
            history = follow(rig, max_events=5, until=6.0 / FREQUENCY)
        except RuntimeError:  # the exact solution takes too long
            continue
        if history.events:  # not under too much gravity
            errors.append((error_of_events(rig, history), error_of_loads(rig, history)))
    assert len(errors) > 20
    assert (np.quantile(errors, 0.95, axis=0) < 1e-3).all()


@pytest.mark.parametrize(('ratios', 'promised'), [((0.2342, 8.242), 3.6), ((3.0333, 2.5), 1.8)])
def test_events_have_the_promised_order(ratios, promised):
    rig = make_rig(*ratios, gravity_ratio=0.05)
    history = follow(rig, max_events=1 if promised > 3.0 else 2)
    steps = np.array([32, 64, 128])
    errors = []
    for count in steps:
        model = WaveStepper(rig, steps=int(count))
        model.advance_to(history.end_time + 1e-4)
        last = model.events()[len(history.events) - 1]
        errors.append(abs(last.velocity - history.events[-1].velocity))
    assert order(steps, errors) > promised


@pytest.mark.parametrize('ratios', [(0.05, 2.0, 0.0, 0.0), (0.6, 7.3, 0.064, 0.03), (5.0, 20.0)])
def test_largest_strain_agrees_with_the_field(ratios):
    rig = make_rig(*ratios)
    end = released(WaveStepper(rig)).events()[0].time
    model = WaveStepper(rig, field_points=401)
    largest = 0.0
    for time in np.linspace(0.0, end, 400):
        model.advance_to(time)
        largest = max(largest, np.abs(model.read_layer()[3]).max())
    assert largest * (1.0 - 1e-3) <= model.loads.strain <= largest * (1.0 + 3e-3)


def energy(model):
    """Integrate the energy of the layer against rest, and add that of the projectile [J]."""
    rig, layer = model.rig, model.read_layer()
    mass, weight = rig.projectile.mass, rig.projectile.mass * rig.gravity
    density = rig.layer.mass * layer[1] ** 2 + (layer[2] - weight) ** 2 / rig.layer.stiffness
    gap = model.state[PROJECTILE_POSITION] - model.read_layer()[0, -1]
    height = model.state[PLATE_POSITION] + gap
    waves = 0.5 * trapezoid(density, dx=1.0 / (model.field_points - 1))
    return waves + 0.5 * mass * model.state[PROJECTILE_VELOCITY] ** 2 + weight * height


def test_work_of_the_plate_is_energy_of_layer_and_projectile_to_1e_3():
    model = WaveStepper(Rig(), field_points=257)
    for time in (0.0035, 0.005, 0.006, 0.00764):
        model.advance_to(time)
        assert model.plate_work == model.stored_energy()
        assert model.plate_work == pytest.approx(energy(model), rel=1e-3)
