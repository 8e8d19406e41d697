# SPDX-License-Identifier: Apache-2.0
"""
A map of first releases by elastic finite differences, over the paper's (x, C), with its densities.

The plain scheme is the paper's on one uniform grid, so that the projectile's fast waves set the
step for all: c_r / c_s times as many as the layer alone would need.
"""

from __future__ import annotations

from collections.abc import Callable
import functools
import math
import os
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.finite_difference import first_releases
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.travelling_wave import first_releases as exact_releases

from bench import peers
from bench.race import head, race

Floats = NDArray[np.float64]

SIDE = 128
DENSITY_RATIO = 1.3
WAVE_SPEED = math.sqrt(3.6e9 / 1300.0)  # of the projectile [m/s]
TOLERANCE = 1e-3

_OURS = 'ours, 1 thread'


class Way(NamedTuple):
    """A way to t_e f and alpha at some of the points, NaN at the others."""

    call: Callable[[], Floats]
    points: int = SIDE * SIDE


def rows() -> list[str]:
    """Return the rows of a Markdown table, the head first."""
    x = (np.arange(SIDE) + 0.5) / SIDE
    c = 14.0 * (np.arange(SIDE) + 1.0) / SIDE
    x, c = map(np.ravel, np.meshgrid(x, c))
    ways = _ways(x, c)
    times = race({name: way.call for name, way in ways.items()})
    # an elastic projectile of 3.6 GPa changes both by 1e-5
    exact = exact_releases(mass_ratio=DENSITY_RATIO * (1.0 - x) / x, speed_ratio=c / x)
    true = np.stack((exact.ejection_phase, exact.energy_transfer))
    lines = head(
        f'{SIDE} x {SIDE} elastic throws',
        'error of t_e f, median',
        '90 %',
        'of alpha, 90 %',
        f'both below {TOLERANCE:g}',
        'min [s]',
        'median [s]',
        'us per throw',
        'over ours',
    )
    for name, way in ways.items():
        error = np.abs(way.call() - true) / np.array([true[0], np.maximum(true[1], 0.1)])
        error = error[:, np.isfinite(error[0])]
        (middle, most), (_, alpha) = (np.percentile(part, (50, 90)) for part in error)
        good = 100.0 * np.mean((error < TOLERANCE).all(axis=0))
        least, median = (time * x.size / way.points for time in times[name])
        lines.append(
            f'| {name} | {middle:.1e} | {most:.1e} | {alpha:.1e} | {good:.1f} % | {least:.3g} '
            f'| {median:.3g} | {1e6 * least / x.size:.3g} | {least / times[_OURS].least:.3g} |'
        )
    return lines


def _ways(x: Floats, c: Floats) -> dict[str, Way]:
    shuffled = np.random.default_rng(1).permutation(x.size)

    def ours(threads: int | None) -> Floats:
        releases = first_releases(
            mass_ratio=DENSITY_RATIO * (1.0 - x) / x,
            speed_ratio=c / x,
            crossing_ratio=(1.0 - x) / x * Layer().wave_speed / WAVE_SPEED,
            threads=threads,
        )
        return np.stack((releases.ejection_phase, releases.energy_transfer))

    def plain(cells: int, points: int) -> Way:
        def call() -> Floats:
            found = np.full((2, x.size), math.nan)
            for i in shuffled[:points]:
                found[:, i] = _plain(x[i], c[i], cells)
            return found

        return Way(call, points)

    ways = {
        _OURS: Way(functools.partial(ours, 1)),
        f'ours, all threads ({os.cpu_count()})': Way(functools.partial(ours, None)),
    }
    for cells, points in ((50, 96), (100, 48), (200, 12)):
        name = f"the paper's scheme in numba, uniform grid of {cells} cells, 1 thread"
        ways[f'{name} ({points} throws, scaled)'] = plain(cells, points)
    return ways


def _plain(x: float, c: float, cells: int) -> peers.Release:
    """Throw by the plain scheme, with layer and projectile on one grid."""
    layer = Layer()
    length = layer.thickness * (1.0 - x) / x
    mass = DENSITY_RATIO * layer.density * layer.section * length
    rig = Rig(
        engine=Engine(frequency=x / (c * layer.crossing_time), damping_ratio=0.0),
        layer=layer,
        projectile=Projectile(mass=mass, length=length, youngs_modulus=1300.0 * WAVE_SPEED**2),
        gravity=0.0,
    )
    of_layer = max(2, round(x * cells))
    bar = peers.Bar.of(rig, cells=of_layer, projectile_cells=max(1, cells - of_layer))
    return peers.elastic_numba(peers.Case(rig.mass_ratio, rig.speed_ratio), bar)
