# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Throws, simulated seconds and recommendations, compared with simpler methods."""

from __future__ import annotations

from functools import partial
from pathlib import Path
import sys
from typing import Any

from bench.tables import Case, measure, Result
import numpy as np
from soft_throw_ros.core.batch import leave_processors
from soft_throw_ros.core.cell_stepper import CellStepper
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import throw_many
from soft_throw_ros.core.wave_stepper import WaveStepper
from soft_throw_ros.design.recommendation import recommend
from soft_throw_ros.design.score import Limits

sys.path.append(str(Path(__file__).resolve().parents[1] / 'test'))

from reference.method_of_lines import first_release as release_by_lines  # noqa: E402, I100

# Ejection phase t_e f of the default rig without gravity, from two methods with 40 digits [-]
TRUE_PHASE = 0.4815082783157032
MANY = 16_384  # number of throws in one call [-]
TICKS = 1000  # number of ticks in one simulated second [-]
# The most expensive layer
GEL = Layer(stress_strain_law='neo_hookean', loss='constant', loss_tangent=0.05)


def throws() -> Result:
    """Compute first releases of the default rig without gravity, and from a gel."""
    rig, gel = Rig(gravity=0.0), Rig(layer=GEL)
    frequency = rig.engine.frequency
    ratios = {
        'mass_ratio': rig.mass_ratio, 'speed_ratio': rig.speed_ratio,
        'damping_ratio': rig.engine.damping_ratio,
    }
    many = ratios | {'mass_ratio': rig.mass_ratio * np.geomspace(1.0, 2.0, MANY)}

    def error(phase: float, true: float = TRUE_PHASE) -> float:
        return abs(phase - true)

    error_of_gel = partial(error, true=_by_lines(gel, cells=400))

    def by_waves(stepper: Any) -> float:
        stepper.reset()
        stepper.advance_to(0.5 / frequency)
        return float(stepper.events()[0].time * frequency)

    cases = [
        Case('travelling waves', partial(by_waves, WaveStepper(rig)), error=error),
        Case('closed form', lambda: float(first_releases(**ratios).ejection_phase), error=error),
        Case(f'closed form, {MANY} at once, 1 thread',
             leave_processors(sys.maxsize)(
                 lambda: float(first_releases(**many).ejection_phase[0])), MANY, error),
        Case('cells', partial(by_waves, CellStepper(rig)), error=error),
        Case('gel of large strain and constant loss, cells',
             lambda: float(throw_many(gel).ejection_time * frequency), error=error_of_gel),
        Case('the same, solve_ivp, RK45, 64 cells', partial(_by_lines, gel, cells=64),
             error=error_of_gel),
    ]
    return measure('one throw', 't_e f', cases)


def _by_lines(rig: Rig, *, cells: int) -> float:
    """Return the ejection phase by the method of lines."""
    return float(release_by_lines(rig, cells=cells)[0] * rig.engine.frequency)


def real_time() -> Result:
    """Simulate one second at 1 kHz with the layer: release, flight and landings."""

    def run(stepper: Any) -> float:
        stepper.reset()
        for tick in range(1, TICKS + 1):
            stepper.advance_to(tick / TICKS)
            stepper.read_layer()
        return float(stepper.events()[0].time)

    def cells(name: str, goal: float, layer: Layer) -> Case:
        rig = Rig(layer=layer)
        true = run(CellStepper(rig, cells=512))
        call = partial(run, CellStepper(rig, cells=64))
        return Case(
            f'64 cells, {name}', call, 1.0, lambda time: abs(time - true) * rig.engine.frequency,
            goal,
        )

    fine = run(WaveStepper(Rig(), steps=200))
    cases = [
        Case('travelling waves', partial(run, WaveStepper(Rig())), 1.0,
             lambda time: abs(time - fine) * Rig().engine.frequency, 1.6e3),
        cells('no loss', 3.3e3, Layer()),
        cells('loss', 1.3e4, Layer(loss_tangent=0.05)),
        cells('constant loss', 1e4, Layer(loss_tangent=0.05, loss='constant')),
        cells('large strain', 1e4, Layer(stress_strain_law='neo_hookean')),
        cells('large strain and constant loss', 1e4, GEL),
    ]
    return measure('one second with 1000 ticks', 't_e f', cases)


def recommendation() -> Result:
    """Find the best layer: thickness and wave speed within the default limits."""
    rig, lossy = Rig(gravity=0.0), Rig(layer=Layer(loss_tangent=0.1))

    def brute_force() -> float:
        thickness, speed = np.geomspace(1e-3, 0.05, 400)[:, None], np.geomspace(1.0, 50.0, 400)
        many = throw_many(rig, {'thickness': thickness, 'wave_speed': speed})
        return float(np.nanmax(many.energy_transfer))

    best = brute_force()
    cases = [
        Case('recommend', lambda: float(recommend(rig).energy_transfer), 1.0,
             lambda alpha: max(best - alpha, 0.0) / best, 5e4),
        Case('brute force, 400 x 400 by the closed form', brute_force, error=lambda _: 0.0),
        Case('recommend with loss and a limit of strain',
             lambda: recommend(lossy, limits=Limits(max_strain=0.1)), goal=2e6),
    ]
    return measure('one recommendation', 'alpha, relative', cases)
