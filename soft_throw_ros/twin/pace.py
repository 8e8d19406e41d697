# SPDX-License-Identifier: Apache-2.0
"""When each step is due."""

from __future__ import annotations

SECOND = 1_000_000_000
"""[ns]"""


class Pace:
    """
    When each step is due.

    Deadlines are absolute: being late once makes nothing late later.

    Parameters
    ----------
    step : int
        A step.
    time_ns : int
        When it is due. [ns]
    rate : float
        Steps per second. [Hz]

    Attributes
    ----------
    step, time_ns, rate
        As above, as they are now.

    Examples
    --------
    >>> pace = Pace(step=10, time_ns=5_000_000, rate=1000.0)
    >>> pace.deadline(12)
    7000000
    >>> pace.skip(step=12, now=30_000_000, max_catch_up=3_000_000)
    20
    >>> pace.deadline(12)
    27000000
    >>> pace.step_due(27_000_000), pace.step_due(27_000_001)
    (12, None)

    """

    def __init__(self, *, step: int, time_ns: int, rate: float) -> None:
        self.step = step
        self.time_ns = time_ns
        self.rate = rate

    def deadline(self, step: int) -> int:
        """Return when a step is due. [ns]"""
        return self.time_ns + round((step - self.step) * SECOND / self.rate)

    def step_due(self, time_ns: int) -> int | None:
        """Return the step that is due at a time, None if there is none."""
        step = self.step + round((time_ns - self.time_ns) * self.rate / SECOND)
        return step if self.deadline(step) == time_ns else None

    def change_rate(self, *, step: int, rate: float) -> None:
        """Take another rate from `step` on, whose own deadline stays."""
        self.time_ns = self.deadline(step)
        self.step = step
        self.rate = rate

    def skip(self, *, step: int, now: int, max_catch_up: int) -> int:
        """
        Let time stand still for what a stall took beyond `max_catch_up`.

        Returns
        -------
        int
            How many ticks of the clock go without a step. Steps stay consecutive.

        """
        late = now - self.deadline(step) - max_catch_up
        ticks = int(late * self.rate / SECOND) if late > 0 else 0
        if ticks:
            self.time_ns = self.deadline(step + ticks)
            self.step = step
        return ticks
