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
Hosts on one machine, each in a network namespace, joined by a cable that delays, loses and is cut.

The cable is a thread that hands Ethernet frames from host to host. It does what `tc netem` does,
and also where the kernel has no netem. Nothing is left behind: a namespace goes with the last
thread or process that is in it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
import ctypes
import fcntl
import os
import random
import select
import struct
import subprocess
import threading
import time
from types import TracebackType
from typing import Any, TypeVar

Result = TypeVar('Result')

_CLONE_NEWNET = 0x40000000
_TUNSETIFF = 0x400454CA
_IFF_TAP = 0x0002
_IFF_NO_PI = 0x1000
_LARGEST_FRAME = 2048


class Host:
    """
    A network namespace with one end of a cable, at 10.77.0.NUMBER.

    Raises
    ------
    OSError
        If the system does not allow it, or has no `ip`.

    """

    def __init__(self, number: int) -> None:
        self._thread = ThreadPoolExecutor(1)  # which alone is in the namespace
        self.port: int = self.call(self._enter, number)

    def call(self, function: Callable[..., Result], *args: Any, **kwargs: Any) -> Result:
        """Call something on this host; processes that it starts are on it, too."""
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
            raise OSError(f'no network namespace of its own: {reason}')
        port = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
        fcntl.ioctl(port, _TUNSETIFF, struct.pack('16sH22x', b'cable', _IFF_TAP | _IFF_NO_PI))
        for command in (
            f'address add 10.77.0.{number}/24 dev cable',
            'link set cable up',
            'link set lo up',
            'route add 224.0.0.0/4 dev cable',
            # a host that has gone is missed at once, not only after 15 to 45 s
            'ntable change name arp_cache dev cable base_reachable 1000 delay_probe 100',
        ):
            subprocess.run(['ip', *command.split()], check=True, capture_output=True)
        return port


class Cable:
    """
    What joins hosts: a switch that hands on every frame late, or loses it.

    Parameters
    ----------
    hosts : sequence of Host
        On the cable.
    delay : float
        Of every frame. [s]
    loss : float
        What part of the frames is lost. [-]

    Attributes
    ----------
    is_cut : bool
        Whether all is lost at present.
    handed_on, lost : int
        How many frames.

    """

    def __init__(self, hosts: list[Host], *, delay: float, loss: float) -> None:
        self.is_cut = False
        self.handed_on = 0
        self.lost = 0
        self._ports = [host.port for host in hosts]
        self._delay = delay
        self._loss = loss
        self._chance = random.Random(1)
        self._waiting: deque[tuple[float, int, bytes]] = deque()
        self._places: dict[bytes, int] = {}  # ports by addresses
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Cable:
        self._thread.start()
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        self._is_over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._is_over.is_set():
            until = self._waiting[0][0] - time.monotonic() if self._waiting else 0.1
            ready, _, _ = select.select(self._ports, [], [], max(until, 0.0))
            for port in ready:
                frame = os.read(port, _LARGEST_FRAME)
                self._places[frame[6:12]] = port
                if self.is_cut or self._chance.random() < self._loss:
                    self.lost += 1
                else:
                    self._waiting.append((time.monotonic() + self._delay, port, frame))
            while self._waiting and self._waiting[0][0] <= time.monotonic():
                self._hand_on(*self._waiting.popleft()[1:])

    def _hand_on(self, origin: int, frame: bytes) -> None:
        to = self._places.get(frame[:6])
        for port in [to] if to is not None else self._ports:
            if port != origin:
                try:
                    os.write(port, frame)
                    self.handed_on += 1
                except OSError:  # its queue is full, or the host is gone
                    self.lost += 1
