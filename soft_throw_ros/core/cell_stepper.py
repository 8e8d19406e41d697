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
Cells of finite size: layers with loss, stacks, elastic projectiles, layers on the projectile.

Notes
-----
Eqs. (2)-(3) of [1]_, :math:`\rho u_{tt} = \sigma_y`, with the Kelvin-Voigt stress
:math:`\sigma = E u_y + \eta u_{ty}`, on the nodes of `soft_throw_ros.core.cells`. Displacements u
belong to whole steps, velocities v to half steps, so that semi-implicit Euler is of second order,

.. math::

    M a^n = -K (u^n + \beta h^2 a^n) - C \frac{v^{n+1/2} + v^{n-1/2}}{2}, \qquad
    v^{n+1/2} = v^{n-1/2} + h a^n, \qquad u^{n+1} = u^n + h v^{n+1/2}.

:math:`\beta` is 0 but in cells that a wave crosses in less than a step h, where 1/4 (average
acceleration) keeps the scheme stable. What is implicit is one tridiagonal system with constant
coefficients. All counts from the static equilibrium; the weight of the layer is left out as in
[1]_, unless it is thrown along.

In contact the two nodes of the joint move as one. The force between them is inertia and stress of
what is above, and the projectile leaves when it falls below zero, at the root of the cubic through
four steps. After that the nodes are free of each other, and of the weight. In the cell at each
free end a dashpot takes away what the release leaves there in turns from step to step; in one cell
it is a change of second order.

They meet again when the gap is closed at the end of a step; from there on they are where momentum
puts them, at the common velocity. That is how two waves meet half a cell later, so that events
after a landing are of second order, too, though a landing is a jump.

The grid is up to one step ahead of the time that is asked for, and the state is interpolated
between its last two steps (third order). So with a measured plate it can go as far as the last
whole step before what is known.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

from functools import partial
import math
from typing import Literal

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.batch import broadcast_ratios, in_threads
from soft_throw_ros.core.cells import (
    BURDEN,
    crossing_time,
    CURVATURE,
    cut,
    DISPLACEMENT,
    factorise,
    FORCE,
    INVERSE,
    LARGEST,
    LEAST,
    LENGTH,
    make_bodies,
    make_grid,
    make_massless_grid,
    MASS,
    MEAN_VELOCITY,
    MEMORY,
    OFFSET,
    POSITION,
    PULL,
    REST,
    ROWS,
    SHOCK,
    SHORTEST,
    solve,
    SOLVER,
    SPEED,
    SPRING,
    STATIC,
    STIFF,
    STIFFNESS,
    STRENGTH,
    STRESS,
    STRETCH,
    VELOCITY,
    VISCOSITY,
)
from soft_throw_ros.core.kernels import compiled, inlined, kernel, part, reduction
from soft_throw_ros.core.material import RELAXATION_RATES, static_stretch
from soft_throw_ros.core.models import CELL_MODELS
from soft_throw_ros.core.plate import PlateMotion, SampledMotion
from soft_throw_ros.core.plate_kernels import (
    BLOCK,
    DAMPED,
    motion_at,
    PLATE,
    start_block,
    write_underdamped,
)
from soft_throw_ros.core.rig import Rig, Stack
from soft_throw_ros.core.stepper import (
    BACKWARDS,
    BEYOND_HORIZON,
    FirstThrows,
    LANDING,
    load_kernels,
    Loads,
    note_event,
    PLATE_FORCE,
    PLATE_POSITION,
    PLATE_VELOCITY,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    RECONTACT,
    RELEASE,
    require_count,
    Stepper,
    TIME,
    TOO_FAR,
    TOO_MANY_EVENTS,
)

Floats = NDArray[np.float64]

MAX_CELLS = 4096
"""Most cells of a layer."""

MAX_UPDATE_RATE = 4e7
"""Most cells times steps in a second of rig time; a processor takes 3e8 and more. [1/s]"""

MAX_PERIODS = 16.0
"""Plate periods, and periods of the projectile on the layer, in which `first_throws` waits."""

MAX_CROSSINGS = 4096.0
"""Crossings of the wave in which `first_throws` waits at most."""

MAX_CROSSING_RATIO = 32.0
"""Slowest projectile of `first_throws`: it has as many times more cells than the layer."""

_CELLS = 64
_USUAL_NODES = _CELLS + 2
_CELLS_PER_RELAXATION = 12.0  # for 1e-4 in the speed, if there is time for it, ...
_FEWEST_PER_RELAXATION = 4.0  # and for 1e-3
_STEPS_PER_PERIOD = 120.0
_FEWEST_PER_PERIOD = 80.0
_SLOWEST = 8.0  # projectile in real time, whose waves take so many times longer than the layer's
_UPDATE_COST = 4e-9  # of a cell in a step, of a processor [s]
_SPRING_STEPS = 1000.0  # of a layer without mass, per period of plate or projectile
_MOST_FOR_BATCH = 1024  # cells that `first_throws` chooses
_FASTEST = 0.05  # shock in a cell, in cells per step, so that what is explicit is stable
_THROWS_PER_THREAD = 16

_NOISE = 1e-11  # of the plate's speed, as a wave: a force below it is rounding, and no pull

