# SPDX-License-Identifier: Apache-2.0
"""What is made ready before a throw, by any model."""

from typing import Any

import numpy as np
import pytest
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.core import finite_difference, grid_stepper, spring_mass, stepper
from soft_throw_ros.core.grid_stepper import GridStepper
from soft_throw_ros.core.models import MODELS, ON_GRIDS
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.travelling_wave import first_release
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.flight import Flight, time_until_over
from soft_throw_ros.twin.plan import check, FIELD_POINTS, Plan, warm_up
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import replay, Session


def make_settings(**request: Any) -> dict[str, Any]:
    named = {name.replace('__', '.'): value for name, value in request.items()}
    return {**TWIN.defaults(), **TWIN.change(TWIN.defaults(), named)}


CASES = [
    {'model': 'travelling_wave'},
    {'layer__loss_tangent': 0.05},
    {'model': 'finite_difference'},
    {'model': 'finite_difference_elastic', 'projectile__youngs_modulus': 1e6},
    {'model': 'finite_difference_glued', 'layer__loss_tangent': 0.1},
    {'model': 'spring_mass', 'layer__loss_tangent': 0.1},
]
ANY_MODEL = pytest.mark.parametrize('request_', CASES, ids=lambda case: ' '.join(map(str, case)))


def throw(settings: dict[str, Any], *, max_events: int = 2) -> tuple[Flight, dict[str, Any]]:
    """Fly until it is over, and return what is reported at the release and in the end."""
    plan = Plan.of(settings)
    flight = Flight(plan, plan.stepper)
    results = {}
    for tick in range(1, 20_000):
        flight.advance(tick * plan.tick, max_events=max_events)
        if flight.has_left and 'release' not in results:
            results['release'] = flight.result('release', tick, 0.1)
        if flight.ended_by:
            results['final'] = flight.result('final', tick, 0.1)
            break
    return flight, results


def test_lossless_layer_is_followed_by_the_travelling_wave():
    plan = Plan.of(make_settings())
    assert plan.model == 'travelling_wave'
    assert isinstance(plan.stepper, Stepper)


@pytest.mark.parametrize('loss', [1e-6, 0.05, 2.0])
def test_internal_loss_takes_finite_differences_of_64_cells_or_more(loss):
    plan = Plan.of(make_settings(layer__loss_tangent=loss))
    assert plan.model == 'finite_difference'
    assert isinstance(plan.stepper, GridStepper)
    assert plan.stepper.grid.cells >= 64
    assert plan.stepper.rig.layer.loss_tangent == loss


@pytest.mark.parametrize('model', ON_GRIDS)
def test_model_that_is_set_is_taken(model):
    plan = Plan.of(make_settings(model=model, layer__loss_tangent=0.02))
    assert plan.model == model
    assert plan.stepper.model == model


@ANY_MODEL
def test_result_agrees_with_the_simulated_throw(request_):
    settings = make_settings(**request_)
    plan = Plan.of(settings)
    throw_ = simulate(rig_of(settings), model=plan.model)
    _, results = throw(settings)
    release = results['release']
    assert release.first.time == pytest.approx(throw_.ejection_time, rel=3e-4)
    assert release.first.speed == pytest.approx(throw_.ejection_speed, rel=1e-3)
    assert release.first.energy_transfer == pytest.approx(throw_.energy_transfer, rel=2e-3)
    assert release.peak_strain == pytest.approx(throw_.peak_strain.value, rel=2e-3)
    assert release.peak_force == pytest.approx(throw_.peak_plate_force, rel=2e-2)
    assert results['final'].apex_height == pytest.approx(throw_.apex_height, rel=2e-2)
    assert results['final'].plate_work >= 0.99 * throw_.energies.plate_work
    assert results['final'].landings >= 1


@ANY_MODEL
def test_time_until_over_is_foretold_by_the_same_model(request_):
    settings = make_settings(**request_)
    plan = Plan.of(settings)
    flight, results = throw(settings)
    foretold = time_until_over(plan, 0.1, max_events=2)
    assert foretold == pytest.approx(results['final'].step * plan.tick - 0.1, abs=1e-9)
    assert flight.ended_by


@ANY_MODEL
def test_throw_field_is_what_the_layer_does(request_):
    settings = make_settings(**request_)
    plan = Plan.of(settings)
    times, strain = plan.throw_field
    assert times[-1] == pytest.approx(1.5 * throw(settings)[1]['release'].first.time, rel=1e-9)
    field, velocity = np.empty((2, FIELD_POINTS))
    for row in (0, 77, 199):
        plan.stepper.reset()
        plan.stepper.advance_to(times[row])
        plan.stepper.read_field(field, velocity)
        assert strain[row].tobytes() == field.tobytes()


