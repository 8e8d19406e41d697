# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""One throw with all its results, and many at once by every method of computation."""

from concurrent.futures import ThreadPoolExecutor
import itertools
import os
import threading

import numpy as np
import pytest
from reference.cases import FREQUENCY, make_rig
from soft_throw_ros.core import batch, simulate, throw_many
from soft_throw_ros.core.cell_stepper import CellStepper
from soft_throw_ros.core.plate import SampledMotion, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.stepper import CAPACITY, Event, PROJECTILE_FORCE, PROJECTILE_POSITION
from soft_throw_ros.core.throw import ejections, HELD, REFUSED, RELEASED, rig_with

TIMES = np.arange(0.0, 0.05, 2e-4)
MOTION = SampledMotion.from_positions(TIMES, Underdamped.of(Engine()).position(TIMES))
SHAKEN = Rig(engine=Engine(motion=MOTION))
LOSSY = Rig(layer=Layer(loss_tangent=0.1))
STACK = Layer.of_sheets((Layer(thickness=8e-3, loss_tangent=0.1), Layer(wave_speed=20.0)))
GEL = Layer(stress_strain_law='neo_hookean', loss='constant', loss_tangent=0.1)
CHANGES = {
    'frequency': 50.0, 'amplitude': 1e-3, 'damping_ratio': 0.1, 'thickness': 0.01,
    'wave_speed': 12.0, 'density': 900.0, 'diameter': 0.015, 'loss_tangent': 0.2, 'mass': 3e-3,
    'gravity': 5.0,
}
METHODS = {
    'closed form': (Rig(engine=Engine(damping_ratio=0.0)), {}, 3 * 256),
    'cells': (LOSSY, {}, 80),
    'steppers': (SHAKEN, {}, 24),
    'mixed': (Rig(), {'gravity': np.tile([0.0, 500.0], 40), 'loss_tangent': np.eye(8, 10).ravel()},
              80),
}
methods = pytest.mark.parametrize('method', METHODS)


def test_ejections_end_at_the_landing():
    kinds = 'release', 'recontact', 'release', 'landing', 'release'
    events = [Event(kind, float(n), 0.0, 1.0) for n, kind in enumerate(kinds)]
    assert ejections(events) == (events[0], events[2])


def test_paths_and_fields_of_a_throw_agree_with_its_numbers():
    throw = simulate(Rig())
    times = np.linspace(throw.ejection_time, throw.events[-1].time, 2001)
    states, layers = throw.trajectory(times)
    heights = states[:, PROJECTILE_POSITION]
    assert heights.max() == pytest.approx(throw.apex_height, rel=1e-5)
    assert (heights >= layers[:, 0, -1] - 1e-12)[:-1].all()
    states, layers = throw.trajectory(np.linspace(0.0, throw.ejection_time, 501), points=65)
    assert layers.shape == (501, 4, 65)
    acceleration = states[:, PROJECTILE_FORCE].max() / throw.rig.projectile.mass - 9.81
    assert throw.loads.acceleration == pytest.approx(acceleration, rel=1e-3)
    assert layers[0, 3] == pytest.approx(throw.rig.rest_height / throw.rig.layer.thickness - 1.0)
    assert np.abs(layers[:, 3]).max() == pytest.approx(throw.loads.strain, rel=1e-2)


@pytest.mark.parametrize(
    'rig',
    [
        Rig(gravity=0.0),
        Rig(engine=Engine(amplitude=0.1, frequency=200.0), layer=Layer(wave_speed=200.0)),
        Rig(
            engine=Engine(frequency=106.63, amplitude=3.986e-3, damping_ratio=0.1162),
            layer=Layer(thickness=0.01951, wave_speed=39.276, density=944.4, diameter=0.01237),
            projectile=Projectile(mass=0.006829),
        ),
    ],
)
def test_every_throw_ends_with_a_landing_or_a_projectile_that_rises(rig):
    throw = simulate(rig)
    assert throw.events[-1].kind == 'landing' or throw.last_release.velocity > 0.0


