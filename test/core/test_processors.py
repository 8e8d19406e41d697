# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Processors that may be used."""

import os
import threading

import pytest
from soft_throw_ros.core import batch, processors
from soft_throw_ros.core.processors import cpu_quota, leave_processors, usable_processors


@pytest.fixture
def machine(monkeypatch):
    """Return a function that sets the affinity of the thread and the quota."""

    def describe(affinity, quota):
        monkeypatch.setattr(os, 'sched_getaffinity', lambda _: set(range(affinity)))
        monkeypatch.setattr(processors, 'cpu_quota', lambda: quota)

    return describe


@pytest.mark.parametrize(
    ('affinity', 'quota', 'usable'),
    [(8, float('inf'), 8), (64, 2.0, 2), (64, 2.9, 2), (4, 0.3, 1), (1, 8.0, 1)],
)
def test_affinity_and_quota_limit_the_processors(machine, affinity, quota, usable):
    machine(affinity, quota)
    assert usable_processors() == usable


@pytest.mark.parametrize(
    ('line', 'files', 'quota'),
    [
        ('0::/', {'cpu.max': '200000 100000\n'}, 2.0),
        ('0::/', {'cpu.max': 'max 100000\n'}, float('inf')),
        ('0::/a/b', {'a/b/cpu.max': 'max 100000\n', 'a/cpu.max': '150000 100000\n'}, 1.5),
        # in a container that sees its own group as the root, but its name on the host
        ('0::/docker/1f', {'cpu.max': '50000 100000\n'}, 0.5),
        (
            '7:memory:/m\n4:cpu,cpuacct:/a\n0::/',
            {'cpu/a/cpu.cfs_quota_us': '300000\n', 'cpu/a/cpu.cfs_period_us': '100000\n'},
            3.0,
        ),
        (
            '4:cpu:/',
            {'cpu/cpu.cfs_quota_us': '-1\n', 'cpu/cpu.cfs_period_us': '100000\n'},
            float('inf'),
        ),
        ('7:cpuset:/', {'cpu.max': '100000 100000\n'}, float('inf')),
        ('0::/', {}, float('inf')),
    ],
)
def test_quota_is_the_smallest_of_the_group_and_its_ancestors(tmp_path, line, files, quota):
    membership = tmp_path / 'cgroup'
    membership.write_text(f'{line}\n')
    for name, text in files.items():
        (tmp_path / 'fs' / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / 'fs' / name).write_text(text)
    assert cpu_quota(membership, tmp_path / 'fs') == quota
    assert cpu_quota(tmp_path / 'nothing', tmp_path) == float('inf')


def test_processors_are_left_to_others_in_a_context_of_one_thread(machine):
    machine(4, 3.0)
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


def test_loop_runs_in_as_many_threads_as_there_are_processors(machine):
    machine(64, 3.0)
    calls = []

    def run(first, stride):
        calls.append((first, stride, threading.get_ident()))

    batch.in_threads(run, count=1000, per_thread=1, threads=None)
    assert sorted(call[:2] for call in calls) == [(0, 3), (1, 3), (2, 3)]
