# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Throws, maps, simulated seconds and recommendations, compared with simpler methods."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
import sys
from typing import Any

from bench.race import Case, Table
import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.cell_stepper import CellStepper, throw_batch
from soft_throw_ros.core.closed_form import (
    first_release,
    first_release_kernel,
    first_releases,
    MAX_INTERVALS,
)
from soft_throw_ros.core.processors import usable_processors
from soft_throw_ros.core.rig import Layer, Ratios, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.throws import throw_many
from soft_throw_ros.core.wave_stepper import WaveStepper
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.objectives.robust import Robust
from soft_throw_ros.design.recommendation import recommend

sys.path.append(str(Path(__file__).resolve().parents[1] / 'test'))

from reference.method_of_lines import first_release as first_release_by_lines  # noqa: E402, I100

Floats = NDArray[np.float64]

TRUE_PHASE = 0.4815082783157032
"""Ejection phase t_e f of the default rig without gravity, from two methods with 40 digits. [-]"""

LOOP = 1000
"""Number of throws in one compiled loop."""

TICKS = 1000
"""Number of ticks in one simulated second."""

SIDE = 128
"""Number of points of the map along each axis."""

DENSITY_RATIO = 1.3
"""Density of the projectile over that of the layer, as on the rig of the paper. [-]"""


def one_throw() -> Table:
    """Compute one first release of the default rig without gravity."""
    rig = Rig(gravity=0.0)
    work = np.empty((2, MAX_INTERVALS))
    ratios = rig.mass_ratio, rig.speed_ratio, rig.engine.damping_ratio

    def closed_form() -> float:
        mu, kappa, zeta = ratios
        release = first_release(mass_ratio=mu, speed_ratio=kappa, damping_ratio=zeta)
        return float(release.ejection_phase)

    def by_stepper(stepper: Any) -> float:
        stepper.reset()
        stepper.advance_to(0.5 / rig.engine.frequency)
        return float(stepper.events()[0].time * rig.engine.frequency)

    cases = [
        Case('closed form, called from Python', closed_form),
        Case('closed form, in a compiled loop', partial(_throw_often, *ratios, work), LOOP),
        Case('travelling waves, to the release', partial(by_stepper, WaveStepper(rig))),
        Case('cells, to the release', partial(by_stepper, CellStepper(rig))),
    ]
    return Table(
        'one throw', 'throw', 'error of t_e f',
        [case._replace(error=lambda phase: abs(phase - TRUE_PHASE)) for case in cases],
    )


@nb.njit(error_model='numpy')
def _throw_often(mu, kappa, zeta, work):
    """Return the phase of the last of many throws with slightly different mass ratios."""
    phase = 0.0
    for i in range(LOOP):
        mass_ratio = mu * (1.0 + 1e-9 * (LOOP - 1 - i))
        phase, _, _ = first_release_kernel(mass_ratio, kappa, zeta, 0.0, work)
    return phase


def one_gel() -> Table:
    """Compute one first release from a neo-Hookean layer with a constant loss tangent."""
    rig = Rig(layer=Layer(stress_strain_law='neo_hookean', loss='constant', loss_tangent=0.05))
    true = first_release_by_lines(rig, cells=400)[0]

    def by_cells() -> float:
        return float(throw_many(rig).ejection_time)

    cases = [
        Case('cells, to the release', by_cells),
        Case('solve_ivp, RK45, 64 cells', lambda: first_release_by_lines(rig, cells=64)[0]),
    ]
    return Table(
        'one throw from a gel', 'throw', 'error of t_e, relative',
        [case._replace(error=lambda time: abs(time / true - 1.0)) for case in cases],
    )


