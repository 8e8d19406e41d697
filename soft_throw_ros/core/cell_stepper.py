# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Throws by cells of finite size: layers with loss, large strain or several sheets.

Each sheet is cut into cells that its fastest wave crosses in one time step, or a little more,
which is the longest step that is stable. At one step exactly, as in a linear layer of one
material, the scheme has no dispersion. Sheets begin and end with a node; a sheet that is too thin
or too stiff for one cell and an explicit step gets one that is implicit. `cell_kernels` has the
scheme and its order.
"""

from __future__ import annotations

from collections.abc import Mapping
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.batch import Cancelled
from soft_throw_ros.core.cell_kernels import (
    advance_compiled,
    BODY,
    POINT,
    prepare,
    read_layer_compiled,
    RECORD,
    ROUNDING,
    ROWS,
    stored_energy,
)
from soft_throw_ros.core.material import LARGEST_STRAIN, relaxation
from soft_throw_ros.core.rig import Layer, Rig, Scales, scales_of, section_of, values_of
from soft_throw_ros.core.stepper import (
    follow_batch,
    load_kernels,
    require_count,
    require_feasible,
    Stepper,
)

Floats = NDArray[np.float64]

MAX_CELLS = 4096
"""Most cells of a layer."""

MAX_UPDATE_RATE = 6e7
"""Most cells times steps in a second of rig time; a processor takes 3e8 and more. [1/s]"""

_UPDATE_COST = 4e-9
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


_SHOCK_SPEED = 1.055
"""Stable step without artificial viscosity over the stable step with artificial viscosity. [-]"""


def reading_points(bodies: NDArray[np.void], count: int) -> NDArray[np.void]:
    """Return a `POINT` for each of some even heights from plate to top of a cut layer."""
    counts = bodies['count']
    sheets = np.repeat(np.arange(counts.size), counts)
    lengths = (bodies['thickness'] / counts)[sheets]
    bounds = np.append(0.0, np.cumsum(lengths))
    heights = np.linspace(0.0, bounds[-1], count)
    cell = np.minimum(np.searchsorted(bounds, heights, side='right'), sheets.size) - 1
    fraction = (heights - bounds[cell]) / lengths[cell]
    # The nearer neighbour, or at the end of a sheet the other one, which extrapolates
    nearer = np.where(fraction > 0.5, 1, -1)
    sheets_around = np.pad(sheets, 1, constant_values=-1)
    neighbour = cell
    for other in (cell - nearer, cell + nearer):
        neighbour = np.where(sheets_around[other + 1] == sheets[cell], other, neighbour)
    points = np.empty(count, POINT)
    points['cell'], points['neighbour'] = cell, neighbour
    points['weight'], points['fraction'] = (fraction - 0.5) * (neighbour - cell), fraction
    return points


def make_bodies(values: Mapping[str, Floats], layer: Layer) -> tuple[NDArray[np.void], Floats]:
    """
    Make the sheets of layers, and the crossing times of their fastest waves.

    The arrays `values` of shape (n,) are as of `rig.values_of`; the sheets of `layer` have the
    proportions of all layers. The results have the shape (n, sheets): `BODY` without numbers of
    cells, and times [s].
    """
    shares = np.array([
        (
            sheet.thickness / layer.thickness, sheet.mass / layer.mass,
            sheet.crossing_time / layer.crossing_time,
            sheet.loss_tangent / layer.loss_tangent if layer.loss_tangent else 1.0,
        )
        for sheet in layer.sheets
    ]).T
    scales, thickness = scales_of(values), values['thickness']
    mass = values['density'] * section_of(values['diameter']) * thickness
    wholes = np.stack([thickness, mass, scales.crossing_time, values['loss_tangent']])
    bodies = np.zeros((thickness.size, len(layer.sheets)), BODY)
    bodies['thickness'], bodies['mass'], crossing, losses = wholes[:, :, None] * shares[:, None]
    bodies['stiffness'] = bodies['mass'] / crossing**2
    bodies['relaxed'] = 1.0
    if layer.stress_strain_law == 'neo_hookean':
        bodies['max_compression'] = LARGEST_STRAIN
    if layer.loss == 'constant':
        for body, loss in zip(bodies.ravel(), losses.ravel().tolist(), strict=True):
            body['relaxed'], body['maxwell'] = relaxation(loss)
    else:
        bodies['lag'] = losses / scales.angular_frequency[:, None]
    bound = bodies['max_compression']
    bodies['tangent'] = bodies['relaxed'] * (1.0 + 2.0 / (1.0 - bound) ** 3) / 3.0
    bodies['tangent'] += bodies['maxwell'].sum(axis=-1)
    fastest = np.sqrt(bodies['tangent']) * np.where(bound > 0.0, _SHOCK_SPEED, 1.0)
    return bodies, crossing / fastest


def _make_sheets(rig: Rig) -> tuple[NDArray[np.void], Floats]:
    """Return a `BODY` for each sheet, and the crossing times of its fastest wave [s]."""
    values = {name: np.array([value]) for name, value in values_of(rig).items()}
    bodies, crossings = make_bodies(values, rig.layer)
    return bodies[0], crossings[0]


def count_cells(crossings: Floats, step: Floats | float) -> NDArray[np.int64]:
    """Count the cells of sheets that their fastest wave crosses in a step or a little more."""
    return np.maximum(1, (crossings / step * (1.0 + ROUNDING)).astype(np.int64))


def cut_layer(rig: Rig, *, cells: int) -> tuple[float, NDArray[np.void]]:
    """
    Cut the layer of a rig into about so many cells, at least 1 per sheet.

    Returns the time step [s], and a `BODY` for each sheet from the plate up.
    """
    bodies, crossings = _make_sheets(rig)
    step = float(crossings.sum()) / cells
    bodies['count'] = count_cells(crossings, step)
    return step, bodies


def cells_per_layer(rig: Rig) -> int:
    r"""
    Choose the number of cells of the layer in real time.

    It is at least 64, with 12 per relaxation time and 120 steps in a period of the plate, for
    errors of 1e-4, or as many as there is time for. ValueError, with a feasible value, if
    `MAX_CELLS` or `MAX_UPDATE_RATE` are too few for 64 cells, 4 per relaxation time and 80 steps
    in a period.

    Examples
    --------
    >>> cells_per_layer(Rig())
    64

    """
    rate = 1.0 / float(_make_sheets(rig)[1].sum())  # of updates, over the square of the cells
    updates = _CELLS**2 * rate
    require_feasible(rig, 'layer.thickness', updates, MAX_UPDATE_RATE, 'cell updates per second')
    limit = min(MAX_CELLS, math.floor(math.sqrt(MAX_UPDATE_RATE / rate)))
    for_mass = math.ceil(_MIN_CELLS_PER_RELAXATION / rig.mass_ratio)
    require_feasible(rig, 'projectile.mass', for_mass, limit, 'cells')
    for_plate = math.ceil(_MIN_STEPS_PER_PERIOD / rig.speed_ratio)
    require_feasible(rig, 'engine.frequency', for_plate, limit, 'cells')
    needed = max(_CELLS_PER_RELAXATION / rig.mass_ratio, _STEPS_PER_PERIOD / rig.speed_ratio)
    return min(max(_CELLS, math.ceil(min(needed, MAX_CELLS))), limit)


def throw_batch(
    values: Mapping[str, Floats],
    layer: Layer,
    *,
    cells: int | None = None,
    cancelled: Cancelled | None = None,
) -> Floats:
    """
    Compute first releases and loads for `throw.throw_many`, unchecked but for `cells`.

    The arrays `values` of shape (n,) are as of `rig.values_of`; the sheets of `layer` have the
    proportions of all layers. The number of cells, 8 to `MAX_CELLS`, is chosen for each throw by
    default, at least 64, for errors of 1e-4. Errors are of second order, but of first order in
    shocks. The result is that of `stepper.follow_batch`.
    """
    if cells is not None:
        require_count('cells', cells, low=8, high=MAX_CELLS)
    scales = scales_of(values)
    bodies, crossings = make_bodies(values, layer)
    steps = crossings.sum(axis=1) / (_choose_cells(scales, layer) if cells is None else cells)
    bodies['count'] = count_cells(crossings, steps[:, None])
    omega = scales.angular_frequency
    peak_force = values['amplitude'] * omega * scales.impedance
    columns = steps, values['mass'], values['gravity'], omega, peak_force

    def prepare_throw(core: NDArray[np.void], n: int) -> tuple[Floats, float]:
        nodes = np.zeros((ROWS, bodies['count'][n].sum() + 2))
        prepare(core, nodes, bodies[n], *(column[n] for column in columns))
        return nodes, _UPDATE_COST * nodes.shape[1] / steps[n]

    return follow_batch(
        RECORD, advance_compiled(), prepare_throw, values, scales.longest_wait, cancelled
    )


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

    def __init__(
        self,
        rig: Rig,
        *,
        is_measured: bool = False,
        cells: int | None = None,
        field_points: int = 64,
    ) -> None:
        cells = cells_per_layer(rig) if cells is None else cells
        require_count('cells', cells, low=1, high=MAX_CELLS)
        self.step, bodies = cut_layer(rig, cells=cells)
        self.cells = int(bodies['count'].sum())
        self.cost = _UPDATE_COST * (self.cells + 2) / self.step
        super().__init__(
            rig, RECORD, np.zeros((ROWS, self.cells + 2)),
            is_measured=is_measured, field_points=field_points,
        )
        self._reading = (reading_points(bodies, field_points),)
        prepare(
            self._core, self._layer, bodies, self.step, rig.projectile.mass, rig.gravity,
            rig.engine.angular_frequency, rig.engine.speed_scale * rig.layer.impedance,
        )
        self._start(advance_compiled(), read_layer_compiled())

    @property
    def horizon(self) -> float:
        """Last step at which the plate is known, until which `advance_to` can go [s]."""
        known = super().horizon
        if math.isinf(known):
            return known
        steps = int(known / self.step)
        while steps * self.step > known:
            steps -= 1
        return steps * self.step

    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, at the present time [J]."""
        return float(stored_energy(self._core, self._layer))


def warm_up() -> None:
    """Compile or load all kernels."""
    load_kernels(CellStepper(Rig(), is_measured=True, field_points=2))
    values = {name: np.array([value]) for name, value in values_of(Rig()).items()}
    throw_batch(values, Layer(), cells=8)
