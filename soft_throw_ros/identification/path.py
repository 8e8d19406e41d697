# SPDX-License-Identifier: Apache-2.0
"""Where the projectile is at given times, by the models that the twin runs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.grid_stepper import GridStepper
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.stepping import (
    Event,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    ThrowStepper,
)

Floats = NDArray[np.float64]


class Path(NamedTuple):
    """Height of the projectile's lower face [m], its velocity [m/s], and what happened."""

    position: Floats
    velocity: Floats
    events: tuple[Event, ...]


def follow(rig: Rig, time: Floats, *, by_grid: bool = False) -> Path:
    """
    Follow a throw.

    Parameters
    ----------
    rig : Rig
    time : ndarray, shape (n,)
        Since the plate began to move, in any order; before that all is at rest. [s]
    by_grid : bool
        Whether to take finite differences though there is no internal loss.

    Returns
    -------
    Path
        Heights count from the plate's position at rest.

    Raises
    ------
    ValueError
        If the model refuses the rig.

    """
    moments, places = np.unique(np.maximum(time, 0.0), return_inverse=True)
    stepper: ThrowStepper
    if by_grid or rig.layer.loss_tangent > 0.0:
        stepper = GridStepper(rig, field_points=2)
    else:
        stepper = Stepper(rig, field_points=2)
    states = np.empty((moments.size, stepper.state.size))
    for row, moment in zip(states, moments.tolist(), strict=True):
        stepper.advance_to(moment)
        row[:] = stepper.state
    return Path(
        states[places, PROJECTILE_POSITION],
        states[places, PROJECTILE_VELOCITY],
        tuple(stepper.events()),
    )


def landing_time(rig: Rig, time: float, *, by_grid: bool = False) -> float:
    """
    Find when the projectile comes down on the layer again.

    Returns infinity if not before `time` [s]; being caught up on the way up is no landing.
    """
    if rig.gravity > 0.0:
        for event in follow(rig, np.array([time]), by_grid=by_grid).events:
            if event.kind == 'landing' and event.velocity <= 0.0:
                return event.time
    return float('inf')
