# SPDX-License-Identifier: Apache-2.0
"""Sweeps: whoever computes them, and however often they are broken off."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
import functools
import multiprocessing
import re

import numpy as np
import pytest
from soft_throw_ros.design import sweep as module
from soft_throw_ros.design.sweep import Checkpoint, CheckpointError, sweep, whole_file

CASES = np.random.default_rng(5).random((2, 103))
SWEEP = {'outputs': 2, 'block': 10}


def turn(cases):
    """Return a polar form, to the last bit whatever comes beside a case."""
    return np.array([np.hypot(*cases), np.arctan2(*cases)])


class Fickle:
    """A function that raises once it has been called often enough."""

    def __init__(self, calls, error=KeyboardInterrupt):
        self.calls = calls
        self.error = error

    def __call__(self, cases):
        if self.calls == 0:
            raise self.error
        self.calls -= 1
        return turn(cases)


@pytest.mark.parametrize('block', [1, 10, 103, 1000])
def test_sweep_is_one_call_whatever_the_blocks(block):
    np.testing.assert_array_equal(sweep(turn, CASES, outputs=2, block=block), turn(CASES))


def test_no_cases_have_no_results():
    assert sweep(turn, np.empty((2, 0)), **SWEEP).shape == (2, 0)


def test_executors_agree_to_the_last_bit():
    function = functools.partial(np.multiply, np.pi)
    here = sweep(function, CASES, **SWEEP)
    with ThreadPoolExecutor(3) as threads:
        np.testing.assert_array_equal(sweep(function, CASES, **SWEEP, executor=threads), here)
    spawn = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(2, mp_context=spawn) as processes:
        np.testing.assert_array_equal(sweep(function, CASES, **SWEEP, executor=processes), here)


def test_progress_adds_up_to_all_cases():
    done = []
    sweep(turn, CASES, **SWEEP, progress=done.append)
    assert sum(done) == CASES.shape[1]
    assert max(done) == SWEEP['block']


@pytest.mark.parametrize('error', [KeyboardInterrupt, MemoryError])
def test_resumed_sweep_equals_an_uninterrupted_one_and_computes_the_rest_only(tmp_path, error):
    target = tmp_path / 'map.npz'
    for _ in range(2):  # broken off twice
        with pytest.raises(error), Checkpoint(target) as checkpoint:
            sweep(Fickle(3, error), CASES, **SWEEP, checkpoint=checkpoint)
    left = Fickle(5)  # of 11 blocks
    done = []
    with Checkpoint(target) as checkpoint:
        results = sweep(left, CASES, **SWEEP, checkpoint=checkpoint, progress=done.append)
        np.testing.assert_array_equal(results, turn(CASES))
    assert left.calls == 0
    assert (done[0], sum(done)) == (60, 103)
    assert list(tmp_path.iterdir()) == []


def test_what_threads_have_done_is_kept_too(tmp_path):
    with (
        ThreadPoolExecutor(1) as executor,
        pytest.raises(KeyboardInterrupt),
        Checkpoint(tmp_path / 'map.npz') as checkpoint,
    ):
        sweep(Fickle(4), CASES, **SWEEP, executor=executor, checkpoint=checkpoint)
    with Checkpoint(tmp_path / 'map.npz') as checkpoint:
        _, done = checkpoint.load('', CASES, **SWEEP)
    assert done.sum() == 4


def test_checkpoint_stays_until_the_results_are_stored(tmp_path, monkeypatch):
    monkeypatch.setattr(module, '_SAVE_PERIOD', 0.0)

    def compute_and_fail_to_store():
        with Checkpoint(tmp_path / 'map.npz') as checkpoint:
            sweep(turn, CASES, **SWEEP, checkpoint=checkpoint)
            raise OSError('disk is full')

    with pytest.raises(OSError, match='disk is full'):
        compute_and_fail_to_store()
    with Checkpoint(tmp_path / 'map.npz') as checkpoint:
        results = sweep(Fickle(0), CASES, **SWEEP, checkpoint=checkpoint)
        np.testing.assert_array_equal(results, turn(CASES))


@pytest.mark.parametrize(
    'other',
    [
        {'cases': CASES + 1e-16},
        {'cases': CASES[:, :-1]},
        {'cases': CASES.reshape(1, -1)},
        {'block': 11},
        {'outputs': 3},
        {'request': 'another model'},
    ],
    ids=lambda other: next(iter(other)),
)
def test_other_requests_never_find_the_checkpoint(tmp_path, other):
    request = {'request': 'a model', 'cases': CASES, **SWEEP}
    with pytest.raises(KeyboardInterrupt), Checkpoint(tmp_path / 'map.npz') as checkpoint:
        sweep(Fickle(3), **request, checkpoint=checkpoint)
    assert checkpoint.load(**request)[1].sum() == 3
    assert checkpoint.load(**(request | other))[1].sum() == 0
    assert Checkpoint(tmp_path / 'other.npz').load(**request)[1].sum() == 0


@pytest.mark.parametrize('content', [b'', b'PK\x03\x04 cut off', b'no archive at all'])
def test_damaged_checkpoint_is_named(tmp_path, content):
    with pytest.raises(KeyboardInterrupt), Checkpoint(tmp_path / 'map.npz') as checkpoint:
        sweep(Fickle(3), CASES, **SWEEP, checkpoint=checkpoint)
    checkpoint.path.write_bytes(content)
    with pytest.raises(CheckpointError, match=re.escape(str(checkpoint.path))):
        sweep(turn, CASES, **SWEEP, checkpoint=checkpoint)


def test_unfinished_file_replaces_nothing(tmp_path):
    path = tmp_path / 'result'
    path.write_text('old')

    def write(text, error=None):
        with whole_file(path) as unfinished:
            unfinished.write_text(text)
            assert path.read_text() == 'old'
            if error:
                raise error

    with pytest.raises(KeyboardInterrupt):
        write('ne', KeyboardInterrupt)
    assert path.read_text() == 'old'
    write('new')
    assert path.read_text() == 'new'
    assert list(tmp_path.iterdir()) == [path]
