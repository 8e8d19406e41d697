# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Throws by cells of finite size: layers with loss, large strain or several sheets.

Notes
-----
Eqs. (2)-(3) of [1]_, :math:`\rho u_{tt} = \sigma_y`, with the Kelvin-Voigt stress
:math:`\sigma = E u_y + \eta u_{ty}`. Nodes are numbered from the plate up, and link j is between
nodes j and j + 1. A link is a cell (a spring beside a dashpot and Maxwell elements, with half of
its mass on each of its nodes) or, as the last one, the contact, whose two nodes move as one while
it lasts. The last node is the projectile. All counts from the static equilibrium; the weight of
the layer is left out as in [1]_. With displacements u at whole and velocities v at half steps,

.. math::

    M a^n = -K (u^n + \beta h^2 a^n) - C \frac{v^{n+1/2} + v^{n-1/2}}{2}, \qquad
    v^{n+1/2} = v^{n-1/2} + h a^n, \qquad u^{n+1} = u^n + h v^{n+1/2}.

The step h is the time in which the fastest wave crosses a cell, or a little less, where there is
no dispersion. :math:`\beta` is 1/4 (average acceleration) in a sheet that is crossed in less than
a step, otherwise 0.

The projectile leaves when the contact force, its inertia and weight, falls below zero. Nodes meet
when the gap is closed at the end of a step, and are put where momentum puts them, at the common
velocity, so that later events are of second order, too; they are of first order in shocks. The
grid is up to one step ahead of the requested time.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any, NamedTuple

import numpy as np
from soft_throw_ros.core import material, stepper
from soft_throw_ros.core.batch import Cancelled
from soft_throw_ros.core.kernels import Floats, inlined, kernel, stepper_kernels, subroutine
from soft_throw_ros.core.rig import Layer, Rig, scales_of, values_of
from soft_throw_ros.core.stepper import CAPACITY, motion_at, Stepper

_UPDATE_COST = 4e-9
"""Time of a processor for a cell in a step. [s]"""

_NEO_HOOKEAN_CELLS = 1.5
"""Cells of a neo-Hookean layer over those of a linear one, in a batch. [-]"""

_FASTEST = 0.05
"""Largest shock that keeps the explicit artificial viscosity stable, in cells per step. [-]"""

_static_stretch = subroutine(material.static_stretch)


class Row(NamedTuple):
    """
    Rows of the table of nodes and links, a column for each; the last link does not exist.

    Of two rows, one is for even and one for odd steps, or one for flight and one for contact; of
    three, each is for a Maxwell element. The first ten are constant in a sheet.
    """

    stiffness: int = 0  # of a linear link [N/m]
    third_modulus: int = 1  # third of E S, of a neo-Hookean link [N]
    shock_viscosity: int = 2  # artificial, over a square of a velocity [N s2/m2]
    maxwell_stiffness: int = 3  # of the Maxwell elements [N/m]
    viscosity: int = 6  # of a link, in flight and in contact [N s/m]
    implicit_stiffness: int = 8  # of a cell that is too fast for the step [kg]
    inverse_length: int = 9  # of a cell, 0 for the contact [1/m]
    mass: int = 10  # of a node [kg]
    rest_height: int = 11  # of a node of the layer [m]
    static_strain: int = 12  # compression of a cell at rest [-]
    constant_tension: int = 13  # of a neo-Hookean link [N]
    displacement: int = 14  # of a node, from rest [m]
    velocity: int = 15  # of a node, half a step earlier [m/s]
    mean_velocity: int = 16  # at the whole step, at even and odd steps [m/s]
    tension: int = 18  # elastic tension of a link, from rest, at even and odd steps [N]
    previous_stretch: int = 20  # of a link, a step ago [m]
    maxwell_stretch: int = 21  # of the springs of the Maxwell elements [m]
    elimination_factor: int = 24  # of a link: momentum that the upper node gets [-]
    inverse_pivot: int = 25  # velocity over momentum of an eliminated node [1/kg]
    momentum_factor: int = 26  # mass of a node if it is coupled, otherwise 1 [kg]
    impulse_factor: int = 27  # half a step, over the mass if it is not coupled [s]
    peak_strain: int = 28  # largest magnitude of the strain of a cell [-]
    position: int = 29  # displacement at the requested time [m]
    speed: int = 30  # velocity at the requested time [m/s]
    force: int = 31  # force through a cell at the requested time, positive in compression [N]


ROW = Row()
"""Rows by name, constants in a kernel."""

