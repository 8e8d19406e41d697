# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Throws by cells of finite size: layers with loss, large strain or several sheets.

`cell_grid` cuts a rig into cells, and `cell_kernels` has the scheme and its order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.batch import Cancelled, check_cancelled, in_threads, longest_wait
from soft_throw_ros.core.cell_grid import count_cells, crossing_time, make_bodies, make_grid
from soft_throw_ros.core.cell_kernels import (
    advance_compiled,
    prepare,
    read_layer_compiled,
    RECORD,
    reset,
    ROW,
    ROWS,
    stored_energy,
)
from soft_throw_ros.core.plate_kernels import NO_PATH, write_damped
from soft_throw_ros.core.rig import Layer, Rig, Scales, scales_of, values_of
from soft_throw_ros.core.stepper import (
    load_kernels,
    Loads,
    RateError,
    require_count,
    require_rate,
    require_steps_per_period,
    Stepper,
)

Floats = NDArray[np.float64]

MAX_CELLS = 4096
"""Most cells of a layer."""

MAX_UPDATE_RATE = 6e7
"""Most cells times steps in a second of rig time; a processor takes 3e8 and more. [1/s]"""

UPDATE_COST = 4e-9
"""Time of a processor for a cell in a step. [s]"""

_CELLS = 64
"""Fewest cells of a layer that are chosen, for 1e-4. [-]"""

_NEO_HOOKEAN_CELLS = 1.5
"""Cells of a neo-Hookean layer over those of a linear one in `throw_batch`, for 2e-4. [-]"""

_CELLS_PER_RELAXATION = 12.0
"""Cells per relaxation time, over the crossing time, for 1e-4 in the speed. [-]"""

_MIN_CELLS_PER_RELAXATION = 4.0
"""The same for 1e-3, below which a rig is refused in real time. [-]"""

_STEPS_PER_PERIOD = 120.0
"""Steps per period of the plate, for 1e-4. [-]"""

_MIN_STEPS_PER_PERIOD = 80.0
"""Steps per period of the plate below which a rig is refused in real time. [-]"""

_MAX_BATCH_CELLS = 2048
"""Most cells that `throw_batch` chooses. [-]"""

_LOSSLESS_CELLS = 256
"""Cells of lossless sheets from which the step is halved; fewer miss short releases. [-]"""

_HALVING = 1e-4
"""Largest relative change of time and speed at which halving the step ends. [-]"""

_SLICE = 0.1
"""Time of a processor between two looks at a flag. [s]"""

_THROWS_PER_THREAD = 16
"""Fewest throws that are worth a thread. [-]"""


def cells_per_layer(rig: Rig) -> int:
    r"""
    Choose the number of cells of the layer in real time.

    Returns
    -------
    int
        At least 64; 12 per relaxation time and 120 steps in a period of the plate, for errors of
        1e-4, or as many as there is time for.

    Raises
    ------
    ValueError
        If `MAX_CELLS` or `MAX_UPDATE_RATE` are too few for 64 cells, 4 per relaxation time and 80
        steps in a period; with a feasible value.

    Examples
    --------
    >>> cells_per_layer(Rig())
    64

    """
    layer = rig.layer
    rate = 1.0 / crossing_time(rig)  # updates per second, over the square of the cells
    require_rate(layer, _CELLS**2 * rate, limit=MAX_UPDATE_RATE, unit='updates of cells')
    limit = min(MAX_CELLS, math.floor(math.sqrt(MAX_UPDATE_RATE / rate)))
    for_mass = math.ceil(_MIN_CELLS_PER_RELAXATION / rig.mass_ratio)
    if for_mass > limit:
        min_mass = rig.projectile.mass * for_mass / limit
        raise RateError(
            f'projectile.mass {rig.projectile.mass:g} kg on a layer of {layer.mass:.4g} kg needs '
            f'{for_mass} cells, the limit is {limit}; '
            f'feasible: projectile.mass of {1.001 * min_mass:.4g} kg or more'
        )
    require_steps_per_period(rig, _MIN_STEPS_PER_PERIOD, limit=limit, unit='cells')
    periods = rig.crossing_time * rig.engine.frequency
    needed = max(_CELLS_PER_RELAXATION / rig.mass_ratio, _STEPS_PER_PERIOD * periods)
    return min(max(_CELLS, math.ceil(min(needed, MAX_CELLS))), limit)


