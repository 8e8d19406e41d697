# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compute the tables of docs/design.md on loss and stacks, and draw the best stacks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
import math
from pathlib import Path
import sys
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from soft_throw_ros.core.material import LOSSES as LOSS_MODELS
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.stepper import PLATE_VELOCITY, PROJECTILE_VELOCITY
from soft_throw_ros.core.throw import simulate, throw_many
from soft_throw_ros.design.recommendation import recommend

sys.path.append(str(Path(__file__).resolve().parents[1] / 'paper'))

import style  # noqa: E402, I100
from style import replace_part, table  # noqa: E402

Floats = NDArray[np.float64]

DOCS = Path(__file__).resolve().parents[1]
PAGE, PICTURE = DOCS / 'design.md', DOCS / 'layers' / 'stacks.png'

LOW, HIGH = (1e-3, 4.0, 950.0), (0.05, 30.0, 1350.0)
"""Bounds of a cast sheet: thickness [m], wave speed [m/s], density [kg/m3]."""

MAX_THICKNESS = 0.05
"""Largest thickness of a stack. [m]"""

LOSSES = (0.0, 0.02, 0.05, 0.1, 0.2)
"""Loss tangents of the table. [-]"""

STRAINS = (math.inf, 0.2)
"""Largest strains of the table. [-]"""

_SEARCH_CELLS, _CELLS = 32, 256  # cells during the search, and of the results


class Best(NamedTuple):
    """The best layer, and the energy transfer and peak strain of its throw."""

    layer: Layer
    energy_transfer: float
    strain: float


def thrown(layer: Layer, cells: int = _CELLS) -> tuple[float, float]:
    """Return energy transfer and peak strain of the default rig."""
    throw = throw_many(Rig(layer=layer), loads=True, cells=cells)
    return float(throw.energy_transfer), float(throw.peak_strain)


def find_best(sheets: int, max_strain: float) -> Best:
    """Find the best stack of lossless sheets by a global random search, because alpha jumps."""

    def stack(logs: Floats) -> Layer:
        return Layer.of_sheets(
            tuple(
                Layer(thickness=thickness, wave_speed=speed, density=density)
                for thickness, speed, density in np.exp(logs).reshape(-1, 3).tolist()
            )
        )

    def objective(logs: Floats) -> float:
        layer = stack(logs)
        if layer.thickness > MAX_THICKNESS:
            return 0.0
        alpha, strain = thrown(layer, _SEARCH_CELLS)
        if not alpha > 0.0:
            return 0.0
        return -alpha * min(1.0, max_strain / strain) ** 4

    bounds = np.log(np.array([LOW, HIGH])).T.tolist() * sheets
    result = differential_evolution(
        objective, bounds, maxiter=20 * len(bounds), popsize=8, tol=1e-4, rng=1, polish=False
    )
    layer = stack(result.x)
    return Best(layer, *thrown(layer))


def loss_table() -> Iterator[tuple[str, ...]]:
    """Yield the rows on loss: the lossless optimum and the best layer for each loss tangent."""
    lossless = recommend(Rig()).rig.layer
    for tangent in LOSSES:
        row = [f'{tangent:g}']
        for loss in LOSS_MODELS:
            lossy = Layer(loss=loss, loss_tangent=tangent)
            best = recommend(Rig(layer=lossy))
            alpha, _ = thrown(replace(lossless, loss=loss, loss_tangent=tangent))
            row += [f'{alpha:.3f}', f'{best.energy_transfer:.3f}']
        yield tuple(row)