RECORD = np.dtype(
    [
        # constants
        ('step', 'f8'),  # [s]
        ('cells', 'i8'),  # number of cells, and of the link that is the contact
        ('has_maxwell', '?'),
        ('has_implicit', '?'),  # whether a cell is too fast for the step
        ('fastest_shock', 'f8'),  # change of velocity in a cell at the largest viscosity [m/s]
        ('maxwell_rates', 'f8', (3,)),  # relaxation rates of the Maxwell elements [1/s]
        ('maxwell_gain', 'f8', (3,)),  # share of a new stretch that an element takes
        ('mass', 'f8'),  # of the projectile [kg]
        ('gravity', 'f8'),  # [m/s2]
        ('release_threshold', 'f8'),  # contact force below which the projectile leaves [N]
        ('edge_cells', 'i8', (2, 2)),  # those that extrapolate the strain to plate and top
        ('collision_node', 'i8'),  # lowest of the nodes that meet the projectile as one
        ('collision_mass', 'f8'),  # of these nodes [kg]
        *stepper.COMMON,
        ('plate_acceleration', 'f8'),  # [m/s2]
        # the state of the grid
        ('index', 'i8'),  # of the step
        ('fraction', 'f8'),  # of the step that has passed
        ('coupled', 'i8', (2,)),  # first and last node of the linear system, see `_factorise`
        ('contact_before', 'f8', (2,)),  # displacements of the contact's nodes a step ago [m]
        # of the layer on plate and projectile: a step ago, before an event, and now [N]
        ('forces', 'f8', (2, 3)),
        ('earlier_force', 'f8'),  # on the projectile, two steps ago [N]
        ('power', 'f8'),  # of the plate [W]
        ('work_before', 'f8'),  # of the plate, a step ago [J]
    ],
    align=True,
)
"""State of a throw by cells."""


@inlined
def _neo_hookean_stress(ratio):
    """Compute the stress of a stretch ratio over E / 3."""
    inverse = 1.0 / max(ratio, 1.0 - material.LARGEST_STRAIN)
    share = ratio * inverse
    return ratio - inverse * inverse * (3.0 - (share + share))


@subroutine
def _factorise(s, nodes):
    """Compute the factors of the matrix, in flight or in contact, see `_solve`."""
    last, half = s.cells + 1, 0.5 * s.step
    case, rigid = (1, s.cells) if s.contact else (0, -1)
    mass, factor = nodes[ROW.mass], nodes[ROW.elimination_factor]
    low, high = last, -1
    for j in range(last):  # first the share of a link in the matrix
        factor[j] = nodes[ROW.implicit_stiffness, j] + half * nodes[ROW.viscosity + case, j]
        if factor[j] > 0.0 or j == rigid:
            low, high = min(low, j), max(high, j)
    first, end = max(low, 1), high + 1  # the motion of node 0 is given
    s.coupled[0], s.coupled[1] = first, end
    for j in range(1, last + 1):
        is_coupled = first <= j <= end
        nodes[ROW.momentum_factor, j] = mass[j] if is_coupled else 1.0
        nodes[ROW.impulse_factor, j] = half / (1.0 if is_coupled else mass[j])
    added = factor[first - 1]
    for j in range(first, end + 1):
        pivot = mass[j] + added
        if j == rigid:  # the projectile gets all of the momentum, and has the same velocity
            factor[j], nodes[ROW.inverse_pivot, j], added = 1.0, 0.0, pivot
        else:
            nodes[ROW.inverse_pivot, j] = 1.0 / (pivot + factor[j])
            factor[j] *= nodes[ROW.inverse_pivot, j]
            added = factor[j] * pivot


@inlined
def _across(nodes, row, j):
    """Return the difference of a row between the ends of link j."""
    return nodes[row, j + 1] - nodes[row, j]


@inlined
def _solve(s, nodes):
    """Solve (M + B + C h / 2) w = (M + B) v + h f / 2 by Thomas's algorithm; B is implicit."""
    w, tension = ROW.mean_velocity + (s.index & 1), ROW.tension + (s.index & 1)
    first, end = s.coupled[0], s.coupled[1]
    for j in range(1, nodes.shape[1]):
        force = nodes[tension, j] - nodes[tension, j - 1]
        start = nodes[ROW.momentum_factor, j] * nodes[ROW.velocity, j]
        nodes[w, j] = start + nodes[ROW.impulse_factor, j] * force
    if end < first:
        return
    if s.has_implicit:
        for j in range(first - 1, end):
            momentum = nodes[ROW.implicit_stiffness, j] * _across(nodes, ROW.velocity, j)
            nodes[w, j + 1] += momentum
            if j > 0:
                nodes[w, j] -= momentum
    value = nodes[w, first - 1]
    for j in range(first, end + 1):
        value = nodes[w, j] = nodes[w, j] + nodes[ROW.elimination_factor, j - 1] * value
    value = 0.0
    for j in range(end, first - 1, -1):
        value *= nodes[ROW.elimination_factor, j]
        value = nodes[w, j] = nodes[ROW.inverse_pivot, j] * nodes[w, j] + value


