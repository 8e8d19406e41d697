# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes `twin` and `rig`: a thread advances a session by the clock."""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from typing import Any

from soft_throw_ros.commands.warm_up import load_kernels, missing_parts
from soft_throw_ros.configuration import Settings
from soft_throw_ros.nodes.process import RunnableNode, STOP_TIMEOUT
from soft_throw_ros.nodes.realtime import Clock, NodeClock, SystemClock, Ticker
from soft_throw_ros.recording.child_process import bound_to_parent
from soft_throw_ros.twin.prepared_rig import prepare, PreparedRig
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session

_SWITCH_INTERVAL = 3e-5  # shortest wait of a due tick for another Python thread [s]
_SWITCH_FRACTION = 0.03  # the same over the tick period, to save processor time [-]


class RealTimeNode(RunnableNode):
    """
    Abstract node that advances a session at the deadlines of its steps, in a thread of its own.

    A subclass declares its parameters with the check `prepare`, creates its publishers, and calls
    `attach_session` last. `system_clock` is the clock, unless the node follows `/clock`.
    """

    session: Session
    ticker: Ticker

    def __init__(
        self, name: str, *, system_clock: SystemClock | None = None, **kwargs: Any
    ) -> None:
        super().__init__(name, **kwargs)
        self._system_clock = system_clock or SystemClock()
        self._started = time.monotonic()

    def prepare(self, settings: Settings, before: PreparedRig | None) -> PreparedRig:
        """Return the rig of complete settings of a twin, after kernels are compiled at first."""
        if before is None and missing_parts():
            self._compile_kernels()
        return prepare(settings, before)

    def _compile_kernels(self) -> None:
        """Compile in a child process, because numba suppresses exceptions of signal handlers."""
        self.get_logger().info('compiling the kernels, once for this installation')
        with subprocess.Popen(
            bound_to_parent([sys.executable, '-m', 'soft_throw_ros', 'warm_up']),
            stdin=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C reaches only the node, which then kills the process
        ) as process:
            try:
                process.wait()
            finally:
                process.kill()  # files on the disk are complete at any time

    def attach_session(self, session: Session) -> None:
        """Attach the session that the node advances after its start."""
        self.session = session
        self._node_clock = NodeClock(self)
        self.add_cleanup(self._node_clock.close)
        self.ticker = Ticker(session, self.on_tick, self._current_clock)
        self.add_cleanup(session.close)
        self.add_cleanup(self.ticker.stop, STOP_TIMEOUT)
        self.create_steady_timer(1.0, self.on_second)

    def on_tick(self, due: int) -> None:
        """Advance by one step, in the tick thread; `due` is its deadline [ns]."""
        self.on_step(self.session.advance(), due)

    def on_step(self, outputs: Outputs, due: int) -> None:
        """Publish the outputs of a step, in the tick thread; `due` is its deadline [ns]."""
        raise NotImplementedError

    def on_second(self) -> None:
        """Follow adjustments of the system clock; runs in the executor's thread."""
        self._system_clock.adjust()
        self._set_switch_interval()  # the rate may have changed

    def start(self) -> None:
        """Load all kernels, freeze the garbage collector, and start the ticks."""
        load_kernels(say=self.get_logger().info)
        self._set_switch_interval()
        gc.collect()  # now, since it would delay ticks
        gc.freeze()
        self.ticker.start()
        self._started = time.monotonic()
        self.get_logger().info('ready' + self.describe_start())

    def describe_start(self) -> str:
        """Return the end of the log line at the start."""
        return ''

    @property
    def duration(self) -> float:
        """Time since the start of the ticks [s]."""
        return time.monotonic() - self._started

    def _set_switch_interval(self) -> None:
        sys.setswitchinterval(max(_SWITCH_INTERVAL, _SWITCH_FRACTION / self.session.rate))

    def _current_clock(self) -> Clock:
        return self._node_clock if self._node_clock.is_active else self._system_clock