def test_throw_without_a_release_raises_an_error():
    with pytest.raises(batch.ThrowUnresolvedError, match=r'0\.001'):
        simulate(Rig(), until=1e-3)
    with pytest.raises(batch.ThrowUnresolvedError, match='below gravity'):
        simulate(Rig(engine=Engine(frequency=1.0, amplitude=1e-3)))


@pytest.mark.parametrize(
    ('compute', 'rig', 'name', 'value'),
    [
        (simulate, Rig(), 'until', -1.0), (simulate, Rig(), 'cells', 64),
        (throw_many, LOSSY, 'cells', 7),
        (CellStepper, Rig(), 'cells', 0), (CellStepper, Rig(), 'cells', CAPACITY + 1),
        (CellStepper, Rig(), 'cells', 64.0),
    ],
)
def test_bad_options_are_quoted(compute, rig, name, value):
    with pytest.raises(ValueError, match=f'^{name} .* got {value!r}$'):
        compute(rig, **{name: value})


@methods
def test_no_bit_of_a_throw_depends_on_threads_or_on_other_throws(method):
    rig, changes, count = METHODS[method]
    random = np.random.default_rng(2)
    changes = {
        **changes, 'mass': 1e-3 * np.exp(random.uniform(-1.0, 1.5, count)),
        'thickness': random.uniform(5e-3, 0.03, count),
        'damping_ratio': random.uniform(0.0, 0.3, count),
    }
    together = np.array(throw_many(rig, changes))
    with batch.leave_processors(1 << 16):
        assert together.tobytes() == np.array(throw_many(rig, changes)).tobytes()
    for i in range(0, count, count // 6):
        single = {name: np.ravel(item)[i % np.size(item)] for name, item in changes.items()}
        assert np.array_equal(np.array(throw_many(rig, single)), together[:, i], equal_nan=True)


@methods
def test_values_are_broadcast(method):
    rig = METHODS[method][0]
    throws = throw_many(rig, {'thickness': [[0.01], [0.02]], 'mass': [5e-4, 1e-3, 2e-3]})
    single = throw_many(rig, {'thickness': 0.02, 'mass': 1e-3})
    assert throws.ejection_speed[1, 1] == pytest.approx(float(single.ejection_speed), rel=1e-14)
    assert throw_many(rig, {'mass': np.array([])}).ejection_time.shape == (0,)
    with pytest.raises(ValueError, match='shape'):
        throw_many(rig, {'thickness': np.ones(2), 'mass': np.ones(3)})


@methods
def test_status_says_what_became_of_a_throw(method):
    rig = METHODS[method][0]
    gravity, mass, thickness = [9.81, 1e4, 9.81, 9.81], [1e-3, 1e-3, 0.0, 1e-3], [1e-2] * 3 + [-1]
    throws = throw_many(rig, {'gravity': gravity, 'mass': mass, 'thickness': thickness})
    assert throws.status.tolist() == [RELEASED, HELD, REFUSED, REFUSED]
    assert np.isnan(throws.ejection_speed).tolist() == [False, True, True, True]


@pytest.mark.parametrize(
    'rig',
    [
        Rig(), Rig(gravity=0.0), Rig(engine=Engine(amplitude=1e-4)), LOSSY, Rig(layer=GEL),
        Rig(layer=STACK), SHAKEN,
    ],
)
def test_release_and_loads_agree_with_a_simulated_throw(rig):
    cells = 100 if rig.layer.needs_cells else None
    throw, throws = simulate(rig, cells=cells), throw_many(rig, cells=cells, loads=True)
    assert throws == pytest.approx((
        throw.ejection_time, throw.ejection_speed, throw.energy_transfer,
        *throw.loads, throw.plate_work, RELEASED,
    ), rel=1e-9 if cells else 1e-4)
    assert throw_many(rig, cells=cells)[:2] == throws[:2]


@pytest.mark.parametrize('start', [0.5, -1.0])
@pytest.mark.parametrize('layer', [Layer(), Layer(wave_speed=60.0, loss_tangent=0.1)])
def test_times_count_from_the_start_of_the_motion(start, layer):
    now, later = (
        Rig(engine=Engine(motion=SampledMotion(MOTION.times + offset, MOTION.states)), layer=layer)
        for offset in (0.0, start)
    )
    expected = pytest.approx(simulate(now).ejection_time, rel=1e-9)
    assert simulate(later).ejection_time == expected
    assert float(throw_many(later).ejection_time) == pytest.approx(expected.expected, rel=1e-3)


def test_light_projectile_under_strong_gravity_leaves_at_its_first_release():
    """It is caught again between two steps of the waves."""
    rig = make_rig(7.602e-4, 68.92, gravity_ratio=0.5238)
    throws = throw_many(rig, loads=True)
    assert throws.ejection_time * FREQUENCY == pytest.approx(0.0726, abs=1e-4)
    assert throws.ejection_speed / rig.engine.speed_scale == pytest.approx(0.351, abs=1e-3)
    assert np.isfinite(throws.plate_work)


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('colour', 1.0), ('loss_tangent', np.nan), ('loss_tangent', -0.1), ('diameter', -0.012),
        ('thickness', np.nan), ('frequency', 0.0), ('damping_ratio', 1.0), ('mass', np.inf),
    ],
)
@pytest.mark.parametrize('rig', [Rig(), SHAKEN], ids=['step', 'file'])
def test_bad_changes_are_refused_by_name(rig, name, value):
    with pytest.raises(ValueError, match=name):
        throw_many(rig, {name: np.array([value])})