# Three such records make a stepper: the first is at a step of the grid, the second at the time
# asked for; the third is what both are reset to. Where two values stand for one, they are those
# below and above the joint, or at the plate and at the top of the layer.
_CORE = np.dtype(
    [
        # what stays
        ('step', 'f8'),
        ('rate', 'f8'),  # 2 / step
        ('cells', 'i8'),  # of the layer
        ('bottom', 'i8'),  # its lowest node
        ('joint', 'i8'),
        ('is_lossy', '?'),
        ('is_viscous', '?'),
        ('is_massless', '?'),
        ('is_curved', '?'),  # whether a sheet is neo-Hookean
        ('fastest_shock', 'f8'),  # change of velocity in a cell up to which viscosity grows
        ('remembers', '?'),  # whether there are Maxwell elements
        ('relaxation', 'f8', (3,)),  # their rates,
        ('keep', 'f8', (3,)),  # and what they keep of their stretch, and take of a new one
        ('take', 'f8', (3,)),
        ('creep', 'f8'),  # stiffness over viscosity, with which a free end without mass creeps
        ('mass', 'f8'),  # of the projectile
        ('face_mass', 'f8'),  # its part of the mass of its lowest node
        ('thrown', 'f8'),  # mass above the joint
        ('gravity', 'f8'),
        ('release_threshold', 'f8'),  # contact force at which the projectile leaves: 0, less noise
        ('rest_height', 'f8'),  # of the projectile's lower face
        (
            'edge_cells',
            'i8',
            (2, 2),
        ),  # to extrapolate the strain to plate and top, as `Cells.place`
        ('edge_weights', 'f8', (2,)),
        ('bodies', 'i8', (2,)),  # outermost nodes that meet as one in a collision
        ('body_masses', 'f8', (2,)),
        *SOLVER,
        # how the plate moves, and where it has got to
        *PLATE,
        ('slope', 'f8'),  # growth over turn
        ('plate_acceleration', 'f8'),
        # where the grid has got to
        ('time', 'f8'),
        ('index', 'i8'),  # of the step
        ('part', 'f8'),  # of it that has passed
        ('contact', '?'),
        ('landed', '?'),
        ('events', 'i8'),
        ('event_time', 'f8'),  # of the event in the last step, or of none
        ('event_velocity', 'f8'),
        ('force', 'f8'),  # in the contact: now, and at the three steps before
        ('force_1', 'f8'),
        ('force_2', 'f8'),
        ('force_3', 'f8'),
        ('known_forces', 'i8'),
        ('below_before', 'f8'),  # displacements of the joint's nodes a step ago
        ('above_before', 'f8'),
        # forces of the layer on plate and projectile: a step ago, in the end, and after an event
        ('on_plate_before', 'f8'),
        ('on_plate_until', 'f8'),
        ('on_plate_now', 'f8'),
        ('on_projectile_before', 'f8'),
        ('on_projectile_until', 'f8'),
        ('on_projectile_now', 'f8'),
        # loads up to the first release
        ('edge_strains', 'f8', (2,)),
        ('acceleration', 'f8'),
        ('plate_force', 'f8'),
        ('first_work', 'f8'),
        # energy
        ('power', 'f8'),
        ('heating', 'f8'),
        ('strain_heating', 'f8'),  # of Maxwell elements and shocks
        ('work_before', 'f8'),  # a step ago
        ('heat_before', 'f8'),
        ('work', 'f8'),
        ('heat', 'f8'),
        # at `time`
        ('surface', 'f8'),
        ('state', 'f8', (7,)),
    ],
    align=True,
)

_PLACE = np.dtype([('cell', 'i8'), ('beside', 'i8'), ('weight', 'f8'), ('part', 'f8')])
"""From where to read the layer at a height, see `Cells.place`."""


def cells_per_layer(rig: Rig, model: str = 'finite_difference') -> int:
    r"""
    Choose how many cells the layer takes in real time, or refuse what cannot be done.

    Returns
    -------
    int
        At least 64; 12 per relaxation time and 120 steps in a period of the plate, or as many
        as there is time for. Errors are 1e-4, then. For a layer without mass 1.

    Raises
    ------
    ValueError
        If `MAX_CELLS` or `MAX_UPDATE_RATE` are too few for 64 cells, 4 per relaxation time and 80
        steps in a period, with what would do.

    Examples
    --------
    >>> cells_per_layer(Rig())
    64

    """
    _require_model(model)
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
        per_cell += max(rig.crossing_ratio, 2.0 / _CELLS)
        modulus = rig.projectile.youngs_modulus
        if rig.crossing_ratio > _SLOWEST:
            stiffer = modulus * (rig.crossing_ratio / _SLOWEST) ** 2
            raise ValueError(
                f'projectile.youngs_modulus {modulus:g} Pa needs {rig.crossing_ratio:.3g} times '
                f'the cells of the layer, the limit is {_SLOWEST:g}; '
                f'feasible: projectile.youngs_modulus of {1.001 * stiffer:.4g} Pa or more'
            )
    rate = MAX_UPDATE_RATE * crossing_time(rig) / per_cell
    limit = min(MAX_CELLS, math.floor(math.sqrt(rate)))
    if limit < _CELLS:
        longer = _CELLS**2 / rate
        raise ValueError(
            f'layer.thickness {layer.thickness:g} m at layer.wave_speed {layer.wave_speed:g} m/s '
            f'needs {MAX_UPDATE_RATE * longer:.3g} updates of cells per second, the limit is '
            f'{MAX_UPDATE_RATE:g}; feasible: layer.thickness of '
            f'{1.001 * layer.thickness * longer:.4g} m or more, or layer.wave_speed of '
            f'{0.999 * layer.wave_speed / longer:.4g} m/s or less'
        )
    for_mass = math.ceil(_FEWEST_PER_RELAXATION / rig.mass_ratio)
    if for_mass > limit:
        least = rig.projectile.mass * for_mass / limit
        raise ValueError(
            f'projectile.mass {rig.projectile.mass:g} kg on a layer of {layer.mass:.4g} kg needs '
            f'{for_mass} cells, the limit is {limit}; '
            f'feasible: projectile.mass of {1.001 * least:.4g} kg or more'
        )
    periods = crossing * rig.engine.frequency
    for_plate = math.ceil(_FEWEST_PER_PERIOD * periods)
    if for_plate > limit:
        most = rig.engine.frequency * limit / for_plate
        raise ValueError(
            f'engine.frequency {rig.engine.frequency:g} Hz with a crossing time of '
            f'{crossing:.4g} s needs {for_plate} cells, the limit is {limit}; '
            f'feasible: engine.frequency of {0.999 * most:.4g} Hz or less'
        )
    wanted = max(_CELLS_PER_RELAXATION / rig.mass_ratio, _STEPS_PER_PERIOD * periods)
    return min(max(_CELLS, math.ceil(min(wanted, MAX_CELLS))), limit)


def _require_model(model: str) -> None:
    """Raise ValueError for a model that is unknown."""
    if model not in CELL_MODELS:
        raise ValueError(f'model must be one of {", ".join(CELL_MODELS)}, got {model!r}')


def _spring_step(rig: Rig) -> float:
    """Choose the time step of a layer without mass [s]."""
    return 1.0 / (_SPRING_STEPS * max(rig.engine.frequency, rig.natural_frequency))


@part
def _choose_system(s):
    """Choose the equations of contact or of flight."""
    system = s.systems[1 if s.contact else 0]
    s.known, s.first, s.end, s.middle = system[0], system[1], system[2], system[3]