@kernel
def _prepare(core: Any, counts: Any, sheets: Any, numbers: Any) -> Floats:
    """Complete the third record but for the plate's motion; return the cut sheets, at rest."""
    step, mass, gravity, omega, peak_force = (
        numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    )
    s, nodes = core[2], np.zeros((ROW.force + 1, counts.sum() + 2))
    s.step, s.mass, s.gravity = step, mass, gravity
    s.release_threshold = -stepper.FORCE_NOISE * peak_force
    s.event_time = s.fastest_shock = math.inf
    s.contact = True
    for element in range(3):
        s.maxwell_rates[element] = material.RELAXATION_RATES[element] * omega
        s.maxwell_gain[element] = 1.0 / (1.0 + 0.5 * step * s.maxwell_rates[element])
    weight, tension = mass * gravity, 0.0
    for n in range(counts.size):
        sheet, first = sheets[n], s.cells
        modulus, inverse = sheet[ROW.third_modulus], sheet[ROW.inverse_length]
        if modulus > 0.0:
            ratio = _static_stretch(weight / modulus)
            strain, tension = 1.0 - ratio, -modulus * _neo_hookean_stress(ratio)
            s.fastest_shock = min(s.fastest_shock, _FASTEST / (inverse * s.step))
        else:
            strain = weight / sheet[ROW.stiffness] * inverse
        s.cells += counts[n]
        for j in range(first, s.cells):
            for row in range(ROW.mass):
                nodes[row, j] = sheet[row]
            nodes[ROW.mass, j] += 0.5 * sheet[ROW.mass]
            nodes[ROW.mass, j + 1] += 0.5 * sheet[ROW.mass]
            nodes[ROW.static_strain, j] = nodes[ROW.peak_strain, j] = strain
            nodes[ROW.constant_tension, j] = tension
            nodes[ROW.rest_height, j + 1] = nodes[ROW.rest_height, j] + (1.0 - strain) / inverse
        s.has_maxwell |= sheet[ROW.maxwell_stiffness:ROW.viscosity].max() > 0.0
        s.has_implicit |= sheet[ROW.implicit_stiffness] > 0.0
    s.edge_cells[0, 1] = min(1, counts[0] - 1)
    s.edge_cells[1, 0], s.edge_cells[1, 1] = s.cells - 1, s.cells - min(2, counts[-1])
    top = s.collision_node = s.cells
    nodes[ROW.mass, top + 1] = mass
    # In flight half of the top's momentum is lost in half a step, which ends its alternation
    nodes[ROW.viscosity, top - 1] += 2.0 / step * nodes[ROW.mass, top]
    # Nodes that only stiff cells part meet as one: a jump of stress there is levelled out at once
    while s.collision_node > 1 and nodes[ROW.implicit_stiffness, s.collision_node - 1] > 0.0:
        s.collision_node -= 1
    for j in range(s.collision_node, top + 1):
        s.collision_mass += nodes[ROW.mass, j]
    _factorise(s, nodes)
    s.rest_height = nodes[ROW.rest_height, top]
    s.loads[2] = weight
    s.forces[0, :], s.forces[1, :] = -weight, weight
    return nodes


