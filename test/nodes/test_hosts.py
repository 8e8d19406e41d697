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
"""A twin, a recorder and a subscriber on three hosts with an unreliable network."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import time

from hosts import Cable, Host
import pytest
import soft_throw_ros
from systems import missing, System

SECOND = 1_000_000_000

pytestmark = [pytest.mark.slow, pytest.mark.once, pytest.mark.timeout(240)]


@pytest.fixture
def hosts():
    made = {}
    try:
        for number, name in enumerate(('twin', 'recorder', 'subscriber'), 1):
            made[name] = Host(number)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f'hosts of its own are not to be had here: {error}')
    yield made
    for host in made.values():
        host.close()


def test_states_of_another_host_arrive_or_are_counted(hosts, start, tmp_path):
    # Memory is shared between namespaces, and would go round the cable.
    profile = (Path(soft_throw_ros.__path__[0]) / 'config' / 'fastdds.xml').read_text('utf-8')
    shared = '<transport_id>soft_throw_shared_memory</transport_id>\n          '
    assert shared in profile
    (tmp_path / 'udp.xml').write_text(profile.replace(shared, ''), 'utf-8')
    apart = os.environ | {
        f'{name}_DEFAULT_PROFILES_FILE': str(tmp_path / 'udp.xml')
        for name in ('FASTDDS', 'FASTRTPS')
    }
    apart['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SUBNET'

    def start_on_host(name, *command, **kwargs):
        return hosts[name].call(start, *command, env=apart, **kwargs)

    with Cable(list(hosts.values()), delay=0.02, loss=0.02) as cable:
        system = System(start_on_host, tmp_path, sink='none')
        assert cable.lost > 0
        cable.is_cut = True
        time.sleep(10.0)
        cable.is_cut = False
        mended = time.time_ns()
        system.wait_for_states()
        system.wait_for_states_of(mended + SECOND)
        outcome = system.end()
    (states,) = outcome.bags
    assert missing(states) == outcome.missing
    # After the cut, the twin sends its history again; older messages count as lost.
    assert 1000 < states.lost < 12_000
    # Hosts that are gone do not hold up the twin.
    assert outcome.ticks_skipped < 1000
    # The subscriber may start, and lose states, before the recorder joins.
    assert outcome.ticks_missing <= outcome.ticks_skipped + outcome.missing
    for stamps in (states.stamps, outcome.heard):
        assert stamps[-1] > mended + SECOND
