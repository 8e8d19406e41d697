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
from soft_throw_ros.core.batch import Cancelled, check_cancelled, in_threads, longest_wait
from soft_throw_ros.core.plate_kernels import NO_PATH, write_damped
from soft_throw_ros.core.rig import Rig, scales_of
from soft_throw_ros.core.stepper import (
    load_kernels,
    Loads,
    require_count,
    require_rate,
    require_steps_per_period,
    Stepper,
)
from soft_throw_ros.core.wave_kernels import (
    advance_compiled,
    clear_waves,
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

STEP_COST = 3e-9
"""Time of a processor for a step. [s]"""

_THROWS_PER_THREAD = 64
"""Fewest throws that are worth a thread. [-]"""


def steps_per_crossing(rig: Rig) -> int:
    r"""
    Choose the number of steps per crossing of the wave in real time.

    Returns
    -------
    int
        512, or more where the relaxation time or the plate's period is short, or less where steps
        would be more than `MAX_STEP_RATE` in a second. Errors in :math:`t f` and
        :math:`V / (A \omega)`: 1e-6 at the first release, and 1e-3 at the next four events of
        95 % of random rigs.

    Raises
    ------
    ValueError
        If the layer is a stack or has loss, or if `MAX_STEPS` or `MAX_STEP_RATE` are too few; the
        message names feasible values.

    Examples
    --------
    >>> steps_per_crossing(Rig())
    512

    """
    rig.check_for_waves()
    slowest = _FEWEST_STEPS / rig.crossing_time
    require_rate(rig.layer, slowest, limit=MAX_STEP_RATE, unit='steps')
    limit = math.floor(min(MAX_STEPS, MAX_STEP_RATE * rig.crossing_time))
    for_plate = require_steps_per_period(
        rig, _STEPS_PER_PERIOD, limit=limit, unit='steps per crossing of the wave'
    )
    for_mass = math.ceil(min(_STEPS_PER_RELAXATION / rig.mass_ratio, _MOST_FOR_RELAXATION))
    steps = min(max(_STEPS, for_mass, for_plate), limit)
    return steps - steps % 32


class WaveStepper(Stepper):
    """
    A throw by travelling waves: a rigid projectile on a lossless layer of one material.

    See `wave_kernels` for the scheme and its order, and `Stepper` for the common contract.

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

    _kernels = advance_compiled, read_layer_compiled

    def __init__(
        self,
        rig: Rig,
        *,
        is_measured: bool = False,
        steps: int | None = None,
        field_points: int = 64,
    ) -> None:
        rig.check_for_waves()
        super().__init__(rig, field_points)
        if steps is None:
            steps = steps_per_crossing(rig)
        self.steps = require_count('steps', steps, low=16, high=MAX_STEPS)
        self._layer = make_waves(self.steps)
        start = self._make_records(RECORD, is_measured=is_measured)
        start['thickness'] = rig.layer.thickness
        start['rest_height'] = rig.rest_height
        prepare(
            self._core, self.steps, rig.crossing_time, rig.relaxation_time, rig.gravity,
            rig.layer.impedance, rig.engine.angular_frequency, rig.engine.speed_scale,
        )
        self._work_unit = rig.layer.impedance * float(start['step'])
        self._bind()
        self.reset()

    def _clear(self) -> None:
        clear_waves(self._layer, self.steps)

    def _copy_layer(self, origin: Stepper) -> None:
        """Copy the waves that are still on their way."""
        grid = origin._core[0]
        kept = int(grid['cell'] - grid['base']) - self.steps
        first, last = max(kept - PAD, 0), int(grid['filled'] - grid['base']) + 2
        self._layer[:, first:last] = origin._layer[:, first:last]

    @property
    def cost(self) -> float:
        """Time of a processor over time of the rig, about [-]."""
        return STEP_COST * self.steps / self.rig.crossing_time

    @property
    def loads(self) -> Loads:
        """Largest loads up to the first release, or up to now before the release."""
        return _loads_of(self._core[1], self.rig.layer.wave_speed)

    @property
    def plate_work(self) -> float:
        """Work of the plate up to the first release, or up to now before the release [J]."""
        now = self._core[1]
        work = now['work'] + (now['offset'] - 0.5) * now['power']
        return float(self._work_unit * (now['first_work'] if self.event_count else work))

    def stored_energy(self) -> float:
        """Return the work of the plate, since the layer is lossless [J]."""
        return self.plate_work


def _loads_of(s: np.void, wave_speed: float) -> Loads:
    """Return the loads of a record in SI units."""
    force, stress = float(s['peak_contact_force']), float(s['peak_plate_stress'])
    contact_stress = force + float(s['gravity_offset'])
    return Loads(
        strain=max(float(s['peak_strain']), stress, contact_stress) / wave_speed,
        plate_strain=stress / wave_speed,
        contact_strain=contact_stress / wave_speed,
        acceleration=force / float(s['relaxation']),
        plate_force=stress * float(s['impedance']),
    )


def throw_batch(
    values: Mapping[str, Floats],
    *,
    until: Floats | float = math.nan,
    threads: int | None = None,
    cancelled: Cancelled | None = None,
) -> Floats:
    r"""
    Compute first releases and loads for `throws.throw_many`, without loss, unchecked.

    Parameters
    ----------
    values, threads, cancelled
        As for `cell_stepper.throw_batch`.
    until : ndarray or float
        Times of the first releases where they are known, otherwise NaN. A light projectile may
        leave and be caught again within a step. [s]

    Returns
    -------
    ndarray, shape (6, n)
        Rows as of `cell_stepper.throw_batch`. Errors: 1e-5 in the release, and 1e-3 in
        loads and work for 95 % of rigs.

    """
    scales = scales_of(values)
    crossing, omega = scales.crossing_time, scales.angular_frequency
    steps = np.maximum(
        _STEPS_PER_RELAXATION / scales.mass_ratio, _STEPS_PER_PERIOD / scales.speed_ratio
    )
    steps = np.clip(32.0 * np.ceil(steps / 32.0), _FEWEST_STEPS, _STEPS).astype(np.int64)
    is_known = np.isfinite(np.broadcast_to(until, crossing.shape))
    latest = np.where(is_known, until + crossing / steps, longest_wait(scales))
    amplitude, zeta, gravity = (values[key] for key in ('amplitude', 'damping_ratio', 'gravity'))
    results = np.full((6, crossing.size), math.nan)

    def run(first: int, stride: int) -> None:
        core, no_events = np.zeros(3, RECORD), np.empty((0, 4))
        numbers = core.view(np.float64).reshape(3, -1)
        advance = advance_compiled()
        for n in range(first, crossing.size, stride):
            check_cancelled(cancelled)
            waves = make_waves(int(steps[n]))
            numbers[:] = 0.0
            write_damped(core, amplitude[n], omega[n], zeta[n])
            prepare(
                core, steps[n], crossing[n], scales.relaxation_time[n], gravity[n],
                scales.impedance[n], omega[n], amplitude[n] * omega[n],
            )
            numbers[:2] = numbers[2]
            advance(core, waves, NO_PATH, no_events, latest[n])
            s = core[1]
            if s['events'] or is_known[n]:
                loads = _loads_of(s, values['wave_speed'][n])
                work = (s['first_work'] if s['events'] else s['work']) * s['step'] * s['impedance']
                results[:, n] = (
                    (s['launch_cell'] + s['launch_offset']) * s['step'], s['launch_velocity'],
                    loads.strain, loads.acceleration, loads.plate_force, work,
                )

    in_threads(run, count=crossing.size, per_thread=_THROWS_PER_THREAD, threads=threads)
    return results


def warm_up() -> None:
    """Compile or load all kernels that the twin needs."""
    load_kernels(WaveStepper(Rig(), is_measured=True, field_points=2))
