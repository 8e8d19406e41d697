# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Effects of a killed or stopped process on the others: the rows of docs/testing.md.

Two counts are correct in every case. The recorder reports as lost the messages that are missing
from its bag by their sequence numbers. The twin reports at least as many skipped ticks as are
missing by their stamps. A short run of `make soak` follows.
"""

from __future__ import annotations

import os
from pathlib import Path
import signal
import time

from bench import soak
from bench.processes import RecordedStates
import numpy as np
import pytest
import soft_throw_ros
from soft_throw_ros.commands import recover
from stopping import stop
from systems import missing, System

pytestmark = [pytest.mark.slow, pytest.mark.once, pytest.mark.timeout(180)]


@pytest.fixture
def system(request, start, tmp_path, monkeypatch):
    """Use UDP for stops: Fast DDS may lose the queue in shared memory of a stopped process."""
    pytest.importorskip('rerun')
    if 'stops' in request.fixturenames:
        # rclpy adds shared memory to the range LOCALHOST; the addresses of the profile are local
        loopback = Path(soft_throw_ros.__path__[0]) / 'config' / 'fastdds_loopback.xml'
        shared = '<transport_id>soft_throw_shared_memory</transport_id>\n          '
        assert shared in loopback.read_text('utf-8')
        profile = tmp_path / 'udp.xml'
        profile.write_text(loopback.read_text('utf-8').replace(shared, ''), 'utf-8')
        monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
        monkeypatch.setenv('ROS_STATIC_PEERS', '127.0.0.1')
    return System(start, tmp_path)


def kill(system, name):
    (pid,) = system.pids(name)
    stop(pid)  # at a time at which it holds no lock of the middleware
    os.kill(pid, signal.SIGKILL)
    assert system.running[name].wait() == -signal.SIGKILL
    system.start(name)


@pytest.mark.parametrize(
    ('stops', 'late', 'is_lossy'),
    [
        # the last one is like a suspended machine
        ({'subscriber': 2.0, 'viewer': 2.0, 'recorder': 2.0, 'twin': 2.0, 'all': 3.0}, 5.0, False),
        ({'recorder': 8.0}, 0.0, True),  # longer than the history of the twin's publisher
    ],
    ids=['each and all', 'recorder for long'],
)
def test_stopped_processes_resume_with_correct_counts(system, stops, late, is_lossy):
    for name, seconds in stops.items():
        stopped = system.pids(name)
        for pid in stopped:
            stop(pid)
        if is_lossy:
            system.wait_for_heard(round(1000 * seconds))
        else:
            time.sleep(seconds)
        for pid in stopped:
            os.kill(pid, signal.SIGCONT)
        system.wait_for_states()
    outcome = system.end()
    (states,) = outcome.bags
    assert missing(states) == outcome.missing
    assert (states.lost > 1000) if is_lossy else (states.lost == 0)
    assert outcome.ticks_missing <= outcome.ticks_skipped
    assert outcome.ticks_skipped > 1000 * (late - 0.2 * len(stops)) or not late
    first, *_, last = outcome.heard.tolist()
    between = (outcome.published >= first) & (outcome.published <= last)
    assert np.isin(outcome.published[between], outcome.heard).all()


def test_restart_of_other_processes_loses_nothing(system, tmp_path):
    kill(system, 'subscriber')
    kill(system, 'viewer')
    system.wait_for_states()
    kill(system, 'recorder')
    killed, system.bags[0] = system.bags[0], tmp_path / 'recovered'
    recover.main([str(killed), '--to', str(system.bags[0])])
    system.wait_for_states()
    outcome = system.end()
    assert missing(outcome.bags[-1]) == outcome.missing
    assert all(bag.lost == 0 for bag in outcome.bags)
    assert outcome.ticks_missing <= outcome.ticks_skipped


def test_restarted_twin_is_still_recorded(system):
    killed = time.time_ns()
    kill(system, 'twin')
    system.wait_for_states()
    kill(system, 'viewer')
    system.wait_for_states()
    outcome = system.end()
    (states,) = outcome.bags  # one bag has both
    is_first = states.stamps < killed
    for part in (is_first, ~is_first):
        assert RecordedStates(*(column[part] for column in states)).lost == 0


@pytest.mark.timeout(300)
def test_promises_are_kept_for_half_a_minute(domain_id, capsys):
    pytest.importorskip('rerun')
    code = soak.main(['--minutes', '0.5', '--sink', 'file'])
    output = capsys.readouterr().out
    assert code == 0, output
    assert output.count(' | yes |') == 6
