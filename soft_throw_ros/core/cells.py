# SPDX-License-Identifier: Apache-2.0
r"""
Masses, springs and dashpots in a row: how a rig is cut into cells, and how they are solved.

Notes
-----
Nodes are numbered from the plate up, and link j is between nodes j and j + 1: a cell, which is a
spring beside a dashpot with half of its mass on each of its nodes; or the joint, which is the
contact: while it lasts its two nodes move as one.

Each sheet is cut into cells that a wave crosses in one time step, or a little more, which is the
longest step that is stable. At one step exactly, as in a layer of one material, the scheme has no
dispersion. Sheets begin and end with a node; a sheet or projectile that is too thin or too stiff
for one cell (two, of a projectile) and an explicit step gets one that is implicit.

What is implicit couples neighbouring accelerations: with c of each link, the matrix
:math:`M + \sum c\, (1, -1)^T (1, -1)`. It is tridiagonal and constant, so its factors are computed
once. A node is eliminated towards its neighbour; both directions are used, because each is a chain
of operations that wait for each other: the nodes are divided by a separator into two parts, each
of which is eliminated from both its ends, so that four chains go side by side.

"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import inlined, kernel, part
from soft_throw_ros.core.rig import Rig

Floats = NDArray[np.float64]

MAX_PROJECTILE_CELLS = 1 << 15
"""Most cells of an elastic projectile."""

# Rows of the table of nodes and links. Those named twice are for flight and for contact.
(
    DISPLACEMENT,
    VELOCITY,  # half a step earlier
    MEAN_VELOCITY,  # of that and half a step later; at even steps, and at odd ones
    _MEAN_VELOCITY_ODD,
    STRESS,  # elastic tension of a link; at even steps, and at odd ones
    _STRESS_ODD,
    MASS,
    STIFFNESS,
    VISCOSITY,
    _VISCOSITY_IN_CONTACT,
    COUPLING,  # what a link adds to the matrix of masses
    _COUPLING_IN_CONTACT,
    SHARE,  # of a node's momentum that its neighbour gets as it is eliminated, by link
    _SHARE_IN_CONTACT,
    GAIN,  # velocity over what is left of the momentum
    _GAIN_IN_CONTACT,
    MOMENTUM,  # what a node starts from: over its velocity, and over the force on it; of a node
    _MOMENTUM_IN_CONTACT,  # that is coupled to none the velocity itself
    IMPULSE,
    _IMPULSE_IN_CONTACT,
    RESPONSE,  # velocity over that of the separator
    _RESPONSE_IN_CONTACT,
    INVERSE,  # one over the height of a cell of the layer, 0 for other links
    REST,  # height of the layer's nodes at rest
    BURDEN,  # what a cell of the layer carries at rest, ...
    STATIC,  # and its compression
    LARGEST,  # magnitude of its strain
    STIFF,  # what makes a cell that is too fast for the step stable, in the matrix of masses
    POSITION,  # at the time asked for: displacement and velocity of nodes, force through cells
    SPEED,
    FORCE,
    ROWS,
) = range(32)

SOLVER = [
    ('systems', 'i8', (2, 4)),  # what follows, in flight and in contact
    ('known', 'i8'),  # highest node whose motion is given
    ('first', 'i8'),  # of the nodes that are coupled
    ('end', 'i8'),
    ('quarter', 'i8'),  # length of the four chains, 0 for one chain from the top down
    ('first_stiff', 'i8'),  # link that is too fast for the step
    ('last_stiff', 'i8'),
]
"""Fields of a record for `solve`."""

_AVERAGE_ACCELERATION = 0.25  # Newmark's parameter, for cells that are too fast for the step
_FEWEST_PROJECTILE_CELLS = 2
_ROUNDING = 1e-9
_SHORTEST = 16  # row of coupled nodes that is worth four chains


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """A rig cut into cells."""

    step: float  # of time [s]
    heights: Floats  # of the layer's nodes, unloaded [m]
    sheets: NDArray[np.int64]  # to which each cell of the layer belongs
    bottom: int  # the layer's lowest node: 0, which is the plate, or 1 if it is not glued on
    joint: int  # the link that is the contact
    face_mass: float  # of the projectile's lowest node, without a layer glued to it [kg]
    nodes: Floats  # the table, with mass, stiffness, viscosity and height filled in

    @property
    def count(self) -> int:
        """Cells of the layer."""
        return self.heights.size - 1

    def place(self, height: float) -> tuple[int, int, float, float]:
        """
        Find what to interpolate from at a height, or to extrapolate from at the end of a sheet.

        That is the cell at this height and one beside it of the same sheet, the weight of the
        latter for what is known in the middle of cells (0 if there is none), and which part of the
        cell is below.
        """
        cell = int(np.searchsorted(self.heights, height, side='right')) - 1
        cell = min(cell, self.count - 1)
        low, high = self.heights[cell : cell + 2]
        part = float((height - low) / (high - low))
        ahead = 1 if part > 0.5 else -1
        for beside in (cell + ahead, cell - ahead):
            if 0 <= beside < self.count and self.sheets[beside] == self.sheets[cell]:
                return cell, beside, (part - 0.5) * (beside - cell), part
        return cell, cell, 0.0, part


def cut(
    rig: Rig, *, cells: int, is_elastic: bool = False, is_on_projectile: bool = False
) -> Cells:
    """
    Cut a rig into about so many cells of the layer; sheets get whole numbers, and at least one.

    Raises
    ------
    ValueError
        If an elastic projectile takes more than `MAX_PROJECTILE_CELLS`; with the number.

    """
    layer, projectile = rig.layer, rig.projectile
    step = layer.crossing_time / cells
    counts = [
        max(1, int(sheet.crossing_time / step * (1.0 + _ROUNDING))) for sheet in layer.sheets
    ]
    count = sum(counts)
    bar = _projectile_cells(rig, step) if is_elastic else 0
    nodes = np.zeros((ROWS, count + bar + 2))
    bottom = 1 if is_on_projectile else 0
    first = bottom
    for sheet, own in zip(layer.sheets, counts, strict=True):
        lag = sheet.loss_tangent / rig.engine.angular_frequency
        add_cells(nodes, first, own, sheet.mass, sheet.stiffness, lag, step)
        nodes[INVERSE, first : first + own] = own / sheet.thickness
        first += own
    face = count + 1
    if bar:
        spring = projectile.youngs_modulus * layer.section / projectile.length
        add_cells(nodes, face, bar, projectile.mass, spring, 0.0, step)
    else:
        nodes[MASS, face] += projectile.mass
    return Cells(
        step=step,
        heights=np.append(0.0, np.cumsum(1.0 / nodes[INVERSE, bottom : bottom + count])),
        sheets=np.repeat(np.arange(len(counts)), counts),
        bottom=bottom,
        joint=0 if is_on_projectile else count,
        face_mass=0.5 * projectile.mass / bar if bar else projectile.mass,
        nodes=nodes,
    )


def cut_massless(rig: Rig, *, step: float) -> Cells:
    """Make one cell without mass, a spring and a dashpot (App. A)."""
    layer, mass = rig.layer, rig.projectile.mass
    nodes = np.zeros((ROWS, 3))
    nodes[MASS, 2] = mass
    nodes[STIFFNESS, 0] = layer.stiffness
    nodes[VISCOSITY, 0] = layer.stiffness * layer.loss_tangent / rig.engine.angular_frequency
    nodes[INVERSE, 0] = 1.0 / layer.thickness
    return Cells(
        step=step,
        heights=np.array([0.0, layer.thickness]),
        sheets=np.zeros(1, np.int64),
        bottom=0,
        joint=1,
        face_mass=mass,
        nodes=nodes,
    )


def _projectile_cells(rig: Rig, step: float) -> int:
    """Count the cells of an elastic projectile, or refuse too many."""
    wanted = rig.crossing_ratio * rig.crossing_time / step * (1.0 + _ROUNDING)
    if wanted > MAX_PROJECTILE_CELLS:
        modulus = rig.projectile.youngs_modulus
        stiffer = modulus * (wanted / MAX_PROJECTILE_CELLS) ** 2
        raise ValueError(
            f'projectile.youngs_modulus {modulus:g} Pa takes {wanted:.0f} cells, the limit is '
            f'{MAX_PROJECTILE_CELLS}; feasible: {1.001 * stiffer:.4g} Pa or more'
        )
    return max(_FEWEST_PROJECTILE_CELLS, int(wanted))


@kernel
def add_cells(
    nodes: Floats,
    first: int,
    count: int,
    mass: float,
    stiffness: float,
    lag: float,
    step: float,
) -> None:
    """Put a body above a node, cut into cells; its loss is viscosity over stiffness. [s]"""
    cell, spring = mass / count, stiffness * count
    is_stiff = math.sqrt(cell / spring) * (1.0 + _ROUNDING) < step
    for j in range(first, first + count):
        nodes[MASS, j] += 0.5 * cell
        nodes[MASS, j + 1] += 0.5 * cell
        nodes[STIFFNESS, j] = spring
        nodes[VISCOSITY, j] = lag * spring
        nodes[STIFF, j] = _AVERAGE_ACCELERATION * step * step * spring if is_stiff else 0.0


@part
def factorise(s: Any, nodes: Floats, step: float, joint: int, known: int, case: int) -> None:
    """Compute the factors of the matrix in flight (0) or in contact (1), see `solve`."""
    rigid = joint if case == 1 else -1
    last = nodes.shape[1] - 1
    mass, coupling = nodes[MASS], nodes[COUPLING + case]
    gain, response = nodes[GAIN + case], nodes[RESPONSE + case]
    low, high = last, -1
    s.first_stiff, s.last_stiff = last, -1
    for j in range(last):
        if nodes[STIFF, j] > 0.0:
            s.first_stiff, s.last_stiff = min(s.first_stiff, j), j
        coupling[j] = nodes[STIFF, j] + 0.5 * step * nodes[VISCOSITY + case, j]
        if coupling[j] > 0.0 or j == rigid:
            low, high = min(low, j), max(high, j)
    first = known + 1 if low <= known else low
    end = high + 1
    if end < first:  # nothing is coupled
        first, end = last + 1, last
    for j in range(1, last + 1):
        is_coupled = first <= j <= end
        nodes[MOMENTUM + case, j] = mass[j] if is_coupled else 1.0
        nodes[IMPULSE + case, j] = 0.5 * step
        if not is_coupled:
            nodes[IMPULSE + case, j] = 0.5 * step / mass[j] if mass[j] > 0.0 else 0.0
    count = end - first + 1
    quarter = (count - 3) // 4 if count >= _SHORTEST else 0
    separator = first + 2 * quarter + 1
    if separator in (rigid, rigid + 1):  # which must be eliminated itself
        quarter = 0
    system = s.systems[case]
    system[0], system[1], system[2], system[3] = known, first, end, quarter
    if quarter == 0:
        if count > 0:
            _eliminate(nodes, case, first, first, end, rigid)
        return
    below, above = separator - 1, separator + 1
    _eliminate(nodes, case, first, first + quarter, below, rigid)
    _eliminate(nodes, case, above, above + quarter, end, rigid)
    # The separator's own equation, after what its acceleration does to both parts
    for j in range(last + 1):
        response[j] = 0.0
    response[below], response[above] = coupling[below], coupling[separator]
    _substitute(nodes, RESPONSE + case, case, first, end, quarter)
    pivot = mass[separator] + coupling[below] * (1.0 - response[below])
    gain[separator] = 1.0 / (pivot + coupling[separator] * (1.0 - response[above]))
    response[separator] = 1.0


@part
def _eliminate(nodes, case, first, merge, end, rigid):
    """Eliminate nodes from both ends towards one that they merge in."""
    mass, coupling = nodes[MASS], nodes[COUPLING + case]
    share, gain = nodes[SHARE + case], nodes[GAIN + case]
    total = mass[merge]
    for side in range(2):
        j, way = (first, 1) if side == 0 else (end, -1)
        added = coupling[first - 1] if side == 0 else coupling[end]
        while j != merge:
            link = j if side == 0 else j - 1
            pivot = mass[j] + added
            if link == rigid:
                share[link], gain[j], added = 1.0, 0.0, pivot
            else:
                gain[j] = 1.0 / (pivot + coupling[link])
                share[link] = coupling[link] * gain[j]
                added = share[link] * pivot
            j += way
        total += added
    gain[merge] = 1.0 / total


@inlined
def _substitute(nodes, x, case, first, end, quarter):
    """Solve the two parts beside the separator for row x, in four chains side by side."""
    # Unsigned, since any other index is looked at whether it counts from the end
    one, first, end, quarter = np.uintp(1), np.uintp(first), np.uintp(end), np.uintp(quarter)
    share, gain = SHARE + case, GAIN + case
    separator = first + quarter + quarter + one
    low, high = first + quarter, separator + one + quarter
    rest = high + quarter
    for j in range(int(end), int(rest), -1):
        nodes[x, j - 1] += nodes[share, j - 1] * nodes[x, j]
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(quarter):
        j, k, m, n = first + i, separator - one - i, separator + one + i, rest - i
        a = nodes[x, j] + nodes[share, j - one] * a
        b = nodes[x, k] + nodes[share, k] * b
        c = nodes[x, m] + nodes[share, m - one] * c
        d = nodes[x, n] + nodes[share, n] * d
        nodes[x, j], nodes[x, k], nodes[x, m], nodes[x, n] = a, b, c, d
    a = nodes[x, low] + nodes[share, low - one] * a + nodes[share, low] * b
    c = nodes[x, high] + nodes[share, high - one] * c + nodes[share, high] * d
    a *= nodes[gain, low]
    c *= nodes[gain, high]
    nodes[x, low], nodes[x, high] = a, c
    b, d = a, c
    for i in range(one, quarter + one):
        j, k, m, n = low - i, low + i, high - i, high + i
        a = nodes[gain, j] * nodes[x, j] + nodes[share, j] * a
        b = nodes[gain, k] * nodes[x, k] + nodes[share, k - one] * b
        c = nodes[gain, m] * nodes[x, m] + nodes[share, m] * c
        d = nodes[gain, n] * nodes[x, n] + nodes[share, n - one] * d
        nodes[x, j], nodes[x, k], nodes[x, m], nodes[x, n] = a, b, c, d
    for j in range(int(rest) + 1, int(end) + 1):
        nodes[x, j] = nodes[gain, j] * nodes[x, j] + nodes[share, j - 1] * nodes[x, j - 1]


@inlined
def solve(s: Any, nodes: Floats, now: int, case: int) -> None:
    """
    Compute the mean velocities w of all nodes but those that are known.

    They solve (M + B + C h / 2) w = (M + B) v + h / 2 times the force of the stresses, with the
    matrix B of stiff cells. Rows are indexed as a table, since views of it would be counted.
    """
    w, stress, momentum, impulse = (
        MEAN_VELOCITY + now,
        STRESS + now,
        MOMENTUM + case,
        IMPULSE + case,
    )
    known, first, end, quarter = s.known, s.first, s.end, s.quarter
    given = nodes[w, known]
    for j in range(1, nodes.shape[1]):
        force = nodes[stress, j] - nodes[stress, j - 1]
        nodes[w, j] = nodes[momentum, j] * nodes[VELOCITY, j] + nodes[impulse, j] * force
    nodes[w, known] = given
    if end < first:
        return
    for j in range(s.first_stiff, s.last_stiff + 1):
        part = nodes[STIFF, j] * (nodes[VELOCITY, j + 1] - nodes[VELOCITY, j])
        nodes[w, j + 1] += part
        if j > known:
            nodes[w, j] -= part
    nodes[w, first] += nodes[COUPLING + case, first - 1] * nodes[w, first - 1]
    if quarter == 0:
        a = 0.0
        for j in range(end, first - 1, -1):
            a = nodes[w, j] + nodes[SHARE + case, j] * a
            nodes[w, j] = a
        a = 0.0
        for j in range(first, end + 1):
            a = nodes[GAIN + case, j] * nodes[w, j] + nodes[SHARE + case, j - 1] * a
            nodes[w, j] = a
        return
    separator = first + 2 * quarter + 1
    load, nodes[w, separator] = nodes[w, separator], 0.0
    _substitute(nodes, w, case, first, end, quarter)
    load += nodes[COUPLING + case, separator - 1] * nodes[w, separator - 1]
    load += nodes[COUPLING + case, separator] * nodes[w, separator + 1]
    load *= nodes[GAIN + case, separator]
    for j in range(1, nodes.shape[1]):
        nodes[w, j] += load * nodes[RESPONSE + case, j]