@ANY_MODEL
def test_at_rest_the_layer_bears_the_weight(request_):
    plan = Plan.of(make_settings(**request_))
    weight = plan.rig.projectile.mass * plan.rig.gravity
    load = weight + ('glued' in plan.model) * plan.rig.layer.mass * plan.rig.gravity
    assert plan.rest.projectile_force == pytest.approx(weight, rel=1e-12)
    assert plan.rest.plate_force == pytest.approx(-load, rel=1e-12)
    assert plan.rest.projectile_velocity == plan.rest.plate_velocity == 0.0
    assert not plan.rest_field.velocity.any()
    assert (plan.rest_field.strain < 0.0).all()


def test_other_models_predict_the_first_release():
    rig = rig_of(TWIN.defaults())
    frequency = rig.engine.frequency
    ratios = {
        'mass_ratio': rig.mass_ratio,
        'speed_ratio': rig.speed_ratio,
        'damping_ratio': rig.engine.damping_ratio,
        'gravity_ratio': rig.gravity_ratio,
    }
    expected = {
        'travelling_wave': first_release(**ratios),
        'finite_difference_elastic': finite_difference.first_releases(
            **ratios, crossing_ratio=rig.crossing_ratio
        ),
        'finite_difference_glued': finite_difference.first_releases(
            **ratios, glued_to='projectile'
        ),
        'spring_mass': spring_mass.first_release(
            frequency_ratio=rig.natural_frequency / frequency
        ),
    }
    for model in MODELS:
        plan = Plan.of(make_settings(model=model))
        assert set(plan.models) == set(expected) - {model}
        for name, release in plan.models.items():
            assert release.time * frequency == pytest.approx(
                expected[name].ejection_phase, rel=1e-5
            )
            assert release.energy_transfer == pytest.approx(
                expected[name].energy_transfer, rel=1e-4
            )
    lossy = Plan.of(make_settings(layer__loss_tangent=0.1))
    assert 'travelling_wave' not in lossy.models
    glued = lossy.models['finite_difference_glued']
    assert glued.energy_transfer < plan.models['finite_difference_glued'].energy_transfer


def test_models_that_see_no_release_say_none():
    plan = Plan.of(make_settings(gravity=30.0, engine__amplitude=1e-5))
    assert plan.models['finite_difference_elastic'] is None
    assert plan.models['finite_difference_glued'] is None


@pytest.mark.parametrize(
    ('request_', 'message'),
    [
        (
            {'layer__thickness': 0.5e-3, 'layer__wave_speed': 200.0},
            r'0\.0005 m .* 200 m/s needs 2\.56e\+07 steps per second, .* feasible: ',
        ),
        (
            {'layer__thickness': 0.5e-3, 'layer__wave_speed': 200.0, 'layer__loss_tangent': 0.1},
            r'0\.0005 m .* 200 m/s needs 1\.64e\+09 updates of cells per second, .* feasible: ',
        ),
        (
            {'layer__diameter': 0.2, 'projectile__mass': 1e-5, 'model': 'spring_mass'},
            r'swings at .* Hz .* updates per second, the limit is .* feasible: ',
        ),
    ],
)
def test_what_real_time_cannot_do_is_refused_with_the_number(request_, message):
    settings = make_settings(**request_)
    with pytest.raises(ValueError, match=message):
        check(settings)
    with pytest.raises(ValueError, match=message):
        Plan.of(settings)


@ANY_MODEL
def test_what_is_checked_can_be_planned(request_):
    check(make_settings(**request_))


@ANY_MODEL
def test_session_by_any_model_is_repeated_to_the_bit(request_):
    lines: list[str] = []
    session = Session(make_settings(throw__period=0.6, **request_), on_entry=lines.append)
    outputs = [session.advance() for _ in range(700)]
    session.change({'layer.thickness': 0.012})
    outputs += [session.advance() for _ in range(800)]
    assert session.throws == 2
    assert sum(len(output.events) for output in outputs) >= 4
    repeated = list(replay(lines, until=1500))
    assert len(repeated) == 1500
    for ours, theirs in zip(outputs, repeated, strict=True):
        assert ours[:6] == theirs[:6]
        assert bits(ours) == bits(theirs)
    assert all(journal.decode(line)['kind'] for line in lines)


def bits(outputs: Outputs) -> list[bytes]:
    fields = [field for field in (outputs.layer, outputs.throw_field) if field is not None]
    return [array.tobytes() for field in fields for array in field]


def test_warm_up_leaves_nothing_to_compile():
    warm_up()
    kernels = {
        (module.__name__, name): kernel
        for module in (stepper, grid_stepper, finite_difference)
        for name, kernel in vars(module).items()
        if hasattr(kernel, 'signatures')
    }
    before = {name: len(kernel.signatures) for name, kernel in kernels.items()}
    for request_ in CASES:
        throw(make_settings(**request_))
    assert {name: len(kernel.signatures) for name, kernel in kernels.items()} == before