def landscape() -> Table:
    """Compute a map of first releases over the (x, C) of the paper, with its densities."""
    x, c = map(np.ravel, np.meshgrid(
        (np.arange(SIDE) + 0.5) / SIDE, 14.0 * (np.arange(SIDE) + 1.0) / SIDE
    ))
    ratios = {'mass_ratio': DENSITY_RATIO * (1.0 - x) / x, 'speed_ratio': c / x}
    exact = np.asarray(first_releases(**ratios).ejection_phase)

    def closed_form(threads: int | None) -> Floats:
        return np.asarray(first_releases(**ratios, threads=threads).ejection_phase)

    def by_cells() -> Floats:
        return throw_batch(Ratios(**ratios), Layer(), threads=1)[0]

    def error(phases: Floats) -> float:
        errors = np.abs(phases - exact)
        return float(np.percentile(errors[np.isfinite(errors)], 90))

    count = float(x.size)
    threads = usable_processors()
    cases = [
        Case('closed form, 1 thread', partial(closed_form, 1), count, goal=4e3 / count),
        Case(f'closed form, all threads ({threads})', partial(closed_form, None), count),
        Case('cells, 1 thread', by_cells, count),
    ]
    return Table(
        f'map of {SIDE} x {SIDE}', 'throw', 'error of t_e f, 90 %',
        [case._replace(error=error) for case in cases],
    )


def one_second() -> Table:
    """Simulate one second of the default rig: release, flight, landings and the layer."""
    rig = Rig()

    def run(stepper: Any, ticks: int, *, reads: bool) -> float:
        read = partial(stepper.read_layer, np.empty((3, stepper.field_points)))
        stepper.reset()
        for tick in range(1, ticks + 1):
            stepper.advance_to(tick / ticks)
            if reads:
                read()
        return float(stepper.events()[0].time)

    def error_of(true: float) -> Callable[[float], float]:
        return lambda time: abs(time - true) * rig.engine.frequency

    def gel_case(name: str, goal: float, **options: Any) -> Case:
        gel = Rig(layer=Layer(**options))
        fine = simulate(gel, max_events=1, cells=1024)
        call = partial(run, CellStepper(gel, cells=64), TICKS, reads=True)
        error = error_of(fine.ejection_time)
        return Case(f'64 cells with {name}, the same', call, error=error, goal=goal)

    waves = WaveStepper(rig)
    cases = [
        Case('waves, 200 steps per crossing, one call',
             partial(run, WaveStepper(rig, steps=200), 1, reads=False), goal=2000.0),
        Case('waves, default steps, 1000 ticks with the layer',
             partial(run, waves, TICKS, reads=True), goal=1000.0 / 1.6),
        Case('waves, default steps, 1000 ticks', partial(run, waves, TICKS, reads=False)),
        Case('64 cells, 1000 ticks with the layer',
             partial(run, CellStepper(rig, cells=64), TICKS, reads=True), goal=300.0),
        gel_case('loss', 150.0, loss_tangent=0.05),
        gel_case('constant loss', 100.0, loss_tangent=0.05, loss='constant'),
        gel_case('large strain', 100.0, stress_strain_law='neo_hookean'),
        gel_case('large strain and loss', 100.0, stress_strain_law='neo_hookean',
                 loss_tangent=0.05),
        gel_case('large strain and constant loss', 100.0, stress_strain_law='neo_hookean',
                 loss_tangent=0.05, loss='constant'),
    ]
    error = error_of(simulate(rig, max_events=1).ejection_time)
    return Table(
        'one second', 'second', 'error of t_e f',
        [case._replace(error=case.error or error) for case in cases], is_factor=True,
    )


def recommendation() -> Table:
    """Find the best layer: thickness and wave speed within the default limits."""
    rig = Rig(gravity=0.0)
    lossy = Rig(layer=Layer(loss_tangent=0.1))
    limits = Limits(max_strain=0.1)

    def brute_force() -> float:
        thickness, speed = np.geomspace(1e-3, 0.05, 400)[:, None], np.geomspace(1.0, 50.0, 400)
        throws = throw_many(rig, {'thickness': thickness, 'wave_speed': speed})
        return float(np.nanmax(throws.energy_transfer))

    best = brute_force()
    cases = [
        Case('plain', lambda: float(recommend(rig).energy_transfer),
             error=lambda alpha: max(best - alpha, 0.0) / best, goal=5e4),
        Case('brute force, 400 x 400 by the closed form', brute_force, error=lambda _: 0.0),
        Case('robust', lambda: recommend(rig, objective=Robust())),
        Case('with a limit of strain', lambda: recommend(rig, limits=limits)),
        Case('with loss and a limit of strain',
             lambda: recommend(lossy, limits=limits), goal=2e6),
    ]
    return Table('one recommendation', 'answer', 'alpha lost, relative', cases)


TABLES = (one_throw, one_gel, landscape, one_second, recommendation)
"""Functions that set up the tables; the name of a function is the name of its part."""
