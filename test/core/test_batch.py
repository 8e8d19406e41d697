# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Properties of throws in batches, for every method of computation."""

import os
import threading

import numpy as np
import pytest
from soft_throw_ros.core.batch import leave_processors, run_batches, usable_processors
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.core.throws import HELD, REFUSED, RELEASED, throw_many

METHODS = {
    'closed form': (Rig(engine=Engine(damping_ratio=0.0)), {}, 2 << 14),
    'waves': (Rig(engine=Engine(amplitude=1e-4)), {'gravity': 9.81}, 3 * 256),
    'cells': (Rig(layer=Layer(loss_tangent=0.1)), {}, 60),
}


@pytest.mark.parametrize('method', METHODS)
def test_no_bit_of_a_throw_depends_on_threads_or_on_other_throws(method):
    rig, changes, count = METHODS[method]
    random = np.random.default_rng(2)
    changes = {
        **changes,
        'mass': 1e-3 * np.exp(random.uniform(-1.0, 1.5, count)),
        'thickness': random.uniform(5e-3, 0.03, count),
        'damping_ratio': random.uniform(0.0, 0.3, count),
    }
    together = throw_many(rig, changes, threads=1)
    shared = throw_many(rig, changes, threads=3)
    assert np.array(together).tobytes() == np.array(shared).tobytes()
    for i in range(0, count, count // 6):
        single = {name: np.ravel(item)[i % np.size(item)] for name, item in changes.items()}
        alone = np.array(throw_many(rig, single))
        assert np.array_equal(alone, np.array(together)[:, i], equal_nan=True)


@pytest.mark.parametrize('method', METHODS)
def test_values_are_broadcast(method):
    rig, changes, _ = METHODS[method]
    thickness, mass = np.array([[0.01], [0.02]]), np.array([5e-4, 1e-3, 2e-3])
    throws = throw_many(rig, {**changes, 'thickness': thickness, 'mass': mass})
    assert all(values.shape == (2, 3) for values in throws)
    single = throw_many(rig, {**changes, 'thickness': 0.02, 'mass': 1e-3})
    assert throws.ejection_speed[1, 1] == pytest.approx(float(single.ejection_speed), rel=1e-14)
    assert throw_many(rig, {**changes, 'mass': np.array([])}).ejection_time.shape == (0,)
    with pytest.raises(ValueError, match='shape'):
        throw_many(rig, {'thickness': np.ones(2), 'mass': np.ones(3)})


@pytest.mark.parametrize('method', METHODS)
def test_status_says_what_became_of_a_throw(method):
    rig, changes, _ = METHODS[method]
    gravity, mass = np.array([9.81, 1e4, 9.81]), np.array([1e-3, 1e-3, 0.0])
    throws = throw_many(rig, {**changes, 'gravity': gravity, 'mass': mass})
    assert throws.status.tolist() == [RELEASED, HELD, REFUSED]
    assert np.isnan(throws.ejection_speed).tolist() == [False, True, True]


@pytest.mark.parametrize('threads', [0, 1.5])
def test_bad_number_of_threads_is_quoted(threads):
    for rig in (Rig(), Rig(layer=Layer(loss_tangent=0.1))):
        with pytest.raises(ValueError, match=f'^threads must be .* got {threads!r}$'):
            throw_many(rig, threads=threads)


@pytest.mark.parametrize('cells', [7, 64.0])
def test_bad_number_of_cells_is_quoted(cells):
    with pytest.raises(ValueError, match=f'^cells must be .* got {cells!r}$'):
        throw_many(Rig(layer=Layer(loss_tangent=0.1)), cells=cells)


def test_ratios_of_the_closed_form_are_broadcast_or_refused():
    throws = first_releases(mass_ratio=[[0.5], [1.0]], speed_ratio=[5.0, 8.0, 12.0])
    assert all(values.shape == (2, 3) for values in throws)
    for name, value in (('mass_ratio', 0.0), ('speed_ratio', np.inf), ('damping_ratio', 1.0)):
        with pytest.raises(ValueError, match=f'^{name} must be .* got {value!r}$'):
            first_releases(**{'mass_ratio': 1.0, 'speed_ratio': 5.0, name: value})


@pytest.fixture
def three(monkeypatch):
    """Set the affinity of all threads to three processors."""
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0, 2, 5})


@pytest.mark.usefixtures('three')
def test_processors_are_left_to_others_in_a_context_of_one_thread():
    with leave_processors(1):
        assert usable_processors() == 2
        with leave_processors(5):
            assert usable_processors() == 1
        elsewhere = []
        thread = threading.Thread(target=lambda: elsewhere.append(usable_processors()))
        thread.start()
        thread.join()
    assert elsewhere == [3]
    assert usable_processors() == 3


@pytest.mark.usefixtures('three')
def test_batches_run_in_as_many_threads_as_there_are_processors():
    calls, together = [], threading.Barrier(3)

    def run(batch):
        together.wait(timeout=10.0)
        calls.append(batch.tolist())

    run_batches(run, np.arange(3), size=1, threads=None)
    assert sorted(calls) == [[0], [1], [2]]
