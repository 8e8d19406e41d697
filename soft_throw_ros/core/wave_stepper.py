# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Throws by travelling waves: a rigid projectile on a lossless layer of one material.

`wave_kernels` has the scheme and its order.
"""

from __future__ import annotations

from collections.abc import Mapping
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.batch import Cancelled
from soft_throw_ros.core.rig import Rig, scales_of
from soft_throw_ros.core.stepper import (
    follow_batch,
    load_kernels,
    require_count,
    require_feasible,
    Stepper,
)
from soft_throw_ros.core.wave_kernels import (
    advance_compiled,
    make_waves,
    PAD,
    prepare,
    read_layer_compiled,
    RECORD,
)

Floats = NDArray[np.float64]

MAX_STEPS = 8192
"""Most steps per crossing of the wave."""

MAX_STEP_RATE = 4e7
"""Most steps per second of rig time; a processor computes 4e8 steps per second. [1/s]"""

_STEPS = 512
"""Steps per crossing that later events need for 1e-3. [-]"""

_FEWEST_STEPS = 64
"""Fewest steps per crossing, for 1e-6 at the first release. [-]"""

_STEPS_PER_PERIOD = 160.0
"""Fewest steps per period of the plate, for 1e-6 at the first release. [-]"""

_STEPS_PER_RELAXATION = 8.0
"""Steps per relaxation time that the first release needs, up to `_MOST_FOR_RELAXATION`. [-]"""

_MOST_FOR_RELAXATION = 2048
"""Most steps per crossing that are chosen for the relaxation time. [-]"""

_STEP_COST = 3e-9
"""Time of a processor for a step. [s]"""


def steps_per_crossing(rig: Rig) -> int:
    r"""
    Choose the number of steps per crossing of the wave in real time.

    It is 512, or more where the relaxation time or the plate's period is short, or less where
    steps would be more than `MAX_STEP_RATE` in a second. Errors in :math:`t f` and
    :math:`V / (A \omega)`: 1e-6 at the first release, and 1e-3 at the next four events of 95 % of
    random rigs. ValueError, with a feasible value, if `MAX_STEPS` or `MAX_STEP_RATE` are too few.

    Examples
    --------
    >>> steps_per_crossing(Rig())
    512

    """
    slowest = _FEWEST_STEPS / rig.crossing_time
    require_feasible(rig, 'layer.thickness', slowest, MAX_STEP_RATE, 'steps per second')
    limit = math.floor(min(MAX_STEPS, MAX_STEP_RATE * rig.crossing_time))
    for_plate = math.ceil(_STEPS_PER_PERIOD / rig.speed_ratio)
    require_feasible(rig, 'engine.frequency', for_plate, limit, 'steps per crossing of the wave')
    for_mass = math.ceil(min(_STEPS_PER_RELAXATION / rig.mass_ratio, _MOST_FOR_RELAXATION))
    steps = min(max(_STEPS, for_mass, for_plate), limit)
    return steps - steps % 32


class WaveStepper(Stepper):
    """
    A throw by travelling waves: a rigid projectile on a lossless layer of one material.

    Parameters
    ----------
    rig, is_measured, field_points
        As for `throw.make_stepper`.
    steps : int, optional
        Per crossing of the wave, 16 to `MAX_STEPS`; the default is `steps_per_crossing`.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, or an argument is out of range.

    Examples
    --------
    The rig of the paper, 10 ms after the start:

    >>> stepper = WaveStepper(Rig())
    >>> stepper.advance_to(0.010)
    1
    >>> [release] = stepper.events()
    >>> f'{release.kind} after {1e3 * release.time:.4f} ms with {release.velocity:.4f} m/s'
    'release after 7.6470 ms with 1.3750 m/s'

    """

    def __init__(
        self,
        rig: Rig,
        *,
        is_measured: bool = False,
        steps: int | None = None,
        field_points: int = 64,
    ) -> None:
        rig.check_for_waves()
        steps = steps_per_crossing(rig) if steps is None else steps
        self.steps = require_count('steps', steps, low=16, high=MAX_STEPS)
        self.cost = _STEP_COST * self.steps / rig.crossing_time
        super().__init__(
            rig, RECORD, make_waves(self.steps), is_measured=is_measured, field_points=field_points
        )
        prepare(
            self._core, self.steps, rig.layer.thickness, rig.crossing_time, rig.relaxation_time,
            rig.gravity, rig.layer.impedance, rig.engine.angular_frequency, rig.engine.speed_scale,
        )
        self._start(advance_compiled(), read_layer_compiled())

    def _copy_layer(self, origin: Stepper) -> None:
        """Copy the waves that are still on their way."""
        grid = origin._core[0]
        kept = int(grid['cell'] - grid['base']) - self.steps
        first, last = max(kept - PAD, 0), int(grid['filled'] - grid['base']) + 2
        self._layer[:, first:last] = origin._layer[:, first:last]


def throw_batch(
    values: Mapping[str, Floats],
    *,
    until: Floats,
    cancelled: Cancelled | None = None,
) -> Floats:
    """
    Compute loads for `throw.throw_many`, without loss, unchecked.

    `until` has the exact times of the first releases [s]: a light projectile may leave and be
    caught again within a step. Arguments and result are else those of `cell_stepper.throw_batch`.
    Errors in loads and work: 1e-3 for 95 % of rigs.
    """
    scales = scales_of(values)
    crossing, omega = scales.crossing_time, scales.angular_frequency
    steps = np.maximum(
        _STEPS_PER_RELAXATION / scales.mass_ratio, _STEPS_PER_PERIOD / scales.speed_ratio
    )
    steps = np.clip(32.0 * np.ceil(steps / 32.0), _FEWEST_STEPS, _STEPS).astype(np.int64)
    columns = (
        steps, values['thickness'], crossing, scales.relaxation_time, values['gravity'],
        scales.impedance, omega, values['amplitude'] * omega,
    )

    def prepare_throw(core: NDArray[np.void], n: int) -> tuple[Floats, float]:
        prepare(core, *(column[n] for column in columns))
        return make_waves(int(steps[n])), _STEP_COST * steps[n] / crossing[n]

    latest = until + crossing / steps
    return follow_batch(RECORD, advance_compiled(), prepare_throw, values, latest, cancelled)


def warm_up() -> None:
    """Compile or load all kernels that the twin needs."""
    load_kernels(WaveStepper(Rig(), is_measured=True, field_points=2))