def throw_batch(
    values: Mapping[str, Floats],
    layer: Layer,
    *,
    cells: int | None = None,
    threads: int | None = None,
    cancelled: Cancelled | None = None,
) -> Floats:
    r"""
    Compute first releases and loads for `throws.throw_many`, unchecked but for `cells`.

    Parameters
    ----------
    values : mapping of str to ndarray, shape (n,)
        Values of the rigs, as of `rig.values_of`.
    layer : Layer
        Layer whose sheets have the proportions of all layers.
    cells : int, optional
        Number of cells of the layer, from 8 to `MAX_CELLS`; by default chosen for each throw, at
        least 64, for errors of 1e-4. Errors are of second order, but of first order in shocks.
    threads, cancelled
        As for `throws.throw_many`.

    Returns
    -------
    ndarray, shape (6, n)
        Rows of `throws.Throws` without the energy transfer; NaN without a release by
        `batch.longest_wait`.

    """
    if cells is not None:
        require_count('cells', cells, low=8, high=MAX_CELLS)
    scales = scales_of(values)
    bodies, crossings = make_bodies(values, layer)
    steps = crossings.sum(axis=1) / (_choose_cells(scales, layer) if cells is None else cells)
    bodies['count'] = count_cells(crossings, steps[:, None])
    is_settled = (values['loss_tangent'] > 0.0) | (cells is not None or not layer.parts)
    latest = longest_wait(scales)
    names = 'amplitude', 'damping_ratio', 'mass', 'gravity'
    amplitude, zeta, mass, gravity = (values[name] for name in names)
    omega = scales.angular_frequency
    results = np.full((6, mass.size), math.nan)

    def run(first: int, stride: int) -> None:
        core, no_events = np.zeros(3, RECORD), np.empty((0, 4))
        numbers = core.view(np.float64).reshape(3, -1)
        advance = advance_compiled()

        def throw(n: int) -> tuple[float, ...]:
            step, body = steps[n], bodies[n]
            nodes = np.zeros((ROWS, body['count'].sum() + 2))
            numbers[:] = 0.0
            write_damped(core, amplitude[n], omega[n], zeta[n])
            peak_force = amplitude[n] * omega[n] * scales.impedance[n]
            prepare(core, nodes, body, step, mass[n], gravity[n], omega[n], peak_force)
            numbers[:2] = numbers[2]
            reset(core, nodes)
            slices = 2 + int(UPDATE_COST * nodes.shape[1] * latest[n] / step / _SLICE)
            for time in np.linspace(0.0, latest[n], slices)[1:]:
                check_cancelled(cancelled)
                if advance(core, nodes, NO_PATH, no_events, time):
                    break
            grid = core[0]
            if not grid['events']:
                return (math.nan,) * 6
            return (
                grid['event_time'], grid['event_velocity'],
                max(grid['edge_strains'].max(), nodes[ROW.peak_strain].max()),
                grid['acceleration'], grid['plate_force'], grid['work'],
            )

        def throw_with(n: int, count: int) -> tuple[float, ...]:
            steps[n] = crossings[n].sum() / count
            bodies['count'][n] = count_cells(crossings[n], steps[n])
            return throw(n)

        for n in range(first, mass.size, stride):
            if is_settled[n]:
                results[:, n] = throw(n)
            else:
                _, results[:, n] = _halve_steps(partial(throw_with, n))

    in_threads(run, count=mass.size, per_thread=_THROWS_PER_THREAD, threads=threads)
    return results


def _halve_steps(throw: Callable[[int], tuple[float, ...]]) -> tuple[int, tuple[float, ...]]:
    """Halve the step until time and speed of the release settle; return cells and results."""
    cells, results = _LOSSLESS_CELLS, throw(_LOSSLESS_CELLS)
    while cells < _MAX_BATCH_CELLS:
        cells, coarse, results = 2 * cells, results, throw(2 * cells)
        if np.allclose(results[:2], coarse[:2], rtol=_HALVING, atol=0.0, equal_nan=True):
            break
    return cells, results


