# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A twin, a recorder and a subscriber on three hosts with an unreliable network.

The hosts are network namespaces of one machine. A thread forwards the Ethernet frames between
them: it replaces `tc netem`, which many kernels lack. A namespace ends with its last thread or
process, so no cleanup is needed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import ctypes
import fcntl
import os
from pathlib import Path
import random
import select
import struct
import subprocess
from test.nodes.conftest import SECOND
import threading
import time
from typing import Any, TypeVar

import pytest
import soft_throw_ros
from systems import missing, System

pytestmark = [pytest.mark.slow, pytest.mark.once, pytest.mark.timeout(240)]

Result = TypeVar('Result')

_CLONE_NEWNET = 0x40000000
_TUNSETIFF = 0x400454CA
_IFF_TAP = 0x0002
_IFF_NO_PI = 0x1000
_LARGEST_FRAME = 2048


class Host:
    """A network namespace with the address 10.77.0.NUMBER and a port of a cable."""

    def __init__(self, number: int) -> None:
        self._thread = ThreadPoolExecutor(1)  # the only thread in the namespace
        self.port: int = self.call(self._enter, number)

    def call(self, function: Callable[..., Result], *args: Any, **kwargs: Any) -> Result:
        """Call a function on this host; processes that it starts are on this host, too."""
        return self._thread.submit(function, *args, **kwargs).result()

    def close(self) -> None:
        """Leave the namespace."""
        os.close(self.port)
        self._thread.shutdown()

    @staticmethod
    def _enter(number: int) -> int:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.unshare(_CLONE_NEWNET) != 0:
            reason = os.strerror(ctypes.get_errno())
            raise OSError(f'no network namespace: {reason}')
        port = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
        fcntl.ioctl(port, _TUNSETIFF, struct.pack('16sH22x', b'cable', _IFF_TAP | _IFF_NO_PI))
        for command in (
            f'address add 10.77.0.{number}/24 dev cable',
            'link set cable up',
            'link set lo up',
            'route add 224.0.0.0/4 dev cable',
            # notice a vanished host at once instead of after 15 to 45 s
            'ntable change name arp_cache dev cable base_reachable 1000 delay_probe 100',
        ):
            subprocess.run(['ip', *command.split()], check=True, capture_output=True)
        return port


class Cable:
    """A switch that delays frames between hosts [s], and loses a fraction or, if cut, all."""

    def __init__(self, hosts: list[Host], *, delay: float, loss: float) -> None:
        self.is_cut = False
        self.lost = 0
        self._ports = [host.port for host in hosts]
        self._delay = delay
        self._loss = loss
        self._chance = random.Random(1)
        self._waiting: deque[tuple[float, int, bytes]] = deque()
        self._port_of: dict[bytes, int] = {}  # by hardware address
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Cable:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_closed.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._is_closed.is_set():
            until = self._waiting[0][0] - time.monotonic() if self._waiting else 0.1
            ready, _, _ = select.select(self._ports, [], [], max(until, 0.0))
            for port in ready:
                frame = os.read(port, _LARGEST_FRAME)
                self._port_of[frame[6:12]] = port
                if self.is_cut or self._chance.random() < self._loss:
                    self.lost += 1
                else:
                    self._waiting.append((time.monotonic() + self._delay, port, frame))
            while self._waiting and self._waiting[0][0] <= time.monotonic():
                self._forward(*self._waiting.popleft()[1:])

    def _forward(self, origin: int, frame: bytes) -> None:
        target = self._port_of.get(frame[:6])
        for port in [target] if target is not None else self._ports:
            if port != origin:
                try:
                    os.write(port, frame)
                except OSError:  # the queue is full, or the host has ended
                    self.lost += 1


@pytest.fixture
def hosts():
    made = {}
    try:
        for number, name in enumerate(('twin', 'recorder', 'subscriber'), 1):
            made[name] = Host(number)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f'this machine does not permit network namespaces: {error}')
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
        system = System(start_on_host, tmp_path, shows=False)
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