@kernel
def _prepare(core, nodes, bodies, omega):
    """Complete a record at rest from step, cells, masses and gravity, and cut the bodies."""
    s = core[2]
    cut(nodes, bodies, s.bottom, s.cells, s.mass, s.step)
    last, joint, top = nodes.shape[1] - 1, s.joint, s.bottom + s.cells
    s.rate = 2.0 / s.step
    s.event_time = s.fastest_shock = math.inf
    s.slope = s.growth / s.turn if s.plate_kind == DAMPED else 0.0
    s.is_massless = joint > 0 and nodes[MASS, joint] == 0.0
    for j in range(last):
        nodes[VISCOSITY + 1, j] = nodes[VISCOSITY, j]
        s.is_curved = s.is_curved or nodes[CURVATURE, j] > 0.0
        nodes[SPRING, j] = nodes[STIFFNESS, j]
        nodes[LENGTH, j] = nodes[SHORTEST, j] = 1.0  # so that nothing is divided by zero
        for element in range(3):
            s.remembers = s.remembers or nodes[STRENGTH + element, j] > 0.0
        s.is_viscous = s.is_viscous or nodes[VISCOSITY, j] > 0.0
    s.is_lossy = s.is_viscous or s.is_curved or s.remembers
    for element in range(3):
        s.relaxation[element] = RELAXATION_RATES[element] * omega
        half = 0.5 * s.step * s.relaxation[element]
        s.keep[element], s.take[element] = (1.0 - half) / (1.0 + half), 1.0 / (1.0 + half)
    s.creep = math.inf
    if s.is_massless and s.is_viscous:
        s.creep = nodes[STIFFNESS, 0] / nodes[VISCOSITY, 0]
    # What takes half of the momentum of a free end in half a step ends its alternation at once
    if joint > 0:
        nodes[VISCOSITY, joint - 1] += 2.0 / s.step * nodes[MASS, joint]
    if joint + 2 <= last:
        nodes[VISCOSITY, joint + 1] += 2.0 / s.step * nodes[MASS, joint + 1]
    for case in range(2):
        given = s.is_massless if case == 0 else joint == 0
        factorise(s, nodes, s.step, joint, 1 if given else 0, case)
    s.contact = True
    _choose_system(s)
    # A jump of stress in a stiff cell is levelled out long before the step ends: nodes that only
    # such cells part meet as one.
    s.bodies[0], s.bodies[1] = joint, joint + 1
    while s.bodies[0] > 1 and nodes[STIFF, s.bodies[0] - 1] > 0.0:
        s.bodies[0] -= 1
    while s.bodies[1] < last and nodes[STIFF, s.bodies[1]] > 0.0:
        s.bodies[1] += 1
    for j in range(s.bodies[0], s.bodies[1] + 1):
        s.body_masses[0 if j <= joint else 1] += nodes[MASS, j]
    for j in range(joint + 1, last + 1):
        s.thrown += nodes[MASS, j]
    # At rest every cell carries the projectile, and what of the layer is thrown along
    carried = s.mass * s.gravity
    for j in range(top - 1, s.bottom - 1, -1):
        if s.bottom > 0:
            own = nodes[MASS, j + 1] - (s.face_mass if j + 1 == top else 0.0)
            carried += own * s.gravity
        nodes[BURDEN, j] = carried
        if nodes[CURVATURE, j] > 0.0:
            nodes[STATIC, j] = 1.0 - static_stretch(carried / nodes[CURVATURE, j])
            s.fastest_shock = min(s.fastest_shock, _FASTEST / (nodes[INVERSE, j] * s.step))
            inverse = nodes[INVERSE, j]
            nodes[SPRING, j] = nodes[CURVATURE, j] * inverse
            nodes[PULL, j] = nodes[CURVATURE, j] / (inverse * inverse)
            nodes[LENGTH, j] = (1.0 - nodes[STATIC, j]) / inverse
            nodes[SHORTEST, j] = nodes[LEAST, j] / inverse
            nodes[OFFSET, j] = nodes[PULL, j] * _inverse_square(nodes[LENGTH, j], 0.0)
        else:
            nodes[STATIC, j] = carried / nodes[STIFFNESS, j] * nodes[INVERSE, j]
    for j in range(s.bottom, top):
        nodes[REST, j + 1] = nodes[REST, j] + (1.0 - nodes[STATIC, j]) / nodes[INVERSE, j]
    s.rest_height = nodes[REST, top]
    s.edge_strains[0], s.edge_strains[1] = nodes[STATIC, s.bottom], nodes[STATIC, top - 1]
    s.plate_force = s.thrown * s.gravity


@inlined
def _strain(s, nodes):
    """Compute the elastic tension of all links, and what that alone turns to heat."""
    stress = STRESS + (s.index & 1)
    s.strain_heating = 0.0
    if s.is_curved:
        s.strain_heating = _strain_curved(s, nodes)
    else:
        for j in range(nodes.shape[1] - 1):  # the material: elastic tension from stretch
            stretch = nodes[DISPLACEMENT, j + 1] - nodes[DISPLACEMENT, j]
            nodes[stress, j] = nodes[STIFFNESS, j] * stretch
    if s.remembers:
        s.strain_heating += _remember(s, nodes)


@inlined
def _inverse_square(length, shortest):
    """Compute one over the square of a length, and below the shortest along the tangent."""
    inverse = 1.0 / max(length, shortest)
    ratio = length * inverse
    return inverse * inverse * (3.0 - (ratio + ratio))


@reduction
def _strain_curved(s, nodes):
    """Compute the tension of linear and neo-Hookean links; the power of shocks, to a tenth."""
    stress, total, fastest = STRESS + (s.index & 1), 0.0, -s.fastest_shock
    for j in range(nodes.shape[1] - 1):
        stretch = nodes[DISPLACEMENT, j + 1] - nodes[DISPLACEMENT, j]
        pull = nodes[PULL, j] * _inverse_square(nodes[LENGTH, j] + stretch, nodes[SHORTEST, j])
        closing = min(nodes[VELOCITY, j + 1] - nodes[VELOCITY, j], 0.0)
        shock = nodes[SHOCK, j] * closing * max(closing, fastest)
        nodes[stress, j] = nodes[SPRING, j] * stretch + (nodes[OFFSET, j] - pull) - shock
        total -= shock * closing
    return total


@reduction
def _remember(s, nodes):
    """Add the tension of the Maxwell elements, by the trapezoidal rule; their power of heat."""
    stress, heat_0, heat_1, heat_2 = STRESS + (s.index & 1), 0.0, 0.0, 0.0
    keep_0, keep_1, keep_2 = s.keep[0], s.keep[1], s.keep[2]
    take_0, take_1, take_2 = s.take[0], s.take[1], s.take[2]
    for j in range(nodes.shape[1] - 1):
        stretch = nodes[DISPLACEMENT, j + 1] - nodes[DISPLACEMENT, j]
        change = stretch - nodes[STRETCH, j]
        nodes[STRETCH, j] = stretch
        first = keep_0 * nodes[MEMORY, j] + take_0 * change
        second = keep_1 * nodes[MEMORY + 1, j] + take_1 * change
        third = keep_2 * nodes[MEMORY + 2, j] + take_2 * change
        nodes[MEMORY, j], nodes[MEMORY + 1, j], nodes[MEMORY + 2, j] = first, second, third
        pull_0 = nodes[STRENGTH, j] * first
        pull_1, pull_2 = nodes[STRENGTH + 1, j] * second, nodes[STRENGTH + 2, j] * third
        nodes[stress, j] += pull_0 + pull_1 + pull_2
        heat_0 += pull_0 * first
        heat_1 += pull_1 * second
        heat_2 += pull_2 * third
    return s.relaxation[0] * heat_0 + s.relaxation[1] * heat_1 + s.relaxation[2] * heat_2


