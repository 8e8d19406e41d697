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
What the nodes `twin` and `rig` have in common: a thread that steps a session by the clock.

All else happens in the executor's thread: services, parameters, and what is published now and
then.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from typing import Any

from soft_throw_ros.configuration import Settings
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.realtime import Clock, NodeClock, SystemClock, Ticker
from soft_throw_ros.twin import kernels
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session

_NICE = 10  # of the process that compiles what can wait

SWITCH_INTERVAL = 3e-5
"""How long a tick that is due waits for another thread of Python; less wakes too many [s]."""

SWITCH_PART = 0.03
"""The same in parts of the time between ticks; less is for nothing, and many nodes on few cores
would do nothing but wake [-]."""

STOP_TIMEOUT = 0.3
"""Longest wait for a thread to end [s]."""


class RealTimeNode(RunnableNode):
    """
    A node that steps a session as steps are due; to be derived from.

    Whoever derives from it declares parameters, calls `load_kernels`, makes publishers, and calls
    `drive` last.

    Parameters
    ----------
    name : str
        Of the node.
    system_clock : SystemClock, optional
        What steps are due by, unless the node follows `/clock`.
    **kwargs
        As for `rclpy.node.Node`.

    Attributes
    ----------
    session : Session
        What happens at which step.
    ticker : Ticker
        What asks for the steps: by itself once it is started.

    """

    session: Session
    ticker: Ticker

    def __init__(
        self, name: str, *, system_clock: SystemClock | None = None, **kwargs: Any
    ) -> None:
        super().__init__(name, **kwargs)
        self._system_clock = system_clock or SystemClock()
        self._compiling: subprocess.Popen[bytes] | None = None
        self._is_closed = False

    def load_kernels(self, settings: Settings) -> None:
        """
        Load the kernels that a rig with these settings of a twin needs; compile them if need be.

        That is done in processes of their own. What can wait is compiled while the node ticks, and
        loaded from the disk when it is needed.
        """
        say = self.get_logger().info
        needed, missing = kernels.needed_parts(settings), kernels.missing_parts()
        first = [part for part in needed if part in missing]
        if first:  # numba swallows what a signal raises in it
            compiling = self._compile(first, stdout=subprocess.PIPE)
            for line in compiling.stdout or ():
                say(line.decode().strip())
            compiling.wait()
        kernels.load_kernels(needed, say=say)
        rest = [part for part in missing if part not in needed]
        if rest:
            say(f'compiling beside, once: {", ".join(rest)}')
            self._compiling = self._compile(rest, stdout=subprocess.DEVNULL)
            os.setpriority(os.PRIO_PROCESS, self._compiling.pid, _NICE)

    def _compile(self, parts: list[str], *, stdout: int) -> subprocess.Popen[bytes]:
        """Compile in a process, which ends with the node."""
        process = subprocess.Popen(
            [sys.executable, '-m', 'soft_throw_ros', 'warm_up', *parts],
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            start_new_session=True,  # Ctrl-C is for the node, which ends it
        )
        self.at_end(process.wait)
        self.at_end(process.kill)  # what is on the disk is whole at any time
        return process

    def close(self) -> None:
        """End what compiles beside; what else there is to do may be cut short."""
        self._is_closed = True
        if self._compiling is not None:
            self._compiling.kill()
        super().close()

    @property
    def is_compiling(self) -> bool:
        """Whether kernels that could wait are still being compiled, or were when all ended."""
        compiling = self._compiling
        return compiling is not None and (self._is_closed or compiling.poll() is None)

    def drive(self, session: Session) -> None:
        """Have steps of a session done as soon as the node starts."""
        self.session = session
        self._node_clock = NodeClock(self)
        self.at_end(self._node_clock.close)
        self.ticker = Ticker(session, self.on_tick, self._current_clock)
        self.at_end(session.close)
        self.at_end(self.ticker.stop, STOP_TIMEOUT)
        self.call_every(1.0, self.on_second)

    def on_tick(self, due: int) -> None:
        """Go a step on, in the thread that ticks; `due` is its time [ns]."""
        self.on_step(self.session.advance(), due)

    def on_step(self, outputs: Outputs, due: int) -> None:
        """Publish what a step gives, in the thread that ticks; `due` is its time [ns]."""
        raise NotImplementedError

    def on_second(self) -> None:
        """Follow what is done to the time of day; in the executor's thread."""
        self._system_clock.adjust()
        self._set_switch_interval()  # the rate may be another one
        if self._compiling is not None:
            self._compiling.poll()  # lest it stays a zombie when it has ended

    @property
    def exit_code(self) -> int | None:
        """1 if the ticks have come to an end by themselves."""
        return 1 if self.ticker.has_ended else None

    def prepare(self) -> None:
        """Load all kernels that are there, and let nothing hold up the ticks."""
        if not self.is_compiling:
            kernels.load_kernels(say=self.get_logger().info)
        self._set_switch_interval()
        gc.collect()
        gc.freeze()

    def start(self) -> None:
        """Tick."""
        self.ticker.start()
        self.get_logger().info('ready')

    def _set_switch_interval(self) -> None:
        sys.setswitchinterval(max(SWITCH_INTERVAL, SWITCH_PART / self.session.rate))

    def _current_clock(self) -> Clock:
        return self._node_clock if self._node_clock.is_active else self._system_clock
