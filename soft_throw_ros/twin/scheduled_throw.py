# SPDX-License-Identifier: Apache-2.0
"""A throw by the schedule or on request, whose plate moves as the engine says."""

from __future__ import annotations

import dataclasses

from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.twin.prepared_rig import PreparedRig, stepper_of
from soft_throw_ros.twin.results import Floats, ThrowField, ThrowResult
from soft_throw_ros.twin.throw_tracker import ThrowStep, ThrowTracker


class ScheduledThrow:
    """
    A throw, from its start until it is over.

    Parameters
    ----------
    prepared : PreparedRig
        What throws.
    number : int
        Of the throw.
    start_ns : int
        When it starts, by the clock of the ticks. [ns]

    """

    def __init__(self, prepared: PreparedRig, *, number: int, start_ns: int = 0) -> None:
        self.number = number
        self._prepared = prepared
        self._tracker = ThrowTracker(prepared, number=number)
        self._start_ns = start_ns
        self._has_shown_field = False

    @property
    def ended_by(self) -> str:
        """Why it is over, empty while it goes on; see `ThrowResult`."""
        return self._tracker.ended_by

    def end(self, reason: str) -> None:
        """Let it be over."""
        self._tracker.ended_by = reason

    @property
    def has_left(self) -> bool:
        """Whether the projectile has left at least once."""
        return self._tracker.first_release is not None

    def advance(self, time: float, config: TwinConfig) -> ThrowStep:
        """Go on to `time` after the start. [s]"""
        return ThrowStep(*self._tracker.advance(time, max_events=config.max_events))

    def result(self, stage: str, step: int, config: TwinConfig) -> ThrowResult:
        """Sum up what there is so far."""
        return self._tracker.result(stage, step, config.max_strain)

    def read_layer(self, out: Floats) -> None:
        """Write what the layer does now, see `Stepper.read_layer`."""
        self._prepared.stepper.read_layer(out)

    def throw_field(self) -> ThrowField | None:
        """Return the layer over time, once, when that time has passed or the throw is over."""
        field, tracker = self._prepared.throw_field, self._tracker
        if (
            field is None
            or self._has_shown_field
            or (tracker.time < field.times[-1] and not tracker.ended_by)
        ):
            return None
        self._has_shown_field = True
        return field._replace(start_ns=self._start_ns)


def time_until_over(prepared: PreparedRig, elapsed: float, *, max_events: int) -> float:
    """
    Find how much longer a throw takes that has gone on for `elapsed`, by throwing once more.

    At most `throw_tracker.LONGEST_THROW`, and exact to a millisecond or a tick. [s]
    """
    # the stepper of the rig is busy with the throw that is under way
    another = dataclasses.replace(prepared, stepper=stepper_of(prepared.config))
    tracker = ThrowTracker(another, number=0)
    tick = max(prepared.tick, 1e-3)
    ticks = 0
    while not tracker.ended_by:
        ticks += 1
        tracker.advance(ticks * tick, max_events=max_events)
    return max(ticks * tick - elapsed, 0.0)
