# SPDX-License-Identifier: Apache-2.0
"""The way of plate and projectile back to rest."""

from __future__ import annotations

from dataclasses import dataclass

from soft_throw_ros.twin.results import State


@dataclass(frozen=True, kw_only=True)
class ReturnPath:
    """
    From standing still to standing still with the least jerk [1]_.

    Plate and projectile do not run into each other, since both go the same part of their way at a
    time.

    Parameters
    ----------
    begin, end : int
        Steps at which it begins and ends.
    origin, goal : State
        Where it leads from and to.

    References
    ----------
    .. [1] Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985) 1688.

    """

    begin: int
    end: int
    origin: State
    goal: State

    def state(self, step: int, *, tick: float) -> State:
        """Return where plate and projectile are; forces are zero, since the layer is left out."""
        ticks = self.end - self.begin
        part = (step - self.begin) / ticks
        mixture = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        speed = 30.0 * (part * (1.0 - part)) ** 2 / (ticks * tick)
        plate = self.goal.plate_position - self.origin.plate_position
        projectile = self.goal.projectile_position - self.origin.projectile_position
        return State(
            plate_position=self.origin.plate_position + mixture * plate,
            projectile_position=self.origin.projectile_position + mixture * projectile,
            plate_velocity=speed * plate,
            projectile_velocity=speed * projectile,
            plate_force=0.0,
            projectile_force=0.0,
        )