@inlined
def _compute_tension(s, nodes):
    """Compute the tension of all links, and of an artificial viscosity against shocks."""
    now, fastest = s.index & 1, -s.fastest_shock
    if nodes[ROW.third_modulus, 0] > 0.0:  # all sheets have one law
        for j in range(nodes.shape[1] - 1):
            stretch = nodes[ROW.inverse_length, j] * _across(nodes, ROW.displacement, j)
            stress = _neo_hookean_stress(1.0 - nodes[ROW.static_strain, j] + stretch)
            pull = nodes[ROW.constant_tension, j] + nodes[ROW.third_modulus, j] * stress
            closing = min(_across(nodes, ROW.velocity, j), 0.0)
            shock = nodes[ROW.shock_viscosity, j] * closing * max(closing, fastest)
            nodes[ROW.tension + now, j] = pull - shock
    else:
        for j in range(nodes.shape[1] - 1):  # E u_y, Eq. (2)
            stretch = _across(nodes, ROW.displacement, j)
            nodes[ROW.tension + now, j] = nodes[ROW.stiffness, j] * stretch
    if not s.has_maxwell:
        return
    tension, gains = ROW.tension + now, (s.maxwell_gain[0], s.maxwell_gain[1], s.maxwell_gain[2])
    for j in range(nodes.shape[1] - 1):  # the Maxwell elements, by the trapezoidal rule
        stretch = _across(nodes, ROW.displacement, j)
        change = stretch - nodes[ROW.previous_stretch, j]
        nodes[ROW.previous_stretch, j] = stretch
        for element in range(3):
            row, gain = ROW.maxwell_stretch + element, gains[element]
            nodes[row, j] = (2.0 * gain - 1.0) * nodes[row, j] + gain * change
            nodes[tension, j] += nodes[ROW.maxwell_stiffness + element, j] * nodes[row, j]


@inlined
def _link_tension(nodes, j, parity, case, rate):
    """Compute the tension of a link at the last step, or the one before, with a rate of -2 / h."""
    opening = _across(nodes, ROW.mean_velocity + parity, j)
    change = opening - nodes[ROW.velocity, j + 1] + nodes[ROW.velocity, j]
    viscous = nodes[ROW.viscosity + case, j] * opening  # eta u_ty, added to Eq. (2)
    implicit = nodes[ROW.implicit_stiffness, j] * change * rate
    return nodes[ROW.tension + parity, j] + viscous + implicit


@inlined
def _contact_forces(s, nodes):
    """Compute the forces of the layer on plate and projectile."""
    now, j, case = s.index & 1, s.cells + 1, 1 if s.contact else 0
    weight = s.mass * s.gravity
    s.forces[1, 2] = 0.0
    if s.contact:
        change = nodes[ROW.mean_velocity + now, j] - nodes[ROW.velocity, j]
        s.forces[1, 2] = weight + s.mass * 2.0 / s.step * change
    inertia = nodes[ROW.mass, 0] * s.plate_acceleration
    s.forces[0, 2] = _link_tension(nodes, 0, now, case, 2.0 / s.step) - inertia - weight


@inlined
def _first_root(a, b, c):
    """Find the root between 0 and 1 of a + b x + c x^2, which is negative at 1; 0 if also at 0."""
    if a <= 0.0:
        return 0.0
    root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
    return 2.0 * a / (root - b) if b < 0.0 else -0.5 * (root + b) / c


@subroutine
def _handle_release(s, nodes, events):
    """Release the projectile at the root of the force, which is below zero now."""
    earlier, before, after = s.earlier_force, s.forces[1, 0], s.forces[1, 2]
    bend = 0.5 * (earlier + after) - before if earlier > 0.0 else 0.0  # just landed: a line
    slope = after - before - bend
    t = _first_root(before, slope, bend)
    # Impulse of the force less the weight from half of the step on; the mean velocity of the step
    # is that at its middle and a 24th of its curvature
    impulse = (before - s.mass * s.gravity) * (t - 0.5) - (after - before) / 24.0
    impulse += slope * (t**2 - 0.25) / 2.0 + bend * (t**3 - 0.125) / 3.0
    velocity = nodes[ROW.velocity, s.cells + 1] + s.step * impulse / s.mass
    height, _ = _motion(s, nodes, s.cells + 1, t)
    stepper.note_event(s, events, (s.index - 1 + t) * s.step, height, velocity)
    _factorise(s, nodes)


@subroutine
def _handle_landing(s, nodes, events):
    """Land the projectile at the root of the gap, which is negative now."""
    j, projectile_node = s.cells, s.cells + 1
    u, v = nodes[ROW.displacement], nodes[ROW.velocity]
    before = nodes[ROW.mean_velocity + 1 - (s.index & 1)]
    gap, closed = s.contact_before[1] - s.contact_before[0], u[j + 1] - u[j]
    bend = s.step * (v[j + 1] - v[j] - (before[j + 1] - before[j]))
    t = _first_root(gap, closed - gap - bend, bend)
    speed, change = v[projectile_node], v[projectile_node] - before[projectile_node]
    height = u[projectile_node] - s.step * (1.0 - t) * (speed + t * change)
    velocity = speed - s.gravity * s.step * (t - 0.5)
    overlap, approach = u[j] - u[j + 1], v[j] - v[j + 1]
    below_share = s.collision_mass / (s.collision_mass + s.mass)
    for k in range(s.collision_node, j + 1):
        u[k] -= (1.0 - below_share) * overlap
        v[k] -= (1.0 - below_share) * approach
    u[projectile_node] += below_share * overlap
    v[projectile_node] += below_share * approach
    stepper.note_event(s, events, (s.index - 1 + t) * s.step, height, velocity)
    _factorise(s, nodes)


