# SPDX-License-Identifier: Apache-2.0
"""A map of first releases over the paper's (x, C), its densities, harmonic plate."""

from __future__ import annotations

from collections.abc import Callable
import functools
import math
import os
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import finite_difference
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.travelling_wave import (
    first_release_kernel,
    first_releases,
    MAX_INTERVALS,
)

from bench import peers
from bench.race import head, race

Floats = NDArray[np.float64]

SIDE = 128
LARGE_SIDE = 1024
DENSITY_RATIO = 1.3

_BATCH = 'exact batch, 1 thread'
_SCALAR = 'exact scalar in a compiled loop, 1 thread'
_LARGE = 'exact batch, 1 thread, large'


class Way(NamedTuple):
    """A way to t_e f at some of the points, NaN at the others."""

    call: Callable[[], Floats]
    points: int = SIDE * SIDE


def rows() -> list[str]:
    """Return the rows of a Markdown table, the head first."""
    mu, kappa = _ratios(SIDE)
    ways = _ways(mu, kappa)
    calls = {name: way.call for name, way in ways.items()}
    times = race({**calls, _LARGE: functools.partial(_batch, *_ratios(LARGE_SIDE), 1)})
    exact = ways[_SCALAR].call()
    lines = head(
        f'{SIDE} x {SIDE} throws',
        'error of t_e f, median',
        '99 %',
        'min [ms]',
        'median [ms]',
        'us per throw',
        'over batch',
    )
    for name, way in ways.items():
        errors = np.abs(way.call() - exact)
        middle, most = np.percentile(errors[np.isfinite(errors)], (50, 99))
        least, median = (time * mu.size / way.points for time in times[name])
        lines.append(
            f'| {name} | {middle:.1e} | {most:.1e} | {1e3 * least:.4g} | {1e3 * median:.4g} '
            f'| {1e6 * least / mu.size:.3g} | {least / times[_BATCH].least:.3g} |'
        )
    large = times[_LARGE].least
    ratio = large / times[_BATCH].least * (SIDE / LARGE_SIDE) ** 2
    size = f'{LARGE_SIDE} x {LARGE_SIDE}'
    lines.append('')
    lines.append(f'{size} throws by the {_BATCH}: {1e3 * large:.4g} ms, {ratio:.2f} times each.')
    return lines


def _ratios(side: int) -> tuple[Floats, Floats]:
    """Return mass and speed ratios over a square of x and C."""
    x = (np.arange(side) + 0.5) / side
    c = 14.0 * (np.arange(side) + 1.0) / side
    x, c = map(np.ravel, np.meshgrid(x, c))
    return DENSITY_RATIO * (1.0 - x) / x, c / x


def _batch(mu: Floats, kappa: Floats, threads: int | None) -> Floats:
    releases = first_releases(mass_ratio=mu, speed_ratio=kappa, threads=threads)
    return np.asarray(releases.ejection_phase)


def _our_differences(mu: Floats, kappa: Floats, wave_speed_ratio: float) -> Floats:
    releases = finite_difference.first_releases(
        mass_ratio=mu,
        speed_ratio=kappa,
        crossing_ratio=mu / DENSITY_RATIO * wave_speed_ratio,
        unresolved='nan',
        threads=1,
    )
    return np.asarray(releases.ejection_phase)


def _ways(mu: Floats, kappa: Floats) -> dict[str, Way]:
    shuffled = np.random.default_rng(1).permutation(mu.size)

    def sample(throw: Callable[[peers.Case], peers.Release], points: int) -> Way:
        def call() -> Floats:
            phases = np.full(mu.size, math.nan)
            for i in shuffled[:points]:
                phases[i] = throw(peers.Case(mu[i], kappa[i])).ejection_phase
            return phases

        return Way(call, points)

    ways = {
        _BATCH: Way(functools.partial(_batch, mu, kappa, 1)),
        f'exact batch, all threads ({os.cpu_count()})': Way(
            functools.partial(_batch, mu, kappa, None)
        ),
        _SCALAR: Way(functools.partial(_exact, mu, kappa, np.empty((2, MAX_INTERVALS)))),
    }
    for projectile, ratio in (('rigid', 0.0), ('elastic', _wave_speed_ratio())):
        ways[f'finite differences of the package, {projectile} projectile, 1 thread'] = Way(
            functools.partial(_our_differences, mu, kappa, ratio)
        )
    for cells in (25, 100):
        ways[f'finite differences, rigid projectile, numba, {cells} cells, 1 thread'] = Way(
            functools.partial(_differences, mu, kappa, cells)
        )
    for name, throw, points in (
        (
            'finite differences, rigid projectile, numpy, 25 cells',
            functools.partial(peers.rigid_numpy, cells=25),
            48,
        ),
        ("the paper's finite differences, numba, 25 + 4 cells", _elastic, 48),
        ("the paper's finite differences, numba, 100 cells alike", _elastic_alike, 24),
        (
            'solve_ivp, DOP853, 25 cells, rtol 1e-06',
            functools.partial(peers.method_of_lines, cells=25, tolerance=1e-6),
            12,
        ),
    ):
        ways[f'{name} ({points} throws, scaled)'] = sample(throw, points)
    return ways


def _elastic(case: peers.Case) -> peers.Release:
    """Throw by the paper's scheme, with a grid for each of the two materials."""
    return peers.elastic_numba(case, peers.Bar.of(_rig(case), cells=25, projectile_cells=4))


def _elastic_alike(case: peers.Case) -> peers.Release:
    """Throw by the paper's scheme on one uniform grid."""
    rig = _rig(case)
    layer, projectile = rig.layer.thickness, rig.projectile.length
    cells = min(max(round(100 * layer / (layer + projectile)), 1), 99)
    return peers.elastic_numba(case, peers.Bar.of(rig, cells=cells, projectile_cells=100 - cells))


def _rig(case: peers.Case) -> Rig:
    """Make a rig with the layer as it is and the projectile as long as mu says."""
    layer = Layer()
    return Rig(
        engine=Engine(frequency=1.0 / (case.kappa * layer.crossing_time), damping_ratio=0.0),
        layer=layer,
        projectile=Projectile(
            mass=case.mu * layer.mass, length=case.mu * layer.thickness / DENSITY_RATIO
        ),
        gravity=0.0,
    )


def _wave_speed_ratio() -> float:
    """Return the wave speed of the layer over that of the projectile."""
    layer, projectile = Layer(), Projectile()
    return layer.wave_speed / math.sqrt(
        projectile.youngs_modulus / (DENSITY_RATIO * layer.density)
    )


@nb.njit(error_model='numpy')
def _exact(mu, kappa, work):
    phases = np.empty(mu.size)
    for i in range(mu.size):
        phases[i] = first_release_kernel(mu[i], kappa[i], 0.0, 0.0, work)[0]
    return phases


@nb.njit(error_model='numpy')
def _differences(mu, kappa, cells):
    phases = np.empty(mu.size)
    for i in range(mu.size):
        time, _ = peers.rigid_kernel(mu[i], 2.0 * math.pi / kappa[i], 0.0, cells)
        phases[i] = time / kappa[i]
    return phases
