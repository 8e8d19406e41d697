# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Throws by cells of finite size: layers with loss, large strain or several sheets.

`cell_grid` cuts a rig into cells, and `cell_kernels` has the scheme and its order.
"""

from __future__ import annotations

from functools import partial
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.batch import (
    broadcast_ratios,
    Cancelled,
    check_cancelled,
    in_threads,
    longest_wait,
)
from soft_throw_ros.core.cell_grid import (
    count_cells,
    crossing_time,
    make_bodies,
    make_grid,
)
from soft_throw_ros.core.cell_kernels import (
    advance_compiled,
    prepare,
    prepare_ratios,
    read_layer_compiled,
    RECORD,
    reset,
    ROW,
    ROWS,
    stored_energy,
)
from soft_throw_ros.core.plate import peak_velocity_ratios
from soft_throw_ros.core.plate_kernels import BLOCK
from soft_throw_ros.core.rig import Layer, Ratios, Rig
from soft_throw_ros.core.stepper import (
    load_kernels,
    Loads,
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

_MAX_BATCH_CELLS = 1024
"""Most cells that `throw_batch` chooses. [-]"""

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
        raise ValueError(
            f'projectile.mass {rig.projectile.mass:g} kg on a layer of {layer.mass:.4g} kg needs '
            f'{for_mass} cells, the limit is {limit}; '
            f'feasible: projectile.mass of {1.001 * min_mass:.4g} kg or more'
        )
    require_steps_per_period(rig, _MIN_STEPS_PER_PERIOD, limit=limit, unit='cells')
    periods = rig.crossing_time * rig.engine.frequency
    needed = max(_CELLS_PER_RELAXATION / rig.mass_ratio, _STEPS_PER_PERIOD * periods)
    return min(max(_CELLS, math.ceil(min(needed, MAX_CELLS))), limit)


def throw_batch(
    ratios: Ratios,
    layer: Layer,
    *,
    cells: int | None = None,
    threads: int | None = None,
    cancelled: Cancelled | None = None,
) -> Floats:
    r"""
    Compute first releases and loads for `throws.throw_many`.

    Parameters
    ----------
    ratios : Ratios
        Ratios of the throws.
    layer : Layer
        Layer whose sheets have the proportions of all layers.
    cells : int, optional
        Number of cells of the layer, from 8 to `MAX_CELLS`; by default chosen for each throw, at
        least 64, for errors of 1e-4. Errors are of second order, but of first order in shocks.
    threads, cancelled
        As for `throws.throw_many`.

    Returns
    -------
    ndarray, shape (7, n)
        Rows of `throws.Throws`, divided by `throws.units_of`; NaN without a release by
        `batch.longest_wait`.

    Raises
    ------
    ValueError
        If a ratio or `cells` is out of range.

    """
    if cells is not None:
        require_count('cells', cells, low=8, high=MAX_CELLS)
    rows, _ = broadcast_ratios(**ratios._asdict())
    ratios = Ratios(*rows)
    mu, kappa = ratios.mass_ratio, ratios.speed_ratio
    results = np.full((7, mu.size), math.nan)
    bodies, crossings = make_bodies(ratios, layer)
    steps = crossings.sum(axis=1) / (_choose_cells(ratios) if cells is None else cells)
    bodies['count'] = count_cells(crossings, steps[:, None])
    latest, peak_speed = longest_wait(mu, kappa), peak_velocity_ratios(ratios.damping_ratio)

    def run(first: int, stride: int) -> None:
        core, path, no_events = np.zeros(3, RECORD), np.empty((2, BLOCK)), np.empty((0, 4))
        numbers = core.view(np.float64).reshape(3, -1)
        advance = advance_compiled()
        for n in range(first, mu.size, stride):
            nodes = np.zeros((ROWS, bodies[n]['count'].sum() + 2))
            numbers[:] = 0.0
            ratios_of_throw = tuple(rows[:4, n].tolist())
            prepare_ratios(core, nodes, path, bodies[n], ratios_of_throw, steps[n])
            numbers[:2] = numbers[2]
            reset(core, nodes)
            grid = core[0]
            updates = nodes.shape[1] * latest[n] / steps[n]
            for time in np.linspace(0.0, latest[n], 2 + int(UPDATE_COST * updates / _SLICE))[1:]:
                check_cancelled(cancelled)
                if advance(core, nodes, path, no_events, time):
                    break
            if grid['events']:
                omega = 2.0 * math.pi / kappa[n]
                strain = max(grid['edge_strains'].max(), nodes[ROW.peak_strain].max())
                if ratios.strain_ratio[n] > 0.0:
                    strain *= omega / ratios.strain_ratio[n]
                speed = grid['event_velocity'] / omega
                results[:, n] = (
                    grid['event_time'] / kappa[n], speed, (speed / peak_speed[n]) ** 2,
                    strain / omega, grid['acceleration'] / omega**2,
                    grid['plate_force'] / omega, grid['work'] / (mu[n] * omega**2),
                )

    in_threads(run, count=mu.size, per_thread=_THROWS_PER_THREAD, threads=threads)
    return results


def _choose_cells(ratios: Ratios) -> NDArray[np.int64]:
    """Choose the numbers of cells of the layers in `throw_batch`."""
    mu, kappa = ratios.mass_ratio, ratios.speed_ratio
    finer = np.where(ratios.strain_ratio > 0.0, _NEO_HOOKEAN_CELLS, 1.0)
    counts = (finer * _CELLS).astype(np.int64)
    needed = finer * np.maximum(_CELLS_PER_RELAXATION / mu, _STEPS_PER_PERIOD / kappa)
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

    _changing = ('_nodes',)

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
        self._nodes = np.zeros((ROWS, self.cells + 2))
        self._points = grid.points(field_points)
        self._make_records(RECORD, grid.step, is_measured=is_measured)
        prepare(
            self._core, self._nodes, grid.bodies, grid.step, rig.projectile.mass, rig.gravity,
            rig.engine.angular_frequency, rig.engine.speed_scale * rig.layer.impedance,
        )
        self._bind()
        self.reset()

    def _bind(self) -> None:
        arrays = (self._core, self._nodes)
        self._advance = partial(advance_compiled(), *arrays, self._path, self._events)
        self._read_layer = partial(read_layer_compiled(), *arrays, self._points)

    def _clear(self) -> None:
        reset(self._core, self._nodes)

    def _copy_layer(self, origin: Stepper) -> None:
        assert isinstance(origin, CellStepper)
        self._nodes[:] = origin._nodes

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
        return float(UPDATE_COST * self._nodes.shape[1] / self.step)

    @property
    def loads(self) -> Loads:
        """Largest loads up to the first release, or up to now before the release."""
        now = self._core[1]
        plate, contact = now['edge_strains'].tolist()
        inside = float(self._nodes[ROW.peak_strain].max())
        acceleration, force = float(now['acceleration']), float(now['plate_force'])
        return Loads(max(inside, plate, contact), plate, contact, acceleration, force)

    @property
    def plate_work(self) -> float:
        """Work of the plate up to the first release, or up to now before the release [J]."""
        return float(self._core[1]['work'])

    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, at the present time [J]."""
        return float(stored_energy(self._core, self._nodes))


def warm_up() -> None:
    """Compile or load all kernels."""
    load_kernels(CellStepper(Rig(), is_measured=True, field_points=2))
    throw_batch(Ratios(mass_ratio=1.0, speed_ratio=8.0), Layer(), cells=8)