@inlined
def _march(s, nodes, path, events, goal):
    """Advance to step `goal`, or into one with more events than there is room for."""
    step, link = s.step, s.cells
    while s.index < goal and s.events <= events.shape[0]:
        before, now = s.index & 1, 1 - (s.index & 1)
        for k in range(2):
            s.contact_before[k] = nodes[ROW.displacement, link + k]
        for j in range(nodes.shape[1]):
            velocity = 2.0 * nodes[ROW.mean_velocity + before, j] - nodes[ROW.velocity, j]
            nodes[ROW.velocity, j] = velocity  # v^{n+1/2} = v^{n-1/2} + h a^n
            nodes[ROW.displacement, j] += step * velocity  # u^{n+1} = u^n + h v^{n+1/2}
        s.index += 1
        s.event_time = math.inf
        s.earlier_force = s.forces[1, 0]
        for end in range(2):
            s.forces[end, 0] = s.forces[end, 1] = s.forces[end, 2]
        s.work_before = s.work
        height, speed, s.plate_acceleration = motion_at(s, path, s.index * step)
        nodes[ROW.displacement, 0], nodes[ROW.mean_velocity + now, 0] = height, speed
        nodes[ROW.velocity, 0] = speed - 0.5 * step * s.plate_acceleration
        gap = nodes[ROW.displacement, link + 1] - nodes[ROW.displacement, link]
        if not s.contact and gap < 0.0:
            _handle_landing(s, nodes, events)
        _compute_tension(s, nodes)
        while True:
            if not s.contact:  # both sides of the contact are free of the weight
                nodes[ROW.tension + now, link] = s.mass * s.gravity
            _solve(s, nodes)
            _contact_forces(s, nodes)
            if s.event_time < math.inf:
                break
            s.forces[0, 1], s.forces[1, 1] = s.forces[0, 2], s.forces[1, 2]
            if not s.forces[1, 2] < s.release_threshold:
                break
            _handle_release(s, nodes, events)  # and compute the step again, in flight
        if s.events == 0:
            _compare_loads(s, nodes)
        elif s.events > 1 or s.event_time == math.inf:
            continue
        power = -s.forces[0, 2] * nodes[ROW.mean_velocity + now, 0]
        duration = min(s.index * step, s.event_time) - (s.index - 1) * step
        s.work += duration * (s.power + 0.5 * duration / step * (power - s.power))
        s.power = power


@inlined
def _strain_of(nodes, row, j):
    """Compute the strain of a cell from the row of displacements or of positions."""
    return _across(nodes, row, j) * nodes[ROW.inverse_length, j] - nodes[ROW.static_strain, j]


@inlined
def _compare_loads(s, nodes):
    """Update the running maxima."""
    for j in range(nodes.shape[1] - 1):
        strain = abs(_strain_of(nodes, ROW.displacement, j))
        if strain > nodes[ROW.peak_strain, j]:  # noqa: PLR1730 - numba makes vectors of this
            nodes[ROW.peak_strain, j] = strain
    for end in range(2):
        strain = _strain_of(nodes, ROW.displacement, s.edge_cells[end, 0])
        inner = _strain_of(nodes, ROW.displacement, s.edge_cells[end, 1])
        strain -= 0.5 * (inner - strain)
        s.loads[0] = max(s.loads[0], abs(strain))
    s.loads[1] = max(s.loads[1], s.forces[1, 2] / s.mass - s.gravity)
    s.loads[2] = max(s.loads[2], abs(s.forces[0, 2]))


@subroutine
def _motion(s, nodes, j, t):
    """Interpolate displacement and velocity of a node between the last two steps."""
    u, v, step = nodes[ROW.displacement, j], nodes[ROW.velocity, j], s.step
    now = s.index & 1
    # Changes of velocity in half a step, of an acceleration that is linear in time
    old, new = v - nodes[ROW.mean_velocity + 1 - now, j], nodes[ROW.mean_velocity + now, j] - v
    before = u - step * v
    if j >= s.cells:  # which a landing may have moved
        before = s.contact_before[j - s.cells]
    bend = old * (2.0 - t) + new * (1.0 + t)
    height = before + t * (u - before) - step * t * (1.0 - t) * bend / 3.0
    turn = old * (2.0 * t - t * t - 2.0 / 3.0) + new * (t * t - 1.0 / 3.0)
    return height, v + turn


