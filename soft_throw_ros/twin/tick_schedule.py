# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Deadlines of steps."""

from __future__ import annotations

from dataclasses import dataclass

from soft_throw_ros.storage.message import SECOND


@dataclass
class TickSchedule:
    """Absolute deadlines of steps, so that a delay of one step does not delay later ones."""

    step: int  # number of a step
    time_ns: int  # deadline of the step [ns]
    rate: float  # steps per second [Hz]

    def deadline(self, step: int) -> int:
        """Return the deadline of a step [ns]."""
        return self.time_ns + round((step - self.step) * SECOND / self.rate)

    def change_rate(self, *, step: int, rate: float) -> None:
        """Change the rate after a step, whose own deadline stays."""
        self.time_ns = self.deadline(step)
        self.step = step
        self.rate = rate

    def skip(self, *, step: int, now: int, max_catch_up: int) -> int:
        """
        Delay all deadlines by the part of a stall beyond `max_catch_up` [ns].

        Steps stay consecutive; return the number of ticks of the clock without a step.
        """
        late = now - self.deadline(step) - max_catch_up
        ticks = int(late * self.rate / SECOND) if late > 0 else 0
        if ticks:
            self.time_ns = self.deadline(step + ticks)
            self.step = step
        return ticks