@inlined
def _accelerate(s, nodes):
    """Compute the velocities of all nodes at the whole step."""
    if not s.contact:  # both sides of the joint are free of the weight
        nodes[STRESS + (s.index & 1), s.joint] = s.thrown * s.gravity
    solve(s, nodes, s.index & 1, 1 if s.contact else 0)


@inlined
def _tension(s, nodes, j):
    """Compute the tension of a link with its viscous part, and that of a stiff cell."""
    w, case = MEAN_VELOCITY + (s.index & 1), 1 if s.contact else 0
    rate = nodes[w, j + 1] - nodes[w, j]
    change = rate - nodes[VELOCITY, j + 1] + nodes[VELOCITY, j]
    viscous = nodes[VISCOSITY + case, j] * rate + nodes[STIFF, j] * change * s.rate
    return nodes[STRESS + (s.index & 1), j] + viscous


@inlined
def _drive(s, nodes, path):
    """Move an underdamped plate by rotations of a phasor, evaluated anew for every block."""
    k = s.index & (BLOCK - 1)
    if k == 0:
        start_block(s, s.index)
    real = s.cosine * path[0, k] - s.sine * path[1, k]
    imaginary = s.cosine * path[1, k] + s.sine * path[0, k]
    height = s.amplitude * (1.0 - real + s.slope * imaginary)  # Eq. (D2)
    acceleration = s.factor * (s.turn * real + s.growth * imaginary)
    _move_plate(s, nodes, height, s.factor * imaginary, acceleration)


@part
def _drive_along(s, nodes, path):
    """Move a plate whose motion is given in pieces."""
    height, speed, acceleration = motion_at(s, path, s.index * s.step)
    _move_plate(s, nodes, height, speed, acceleration)


@inlined
def _move_plate(s, nodes, height, speed, acceleration):
    """Move the lowest node, and what goes with it."""
    w, before = MEAN_VELOCITY + (s.index & 1), nodes[DISPLACEMENT, 0]
    s.plate_acceleration = acceleration
    nodes[DISPLACEMENT, 0], nodes[w, 0] = height, speed
    nodes[VELOCITY, 0] = speed - 0.5 * s.step * acceleration
    if s.joint == 0 and s.contact:
        nodes[DISPLACEMENT, 1], nodes[w, 1] = height, speed
        nodes[VELOCITY, 1] = nodes[VELOCITY, 0]
    elif s.is_massless and not s.contact:
        _creep(s, nodes, w, s.below_before - before)


@part
def _creep(s, nodes, w, stretch):
    """Let the free end of a layer without mass creep to where it has no load."""
    free = s.thrown * s.gravity / nodes[STIFFNESS, 0]
    stretch = (stretch - free) * math.exp(-s.creep * s.step)
    nodes[DISPLACEMENT, 1] = nodes[DISPLACEMENT, 0] + free + stretch
    nodes[VELOCITY, 1] = (nodes[DISPLACEMENT, 1] - s.below_before) / s.step
    nodes[w, 1] = nodes[w, 0] - (s.creep * stretch if s.is_lossy else 0.0)


@part
def _speed_of_thrown(s, nodes):
    """Compute the speed of the centre of mass of what is thrown, at the half step."""
    momentum = 0.0
    for j in range(s.joint + 1, nodes.shape[1]):
        momentum += nodes[MASS, j] * nodes[VELOCITY, j]
    return momentum / s.thrown


@part
def _note_event(s, events, kind, part, height, velocity):
    """Write down an event in the last step."""
    s.event_time, s.event_velocity = (s.index - 1 + part) * s.step, velocity
    note_event(s, events, kind, s.event_time, height, velocity)


@inlined
def _weigh(s, nodes):
    """Compute the forces of the layer on plate and projectile, and that in the contact."""
    w, j, face, last = MEAN_VELOCITY + (s.index & 1), s.joint + 1, s.cells + 1, nodes.shape[1] - 1
    weight = s.mass * s.gravity
    change = nodes[w, j] - nodes[VELOCITY, j]
    force = s.thrown * s.gravity + nodes[MASS, j] * s.rate * change
    if j < last:
        force -= _tension(s, nodes, j)
    if s.contact:
        s.force_3, s.force_2, s.force_1 = s.force_2, s.force_1, s.force
        s.force = force
        s.known_forces += 1
    pushed = 0.0
    if s.contact or s.joint == 0:
        change = nodes[w, face] - nodes[VELOCITY, face]
        pushed = weight + s.face_mass * s.rate * change
        if face < last:
            pushed -= _tension(s, nodes, face)
    s.on_projectile_now = pushed
    if s.joint == 0:
        s.on_plate_now = -force if s.contact else 0.0
    else:
        s.on_plate_now = (
            _tension(s, nodes, s.bottom) - nodes[MASS, 0] * s.plate_acceleration - weight
        )


@part
def _first_root(a, b, c, d):
    """Find where in a step a + b x + c x^2 + d x^3 falls below 0, until no number is between."""
    low, high = 0.0, 1.0
    while True:
        x = 0.5 * (low + high)
        if not low < x < high:
            return x
        if a + x * (b + x * (c + x * d)) < 0.0:
            high = x
        else:
            low = x


@part
def _leave(s, nodes, events):
    """Let go, now that the force is below zero."""
    after, before, earlier, first = s.force, s.force_1, s.force_2, s.force_3
    if s.known_forces < 4:  # so short after a landing it is a line
        earlier, first = 2.0 * before - after, 3.0 * before - 2.0 * after
    third = (after - first + 3.0 * (earlier - before)) / 6.0
    second = 0.5 * (earlier + after) - before
    slope = after - before - second - third
    part = _first_root(before, slope, second, third)
    # What the force less the weight does from half of the step on, where the mean velocity of the
    # step is that at its middle and a 24th of its bend
    impulse = (before - s.thrown * s.gravity) * (part - 0.5) + slope * (part**2 - 0.25) / 2.0
    impulse += second * (part**3 - 0.125) / 3.0 + third * (part**4 - 0.0625) / 4.0
    impulse -= (after - before) / 24.0
    velocity = _speed_of_thrown(s, nodes) + s.step * impulse / s.thrown
    s.contact = False
    _choose_system(s)
    _note_event(s, events, RELEASE, part, _motion(s, nodes, s.cells + 1, part)[0], velocity)