@kernel
def _advance(core, nodes, path, events, time):
    """Advance to `time`; return the number of events until now, or an error code."""
    grid, s = core[0], core[1]
    step = grid.step
    goal = stepper.steps_until(s, step, time)
    if goal < 0:
        return goal
    goal += int(goal * step < time)
    if goal * step > grid.horizon:
        return -1
    _march(grid, nodes, path, events, goal)
    for j in range(grid.cells):  # the loads have those of both ends
        grid.loads[0] = max(grid.loads[0], nodes[ROW.peak_strain, j])
    piece = s.piece
    core[1] = core[0]
    if grid.events > events.shape[0]:
        return grid.events
    if time < s.piece_begin:  # the grid is further on
        s.piece = piece
    s.fraction = min(max((time - (goal - 1) * step) / step, 0.0), 1.0)
    later, weight = 2, 1.0
    if time < s.event_time:  # the event is still to come
        until = min(max(s.event_time / step - (goal - 1), 1e-9), 1.0)
        s.work = s.work_before + s.fraction / until * (s.work - s.work_before)
        if s.event_time < math.inf:
            s.contact = not s.contact
            s.events -= 1
        later, weight = 1, s.fraction
    state = s.state
    state[stepper.TIME] = time
    state[stepper.PLATE_POSITION], state[stepper.PLATE_VELOCITY], _ = motion_at(s, path, time)
    height, state[stepper.PROJECTILE_VELOCITY] = _motion(s, nodes, s.cells + 1, s.fraction)
    state[stepper.PROJECTILE_POSITION] = s.rest_height + height
    s.surface, _ = _motion(s, nodes, s.cells, s.fraction)
    for end in range(2):
        before = s.forces[end, 0]
        state[stepper.PLATE_FORCE + end] = before + weight * (s.forces[end, later] - before)
    return s.events


@subroutine
def _move_nodes(s, nodes):
    """Interpolate all nodes, and the forces through all cells, at the requested time."""
    now, fraction = s.index & 1, s.fraction
    for j in range(nodes.shape[1]):
        nodes[ROW.position, j], nodes[ROW.speed, j] = _motion(s, nodes, j, fraction)
    nodes[ROW.position, 0] = s.state[stepper.PLATE_POSITION]
    nodes[ROW.speed, 0] = s.state[stepper.PLATE_VELOCITY]
    case, weight = 1 if s.contact else 0, s.mass * s.gravity
    for j in range(nodes.shape[1] - 1):
        earlier = _link_tension(nodes, j, 1 - now, case, -2.0 / s.step)
        later = _link_tension(nodes, j, now, case, 2.0 / s.step)
        nodes[ROW.force, j] = weight - earlier - fraction * (later - earlier)


@kernel
def _read_layer(core, nodes, points, out):
    """Read heights, velocities, forces and strains of the layer from plate to top."""
    s = core[1]
    _move_nodes(s, nodes)
    for n in range(points.shape[1]):
        j, low, high = int(points[0, n]), int(points[1, n]), int(points[2, n])
        fraction, weight = points[3, n], points[4, n]
        length = _across(nodes, ROW.rest_height, j) + _across(nodes, ROW.position, j)
        out[0, n] = nodes[ROW.rest_height, j] + nodes[ROW.position, j] + fraction * length
        out[1, n] = nodes[ROW.speed, j] + fraction * _across(nodes, ROW.speed, j)
        force, strain = nodes[ROW.force, low], _strain_of(nodes, ROW.position, low)
        out[2, n] = force + weight * (nodes[ROW.force, high] - force)
        out[3, n] = strain + weight * (_strain_of(nodes, ROW.position, high) - strain)


@subroutine
def _elastic_energy(ratio):
    """Integrate the tension of a neo-Hookean rod in E / 3 over the stretch."""
    x = max(ratio, 1.0 - material.LARGEST_STRAIN)
    beyond, slope = ratio - x, 1.0 + 2.0 / x**3
    return 0.5 * x**2 + 1.0 / x + beyond * (x - 1.0 / x**2 + 0.5 * beyond * slope)


