# SPDX-License-Identifier: Apache-2.0
r"""
First releases by finite differences: with internal loss, and with an elastic projectile.

Notes
-----
Eqs. (2)-(3) of [1]_, :math:`\rho u_{tt} = \sigma_y`, with the Kelvin-Voigt stress
:math:`\sigma = E u_y + \eta u_{ty}`, for a uniform layer of N cells and, unless it is rigid, an
elastic projectile of cells of its own. Displacements u belong to nodes and whole steps,
velocities v to nodes and half steps, so that semi-implicit Euler is of second order,

.. math::

    M \frac{v^{n+1/2} - v^{n-1/2}}{h} = -K (u^n + \beta h^2 a^n)
    - C \frac{v^{n+1/2} + v^{n-1/2}}{2}, \qquad u^{n+1} = u^n + h v^{n+1/2},

where a is the acceleration. The step h is what a wave needs for a cell of the layer: there the
scheme has no dispersion, and takes fronts from node to node as they are. The projectile is cut
into as many cells as its wave crosses within steps, at least two; if it is so stiff that it
crosses more than a cell in a step, :math:`\beta = 1/4` (average acceleration) keeps this stable,
else :math:`\beta = 0`. What is implicit is one tridiagonal system with constant coefficients.

Left as in [1]_: the section stays as it is, and the layer has no weight.

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
from numpy.typing import ArrayLike
from soft_throw_ros.core import checks
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.travelling_wave import FirstRelease, ThrowUnresolvedError

MAX_CROSSINGS = 400.0
"""Crossings of the wave that are followed before a named error is raised."""

DEFAULT_CELLS = 128
"""Cells of the layer."""

_FEWEST_PROJECTILE_CELLS = 2

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
    cells: int = DEFAULT_CELLS,
    unresolved: Literal['raise', 'nan'] = 'raise',
    threads: int | None = None,
) -> FirstRelease:
    r"""
    Find when and how fast projectiles first leave their layers, for many throws.

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
        :math:`L_r c_s / (c_r L_s)`; 0 is rigid. [-]
    cells : int
        Into which the layer is cut, from 8 to 4096.
    unresolved : {'raise', 'nan'}
        What becomes of throws that are not resolved: the first is raised, or all are NaN.
    threads : int, optional
        Largest number of threads, all cores if not given. Results do not depend on it.

    Returns
    -------
    FirstRelease
        Of arrays with the common shape; the speed is that of the projectile's centre of mass.

    Raises
    ------
    ValueError
        If a ratio is not finite and positive (damping: in [0, 1); gravity, loss and crossing
        ratio: not negative), the shapes do not fit, or an option is not one of its values.
    ThrowUnresolvedError
        If a projectile does not leave within `MAX_CROSSINGS`, unless `unresolved` is 'nan'.

    Examples
    --------
    Internal loss costs energy:

    >>> throws = first_releases(
    ...     mass_ratio=0.234231, speed_ratio=8.242210, loss_tangent=[0.0, 0.02]
    ... )
    >>> throws.energy_transfer.round(2)
    array([4.12, 3.8 ])

    """
    if unresolved not in ('raise', 'nan'):
        raise ValueError(f"unresolved must be 'raise' or 'nan', got {unresolved!r}")
    if threads is not None and not (type(threads) is int and threads > 0):
        raise ValueError(f'threads must be a positive whole number or None, got {threads!r}')
    if not (type(cells) is int and 8 <= cells <= 4096):
        raise ValueError(f'cells must be a whole number from 8 to 4096, got {cells!r}')
    damping_ratio = checks.below_one_array('damping_ratio', damping_ratio)
    cases = np.broadcast_arrays(
        checks.positive_array('mass_ratio', mass_ratio),
        checks.positive_array('speed_ratio', speed_ratio),
        damping_ratio,
        checks.not_negative_array('gravity_ratio', gravity_ratio),
        checks.not_negative_array('loss_tangent', loss_tangent),
        checks.not_negative_array('crossing_ratio', crossing_ratio),
    )
    shape = cases[0].shape
    rows = np.stack([case.ravel() for case in cases], axis=1)
    found = np.empty((rows.shape[0], 2))
    parts = max(1, min(threads or os.cpu_count() or 1, rows.shape[0]))

    def run(part: int) -> None:
        _releases(rows, cells, found, part, parts)

    with ThreadPoolExecutor(parts) as pool:
        list(pool.map(run, range(parts)))
    failed = np.flatnonzero(np.isnan(found[:, 0]))
    if failed.size and unresolved == 'raise':
        mu, kappa, zeta, gravity, loss, crossing = rows[failed[0]]
        raise ThrowUnresolvedError(
            f'no release within {MAX_CROSSINGS:.0f} crossings for mass_ratio {mu:g}, '
            f'speed_ratio {kappa:g}, damping_ratio {zeta:g}, gravity_ratio {gravity:g}, '
            f'loss_tangent {loss:g}, crossing_ratio {crossing:g}'
        )
    phase, speed = found.T.reshape(2, *shape)
    return FirstRelease(phase, speed, (speed / _peak_velocity_ratio(damping_ratio)) ** 2)


@_jit
def _releases(rows, cells, found, part, parts):
    """Compute every so-manieth throw."""
    for i in range(part, rows.shape[0], parts):
        row = rows[i]
        found[i, 0], found[i, 1] = _release(row[0], row[1], row[2], row[3], row[4], row[5], cells)


@_jit
def _plate(omega, zeta, time):
    """Height of the plate over its amplitude, (D2)."""
    root = math.sqrt(1.0 - zeta * zeta)
    angle = root * omega * time
    decay = math.exp(-zeta * omega * time)
    return 1.0 - decay * (math.cos(angle) + zeta / root * math.sin(angle))


@_jit
def _release(mu, kappa, zeta, gravity, loss, crossing, cells):
    """Compute (t_e f, V_e / (A w)), NaN if there is no release; layer's mass and t_s are 1."""
    omega = 2.0 * math.pi / kappa
    step = 1.0 / cells
    more = 0
    if crossing > 0.0:
        more = max(_FEWEST_PROJECTILE_CELLS, int(crossing * cells))
    size = cells + more
    stiffness = np.empty(size)
    viscosity = np.zeros(size)
    mass = np.zeros(size + 1)
    implicit = np.zeros(size)
    for i in range(size):
        if i < cells:
            stiffness[i] = cells
            viscosity[i] = loss / omega * cells
            implicit[i] = 0.5 * step * viscosity[i]
            half = 0.5 * step
        else:
            stiffness[i] = mu / crossing**2 * more
            if crossing < step * more:
                implicit[i] = 0.25 * step * step * stiffness[i]
            half = 0.5 * mu / more
        mass[i] += half
        mass[i + 1] += half
    if more == 0:
        mass[cells] += mu
    # from the top down: row j of the tridiagonal matrix, freed of what is above it
    share = np.zeros(size + 1)
    pivot = np.zeros(size + 1)
    for j in range(size, 0, -1):
        pivot[j] = mass[j] + implicit[j - 1]
        if j < size:
            share[j] = implicit[j] / pivot[j + 1]
            pivot[j] += implicit[j] * (1.0 - share[j])
    u = np.zeros(size + 1)
    v = np.zeros(size + 1)
    a = np.zeros(size + 1)
    stress = np.zeros(size)
    weight = mu * gravity * omega**2
    before = weight
    height, coming = 0.0, _plate(omega, zeta, step)
    for n in range(1, int(MAX_CROSSINGS * cells)):
        past, height, coming = height, coming, _plate(omega, zeta, (n + 1) * step)
        u[0] = height
        v[0] = (height - past) * cells
        a[0] = (coming - 2.0 * height + past) * cells * cells
        for j in range(1, size + 1):
            u[j] += step * v[j]
        for i in range(size):
            stress[i] = stiffness[i] * (u[i + 1] - u[i]) + viscosity[i] * (v[i + 1] - v[i])
        a[size] = -stress[size - 1]
        for j in range(size - 1, 0, -1):
            a[j] = stress[j] - stress[j - 1] + share[j] * a[j + 1]
        for j in range(1, size + 1):
            a[j] = (a[j] + implicit[j - 1] * a[j - 1]) / pivot[j]
        below = stress[cells - 1] + implicit[cells - 1] * (a[cells] - a[cells - 1])
        force = weight - (below + 0.5 * step * a[cells])
        if force < 0.0 and n > cells:
            part = before / (before - force)
            momentum = 0.0
            if more == 0:
                momentum = mu * v[cells]
            else:
                for j in range(cells, size + 1):
                    momentum += (mass[j] if j > cells else 0.5 * mu / more) * v[j]
            drift = (part - 0.5) * (before - weight)
            drift += 0.5 * (part * part - 0.25) * (force - before)
            return (n - 1 + part) / cells / kappa, (momentum + step * drift) / mu / omega
        before = force
        for j in range(1, size + 1):
            v[j] += step * a[j]
    return math.nan, math.nan
