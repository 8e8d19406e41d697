# SPDX-License-Identifier: Apache-2.0
"""One second of the default rig: throw, flight, landings, and the layer's field at 1 kHz."""

from __future__ import annotations

from collections.abc import Callable
import functools
from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.grid_stepper import GridStepper
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.stepping import ThrowStepper
from soft_throw_ros.core.throw import simulate

from bench import peers
from bench.one_throw import TRUE
from bench.race import head, race

TICKS = 1000


class Way(NamedTuple):
    """A way through a share of a second, which returns t_e f."""

    call: Callable[[], float]
    steps: float  # in one second
    true: float
    share: float = 1.0


def rows() -> list[str]:
    """Return the rows of a Markdown table, the head first."""
    ways = _ways()
    times = race({name: way.call for name, way in ways.items()})
    first, *_ = times.values()
    lines = head(
        f'one second, {TICKS} ticks',
        'error of t_e f',
        'real-time factor',
        'us per tick, min',
        'median',
        'ns per step',
        'over stepper',
    )
    for name, way in ways.items():
        least, median = (time / way.share for time in times[name])
        lines.append(
            f'| {name} | {abs(way.call() - way.true):.1e} | {1.0 / least:.4g} '
            f'| {1e6 * least / TICKS:.3g} | {1e6 * median / TICKS:.3g} '
            f'| {1e9 * least / way.steps:.3g} | {least / first.least:.3g} |'
        )
    return lines


def _ways() -> dict[str, Way]:
    rig = Rig()
    case = peers.Case.of(rig)
    second = 1.0 / rig.crossing_time
    frequency = rig.engine.frequency
    true = simulate(rig, max_events=1).ejection_time * frequency
    ways: dict[str, Way] = {}
    for steps in (None, 200):
        stepper = Stepper(rig, steps=steps)
        title = f'stepper, {stepper.steps} steps per crossing'
        for how, ticks, has_field in (
            ('with the field', TICKS, True),
            ('without it', TICKS, False),
            ('in one call', 1, False),
        ):
            ways[f'{title}, {how}'] = Way(
                functools.partial(_step, stepper, ticks=ticks, has_field=has_field),
                stepper.steps * second,
                true,
            )
    lossy = Rig(layer=Layer(loss_tangent=0.05))
    with_loss = simulate(lossy, model='finite_difference', max_events=1, cells=2048)
    for title, model, its_rig, its_true in (
        ('', 'finite_difference', rig, true),
        (', internal loss', 'finite_difference', lossy, with_loss.ejection_time * frequency),
        (', elastic projectile', 'finite_difference_elastic', rig, true),
    ):
        grid = GridStepper(its_rig, model=model)
        cells = grid.grid.cells
        ways[f'our finite differences, {cells} cells{title}, with the field'] = Way(
            functools.partial(_step, grid, ticks=TICKS, has_field=True),
            cells * second,
            its_true,
        )
    for cells in (64, 200):
        ways[f'finite differences, rigid projectile, numba, {cells} cells'] = Way(
            functools.partial(_differences, case, second, cells), cells * second, true
        )
    ways['finite differences, rigid projectile, numpy, 64 cells (0.05 s, scaled)'] = Way(
        functools.partial(_differences_by_numpy, case, 0.05 * second, 64),
        64 * second,
        true,
        share=0.05,
    )
    bar = peers.Bar.of(rig, cells=64, projectile_cells=4)
    weightless = case._replace(gravity=0.0)
    ways["the paper's finite differences, numba, 64 + 4 cells (one throw, scaled)"] = Way(
        lambda: peers.elastic_numba(weightless, bar).ejection_phase,
        second / bar.dt,
        TRUE.ejection_phase,
        share=TRUE.ejection_phase / rig.engine.frequency,
    )
    return ways


def _step(stepper: ThrowStepper, *, ticks: int, has_field: bool) -> float:
    strain, velocity = np.empty((2, stepper.field_points))
    stepper.reset()
    for tick in range(1, ticks + 1):
        stepper.advance_to(tick / ticks)
        if has_field:
            stepper.read_field(strain, velocity)
    return stepper.events()[0].time * stepper.rig.engine.frequency


def _differences(case: peers.Case, duration: float, cells: int) -> float:
    frame_steps = round(duration * cells / TICKS)
    strain = np.empty((round(duration * cells / frame_steps), cells))
    time = peers.march_kernel(case.mu, case.omega, case.zeta, case.gravity, frame_steps, strain)
    return time / case.kappa


def _differences_by_numpy(case: peers.Case, duration: float, cells: int) -> float:
    march = peers.NumpyMarch(case, cells=cells)
    for _ in range(round(duration * cells)):
        march.step()
    return march.releases[0][0] / case.kappa
