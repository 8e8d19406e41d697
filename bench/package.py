# SPDX-License-Identifier: Apache-2.0
"""All that is measured of the package, by the names that the tables need."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.cell_stepper import CellStepper, first_throws
from soft_throw_ros.core.closed_form import (
    first_release,
    first_release_kernel,
    first_releases,
    MAX_INTERVALS,
)
from soft_throw_ros.core.plate import peak_velocity_ratio, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.smoothing import smooth
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.wave_stepper import WaveStepper
from soft_throw_ros.design.objective import Limits, Robust
from soft_throw_ros.design.recommendation import recommend

__all__ = [
    'Engine',
    'Layer',
    'Limits',
    'Projectile',
    'Rig',
    'Robust',
    'Underdamped',
    'cell_stepper',
    'first_release',
    'first_release_kernel',
    'first_releases',
    'map_by_cells',
    'peak_velocity_ratio',
    'reader_of',
    'recommend',
    'simulate',
    'smooth',
    'wave_stepper',
    'work_of_kernel',
]

Floats = NDArray[np.float64]


def wave_stepper(rig: Rig, *, steps: int | None = None) -> Any:
    """Make the stepper of travelling waves, with so many steps per crossing."""
    return WaveStepper(rig, steps=steps)


def cell_stepper(rig: Rig, model: str = 'finite_difference', *, cells: int | None = None) -> Any:
    """Make the stepper of cells."""
    return CellStepper(rig, model=model, cells=cells)


def reader_of(stepper: Any) -> Callable[[], Any]:
    """Return a call that reads the layer, as the twin does at every field."""
    return partial(stepper.read_layer, np.empty((3, stepper.field_points)))


def map_by_cells(mu: Floats, kappa: Floats, crossing_ratio: Floats | float, **options: Any) -> Any:
    """Compute first releases by cells; the projectile is rigid if its crossing ratio is 0."""
    return first_throws(
        mass_ratio=mu,
        speed_ratio=kappa,
        crossing_ratio=crossing_ratio,
        unresolved='nan',
        **options,
    )


def work_of_kernel() -> tuple[Floats, ...]:
    """Return the memory that `first_release_kernel` wants as its last arguments."""
    return (np.empty((2, MAX_INTERVALS)),)
