# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""
What becomes of the others if one process is killed or stopped: the rows of docs/reliability.md.

Whatever happens, two counts are true: what the recorder says is not in its bag is what is missing
there by the numbers of messages, and the twin says it has skipped no fewer ticks than are missing
by their stamps.
"""

from __future__ import annotations

import os
import signal
import time

import numpy as np
import pytest
from soft_throw_ros.commands import recover
from systems import missing, System

pytestmark = [pytest.mark.once, pytest.mark.timeout(180)]


@pytest.fixture
def system(start, tmp_path):
    pytest.importorskip('rerun')
    return System(lambda _name, *command, **kwargs: start(*command, **kwargs), tmp_path)


def kill(system, name):
    (pid,) = system.pids(name)
    os.kill(pid, signal.SIGKILL)
    if name != 'viewer':  # which the recorder starts again
        assert system.running[name].wait() == -signal.SIGKILL
        system.start(name)


@pytest.mark.parametrize(
    ('stops', 'late', 'is_lossy'),
    [
        ({'subscriber': 2.0, 'viewer': 2.0, 'recorder': 2.0}, 0.0, False),
        ({'recorder': 8.0}, 0.0, True),  # longer than the twin keeps states for it
        ({'twin': 2.0, 'all': 3.0}, 5.0, False),  # and as if the machine slept
    ],
    ids=['others', 'recorder for long', 'twin and all'],
)
def test_processes_that_are_stopped_and_go_on(system, stops, late, is_lossy):
    for name, seconds in stops.items():
        stopped = system.pids(name)
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(seconds)
        for pid in stopped:
            os.kill(pid, signal.SIGCONT)
        if name != list(stops)[-1]:
            system.wait_for_states()
    outcome = system.end()
    (states,) = outcome.bags
    assert missing(states) == outcome.missing
    assert (states.lost > 1000) if is_lossy else (states.lost == 0)
    assert outcome.ticks_missing <= outcome.ticks_skipped
    assert outcome.ticks_skipped > 1000 * (late - 0.2 * len(stops)) or not late
    first, *_, last = outcome.heard.tolist()
    assert last > outcome.told  # a twin that ends takes with it what was not fetched yet
    between = (outcome.published >= first) & (outcome.published <= last)
    assert np.isin(outcome.published[between], outcome.heard).all()
    assert outcome.viewers == 1


def test_others_that_are_killed_and_started_again_cost_nothing(system, tmp_path):
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


def test_twin_that_is_killed_and_started_again_is_recorded_on(system):
    kill(system, 'twin')
    system.wait_for_states()
    kill(system, 'viewer')
    system.wait_for_states()
    outcome = system.end()
    (states,) = outcome.bags
    assert missing(states, twins=2) == outcome.missing  # one bag has both
    assert outcome.viewers == 2
