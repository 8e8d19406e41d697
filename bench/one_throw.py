# SPDX-License-Identifier: Apache-2.0
"""One first release of the default rig, without gravity."""

from __future__ import annotations

from collections.abc import Callable
import functools

import numba as nb
import numpy as np
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.travelling_wave import (
    first_release,
    first_release_kernel,
    MAX_INTERVALS,
)

from bench import peers
from bench.race import head, race, Times

TRUE = peers.Release(0.4815082783157032, 3.6373472456471254)
"""Computed with 40 digits, and checked by a second method."""

LOOP = 1000
"""Throws in the compiled loop."""

_IN_LOOP = 'exact, in a compiled loop'
_CALLED = 'exact, called from Python'


def rows() -> list[str]:
    """Return the rows of a Markdown table, the head first."""
    ways = _ways()
    times = race(ways)
    times[_IN_LOOP] = Times(*(time / LOOP for time in times[_IN_LOOP]))
    lines = head(
        'one throw', 'error of t_e f', 'of alpha', 'min [us]', 'median [us]', 'over exact'
    )
    for name, way in ways.items():
        phase, alpha = way()
        least, median = times[name]
        lines.append(
            f'| {name} | {abs(phase - TRUE.ejection_phase):.1e} '
            f'| {abs(alpha / TRUE.energy_transfer - 1.0):.1e} '
            f'| {1e6 * least:.3g} | {1e6 * median:.3g} | {least / times[_CALLED].least:.3g} |'
        )
    return lines


def _ways() -> dict[str, Callable[[], peers.Release]]:
    rig = Rig(gravity=0.0)
    case = peers.Case.of(rig)
    stepper = Stepper(rig, field_points=2)
    plate_speed = Underdamped.of(rig.engine).peak_velocity
    work = np.empty((2, MAX_INTERVALS))

    def in_loop() -> peers.Release:
        phase, speed = _loop(case.mu, case.kappa, case.zeta, work)
        return case.release(phase * case.kappa, speed * case.omega)

    def called() -> peers.Release:
        exact = first_release(mass_ratio=case.mu, speed_ratio=case.kappa, damping_ratio=case.zeta)
        return peers.Release(exact.ejection_phase, exact.energy_transfer)

    def stepped() -> peers.Release:
        stepper.reset()
        stepper.advance_to(0.5 / rig.engine.frequency)
        _, time, speed = stepper.events()[0]
        return peers.Release(time * rig.engine.frequency, (speed / plate_speed) ** 2)

    ways: dict[str, Callable[[], peers.Release]] = {
        _IN_LOOP: in_loop,
        _CALLED: called,
        'stepper, to the release': stepped,
    }
    for name, way, cells in (
        ('numba', peers.rigid_numba, 25),
        ('numba', peers.rigid_numba, 100),
        ('numba', peers.rigid_numba, 800),
        ('numpy', peers.rigid_numpy, 25),
        ('numpy', peers.rigid_numpy, 100),
    ):
        title = f'finite differences, rigid projectile, {name}, {cells} cells'
        ways[title] = functools.partial(way, case, cells=cells)
    for name, elastic, cells, more in (
        ('numba', peers.elastic_numba, 50, 25),
        ('numba', peers.elastic_numba, 50, 4),
        ('numpy', peers.elastic_numpy, 50, 4),
    ):
        bar = peers.Bar.of(rig, cells=cells, projectile_cells=more)
        title = f"the paper's finite differences, {name}, {cells} + {more} cells"
        ways[title] = functools.partial(elastic, case, bar)
    for method, cells, tolerance in (
        ('RK45', 25, 1e-4),
        ('DOP853', 50, 1e-6),
        ('DOP853', 200, 1e-8),
    ):
        ways[f'solve_ivp, {method}, {cells} cells, rtol {tolerance:g}'] = functools.partial(
            peers.method_of_lines, case, cells=cells, method=method, tolerance=tolerance
        )
    return ways


@nb.njit(error_model='numpy')
def _loop(mu, kappa, zeta, work):
    """Throw many times, each a little different; the last is the one asked for."""
    phase = speed = 0.0
    for i in range(LOOP):
        nearby = mu * (1.0 + 1e-9 * (LOOP - 1 - i))
        phase, speed, _ = first_release_kernel(nearby, kappa, zeta, 0.0, work)
    return phase, speed
