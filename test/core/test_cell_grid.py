# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Division of a rig into cells, and the equations of its nodes."""

from dataclasses import replace

import numba as nb
import numpy as np
import pytest
from soft_throw_ros.core import cell_kernels
from soft_throw_ros.core.cell_kernels import RECORD, ROW, ROWS
from soft_throw_ros.core.cell_stepper import cut_layer, reading_points
from soft_throw_ros.core.rig import Layer, Rig

STACK = Layer.of_sheets(
    (
        Layer(thickness=6e-3, wave_speed=7.8),
        Layer(thickness=5e-5, wave_speed=100.0, density=7800.0),
        Layer(thickness=9e-3, wave_speed=20.0, loss_tangent=0.2),
    )
)
GEL = {'stress_strain_law': 'neo_hookean', 'loss': 'constant'}
GELS = Layer.of_sheets(tuple(replace(sheet, **GEL) for sheet in STACK.sheets))
LAYERS = pytest.mark.parametrize(
    'layer', [Layer(), Layer(loss_tangent=0.1), STACK], ids=['lossless', 'lossy', 'stack']
)


@nb.njit
def fill(core, nodes, bodies):
    """Cut bodies into cells."""
    cell_kernels.cut(core[0], nodes, bodies)


class Cut:
    """A rig cut into cells."""

    def __init__(self, rig, *, cells):
        self.step, self.bodies = cut_layer(rig, cells=cells)
        counts = self.bodies['count']
        self.count = int(counts.sum())
        self.core = np.zeros(1, RECORD)
        self.core['step'], self.core['cells'] = self.step, self.count
        self.core['mass'] = rig.projectile.mass
        self.nodes = np.zeros((ROWS, self.count + 2))
        fill(self.core, self.nodes, self.bodies)
        self.sheets = np.repeat(np.arange(counts.size), counts)
        inverse = self.nodes[ROW.inverse_length, : self.count]
        self.heights = np.append(0.0, np.cumsum(1.0 / inverse))


def couple(links):
    """Return the matrix of links between neighbouring nodes."""
    n = links.size + 1
    matrix = np.zeros((n, n))
    for j, link in enumerate(links):
        matrix[j:j + 2, j:j + 2] += link * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return matrix


@nb.njit
def solve(core, nodes, case):
    """Compute mean velocities at an even step."""
    s = core[0]
    cell_kernels.factorise(s, nodes, case)
    s.contact = case == 1
    cell_kernels.solve(s, nodes)


@LAYERS
@pytest.mark.parametrize('count', [1, 5, 64, 65])
@pytest.mark.parametrize('in_contact', [False, True])
def test_velocities_solve_the_equations_of_motion(layer, count, in_contact):
    grid = Cut(Rig(layer=layer), cells=count)
    nodes, link, case = grid.nodes, grid.count, int(in_contact)
    n = nodes.shape[1]
    random = np.random.default_rng(count)
    nodes[ROW.velocity] = random.normal(size=n)
    nodes[ROW.tension, :-1] = random.normal(size=n - 1)
    nodes[ROW.mean_velocity, 0] = 0.7
    solve(grid.core, nodes, case)

    half = 0.5 * grid.step
    start = np.diag(nodes[ROW.mass]) + couple(nodes[ROW.implicit_stiffness, :-1])
    matrix = start + couple(half * nodes[ROW.viscosity, :-1])
    force = np.diff(nodes[ROW.tension], prepend=0.0)
    right = start @ nodes[ROW.velocity] + half * force
    merge = np.eye(n)  # the two nodes of a contact are merged
    if in_contact:
        merge = np.delete(merge, link + 1, axis=1)
        merge[link + 1, link] = 1.0
    matrix, right = merge.T @ matrix @ merge, merge.T @ right
    matrix[0], right[0] = 0.0, 0.7
    matrix[0, 0] = 1.0
    expected = merge @ np.linalg.solve(matrix, right)
    assert nodes[ROW.mean_velocity] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    'layer', [Layer(), STACK, GELS, Layer(loss_tangent=0.3, **GEL)],
    ids=['linear', 'stack', 'gels', 'gel'],
)
@pytest.mark.parametrize('count', [1, 7, 60])
def test_step_is_stable(layer, count):
    """The fastest mode must not turn by more than pi in a step: h^2 K <= 4 M."""
    grid = Cut(Rig(layer=layer), cells=count)
    mass = np.diag(grid.nodes[ROW.mass]) + couple(grid.nodes[ROW.implicit_stiffness, :-1])
    springs = grid.nodes[ROW.stiffness] + grid.nodes[ROW.maxwell_stiffness:][:3].sum(axis=0)
    modulus = grid.nodes[ROW.third_modulus]
    least = np.where(modulus > 0.0, grid.nodes[ROW.min_stretch], 1.0)
    springs += modulus * (1.0 + 2.0 / least**3) * grid.nodes[ROW.inverse_length]
    surplus = 4.0 * mass - grid.step**2 * couple(springs[:-1])
    assert np.linalg.eigvalsh(surplus).min() > -1e-6 * mass.max()


def test_sheets_get_whole_cells_and_thin_stiff_ones_an_implicit_one():
    grid = Cut(Rig(layer=STACK), cells=100)
    counts = [np.count_nonzero(grid.sheets == sheet) for sheet in range(3)]
    times = [sheet.crossing_time for sheet in STACK.sheets]
    assert counts == [int(times[0] / grid.step), 1, int(times[2] / grid.step)]
    assert np.flatnonzero(grid.nodes[ROW.implicit_stiffness]).tolist() == [counts[0]]
    assert grid.heights[counts[0]] == pytest.approx(6e-3)
    assert grid.heights[counts[0] + 1] == pytest.approx(6.05e-3)


@LAYERS
def test_linear_functions_are_read_exactly_within_sheets(layer):
    grid = Cut(Rig(layer=layer), cells=40)
    middles = 0.5 * (grid.heights[1:] + grid.heights[:-1])
    values = 3.0 * middles + np.where(grid.sheets == 2, 1.0, 0.0)
    points = reading_points(grid.bodies, 77)
    heights = np.linspace(0.0, layer.thickness, 77).tolist()
    for height, (cell, neighbour, weight, fraction) in zip(heights, points, strict=True):
        assert grid.sheets[cell] == grid.sheets[neighbour]
        below, above = grid.heights[cell:cell + 2]
        assert below + fraction * (above - below) == pytest.approx(height)
        if cell != neighbour:
            jump = 1.0 if grid.sheets[cell] == 2 else 0.0
            read = values[cell] + weight * (values[neighbour] - values[cell])
            assert read == pytest.approx(3.0 * height + jump)