@pytest.mark.parametrize(
    ('compute', 'loss'), [(throw_many, 1e-3), (simulate, 1e-3), (simulate, 0.0)]
)
def test_single_throw_looks_at_the_flag_several_times(compute, loss):
    """A stiff layer takes many cells or steps."""
    layer = Layer(wave_speed=100.0, loss_tangent=loss)
    rig = Rig(engine=Engine(frequency=3.0), layer=layer, gravity=0.0)
    calls = itertools.count()
    with pytest.raises(batch.SearchCancelledError):
        compute(rig, cancelled=lambda: next(calls) > 0)


def test_slow_throw_of_a_batch_is_computed_in_parts():
    rig, looks = Rig(layer=Layer(thickness=2e-3, wave_speed=30.0, loss_tangent=0.1)), []
    throws = throw_many(rig, cells=1000, cancelled=lambda: bool(looks.append(0)))
    release = CellStepper(rig, cells=1000).advance_to_release(latest=0.01)
    assert throws[:2] == (release.time, release.velocity)
    assert len(looks) > 4


@pytest.mark.parametrize('rig', [Rig(), Rig(layer=STACK), SHAKEN], ids=str)
def test_changes_agree_with_another_rig(rig):
    changed = rig_with(rig, CHANGES)
    for name, value in CHANGES.items():
        components = changed.engine, changed.layer, changed.projectile, changed
        component = next(item for item in components if name in vars(item))
        assert getattr(component, name) == pytest.approx(value)
    assert len(changed.layer.parts) == len(rig.layer.parts)
    throws, expected = throw_many(rig, CHANGES), throw_many(changed)
    assert throws[:3] == pytest.approx(expected[:3], rel=1e-9)


def test_batches_leave_processors_to_others_in_a_context_of_one_thread(monkeypatch):
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0, 2, 5})
    together = threading.Barrier(3)
    batch.run_batches(lambda _: together.wait(timeout=60.0), np.arange(3), size=1)
    with batch.leave_processors(1):
        assert batch.usable_processors() == 2
        with batch.leave_processors(5), ThreadPoolExecutor() as pool:
            assert batch.usable_processors() == 1
            assert pool.submit(batch.usable_processors).result() == 3
    assert batch.usable_processors() == 3