@kernel
def _stored_energy(core: Any, nodes: Any) -> float:
    """Add up kinetic and potential energy against rest."""
    s = core[1]
    _move_nodes(s, nodes)
    position, speed = nodes[ROW.position], nodes[ROW.speed]
    total = 0.5 * nodes[ROW.mass, 0] * speed[0] ** 2
    total += s.mass * s.gravity * (position[0] + position[s.cells + 1] - position[s.cells])
    remainder = (1.0 - s.fraction) * s.step
    for j in range(position.size - 1):
        stretch = position[j + 1] - position[j]
        total += 0.5 * nodes[ROW.stiffness, j] * stretch**2
        if nodes[ROW.third_modulus, j] > 0.0:
            start = 1.0 - nodes[ROW.static_strain, j]
            elastic = _elastic_energy(start + stretch * nodes[ROW.inverse_length, j])
            elastic -= _elastic_energy(start)
            total += nodes[ROW.third_modulus, j] / nodes[ROW.inverse_length, j] * elastic
            total += nodes[ROW.constant_tension, j] * stretch
        for element in range(3):  # which go on by their last rate
            maxwell = nodes[ROW.maxwell_stretch + element, j]
            change = nodes[ROW.previous_stretch, j] - stretch
            maxwell -= change - remainder * s.maxwell_rates[element] * maxwell
            total += 0.5 * nodes[ROW.maxwell_stiffness + element, j] * maxwell**2
        total += 0.5 * nodes[ROW.mass, j + 1] * speed[j + 1] ** 2
    return total  # type: ignore[no-any-return]


_kernels = stepper_kernels(RECORD, _advance, _read_layer, arrays=3)


@kernel
def _follow(core, nodes, number, plates, arrays, latest, rows):
    """Go on with the throws of a batch, see `stepper.follow_batch`."""
    left, path, no_events = stepper.SLICE, np.empty((7, 0)), np.empty((0, 4))
    counts, sheets, numbers = arrays
    while number < latest.size and left > stepper.ROUNDING:
        if not nodes.size:
            stepper.begin_throw(core, plates[:, number])
            nodes = _prepare(core, counts[number], sheets[number], numbers[number])
            core[0] = core[1] = core[2]
        cost = _UPDATE_COST * nodes.shape[1] / core[0].step
        begin = core[1].state[stepper.TIME]
        until = min(latest[number], begin + stepper.SLICE / cost)
        left -= cost * (until - begin)
        if _advance(core, nodes, path, no_events, until) or until == latest[number]:
            stepper.write_release(core, rows[:, number])
            number, nodes = number + 1, np.empty((0, 0))
    return number, nodes