@part
def _land(s, nodes, events):
    """Close the gap, now that it is negative."""
    j = s.joint
    u, v, before = nodes[DISPLACEMENT], nodes[VELOCITY], nodes[MEAN_VELOCITY + 1 - (s.index & 1)]
    gap, closed = s.above_before - s.below_before, u[j + 1] - u[j]
    bend = s.step * (v[j + 1] - v[j] - (before[j + 1] - before[j]))
    part = _first_root(gap, closed - gap - bend, bend, 0.0)
    face = s.cells + 1
    height = u[face] - s.step * (1.0 - part) * (v[face] + part * (v[face] - before[face]))
    velocity = _speed_of_thrown(s, nodes) - s.gravity * s.step * (part - 0.5)
    overlap, approach = u[j] - u[j + 1], v[j] - v[j + 1]
    part_above = 1.0
    if j > 0:
        part_above = s.body_masses[0] / (s.body_masses[0] + s.body_masses[1])
        for k in range(s.bodies[0], j + 1):
            u[k] -= (1.0 - part_above) * overlap
            v[k] -= (1.0 - part_above) * approach
    else:
        s.work += s.body_masses[1] * approach * v[0]
    for k in range(j + 1, s.bodies[1] + 1):
        u[k] += part_above * overlap
        v[k] += part_above * approach
    s.contact = True
    _choose_system(s)
    s.known_forces = 0
    s.landed = s.landed or (velocity <= 0.0 and s.gravity > 0.0)
    _note_event(s, events, LANDING if s.landed else RECONTACT, part, height, velocity)


@inlined
def _march(s, nodes, path, events, goal):
    """Advance to step `goal`, or into one with more events than there is room for."""
    step, joint = s.step, s.joint
    while s.index < goal and s.events <= events.shape[0]:
        w = MEAN_VELOCITY + (s.index & 1)
        s.below_before = nodes[DISPLACEMENT, joint]
        s.above_before = nodes[DISPLACEMENT, joint + 1]
        for j in range(nodes.shape[1]):
            nodes[VELOCITY, j] = 2.0 * nodes[w, j] - nodes[VELOCITY, j]
            nodes[DISPLACEMENT, j] += step * nodes[VELOCITY, j]
        s.index += 1
        s.event_time = math.inf
        s.on_plate_before, s.on_projectile_before = s.on_plate_now, s.on_projectile_now
        s.work_before, s.heat_before = s.work, s.heat
        if s.plate_kind == DAMPED:
            _drive(s, nodes, path)
        else:
            _drive_along(s, nodes, path)
        gap = nodes[DISPLACEMENT, joint + 1] - nodes[DISPLACEMENT, joint]
        lands = not s.contact and gap < 0.0
        if lands:
            _land(s, nodes, events)
        _strain(s, nodes)
        leaves = False
        while True:
            _accelerate(s, nodes)
            _weigh(s, nodes)
            if leaves:
                break
            s.on_plate_until = s.on_plate_before if lands else s.on_plate_now
            s.on_projectile_until = s.on_projectile_before if lands else s.on_projectile_now
            leaves = s.contact and not lands and s.force < s.release_threshold
            if not leaves:
                break
            _leave(s, nodes, events)  # and compute the step again, in flight
        power = -s.on_plate_now * nodes[MEAN_VELOCITY + (s.index & 1), 0]
        s.work += 0.5 * step * (s.power + power)
        s.power = power
        if s.is_lossy:
            heating = s.strain_heating
            if s.is_viscous:
                heating += _heating(nodes, s.index & 1)
            s.heat += 0.5 * step * (s.heating + heating)
            s.heating = heating
        if s.events == 0:
            _compare_loads(s, nodes)
        elif s.events == 1 and s.event_time < math.inf:  # the first release was in this step
            part = s.event_time / step - (s.index - 1)
            s.first_work = s.work_before + part * (s.work - s.work_before)


@reduction
def _heating(nodes, now):
    """Compute the power that viscosity turns to heat in the layer."""
    total = 0.0
    for j in range(nodes.shape[1] - 1):
        rate = nodes[MEAN_VELOCITY + now, j + 1] - nodes[MEAN_VELOCITY + now, j]
        total += nodes[VISCOSITY + 1, j] * rate * rate
    return total


@part
def _strain_of(nodes, row, j):
    """Compute the strain of a cell from displacements or positions."""
    stretch = nodes[row, j + 1] - nodes[row, j]
    return stretch * nodes[INVERSE, j] - nodes[STATIC, j]


@inlined
def _compare_loads(s, nodes):
    """Look whether anything is larger than it has been."""
    for j in range(nodes.shape[1] - 1):
        stretch = nodes[DISPLACEMENT, j + 1] - nodes[DISPLACEMENT, j]
        strain = abs(stretch * nodes[INVERSE, j] - nodes[STATIC, j])
        if strain > nodes[LARGEST, j]:  # noqa: PLR1730 - numba makes vectors of this
            nodes[LARGEST, j] = strain
    for end in range(2):
        strain = _strain_of(nodes, DISPLACEMENT, s.edge_cells[end, 0])
        other = _strain_of(nodes, DISPLACEMENT, s.edge_cells[end, 1])
        strain += s.edge_weights[end] * (other - strain)
        s.edge_strains[end] = max(s.edge_strains[end], abs(strain))
    acceleration = s.on_projectile_now / s.mass - s.gravity
    s.acceleration = max(s.acceleration, abs(acceleration))
    s.plate_force = max(s.plate_force, abs(s.on_plate_now))


@part
def _motion(s, nodes, j, part):
    """Interpolate displacement and velocity of a node between the last two steps."""
    u, v, step = nodes[DISPLACEMENT, j], nodes[VELOCITY, j], s.step
    if s.index == 0:
        return u, v
    now = s.index & 1
    # Changes of velocity in half a step, of an acceleration that is linear in time
    old, new = v - nodes[MEAN_VELOCITY + 1 - now, j], nodes[MEAN_VELOCITY + now, j] - v
    before = u - step * v
    if j == s.joint or j == s.joint + 1:  # which a landing may have moved
        before = s.below_before if j == s.joint else s.above_before
    bend = old * (2.0 - part) + new * (1.0 + part)
    height = before + part * (u - before) - step * part * (1.0 - part) * bend / 3.0
    turn = old * (2.0 * part - part * part - 2.0 / 3.0) + new * (part * part - 1.0 / 3.0)
    return height, v + turn