def settled_cells(rig: Rig, *, latest: float, cancelled: Cancelled | None = None) -> int | None:
    """
    Return the number of cells for 1e-4 offline, None for that of `cells_per_layer`.

    Nothing smooths the waves in sheets without loss, whose boundaries are between two steps.

    Parameters
    ----------
    rig, cancelled
        As for `throw.simulate`.
    latest : float
        Longest wait for the first release. [s]

    """
    if not rig.layer.parts or rig.layer.loss_tangent > 0.0:
        return None

    def throw(cells: int) -> tuple[float, ...]:
        stepper = CellStepper(rig, cells=cells, field_points=2)
        event = stepper.advance_to_release(latest=latest, step=latest / 256, cancelled=cancelled)
        return (math.nan,) * 2 if event is None else (event.time, event.velocity)

    return _halve_steps(throw)[0]


def _choose_cells(scales: Scales, layer: Layer) -> NDArray[np.int64]:
    """Choose the numbers of cells of the layers in `throw_batch`."""
    finer = _NEO_HOOKEAN_CELLS if layer.stress_strain_law == 'neo_hookean' else 1.0
    counts = np.full(scales.mass_ratio.shape, int(finer * _CELLS))
    needed = finer * np.maximum(
        _CELLS_PER_RELAXATION / scales.mass_ratio, _STEPS_PER_PERIOD / scales.speed_ratio
    )
    while (too_few := (counts < needed) & (counts < _MAX_BATCH_CELLS)).any():
        counts[too_few] *= 2
    return counts


class CellStepper(Stepper):
    """
    A throw by cells; the layer may be a stack, and have loss.

    `stored_energy` is that of now, at any time.

    Parameters
    ----------
    rig, is_measured, field_points
        As for `throw.make_stepper`.
    cells : int, optional
        Number of cells of the layer, from 1 to `MAX_CELLS`; the default is `cells_per_layer`.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, or an argument is out of range.

    Examples
    --------
    A layer with internal loss:

    >>> from soft_throw_ros.core.rig import Layer
    >>> stepper = CellStepper(Rig(layer=Layer(loss_tangent=0.05)))
    >>> stepper.advance_to(0.010)
    1
    >>> [release] = stepper.events()
    >>> f'{release.kind} after {1e3 * release.time:.3f} ms with {release.velocity:.3f} m/s'
    'release after 7.336 ms with 1.301 m/s'

    """

    _kernels = advance_compiled, read_layer_compiled

    def __init__(
        self,
        rig: Rig,
        *,
        is_measured: bool = False,
        cells: int | None = None,
        field_points: int = 64,
    ) -> None:
        super().__init__(rig, field_points)
        if cells is None:
            cells = cells_per_layer(rig)
        require_count('cells', cells, low=1, high=MAX_CELLS)
        grid = make_grid(rig, cells=cells)
        self.cells = int(grid.counts.sum())
        self.step = grid.step
        self._layer = np.zeros((ROWS, self.cells + 2))
        self._reading = (grid.points(field_points),)
        self._make_records(RECORD, is_measured=is_measured)
        prepare(
            self._core, self._layer, grid.bodies, grid.step, rig.projectile.mass, rig.gravity,
            rig.engine.angular_frequency, rig.engine.speed_scale * rig.layer.impedance,
        )
        self._bind()
        self.reset()

    def _clear(self) -> None:
        reset(self._core, self._layer)

    @property
    def horizon(self) -> float:
        """Last step at which the plate is known, until which `advance_to` can go [s]."""
        known = float(self._core['horizon'][0])
        if math.isinf(known):
            return known
        steps = int(known / self.step)
        while steps * self.step > known:
            steps -= 1
        return steps * self.step

    @property
    def cost(self) -> float:
        """Time of a processor over time of the rig, about [-]."""
        return float(UPDATE_COST * self._layer.shape[1] / self.step)

    @property
    def loads(self) -> Loads:
        """Largest loads up to the first release, or up to now before the release."""
        now = self._core[1]
        plate, contact = now['edge_strains'].tolist()
        inside = float(self._layer[ROW.peak_strain].max())
        acceleration, force = float(now['acceleration']), float(now['plate_force'])
        return Loads(max(inside, plate, contact), plate, contact, acceleration, force)

    @property
    def plate_work(self) -> float:
        """Work of the plate up to the first release, or up to now before the release [J]."""
        return float(self._core[1]['work'])

    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, at the present time [J]."""
        return float(stored_energy(self._core, self._layer))


def warm_up() -> None:
    """Compile or load all kernels."""
    load_kernels(CellStepper(Rig(), is_measured=True, field_points=2))
    values = {name: np.array([value]) for name, value in values_of(Rig()).items()}
    throw_batch(values, Layer(), cells=8)
