# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Transport profiles of Fast DDS; `test_faults` tests their effect on recordings."""

from __future__ import annotations

import os
from pathlib import Path
import sys

import pytest
from soft_throw_ros.nodes.process import use_transport_profile

VARIABLES = (
    'FASTDDS_BUILTIN_TRANSPORTS',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
)
LISTEN = """
from pathlib import Path
from soft_throw_ros.nodes.process import use_transport_profile
use_transport_profile()
import rclpy
rclpy.init()
node = rclpy.create_node('listening')
names = [path.resolve().name for path in Path('/proc/self/fd').iterdir()]
inodes = {name[8:-1] for name in names if name.startswith('socket:[')}
for line in Path('/proc/net/udp').read_text().splitlines()[1:]:
    fields = line.split()
    if fields[9] in inodes:
        print(fields[1])
"""


@pytest.mark.parametrize('chosen', [None, *VARIABLES])
def test_profile_is_ours_unless_another_is_chosen(monkeypatch, chosen) -> None:
    for reach, ours in (
        ('', 'fastdds.xml'),
        ('SUBNET', 'fastdds.xml'),
        ('LOCALHOST', 'fastdds_loopback.xml'),
        ('OFF', 'fastdds_loopback.xml'),
    ):
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', reach)
        for name in VARIABLES:
            monkeypatch.setenv(name, 'theirs')  # recorded, so that monkeypatch restores it
            if name != chosen:
                monkeypatch.delenv(name)
        use_transport_profile()
        present = {name: os.environ[name] for name in VARIABLES if name in os.environ}
        if chosen is None:
            assert [Path(path).name for path in present.values()] == [ours]
        else:
            assert present == {chosen: 'theirs'}


def test_ports_are_local_unless_other_machines_are_allowed(start, domain_id) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    first = 7400 + 250 * domain_id  # DDS listens here; senders use other ports
    expected = {'LOCALHOST': '0100007F', 'OFF': '0100007F', 'SUBNET': '00000000'}
    for reach, host in expected.items():
        limited = environment | {'ROS_AUTOMATIC_DISCOVERY_RANGE': reach}
        process = start(sys.executable, '-c', LISTEN, env=limited)
        assert process.wait() == 0
        sockets = [line.split(':') for line in process.lines]
        present = {host for host, port in sockets if first <= int(port, 16) < first + 250}
        # 239.255.0.1 is the group for discovery
        assert {host} <= present <= {host, '0100FFEF'}, (reach, process.lines)
