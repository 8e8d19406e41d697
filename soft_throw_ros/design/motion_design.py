# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design of the plate's motion, compared with the present throw."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from soft_throw_ros.core.batch import Cancelled, ThrowUnresolvedError
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.plate_motion import find_best_motion, PlateLimits
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.score import Limits


@dataclass(frozen=True, kw_only=True)
class MotionDesign(PredictedThrow):
    """The best motion of the plate, and its throw."""

    rig: Rig
    """The rig with the best motion."""
    present: Rig
    """The rig as it is."""
    limits: PlateLimits
    """Limits of the actuator."""
    now: PredictedThrow | None
    """Throw of the rig as it is; None if it does not throw."""

    @property
    def motion(self) -> SampledMotion:
        """Designed motion of the plate."""
        assert self.rig.engine.motion is not None
        return self.rig.engine.motion

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with `now.` before the values of the present throw."""
        now = vars(self.now) if self.now else {}
        return super().values() | {f'now.{name}': value for name, value in now.items()}


def design_motion(
    rig: Rig,
    plate: PlateLimits | None = None,
    *,
    limits: Limits | None = None,
    cancelled: Cancelled | None = None,
) -> MotionDesign:
    """
    Find the best motion of the plate.

    Parameters
    ----------
    rig : Rig
        The present rig.
    plate : PlateLimits, optional
        Limits of the actuator; those of its present motion if not given.
    limits, cancelled : optional
        As for `recommend`; the strain of the layer and the acceleration count.

    Raises
    ------
    ThrowUnresolvedError
        If no throw within the limits releases the projectile.
    SearchCancelledError
        If `cancelled` returns True.

    Examples
    --------
    >>> design = design_motion(Rig(gravity=0.0))
    >>> round(design.kinetic_energy / design.now.kinetic_energy, 2)
    1.15

    """
    plate = plate or PlateLimits.of(rig.engine)
    best = find_best_motion(rig, plate, loads=limits, cancelled=cancelled).rig
    now = None
    with contextlib.suppress(ThrowUnresolvedError):
        now = predict(rig)
    return MotionDesign(**vars(predict(best)), rig=best, present=rig, limits=plate, now=now)