@kernel
def _advance(core, nodes, path, events, time):
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
    if nodes.shape[1] == _USUAL_NODES:  # known, so that no loop has to ask what may overlap
        _march(grid, nodes, path, events, goal)
    else:
        _march(grid, nodes, path, events, goal)
    if grid.events > events.shape[0]:
        return TOO_MANY_EVENTS
    piece = s.piece  # the grid's may be further on
    core[1] = core[0]
    s.piece = piece
    s.time = time
    s.part = 1.0
    if goal > 0:
        s.part = min(max((time - (goal - 1) * step) / step, 0.0), 1.0)
    s.work = s.work_before + s.part * (s.work - s.work_before)
    s.heat = s.heat_before + s.part * (s.heat - s.heat_before)
    on_plate, on_projectile, weight = s.on_plate_now, s.on_projectile_now, 1.0
    if time < s.event_time:  # the event is still to come
        if s.event_time < math.inf:
            s.contact = not s.contact
            s.events -= 1
        on_plate, on_projectile, weight = s.on_plate_until, s.on_projectile_until, s.part
    state = s.state
    state[TIME] = time
    state[PLATE_POSITION], state[PLATE_VELOCITY], _ = motion_at(s, path, time)
    height, state[PROJECTILE_VELOCITY] = _motion(s, nodes, s.cells + 1, s.part)
    state[PROJECTILE_POSITION] = s.rest_height + height
    s.surface, _ = _motion(s, nodes, s.bottom + s.cells, s.part)
    rise = on_plate - s.on_plate_before
    state[PLATE_FORCE] = s.on_plate_before + weight * rise
    rise = on_projectile - s.on_projectile_before
    state[PROJECTILE_FORCE] = s.on_projectile_before + weight * rise
    return s.events


@part
def _move_nodes(s, nodes):
    """Bring all nodes and the forces through all cells to the time asked for."""
    now, part = s.index & 1, s.part if s.index > 0 else 1.0
    old, new, before, after = (
        MEAN_VELOCITY + 1 - now,
        MEAN_VELOCITY + now,
        STRESS + 1 - now,
        STRESS + now,
    )
    back, bend = (part - 1.0) * s.step, (part - 1.0) * s.step * part / 3.0
    from_old, from_new = 2.0 * part - part * part - 2.0 / 3.0, part * part - 1.0 / 3.0
    for j in range(nodes.shape[1]):  # as `_motion`
        u, v = nodes[DISPLACEMENT, j], nodes[VELOCITY, j]
        first, second = v - nodes[old, j], nodes[new, j] - v
        turn = first * (2.0 - part) + second * (1.0 + part)
        nodes[POSITION, j] = u + back * v + bend * turn
        nodes[SPEED, j] = v + from_old * first + from_new * second
    for j in range(s.joint, s.joint + 2):
        nodes[POSITION, j], nodes[SPEED, j] = _motion(s, nodes, j, part)
    nodes[POSITION, 0], nodes[SPEED, 0] = s.state[PLATE_POSITION], s.state[PLATE_VELOCITY]
    viscosity = VISCOSITY + (1 if s.contact else 0)
    for j in range(nodes.shape[1] - 1):  # as `_tension`
        middle = nodes[VELOCITY, j + 1] - nodes[VELOCITY, j]
        first, second = nodes[old, j + 1] - nodes[old, j], nodes[new, j + 1] - nodes[new, j]
        earlier = nodes[viscosity, j] * first + nodes[STIFF, j] * (middle - first) * s.rate
        later = nodes[viscosity, j] * second + nodes[STIFF, j] * (second - middle) * s.rate
        earlier, later = nodes[before, j] + earlier, nodes[after, j] + later
        nodes[FORCE, j] = nodes[BURDEN, j] - earlier - part * (later - earlier)


@kernel
def _read_layer(core, nodes, places, out):
    """Read heights, velocities, forces and perhaps strains of the layer from plate to top."""
    s = core[1]
    _move_nodes(s, nodes)
    one = np.uintp(1)  # any other index is looked at whether it counts from the end
    for n in range(places.size):
        j, k = np.uintp(places[n].cell), np.uintp(places[n].beside)
        part, weight = places[n].part, places[n].weight
        below = nodes[REST, j] + nodes[POSITION, j]
        above = nodes[REST, j + one] + nodes[POSITION, j + one]
        out[0, n] = below + part * (above - below)
        out[1, n] = nodes[SPEED, j] + part * (nodes[SPEED, j + one] - nodes[SPEED, j])
        out[2, n] = nodes[FORCE, j] + weight * (nodes[FORCE, k] - nodes[FORCE, j])
        if out.shape[0] > 3:
            here = _strain_of(nodes, POSITION, places[n].cell)
            there = _strain_of(nodes, POSITION, places[n].beside)
            out[3, n] = here + weight * (there - here)


@part
def _elastic_energy(ratio, least):
    """Integrate the tension of a neo-Hookean rod in E / 3 over the stretch."""
    held = max(ratio, least)
    slope = 1.0 + 2.0 / held**3
    beyond = ratio - held
    return 0.5 * held**2 + 1.0 / held + beyond * (held - 1.0 / held**2 + 0.5 * beyond * slope)


@kernel
def _stored_energy(core, nodes):
    """Add up the energy of layer and projectile against rest."""
    s = core[1]
    _move_nodes(s, nodes)
    position, speed = nodes[POSITION], nodes[SPEED]
    weight = s.thrown * s.gravity
    total = 0.5 * nodes[MASS, 0] * speed[0] ** 2
    total += weight * (position[0] + position[s.joint + 1] - position[s.joint])
    rest = 1.0 - s.part if s.index > 0 else 0.0
    for j in range(position.size - 1):
        stretch = position[j + 1] - position[j]
        total += 0.5 * nodes[STIFFNESS, j] * stretch**2
        if nodes[CURVATURE, j] > 0.0:
            start = 1.0 - nodes[STATIC, j]
            elastic = _elastic_energy(start + stretch * nodes[INVERSE, j], nodes[LEAST, j])
            elastic -= _elastic_energy(start, nodes[LEAST, j])
            total += nodes[CURVATURE, j] / nodes[INVERSE, j] * elastic
            total += (nodes[OFFSET, j] - nodes[CURVATURE, j] * start) * stretch
        for element in range(3):  # which go on by their last rate
            memory = nodes[MEMORY + element, j]
            change = nodes[STRETCH, j] - nodes[POSITION, j + 1] + nodes[POSITION, j]
            memory -= change - rest * s.step * s.relaxation[element] * memory
            total += 0.5 * nodes[STRENGTH + element, j] * memory**2
        total += 0.5 * nodes[MASS, j + 1] * speed[j + 1] ** 2
    return total


@kernel
def _reset(core, nodes):
    """Put everything back to rest."""
    s = core[0]
    for j in range(nodes.shape[1]):
        for row in range(DISPLACEMENT, MASS):
            nodes[row, j] = 0.0
        nodes[LARGEST, j] = nodes[STATIC, j]
    s.cosine = 1.0
    weight = s.mass * s.gravity
    s.force = s.thrown * s.gravity
    s.known_forces = 1
    s.on_plate_now = -s.force if s.joint == 0 else -weight
    s.on_projectile_now = weight
    s.on_plate_before = s.on_plate_until = s.on_plate_now
    s.on_projectile_before = s.on_projectile_until = weight
    core[1] = core[0]