def stack_table(stacks: Sequence[tuple[int, float, Best]]) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the best stacks, with their throw from a real gel."""
    for count, max_strain, best in stacks:
        real = [
            replace(sheet, stress_strain_law='neo_hookean', loss='constant', loss_tangent=0.05)
            for sheet in best.layer.sheets
        ]
        alpha, _ = thrown(Layer.of_sheets(tuple(real)))
        sheets = ', '.join(
            f'{sheet.thickness:.4g} {sheet.wave_speed:.4g} {sheet.density:.4g}'
            for sheet in best.layer.sheets
        )
        yield (
            str(count),
            'any' if math.isinf(max_strain) else f'{1e2 * max_strain:g} %',
            f'`{sheets}`',
            f'{best.energy_transfer:.2f}', f'{1e2 * best.strain:.0f} %', f'{alpha:.2f}',
        )


def summary(stacks: Sequence[tuple[int, float, Best]]) -> str:
    """Return the gain of stacks over the best single layer."""
    alpha = {(count, most): best.energy_transfer for count, most, best in stacks}
    more = {key: 1e2 * (value / alpha[1, key[1]] - 1.0) for key, value in alpha.items()}
    free, limited = STRAINS
    return (
        f'Two sheets throw with {more[2, limited]:.0f} % more energy than the best layer of one '
        f'material, and three with {more[3, limited]:.0f} %,\nif no sheet is to be compressed by '
        f'more than {1e2 * limited:g} %; without that limit with {more[2, free]:.0f} % and '
        f'{more[3, free]:.0f} %.'
    )


def draw(stacks: Sequence[tuple[int, float, Best]], path: Path) -> None:
    """Draw the impedance of the best stacks over height, and their throws over time."""
    chosen = [(count, best) for count, most, best in stacks if not math.isinf(most)]
    colours = (style.BLACK, style.BLUE, style.RED)
    figure, (left, right) = style.new_figure(
        'Sheets that hand a wave on',
        'The best stacks whose sheets are compressed by 20 % at most, on the default rig.',
        height=3.6,
    )
    times = np.linspace(0.0, 0.012, 600)
    for (count, best), colour in zip(chosen, colours, strict=True):
        edges = 1e3 * np.cumsum([0.0, *(sheet.thickness for sheet in best.layer.sheets)])
        levels = [sheet.impedance for sheet in best.layer.sheets]
        name = ('one sheet', 'two sheets', 'three sheets')[count - 1]
        left.stairs(levels, edges, color=colour, lw=2.0, baseline=None, label=name)
        cells = _CELLS if best.layer.needs_cells else None
        throw = simulate(Rig(layer=best.layer), cells=cells, until=times[-1])
        states, _ = throw.trajectory(times)
        right.plot(1e3 * times, states[:, PROJECTILE_VELOCITY], color=colour)
        release = throw.events[0]
        right.plot(1e3 * release.time, release.velocity, 'o', color=colour, mec='white')
    plate = states[:, PLATE_VELOCITY]
    right.plot(1e3 * times, plate, color=style.BLACK, ls='--', lw=1.0, label='plate')
    left.set(
        xlabel='height in the layer [mm]', ylabel=r'impedance $\rho_s c_s S$ [kg/s]', ylim=0.0
    )
    right.set(xlabel='time [ms]', ylabel='speed [m/s]')
    left.legend()
    right.legend()
    style.save(figure, path)


LOSS_HEAD = (
    'tan delta', 'Kelvin-Voigt: lossless optimum', 'best', 'constant: lossless optimum', 'best',
)
STACK_HEAD = (
    'sheets', 'strain allowed', 'from the plate up: m, m/s, kg/m3', 'alpha', 'strain',
    'alpha as a real gel',
)


def main() -> None:
    """Update the page and its picture."""
    stacks = [
        (sheets, max_strain, find_best(sheets, max_strain))
        for max_strain in STRAINS for sheets in (1, 2, 3)
    ]
    with style.settings():
        draw(stacks, PICTURE)
    page = replace_part(PAGE.read_text('utf-8'), 'loss', table(LOSS_HEAD, loss_table()))
    part = f'{summary(stacks)}\n\n{table(STACK_HEAD, stack_table(stacks))}'
    PAGE.write_text(replace_part(page, 'stacks', part), 'utf-8')


if __name__ == '__main__':
    main()