class _Grids:
    """
    Layers of some `rig.values_of`, or of arrays of them, cut into about so many cells.

    `layer` has the proportions of all. The rows of an array are layers, its columns are sheets.
    """

    def __init__(self, values: Mapping[str, Any], layer: Layer, cells: Any) -> None:
        shares = np.array([
            (sheet.thickness / layer.thickness, sheet.mass / layer.mass,
             sheet.crossing_time / layer.crossing_time,
             sheet.loss_tangent / layer.loss_tangent if layer.loss_tangent else 1.0)
            for sheet in layer.sheets
        ]).T
        rigs = scales_of({name: np.atleast_1d(value) for name, value in values.items()})
        wholes = rigs.layer.thickness, rigs.layer.mass, rigs.crossing_time, rigs.layer.loss_tangent
        thickness, mass, crossing, losses = np.reshape(wholes, (4, -1, 1)) * shares[:, None]
        spring, none = mass / crossing**2, np.zeros_like(mass)  # of a sheet
        omega = rigs.engine.angular_frequency
        constant = losses if layer.loss == 'constant' else none
        fits = [material.relaxation(loss) for loss in constant.ravel().tolist()]
        relaxed, *maxwell = np.array(fits).T.reshape(4, *none.shape)
        lag = (losses - constant) / omega[:, None]
        is_curved = layer.stress_strain_law == 'neo_hookean'
        # The fastest wave is that of the largest stiffness of any state
        steepest = (1.0 + 2.0 / (1.0 - material.LARGEST_STRAIN) ** 3) / 3.0 if is_curved else 1.0
        tangent = relaxed * steepest + sum(maxwell)
        crossing = crossing / np.sqrt(tangent)
        if is_curved:  # the explicit artificial viscosity makes the stable step shorter
            crossing *= math.sqrt(1.0 - 2.0 * _FASTEST)
        steps = crossing.sum(axis=1, keepdims=True) / np.reshape(cells, (-1, 1))
        crossed = crossing / steps * (1.0 + math.sqrt(np.finfo(float).eps))
        counts = np.maximum(1, crossed.astype(np.int64))
        mass, spring, inverse = mass / counts, spring * counts, counts / thickness
        # Newmark's parameter is 1/4 (average acceleration) where a wave is faster than the step
        implicit = np.where(crossed < 1.0, 0.25 * steps * steps * tangent * spring, 0.0)
        law = relaxed * spring, none, none
        if is_curved:  # with the viscosity of von Neumann and Richtmyer
            law = none, relaxed * spring / inverse / 3.0, mass * inverse
        viscosity = lag * spring
        maxwell = [modulus * spring for modulus in maxwell]
        rows = *law, *maxwell, viscosity, viscosity, implicit, inverse, mass
        self.steps, self._counts, self._lengths = steps[:, 0], counts, thickness / counts
        numbers = np.broadcast_arrays(
            self.steps, rigs.projectile.mass, rigs.gravity, omega,
            rigs.engine.speed_scale * rigs.layer.impedance,
        )
        self.arrays = counts, np.stack(rows, axis=-1), np.stack(numbers, axis=-1)

    def reading_points(self, number: int) -> Floats:
        """
        Return even heights from plate to top of the first layer.

        The rows are the cell at the height, the two cells of its sheet (or twice the only one)
        whose middles give forces and strains, the fraction of the first cell, and the weight of
        the last.
        """
        counts, lengths = self._counts[0], self._lengths[0]
        bounds = np.append(0.0, np.cumsum(counts * lengths))
        heights = np.linspace(0.0, bounds[-1], number)
        sheet = np.minimum(np.searchsorted(bounds, heights, side='right'), counts.size) - 1
        position = (heights - bounds[sheet]) / lengths[sheet]  # in cells
        first, last = np.cumsum(counts)[sheet] - counts[sheet], counts[sheet] - 1
        cell = np.minimum(position.astype(np.int64), last)
        low = np.clip((position - 0.5).astype(np.int64), 0, np.maximum(last - 1, 0))
        cells = first + np.array([cell, low, np.minimum(low + 1, last)])
        return np.array([*cells, position - cell, position - 0.5 - low])


def throw_batch(
    values: Mapping[str, Floats], layer: Layer, cells: int | None, cancelled: Cancelled | None
) -> Floats:
    """
    Compute first releases and loads for `throw.throw_many`, unchecked but for `cells`.

    Arguments are as of `_Grids`, with 8 to `CAPACITY` cells, or by default so many as errors of
    1e-4 need; the result is that of `stepper.follow_batch`.
    """
    rigs = scales_of(values)
    if cells is None:
        finer = _NEO_HOOKEAN_CELLS if layer.stress_strain_law == 'neo_hookean' else 1.0
        cells = np.minimum(np.ceil(finer * stepper.needed_cells(rigs)), CAPACITY)
    else:
        stepper.require_count('cells', cells, low=8, high=CAPACITY)
    arrays = _Grids(values, layer, cells).arrays
    return stepper.follow_batch(_follow, RECORD, rigs, arrays, rigs.longest_wait, cancelled)


class CellStepper(Stepper):
    """
    A throw by cells; the layer may be a stack, and have loss.

    `stored_energy` is that of now, at any time. Arguments are as for `throw.make_stepper`; the
    layer has about so many cells, from 1 to `CAPACITY`.
    """

    def __init__(self, rig: Rig, *, cells: int | None = None, **options: Any) -> None:
        values = values_of(rig)
        if cells is None:
            (step,) = _Grids(values, rig.layer, 1).steps
            cells = stepper.cells_in_real_time(rig, _UPDATE_COST / step, 2)
        stepper.require_count('cells', cells, low=1, high=CAPACITY)
        grids, core = _Grids(values, rig.layer, cells), np.zeros(3, RECORD)
        counts, sheets, numbers = grids.arrays
        nodes = _prepare(core, counts[0], sheets[0], numbers[0])
        self.step = float(grids.steps[0])
        self.cost = _UPDATE_COST * nodes.shape[1] / self.step
        super().__init__(rig, core, nodes, _kernels(), grids.reading_points, **options)

    @property
    def horizon(self) -> float:
        """Last step at which the plate is known, until which `advance_to` can go [s]."""
        known = super().horizon
        return known if math.isinf(known) else known // self.step * self.step

    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, at the present time [J]."""
        return float(_stored_energy(self._core, self._layer))