@kernel
def _prepare_without_units(core, nodes, path, bodies, ratios, step, cells, bars, is_on_projectile):
    """Make a record at rest in units of layer mass, crossing time and amplitude."""
    mu, kappa, zeta, gravity = ratios
    omega = 2.0 * math.pi / kappa
    s = core[2]
    s.step, s.cells = step, cells
    s.bottom, s.joint = (1, 0) if is_on_projectile else (0, cells)
    s.mass = mu
    s.face_mass = 0.5 * mu / bars if bars > 0 else mu
    s.gravity = gravity * omega * omega
    s.release_threshold = -_NOISE * omega
    write_underdamped(s, path, omega, omega, zeta, s.step)
    for end in range(2):
        first = s.bottom + (cells - 1 if end == 1 else 0)
        count = bodies[bodies.shape[0] - (2 if bars > 0 else 1), 0] if end == 1 else bodies[0, 0]
        s.edge_cells[end, 0] = s.edge_cells[end, 1] = first
        if count > 1:
            s.edge_cells[end, 1] = first + (1 - 2 * end)
            s.edge_weights[end] = -0.5
    _prepare(core, nodes, bodies, omega)


def first_throws(
    *,
    mass_ratio: ArrayLike,
    speed_ratio: ArrayLike,
    damping_ratio: ArrayLike = 0.0,
    gravity_ratio: ArrayLike = 0.0,
    loss_tangent: ArrayLike = 0.0,
    crossing_ratio: ArrayLike = 0.0,
    strain_ratio: ArrayLike = 0.0,
    constant_loss: ArrayLike = False,
    stack: Stack | None = None,
    glued_to: Literal['plate', 'projectile'] = 'plate',
    cells: int | None = None,
    unresolved: Literal['raise', 'nan'] = 'raise',
    threads: int | None = None,
) -> FirstThrows:
    r"""
    Throw many times up to the first release.

    The plate moves as `plate.Underdamped`.

    Parameters
    ----------
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio : array_like
        :math:`\mu = m / (\rho_s S L_s)`, :math:`\kappa = c_s / (L_s f)`, the plate's
        :math:`\zeta`, and :math:`g / (A \omega^2)`; broadcast against each other. [-]
    loss_tangent : array_like
        Of the layer at the plate's frequency, :math:`\eta \omega / E_s`. [-]
    crossing_ratio : array_like
        What a wave needs through the projectile over what it needs through the layer; 0 is rigid,
        and `MAX_CROSSING_RATIO` is the most. [-]
    strain_ratio : array_like
        :math:`A \omega / c_s` of a neo-Hookean layer, 0 is a linear one. [-]
    constant_loss : array_like of bool
        Whether the loss tangent is constant, and not in proportion to frequency.
    stack : Stack, optional
        Of which the layer is, with sheets scaled alike; of one material if not given. Mass,
        crossing time and loss tangent are those of the whole.
    glued_to : {'plate', 'projectile'}
        Where the layer is glued. On the projectile it is thrown along, and leaves the plate.
    cells : int, optional
        Of the layer, from 8 to `MAX_CELLS`; if not given as many as it takes for 1e-4, throw by
        throw, from 64 to 1024. Errors are of second order.
    unresolved : {'raise', 'nan'}
        What becomes of throws without a release: the first is raised, or all are NaN.
    threads : int, optional
        Largest number of threads, all cores if not given. Results do not depend on it.

    Returns
    -------
    FirstThrows
        Of arrays with the common shape; the speed is that of the centre of mass of what is thrown.

    Raises
    ------
    ValueError
        If a ratio is out of range, or an option is not one of its values.
    ThrowUnresolvedError
        If a projectile does not leave within `MAX_PERIODS` and `MAX_CROSSINGS`, unless
        `unresolved` is 'nan'.

    Examples
    --------
    Internal loss costs energy:

    >>> throws = first_throws(
    ...     mass_ratio=0.234231, speed_ratio=8.242210, loss_tangent=[0.0, 0.02]
    ... )
    >>> throws.energy_transfer.round(3)
    array([4.123, 3.798])

    """
    if glued_to not in ('plate', 'projectile'):
        raise ValueError(f"glued_to must be 'plate' or 'projectile', got {glued_to!r}")
    if cells is not None:
        require_count('cells', cells, low=8, high=MAX_CELLS)
    ratios, shape = broadcast_ratios(
        unresolved,
        mass_ratio=mass_ratio,
        speed_ratio=speed_ratio,
        damping_ratio=damping_ratio,
        gravity_ratio=gravity_ratio,
        loss_tangent=loss_tangent,
        crossing_ratio=crossing_ratio,
        strain_ratio=strain_ratio,
        constant_loss=constant_loss,
    )
    slowest = ratios[5].max(initial=0.0)
    if slowest > MAX_CROSSING_RATIO:
        raise ValueError(f'crossing_ratio must be at most {MAX_CROSSING_RATIO:g}, got {slowest}')
    rows = np.ascontiguousarray(ratios.T)
    found = _throw_all(rows, stack, cells, glued_to == 'projectile', threads)
    return FirstThrows.collect(found.T, ratios, shape, unresolved, f'{MAX_PERIODS:g} periods')


