# SPDX-License-Identifier: Apache-2.0
"""What the models in real time have in common: states of a filter, and scouts."""

import math

import numpy as np
import pytest
from soft_throw_ros.core.grid_stepper import GridStepper
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.stepping import (
    FeedFullError,
    PLATE_FORCE,
    PLATE_POSITION,
    PLATE_VELOCITY,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    TIME,
)

PROJECTILE = [PROJECTILE_POSITION, PROJECTILE_VELOCITY, PROJECTILE_FORCE]
LOSSY = Rig(layer=Layer(loss_tangent=0.05))


def make_wave(motion=None):
    return Stepper(Rig(), motion)


def make_grid(motion=None):
    return GridStepper(LOSSY, motion)


def states_of(plate, times):
    """Height, velocity and acceleration of an underdamped plate."""
    omega = 2.0 * math.pi * plate.frequency
    height, speed = plate.position(times), plate.velocity(times)
    return np.column_stack(
        (
            height,
            speed,
            omega**2 * (plate.amplitude - height) - 2.0 * plate.damping_ratio * omega * speed,
        )
    )


def feed_until(model, time, spacing=2.5e-4):
    """Feed what is missing up to a time, and go there."""
    begin = round(model.horizon / spacing) + 1 if model.horizon else 0
    times = spacing * np.arange(begin, round(time / spacing) + 1)
    model.feed_states(times, states_of(Underdamped.of(model.rig.engine), times))
    model.advance_to(model.horizon)


@pytest.mark.parametrize('make', [make_wave, make_grid])
def test_fed_states_agree_with_the_analytic_plate(make):
    exact, fed = make(), make('measured')
    feed_until(fed, 0.02)
    exact.advance_to(fed.state[TIME])
    assert fed.state[:PLATE_FORCE] == pytest.approx(exact.state[:PLATE_FORCE], abs=2e-9)
    [ours], [theirs] = fed.events(), exact.events()
    assert ours == pytest.approx(theirs, abs=2e-9)


def test_fed_states_are_of_sixth_order_in_their_spacing():
    errors, spacings = [], np.array([1e-3, 5e-4, 2.5e-4])
    exact = make_wave()
    exact.advance_to(0.0095)
    for spacing in spacings:
        fed = make_wave('measured')
        plate = Underdamped.of(fed.rig.engine)
        times = spacing * np.arange(round(0.012 / spacing) + 1)
        fed.feed_states(times, states_of(plate, times))
        fed.advance_to(0.0095)
        errors.append(abs(fed.state - exact.state)[PLATE_POSITION])
    # in the middle between states 1 ms apart, at a state else
    assert errors[0] < 5e-8
    assert max(errors[1:]) < 1e-15


@pytest.mark.parametrize('make', [make_wave, make_grid])
def test_feeding_states_one_by_one_changes_no_bit(make):
    plate = Underdamped.of(Rig().engine)
    times = 2.5e-4 * np.arange(60)
    states = states_of(plate, times)
    whole, split = make('measured'), make('measured')
    whole.feed_states(times, states)
    for time, state in zip(times, states, strict=True):
        split.feed_states([time], [state])
        split.advance_to(split.horizon)
    whole.advance_to(split.state[TIME])
    assert whole.state.tobytes() == split.state.tobytes()
    assert whole.events() == split.events()


@pytest.mark.parametrize(
    ('make', 'accuracy'),
    [
        (make_wave, 1e-5),
        (lambda motion=None: GridStepper(Rig(), motion), 2e-5),
        (make_grid, 1.5e-2),  # since internal loss spreads in no time
    ],
)
def test_scout_knows_the_projectile_for_a_crossing_of_the_wave(make, accuracy):
    exact, model = make(), make('measured')
    scout = model.scout()
    for millisecond in range(1, 25):
        feed_until(model, 1e-3 * millisecond)
        scout.depart(model)
        scout.advance_to(model.horizon + model.rig.crossing_time)
        exact.advance_to(scout.state[TIME])
        assert scout.state[PROJECTILE] == pytest.approx(exact.state[PROJECTILE], abs=accuracy)
        assert scout.event_count == exact.event_count
        assert scout.in_contact == exact.in_contact


@pytest.mark.parametrize('make', [make_wave, make_grid])
def test_scout_leaves_its_origin_as_it_was(make):
    alone, followed = make('measured'), make('measured')
    scout = followed.scout()
    strain, velocity = np.empty((2, 64))
    for millisecond in range(1, 30):
        feed_until(alone, 1e-3 * millisecond)
        feed_until(followed, 1e-3 * millisecond)
        scout.depart(followed)
        scout.advance_to(followed.horizon + 5e-3)
        scout.read_field(strain, velocity)
        assert followed.state.tobytes() == alone.state.tobytes()
        assert followed.events() == alone.events()


def test_scout_has_the_plate_keep_its_acceleration():
    model = make_wave('measured')
    scout = model.scout()
    model.feed_states([0.0, 1e-3], [[0.0, 0.0, 0.0], [1e-3, 2.0, 30.0]])
    model.advance_to(1e-3)
    scout.depart(model)
    scout.advance_to(3e-3)
    assert scout.state[PLATE_POSITION] == pytest.approx(1e-3 + 4e-3 + 6e-5, rel=1e-12)
    assert scout.state[PLATE_VELOCITY] == pytest.approx(2.06, rel=1e-12)
    assert model.horizon == 1e-3


def test_scout_of_a_plate_at_rest_stays_at_rest():
    model = make_wave('measured')
    scout = model.scout()
    scout.depart(model)
    scout.advance_to(1.0)
    assert scout.state[PLATE_POSITION] == 0.0
    assert scout.event_count == 0


def test_states_that_cannot_be_are_refused():
    model = make_wave('measured')
    with pytest.raises(ValueError, match=r'of shape \(n, 3\), got \(2, 2\)'):
        model.feed_states([0.0, 1.0], np.zeros((2, 2)))
    with pytest.raises(ValueError, match='states must be finite, got nan at index 1'):
        model.feed_states([0.0, 1.0], [[0.0] * 3, [0.0, math.nan, 0.0]])
    with pytest.raises(FeedFullError, match='4096 ahead of advance_to, got 5000'):
        model.feed_states(np.arange(5000.0), np.zeros((5000, 3)))
    model.feed_states([0.0, 1.0], np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r'times must increase, got 0\.5 after 1\.0'):
        model.feed_states([0.5], np.zeros((1, 3)))
    with pytest.raises(ValueError, match='states were fed before, got positions'):
        model.feed([2.0], positions=[0.0])
    with pytest.raises(ValueError, match="scout needs a stepper made with motion 'measured'"):
        make_wave().scout()
    with pytest.raises(ValueError, match='feed_states needs a stepper made with motion'):
        make_wave().feed_states([0.0], np.zeros((1, 3)))
