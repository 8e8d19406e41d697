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
The twin without ROS: what happens at which step.

A step is a tick of `rate.state`, and steps are all the time there is: whoever drives a session
(a node by the clock, a replay as fast as it can) asks for one after the other and gets the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Lock

from soft_throw_ros.configuration import Settings
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.journal import JournalWriter
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.plate_monitor import SampleCounts
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.staged_settings import StagedSettings
from soft_throw_ros.twin.throw_cycle import ThrowCycle
from soft_throw_ros.twin.tick_schedule import TickSchedule


class RequestRejected(Exception):
    """What was asked for cannot be done now; the message says why, and for how long."""


class Session:
    """
    The cycle of a rig, its settings and its journal.

    Inputs may come from another thread than steps are asked for from. An input is taken between
    two steps, and has the number of the second one in the journal.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings to start with.
    step : int
        Number of the first step.
    on_entry : callable
        Called with every line of the journal, in order. It must not call back.
    pending : mapping of str to value, optional
        Changes that wait, in a session that goes on where the journal of another one is.

    Attributes
    ----------
    step : int
        Number of the next step.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, with the number.

    """

    def __init__(
        self,
        settings: Settings,
        *,
        step: int = 0,
        on_entry: Callable[[str], None] = lambda _line: None,
        pending: Settings | None = None,
    ) -> None:
        self.step = step
        self._lock = Lock()  # held for microseconds
        self._changing = Lock()  # held while a rig is prepared, for milliseconds
        self._staged = StagedSettings(settings, pending or {})
        self._journal = JournalWriter(on_entry, step=step)
        self._cycle = ThrowCycle(self._staged, self._journal, step=step)
        if pending is None:
            self._journal.begin('start', step, settings)

    @classmethod
    def from_entry(
        cls, entry: journal.Entry, *, on_entry: Callable[[str], None] = lambda _line: None
    ) -> Session:
        """
        Continue from the start of a session or of a throw, as the journal has it.

        The next step is the entry's own. It gives what it gave then, to the last bit, and so do
        all that follow if they get the same inputs, see `twin.replay`.

        Raises
        ------
        JournalError
            If the entry is no such start, or lacks something.
        ValueError
            If the rig cannot be stepped in real time.

        """
        settings, step = journal.checked_settings(entry, 'settings'), entry['step']
        if entry['kind'] == 'start':
            return cls(settings, step=step, on_entry=on_entry)
        if entry['kind'] != 'throw' or 'throw' not in entry:
            raise journal.JournalError(
                f'a session starts with an entry start or throw, got {dict(entry)!r}'
            )
        pending = journal.checked_settings(entry, 'pending')
        session = cls(settings, step=step, on_entry=on_entry, pending=pending)
        session._cycle.resume(step, entry)
        return session

    @property
    def throws(self) -> int:
        """How many throws have started."""
        return self._cycle.throws

    @property
    def rate(self) -> float:
        """Return steps per second of the clock, now [Hz]."""
        return self._staged.config.state_rate

    @property
    def time_scale(self) -> float:
        """Time of the rig over time of the clock, now [-]."""
        return self._staged.config.time_scale

    def due_ns(self, step: int) -> int:
        """Return when a step is due by the schedule that was told last [ns]."""
        return self._cycle.schedule.deadline(step)

    @property
    def pending(self) -> Settings:
        """Return the changes that wait, by name."""
        return self._staged.pending

    @property
    def wanted(self) -> Settings:
        """All settings, with the changes that wait."""
        return self._staged.wanted

    @property
    def is_measured(self) -> bool:
        """Whether samples of the rig are taken."""
        return self._cycle.monitor is not None

    @property
    def is_at_rest(self) -> bool:
        """Whether a measured plate is at rest, so that a throw starts when it jumps up."""
        monitor = self._cycle.monitor
        return monitor is not None and monitor.is_armed

    @property
    def sample_counts(self) -> SampleCounts:
        """How many samples of the rig were taken and refused."""
        return self._cycle.sample_counts

    # inputs

    def request_throw(self) -> None:
        """
        Have a throw start with the next step, or after putting back if changes wait.

        Raises
        ------
        RequestRejected
            If one is under way, saying how long that takes, or the plate is measured.

        """
        with self._lock:
            if self.is_measured:
                raise RequestRejected('the plate is measured: a throw starts when it jumps up')
            refusal = self._cycle.request_throw(self.step)
            if refusal is None:
                self._journal.write('input', self.step, input='throw')
                return
        raise RequestRejected(refusal())  # which may take milliseconds: no step is held up

    def reset(self) -> None:
        """Break off a throw under way, put things back, and count the period from here."""
        with self._lock:
            self._journal.write('input', self.step, input='reset')
            self._cycle.reset(self.step)

    def change(self, values: Settings) -> None:
        """
        Change settings: at once, or when things are put back, see `StagedSettings`.

        Raises
        ------
        ValueError
            If the rig could not be stepped in real time; then nothing has changed.

        """
        with self._changing:
            prepared = self._staged.prepare(values)
            with self._lock:
                self._journal.write_change(self.step, values)
                self._staged.stage(values, prepared)
                if 'throw.period' in values:
                    self._cycle.set_throw_due()

    def measure(self, samples: Sequence[Sample]) -> None:
        """Take samples of the rig, if the plate is measured, or refuse and count them."""
        with self._lock:
            taken = self._cycle.take(self.step, samples)
            if taken:
                self._journal.keep_samples(self.step, taken)

    def set_tick_schedule(self, schedule: TickSchedule) -> None:
        """
        Take note of when steps are due from the next one on.

        Samples and results have stamps, which it relates to steps. It is in the journal, and again
        with every throw, so that whoever has some of the messages can tell by their stamps which
        steps they are of.
        """
        with self._lock:
            self._cycle.schedule = replace(schedule)  # whose owner goes on changing it
            self._journal.write('tick_schedule', self.step, **journal.encode_schedule(schedule))

    def close(self) -> None:
        """Write down what is not in the journal yet, since there are no more steps."""
        with self._lock:
            self._journal.close(self.step)

    # steps

    def advance(self) -> Outputs:
        """Go one step on."""
        with self._lock:
            outputs = self._cycle.advance(self.step)
            self.step += 1
            rate = self._staged.config.state_rate
            is_measured = self._cycle.monitor is not None
            self._journal.end_step(outputs, rate=rate, is_measured=is_measured)
            return outputs
