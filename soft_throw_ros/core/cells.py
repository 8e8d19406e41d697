# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
r"""
Masses, springs and dashpots in a row: how a rig is cut into cells, and how they are solved.

Notes
-----
Nodes are numbered from the plate up, and link j is between nodes j and j + 1: a cell, which is a
spring beside a dashpot and Maxwell elements (see `material`), with half of its mass on each of its
nodes; or the joint, which is the contact: while it lasts its two nodes move as one.

Each sheet is cut into cells that its fastest wave crosses in one time step, or a little more,
which is the longest step that is stable. At one step exactly, as in a linear layer of one
material, the scheme has no dispersion. Sheets begin and end with a node; a sheet or projectile
that is too thin or too stiff for one cell (two, of a projectile) and an explicit step gets one
that is implicit.

What is implicit couples neighbouring accelerations: with c of each link, the matrix
:math:`M + \sum c\, (1, -1)^T (1, -1)`. It is tridiagonal and constant, so its factors are computed
once. Nodes are eliminated from both ends towards the middle, because each direction is a chain of
operations that wait for each other, and two such chains go side by side.

"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import inlined, part, Record
from soft_throw_ros.core.material import relaxation, strain_bounds
from soft_throw_ros.core.rig import Layer, Rig, Stack

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
    STRETCH,  # of a link a step ago
    MEMORY,  # stretch of the Maxwell elements of a link
    _MEMORY_1,
    _MEMORY_2,
    MASS,
    STIFFNESS,  # of the linear spring
    CURVATURE,  # a third of E S of a neo-Hookean one
    LEAST,  # stretch up to which it is followed
    SPRING,  # of any link, what is in proportion to its stretch,
    OFFSET,  # a constant,
    PULL,  # and what is taken from them, over the square of
    LENGTH,  # the length, with that at rest,
    SHORTEST,  # and that up to which it is followed; 1 for links that are linear
    SHOCK,  # what its artificial viscosity takes from the square of a change of velocity
    STRENGTH,  # of the Maxwell elements
    _STRENGTH_1,
    _STRENGTH_2,
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
) = range(45)

SOLVER = [
    ('systems', 'i8', (2, 4)),  # what follows, in flight and in contact
    ('known', 'i8'),  # highest node whose motion is given
    ('first', 'i8'),  # of the nodes that are coupled
    ('end', 'i8'),
    ('middle', 'i8'),  # in which both chains meet
    ('first_stiff', 'i8'),  # link that is too fast for the step
    ('last_stiff', 'i8'),
]
"""Fields of a record for `solve`."""

BODY = ('count', 'thickness', 'mass', 'stiffness', 'lag', 'bound', 'relaxed', *'012')
"""
What a body is cut from, for `cut`: number of cells; thickness, 0 if its strain does not matter;
mass; stiffness; viscosity over stiffness [s]; the largest compression of a neo-Hookean one, 0 for
a linear one; and its parts of the stiffness: of the spring, and of each Maxwell element.
"""

_AVERAGE_ACCELERATION = 0.25  # Newmark's parameter, for cells that are too fast for the step
_FEWEST_PROJECTILE_CELLS = 2
_ROUNDING = 1e-9
_DAMPED = 1.055  # by which artificial viscosity shortens the step
_SHOCK = 1.0  # of the density: the artificial viscosity


class Grid(NamedTuple):
    """A rig to be cut into cells."""

    step: float
    """Of time. [s]"""
    bodies: Floats
    """A row of `BODY` for each sheet from the plate up, and for an elastic projectile."""
    bars: int
    """Cells of the projectile, 0 if it is rigid."""

    @property
    def counts(self) -> NDArray[np.int64]:
        """Cells of each sheet."""
        return self.bodies[: len(self.bodies) - (self.bars > 0), 0].astype(np.int64)

    def places(self, points: int) -> list[tuple[int, int, float, float]]:
        """
        Find what to interpolate from at heights, or to extrapolate from at the end of a sheet.

        That is the cell at each height and one beside it of the same sheet, the weight of the
        latter for what is known in the middle of cells (0 if there is none), and which part of the
        cell is below.
        """
        counts = self.counts
        sheets = np.repeat(np.arange(counts.size), counts)
        tops = np.cumsum(np.repeat(self.bodies[: counts.size, 1] / counts, counts))
        heights = np.append(0.0, tops)
        found = []
        for height in np.linspace(0.0, tops[-1], points).tolist():
            cell = min(int(np.searchsorted(heights, height, side='right')), tops.size) - 1
            low, high = heights[cell:cell + 2]
            part = float((height - low) / (high - low))
            ahead = 1 if part > 0.5 else -1
            beside = [
                other
                for other in (cell + ahead, cell - ahead)
                if 0 <= other < tops.size and sheets[other] == sheets[cell]
            ]
            other = beside[0] if beside else cell
            found.append((cell, other, (part - 0.5) * (other - cell), part))
        return found


def fastest_waves(bodies: Floats) -> Floats:
    """Compute largest speeds of waves over those of slow and weak ones, of rows of `BODY` [-]."""
    bound, relaxed = bodies[..., 5], bodies[..., 6]
    tangent = relaxed * (1.0 + 2.0 / (1.0 - bound) ** 3) / 3.0 + bodies[..., 7:].sum(axis=-1)
    return np.asarray(np.sqrt(tangent) * np.where(bound > 0.0, _DAMPED, 1.0))


def make_bodies(ratios: Floats, stack: Stack | None) -> tuple[Floats, Floats]:
    """
    Make the sheets of layers in units of layer mass, crossing time and amplitude.

    Parameters
    ----------
    ratios : ndarray, shape (n, 8)
        Those of `cell_stepper.first_throws`, in its order. [-]
    stack : Stack, optional
        Of which the layers are.

    Returns
    -------
    bodies : ndarray, shape (n, sheets, 10)
        Rows of `BODY` without numbers of cells; the thickness is such that strains are true ones
        if the layer is not linear, and otherwise a part of the whole.
    crossings : ndarray, shape (n, sheets)
        What the fastest wave needs through each.

    """
    sheets = stack.sheets if stack else (Layer(),)
    whole = stack or sheets[0]
    mu, kappa, gravity, loss, strain, is_constant = (
        ratios[:, k, None] for k in (0, 1, 3, 4, 6, 7)
    )
    values = np.array([
        (sheet.thickness, sheet.mass, sheet.crossing_time, sheet.loss_tangent) for sheet in sheets
    ]).T
    parts = np.array([whole.thickness, whole.mass, whole.crossing_time, whole.loss_tangent or 1.0])
    thickness, mass, crossing, share = values / parts[:, None]
    stiffness, omega = mass / crossing**2, 2.0 * math.pi / kappa
    losses = loss * (share if whole.loss_tangent > 0.0 else 1.0)
    losses = np.broadcast_to(losses, (len(ratios), len(sheets)))
    bodies = np.zeros((*losses.shape, len(BODY)))
    is_curved = strain > 0.0
    thickness = thickness * np.where(is_curved, omega / np.where(is_curved, strain, 1.0), 1.0)
    modulus = stiffness * thickness
    # The sheets carry one force, so the soft ones are compressed most
    softness = thickness.sum(axis=1, keepdims=True) / (1.0 / stiffness).sum() / modulus
    bound = strain_bounds(strain * softness, mu, mu * gravity * omega**2 / modulus)
    for n, column in enumerate((
        thickness, mass, stiffness, np.where(is_constant > 0.0, 0.0, losses / omega),
        np.where(is_curved, bound, 0.0),
    )):
        bodies[..., 1 + n] = column
    bodies[..., 6] = 1.0
    for throw in np.flatnonzero(is_constant):
        fits = [relaxation(each) for each in losses[throw].tolist()]
        bodies[throw, :, 6:] = [(fit.relaxed, *fit.strengths) for fit in fits]
    return bodies, crossing / fastest_waves(bodies)


def _sheets(rig: Rig, peak_speed: float | None) -> tuple[Floats, Floats]:
    """Return a row of `BODY` for each sheet, and what its fastest wave needs through it [s]."""
    layer, time, ratios = rig.layer, rig.crossing_time, rig.cell_ratios
    stack = ratios.pop('stack')
    if peak_speed is not None:
        ratios['strain_ratio'] *= peak_speed / rig.engine.speed_scale
    row = [*ratios.values()]
    row.insert(5, 0.0)  # the projectile is cut by itself
    bodies, crossings = make_bodies(np.array([row], dtype=np.float64), stack)
    units = np.array([1.0, 1.0, layer.mass, layer.mass / time**2, time, *[1.0] * 5])
    rows = bodies[0] * units
    rows[:, 1] = [sheet.thickness for sheet in layer.sheets]
    return rows, crossings[0] * time


def crossing_time(rig: Rig, peak_speed: float | None = None) -> float:
    """Compute what the fastest wave needs through the layer, see `make_grid` [s]."""
    return float(_sheets(rig, peak_speed)[1].sum())


def make_grid(
    rig: Rig, *, cells: int, is_elastic: bool = False, peak_speed: float | None = None
) -> Grid:
    """
    Cut a rig into about so many cells of the layer; sheets get whole numbers, and at least one.

    Parameters
    ----------
    rig, cells
        The rig, and the cells of the layer.
    is_elastic : bool
        Whether the projectile is cut, too.
    peak_speed : float, optional
        Of the plate; its engine's if not given. [m/s]

    Raises
    ------
    ValueError
        If an elastic projectile takes more than `MAX_PROJECTILE_CELLS`; with the number.

    """
    bodies, crossings = _sheets(rig, peak_speed)
    step = float(crossings.sum()) / cells
    bodies[:, 0] = np.maximum(1, (crossings / step * (1.0 + _ROUNDING)).astype(np.int64))
    bars = _projectile_cells(rig, step) if is_elastic else 0
    if bars:
        projectile = rig.projectile
        spring = projectile.youngs_modulus * rig.layer.section / projectile.length
        bodies = np.vstack([bodies, [bars, 0, projectile.mass, spring, 0, 0, 1, 0, 0, 0]])
    return Grid(step, bodies, bars)


def make_massless_grid(rig: Rig, *, step: float) -> Grid:
    """
    Make one cell without mass, a spring and a dashpot (App. A).

    Raises
    ------
    ValueError
        If the layer is not linear, or its loss not Kelvin and Voigt's.

    """
    layer = rig.layer
    if any(each.elasticity != 'linear' or each.loss == 'constant' for each in layer.sheets):
        raise ValueError(
            'the model spring_mass needs layer.elasticity linear and layer.loss kelvin_voigt, '
            f'got {layer.elasticity} and {layer.loss}'
        )
    lag = layer.loss_tangent / rig.engine.angular_frequency
    row = [1, layer.thickness, 0, layer.stiffness, lag, 0, 1, 0, 0, 0]
    return Grid(step, np.array([row], dtype=np.float64), 0)


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


@part
def cut(nodes: Floats, bodies: Floats, bottom: int, cells: int, mass: float, step: float) -> None:
    """Cut bodies into cells, from the node `bottom` up; without a bar the mass is a point."""
    first, face = bottom, cells + 1
    for n in range(bodies.shape[0]):
        body = bodies[n]
        if first == bottom + cells:
            first = face
        count = int(body[0])
        cell, spring = body[2] / count, body[3] * count
        inverse = count / body[1] if body[1] > 0.0 else 0.0
        stiffest = body[6] + body[7] + body[8] + body[9]
        bound = body[5]
        if bound > 0.0:
            stiffest += body[6] * ((1.0 + 2.0 / (1.0 - bound) ** 3) / 3.0 - 1.0)
        stiffest *= spring
        is_stiff = 0.0 < math.sqrt(cell / stiffest) * (1.0 + _ROUNDING) < step
        for j in range(first, first + count):
            nodes[MASS, j] += 0.5 * cell
            nodes[MASS, j + 1] += 0.5 * cell
            nodes[INVERSE, j] = inverse
            if bound > 0.0:
                nodes[CURVATURE, j] = body[6] * spring / inverse / 3.0
                nodes[LEAST, j] = 1.0 - bound
                nodes[SHOCK, j] = _SHOCK * cell * inverse
            else:
                nodes[STIFFNESS, j] = body[6] * spring
            for element in range(3):
                nodes[STRENGTH + element, j] = body[7 + element] * spring
            nodes[VISCOSITY, j] = body[4] * spring
            nodes[STIFF, j] = _AVERAGE_ACCELERATION * step * step * stiffest if is_stiff else 0.0
        first += count
    if first == bottom + cells:
        nodes[MASS, face] += mass


@part
def factorise(s: Record, nodes: Floats, step: float, joint: int, known: int, case: int) -> None:
    """Compute the factors of the matrix in flight (0) or in contact (1), see `solve`."""
    rigid = joint if case == 1 else -1
    last = nodes.shape[1] - 1
    mass, coupling = nodes[MASS], nodes[COUPLING + case]
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
    middle = (first + end) // 2
    system = s.systems[case]
    system[0], system[1], system[2], system[3] = known, first, end, middle
    if first <= end:
        _eliminate(nodes, case, first, middle, end, rigid)


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
def _go_up(nodes, x, share, j, a, here, next_):
    """Follow a chain by two nodes, of which the second waits for no more than the first does."""
    one = np.uintp(1)
    s, t = nodes[share, j - one], nodes[share, j]
    nodes[x, j], nodes[x, j + one] = here + s * a, next_ + t * here + t * s * a
    return nodes[x, j + one]


@inlined
def _go_down(nodes, x, share, j, a, here, next_):
    """Follow a chain by two nodes downwards."""
    one = np.uintp(1)
    s, t = nodes[share, j], nodes[share, j - one]
    nodes[x, j], nodes[x, j - one] = here + s * a, next_ + t * here + t * s * a
    return nodes[x, j - one]


@inlined
def _substitute(nodes, x, case, first, middle, end):
    """Solve for row x, from both ends to the middle and back, side by side."""
    # Unsigned, since any other index is looked at whether it counts from the end
    one, two = np.uintp(1), np.uintp(2)
    first, middle = np.uintp(first), np.uintp(middle)
    share, gain = SHARE + case, GAIN + case
    length = middle - first
    top = middle + length  # of chains of one length
    if end > int(top):
        nodes[x, top] += nodes[share, top] * nodes[x, top + one]
    odd = length & one  # the outermost node of each chain, if it is one too many
    a, b = 0.0, 0.0
    if odd:
        a, b = nodes[x, first], nodes[x, top]
    for i in range(odd, length, two):
        j, k = first + i, top - i
        a = _go_up(nodes, x, share, j, a, nodes[x, j], nodes[x, j + one])
        b = _go_down(nodes, x, share, k, b, nodes[x, k], nodes[x, k - one])
    a = nodes[x, middle] + nodes[share, middle - one] * a + nodes[share, middle] * b
    a *= nodes[gain, middle]
    b = nodes[x, middle] = a
    for i in range(one, length, two):
        j, k = middle - i, middle + i
        y, z = nodes[gain, j] * nodes[x, j], nodes[gain, j - one] * nodes[x, j - one]
        a = _go_down(nodes, x, share, j, a, y, z)
        y, z = nodes[gain, k] * nodes[x, k], nodes[gain, k + one] * nodes[x, k + one]
        b = _go_up(nodes, x, share, k, b, y, z)
    if odd:
        nodes[x, first] = nodes[gain, first] * nodes[x, first] + nodes[share, first] * a
        b = nodes[gain, top] * nodes[x, top] + nodes[share, top - one] * b
        nodes[x, top] = b
    if end > int(top):
        nodes[x, top + one] = (
            nodes[gain, top + one] * nodes[x, top + one] + nodes[share, top] * nodes[x, top]
        )


@inlined
def solve(s: Record, nodes: Floats, now: int, case: int) -> None:
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
    known, first, end, middle = s.known, s.first, s.end, s.middle
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
    _substitute(nodes, w, case, first, middle, end)
