# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Processors that may be used."""

import os
import threading

import pytest
from soft_throw_ros.core import batch
from soft_throw_ros.core.processors import leave_processors, usable_processors


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
def test_loop_runs_in_as_many_threads_as_there_are_processors():
    calls = []

    def run(first, stride):
        calls.append((first, stride, threading.get_ident()))

    batch.in_threads(run, count=1000, per_thread=1, threads=None)
    assert sorted(call[:2] for call in calls) == [(0, 3), (1, 3), (2, 3)]
