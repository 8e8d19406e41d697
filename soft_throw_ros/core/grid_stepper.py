# SPDX-License-Identifier: Apache-2.0
r"""
Finite differences advanced in real time: contact, release, flight and landing.

For layers with internal loss, stacked and graded layers, elastic projectiles, layers glued to the
projectile, and layers without mass.

Notes
-----
Eqs. (2)-(3) of [1]_ on the cells of `soft_throw_ros.core.grid`, by the scheme described in
`soft_throw_ros.core.finite_difference`: displacements at whole steps, velocities at half steps,
which makes semi-implicit Euler second order; what is implicit (loss, and cells that are too fast)
is one tridiagonal system. All counts from the static equilibrium, the weight of the layer left
out as in [1]_, unless it is thrown along.

The contact is a joint between two nodes: their motion is one while it lasts. The force in it is
the inertia and stress of what is above, and the projectile leaves when it falls below zero, at the
root of the cubic through four steps. After that the nodes are free of each other, and of the
weight. In the cell at each free end a dashpot takes away what the release leaves there in turns
from step to step; in one cell it is a change of second order.

They land when the gap between them is closed at the end of a step; from there on they are where
momentum puts them, at the common velocity. That is how two waves meet half a cell later, so that
events after a landing are of second order, too, though a landing is a jump.

The grid is up to one step ahead of the time that is asked for, and the state is interpolated
between its last two steps (third order). So with a measured plate it can go as far as the last
whole step before what is known.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

import math
from typing import Literal

import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.finite_difference import release_within
from soft_throw_ros.core.grid import cut, massless
from soft_throw_ros.core.models import ON_GRIDS
from soft_throw_ros.core.moving_plate import (
    motion_at,
    PLATE,
    plate_at,
    take_samples,
    take_states,
    write_motion,
)
from soft_throw_ros.core.plate import PlateMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepping import (
    BACKWARDS,
    BEYOND_HORIZON,
    checked_count,
    MAX_EVENTS,
    Peaks,
    PLATE_FORCE,
    PLATE_POSITION,
    PLATE_VELOCITY,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    ThrowStepper,
    TIME,
    TOO_FAR,
    TOO_MANY_EVENTS,
)

Floats = NDArray[np.float64]

MAX_CELLS = 4096
"""Most cells of a layer."""

MAX_UPDATE_RATE = 2e7
"""Most cells times steps in a second of rig time; a processor takes 1e8 and more. [1/s]"""

_MIN_CELLS = 64
_CELLS_PER_RELAXATION = 4.0
_STEPS_PER_PERIOD = 80.0
_SLOWEST = 8.0  # projectile, whose waves take so many times longer than those of the layer
_SPRING_STEPS = 1000  # without cells, per period of plate or projectile
_NOISE = 1e-12  # of the plate's speed, as a wave, which is no pull

# rows of the nodes and links
(
    _U,
    _V,
    _A,  # at even steps, and at odd ones
    _A_ODD,
    _MASS,
    _STIFFNESS,
    _VISCOSITY,
    _IMPLICIT,  # in flight, and in contact
    _IMPLICIT_IN_CONTACT,
    _LOAD,  # of a link
    _SHARE,  # in flight, and in contact
    _SHARE_IN_CONTACT,
    _GAIN,  # in flight, and in contact
    _GAIN_IN_CONTACT,
    _INVERSE,  # one over the height of the layer's cells
    _STATIC,  # their strain at rest
    _LARGEST,  # magnitude of their strain
    _FIRST_LARGEST,
) = range(18)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')

_CORE = np.dtype(
    [
        # what stays
        ('step', 'f8'),
        ('last', 'i8'),  # node
        ('bottom', 'i8'),
        ('top', 'i8'),
        ('joint', 'i8'),
        ('face', 'i8'),
        ('face_mass', 'f8'),
        ('mass', 'f8'),  # of the projectile
        ('thrown', 'f8'),  # mass above the joint
        ('lossy', '?'),
        ('coupled', 'i8', (2, 2)),  # first and last link that share, in flight and in contact
        ('calming', 'f8', (2,)),  # viscosity of the links at both free ends, in flight
        ('massless', '?'),
        ('creep', 'f8'),  # of its free end in a step: what is left of the way
        # nodes and masses below and above the joint that meet as one, see `Grid.bodies`
        ('lowest', 'i8'),
        ('uppermost', 'i8'),
        ('lower_mass', 'f8'),
        ('upper_mass', 'f8'),
        ('weight', 'f8'),  # of what is thrown
        ('burden', 'f8'),  # of the projectile
        ('gravity', 'f8'),
        ('floor', 'f8'),  # contact force at which the projectile leaves: 0, less noise
        ('rest_height', 'f8'),
        ('edges', 'f8', (2,)),  # weights to extrapolate the strain to plate and top
        *PLATE,
        # where it has got to
        ('time', 'f8'),
        ('cell', 'i8'),  # step of the grid
        ('part', 'f8'),  # of it that has passed
        ('contact', '?'),
        ('events', 'i8'),
        ('full', '?'),  # of events, so that it stands still
        ('event_time', 'f8'),  # of the event in the last step, or of none
        ('forces', 'f8', (4,)),  # in the contact, the latest first
        ('known', 'i8'),  # of them
        ('lower', 'f8'),  # displacement of both sides of the joint one step ago
        ('upper', 'f8'),
        # forces of the layer on plate and projectile: a step ago, in the end, and after an event
        ('on_plate', 'f8', (3,)),
        ('on_projectile', 'f8', (3,)),
        # what was largest, and what was lost
        ('plate_strain', 'f8'),
        ('contact_strain', 'f8'),
        ('acceleration', 'f8'),
        ('plate_force', 'f8'),
        ('first_plate_strain', 'f8'),
        ('first_contact_strain', 'f8'),
        ('first_acceleration', 'f8'),
        ('first_plate_force', 'f8'),
        ('power', 'f8'),  # of the plate, and what turns to heat
        ('heating', 'f8'),
        ('work_before', 'f8'),  # a step ago
        ('loss_before', 'f8'),
        ('work', 'f8'),
        ('most_work', 'f8'),
        ('loss', 'f8'),
        ('highest', 'f8'),
        # at `time`
        ('surface', 'f8'),
        ('state', 'f8', (7,)),
    ],
    align=True,
)


@_jit
def _accelerate(s, nodes):
    """Work out the loads of all links and the accelerations of all nodes but the plate."""
    last, joint = s.last, s.joint
    A = _A + (s.cell & 1)
    case = 1 if s.contact else 0
    for j in range(last):
        nodes[_LOAD, j] = nodes[_STIFFNESS, j] * (nodes[_U, j + 1] - nodes[_U, j])
    if s.lossy:
        for j in range(last):
            nodes[_LOAD, j] += nodes[_VISCOSITY, j] * (nodes[_V, j + 1] - nodes[_V, j])
    if not s.contact:
        for side in range(2):
            j = joint - 1 + 2 * side
            if s.calming[side] > 0.0:
                nodes[_LOAD, j] += s.calming[side] * (nodes[_V, j + 1] - nodes[_V, j])
    for j in range(1, last):
        nodes[A, j] = nodes[_LOAD, j] - nodes[_LOAD, j - 1]
    nodes[A, last] = -nodes[_LOAD, last - 1]
    if not s.contact:
        nodes[A, joint + 1] -= s.weight
        if joint > 0:
            nodes[A, joint] += s.weight
    low, high = s.coupled[case, 0], s.coupled[case, 1]
    value = nodes[A, high + 1]
    for j in range(high, max(low, 1) - 1, -1):
        value = nodes[A, j] + nodes[_SHARE + case, j] * value
        nodes[A, j] = value
    for j in range(1, last + 1):
        nodes[A, j] *= nodes[_GAIN + case, j]
    value = nodes[A, low]
    for j in range(low, high + 1):
        value = nodes[A, j + 1] + nodes[_SHARE + case, j] * value
        nodes[A, j + 1] = value
    for j in range(low, high + 1):
        nodes[_LOAD, j] += nodes[_IMPLICIT + case, j] * (nodes[A, j + 1] - nodes[A, j])


@_jit
def _force_from_below(s, nodes, j, mass):
    """Compute the force on a node, and what is above it, that makes it accelerate as it does."""
    above = nodes[_LOAD, j] if j < s.last else 0.0
    return mass * nodes[_A + (s.cell & 1), j] - above


@_jit
def _drive(s, nodes, path):
    """Move the plate, and what goes with it."""
    A = _A + (s.cell & 1)
    stretch = s.lower - nodes[_U, 0]
    nodes[_U, 0], speed, nodes[A, 0] = motion_at(s, path, s.cell * s.step)
    nodes[_V, 0] = speed - 0.5 * s.step * nodes[A, 0]
    if s.contact and s.joint == 0:
        nodes[_U, 1], nodes[_V, 1] = nodes[_U, 0], nodes[_V, 0]
    elif s.massless and not s.contact:  # the free end creeps to where it has no load
        free = s.weight / nodes[_STIFFNESS, 0]
        nodes[_U, 1] = nodes[_U, 0] + free + (stretch - free) * s.creep
        nodes[_V, 1] = (nodes[_U, 1] - s.lower) / s.step
    return speed


@_jit
def _speed_of_thrown(s, nodes):
    """Compute the speed of the centre of mass of what is thrown, at the half step."""
    momentum = 0.0
    for j in range(s.joint + 1, s.last + 1):
        momentum += nodes[_MASS, j] * nodes[_V, j]
    return momentum / s.thrown


@_jit
def _note(s, events, kind, part, velocity):
    """Write down an event in the last step, if there is room."""
    if s.events == MAX_EVENTS:
        s.full = True
        return
    s.event_time = (s.cell - 1 + part) * s.step
    events[s.events, 0] = kind
    events[s.events, 1] = s.event_time
    events[s.events, 2] = velocity
    s.events += 1


@_jit
def _leave(s, nodes, events):
    """Let go, now that the force is below zero."""
    after, before = s.forces[0], s.forces[1]
    earlier, first = s.forces[2], s.forces[3]
    if s.known < 4:  # so short after a landing it is a line
        earlier, first = 2.0 * before - after, 3.0 * before - 2.0 * after
    part, impulse = release_within(after, before, earlier, first, s.weight)
    velocity = _speed_of_thrown(s, nodes) + s.step * impulse / s.thrown
    s.contact = False
    if s.events == 0:
        s.first_plate_strain, s.first_contact_strain = s.plate_strain, s.contact_strain
        s.first_acceleration, s.first_plate_force = s.acceleration, s.plate_force
        nodes[_FIRST_LARGEST] = nodes[_LARGEST]
    _note(s, events, 0.0, part, velocity)


@_jit
def _land(s, nodes, events):
    """Close the gap, now that it is negative."""
    j = s.joint
    u, v, before = nodes[_U], nodes[_V], nodes[_A + 1 - (s.cell & 1)]
    first, end = s.upper - s.lower, u[j + 1] - u[j]
    bend = 0.5 * s.step**2 * (before[j + 1] - before[j])
    low, high = 0.0, 1.0
    while True:
        part = 0.5 * (low + high)
        if not low < part < high:
            break
        if first + part * (end - first) - bend * part * (1.0 - part) < 0.0:
            high = part
        else:
            low = part
    velocity = _speed_of_thrown(s, nodes) - s.gravity * s.step * (part - 0.5)
    overlap, approach = u[j] - u[j + 1], v[j] - v[j + 1]
    part_above = 1.0
    if j > 0:
        part_above = s.lower_mass / (s.lower_mass + s.upper_mass)
        for k in range(s.lowest, j + 1):
            u[k] -= (1.0 - part_above) * overlap
            v[k] -= (1.0 - part_above) * approach
    else:
        s.work += s.upper_mass * approach * v[0]
    for k in range(j + 1, s.uppermost + 1):
        u[k] += part_above * overlap
        v[k] += part_above * approach
    s.contact = True
    s.known = 0
    _note(s, events, 1.0, part, velocity)


@_jit
def _march(s, nodes, path, events):
    """Advance by one step, or into one with more events than there is room for."""
    step, joint, last = s.step, s.joint, s.last
    before = _A + (s.cell & 1)
    s.lower, s.upper = nodes[_U, joint], nodes[_U, joint + 1]
    for j in range(1, last + 1):
        nodes[_V, j] += step * nodes[before, j]
        nodes[_U, j] += step * nodes[_V, j]
    s.cell += 1
    s.event_time = math.inf
    s.on_plate[0], s.on_projectile[0] = s.on_plate[2], s.on_projectile[2]
    s.work_before, s.loss_before = s.work, s.loss
    speed = _drive(s, nodes, path)
    lands = not s.contact and nodes[_U, joint + 1] < nodes[_U, joint]
    if lands:
        _land(s, nodes, events)
    _accelerate(s, nodes)
    _weigh(s, nodes)
    if lands:
        s.on_plate[1], s.on_projectile[1] = s.on_plate[0], s.on_projectile[0]
    else:
        s.on_plate[1], s.on_projectile[1] = s.on_plate[2], s.on_projectile[2]
    if s.contact and not lands and s.forces[0] < s.floor:
        _leave(s, nodes, events)
        _accelerate(s, nodes)
        _weigh(s, nodes)
    power = -s.on_plate[2] * speed
    s.work += 0.5 * step * (s.power + power)
    s.power = power
    s.most_work = max(s.most_work, s.work)
    s.highest = max(s.highest, nodes[_U, s.face])
    if s.lossy:
        heating = _heating(s, nodes)
        s.loss += 0.5 * step * (s.heating + heating)
        s.heating = heating
    _compare(s, nodes)


@_jit
def _weigh(s, nodes):
    """Work out the forces of the layer on plate and projectile, and that in the contact."""
    force = s.weight + _force_from_below(s, nodes, s.joint + 1, nodes[_MASS, s.joint + 1])
    if s.contact:
        for k in range(3, 0, -1):
            s.forces[k] = s.forces[k - 1]
        s.forces[0] = force
        s.known += 1
    pushed = _force_from_below(s, nodes, s.face, s.face_mass)
    s.on_projectile[2] = pushed + s.burden if s.contact or s.joint == 0 else 0.0
    if s.joint == 0:
        s.on_plate[2] = -force if s.contact else 0.0
    else:
        inertia = nodes[_MASS, 0] * nodes[_A + (s.cell & 1), 0]
        s.on_plate[2] = nodes[_LOAD, 0] - inertia - s.burden


@_jit
def _heating(s, nodes):
    """Compute the power that turns to heat in the layer."""
    A, half = _A + (s.cell & 1), 0.5 * s.step
    total = 0.0
    for j in range(s.last):
        rate = nodes[_V, j + 1] - nodes[_V, j] + half * (nodes[A, j + 1] - nodes[A, j])
        total += nodes[_VISCOSITY, j] * rate * rate
    return total


@_jit
def _compare(s, nodes):
    """Look if anything is larger than it has been."""
    bottom = s.bottom
    for i in range(s.top - bottom):
        stretch = nodes[_U, bottom + i + 1] - nodes[_U, bottom + i]
        strain = abs(stretch * nodes[_INVERSE, i] - nodes[_STATIC, i])
        nodes[_LARGEST, i] = max(nodes[_LARGEST, i], strain)
    s.plate_strain = max(s.plate_strain, abs(_edge_strain(s, nodes, 0)))
    s.contact_strain = max(s.contact_strain, abs(_edge_strain(s, nodes, 1)))
    s.acceleration = max(s.acceleration, (s.on_projectile[2] - s.burden) / s.mass)
    s.plate_force = max(s.plate_force, abs(s.on_plate[2]))


@_jit
def _edge_strain(s, nodes, end):
    """Extrapolate the strain to the plate (0) or the top (1)."""
    cells = s.top - s.bottom
    i = 0 if end == 0 else cells - 1
    strain = _strain(s, nodes, i)
    if s.edges[end] == 0.0:
        return strain
    return strain + s.edges[end] * (_strain(s, nodes, 1 if end == 0 else cells - 2) - strain)


@_jit
def _strain(s, nodes, i):
    """Compute the strain of cell i of the layer."""
    j = s.bottom + i
    return (nodes[_U, j + 1] - nodes[_U, j]) * nodes[_INVERSE, i] - nodes[_STATIC, i]


@_jit
def _advance(time, core, nodes, path, events):
    """Advance to `time`; the number of events so far, or what is wrong."""
    grid, s = core[0], core[1]
    if not time >= s.time:
        return BACKWARDS
    step = grid.step
    if time >= 4e15 * step:
        return TOO_FAR
    goal = int(time / step)
    while goal * step < time:
        goal += 1
    while goal > 0 and (goal - 1) * step >= time:
        goal -= 1
    if goal * step > grid.horizon:
        return BEYOND_HORIZON
    while grid.cell < goal and not grid.full:
        _march(grid, nodes, path, events)
    if grid.full:
        return TOO_MANY_EVENTS
    piece = s.piece  # the grid's may be further on
    core[1] = core[0]
    s.piece = piece
    s.time = time
    s.part = 1.0
    if goal > 0:
        s.part = min(max((time - (goal - 1) * step) / step, 0.0), 1.0)
    s.work = s.work_before + s.part * (s.work - s.work_before)
    s.loss = s.loss_before + s.part * (s.loss - s.loss_before)
    after = 2
    if time < s.event_time:  # the event is still to come
        if s.event_time < math.inf:
            s.contact = not s.contact
            s.events -= 1
        after = 1
    state = s.state
    state[TIME] = time
    state[PLATE_POSITION], state[PLATE_VELOCITY] = plate_at(s, path, time)
    height, state[PROJECTILE_VELOCITY] = _node(s, nodes, s.face)
    state[PROJECTILE_POSITION] = s.rest_height + height
    s.surface, _ = _node(s, nodes, s.top)
    weight = s.part if after == 1 else 1.0
    state[PLATE_FORCE] = s.on_plate[0] + weight * (s.on_plate[after] - s.on_plate[0])
    rise = s.on_projectile[after] - s.on_projectile[0]
    state[PROJECTILE_FORCE] = s.on_projectile[0] + weight * rise
    return s.events


@_jit
def _node(s, nodes, j):
    """Interpolate displacement and velocity of a node between the last two steps."""
    u, v = nodes[_U, j], nodes[_V, j]
    part, step = s.part, s.step
    if s.cell == 0:
        return u, v
    now = s.cell & 1
    old, new = nodes[_A + 1 - now, j], nodes[_A + now, j]
    before = u - step * v
    if j == s.joint:
        before = s.lower
    elif j == s.joint + 1:
        before = s.upper
    bend = old * (2.0 - part) + new * (1.0 + part)
    height = before + part * (u - before) - step * step * part * (1.0 - part) * bend / 6.0
    turn = old * (part - 0.5 * part * part - 0.375) + new * (0.5 * part * part - 0.125)
    return height, v + step * turn


@_jit
def _read_field(core, nodes, table, strain, velocity):
    """Read strain and velocity of the layer from plate to top."""
    s = core[1]
    cells, weights = table
    for n in range(strain.size):
        i, beside, j = cells[0, n], cells[1, n], cells[2, n]
        strain[n] = _strain_now(s, nodes, i)
        if weights[0, n] != 0.0:
            strain[n] += weights[0, n] * (_strain_now(s, nodes, beside) - strain[n])
        below = _node(s, nodes, j)[1] if j > 0 else s.state[PLATE_VELOCITY]
        above = _node(s, nodes, j + 1)[1]
        velocity[n] = below + weights[1, n] * (above - below)


@_jit
def _strain_now(s, nodes, i):
    """Interpolate the strain of cell i of the layer in time."""
    j = s.bottom + i
    below = _node(s, nodes, j)[0] if j > 0 else s.state[PLATE_POSITION]
    return (_node(s, nodes, j + 1)[0] - below) * nodes[_INVERSE, i] - nodes[_STATIC, i]


@_jit
def _sample_field(times, out, needs, core, nodes, path, events):
    """Advance through `times` and write the strain at each into a row; the last row and status."""
    velocity, table = needs
    for row in range(times.size):
        status = _advance(times[row], core, nodes, path, events)
        if status < 0:
            return row, status
        _read_field(core, nodes, table, out[row], velocity)
    return times.size, 0


@_jit
def _stored_energy(core, nodes):
    """Sum up the energy of layer and projectile against rest."""
    s = core[1]
    below, speed = s.state[PLATE_POSITION], s.state[PLATE_VELOCITY]
    total = 0.5 * nodes[_MASS, 0] * speed * speed + s.weight * below
    for j in range(s.last):
        above, speed = _node(s, nodes, j + 1)
        stretch = above - below
        total += 0.5 * (nodes[_STIFFNESS, j] * stretch * stretch)
        total += 0.5 * (nodes[_MASS, j + 1] * speed * speed)
        if j == s.joint:
            total += s.weight * stretch
        below = above
    return total


@_jit
def _reset(core, nodes, path):
    """Put everything back to rest."""
    core[0] = core[2]
    s = core[0]
    for row in (_U, _V, _A, _A_ODD, _LOAD, _FIRST_LARGEST):
        nodes[row] = 0.0
    for i in range(s.top - s.bottom):
        nodes[_LARGEST, i] = abs(nodes[_STATIC, i])
    speed = _drive(s, nodes, path)
    _accelerate(s, nodes)
    _weigh(s, nodes)
    # the plate has not moved yet, whatever its acceleration
    s.on_plate[:] = -s.weight if s.joint == 0 else -s.burden
    s.on_projectile[:] = s.burden
    s.power = -s.on_plate[2] * speed
    if s.joint == 0:
        nodes[_V, 1] = speed
    core[1] = core[0]


@_jit
def _feed(core, path, times, values, of_positions):
    """Take in measured samples of the plate."""
    take_samples(core[0], path, times, values, of_positions)
    core[1].horizon = core[0].horizon


@_jit
def _feed_states(core, path, times, states):
    """Take in states of the plate."""
    take_states(core[0], path, times, states)
    core[1].horizon = core[0].horizon


def cells_per_layer(rig: Rig, model: str = 'finite_difference') -> int:
    r"""
    Choose how many cells the layer takes in real time, or refuse what cannot be done.

    Parameters
    ----------
    rig : Rig
        The rig.
    model : str
        One of `models.ON_GRIDS`.

    Returns
    -------
    int
        At least 64, 4 per relaxation time :math:`\tau`, and so many that there are 80 steps in a
        period of the plate. For a layer without mass 1.

    Raises
    ------
    ValueError
        If more than `MAX_CELLS` would be needed, or more updates than `MAX_UPDATE_RATE`; it says
        which number, which limit and what would do.

    Examples
    --------
    >>> cells_per_layer(Rig())
    64

    """
    _check_model(model)
    if model == 'spring_mass':
        rate = 3.0 / _spring_step(rig)
        if rate > MAX_UPDATE_RATE:
            raise ValueError(
                f'a projectile that swings at {rig.natural_frequency:.4g} Hz on its layer needs '
                f'{rate:.3g} updates per second, the limit is {MAX_UPDATE_RATE:g}; feasible: '
                f'layer.wave_speed of {rig.layer.wave_speed * MAX_UPDATE_RATE / rate:.4g} m/s'
            )
        return 1
    layer, crossing = rig.layer, rig.crossing_time
    per_cell = 1.0
    if model == 'finite_difference_elastic':
        per_cell += max(rig.crossing_ratio, 2.0 / _MIN_CELLS)
        modulus = rig.projectile.youngs_modulus
        if rig.crossing_ratio > _SLOWEST:
            stiffer = modulus * (rig.crossing_ratio / _SLOWEST) ** 2
            raise ValueError(
                f'projectile.youngs_modulus {modulus:g} Pa needs {rig.crossing_ratio:.3g} times '
                f'the cells of the layer, the limit is {_SLOWEST:g}; '
                f'feasible: projectile.youngs_modulus of {1.001 * stiffer:.4g} Pa or more'
            )
    rate = MAX_UPDATE_RATE * crossing / per_cell
    limit = min(MAX_CELLS, math.floor(math.sqrt(rate)))
    if limit < _MIN_CELLS:
        longer = _MIN_CELLS**2 / rate
        raise ValueError(
            f'layer.thickness {layer.thickness:g} m at layer.wave_speed {layer.wave_speed:g} m/s '
            f'needs {MAX_UPDATE_RATE * longer:.3g} updates of cells per second, the limit is '
            f'{MAX_UPDATE_RATE:g}; feasible: layer.thickness of '
            f'{1.001 * layer.thickness * longer:.4g} m or more, or layer.wave_speed of '
            f'{0.999 * layer.wave_speed / longer:.4g} m/s or less'
        )
    for_mass = math.ceil(_CELLS_PER_RELAXATION / rig.mass_ratio)
    if for_mass > limit:
        least = rig.projectile.mass * for_mass / limit
        raise ValueError(
            f'projectile.mass {rig.projectile.mass:g} kg on a layer of {layer.mass:.4g} kg needs '
            f'{for_mass} cells, the limit is {limit}; '
            f'feasible: projectile.mass of {1.001 * least:.4g} kg or more'
        )
    for_plate = math.ceil(_STEPS_PER_PERIOD * crossing * rig.engine.frequency)
    if for_plate > limit:
        most = rig.engine.frequency * limit / for_plate
        raise ValueError(
            f'engine.frequency {rig.engine.frequency:g} Hz with a crossing time of '
            f'{crossing:.4g} s needs {for_plate} cells, the limit is {limit}; '
            f'feasible: engine.frequency of {0.999 * most:.4g} Hz or less'
        )
    return max(_MIN_CELLS, for_mass, for_plate)


def _check_model(model: str) -> None:
    """Raise ValueError for a model that is unknown."""
    if model not in ON_GRIDS:
        raise ValueError(f'model must be one of {", ".join(ON_GRIDS)}, got {model!r}')


def _spring_step(rig: Rig) -> float:
    """Choose the time step of a layer without mass. [s]"""
    return 1.0 / (_SPRING_STEPS * max(rig.engine.frequency, rig.natural_frequency))


class GridStepper(ThrowStepper):
    """
    A throw by finite differences in real time.

    Parameters
    ----------
    rig : Rig
        The rig, with any layer.
    motion : Underdamped, Sampled, 'measured' or None
        How the plate moves; None is `Underdamped.of(rig.engine)`, 'measured' waits for `feed`.
        A sampled motion must not begin before time 0.
    model : str
        One of `models.ON_GRIDS`: with a rigid projectile (default), with an elastic one, with the
        layer glued to the (rigid) projectile, or without mass in the layer.
    cells : int, optional
        Of the layer, 1 to `MAX_CELLS`, however long they take; the default is `cells_per_layer`.
    step : float, optional
        Time step; the longest stable one if not given. [s]
    field_points : int
        Heights at which `read_field` and `sample_field` give the layer, 2 or more.

    Attributes
    ----------
    grid : Grid
        The cells.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time (see `cells_per_layer`), the step is too long to
        be stable, or an argument is out of range.

    Notes
    -----
    See the module for the scheme, and `ThrowStepper` for what all models in real time promise.
    An event carries the velocity of the centre of mass of what is thrown, and `state` that of the
    projectile's lower face. `stored_energy` and `dissipated` add up to `work` to second order,
    and to first after landings. Peaks are those at grid points, of which the last may be a step
    ahead.

    Examples
    --------
    A layer with internal loss:

    >>> from soft_throw_ros.core.rig import Layer
    >>> stepper = GridStepper(Rig(layer=Layer(loss_tangent=0.05)))
    >>> stepper.advance_to(0.010)
    1
    >>> [release] = stepper.events()
    >>> f'{release.kind} after {1e3 * release.time:.3f} ms with {release.velocity:.3f} m/s'
    'release after 7.336 ms with 1.301 m/s'

    """

    _advance = staticmethod(_advance)
    _sample = staticmethod(_sample_field)
    _changing = ('_core', '_nodes')

    def __init__(
        self,
        rig: Rig,
        motion: PlateMotion | Literal['measured'] | None = None,
        *,
        model: str = 'finite_difference',
        cells: int | None = None,
        step: float | None = None,
        field_points: int = 64,
    ) -> None:
        _check_model(model)
        super().__init__(rig, field_points)
        if cells is None:
            cells = cells_per_layer(rig, model)
        else:
            checked_count('cells', cells, low=1, high=MAX_CELLS)
        if model == 'spring_mass':
            self.grid = massless(rig, step=_spring_step(rig) if step is None else step)
        else:
            self.grid = cut(
                rig,
                cells=cells,
                step=step,
                is_elastic=model == 'finite_difference_elastic',
                glued_to='projectile' if model == 'finite_difference_glued' else 'plate',
            )
        self.model = model
        self._core = np.zeros(3, _CORE)
        self._nodes = self._make_nodes()
        self._table = self._make_table()
        self._prepare()
        self._is_fed = motion == 'measured'
        self._path = write_motion(self._core[2], motion, rig.engine)
        self._memory = (self._core, self._nodes, self._path, self._events)
        self._scratch = (np.zeros(field_points), self._table)
        self.state = self._core['state'][1]
        self.state.flags.writeable = False
        self.reset()

    def _make_nodes(self) -> Floats:
        """Return the table of nodes and links."""
        grid, rig = self.grid, self.rig
        nodes = np.zeros((_FIRST_LARGEST + 1, grid.mass.size))
        nodes[_MASS] = grid.mass
        nodes[_STIFFNESS, :-1] = grid.stiffness
        nodes[_VISCOSITY, :-1] = grid.viscosity
        for in_contact in (False, True):
            nodes[_IMPLICIT + in_contact, :-1] = grid.implicit_masses(in_contact=in_contact)
            share, gain = grid.factors(in_contact=in_contact)
            nodes[_SHARE + in_contact, :-1] = share
            nodes[_GAIN + in_contact] = gain
        inverse = 1.0 / np.diff(grid.heights)
        springs = grid.stiffness[grid.bottom : grid.bottom + grid.cells]
        nodes[_INVERSE, : grid.cells] = inverse
        burden = np.full(grid.cells, rig.projectile.mass)
        if grid.bottom > 0:  # what is thrown along bears its own weight, too
            burden = np.cumsum(grid.mass[::-1])[::-1][grid.bottom + 1 : grid.top + 1]
        nodes[_STATIC, : grid.cells] = burden * rig.gravity / springs * inverse
        return nodes

    def _make_table(self) -> tuple[NDArray[np.int64], Floats]:
        """Return the cells, nodes and weights to read strain and velocity from."""
        points = np.linspace(0.0, self.grid.heights[-1], self.field_points)
        rows = [self.grid.neighbours(height) for height in points.tolist()]
        cells = np.array([[i, beside, self.grid.bottom + i] for i, beside, _, _ in rows])
        return cells.T.copy(), np.array([row[2:] for row in rows]).T.copy()

    def _prepare(self) -> None:
        """Write the record that `reset` goes back to."""
        grid, rig = self.grid, self.rig
        start = self._core[2]
        start['step'] = grid.step
        start['last'] = grid.mass.size - 1
        start['bottom'], start['top'] = grid.bottom, grid.top
        start['joint'], start['face'] = grid.joint, grid.face
        start['face_mass'] = grid.face_mass
        start['mass'] = rig.projectile.mass
        start['thrown'] = grid.thrown_mass
        start['lossy'] = grid.viscosity.any()
        start['calming'] = grid.calming
        for in_contact in (False, True):
            sharing = np.flatnonzero(self._nodes[_SHARE + in_contact])
            start['coupled'][int(in_contact)] = sharing[[0, -1]] if sharing.size else (0, -1)
        start['massless'] = grid.joint > 0 and grid.mass[grid.joint] == 0.0
        if start['massless'] and start['lossy']:
            start['creep'] = math.exp(-grid.stiffness[0] / grid.viscosity[0] * grid.step)
        start['lowest'], start['uppermost'] = bodies = grid.bodies()
        start['lower_mass'] = grid.mass[bodies[0] : grid.joint + 1].sum()
        start['upper_mass'] = grid.mass[grid.joint + 1 : bodies[1] + 1].sum()
        start['weight'] = grid.thrown_mass * rig.gravity
        start['burden'] = rig.projectile.mass * rig.gravity
        start['gravity'] = rig.gravity
        start['floor'] = -_NOISE * rig.engine.speed_scale * rig.layer.impedance
        sag = self._nodes[_STATIC, : grid.cells] @ np.diff(grid.heights)
        start['rest_height'] = rig.layer.thickness - sag
        start['edges'] = [grid.neighbours(height)[2] for height in (0.0, grid.heights[-1])]
        start['contact'] = True
        start['event_time'] = math.inf
        static = self._nodes[_STATIC, [0, grid.cells - 1]]
        start['plate_strain'], start['contact_strain'] = static
        start['plate_force'] = start['weight']

    def _put_to_rest(self) -> None:
        _reset(self._core, self._nodes, self._path)

    def _take_samples(self, times: Floats, values: Floats, of_positions: bool) -> None:
        _feed(self._core, self._path, times, values, of_positions)

    def _take_states(self, times: Floats, states: Floats) -> None:
        _feed_states(self._core, self._path, times, states)

    def _read_field(self, strain: Floats, velocity: Floats) -> None:
        _read_field(self._core, self._nodes, self._table, strain, velocity)

    @property
    def horizon(self) -> float:
        """Until when `advance_to` can go: the last step at which the plate is known. [s]"""
        known, step = float(self._core['horizon'][0]), self.grid.step
        if math.isinf(known):
            return known
        steps = int(known / step)
        while steps * step > known:
            steps -= 1
        return steps * step

    def _peaks(self, prefix: str) -> Peaks:
        now = self._core[1]
        return Peaks(*(float(now[f'{prefix}{name}']) for name in Peaks._fields))

    @property
    def peak_strain(self) -> float:
        """Largest magnitude of the strain so far, anywhere in the layer. [-]"""
        return self._peak_strain(_LARGEST, self.peaks)

    @property
    def first_peak_strain(self) -> float:
        """Largest magnitude of the strain up to the first release. [-]"""
        return self._peak_strain(
            _FIRST_LARGEST if self.event_count else _LARGEST, self.first_peaks
        )

    def _peak_strain(self, row: int, peaks: Peaks) -> float:
        inside = float(self._nodes[row, : self.grid.cells].max())
        return max(inside, peaks.plate_strain, peaks.contact_strain)

    @property
    def work(self) -> float:
        """Work of the plate so far, by the trapezoidal rule. [J]"""
        return float(self._core[1]['work'])

    @property
    def peak_work(self) -> float:
        """Largest work of the plate so far: what the engine has to have handed out. [J]"""
        return float(self._core[1]['most_work'])

    @property
    def dissipated(self) -> float:
        """Energy that the layer has turned to heat so far, by the trapezoidal rule. [J]"""
        return float(self._core[1]['loss'])

    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, at the present time. [J]"""
        return float(_stored_energy(self._core, self._nodes))


def warm_up() -> None:
    """Compile or load all kernels."""
    stepper = GridStepper(Rig(), 'measured', field_points=2)
    stepper.feed(np.arange(8.0), velocities=np.zeros(8))
    stepper.advance_to(stepper.horizon / 1024.0)
    stepper.read_field(np.empty(2), np.empty(2))
    stepper.sample_field(np.array([stepper.state[TIME]]), np.empty((1, 2)))
    stepper.stored_energy()
    stepper.reset()
    stepper.feed_states(np.arange(2.0), np.zeros((2, 3)))
    stepper.scout().depart(stepper)
