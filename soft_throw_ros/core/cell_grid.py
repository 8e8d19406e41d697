# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A rig cut into cells.

Each sheet is cut into cells that its fastest wave crosses in one time step, or a little more,
which is the longest step that is stable. At one step exactly, as in a linear layer of one
material, the scheme has no dispersion. Sheets begin and end with a node; a sheet that is too thin
or too stiff for one cell and an explicit step gets one that is implicit.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.material import LARGEST_STRAIN, relaxation
from soft_throw_ros.core.rig import Layer, Rig, scales_of, section_of, values_of

Floats = NDArray[np.float64]

BODY = np.dtype(
    [
        ('count', 'i8'),  # number of cells
        ('thickness', 'f8'),  # [m]
        ('mass', 'f8'),  # [kg]
        ('stiffness', 'f8'),  # at the plate's frequency [N/m]
        ('lag', 'f8'),  # viscosity over stiffness [s]
        ('max_compression', 'f8'),  # of a neo-Hookean body, 0 for a linear one [-]
        ('relaxed', 'f8'),  # share of the spring in the stiffness [-]
        ('maxwell', 'f8', (3,)),  # shares of the Maxwell elements in the stiffness [-]
    ]
)
"""A sheet, to be cut into cells of one kind."""

POINT = np.dtype(
    [
        ('cell', 'i8'),  # at the height
        ('neighbour', 'i8'),  # of this cell in its sheet, or the cell itself if it has none
        ('weight', 'f8'),  # of the neighbour for quantities in the middle of cells [-]
        ('fraction', 'f8'),  # of the cell below the height [-]
    ]
)
"""A height at which the layer is read."""

ROUNDING = 1e-9
"""Relative rounding error of a crossing time. [-]"""

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


def _fastest_waves(bodies: NDArray[np.void]) -> Floats:
    """Return the largest wave speeds over the speeds of slow and weak waves [-]."""
    bound = bodies['max_compression']
    tangent = bodies['relaxed'] * (1.0 + 2.0 / (1.0 - bound) ** 3) / 3.0
    tangent += bodies['maxwell'].sum(axis=-1)
    return np.asarray(np.sqrt(tangent) * np.where(bound > 0.0, _SHOCK_SPEED, 1.0))


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
    return bodies, crossing / _fastest_waves(bodies)


def _make_sheets(rig: Rig) -> tuple[NDArray[np.void], Floats]:
    """Return a `BODY` for each sheet, and the crossing times of its fastest wave [s]."""
    values = {name: np.array([value]) for name, value in values_of(rig).items()}
    bodies, crossings = make_bodies(values, rig.layer)
    return bodies[0], crossings[0]


def count_cells(crossings: Floats, step: Floats | float) -> NDArray[np.int64]:
    """Count the cells of sheets that their fastest wave crosses in a step or a little more."""
    return np.maximum(1, (crossings / step * (1.0 + ROUNDING)).astype(np.int64))


def crossing_time(rig: Rig) -> float:
    """Return the crossing time of the fastest wave of the layer [s]."""
    return float(_make_sheets(rig)[1].sum())


def cut_layer(rig: Rig, *, cells: int) -> tuple[float, NDArray[np.void]]:
    """
    Cut the layer of a rig into about so many cells, at least 1 per sheet.

    Returns the time step [s], and a `BODY` for each sheet from the plate up.
    """
    bodies, crossings = _make_sheets(rig)
    step = float(crossings.sum()) / cells
    bodies['count'] = count_cells(crossings, step)
    return step, bodies
