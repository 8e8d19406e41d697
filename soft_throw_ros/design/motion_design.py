# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design of the plate's motion, compared with the present throw and with the worst case."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
from soft_throw_ros.core.batch import Cancelled, ThrowUnresolvedError
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import rig_with
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.plate_motion import find_best_motion, PlateLimits
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.uncertainty import Uncertainties


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
    worst: PredictedThrow | None
    """Slowest throw of the best motion within the uncertainties; None if a rig does not throw."""

    @property
    def motion(self) -> SampledMotion:
        """Designed motion of the plate."""
        assert self.rig.engine.motion is not None
        return self.rig.engine.motion

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with `now.` and `worst.` before values of other throws."""
        others = {'now': self.now, 'worst': self.worst}
        return super().values() | {
            f'{key}.{name}': value
            for key, throw in others.items() if throw for name, value in vars(throw).items()
        }


def design_motion(
    rig: Rig,
    plate: PlateLimits | None = None,
    *,
    limits: Limits | None = None,
    uncertainties: Uncertainties | None = None,
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
    uncertainties : Uncertainties, optional
        The projectile stays on the layer until the release within those of wave speed, thickness
        and mass; the rig is exact if not given.

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
    changes = _corners(rig, uncertainties) if uncertainties else []
    others = [rig_with(rig, change) for change in changes]
    best = find_best_motion(rig, plate, loads=limits, others=others, cancelled=cancelled).rig
    throw, now, worst = predict(best), None, None
    with contextlib.suppress(ThrowUnresolvedError):
        now = predict(rig)
    with contextlib.suppress(ThrowUnresolvedError):
        cases = [throw, *(predict(rig_with(best, change)) for change in changes)]
        worst = min(cases, key=lambda case: case.ejection_speed)
    return MotionDesign(
        **vars(throw), rig=best, present=rig, limits=plate, now=now, worst=worst
    )


def _corners(rig: Rig, uncertainties: Uncertainties) -> list[dict[str, float]]:
    """Return the changes to the slowest and to the fastest layer and projectile."""
    offsets = np.array([[-1.0, 1.0, 1.0, 0.0, 0.0], [1.0, -1.0, -1.0, 0.0, 0.0]])
    changes = uncertainties.variants(rig, offsets).changes(
        rig.layer.thickness, rig.layer.wave_speed
    )
    names = ('mass', 'thickness', 'wave_speed')
    return [{name: float(changes[name][n]) for name in names} for n in range(len(offsets))]