def _throw_all(
    rows: Floats,
    stack: Stack | None,
    cells: int | None,
    is_on_projectile: bool,
    threads: int | None,
) -> Floats:
    """Compute a row of `FirstThrows` for each row of ratios."""
    found = np.full((rows.shape[0], 6), math.nan)
    wanted = np.full(rows.shape[0], cells or _CELLS)
    if cells is None:
        least = np.maximum(_CELLS_PER_RELAXATION / rows[:, 0], _STEPS_PER_PERIOD / rows[:, 1])
        while (too_few := (wanted < least) & (wanted < _MOST_FOR_BATCH)).any():
            wanted[too_few] *= 2
    bodies, crossings = make_bodies(rows, stack)
    steps = crossings.sum(axis=1) / wanted
    counts = np.maximum(1, (crossings / steps[:, None] * (1.0 + 1e-9)).astype(np.int64))
    bodies[..., 0] = counts
    bars = np.where(rows[:, 5] > 0.0, np.maximum(2, (rows[:, 5] / steps).astype(np.int64)), 0)
    mu, kappa = rows[:, 0], rows[:, 1]
    periods = MAX_PERIODS * np.maximum(kappa, 2.0 * math.pi * np.sqrt(mu))
    latest = np.minimum(1.0 + periods, MAX_CROSSINGS)

    def run(part: int, parts: int) -> None:
        core, path, no_events = np.zeros(3, _CORE), np.empty((2, BLOCK)), np.empty((0, 4))
        numbers = core.view(np.float64).reshape(3, -1)
        advance = _advance_compiled()
        for n in range(part, rows.shape[0], parts):
            count, bar = int(counts[n].sum()), int(bars[n])
            nodes = np.zeros((ROWS, count + bar + 2))
            numbers[:] = 0.0
            ratios, own = tuple(rows[n].tolist()), bodies[n]
            if bar:
                spring = ratios[0] / ratios[5] ** 2
                own = np.vstack([own, [bar, 0.0, ratios[0], spring, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
            _prepare_without_units(
                core, nodes, path, own, ratios[:4], steps[n], count, bar, is_on_projectile
            )
            numbers[:2] = numbers[2]
            _reset(core, nodes)
            advance(core, nodes, path, no_events, latest[n])
            grid = core[0]
            if grid['events']:
                omega = 2.0 * math.pi / ratios[1]
                strain = max(grid['edge_strains'].max(), nodes[LARGEST].max())
                if ratios[6] > 0.0:
                    strain *= omega / ratios[6]
                work = grid['first_work'] / (ratios[0] * omega**2)
                found[n] = (
                    grid['event_time'] / ratios[1], grid['event_velocity'] / omega,
                    strain / omega, grid['acceleration'] / omega**2,
                    grid['plate_force'] / omega, work,
                )

    in_threads(run, count=rows.shape[0], per_thread=_THROWS_PER_THREAD, threads=threads)
    return found


_RECORDS, _ROWS = nb.from_dtype(_CORE)[::1], nb.float64[:, ::1]
_advance_compiled = compiled(_advance, _RECORDS, _ROWS, _ROWS, _ROWS, nb.float64)
_read_layer_compiled = compiled(_read_layer, _RECORDS, _ROWS, nb.from_dtype(_PLACE)[::1], _ROWS)


def _aligned_zeros(rows: int, columns: int) -> Floats:
    """Make a table that begins with a line of the cache: 5 % faster than 16 bytes beside it."""
    room = np.zeros(rows * columns + 8)
    start = -room.ctypes.data % 64 // 8
    return room[start:start + rows * columns].reshape(rows, columns)


class CellStepper(Stepper):
    """
    A throw by cells; the layer may be a stack, and have loss.

    An event carries the velocity of the centre of mass of what is thrown, and `state` that of the
    projectile's lower face. `stored_energy` and `heat` add up to `work_so_far` to second order,
    and to first after landings.

    Parameters
    ----------
    rig : Rig
        The rig.
    motion : Underdamped, SampledMotion, 'measured' or None
        How the plate moves; None is the engine's, 'measured' waits for `append_plate_states`.
    model : str
        One of `CELL_MODELS`.
    cells : int, optional
        Of the layer, 1 to `MAX_CELLS`, however long they take; the default is `cells_per_layer`.
    field_points : int
        Heights at which the layer is read, 2 or more.

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

    _changing = '_nodes'

    def __init__(
        self,
        rig: Rig,
        motion: PlateMotion | Literal['measured'] | None = None,
        *,
        model: str = 'finite_difference',
        cells: int | None = None,
        field_points: int = 64,
    ) -> None:
        _require_model(model)
        super().__init__(rig, field_points)
        if cells is None:
            cells = cells_per_layer(rig, model)
        require_count('cells', cells, low=1, high=MAX_CELLS)
        scale = rig.engine.speed_scale
        if isinstance(motion, SampledMotion):
            scale = max(scale, motion.peak_velocity)
        if model == 'spring_mass':
            grid = make_massless_grid(rig, step=_spring_step(rig))
        else:
            is_elastic = model == 'finite_difference_elastic'
            grid = make_grid(rig, cells=cells, is_elastic=is_elastic, peak_speed=scale)
        self.model = model
        self.cells = int(grid.counts.sum())
        self.step = grid.step
        self._nodes = _aligned_zeros(ROWS, self.cells + grid.bars + 2)
        self._places = np.array(grid.places(field_points), _PLACE)
        bottom = 1 if model == 'finite_difference_glued' else 0
        for name in ('cell', 'beside'):
            self._places[name] += bottom
        start = self._make_records(_CORE, motion, grid.step)
        start['step'], start['cells'] = grid.step, self.cells
        start['bottom'], start['joint'] = bottom, 0 if bottom else self.cells
        mass = rig.projectile.mass
        start['mass'], start['face_mass'] = mass, 0.5 * mass / grid.bars if grid.bars else mass
        start['gravity'] = rig.gravity
        start['release_threshold'] = -_NOISE * rig.engine.speed_scale * rig.layer.impedance
        edges = self._places[[0, -1]]
        start['edge_cells'] = np.stack((edges['cell'], edges['beside']), axis=1)
        start['edge_weights'] = edges['weight']
        _prepare(self._core, self._nodes, grid.bodies, rig.engine.angular_frequency)
        self._bind()
        self.reset()

    def _bind(self) -> None:
        arrays = (self._core, self._nodes)
        self._advance = partial(_advance_compiled(), *arrays, self._path, self._events)
        self._read_layer = partial(_read_layer_compiled(), *arrays, self._places)

    def _clear(self) -> None:
        _reset(self._core, self._nodes)

    def _copy_layer(self, origin: Stepper) -> None:
        assert isinstance(origin, CellStepper)
        self._nodes[:] = origin._nodes

    @property
    def horizon(self) -> float:
        """Until when `advance_to` can go: the last step at which the plate is known [s]."""
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
        return float(_UPDATE_COST * self._nodes.shape[1] / self.step)

    @property
    def loads(self) -> Loads:
        """Largest loads up to the first release, or so far if that is to come."""
        now = self._core[1]
        plate, contact = now['edge_strains'].tolist()
        inside = float(self._nodes[LARGEST].max())
        acceleration, force = float(now['acceleration']), float(now['plate_force'])
        return Loads(max(inside, plate, contact), plate, contact, acceleration, force)

    @property
    def work_so_far(self) -> float:
        """Work of the plate from the start to now, whatever has happened [J]."""
        return float(self._core[1]['work'])

    @property
    def heat(self) -> float:
        """Return what internal loss has taken so far [J]."""
        return float(self._core[1]['heat'])

    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, at the present time [J]."""
        return float(_stored_energy(self._core, self._nodes))


def warm_up() -> None:
    """Compile or load all kernels."""
    load_kernels(CellStepper(Rig(), 'measured', field_points=2))
    first_throws(mass_ratio=1.0, speed_ratio=8.0, cells=8)
