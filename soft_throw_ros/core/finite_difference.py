# SPDX-License-Identifier: Apache-2.0
r"""
First releases by finite differences: with internal loss, and with an elastic projectile.

For one throw with all that belongs to it, and for layers that are not uniform, there is
`soft_throw_ros.core.throw.simulate`; this is the same scheme for arrays of throws.

Notes
-----
Eqs. (2)-(3) of [1]_, :math:`\rho u_{tt} = \sigma_y`, with the Kelvin-Voigt stress
:math:`\sigma = E u_y + \eta u_{ty}`. Displacements u belong to nodes and whole steps, velocities
v to nodes and half steps, so that semi-implicit Euler is of second order,

.. math::

    M \frac{v^{n+1/2} - v^{n-1/2}}{h} = -K (u^n + \beta h^2 a^n)
    - C \frac{v^{n+1/2} + v^{n-1/2}}{2}, \qquad u^{n+1} = u^n + h v^{n+1/2},

where a is the acceleration. The step h is what a wave needs for a cell of the layer: there the
scheme has no dispersion, and takes fronts from node to node as they are. An elastic projectile
is cut into cells of its own, as many as its wave crosses in a step each, but at least two. If it
is so stiff that its wave crosses more than a cell in a step, :math:`\beta = 1/4` (average
acceleration) keeps that stable; else :math:`\beta = 0`. What is implicit is one tridiagonal
system with constant coefficients.

The moment of release is the root of a cubic through the contact force at four steps. Two grids,
one of half the cells, are extrapolated to none, which makes it third order (and the time of
release fourth, mostly). Where ejection times jump, across odd multiples of :math:`t_s`, the two
grids may tell of different releases; then the finer one is taken, after refining.

Left out as in [1]_: the section stays as it is, and the weight of the layer squeezes nothing.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import math
import os
from typing import Literal

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.travelling_wave import FirstRelease, ThrowUnresolvedError

Floats = NDArray[np.float64]

MAX_PERIODS = 16.0
"""Plate periods, and periods of the projectile on the layer, after which one gives up."""

MAX_CROSSINGS = 4096.0
"""Crossings of the wave after which one gives up in any case."""

MAX_CELLS = 1024
"""Most cells that are chosen, and that can be asked for."""

MAX_CROSSING_RATIO = 32.0
"""Slowest projectile: it is cut into as many times more cells than the layer."""

_FEWEST_CELLS = 64  # that are chosen, ...
_CELLS_PER_RELAXATION = 2.0  # with so many for tau, ...
_CELLS_PER_PERIOD = 16.0  # and for the plate's period
_FEWEST_PROJECTILE_CELLS = 2
_THROWS_PER_THREAD = 32
_NOISE = 1e-12  # of the plate's speed, as a wave, which is no pull

_LANES = 32
_U, _V, _A, _SHARE, _GAIN = (_LANES * k for k in range(5))  # of a node, for all lanes
_NODE = 5 * _LANES
(
    _CASE,
    _STEPS,
    _LAST,
    _LOSS,  # viscosity of a cell of the layer, and its part of the tridiagonal matrix
    _DRAG,
    _BAR,  # stiffness of a cell of the projectile, and its part of the tridiagonal matrix
    _SOLID,
    _FACE,  # mass of the projectile's lowest node
    _MASS,  # of what is thrown
    _WEIGHT,
    _REAL,  # e^{lambda t}, e^{lambda h}
    _IMAGINARY,
    _TURN_REAL,
    _TURN_IMAGINARY,
    _SLOPE,  # zeta / sqrt(1 - zeta^2)
    _SPEED,  # w / sqrt(1 - zeta^2)
    _ACCELERATION,  # w^2
    _FLOOR,  # below which a force is a pull, and no noise
    _FORCE,  # now, and at three steps before
) = range(19)
_LANE_ROWS = _FORCE + 4

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')
_peak_velocity_ratio = nb.vectorize(cache=True)(peak_velocity_ratio)


def first_releases(
    *,
    mass_ratio: ArrayLike,
    speed_ratio: ArrayLike,
    damping_ratio: ArrayLike = 0.0,
    gravity_ratio: ArrayLike = 0.0,
    loss_tangent: ArrayLike = 0.0,
    crossing_ratio: ArrayLike = 0.0,
    glued_to: Literal['plate', 'projectile'] = 'plate',
    cells: int | None = None,
    unresolved: Literal['raise', 'nan'] = 'raise',
    threads: int | None = None,
) -> FirstRelease:
    r"""
    Find when and how fast projectiles first leave, for many throws.

    The layers are uniform; the plate moves as `plate.Underdamped`.

    Parameters
    ----------
    mass_ratio : array_like
        Projectile over layer mass, :math:`\mu = m / (\rho_s S L_s)`. [-]
    speed_ratio : array_like
        Crossings of the wave per plate period, :math:`\kappa = c_s / (L_s f)`. [-]
    damping_ratio : array_like
        Of the plate, :math:`\zeta`. [-]
    gravity_ratio : array_like
        :math:`g / (A \omega^2)`. [-]
    loss_tangent : array_like
        Of the layer at the plate's frequency, :math:`\eta \omega / E_s`. [-]
    crossing_ratio : array_like
        What a wave needs through the projectile over what it needs through the layer,
        :math:`L_r c_s / (c_r L_s)`; 0 is rigid, and `MAX_CROSSING_RATIO` is the most. [-]
    glued_to : {'plate', 'projectile'}
        Where the layer is glued. On the projectile it is thrown along, as in [1]_, and the
        release is at the plate.
    cells : int, optional
        Into which the finer grid cuts the layer: an even number from 16 to `MAX_CELLS`. If not
        given it is chosen throw by throw, for 1e-3 in both results almost everywhere, and
        doubled where the two grids do not agree.
    unresolved : {'raise', 'nan'}
        What becomes of throws that are not resolved: the first is raised, or all are NaN.
    threads : int, optional
        Largest number of threads, all cores if not given. Results do not depend on it.

    Returns
    -------
    FirstRelease
        Of arrays with the common shape. The speed is that of the centre of mass of what is
        thrown.

    Raises
    ------
    ValueError
        If a ratio is not finite and positive (damping: in [0, 1); gravity, loss and crossing
        ratio: not negative), a projectile is too slow, the shapes do not fit, or an option is not
        one of its values.
    ThrowUnresolvedError
        If a projectile does not leave within `MAX_PERIODS` and `MAX_CROSSINGS`, unless
        `unresolved` is 'nan'.

    References
    ----------
    .. [1] Celestini, Raufaste et al. (2020), reference 27 of the paper.

    Examples
    --------
    Internal loss costs energy:

    >>> throws = first_releases(
    ...     mass_ratio=0.234231, speed_ratio=8.242210, loss_tangent=[0.0, 0.02]
    ... )
    >>> throws.energy_transfer.round(4)
    array([4.1232, 3.7985])

    """
    if glued_to not in ('plate', 'projectile'):
        raise ValueError(f"glued_to must be 'plate' or 'projectile', got {glued_to!r}")
    if unresolved not in ('raise', 'nan'):
        raise ValueError(f"unresolved must be 'raise' or 'nan', got {unresolved!r}")
    if threads is not None and not (type(threads) is int and threads > 0):
        raise ValueError(f'threads must be a positive whole number or None, got {threads!r}')
    if cells is not None and not (
        type(cells) is int and 16 <= cells <= MAX_CELLS and cells % 2 == 0
    ):
        raise ValueError(
            f'cells must be an even number from 16 to {MAX_CELLS} or None, got {cells!r}'
        )
    damping_ratio = checks.below_one_array('damping_ratio', damping_ratio)
    crossing_ratio = checks.not_negative_array('crossing_ratio', crossing_ratio)
    if crossing_ratio.max(initial=0.0) > MAX_CROSSING_RATIO:
        raise ValueError(
            f'crossing_ratio must be at most {MAX_CROSSING_RATIO:g}, got {crossing_ratio.max()}'
        )
    cases = np.broadcast_arrays(
        checks.positive_array('mass_ratio', mass_ratio),
        checks.positive_array('speed_ratio', speed_ratio),
        damping_ratio,
        checks.not_negative_array('gravity_ratio', gravity_ratio),
        checks.not_negative_array('loss_tangent', loss_tangent),
        crossing_ratio,
    )
    shape = cases[0].shape
    rows = np.stack([case.ravel() for case in cases], axis=1)
    found = np.full((rows.shape[0], 2), math.nan)
    _refine(rows, cells, glued_to == 'projectile', threads or os.cpu_count() or 1, found)
    failed = np.flatnonzero(np.isnan(found[:, 0]))
    if failed.size and unresolved == 'raise':
        mu, kappa, zeta, gravity, loss, crossing = rows[failed[0]]
        raise ThrowUnresolvedError(
            f'no release within {_patience(mu, kappa):.0f} crossings for mass_ratio {mu:g}, '
            f'speed_ratio {kappa:g}, damping_ratio {zeta:g}, gravity_ratio {gravity:g}, '
            f'loss_tangent {loss:g}, crossing_ratio {crossing:g}'
        )
    phase, speed = found.T.reshape(2, *shape)
    return FirstRelease(phase, speed, (speed / _peak_velocity_ratio(damping_ratio)) ** 2)


def _refine(
    rows: Floats, cells: int | None, on_projectile: bool, threads: int, found: Floats
) -> None:
    """Fill `found` from two grids each, and from finer ones where these do not agree."""
    sizes = np.full(rows.shape[0], cells or _FEWEST_CELLS)
    if cells is None:
        wanted = np.maximum(_CELLS_PER_RELAXATION / rows[:, 0], _CELLS_PER_PERIOD / rows[:, 1])
        while (too_few := (sizes < wanted) & (sizes < MAX_CELLS)).any():
            sizes[too_few] *= 2
    left = np.arange(rows.shape[0])
    while left.size:
        cases, size = rows[left], sizes[left]
        bars = np.maximum(_FEWEST_PROJECTILE_CELLS, (0.5 * size * cases[:, 5]).astype(np.int64))
        bars[cases[:, 5] == 0.0] = 0
        coarse = _compute(cases, size // 2, bars, on_projectile, threads)
        fine = _compute(cases, size, 2 * bars, on_projectile, threads)
        steps_apart = np.abs(fine[:, 0] - coarse[:, 0]) * cases[:, 1] * (size // 2)
        agree = steps_apart < 1.0
        found[left] = np.where(agree[:, None], (4.0 * fine - coarse) / 3.0, fine)
        doubtful = ~agree & ~np.isnan(fine[:, 0]) & (size < MAX_CELLS)
        left = left[doubtful & (cells is None)]
        sizes[left] *= 2


def _compute(
    rows: Floats,
    cells: NDArray[np.int64],
    bars: NDArray[np.int64],
    on_projectile: bool,
    threads: int,
) -> Floats:
    """Compute (t_e f, V_e / (A w)) of all throws, those with the same grid side by side."""
    found = np.empty((rows.shape[0], 2))

    def run(task: tuple[NDArray[np.int64], int, int]) -> None:
        members, size, more = task
        found[members] = _releases(rows[members], size, more, on_projectile)

    tasks = []
    for size, more in sorted(set(zip(cells.tolist(), bars.tolist(), strict=True))):
        members = np.flatnonzero((cells == size) & (bars == more))
        parts = min(threads, max(1, members.size // _THROWS_PER_THREAD))
        tasks += [(members[part::parts], size, more) for part in range(parts)]
    if threads == 1 or len(tasks) == 1:
        for task in tasks:
            run(task)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, tasks))
    return found


@_jit
def _releases(rows, cells, more, on_projectile):
    """
    Compute (t_e f, V_e / (A w)) row by row, NaN if there is no release.

    Units: mass and crossing time of the layer, amplitude of the plate. As many throws as there
    are lanes go side by side; the next takes the place of one that is done.
    """
    found = np.empty((rows.shape[0], 2))
    nodes = np.zeros((cells + more + 1) * _NODE)
    lanes = np.zeros((_LANE_ROWS, _LANES))
    width = min(_LANES, rows.shape[0])
    for lane in range(width):
        _load(nodes, lanes, lane, rows, lane, cells, more, on_projectile)
    following = width
    while width > 0:
        _step(nodes, lanes, width, cells, more, on_projectile)
        lane = 0
        while lane < width:
            steps = lanes[_STEPS, lane]
            falls = lanes[_FORCE, lane] < lanes[_FLOOR, lane] and steps > 3
            if falls or steps > lanes[_LAST, lane]:
                case = int(lanes[_CASE, lane])
                found[case, 0], found[case, 1] = math.nan, math.nan
                if falls:
                    time, speed = _release(nodes, lanes, lane, cells, more, on_projectile)
                    kappa = rows[case, 1]
                    found[case, 0] = time / kappa
                    found[case, 1] = speed * kappa / (2.0 * math.pi)
                if following < rows.shape[0]:
                    _load(nodes, lanes, lane, rows, following, cells, more, on_projectile)
                    following += 1
                else:
                    width -= 1
                    _move(nodes, lanes, width, lane)
                    continue
            lane += 1
    return found


@_jit
def _load(nodes, lanes, lane, rows, case, cells, more, on_projectile):
    """Put a throw at rest into a lane."""
    row = rows[case]
    mu, kappa, zeta, gravity, loss, crossing = row[0], row[1], row[2], row[3], row[4], row[5]
    step = 1.0 / cells
    omega = 2.0 * math.pi / kappa
    root = math.sqrt(1.0 - zeta * zeta)
    decay = math.exp(-zeta * omega * step)
    viscosity = loss / omega * cells
    bar = solid = 0.0
    face = mu
    if more > 0:
        bar = mu / crossing**2 * more
        face = 0.5 * mu / more
        if crossing < step * more:
            solid = 0.25 * step * step * bar
    lanes[_CASE, lane] = case
    lanes[_STEPS, lane] = 0.0
    lanes[_LAST, lane] = math.ceil(_patience(mu, kappa) * cells)
    lanes[_LOSS, lane] = viscosity
    lanes[_DRAG, lane] = drag = 0.5 * step * viscosity
    lanes[_BAR, lane] = bar
    lanes[_SOLID, lane] = solid
    lanes[_FACE, lane] = face
    lanes[_MASS, lane] = mass = mu + (1.0 if on_projectile else 0.0)
    lanes[_WEIGHT, lane] = weight = mass * gravity * omega * omega
    lanes[_FORCE:, lane] = weight
    lanes[_REAL, lane] = 1.0
    lanes[_IMAGINARY, lane] = 0.0
    lanes[_TURN_REAL, lane] = decay * math.cos(root * omega * step)
    lanes[_TURN_IMAGINARY, lane] = decay * math.sin(root * omega * step)
    lanes[_SLOPE, lane] = zeta / root
    lanes[_SPEED, lane] = omega / root
    lanes[_ACCELERATION, lane] = omega * omega
    lanes[_FLOOR, lane] = -_NOISE * omega
    # from the top down: the row of each node in the matrix, freed of the one above it
    last = cells + more
    above = pivot = 0.0
    for j in range(last, -1, -1):
        node = j * _NODE + lane
        nodes[node + _U] = nodes[node + _V] = nodes[node + _A] = 0.0
        share = above / pivot if j < last else 0.0
        below = drag if j <= cells else solid
        pivot = _mass_of(j, face, cells, more) + below + above * (1.0 - share)
        above = below
        nodes[node + _SHARE] = share
        nodes[node + _GAIN] = 1.0 / pivot


@_jit
def _patience(mu, kappa):
    """Compute after how many crossings one gives up."""
    periods = MAX_PERIODS * max(kappa, 2.0 * math.pi * math.sqrt(mu))
    return min(1.0 + periods, MAX_CROSSINGS)


@_jit
def _mass_of(j, face, cells, more):
    """Compute the mass of a node in contact."""
    last = cells + more
    layer = 0.0 if j > cells else (0.5 if j in (0, cells) else 1.0) / cells
    bar = 0.0 if j < cells else face * (1.0 if j in (cells, last) else 2.0)
    return layer + bar


@_jit
def _move(nodes, lanes, source, target):
    """Copy a lane."""
    lanes[:, target] = lanes[:, source]
    for k in range(target, nodes.size, _LANES):
        nodes[k] = nodes[k + source - target]


@_jit
def _step(nodes, lanes, width, cells, more, on_projectile):
    """
    Advance displacements to the next step, velocities to half a step beyond it.

    The inner loops go over lanes, and become vectors because their arrays are one and the same,
    and all offsets within it constant.
    """
    step = 1.0 / cells
    last = cells + more
    real, imaginary = lanes[_REAL], lanes[_IMAGINARY]
    turn_real, turn_imaginary = lanes[_TURN_REAL], lanes[_TURN_IMAGINARY]
    slope, speed, acceleration = lanes[_SLOPE], lanes[_SPEED], lanes[_ACCELERATION]
    loss, drag = lanes[_LOSS], lanes[_DRAG]
    bar, solid, face = lanes[_BAR], lanes[_SOLID], lanes[_FACE]
    weight = lanes[_WEIGHT]
    for row in range(_LANE_ROWS - 1, _FORCE, -1):
        lanes[row, :width] = lanes[row - 1, :width]
    force = lanes[_FORCE]
    plate = nodes[:_NODE]
    for i in range(width):
        plate[_U + i] = 1.0 - (real[i] + slope[i] * imaginary[i])
        plate[_A + i] = acceleration[i] * (real[i] - slope[i] * imaginary[i])
        plate[_V + i] = speed[i] * imaginary[i] - 0.5 * step * plate[_A + i]
        turned = real[i] * turn_real[i] - imaginary[i] * turn_imaginary[i]
        imaginary[i] = real[i] * turn_imaginary[i] + imaginary[i] * turn_real[i]
        real[i] = turned
    # from the top down: displacements, stresses, and elimination
    top = nodes[last * _NODE :]
    for i in range(width):
        top[_U + i] += step * top[_V + i]
        top[_A + i] = 0.0
    for j in range(last - 1, cells - 1, -1):
        pair = nodes[j * _NODE : (j + 2) * _NODE]
        for i in range(width):
            pair[_U + i] += step * pair[_V + i]
            stress = bar[i] * (pair[_NODE + _U + i] - pair[_U + i])
            pair[_NODE + _A + i] -= stress
            pair[_A + i] = stress + pair[_SHARE + i] * pair[_NODE + _A + i]
    for j in range(cells - 1, -1, -1):
        pair = nodes[j * _NODE : (j + 2) * _NODE]
        for i in range(width):
            below = pair[_U + i]
            if j > 0:
                below += step * pair[_V + i]
                pair[_U + i] = below
            stress = cells * (pair[_NODE + _U + i] - below)
            stress += loss[i] * (pair[_NODE + _V + i] - pair[_V + i])
            pair[_NODE + _A + i] -= stress
            stress += pair[_SHARE + i] * pair[_NODE + _A + i]
            if j > 0:
                pair[_A + i] = stress
            else:
                inertia = 0.5 * step + drag[i] * (1.0 - pair[_SHARE + i])
                force[i] = weight[i] + inertia * pair[_A + i] - stress
    # from the plate up: accelerations, and velocities
    for j in range(1, last + 1):
        pair = nodes[(j - 1) * _NODE : (j + 1) * _NODE]
        for i in range(width):
            value = (
                pair[_NODE + _GAIN + i] * pair[_NODE + _A + i] + pair[_SHARE + i] * pair[_A + i]
            )
            pair[_NODE + _A + i] = value
            pair[_NODE + _V + i] += step * value
    steps = lanes[_STEPS]
    for i in range(width):
        steps[i] += 1.0
    if not on_projectile:
        pair = nodes[cells * _NODE :]
        for i in range(width):
            force[i] = weight[i] + face[i] * pair[_A + i]
            if more > 0:
                stretch = pair[_NODE + _U + i] - pair[_U + i]
                drift = pair[_NODE + _A + i] - pair[_A + i]
                force[i] -= bar[i] * stretch + solid[i] * drift


@_jit
def release_within(
    after: float, before: float, earlier: float, first: float, weight: float
) -> tuple[float, float]:
    """
    Find when the contact force falls below zero within a step, and what it has done.

    The force is the cubic through its values at the end of this step and of the three before. It
    returns the part of the step that has passed, and the integral of force less weight from half
    of the step to there, in steps. For use inside compiled code.
    """
    third = (after - first + 3.0 * (earlier - before)) / 6.0
    second = 0.5 * (earlier + after) - before
    slope = after - before - second - third
    low, high = 0.0, 1.0
    while True:
        part = 0.5 * (low + high)
        if not low < part < high:
            break
        if before + part * (slope + part * (second + part * third)) < 0.0:
            high = part
        else:
            low = part
    impulse = (before - weight) * (part - 0.5) + slope * (part**2 - 0.25) / 2.0
    impulse += second * (part**3 - 0.125) / 3.0 + third * (part**4 - 0.0625) / 4.0
    return part, impulse


@_jit
def _release(nodes, lanes, lane, cells, more, on_projectile):
    """Compute when the force fell to 0 in the last step, and the speed of the centre of mass."""
    step = 1.0 / cells
    force, weight = lanes[_FORCE:, lane], lanes[_WEIGHT, lane]
    part, impulse = release_within(force[0], force[1], force[2], force[3], weight)
    # from half a step beyond the last one back to there
    momentum = step * (impulse - (force[0] - weight))
    for j in range(0 if on_projectile else cells, cells + more + 1):
        mass = _mass_of(j, lanes[_FACE, lane], cells, more)
        if j == cells and not on_projectile:
            mass = lanes[_FACE, lane]
        momentum += mass * nodes[j * _NODE + _V + lane]
    return (lanes[_STEPS, lane] - 2.0 + part) * step, momentum / lanes[_MASS, lane]
